"""Files that appear whole or not at all, and the versions that influenced what is in them.

Results wait until they are whole in a hidden folder beside their place, under locks that die with a process.
"""

from __future__ import annotations

import errno
import functools
import glob
import hashlib
import json
import math
import os
import platform
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import fields, is_dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

from vsgdesign import __version__
from vsgdesign.errors import ArtifactError

WINDOWS = os.name == "nt"
"""There no open file can be removed: a lock is given back before its file goes, and elsewhere after it."""

_SUFFIX = ".part"
_NEW, _OLD, _LOCK = "new", "old", "lock"
_LONGEST = 200
"""Bytes of a name that are taken over into the hidden one: names end at 255."""

_ADVICE = {
    errno.ENOSPC: "Free some space, or give a place on another disk.",
    errno.EDQUOT: "Remove what is no longer needed, or give a place on another disk.",
    errno.EFBIG: "Give a place that takes larger files.",
    errno.ENAMETOOLONG: "Give a shorter name.",
    errno.ELOOP: "Mend the link, or give another place.",
    errno.EBUSY: "It is a disk of its own; give a place within it.",
    errno.EXDEV: "It is a disk of its own; give a place within it.",
}
_ELSEWHERE = "Give a place that may be written to."
OF_THE_DISK = frozenset(_ADVICE) | {errno.EIO, errno.EROFS, errno.ESTALE}
"""What goes wrong while a file is written, and is neither the study's fault nor the program's."""


def cannot_write(target: str | Path, error: OSError) -> ArtifactError:
    """The one sentence for a place that could not be written to."""
    advice = _ADVICE.get(error.errno or 0, _ELSEWHERE)
    return ArtifactError(f'cannot write "{target}": {error.strerror or error}. {advice}')


def check_writable(folder: Path, shown: str | Path) -> None:
    """Before the long work: raises ArtifactError where nothing can be written to a folder, which may be missing yet."""
    there = next(parent for parent in (folder, *folder.parents) if os.path.lexists(parent))
    if not there.is_dir():
        raise ArtifactError(f'cannot write "{shown}": "{there}" is not a folder. {_ELSEWHERE}')
    if not os.access(there, os.W_OK | os.X_OK):
        raise ArtifactError(f'cannot write "{shown}": Permission denied in "{there}". {_ELSEWHERE}')


@contextmanager
def staged(target: Path, shown: str | Path) -> Iterator[Path]:
    """A path to write a file or folder at, which is moved to ``target`` when the block ends without an error.

    ``target`` has no symbolic links in it. What was there before is kept until the new one is in its place; after an
    error or an interruption it is as it was, and missing parents that were made are gone again. What processes left
    that were killed here earlier is removed, and what they had moved aside is put back. Raises ArtifactError, which
    calls the place ``shown``.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(parents_made(target.parent))
            _sweep(target)
            space = stack.enter_context(_space(target))
        except OSError as error:
            raise cannot_write(shown, error) from error
        try:
            yield space / _NEW
        except OSError as error:
            if error.errno in OF_THE_DISK:
                raise cannot_write(shown, error) from error
            raise
        try:
            _replace(space, target)
        except OSError as error:
            raise cannot_write(shown, error) from error


def _replace(space: Path, target: Path) -> None:
    if not target.is_dir():
        os.replace(space / _NEW, target)
        return
    # A folder cannot be renamed over a full one: the old moves aside first, and back if that fails.
    try:
        os.replace(target, space / _OLD)
        os.replace(space / _NEW, target)
    except BaseException:  # an interruption counts: the old results must not go with the folder they wait in
        _put_back(space, target)
        raise


def _put_back(space: Path, target: Path) -> None:
    if not os.path.lexists(target) and os.path.lexists(space / _OLD):
        os.replace(space / _OLD, target)


def hidden_prefix(target: Path) -> str:
    """How the hidden name of what waits beside a target begins."""
    name = target.name
    if len(os.fsencode(name)) > _LONGEST:
        name = hashlib.sha256(os.fsencode(name)).hexdigest()[:16]
    return f".{name}."


@contextmanager
def _space(target: Path) -> Iterator[Path]:
    """A new hidden folder beside ``target``, on the same file system, locked; removed at the end."""
    with ExitStack() as held:
        while True:
            space = Path(tempfile.mkdtemp(_SUFFIX, hidden_prefix(target), target.parent))
            try:
                held.enter_context(locked(space / _LOCK, partial(_remove, space)))
                break
            except (LockedError, FileNotFoundError):
                continue  # somebody swept it between its making and its locking
        yield space


def _sweep(target: Path) -> None:
    """Remove what dead processes left of this target. Another's, or what cannot be judged, stays."""
    for space in sorted(target.parent.glob(f"{glob.escape(hidden_prefix(target))}*{_SUFFIX}")):
        with locked_by_the_dead(space / _LOCK) as dead:
            if dead:
                with suppress(OSError):
                    _put_back(space, target)
                    _remove(space)
        if dead and WINDOWS:  # the lock was open until here
            _remove(space)


