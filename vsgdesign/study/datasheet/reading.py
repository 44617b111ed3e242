"""Read the file of a datasheet: CSV with any separator, decimal sign and encoding of a spreadsheet, or TOML."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.datasheet.fields import find_field, squeezed
from vsgdesign.study.datasheet.quantities import is_unit
from vsgdesign.study.given_files import TOML_BYTES, read_given
from vsgdesign.study.parameters.toml_file import parse_toml

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


def read_sheet(path: str | Path) -> Sheet:
    """Read the rows of a .csv or .toml file. Raises StudyError if it is neither."""
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
        return Sheet(str(path), tuple(_rows_of_table(parse_toml(text, str(path)), "")), remarks=remark)
    return _read_csv(text, str(path), remark)


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
