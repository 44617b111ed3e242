"""Reads one TOML table field by field and collects every fault instead of stopping at the first. Quantities are written
as an engineer writes them: ``"11.6 mH"``, ``"5 kVA"``, ``0.0116``. A bare number is SI.
"""

from __future__ import annotations

import itertools
import math
import re
from decimal import Decimal
from typing import Any, NamedTuple

from vsgdesign.errors import Fault, VsgDesignError, did_you_mean

_PREFIXES = {"": 0, "p": -12, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "k": 3, "M": 6, "G": 9}
"""Decimal exponents: scaled as decimals, "50 uF" is the float nearest to 5e-5, not 50 times that of 1e-6."""

_DIMENSIONS: dict[str, dict[str, float]] = {
    "V": {"V": 1.0},
    "A": {"A": 1.0},
    "W": {"W": 1.0},
    "VA": {"VA": 1.0},
    "var": {"var": 1.0, "VAr": 1.0, "VAR": 1.0},
    "Hz": {"Hz": 1.0},
    "s": {"s": 1.0},
    "H": {"H": 1.0},
    "F": {"F": 1.0},
    "ohm": {"ohm": 1.0, "Ohm": 1.0, "\u03a9": 1.0, "\u2126": 1.0},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0},
    "1": {"": 1.0, "pu": 1.0, "%": 0.01, "pct": 0.01},
}
_UNPREFIXED = {"deg", "°", "", "pu", "%", "pct"}

_NUMBER = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$")


class UnitError(VsgDesignError):
    """A quantity's text cannot be read in the unit that the field asks for."""


def _unit_scale(unit: str, dimension: str) -> tuple[int, float]:
    """Decimal exponent and factor from ``unit`` to the SI unit of ``dimension``."""
    bases = _DIMENSIONS.get(dimension)
    if bases is None:  # a compound SI unit such as "rad/(s²·W)": only itself, unscaled
        if unit == dimension:
            return 0, 1.0
        raise UnitError(f"expected a plain number in {dimension}")
    for base, factor in bases.items():
        if unit == base:
            return 0, factor
        if base not in _UNPREFIXED and unit.endswith(base) and unit[: -len(base)] in _PREFIXES:
            return _PREFIXES[unit[: -len(base)]], factor
    raise UnitError(f"expected {_examples(dimension)}")


