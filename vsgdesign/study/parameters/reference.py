"""What the fields of a study say of themselves: where they are, and their meaning and type in words.

The words come from :mod:`vsgdesign.study.parameters.fields`, so that a field is described where it is read and nowhere
else.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from vsgdesign.study.parameters.building import Sections
from vsgdesign.study.parameters.fields import Field, fields_of


def tables_of(fields: tuple[Field, ...], path: str = "") -> Iterator[tuple[str, tuple[Field, ...]]]:
    """The path of every table of a study, and its fields; ``""`` for the top level."""
    yield path, fields
    for one in fields:
        if one.of:
            yield from tables_of(one.fields, f"{path}.{one.name}" if path else one.name)


def field_at(path: str) -> Field:
    """The field of a path such as ``power_loops.tau_P``. Raises KeyError for a path that a study does not have."""
    table, _, name = path.rpartition(".")
    return {one.name: one for one in dict(tables_of(fields_of(Sections)))[table]}[name]


def plain_meaning(one: Field) -> str:
    """The meaning of a field as text without links and marks."""
    text = re.sub(r" \(:eq:.[a-z0-9-]+.\)", "", one.meaning.removesuffix("."))
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text).replace("`", "")


def type_text(one: Field, table: str = "Mapping[str, Any]") -> str:
    """The type of a field as an argument in Python, as text: ``Quantity`` is a number in SI or a text with a unit.

    ``table``: the type of a table.
    """
    words = "Literal[" + ", ".join(f'"{word}"' for word in one.choices) + "]"
    types = {
        "number": "Quantity",
        "range": "Quantity | Sequence[Quantity]",
        "numbers": "Sequence[Quantity]",
        "whole number": "int",
        "whole range": "int | Sequence[int]",
        "true or false": "bool",
        "word": words if isinstance(one.words, tuple) else f"{words} | str",
        "text": "str | Path" if "file" in one.limits or ".csv" in one.limits else "str",
        "name": "str",
        "names": "Sequence[str | int]",
        "tables": f"Sequence[{table}]",
        "table": table + (f' | Literal["{one.instead}"]' if one.instead else ""),
    }
    return types[one.kind]
