"""Read the file of a datasheet into rows by field: CSV with any separator, decimal sign and encoding of a spreadsheet,
or TOML. A converter of the package is read as a datasheet, too. A fault in one row does not hide the faults of the
others.
"""

from __future__ import annotations

import csv
import io
import math
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsgdesign.errors import Fault, StudyError, did_you_mean
from vsgdesign.study.datasheet.fields import BY_NAME, advice_for, chosen, find_field, is_unused, squeezed
from vsgdesign.study.datasheet.quantities import RATIO, Amount, AmountError, is_unit, other_prefix, read_amount
from vsgdesign.study.given_files import CASE_PREFIX, TOML_BYTES, parse_toml, read_given
from vsgdesign.study.parameters.loading import case_names, merged_document
from vsgdesign.study.parameters.reader import format_quantity

_HEADINGS = {
    "key": {
        "field",
        "parameter",
        "quantity",
        "name",
        "item",
        "property",
        "größe",
        "groesse",
        "grösse",
        "bezeichnung",
        "description",
        "characteristic",
        "key",
        "parametername",
    },
    "value": {"value", "wert", "rating", "data", "val", "nominal", "typ", "typical"},
    "unit": {"unit", "units", "einheit", "einheiten", "dim"},
}
_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars"}


@dataclass(frozen=True)
class Entry:
    """One row of a datasheet."""

    key: str
    value: Any
    """A text; from TOML also a number, a truth value or a list."""
    unit: str = ""
    """From a column of units, or in brackets after the key."""
    place: str = ""


@dataclass(frozen=True)
class Sheet:
    """All rows of a datasheet, as written."""

    source: str
    entries: tuple[Entry, ...]
    decimal_comma: bool = False
    """Whether the file writes 1,5 for one and a half."""
    remarks: tuple[str, ...] = ()
    """How the file was read, if that was not obvious."""


_OF_A_STUDY = {"base", "controllers", "simulation", "power_loops", "inner_loops"}
"""Sections of a study, of which no datasheet has one."""
_OF_A_CASE = ("converter", "filter")
"""Sections of a case that a datasheet would have."""


def read_sheet(path: str | Path) -> Sheet:
    """Read the rows of a .csv or .toml file, or those of ``"case:NAME"``, a converter that comes with the package.
    Raises StudyError if it is none of them."""
    if str(path).startswith(CASE_PREFIX):
        return _sheet_of_case(str(path))
    path = Path(path)

    def fault(problem: str, advice: str) -> StudyError:
        return StudyError(str(path), [Fault("datasheet", f'"{path}"', problem, advice)])

    advice = "Give a .csv file with one field a row (name, value, unit), or a .toml file."
    try:
        if path.is_dir():
            raise fault("is a folder, not a datasheet", advice)
        raw = read_given(path, TOML_BYTES)
    except FileNotFoundError:
        raise fault("there is no such file", advice) from None
    except (OSError, ValueError) as error:
        raise fault(f"cannot be read: {getattr(error, 'strerror', None) or error}", advice) from None
    if raw[:4] == b"PK\x03\x04":
        raise fault("is a spreadsheet or another archive", 'Save it as "CSV UTF-8" and give that file.')
    text, remark = _decoded(raw)
    if text is None:
        raise fault("is not text", advice)
    if not text.strip():
        raise fault("is empty", advice)
    if path.suffix.casefold() == ".toml":
        table = parse_toml(text, str(path))
        if _OF_A_STUDY & table.keys():
            raise fault("is a study, not a datasheet", f"Run it: vsgdesign run {shlex.quote(str(path))}.")
        return Sheet(str(path), tuple(_rows_of_table(table, "")), remarks=remark)
    return _read_csv(text, str(path), remark)


def _sheet_of_case(name: str) -> Sheet:
    """The converter and the filter of a case as far as a datasheet has rows for them, and where they are from. Its
    loops are left to be designed."""
    known = [CASE_PREFIX + one for one in case_names()]
    if name not in known:
        advice = did_you_mean(name, known, f"Known are {', '.join(known)}.")
        raise StudyError(name, [Fault("datasheet", f'"{name}"', "no such converter comes with the package", advice)])
    case = merged_document({"base": name}, source=name)
    rows = {section: case[section] for section in _OF_A_CASE}
    rows |= {"capacitor_connection": "star", "source": case["study"]["source"]}
    return Sheet(name, tuple(entry for entry in _rows_of_table(rows, "") if find_field(entry.key)))


def _decoded(raw: bytes) -> tuple[str | None, tuple[str, ...]]:
    """The text, or None if the file is not text, and what was assumed about its encoding."""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        try:
            return raw.decode("utf-16"), ()
        except UnicodeDecodeError:
            return None, ()
    if b"\0" in raw:
        return None, ()
    try:
        return raw.decode("utf-8-sig"), ()
    except UnicodeDecodeError:
        pass
    try:
        text = raw.decode("cp1252")
    except UnicodeDecodeError:
        return None, ()
    printable = sum(character.isprintable() or character in "\r\n\t" for character in text)
    if printable < 0.98 * len(text):
        return None, ()
    return text, ("the file is not UTF-8 and was read as Windows-1252",)