def parse_quantity(value: object, dimension: str) -> float:
    """A TOML value as a float in SI. ``dimension`` is the SI unit ("H", "VA", …) or "1" for a ratio.

    Raises UnitError with the reason: not a number, a unit of another dimension, NaN or infinite.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise UnitError(f"expected {_examples(dimension)}")
    try:
        if isinstance(value, str):
            match = _NUMBER.match(value)
            if match is None:
                raise UnitError(f"not a number with a unit; expected {_examples(dimension)}")
            exponent, factor = _unit_scale(match.group(2), dimension) if match.group(2) else (0, 1.0)
            number = float(Decimal(match.group(1)).scaleb(exponent)) * factor
        else:
            number = float(value)
    except ArithmeticError:  # beyond the range of float, or of Decimal
        number = math.inf
    if not math.isfinite(number):
        raise UnitError("must be a finite number")
    return number


def same_quantity(a: object, b: object) -> bool:
    """Whether two TOML values say the same quantity, as "8 kW" and 8000 do."""

    def in_si(value: object, dimension: str) -> float:
        try:
            return parse_quantity(value, dimension)
        except UnitError:
            return math.nan

    return any(in_si(a, dimension) == in_si(b, dimension) for dimension in _DIMENSIONS)


def _examples(dimension: str) -> str:
    if dimension == "1":
        return 'a ratio such as 0.05 or "5 %"'
    if dimension == "rad":
        return 'an angle such as "30 deg" or 0.52 (rad)'
    prefixed = {"H": "mH", "F": "uF", "s": "ms", "VA": "kVA", "W": "kW", "var": "kvar", "Hz": "kHz", "ohm": "mohm"}
    unit = prefixed.get(dimension, dimension)
    return f'a number in {dimension} or a text such as "1.5 {unit}"'


def format_quantity(value: float, dimension: str) -> str:
    """A value for messages, in engineering notation: ``0.0116, "H"`` gives ``11.6 mH``."""
    if dimension == "1" or value == 0.0 or not math.isfinite(value):
        return f"{value:.6g}" if dimension == "1" else f"{value:.6g} {dimension}"
    if dimension == "rad" or dimension not in _DIMENSIONS:
        return f"{value:.6g} {dimension}"
    exponent = min(max(3 * math.floor(math.log10(abs(value)) / 3), -12), 9)
    prefix = {-12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}[exponent]
    return f"{value / 10.0**exponent:.6g} {prefix}{dimension}"


REQUIRED = object()
"""Default of a field that must be given."""

_DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(10))}
"""Names that Windows has for devices, in every folder and with every ending."""

MOST_VALUES = 1000
"""Values of a list: two of them span a map, which is held in memory."""

LONGEST_NAME = 100
"""Bytes of a name that becomes a part of file names, which may have 255."""


class Asked(NamedTuple):
    """A quantity that a reader asked for: its value and limits in SI, and whether the document gives it."""

    unit: str
    low: float
    high: float
    value: Any
    given: bool


class TableReader:
    """A view on one TOML table. Each ``take`` checks one field; ``finish`` reports the unknown ones.

    A faulty field yields its default, or NaN or an empty value, so that reading goes on and the remaining
    faults are found too; the caller raises once at the end if ``faults`` is not empty. ``asked`` collects by its
    full name every quantity that is read, with its limits.
    """

    def __init__(self, table: Any, path: str, faults: list[Fault], asked: dict[str, Asked] | None = None) -> None:
        self.path = path
        self.faults = faults
        self._asked: dict[str, Asked] = {} if asked is None else asked
        self._known: list[str] = []
        if isinstance(table, dict):
            self.table: dict[str, Any] = table
        else:
            self.table = {}
            if table is not None:
                self.fault("", table, "expected a table", f"Write it as [{path}] with one field a line.")

    def name(self, field: str) -> str:
        """Full dotted name of a field of this table, or with brackets that of a place in a list."""
        if field.isdigit():
            return f"{self.path}[{field}]"
        return f"{self.path}.{field}" if self.path and field else (field or self.path)

    def has(self, field: str) -> bool:
        """Whether the table gives this field."""
        return field in self.table

    def fault(self, field: str, value: object, problem: str, advice: str = "") -> None:
        """Record a fault of a field of this table."""
        written = str(value).lower() if isinstance(value, bool) else str(value)  # true, as in TOML
        shown = "" if value is None else (f'"{value}"' if isinstance(value, str) else written)
        self.faults.append(Fault(self.name(field), shown, problem, advice))

    def quantity(
        self,
        field: str,
        dimension: str,
        low: float = -math.inf,
        high: float = math.inf,
        default: Any = REQUIRED,
        hint: str = "",
        zero: str = "",
    ) -> Any:
        """A quantity in SI within [low, high]. ``zero``: what 0 stands for, where it is allowed beside them."""
        value = self._quantity(field, dimension, low, high, default, hint, zero)
        self._asked[self.name(field)] = Asked(dimension, low, high, value, self.has(field))
        return value

    def _quantity(self, field: str, dimension: str, low: float, high: float, default: Any, hint: str, zero: str) -> Any:
        asked = "a number"
        if dimension != "1":
            asked = f'a quantity in {dimension}; for example {field} = "… {dimension}"'
        raw = self._raw(field, default, asked)
        if raw is _MISSING:
            return math.nan if default is REQUIRED else default
        try:
            value = parse_quantity(raw, dimension)
        except UnitError as error:
            self.fault(field, raw, str(error))
            return math.nan
        # A limit is NaN where the field that it follows from is itself faulty: then it is no limit.
        low = -math.inf if math.isnan(low) else low
        high = math.inf if math.isnan(high) else high
        if not low <= value <= high and not (zero and value == 0.0):
            limits = f"outside {format_quantity(low, dimension)} to {format_quantity(high, dimension)}"
            if math.isinf(high):
                limits = f"below {format_quantity(low, dimension)}"
            as_read = f" (read as {format_quantity(value, dimension)})" if dimension != "1" else ""
            unit = "Give a value within these limits." if dimension == "1" else "Check the unit: a bare number is SI."
            advice = hint or (f"Or give 0: {zero}." if zero else unit)
            self.fault(field, raw, limits + as_read, advice)
            return math.nan
        return value

    def quantities(
        self, field: str, dimension: str, low: float, high: float, default: tuple[float, ...], increasing: bool = True
    ) -> tuple[float, ...]:
        """A non-empty list of quantities within [low, high], strictly increasing unless said otherwise."""
        self._known.append(field)
        if field not in self.table:
            return default
        raw = self.table[field]
        if not isinstance(raw, list) or not raw:
            self.fault(field, raw, "must be a list of at least one value", f"For example {field} = [1.5, 3, 10].")
            return default
        if len(raw) > MOST_VALUES:
            self.fault(field, None, f"has {len(raw)} values, more than {MOST_VALUES}", "Give fewer.")
            return default
        items = TableReader({str(k): item for k, item in enumerate(raw)}, self.name(field), self.faults)
        values = tuple(items.quantity(str(k), dimension, low, high) for k in range(len(raw)))
        # A faulty item is NaN, which has had its own fault.
        if increasing and any(b <= a for a, b in itertools.pairwise(values)):
            self.fault(field, raw, "must increase from each value to the next")
        return values

    def names(self, field: str, counts: tuple[int, ...], example: str) -> tuple[str, ...] | None:
        """A list of texts or whole numbers, as texts; None where there is none. ``counts``: how many there may be."""
        self._known.append(field)
        raw = self.table.get(field)
        if raw is None:
            return None
        items = raw if isinstance(raw, list) else [raw]
        good = all(isinstance(item, str | int) and not isinstance(item, bool) for item in items)
        if not good or len(items) not in counts:
            how_many = " or ".join(map(str, counts))
            self.fault(
                field, raw, f"must be a list of {how_many} names or numbers", f"For example {field} = {example}."
            )
            return None
        return tuple(str(item) for item in items)

    def texts(self, field: str, default: Any = REQUIRED) -> Any:
        """A list of any number of texts."""
        raw = self._raw(field, default, "a list of texts")
        if raw is _MISSING:
            return () if default is REQUIRED else default
        if not isinstance(raw, list) or not all(isinstance(item, str) for item in raw):
            self.fault(field, raw, "must be a list of texts")
            return ()
        return tuple(raw)

    def integer(self, field: str, low: int, high: int, default: Any = REQUIRED, zero: str = "") -> Any:
        """A whole number within [low, high]. ``zero``: what 0 stands for, where it is allowed beside them."""
        value = self._integer(field, low, high, default, zero)
        self._asked[self.name(field)] = Asked("1", low, high, value, self.has(field))
        return value

    def _integer(self, field: str, low: int, high: int, default: Any, zero: str) -> Any:
        raw = self._raw(field, default, f"a whole number from {low} to {high}")
        if raw is _MISSING:
            return low if default is REQUIRED else default
        whole = isinstance(raw, int) and not isinstance(raw, bool)
        if not whole or not (low <= raw <= high or (zero and raw == 0)):
            advice = f"Or give 0: {zero}." if zero else ""
            self.fault(field, raw, f"must be a whole number from {low} to {high}", advice)
            return low
        return raw

    def choice(self, field: str, allowed: tuple[str, ...], default: Any = REQUIRED) -> Any:
        """One of a few words."""
        raw = self._raw(field, default, "one of " + ", ".join(f'"{a}"' for a in allowed))
        if raw is _MISSING:
            return allowed[0] if default is REQUIRED else default
        if raw not in allowed:
            self.fault(field, raw, "must be one of " + ", ".join(f'"{a}"' for a in allowed))
            return allowed[0]
        return raw

    def flag(self, field: str, default: Any = REQUIRED) -> Any:
        """Yes or no."""
        raw = self._raw(field, default, "true or false")
        if raw is _MISSING:
            return False if default is REQUIRED else default
        if not isinstance(raw, bool):
            self.fault(field, raw, "must be true or false")
            return False
        return raw

    def text(self, field: str, default: Any = REQUIRED) -> Any:
        """A non-empty text."""
        raw = self._raw(field, default, "a text")
        if raw is _MISSING:
            return "" if default is REQUIRED else default
        if not isinstance(raw, str) or not raw.strip():
            self.fault(field, raw, "must be a non-empty text")
            return ""
        return raw

    def identifier(self, field: str, default: Any = REQUIRED) -> Any:
        """A text that can name a file on every system: letters, digits, '-', '_' and '.'."""
        name = self.text(field, default)
        if field in self.table and name and not all(c.isalnum() or c in "-_." for c in name):
            self.fault(field, name, "may hold letters, digits, '-', '_' and '.' only", "It becomes a file name.")
        elif field in self.table and name[:1] in ("-", "."):
            problem = "begins as an option does" if name[0] == "-" else "begins as a hidden file does"
            self.fault(field, name, problem, "It becomes a file name. Begin with a letter, a digit or '_'.")
        elif field in self.table and (name.endswith(".") or name.partition(".")[0].casefold() in _DEVICES):
            problem = "cannot be the name of a file on Windows"
            self.fault(field, name, problem, "It becomes a file name. Give another one.")
        elif field in self.table and len(name.encode()) > LONGEST_NAME:
            self.fault(
                field,
                f"{name[:20]}…",
                f"has {len(name.encode())} bytes, more than {LONGEST_NAME}",
                "It becomes a part of file names. Give a shorter one.",
            )
        return name

    def section(self, field: str) -> TableReader:
        """A nested table that must be there."""
        table = self.child(field)
        if table is None:
            self.fault(field, None, "missing table", f"Add a [{self.name(field)}] section.")
            return TableReader(None, self.name(field), [])  # its missing fields need no fault of their own
        return table

    def child(self, field: str) -> TableReader | None:
        """A nested table, or None where it is absent."""
        self._known.append(field)
        if not self.has(field):
            return None
        return TableReader(self.table[field], self.name(field), self.faults, self._asked)

    def child_or_word(self, field: str, word: str) -> TableReader | str | None:
        """A nested table, or the one word that may stand in its place, or None where the field is absent or faulty."""
        raw = self.table.get(field)
        if not self.has(field) or isinstance(raw, dict):
            return self.child(field)
        self._known.append(field)
        if raw == word:
            return word
        self.fault(field, raw, f'must be a table or the word "{word}"', f"For example {field} = {{ … }}")
        return None

    def children(self, field: str) -> list[TableReader]:
        """A list of tables ([[field]] in TOML); empty where absent."""
        self._known.append(field)
        raw = self.table.get(field, [])
        if not isinstance(raw, list):
            self.fault(field, raw, "expected a list of tables", f"Write each as [[{self.name(field)}]].")
            return []
        name = self.name(field)
        return [TableReader(item, f"{name}[{k}]", self.faults, self._asked) for k, item in enumerate(raw)]

    def one_of(self, *groups: tuple[str, ...]) -> tuple[str, ...] | None:
        """Exactly one group of fields that belong together must be given whole; which one, or None."""
        used = [group for group in groups if any(self.has(field) for field in group)]
        options = " or ".join(" with ".join(group) for group in groups)
        if len(used) != 1:
            given = ", ".join(field for group in used for field in group if self.has(field))
            self.fault("", None, f"give either {options}" + (f", not both ({given})" if used else ""))
            for group in groups:
                self._known.extend(group)
            return None
        for group in groups:
            if group is not used[0]:
                self._known.extend(group)
        return used[0]

    def skip(self, *fields: str) -> None:
        """Fields that are read elsewhere, or whose fault has been told already."""
        self._known.extend(fields)

    def finish(self) -> None:
        """Report every field that nothing asked for, with the nearest known name."""
        for field in self.table:
            if field not in self._known:
                known = "Known here: " + ", ".join(sorted(set(self._known)))
                self.fault(field, None, "unknown field", did_you_mean(field, self._known, known, 0.5))

    def _raw(self, field: str, default: object, expected: str) -> Any:
        self._known.append(field)
        if field in self.table:
            return self.table[field]
        if default is REQUIRED:
            self.fault(field, None, "missing", f"Give {expected}.")
        return _MISSING


_MISSING = object()
