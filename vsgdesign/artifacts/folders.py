"""Folders of results: they list what was written into them, and only an unchanged one is ever replaced."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import json_text, plain, write_text
from vsgdesign.artifacts.guarded_file import content_hash
from vsgdesign.artifacts.staging import cannot_write, check_writable, parents_made, staged
from vsgdesign.errors import ArtifactError
from vsgdesign.study.given_files import RESULT_BYTES, read_given

RESULTS = "results.json"
"""The file of a folder that lists all others, where a verb does not say another."""

_ADVICE = "Give a new or an empty folder, or remove this one."


@contextmanager
def staged_folder(
    target: str | Path, kind: str, *, inputs: Iterable[str | Path] = (), record: str = RESULTS
) -> Iterator[Path]:
    """A fresh folder to write into, which takes the target's place when the block ends without an error.

    ``kind`` says which verb writes ("vsgdesign run"). The block ends with :func:`write_record`. A target that is
    there already is replaced where it is empty, or where it is a result of the same kind in which every file is
    listed and has its hash. Anything else is refused before the block runs, and again at its end: one more file,
    a changed file, another verb's result, a folder with one of the ``inputs`` in it, the folder that one is in. A
    symbolic link stays one: the folder that it points to is replaced. After an error or an interruption the target
    is as it was. Raises ArtifactError.
    """
    inputs = tuple(inputs)
    place = check_folder_target(target, kind, inputs, record)
    with staged(place, target) as folder:
        folder.mkdir()
        yield folder
        if not (folder / record).is_file():
            raise ValueError(f"the folder of {kind} has no {record}")
        check_folder_target(target, kind, inputs, record)


@contextmanager
def room_for(target: str | Path, kind: str, *, inputs: Iterable[str | Path] = ()) -> Iterator[None]:
    """For work that keeps finished parts beside ``target`` before its :func:`staged_folder` begins: refuses what that
    would refuse, and makes missing parents, which are gone again after an error. Raises ArtifactError."""
    place = check_folder_target(target, kind, inputs, RESULTS)
    with ExitStack() as held:
        try:
            held.enter_context(parents_made(place.parent))
        except OSError as error:
            raise cannot_write(target, error) from error
        yield


def write_record(
    folder: Path,
    document: dict[str, Any],
    kind: str,
    record: str = RESULTS,
    *,
    known: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Write a document with the list of every other file of the folder and its SHA-256, and with its own hash.

    ``known``: those of files that whoever wrote them has found. Returns the whole document; what is not finite is null
    in the file alone.
    """
    found, names = dict(known or {}), [name for name in sorted(_files(folder)) if name != record]
    files = {name: found.get(name) or file_hash(folder / name) for name in names}
    whole = {"kind": kind} | document | {"files": files}
    written = plain(whole)
    written["sha256"] = content_hash(written)
    write_text(folder / record, json_text(written))
    return whole | {"sha256": written["sha256"]}


def check_folder_target(
    target: str | Path, kind: str, inputs: Iterable[str | Path] = (), record: str = RESULTS
) -> Path:
    """Where a folder given as ``target`` will be, links followed. Raises ArtifactError where it may not be replaced."""
    place = Path(os.path.realpath(target))
    check_writable(place.parent, target)
    try:
        try:
            os.lstat(place)  # says also that a name is too long
        except FileNotFoundError:
            return place
        if not place.is_dir():
            raise ArtifactError(f'"{target}" is a file; give a folder for the results.')
        if not os.access(place, os.W_OK):
            raise ArtifactError(
                f'cannot write into "{target}": Permission denied. Give a folder in a place that may be written to.'
            )
        if Path.cwd().resolve().is_relative_to(place):
            raise ArtifactError(f'"{target}" is the folder that you are in, or one above it. Give a folder below it.')
        for path in inputs:
            if Path(os.path.realpath(path)).is_relative_to(place):
                raise ArtifactError(f'"{target}" holds "{path}", which is read here. Give another folder.')
        if (problem := _problem(place, kind, record)) is not None:
            raise ArtifactError(f'"{target}" {problem}, and is left untouched. {_ADVICE}')
    except OSError as error:
        raise cannot_write(target, error) from error
    return place


def _problem(folder: Path, kind: str, record: str) -> str | None:
    """Why a folder is no unchanged result of this kind; None where it is, or is empty."""
    first = min((path.name for path in folder.iterdir()), default=None)
    if first is None:
        return None
    document = _record(folder / record)
    if document is None:
        here = record if os.path.lexists(folder / record) else first
        if here != record:
            return f"holds {here}, and no {record} that says which verb wrote it"
        return f"holds a {record} that was changed, or that an earlier version wrote without a list of the files"
    if document.get("kind") != kind:
        return f'holds the results of "{document.get("kind")}", not of "{kind}"'
    files = document["files"]
    for name in _files(folder):
        if name == record:
            continue
        if name not in files:
            return f'holds {name}, which "{kind}" did not write'
        if (folder / name).is_symlink() or not (folder / name).is_file() or file_hash(folder / name) != files[name]:
            return f'holds {name}, which was changed since "{kind}" wrote it'
    return None


def _record(path: Path) -> dict[str, Any] | None:
    """The document of a record that is as it was written, else None."""
    try:
        if path.is_symlink():
            return None
        text = read_given(path, RESULT_BYTES).decode("utf-8")
        document = json.loads(text)
        said = document.pop("sha256")
        whole = document | {"sha256": content_hash(document)}
        good = said == whole["sha256"] and text == json_text(whole) and isinstance(document["files"], dict)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return document if good else None


def _files(folder: Path) -> Iterator[str]:
    """Every file and link below a folder by its path in it."""

    def stop(error: OSError) -> None:
        raise error  # what cannot be read may be anything

    for parent, folders, files in os.walk(folder, onerror=stop):
        links = [name for name in folders if (Path(parent) / name).is_symlink()]
        for name in sorted([*files, *links]):
            yield (Path(parent) / name).relative_to(folder).as_posix()


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
