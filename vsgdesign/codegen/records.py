"""Values that a reader holds besides expressions: NamedTuples, and what is known when the text is generated."""

from __future__ import annotations

import typing
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.codegen.expressions import Expression, Field, Invocation, Number, Operation, Variable

SCALARS = (Number, Variable, Field, Operation, Invocation)


@dataclass
class Record:
    """A NamedTuple: its values by field, and its name in the target where it has one."""

    cls: Any
    values: dict[str, Any]
    home: str = ""
    label: str = ""
    """What the source calls it."""
    given: bool = False
    """Whether it came in as an argument and is what it was."""


def is_record(cls: Any) -> bool:
    """Whether it is the class of a NamedTuple."""
    return isinstance(cls, type) and issubclass(cls, tuple) and hasattr(cls, "_fields")


def known(value: Any, name: str = "") -> Any:
    """What is known when the text is generated: numbers become expressions, NamedTuples records."""
    if isinstance(value, bool | np.bool_):
        return Number(bool(value))
    if isinstance(value, int | float):
        return Number(float(value), name)
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return Record(type(value), {field: known(getattr(value, field)) for field in type(value)._fields})
    return value


def record_at(cls: Any, home: str, path: str = "", given: bool = True) -> Record:
    """A record that is in the target under a name; fields whose type is a NamedTuple are records in it."""
    hints = typing.get_type_hints(cls)
    values: dict[str, Any] = {}
    for name in cls._fields:
        inner = f"{path}{name}"
        hint = hints.get(name)
        values[name] = record_at(hint, home, f"{inner}.", given) if is_record(hint) else Field(home, inner)
    return Record(cls, values, "" if path else home, given=given and not path)


def leaves(record: Record, path: str = "") -> list[tuple[str, Expression]]:
    """Every scalar of a record by path."""
    found: list[tuple[str, Expression]] = []
    for name, value in record.values.items():
        if isinstance(value, Record):
            found += leaves(value, f"{path}{name}.")
        else:
            found.append((f"{path}{name}", value))
    return found
