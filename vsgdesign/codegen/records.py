"""Values that a reader holds besides expressions: NamedTuples, and what is known when the text is generated."""

from __future__ import annotations

import functools
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.codegen.expressions import (
    NUMBERS,
    REAL,
    Expression,
    Field,
    Invocation,
    Number,
    Numbers,
    Operation,
    Variable,
)
from vsgdesign.codegen.language import marked

SCALARS = (Number, Variable, Field, Operation, Invocation, Numbers)


@dataclass
class Record:
    """A NamedTuple: its values by field, and its name in the target where it has one."""

    cls: Any
    values: dict[str, Any]
    home: str = ""
    path: str = ""
    """Where it is within the record of that name."""
    label: str = ""
    """What the source calls it."""
    given: bool = False
    """Whether it came in as an argument and is what it was."""
    choice: tuple[Expression, Record, Record] | None = None
    """A condition and the two records of which it is one, where that is all that it is."""


@dataclass(frozen=True)
class Changed:
    """What makes a record of another one: its method ``_replace``."""

    record: Record


@functools.cache
def _hints(record: Any) -> dict[str, Any]:
    return typing.get_type_hints(record, include_extras=True)


def kind_of_field(record: Any, name: str) -> str:
    """REAL, COUNT or NUMBERS, of a field that is no record."""
    return marked(_hints(record).get(name)) or REAL


def is_record(cls: Any) -> bool:
    """Whether it is the class of a NamedTuple."""
    return isinstance(cls, type) and issubclass(cls, tuple) and hasattr(cls, "_fields")


def known(value: Any, name: str = "") -> Any:
    """What is known when the text is generated: numbers become expressions, NamedTuples records."""
    if isinstance(value, bool | np.bool_):
        return Number(bool(value))
    if isinstance(value, int | float):
        return Number(int(value) if isinstance(value, int) else float(value), name)
    if is_record(type(value)):
        fields = {
            field: Numbers(tuple(item)) if kind_of_field(type(value), field) == NUMBERS else known(item)
            for field, item in value._asdict().items()
        }
        if all(isinstance(item, Number | Numbers | Record) for item in fields.values()):
            return Record(type(value), fields)
    return value


class Kinds:
    """What the fields of NamedTuples are: a number, or another NamedTuple by their type hint, their default, or by what
    was said for a class."""

    def __init__(self, said: Mapping[Any, Mapping[str, Any]]) -> None:
        self._said = {record: dict(fields) for record, fields in said.items()}
        self._found: dict[Any, list[tuple[str, Any]]] = {}

    def takes(self, record: Any, name: str, given: Any) -> bool:
        """Whether a field takes a value. A record in place of one that is nothing makes the field one of its kind."""
        kind = dict(self.fields(record))[name]
        if not isinstance(given, Record):
            return kind is None
        if kind is not given.cls and kind is not None and not self.paths(kind):
            self._said.setdefault(record, {})[name] = given.cls
            self._found.pop(record, None)
            return True
        return kind is given.cls

    def fields(self, record: Any) -> list[tuple[str, Any]]:
        """Names, and the class of what is no number."""
        if record in self._found:
            return self._found[record]
        hints = _hints(record)
        found = self._found[record] = []
        for name in record._fields:
            default = record._field_defaults.get(name)
            kinds = self._said.get(record, {}).get(name), hints.get(name), type(default)
            found.append((name, next(filter(is_record, kinds), None)))
        return found

    def paths(self, record: Any, prefix: str = "") -> list[str]:
        """Every number in it; none of a record that is nothing in the target."""
        found: list[str] = []
        for name, inner in self.fields(record):
            found += [f"{prefix}{name}"] if inner is None else self.paths(inner, f"{prefix}{name}.")
        return found

    def at(self, record: Any, home: str, path: str = "", given: bool = True) -> Record:
        """A record that is in the target under a name."""
        values: dict[str, Any] = {}
        for name, inner in self.fields(record):
            place = f"{path}.{name}" if path else name
            if inner is None:
                values[name] = Field(home, place, kind_of_field(record, name))
            else:
                values[name] = self.at(inner, home, place, given)
        return Record(record, values, home if values else "", path, given=given)


def leaves(record: Record, path: str = "") -> list[tuple[str, Expression]]:
    """Every scalar of a record by path."""
    found: list[tuple[str, Expression]] = []
    for name, value in record.values.items():
        if isinstance(value, Record):
            found += leaves(value, f"{path}{name}.")
        else:
            found.append((f"{path}{name}", value))
    return found


def numbers_of(record: Any) -> list[float]:
    """Every number of a record in order, those of records inside it in their place."""
    return [x for value in record for x in (numbers_of(value) if isinstance(value, tuple) else (float(value),))]


def record_like(like: Any, numbers: Iterator[float]) -> Any:
    """The record of the kind of ``like`` with these numbers: the opposite of :func:`numbers_of`."""
    parts = [record_like(value, numbers) if isinstance(value, tuple) else next(numbers) for value in like]
    return type(like)(*parts) if hasattr(like, "_fields") else tuple(parts)


def zero_record(kind: Any) -> Any:
    """A record of a NamedTuple class with zeros for its numbers. Fields that are records are found by their
    annotation."""
    hints = typing.get_type_hints(kind)
    return kind(*(_zero(hints[name]) for name in kind._fields))


def _zero(annotation: Any) -> Any:
    if typing.get_origin(annotation) is tuple:
        return tuple(_zero(one) for one in typing.get_args(annotation))
    return zero_record(annotation) if hasattr(annotation, "_fields") else 0.0