def _rows_of_table(table: dict[str, Any], above: str) -> Iterator[Entry]:
    for key, value in table.items():
        name = f"{above}.{key}" if above else key
        if isinstance(value, dict):
            rest = value
            if "value" in value and not isinstance(value["value"], dict):  # L_1 = { value = 0.25, unit = "mH" }
                yield Entry(name, value["value"], str(value.get("unit", "")), name)
                rest = {field: item for field, item in value.items() if field not in ("value", "unit")}
            yield from _rows_of_table(rest, name)
        else:
            yield Entry(name, value, "", name)


def _read_csv(text: str, source: str, remarks: tuple[str, ...]) -> Sheet:
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    separator = _separator(lines)
    if separator is None:
        raise StudyError(
            source,
            [
                Fault(
                    "datasheet",
                    f'"{source}"',
                    "no line has two columns",
                    "Write one field a line: name, value, unit, with commas, semicolons or tabs between them.",
                )
            ],
        )
    rows: list[tuple[int, list[str]]] = []
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells) and not cells[0].startswith("#"):
                rows.append((reader.line_num, cells))
    except csv.Error as error:
        raise StudyError(source, [Fault("datasheet", f"line {reader.line_num}", f"cannot be read ({error})")]) from None
    rows = _turned(rows)
    key, value, unit, body = _columns(rows)
    faults: list[Fault] = []
    entries: list[Entry] = []
    for number, cells in body:
        cells = cells + [""] * (max(key, value, unit) + 1 - len(cells))
        name, written, written_unit = cells[key], cells[value], cells[unit] if unit >= 0 else ""
        if unit < 0 and len(cells) > value + 1:
            written_unit = cells[value + 1]
            if separator == "," and re.fullmatch(r"[-+]?\d+", written) and re.match(r"\d", written_unit):
                faults.append(
                    Fault(
                        name,
                        f'"{written},{written_unit}"',
                        f"line {number} has a comma between columns and in a number",
                        'Put the value in quotes, "' + f'{written},{written_unit}", or use semicolons between columns.',
                    )
                )
                continue
            if not is_unit(written_unit):
                written_unit = ""  # a column of remarks
        if not written or written in ("-", "–", "—", "n/a", "N/A", "?"):
            continue  # a heading, or a row that is not filled in
        bracket = re.search(r"[(\[](.*?)[)\]]\s*$", name)
        if bracket and not written_unit and is_unit(bracket[1]):
            written_unit = bracket[1]
        entries.append(Entry(name, written, written_unit, f"line {number}"))
    if faults:
        raise StudyError(source, faults)
    comma = separator != "," and any(re.search(r"\d,\d{1,2}(?!\d)|\d,\d{4,}", str(entry.value)) for entry in entries)
    comma = comma or any(re.search(r"(?<!\d)0,\d", str(entry.value)) for entry in entries)
    return Sheet(source, tuple(entries), comma, remarks)


def _separator(lines: list[str]) -> str | None:
    """The separator of most lines. A comma may also be a decimal comma and is therefore tried last."""
    for separator in (";", "\t", "|", ","):
        if sum(separator in line for line in lines) > 0.5 * len(lines):
            return separator
    return next((separator for separator in _SEPARATORS if any(separator in line for line in lines)), None)


def _turned(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Turn a table with one converter per row, whose first row contains the names, into one name per row."""
    if len(rows) == 2 and len(rows[0][1]) > 3 and sum(find_field(cell) is not None for cell in rows[0][1]) > 2:
        values = rows[1][1] + [""] * len(rows[0][1])
        return [(rows[1][0], [name, value]) for name, value in zip(rows[0][1], values, strict=False)]
    return rows


def _columns(rows: list[tuple[int, list[str]]]) -> tuple[int, int, int, list[tuple[int, list[str]]]]:
    """The columns of names, values and units (−1: none), from the heading if there is one, and the rows below it."""
    first = [squeezed(cell) for cell in rows[0][1]] if rows else []
    found = {what: next((k for k, cell in enumerate(first) if cell in names), -1) for what, names in _HEADINGS.items()}
    if found["value"] >= 0 and (found["key"] >= 0 or found["value"] > 0):
        return max(found["key"], 0), found["value"], found["unit"], rows[1:]
    if first and found["key"] == 0 and found["unit"] > 1:  # a heading that calls the values by the product's name
        return 0, 1, found["unit"], rows[1:]
    return 0, 1, -1, rows


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
            problem = f"is a list of {len(value)}" if isinstance(value, list) else "is not a value"
            asked = "one value, or both ends of a range" if ranged else "one value"
            self.fault(name, problem, f"Give {asked}, for example {BY_NAME[name].example}.")
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
