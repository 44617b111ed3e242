"""Fields of a study as data: name, unit, limits, default and meaning of each stand once.

A class describes a table by the specifiers below (``number``, ``whole``, ``word``, …), which stand where its attributes
have their defaults. The first paragraph of an attribute's docstring is its meaning, as the page [study file] has it. A
:func:`section` is the record as well; where the record lies in another room, or needs more than the fields, a plain
class has the fields alone. :func:`read` makes the record of a table, and :func:`document` writes it back.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import itertools
import math
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar, dataclass_transform

from vsgdesign.study.parameters.ranges import KINDS, Spread, one_of
from vsgdesign.study.parameters.reader import REQUIRED, TableReader

SEEDS = 2**31 - 1
"""Largest seed."""


@dataclass(frozen=True)
class Times:
    """A factor times a quantity of the study by its name: a limit, a default or a unit that follows from it."""

    factor: float
    of: str

    def __rmul__(self, factor: float) -> Times:
        return Times(factor * self.factor, self.of)


S_RATED, V_RATED, F_N, T_S = Times(1.0, "S_rated"), Times(1.0, "V_rated"), Times(1.0, "f_n"), Times(1.0, "T_s")
Z_BASE, L_BASE, C_BASE = Times(1.0, "Z_base"), Times(1.0, "Z_base/ω_n"), Times(1.0, "1/(ω_n Z_base)")
V_MIN, V_MAX = Times(1.0, "`V_min_pu`"), Times(1.0, "`V_max_pu`")
DURATION, MOST_REFERENCE = Times(1.0, "`duration`"), Times(1.0, "`reference_limit_pu` S_rated")

T = TypeVar("T")
Limit = float | Times
Scope = Mapping[str, float]
"""What limits and defaults follow from, by the names above, in SI."""

Words = tuple[str, ...] | Callable[[], tuple[str, ...]]
"""A few words; a function where more can be registered later."""


@dataclass(frozen=True, kw_only=True)
class Field:
    """One field of a table of a study file."""

    kind: str
    """``number``, ``range`` (a number or [low, high]), ``spread``, ``numbers``, ``whole number``, ``whole range`` (of
    them), ``word``, ``true or false``, ``text``, ``texts`` (any number of them), ``name`` (of a file), ``names``,
    ``table`` or ``tables``."""
    name: str = ""
    attribute: str = ""
    """The attribute that it becomes."""
    unit: str = "1"
    """SI unit; "1" for a ratio."""
    low: Limit = -math.inf
    high: Limit = math.inf
    words: Words = ()
    default: Any = REQUIRED
    """In the unit of the document. REQUIRED beside ``shown``: it follows from other data; the reader is given it."""
    limits: str = ""
    """Limits in words, where they are no numbers."""
    shown: str = ""
    """Default in words, where it is no number."""
    scale: Limit = 1.0
    """Value of the attribute over that of the document."""
    true: str = ""
    """The word that makes the attribute true."""
    logarithmic: bool = False
    """Whether the logarithm of a range is what is drawn uniformly, as long as it begins above zero."""
    increasing: bool = True
    """Whether a list must increase."""
    hint: str = ""
    """What to do with a value beyond the limits."""
    zero: str = ""
    """What 0 stands for, where it is allowed beside the limits."""
    counts: tuple[int, ...] = ()
    example: str = ""
    """Of a list of names: how many there may be, and what it may look like."""
    of: Any = ()
    """The fields of a table, the class that has them, or a function where more can be registered later."""
    instead: str = ""
    """A word that may stand in the place of a table."""
    home: type | None = None
    """The class that has it as an attribute."""
    explained: str = ""
    """The meaning of a field that is no attribute of a class."""

    @property
    def required(self) -> bool:
        """Whether a study has to give it, or another field in its place."""
        return self.default is REQUIRED and (not self.shown or self.shown.startswith("required"))

    @property
    def choices(self) -> tuple[str, ...]:
        """The words as they are now."""
        return self.words() if callable(self.words) else self.words

    @property
    def meaning(self) -> str:
        """The first paragraph of the attribute's docstring; empty without one."""
        return self.explained if self.home is None else _meanings(self.home).get(self.attribute, "")

    @property
    def fields(self) -> tuple[Field, ...]:
        """The fields of a table."""
        return fields_of(self.of if isinstance(self.of, tuple | type) else self.of())


