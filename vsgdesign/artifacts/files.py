"""Files that appear whole or not at all."""

from __future__ import annotations

import json
import math
import os
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.staging import cannot_write, check_writable, hidden_prefix, staged
from vsgdesign.errors import ArtifactError


@contextmanager
def staged_file(target: str | Path, what: str, ours: Callable[[Path], bool]) -> Iterator[Path]:
    """A path to write ``what`` ("a gain table") at, which takes the target's place when the block ends well.

    A file that is there already is replaced where ``ours`` says that it is an unchanged one of the same kind, or
    where it is empty; anything else is refused before the block runs, and again at its end. A symbolic link stays
    one: the file that it points to is replaced. After an error or an interruption the target is as it was. Raises
    ArtifactError.
    """
    place = check_file_target(target, what, ours)
    with staged(place, target) as path:
        yield path
        os.chmod(path, 0o644)
        check_file_target(target, what, ours)


def check_file_target(target: str | Path, what: str, ours: Callable[[Path], bool]) -> Path:
    """Where a file given as ``target`` will be, links followed. Raises ArtifactError where it may not be written."""
    place = Path(os.path.realpath(target))
    check_writable(place.parent, target)
    try:
        try:
            found = os.lstat(place)
        except FileNotFoundError:
            return place
        if stat.S_ISDIR(found.st_mode):
            raise ArtifactError(f'cannot write "{target}": it is a folder. Give a file.')
        if not stat.S_ISREG(found.st_mode):
            raise ArtifactError(f'cannot write "{target}": it is a device or a pipe. Give a file.')
        if found.st_size and not ours(place):
            raise ArtifactError(
                f'"{target}" is not {what} as it was written, and is left untouched. Give another file, or remove it.'
            )
    except OSError as error:
        raise cannot_write(target, error) from error
    return place


def json_text(document: Any) -> str:
    """The text of a document in JSON's types, as every file of ours has it."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_text(path: str | Path, text: str) -> None:
    """UTF-8 text, written to a neighbour, then renamed: the file appears whole or not at all."""
    with _neighbour(Path(path), text.encode()) as name:
        os.replace(name, path)


def check_new(path: str | Path) -> Path:
    """The path, if a file can be made there. Raises ArtifactError."""
    path = Path(path)
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except ValueError as error:  # a NUL
        raise ArtifactError(f'cannot write "{path}": {error}. Give another file.') from None
    except OSError as error:  # a name too long, a folder that may not be entered
        raise cannot_write(path, error) from None
    if path.is_dir():
        raise ArtifactError(f'"{path}" is a folder; give a file, for example {path / "study.toml"}.')
    if path.exists() or path.is_symlink():
        raise _left_untouched(path)
    if not path.parent.is_dir():
        raise ArtifactError(f'there is no folder "{path.parent}"; make it, or give a file in another one.')
    check_writable(path.parent, path)
    return path


def write_new_text(path: str | Path, text: str) -> None:
    """UTF-8 text into a file that must not be there yet, whole or not at all. Raises ArtifactError."""
    write_new(path, text.encode())


def write_new(path: str | Path, data: bytes) -> None:
    """Bytes into a file that must not be there yet, whole or not at all. Raises ArtifactError."""
    path = check_new(path)
    try:
        with _neighbour(path, data) as name:
            os.link(name, path)  # unlike a rename it fails where somebody else was quicker
    except FileExistsError:
        raise _left_untouched(path) from None
    except OSError as error:
        raise cannot_write(path, error) from None


def _left_untouched(path: Path) -> ArtifactError:
    return ArtifactError(f'"{path}" already exists and was left untouched; give another file.')


@contextmanager
def _neighbour(path: Path, data: bytes) -> Iterator[str]:
    """A whole file beside a path, under a name of its own; gone at the end of the block."""
    handle, name = tempfile.mkstemp(prefix=hidden_prefix(path), dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
        os.chmod(name, 0o644)
        yield name
    finally:
        Path(name).unlink(missing_ok=True)


def plain(value: Any) -> Any:
    """The value in JSON's types: tuples and arrays to lists, dataclasses to tables of their fields, NumPy scalars to
    numbers, what is not finite to null."""
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if value is None or isinstance(value, bool | str | int):
        return value
    if is_dataclass(value):
        return {one.name: plain(getattr(value, one.name)) for one in fields(value)}
    number = float(value)
    return number if math.isfinite(number) else None


def sorted_plain(value: Any) -> Any:
    """As :func:`plain`, with the keys of every table in order: equal contents give equal text."""

    def in_order(item: Any) -> Any:
        if isinstance(item, dict):
            return {key: in_order(item[key]) for key in sorted(item)}
        return [in_order(part) for part in item] if isinstance(item, list) else item

    return in_order(plain(value))
