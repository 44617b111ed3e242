"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vsgdesign.errors import ArtifactError

MARKER = "results.json"
"""A folder that holds this file is one of ours and may be replaced."""


_ADVICE = "Give a folder in a place that may be written to."


def _check_replaceable(target: Path, marker: str) -> None:
    if target.is_dir() and not os.access(target, os.W_OK):
        raise ArtifactError(f'cannot write into "{target}": Permission denied. {_ADVICE}')
    if target.exists() and not target.is_dir():
        raise ArtifactError(f'"{target}" is a file; give a folder for the results.')
    if target.is_dir() and any(target.iterdir()) and not (target / marker).is_file():
        raise ArtifactError(
            f'"{target}" holds other files (no {marker} in it) and is left untouched; give a new or an empty folder.'
        )


@contextmanager
def staged_folder(target: str | Path, marker: str = MARKER) -> Iterator[Path]:
    """A fresh folder to write into, which takes the target's place when the block ends without an error.

    A target from an earlier run (it holds the marker) is replaced; one with anything else in it is refused
    at once. After an error or an interruption the target is as it was before. Raises ArtifactError.
    """
    target = Path(target).absolute()
    _check_replaceable(target, marker)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    except OSError as error:
        raise ArtifactError(f'cannot write beside "{target}": {error.strerror}. {_ADVICE}') from error
    try:
        os.chmod(staging, 0o755)  # mkdtemp makes it private to the user
        yield staging
        _check_replaceable(target, marker)
        try:
            _replace(staging, target)
        except OSError as error:
            raise ArtifactError(f'cannot write "{target}": {error.strerror}. {_ADVICE}') from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _replace(staging: Path, target: Path) -> None:
    if not target.exists():
        os.replace(staging, target)
        return
    # A folder cannot be renamed over a full one: the old moves aside first, and back if that fails.
    aside = Path(tempfile.mkdtemp(prefix=f".{target.name}.old.", dir=target.parent))
    try:
        os.replace(target, aside / "old")
        os.replace(staging, target)
    except BaseException:  # an interruption counts: the old results must not go with the folder they wait in
        if not target.exists():
            os.replace(aside / "old", target)
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def write_json(path: str | Path, document: Any) -> None:
    """JSON with sorted structure as given; NaN and infinity become null; whole or not at all."""
    write_text(path, json.dumps(plain(document), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_text(path: str | Path, text: str) -> None:
    """UTF-8 text, written to a neighbour, then renamed: the file appears whole or not at all."""
    path = Path(path)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def plain(value: Any) -> Any:
    """The value in JSON's types: tuples and arrays to lists, NumPy scalars to numbers, what is not finite to null."""
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if value is None or isinstance(value, bool | str | int):
        return value
    number = float(value)
    return number if math.isfinite(number) else None