def _remove(space: Path) -> None:
    """The lock goes last: what a kill leaves in between can still be swept."""
    for name in (_NEW, _OLD):
        path = space / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
    shutil.rmtree(space, ignore_errors=True)


@contextmanager
def parents_made(folder: Path) -> Iterator[None]:
    """Missing folders are made; those that are still empty after an error are taken away again."""
    missing = [parent for parent in (folder, *folder.parents) if not os.path.lexists(parent)]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for parent in missing:
            with suppress(OSError):
                parent.rmdir()
        raise


class LockedError(Exception):
    """Another process holds the lock."""


@contextmanager
def locked(path: Path, tidy: Callable[[], object] | None = None) -> Iterator[None]:
    """Hold the lock file ``path`` within this block; it is made where it is missing, and stays unless ``tidy``, which
    is called at the end, removes it.

    The kernel gives the lock back when the process ends, also when it is killed; a process that only started
    beside it is never taken for it, as a process number could be. Raises LockedError at once where another holds it,
    OSError where the file cannot be made. A file system without locks has none: the block is entered.
    """
    with ExitStack() as end:
        stream = end.enter_context(path.open("ab"))
        # The one who held it may have removed the file in between: then what was locked is no longer this path.
        if _lock(stream.fileno()) is False or not _is(stream.fileno(), path):
            raise LockedError(str(path))
        if tidy is not None:
            end.callback(tidy)
        if WINDOWS:
            end.callback(stream.close)  # comes before
        yield


@contextmanager
def locked_by_the_dead(path: Path) -> Iterator[bool]:
    """Whether ``path`` is a lock file that nobody holds any more; within the block it is held here.

    No where there is no such file, and where the file system cannot say.
    """
    try:
        stream = path.open("r+b")
    except OSError:
        yield False
        return
    with stream:
        yield _lock(stream.fileno()) is True and _is(stream.fileno(), path)


def _lock(handle: int) -> bool | None:
    """Yes, no, or None where the file system has no locks."""
    from filelock import lock_descriptor  # here, because the runtime reads files with NumPy alone, and locks none

    try:
        return lock_descriptor(handle, blocking=False)
    except OSError:
        return None


def _is(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except OSError:
        return False


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


_LIBRARIES = ("casadi", "clarabel", "cmaes", "control", "cvxpy", "llvmlite", "numba", "numpy", "scipy")


def provenance() -> dict[str, str]:
    """Versions by name."""
    return {"vsgdesign": __version__, "python": platform.python_version()} | _installed()


@functools.cache
def _installed() -> dict[str, str]:
    """Versions of the libraries by name, which reads a file for each: a design asks for every node."""
    return {name: metadata.version(name) for name in _LIBRARIES}


@functools.cache
def package_hash() -> str:
    """SHA-256 over the sources of this package: what an unfinished job was begun with."""
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root).as_posix()}\0".encode() + path.read_bytes())
    return digest.hexdigest()
