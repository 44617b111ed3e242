"""Reads one TOML table field by field and collects every fault instead of stopping at the first."""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

from vsgdesign.errors import Fault, did_you_mean
from vsgdesign.study.parameters.units import UnitError, format_quantity, parse_quantity

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