_KEY = "field of a study"


def _specifier(one: Field) -> Any:
    given = one.default
    if given is REQUIRED or isinstance(given, Times):
        return dataclasses.field(metadata={_KEY: one})
    if isinstance(given, int | float) and not isinstance(given, bool) and isinstance(one.scale, float):
        given = given if one.scale == 1.0 else one.scale * given
    return dataclasses.field(default=given == one.true if one.true else given, metadata={_KEY: one})


def number(unit: str, low: Limit, high: Limit, *, default: Any = REQUIRED, **more: Any) -> Any:
    """A quantity in SI within its limits. ``more``: further attributes of :class:`Field`, here and below."""
    return _specifier(Field(kind="number", unit=unit, low=low, high=high, default=default, **more))


def drawn(unit: str, low: Limit, high: Limit, *, default: Any = REQUIRED, **more: Any) -> Any:
    """A quantity, or a range [low, high] out of which a seed draws."""
    return _specifier(Field(kind="range", unit=unit, low=low, high=high, default=default, **more))


def spread(unit: str, low: Limit, high: Limit, *, default: Any = REQUIRED, **more: Any) -> Any:
    """A :class:`vsgdesign.study.parameters.ranges.Spread`: what a quantity is drawn from, of values within limits."""
    return _specifier(Field(kind="spread", unit=unit, low=low, high=high, default=default, **more))


def numbers(unit: str, low: Limit, high: Limit, *, default: Any = REQUIRED, **more: Any) -> Any:
    """A list of quantities that increase."""
    return _specifier(Field(kind="numbers", unit=unit, low=low, high=high, default=default, **more))


def whole(low: int, high: int, *, default: Any = REQUIRED, **more: Any) -> Any:
    """A whole number."""
    return _specifier(Field(kind="whole number", low=low, high=high, default=default, **more))


def whole_range(low: int, high: int, *, default: Any = REQUIRED, **more: Any) -> Any:
    """A whole number, or a range [low, high] of them."""
    return _specifier(Field(kind="whole range", low=low, high=high, default=default, **more))


def word(words: Words, *, default: Any = REQUIRED, **more: Any) -> Any:
    """One of a few words."""
    return _specifier(Field(kind="word", words=words, default=default, **more))


def flag(*, default: Any = REQUIRED, **more: Any) -> Any:
    """Yes or no."""
    return _specifier(Field(kind="true or false", default=default, **more))


def text(*, default: Any = REQUIRED, kind: str = "text", **more: Any) -> Any:
    """A text. ``kind``: ``name`` for one that becomes a part of file names."""
    return _specifier(Field(kind=kind, default=default, **more))


def texts(*, default: Any = REQUIRED, **more: Any) -> Any:
    """A list of any number of texts."""
    return _specifier(Field(kind="texts", default=default, **more))


def names(counts: tuple[int, ...], example: str, *, default: Any = REQUIRED, **more: Any) -> Any:
    """A list of texts. ``counts``: how many there may be; ``example``: of such a list, for messages."""
    return _specifier(Field(kind="names", counts=counts, example=example, default=default, **more))


def subtable(of: Any, *, kind: str = "table", default: Any = None, **more: Any) -> Any:
    """A table with the fields of ``of``. ``kind``: ``tables`` for a list of them."""
    return _specifier(Field(kind=kind, of=of, default=default, **more))


@dataclass_transform(
    kw_only_default=True,
    frozen_default=True,
    field_specifiers=(
        dataclasses.field,
        number,
        drawn,
        spread,
        numbers,
        whole,
        word,
        flag,
        text,
        texts,
        names,
        subtable,
    ),
)
def section(cls: type[T]) -> type[T]:
    """A frozen dataclass whose attributes are given by name and may be fields of a study."""
    return dataclass(frozen=True, kw_only=True)(cls)


