"""What guards itself: JSON files, which name kind and schema and carry the sha256 of their content, and folders of
results, which list what was written into them. Only an unchanged one is ever replaced.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeGuard, TypeVar

from vsgdesign.artifacts.files import (
    cannot_write,
    check_file_target,
    check_writable,
    json_text,
    parents_made,
    plain,
    staged,
    staged_file,
    write_text,
)
from vsgdesign.errors import ArtifactError
from vsgdesign.study.given_files import RESULT_BYTES, TABLE_BYTES, read_given

T = TypeVar("T")

_ROW = re.compile(r"\[\n\s*([^\[\]{}]*?)\n\s*\]")
_BREAK = re.compile(r",\n *")


def content_hash(document: dict[str, Any]) -> str:
    """sha256 of a document's canonical JSON: sorted keys, no blanks, shortest round-trip numbers."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def is_number(value: object) -> TypeGuard[float]:
    """A finite int or float; a bool is none."""
    return isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)


@dataclass(frozen=True, kw_only=True)
class GuardedFile(Generic[T]):
    """How a thing is kept as such a file. Equal things give equal bytes.

    ``what``, ``origin`` and ``again`` go into the errors: "a gain table", 'written by "vsgdesign table build"', "build
    the table again". ``document`` gives the content in JSON's types, ``build`` the thing of a content,
    ``faults`` what makes it unusable, one sentence each. ``layout`` may move the line breaks of the text.
    """

    kind: str
    schema: int
    what: str
    origin: str
    again: str
    document: Callable[[T], dict[str, Any]]
    build: Callable[[dict[str, Any]], T]
    faults: Callable[[T], Iterable[str]]
    layout: Callable[[str], str] = str
    most_bytes: int = TABLE_BYTES
    """A larger file is not read."""
    upgrades: tuple[Callable[[dict[str, Any]], dict[str, Any]], ...] = ()
    """The k-th makes a content of schema k + 2 of one of schema k + 1: what older versions wrote is read."""

    def render(self, document: dict[str, Any]) -> str:
        """The text of a content, with its hash."""
        whole = document | {"sha256": content_hash(document)}
        return self.layout(json_text(whole))

    def write(self, value: T, path: str | Path) -> None:
        """The file appears whole or not at all; what is there already is replaced only where :meth:`is_unchanged`.

        Raises ArtifactError with every fault where it would be unusable.
        """
        faults = list(self.faults(value))
        if faults:
            raise ArtifactError(
                f'"{path}" was not written, because it would not be a usable {self._noun}.{_listed(faults)}'
            )
        with staged_file(path, self.what, self.is_unchanged) as place:
            place.write_text(self.render(self.document(value)), encoding="utf-8", newline="\n")

    def check_target(self, path: str | Path) -> None:
        """Before the long work rather than after it: raises ArtifactError where :meth:`write` would."""
        check_file_target(path, self.what, self.is_unchanged)

    def is_unchanged(self, path: Path) -> bool:
        """Whether a file is one of this kind, of a schema that is known here, and as it was written."""
        try:
            data = read_given(path, self.most_bytes)
            self._document(data)
        except (OSError, ArtifactError):
            return False
        return True

    def read(self, path: str | Path) -> T:
        """What the file holds.

        Raises ArtifactError with what to do where the file is missing, cut short, not JSON, of another kind or a
        newer schema, changed since it was written, or holds what is unusable.
        """
        try:
            data = read_given(path, self.most_bytes)
        except OSError as error:
            raise ArtifactError(f'cannot read "{path}": {error.strerror}. Give the file of {self.what}.') from error
        try:
            return self._parse(data)
        except ArtifactError as error:
            raise ArtifactError(f"{path}: {error}") from None

    @property
    def _noun(self) -> str:
        return self.what.removeprefix("a ")

    def _parse(self, data: bytes) -> T:
        document = self._document(data)
        for upgrade in self.upgrades[document["schema"] - 1 :]:
            document = upgrade(document)
        document["schema"] = self.schema
        said = content_hash(document)
        try:
            value = self.build(document)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ArtifactError(f"it is not a complete {self._noun} ({_reason(error)}); {self.again}.") from error
        faults = list(self.faults(value))
        if faults:
            raise ArtifactError(f"it is not a usable {self._noun}; {self.again}.{_listed(faults)}")
        if content_hash(self.document(value)) != said:
            raise ArtifactError(f"it has text or an integer where a number must be, or the reverse; {self.again}.")
        return value

    def _document(self, data: bytes) -> dict[str, Any]:
        """The content without its hash, of bytes that are as they were written."""
        document = self._json(data)
        kind = document.get("kind") if isinstance(document, dict) else None
        if kind != self.kind:
            other = f" but of kind {json.dumps(kind)}" if isinstance(kind, str) else ""
            raise ArtifactError(f"it is not {self.what}{other}; give a file {self.origin}.")
        schema = document.get("schema")
        if not isinstance(schema, int) or isinstance(schema, bool) or schema < 1:
            raise ArtifactError(f"schema = {schema!r} is not a schema number; {self.again}.")
        if schema > self.schema:
            raise ArtifactError(f"it has schema {schema}, this version reads up to {self.schema}; update vsgdesign.")
        said = document.pop("sha256", None)
        try:
            is_what_it_says = said == content_hash(document)
        except UnicodeEncodeError:  # half of a surrogate pair: nothing of ours
            is_what_it_says = False
        if not is_what_it_says:
            raise ArtifactError(f"its content does not match its sha256; fetch the original or {self.again}.")
        if data != self.render(document).encode():
            raise ArtifactError("its text was re-formatted since it was written; fetch the original file.")
        return document

    def _json(self, data: bytes) -> Any:
        def number(text: str) -> float:
            value = float(text)
            if not math.isfinite(value):
                raise ArtifactError(f"it holds {text} where a number must be; {self.again}.")
            return value

        try:
            return json.loads(data.decode("utf-8"), parse_float=number, parse_constant=number)
        except UnicodeDecodeError as error:
            raise ArtifactError(f"it is not text; give the JSON file of {self.what}.") from error
        except json.JSONDecodeError as error:
            if data.lstrip()[:1] == b"{" and not data.endswith(b"}\n"):
                raise ArtifactError(f"it is cut short; fetch it again or {self.again}.") from error
            raise ArtifactError(f"it is not JSON ({error}); give the file of {self.what}.") from error
        except ValueError as error:  # an integer of thousands of digits
            raise ArtifactError(f"it is not JSON of vsgdesign ({error}); give the file of {self.what}.") from error
        except RecursionError as error:
            raise ArtifactError(f"it is nested too deeply to be {self.what}; give another file.") from error


def rows_on_a_line(text: str) -> str:
    """A layout: innermost lists joined. JSON's strings have no line breaks, so none of them is touched."""
    return _ROW.sub(lambda row: "[" + _BREAK.sub(", ", row[1]) + "]", text)


def _listed(faults: Sequence[str]) -> str:
    return "".join(f"\n  - {fault}" for fault in faults)


def _reason(error: Exception) -> str:
    return f"{error.args[0]} is missing" if isinstance(error, KeyError) and error.args else str(error)


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
