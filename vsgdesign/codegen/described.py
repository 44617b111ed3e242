"""What each number of a record is: its name, unit, meaning and default, read from the record's own text.

The text below a field, or below several, says what they are. It names the unit at its end behind a comma, or is the
unit alone: ``Filtered active power, W.`` Without one a number has none, or is in per unit, which is written as 1.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from vsgdesign.codegen.comments import field_groups
from vsgdesign.codegen.expressions import COUNT, NUMBERS
from vsgdesign.codegen.records import Kinds, kind_of_field

_ONE = r"(?:1|V|A|W|Hz|H|F|S|s|Ω|VA|var|rad|pu|ticks|samples|cycles|windows)(?:²|³|⁴)?"
_UNIT = re.compile(rf"(?:{_ONE})(?:[·/]\(?{_ONE}(?:·{_ONE})*\)?)*(?: peak| rms| phase rms)?(?: \(rms\))?")


class DescribedNumber(NamedTuple):
    """A number of a record."""

    name: str
    """Its name, with those of the records in which it is: ``gains.K_ip``."""
    unit: str
    meaning: str
    whole: bool
    """Whether it is a whole number."""
    start: float | None
    """With which it begins; None where it must be given."""


def described_numbers(record: Any, first: Any = None, prefix: str = "") -> list[DescribedNumber]:
    """Every number of a NamedTuple, in its order, those of records in it included.

    ``first`` is the record with which it begins; without it the class's defaults are taken.
    """
    of = Kinds({} if first is None else {record: {name: type(value) for name, value in first._asdict().items()}})
    inner, defaults = dict(of.fields(record)), record._field_defaults
    found: list[DescribedNumber] = []
    for names, text in field_groups(record):
        meaning = " ".join(text.split()).rstrip(".")
        head, _, last = meaning.rpartition(", ")
        unit = last if _UNIT.fullmatch(last) else "1"
        for name in names:
            if inner[name] is not None:
                found += described_numbers(inner[name], getattr(first, name, None), f"{prefix}{name}.")
                continue
            if kind_of_field(record, name) == NUMBERS:
                continue
            whole = kind_of_field(record, name) == COUNT
            said = head if unit == last else meaning
            start = defaults.get(name) if first is None else getattr(first, name)
            start = None if start is None else float(start)
            found.append(DescribedNumber(f"{prefix}{name}", unit, said or _first(record), whole, start))
    return found


def _first(record: Any) -> str:
    """The first paragraph of a record's own text."""
    return " ".join((record.__doc__ or "").split("\n\n")[0].split()).rstrip(".")