def fields_of(of: Any) -> tuple[Field, ...]:
    """The fields of a class in their order; fields as they are."""
    return of if isinstance(of, tuple) else _fields_of(of)


@functools.cache
def _fields_of(of: type) -> tuple[Field, ...]:
    if dataclasses.is_dataclass(of):
        all_of_it = {one.name: one for one in dataclasses.fields(of)}
    else:
        all_of_it = {name: one for name, one in vars(of).items() if isinstance(one, dataclasses.Field)}
    found = {name: one.metadata[_KEY] for name, one in all_of_it.items() if _KEY in one.metadata}
    return tuple(replace(one, name=one.name or name, attribute=name, home=of) for name, one in found.items())


@functools.cache
def _meanings(of: type) -> dict[str, str]:
    """The first paragraph of each attribute's docstring, out of the source, as Python does not keep them."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(of))).body[0]
    found = {}
    for one, after in itertools.pairwise(tree.body if isinstance(tree, ast.ClassDef) else []):
        if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name) and isinstance(after, ast.Expr):
            text = after.value.value if isinstance(after.value, ast.Constant) else ""
            found[one.target.id] = " ".join(str(text).partition("\n\n")[0].split())
    return found


def picked(of: Any, *names: str) -> tuple[Field, ...]:
    """Some of the fields, by their names in a study, in this order."""
    known = {one.name: one for one in fields_of(of)}
    return tuple(known[name] for name in names)


def with_defaults(fields: tuple[Field, ...], defaults: Mapping[str, Any]) -> tuple[Field, ...]:
    """Fields with the defaults of a record of another room, by their names."""
    return tuple(replace(one, default=defaults[one.name]) for one in fields)


def inserted(fields: tuple[Field, ...], after: str, *more: Field) -> tuple[Field, ...]:
    """Fields with others after one of them."""
    k = [one.name for one in fields].index(after) + 1
    return (*fields[:k], *more, *fields[k:])


def at(limit: Limit, scope: Scope) -> float:
    """A limit in SI."""
    return limit.factor * scope[limit.of] if isinstance(limit, Times) else limit


def take(table: TableReader, one: Field, scope: Scope, default: Any) -> Any:
    """The value of a field, as a table gives it, in the unit of the document; its faults are collected there."""
    low, high = at(one.low, scope), at(one.high, scope)
    if one.kind == "number":
        return table.quantity(one.name, one.unit, low, high, default, one.hint, one.zero)
    if one.kind in ("range", "spread"):
        return (_range if one.kind == "range" else _spread)(table, one, low, high, default)
    if one.kind == "numbers":
        return table.quantities(one.name, one.unit, low, high, default, one.increasing)
    if one.kind == "whole number":
        return table.integer(one.name, int(low), int(high), default, one.zero)
    if one.kind == "whole range":
        return _whole_range(table, one, int(low), int(high), default)
    if one.kind == "word":
        return table.choice(one.name, one.choices, default=default)
    if one.kind == "true or false":
        return table.flag(one.name, default=default)
    if one.kind == "name":
        return table.identifier(one.name, default=default)
    if one.kind == "text":
        return table.text(one.name, default=default)
    if one.kind == "texts":
        return table.texts(one.name, default=default)
    if one.kind == "names":
        return table.names(one.name, one.counts, one.example)
    child = table.child(one.name)
    return default if child is None else read(one.of, child, scope)


def _range(table: TableReader, one: Field, low: float, high: float, default: Any) -> Any:
    """Two ends; the same twice for a number."""
    if not isinstance(table.table.get(one.name), list):
        value = table.quantity(one.name, one.unit, low, high, default=None)
        return default if value is None else (value, value)
    raw = table.table[one.name]
    faulty = (math.nan, math.nan) if default is None else default
    ends = table.quantities(one.name, one.unit, low, high, faulty, increasing=False)
    if len(ends) == 2 and not ends[0] > ends[1]:
        return ends
    problem, advice = "a range has two ends", f"For example {one.name} = [low, high]."
    if len(ends) == 2:
        problem, advice = "the range is reversed", "Give the lower end first."
    table.fault(one.name, raw, problem, advice)
    return faulty


def _spread(table: TableReader, one: Field, low: float, high: float, default: Any) -> Any:
    """A number, or a table with one of the kinds of a spread."""
    given = table.table.get(one.name)
    if not isinstance(given, dict):
        value = table.quantity(one.name, one.unit, low, high, default, one.hint)
        return one_of(value) if isinstance(value, float) else value
    inner, kind = TableReader(given, table.name(one.name), table.faults), next(iter(given), "")
    table.skip(one.name)
    if len(given) != 1 or kind not in KINDS or not isinstance(given[kind], list):
        table.fault(one.name, given, f"expected a number or {{ {' | '.join(KINDS)} = [...] }}")
        return default
    if kind == "one_of":
        return Spread(kind, inner.quantities(kind, one.unit, low, high, (math.nan,), increasing=False))
    ends = _range(inner, replace(one, name=kind), low, high, None)
    if kind == "log_uniform" and ends[0] <= 0.0:
        inner.fault(kind, given[kind], "a logarithmic range must be positive")
    return Spread(kind, ends)


def _whole_range(table: TableReader, one: Field, low: int, high: int, default: Any) -> Any:
    """Two whole numbers; the same twice for one."""
    given = table.table.get(one.name)
    if not isinstance(given, list):
        value = table.integer(one.name, low, high, default=default)
        return value if isinstance(value, tuple) or value is None else (value, value)
    table.skip(one.name)
    whole_numbers = [end for end in given if isinstance(end, int) and not isinstance(end, bool)]
    if len(given) == 2 and len(whole_numbers) == 2 and low <= given[0] <= given[1] <= high:
        return given[0], given[1]
    problem = f"must be two whole numbers from {low} to {high} that increase"
    table.fault(one.name, given, problem, f"For example {one.name} = [{low}, {min(4, high)}].")
    return low, low


def values(
    of: Any, table: TableReader | None, scope: Scope | None = None, defaults: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """What a table gives for the fields of a dataclass (or for some fields), by attribute and as the attribute has it.

    Without a table it is what an empty one would give. ``defaults``: by name, where they are others than those of the
    fields.
    """
    scope, found = scope or {}, {}
    for one in fields_of(of):
        default = (defaults or {}).get(one.name, one.default)
        default = at(default, scope) if isinstance(default, Times) else default
        value = default if table is None else take(table, one, scope, default)
        found[one.attribute] = _as_attribute(one, value, scope)
    return found


def _as_attribute(one: Field, value: Any, scope: Scope) -> Any:
    if one.true:
        return value == one.true
    if value is None or one.scale == 1.0:
        return value
    scale = at(one.scale, scope)
    return tuple(item * scale for item in value) if isinstance(value, tuple) else value * scale


def read(
    of: type[T],
    table: TableReader | None,
    scope: Scope | None = None,
    defaults: Mapping[str, Any] | None = None,
    **known: Any,
) -> T:
    """The record of a table, or of its defaults; unknown fields of the table are faults. ``known``: attributes that are
    not read."""
    some = tuple(one for one in fields_of(of) if one.attribute not in known)
    found = of(**values(some, table, scope, defaults), **known)
    if table is not None:
        table.finish()
    return found


def document(record: Any, *names: str) -> dict[str, Any]:
    """The fields of a record as a table that reads the same; only those of ``names`` if there are any.

    None stands for a field that is not given. Nothing may have a unit that follows from other data.
    """
    found = {}
    for one in fields_of(type(record)):
        value = getattr(record, one.attribute)
        if value is None or (names and one.name not in names):
            continue
        if one.true:
            value = one.true if value else next(word for word in one.choices if word != one.true)
        elif isinstance(one.scale, float) and one.scale != 1.0:
            value = value / one.scale
        elif dataclasses.is_dataclass(value):
            value = value.document() if isinstance(value, Spread) else document(value)
        found[one.name] = list(value) if isinstance(value, tuple) else value
    return found
