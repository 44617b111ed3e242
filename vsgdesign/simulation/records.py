"""Records (NamedTuples of numbers and of other records) as rows of numbers, and back."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args, get_origin, get_type_hints


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
    hints = get_type_hints(kind)
    return kind(*(_zero(hints[name]) for name in kind._fields))


def _zero(annotation: Any) -> Any:
    if get_origin(annotation) is tuple:
        return tuple(_zero(one) for one in get_args(annotation))
    return zero_record(annotation) if hasattr(annotation, "_fields") else 0.0
