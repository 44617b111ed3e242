"""The rows of a datasheet by field. A fault in one row does not hide the faults of the others."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from vsgdesign.errors import Fault
from vsgdesign.study.datasheet.fields import BY_NAME, advice_for, chosen, find_field, is_unused
from vsgdesign.study.datasheet.quantities import RATIO, Amount, AmountError, other_prefix, read_amount
from vsgdesign.study.datasheet.reading import Entry, Sheet
from vsgdesign.study.parameters.units import format_quantity

LIMITS = {
    "rating": (100.0, 100e6),
    "voltage": (30.0, 50e3),
    "frequency": (10.0, 1000.0),
    "dc_link": (10.0, 200e3),
    "dc_power": (0.5, 20.0),
    "dc_charge_power": (0.0, 20.0),
    "dc_capacitor": (5e-5, 100.0),
    "dc_energy": (0.01, 1e6),
    "carrier": (300.0, 1e6),
    "power_factor": (0.1, 1.0),
    "inductor_x_over_r": (3.0, 1000.0),
    "current_limit": (0.8, 5.0),
    "L_1": (0.005, 0.8),
    "L_2": (0.001, 0.8),
    "transformer": (0.005, 0.3),
    "C": (0.002, 1.0),
    "R_1": (0.0, 0.1),
    "R_2": (0.0, 0.1),
    "R_c": (0.0, 1.0),
    "scr": (0.5, 1000.0),
    "x_over_r": (0.05, 100.0),
}
"""Plausibility limits in SI; those of the filter and the current are in per unit, and
so are those of the dc side: of the rating, and of what stores it for a second."""

_ANY_CONVERTER = {"H": (1e-7, 0.5), "F": (1e-8, 0.1), "ohm": (0.0, 100.0)}
"""Limits of the filter as long as rating, voltage or frequency are not known."""


@dataclass(frozen=True)
class Assumption:
    """A value that the datasheet does not give and that was assumed."""

    field: str
    text: str


class Rows:
    """The fields of a datasheet, with the faults and assumptions so far. A faulty field is NaN."""

    def __init__(self, sheet: Sheet) -> None:
        self.sheet = sheet
        self.faults: list[Fault] = []
        self.assumptions = [Assumption("file", remark) for remark in sheet.remarks]
        self.remarks: dict[str, str] = {}
        self.unused: list[str] = []
        self.given: dict[str, Entry] = {}
        self.beside: dict[str, str] = {}
        """What the name of a field says about its value: ``ll``, ``delta``, ``peak`` ..."""
        for entry in sheet.entries:
            self._sort_in(entry)

    def _sort_in(self, entry: Entry) -> None:
        found = find_field(entry.key)
        if found is None:
            if is_unused(entry.key):
                self.unused.append(entry.key)
            else:
                self.faults.append(Fault(_where(entry), "", "unknown field", advice_for(entry.key)))
            return
        name, word = found
        if name in self.given:
            other = self.given[name]
            self.faults.append(
                Fault(
                    _where(entry),
                    _shown(entry),
                    f"says {name} a second time, after {_where(other)} = {_shown(other)}",
                    "Keep one of them.",
                )
            )
            return
        self.given[name] = entry
        self.beside[name] = word

    def fault(self, name: str, problem: str, advice: str = "") -> None:
        """Record a fault of a field under the name that the user has given to it."""
        entry = self.given.get(name)
        if entry is None:
            self.faults.append(Fault(name, "", problem, advice))
            return
        called = f"{name} ({_where(entry)})" if entry.key != name or entry.place != entry.key else name
        self.faults.append(Fault(called, _shown(entry), problem, advice))

    def assume(self, name: str, text: str) -> None:
        """Record what was assumed for a field."""
        self.assumptions.append(Assumption(name, text))

    def amount(self, name: str, bases: tuple[str, ...], *, ranged: bool = False) -> Amount | None:
        """A field as a quantity; None if it is missing or faulty."""
        entry = self.given.get(name)
        if entry is None:
            if not BY_NAME[name].missing and name not in ("short_circuit_power", "grid_impedance"):
                self.fault(name, "missing", f"Give it, for example {name} = {BY_NAME[name].example}.")
            return None
        value = entry.value
        if ranged and isinstance(value, list) and len(value) in (1, 2) and not any(isinstance(v, bool) for v in value):
            value = " to ".join(str(item) for item in value)
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            self.fault(name, "is not a value", f"Write for example {BY_NAME[name].example}.")
            return None
        try:
            return read_amount(value, bases, unit=entry.unit, decimal_comma=self.sheet.decimal_comma, ranged=ranged)
        except AmountError as error:
            self.fault(name, error.problem, error.advice or f"Write for example {BY_NAME[name].example}.")
            return None

    def within(self, name: str, value: float, base: str, scale: float = 1.0) -> float:
        """The value if it lies within its limits, which are multiplied by ``scale``; otherwise NaN, with a fault."""
        known = not math.isnan(scale)
        low, high = (limit * scale for limit in LIMITS[name]) if known else _ANY_CONVERTER[base]
        if math.isnan(value) or low <= value <= high:
            return value
        per_unit = f", {value / scale:.4g} pu," if known and scale != 1.0 else ""
        limits = f"outside {format_quantity(low, base)} to {format_quantity(high, base)}"
        read = f"is {format_quantity(value, base)}{per_unit} and so " if base != RATIO else "is "
        self.fault(name, read + limits, other_prefix(value, base, low, high) if base != RATIO else "")
        return math.nan

    def plain(self, name: str, base: str, default: float, why: str = "") -> float:
        """A value that needs nothing but its unit."""
        amount = self.amount(name, (base,))
        if amount is None:
            if name not in self.given and why:
                self.assume(name, why)
            return default
        return self.within(name, amount.value, base)

    def word(self, name: str, known: dict[str, str]) -> str | None:
        """A field that is one of some words, as a study writes it; None if it is missing or faulty."""
        entry = self.given.get(name)
        if entry is None:
            return None
        found, advice = chosen(str(entry.value), known)
        if found is None:
            self.fault(name, "is not known", advice)
        return found

    def text(self, name: str) -> str:
        """A field with free text; empty if it is missing."""
        entry = self.given.get(name)
        return "" if entry is None else " ".join(str(entry.value).split())[:200]


def _where(entry: Entry) -> str:
    return entry.key if entry.place in ("", entry.key) else f"{entry.key}, {entry.place}"


def _shown(entry: Entry) -> str:
    text: Any = entry.value
    unit = f" {entry.unit}" if entry.unit else ""
    return f'"{text}{unit}"' if isinstance(text, str) else f"{text}{unit}"
