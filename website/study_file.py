"""The rows of the page docs/study-file.md and of the stub of the facade: what a field of a study says in a line."""

from __future__ import annotations

import math

from vsgdesign.study.parameters.fields import Field, Limit, Times
from vsgdesign.study.parameters.reader import REQUIRED

HEADER = ("| field | unit | limits | default | meaning |", "| --- | --- | --- | --- | --- |")


def table_lines(fields: tuple[Field, ...]) -> list[str]:
    """A table of the page: a row for each field, with its meaning as the docstring has it."""
    return [*HEADER, *map(row, fields)]


def row(one: Field) -> str:
    """One field as a row of the page."""
    cells = (f"`{one.name}`", _kind(one), _limits(one), _default(one), _meaning(one.meaning))
    return "| " + " | ".join(cells).replace("|  |", "| |") + " |"


def _kind(one: Field) -> str:
    unit = "–" if one.unit == "1" else one.unit
    words = {
        "number": unit,
        "range": unit,
        "numbers": f"list of {unit}",
        "name": "text",
        "names": "list of texts",
        "whole range": "whole number",
        "tables": "list of tables",
    }
    return words.get(one.kind, one.kind)


def _limits(one: Field) -> str:
    if one.limits or one.words:
        return one.limits or " ".join(f"`{word}`" for word in one.choices)
    low, high = one.low, one.high
    if isinstance(low, Times) and isinstance(high, Times) and low.of == high.of:
        if low.factor == -high.factor:
            return f"±{_times(high)}"
        return f"{_number(low.factor)} to {_number(high.factor)} times {high.of}"
    if isinstance(low, float) and math.isinf(low):
        return ""
    return f"{_end(one, low)} to {_end(one, high)}"


def _end(one: Field, limit: Limit) -> str:
    return _times(limit) if isinstance(limit, Times) else _value(one, limit)


def _times(limit: Times) -> str:
    return limit.of if limit.factor == 1.0 else f"{_number(limit.factor)} {limit.of}"


def _default(one: Field) -> str:
    given = one.default
    if one.shown or given is REQUIRED or given is None:
        return one.shown or ("required" if given is REQUIRED else "none")
    if isinstance(given, Times):
        return _times(given)
    if isinstance(given, bool):
        return str(given).lower()
    if isinstance(given, str):
        return f"`{given}`"
    if not isinstance(given, tuple):
        return _value(one, given)
    first, last = (_value(one, end) for end in (given[0], given[-1]))
    if one.kind == "range":
        return f"{first} to {last}" + ("" if one.unit in ("1", "rad") else f" {one.unit}")
    return f"{len(given)} values, {first} … {last}"


def _value(one: Field, value: float) -> str:
    """A number in the unit of the field; an angle in multiples of π or in degrees where these are short."""
    if one.kind in ("whole number", "whole range"):
        return str(int(value))
    turns, degrees = value / math.pi, math.degrees(value)
    if one.unit == "rad" and value != 0.0 and turns == round(turns):
        return f"{_number(turns)}π".replace("1π", "π")
    if one.unit == "rad" and value != 0.0 and abs(degrees - round(degrees, 1)) < 1e-9:
        return f"{_number(round(degrees, 1))}°"
    return _number(value)


def _number(value: float) -> str:
    """In as few characters as it takes, with a minus sign."""
    digits, _, power = f"{abs(value):.11e}".partition("e")
    short = f"{digits.rstrip('0').rstrip('.')}e{int(power)}"
    plain = f"{abs(value):.12f}".rstrip("0").rstrip(".")
    tiny = 0.0 < abs(value) < 1e-3
    return ("−" if value < 0.0 else "") + (short if tiny or len(short) < len(plain) - 1 else plain)


def _meaning(text: str) -> str:
    """A docstring as the page has it: without a capital at its begin and a full stop at its end."""
    text = text.removesuffix(".")
    return text[:1].lower() + text[1:] if text[1:2].islower() or text.startswith("A ") else text


def argument_line(one: Field) -> str:
    """A field in a line: its meaning, unit, limits and default."""
    unit = "" if one.unit == "1" else f" in {one.unit}"
    limits = "" if one.words else f"{_limits(one)}{unit}".strip()
    facts = [fact for fact in (limits, f"default {_default(one)}".replace("default required", "required")) if fact]
    return f"{one.meaning.removesuffix('.')} ({'; '.join(facts)})."
