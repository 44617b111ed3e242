"""Files that a user gives: regular files alone, of a size that their kind can have; and TOML, with what is wrong in it
and what to do about it.

A pipe would wait, and a device would be read until memory ends. What is wrong is an OSError whose ``strerror`` is the
end of a sentence, as of every file that cannot be read.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import stat
import tomllib
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from vsgdesign.errors import Fault, StudyError

MB = 10**6

TOML_BYTES = 1 * MB
"""Of a study, a suite, a recipe or a datasheet; each has a few kB."""

TABLE_BYTES = 20 * MB
"""Of a gain table and of designed inner loops."""

WEIGHTS_BYTES = 100 * MB
"""Of weights and measured errors."""

RESULT_BYTES = 500 * MB
"""Of a results.json, of counts and of a trace."""

RECORD_BYTES = 2000 * MB
"""Of a recorded voltage, and of what an archive holds unpacked."""

WINDOWS_BYTES = 20_000 * MB
"""Of a data set of windows."""


def open_given(path: str | Path, most_bytes: int) -> IO[bytes]:
    """A regular file, to be read. Raises OSError for anything else, and for one that is larger."""
    try:
        _check(os.stat(path), most_bytes)
    except ValueError:
        raise OSError(errno.EINVAL, "its name has a character that no name of a file has") from None
    stream = open(path, "rb", opener=_open_at_once)  # noqa: SIM115 - returned
    try:
        _check(os.fstat(stream.fileno()), most_bytes)  # another one may have taken its place
    except OSError:
        stream.close()
        raise
    return stream


def read_given(path: str | Path, most_bytes: int) -> bytes:
    """The bytes of a regular file, as :func:`open_given`."""
    with open_given(path, most_bytes) as stream:
        data = stream.read(most_bytes + 1)  # the system's own files say that they are empty
    if len(data) > most_bytes:
        raise _too_large("more", most_bytes)
    return data


def check_unpacked(stream: IO[bytes], most_bytes: int) -> None:
    """Whether a zip archive is small enough unpacked, too. Raises OSError and zipfile.BadZipFile."""
    with zipfile.ZipFile(stream) as archive:
        size = sum(one.file_size for one in archive.infolist())
    if size > most_bytes:
        raise _too_large(f"{size / MB:,.3g} MB unpacked", most_bytes)
    stream.seek(0)


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _check(found: os.stat_result, most_bytes: int) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise OSError(errno.EISDIR, "it is a folder, and a file is needed")
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device, and a file is needed")
    if found.st_size > most_bytes:
        raise _too_large(f"{found.st_size / MB:,.3g} MB", most_bytes)


def _too_large(size: str, most_bytes: int) -> OSError:
    return OSError(errno.EFBIG, f"it has {size}, and the limit of its kind is {most_bytes / MB:,g} MB")


CASE_PREFIX = "case:"
"""Begins the name of a converter that comes with the package."""
MOST_LEVELS = 50
"""Levels of tables within tables that are read."""
_SHALLOW = "No field lies deeper than four; look for dots in keys."
_KEY = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""
_KEYS = re.compile(rf"{_KEY}(?:[ \t]*\.[ \t]*{_KEY})*")


def read_toml(path: Path, noun: str) -> dict[str, Any]:
    """The content of a file, which is a ``noun`` such as "study file". Raises StudyError."""

    def fault(problem: str, advice: str) -> StudyError:
        return StudyError(str(path), [Fault(noun, f'"{path}"', problem, advice)])

    advice = f"Give the path of a .toml {noun}."
    try:
        if _is_stream(path):
            raise fault(
                f"is a pipe or a device, not a {noun}",
                "Save it as a file: bases, tables and designed inner loops are looked up beside it.",
            )
        if str(path).startswith(CASE_PREFIX) and not path.exists():
            raise fault(
                f"is a converter that comes with the package, not a {noun}",
                f"Write its study with vsgdesign new --from {shlex.quote(str(path))}.",
            )
        if not path.is_file():
            raise fault(f"is a folder, not a {noun}" if path.is_dir() else "there is no such file", advice)
        text = read_given(path, TOML_BYTES).decode("utf-8-sig")  # as spreadsheets and some editors write it
    except UnicodeDecodeError as error:
        if error.object[:2] in (b"\xff\xfe", b"\xfe\xff"):  # as Windows writes "Unicode"
            raise fault("is not UTF-8 text but UTF-16", "Save it with the encoding UTF-8.") from None
        raise fault(f"is not UTF-8 text (byte {error.start})", "Give a TOML text file.") from None
    except OSError as error:
        raise fault(f"cannot be read: {error.strerror}", advice) from None
    of_sheet = f"If it is a datasheet, write its study with vsgdesign new --from {shlex.quote(str(path))}."
    try:
        document = parse_toml(text, str(path))
    except StudyError:
        if noun == "study file" and path.suffix.casefold() in (".csv", ".tsv"):
            raise fault("cannot be read as TOML: it is a table of values", of_sheet) from None
        raise
    if noun == "study file" and _says_no_section(document):
        raise fault("has no section such as [converter]", of_sheet)
    return document


def _says_no_section(document: Mapping[str, Any]) -> bool:
    """Whether a document has fields that belong into sections, and neither a section nor a base that may have them."""
    fields = document.keys() - {"schema"}
    return bool(fields) and "base" not in fields and not any(map(_is_section, document.values()))


def _is_stream(path: Path) -> bool:
    """Standard input, a pipe, a device; also where the shell has put a file behind it: nothing lies beside it."""
    if path == Path("-"):
        return not path.exists()
    behind = os.path.realpath(path.parent)
    given = behind == "/dev" or behind.startswith(("/dev/fd", "/proc/"))
    return given or (path.exists() and not path.is_file() and not path.is_dir())


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """The content of a text. Raises StudyError."""
    deep = [Fault("TOML", "", f"tables are nested more than {MOST_LEVELS} levels deep", _SHALLOW)]
    dotted = (keys for keys in _KEYS.findall(text) if keys.count(".") >= MOST_LEVELS)
    if any(len(re.findall(_KEY, keys)) > MOST_LEVELS for keys in dotted):
        raise StudyError(source, deep)  # before it is read: that takes the square of the length of such a key
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, and what it lets through
        if _is_json(text):
            problem, advice = "this is JSON", "Write it as TOML: [table] for an object, field = value for its members."
        else:
            problem = f"cannot be read as TOML: {error}"
            advice = "A table is [name] on a line of its own, a field is name = value, texts are in quotes."
        raise StudyError(source, [Fault("TOML", "", problem, advice)]) from None
    if _is_deeper(document, MOST_LEVELS):
        raise StudyError(source, deep)
    return document


def _is_deeper(value: Any, levels: int) -> bool:
    """Whether tables and lists are nested deeper; without recursion, which is what deep ones would exhaust."""
    level = [value]
    for _ in range(levels + 1):
        level = [
            item
            for one in level
            if isinstance(one, dict | list)
            for item in (one.values() if isinstance(one, dict) else one)
        ]
    return bool(level)


def _is_json(text: str) -> bool:
    try:
        return isinstance(json.loads(text), dict | list)
    except (ValueError, RecursionError):
        return False


_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(document: Mapping[str, Any], comments: tuple[str, ...] = ()) -> str:
    """A document of numbers, texts, booleans, lists and tables as TOML text, behind lines of comment.

    Numbers are written such that reading gives the same bits. Raises ValueError for a number that is not finite, and
    TypeError for a value that TOML has no word for.
    """
    lines = [f"# {line}".rstrip() for line in comments]
    plain = {key: value for key, value in document.items() if not _is_section(value)}
    lines += [f"{_key(key)} = {_inline(value)}" for key, value in plain.items()]
    for key, value in document.items():
        if isinstance(value, Mapping):
            lines += _section(_key(key), value)
        elif _is_section(value):
            for item in value:
                lines += ["", f"[[{_key(key)}]]", *_fields(item)]
    return "\n".join(lines) + "\n"


def _section(name: str, table: Mapping[str, Any]) -> list[str]:
    nested = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    lines = ["", f"[{name}]", *_fields({key: value for key, value in table.items() if key not in nested})]
    for key, value in nested.items():
        lines += _section(f"{name}.{_key(key)}", value)
    return lines


def _fields(table: Mapping[str, Any]) -> list[str]:
    return [f"{_key(key)} = {_inline(value)}" for key, value in table.items()]


def _is_section(value: Any) -> bool:
    if isinstance(value, Mapping):
        return True
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(item, Mapping) for item in value)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _quoted(key)


_IN_JSON = json.JSONEncoder(ensure_ascii=False).encode


def _quoted(text: str) -> str:
    """A text for TOML, which has the escapes of JSON."""
    return _IN_JSON(text).replace("\x7f", "\\u007f")


def _inline(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if value - value != 0.0:
            raise ValueError(f"{value} cannot be written to a study: it is not finite.")
        return repr(float(value))
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_fields(value)) + " }" if value else "{}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_inline(item) for item in value) + "]"
    raise TypeError(f"{type(value).__name__} has no word in TOML: {value!r:.100}")
