"""Writes a document as TOML: sections at the top, lists of tables as [[sections]], everything deeper inline."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

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


def _quoted(text: str) -> str:
    """A text for TOML, which has the escapes of JSON."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


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
