"""Reads COMTRADE, the files of fault recorders and relays (IEEE C37.111, IEC 60255-24): .cfg with .dat, or one .cff."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from vsgdesign.study.given_files import RECORD_BYTES, TABLE_BYTES, read_given
from vsgdesign.study.parameters.record_columns import Array, Columns, RecordError, says_volts, unfit_unit, volts_of

T = TypeVar("T")

_EXPORT = "Export the record again, or correct that line."
_NEUTRAL = "Choose voltages, phase to neutral."
_SKEW = 0.05
"""How far apart the instants of channels of one sample may be, in sampling intervals."""

_BETWEEN = {"AB", "BC", "CA", "RS", "ST", "TR", "UV", "VW", "WU", "L1L2", "L2L3", "L3L1", "L12", "L23", "L31"}
"""Names of the phase of a voltage between two phases."""

_PHASES = (("A", "B", "C"), ("L1", "L2", "L3"), ("R", "S", "T"), ("U", "V", "W"), ("1", "2", "3"))
"""Names of the three phases."""

_MISSING_ASCII = 99999.0
_BINARY = {"BINARY": "<i2", "BINARY32": "<i4", "FLOAT32": "<f4"}


class Channel(NamedTuple):
    """An analog channel as its .cfg describes it."""

    name: str
    phase: str
    unit: str
    a: float
    b: float
    skew_s: float
    low: float
    ratio: float | None
    """Primary over secondary of its transformer; None where the .cfg does not say it."""
    secondary: bool


class Header(NamedTuple):
    """What a .cfg says."""

    year: str
    channels: tuple[Channel, ...]
    status: int
    """Number of status channels."""
    rates: tuple[tuple[float, int], ...]
    """(samples in a second, last sample) of each part; the rate is 0 where the times of the samples count."""
    form: str
    """Of the samples: ASCII, BINARY, BINARY32 or FLOAT32."""
    tick_s: float
    """One unit of the times, s."""


def comtrade_files(path: str) -> tuple[str, ...]:
    """The files of a record, of which one is given: .cfg and .dat, or .cff alone. Raises RecordError."""
    place = Path(path)
    kind = place.suffix
    if kind.lower() == ".cff":
        return (path,)
    wanted = {".cfg": ".dat", ".dat": ".cfg"}[kind.lower()]
    wanted = wanted.upper() if kind.isupper() else wanted
    other = next(
        (one for one in map(place.with_suffix, (wanted, wanted.lower(), wanted.upper())) if one.exists()), None
    )
    if other is None:
        says = "describes its samples" if wanted.lower() == ".cfg" else "has its samples"
        problem = f'there is no "{place.with_suffix(wanted).name}" beside it, which {says}'
        raise RecordError(("file", problem, "Put both files of the record into one folder, with equal names."))
    return (path, str(other)) if kind.lower() == ".cfg" else (str(other), path)


def read_comtrade(path: str) -> Columns:
    """The analog channels of a record, in V of the primary side where the .cfg says a unit of voltages, with what it
    says of their transformers. Raises RecordError and OSError."""
    files = comtrade_files(path)
    if len(files) == 1:
        text, size, data = _parts_of_cff(read_given(files[0], RECORD_BYTES))
    else:
        text, size, data = read_given(files[0], TABLE_BYTES), None, read_given(files[1], RECORD_BYTES)
    header = _Lines(text).header()
    rate = _one_rate(header)
    rows = _ascii_rows(header, data) if header.form == "ASCII" else _binary_rows(header, data[:size])
    _check_numbers(rows, header)
    values, unfit, voltages = {}, {}, dict[str, str]()
    skews = [channel.skew_s for channel in header.channels if says_volts(channel.unit)] or [0.0]
    skew = max(skews) - min(skews)
    for k, channel in enumerate(header.channels):
        name = channel.name if channel.name and channel.name not in values else f"{channel.name}{k + 1}"
        fault, factor = _judged(channel, name)
        if says_volts(channel.unit) and not _is_between(channel):
            voltages[name] = channel.phase.upper()
            if fault is None and rate is not None and skew * rate > _SKEW:
                problem = f"its voltages are sampled up to {1e6 * skew:.4g} us apart (skew of the .cfg)"
                fault = problem, "Sample the record again, so that all voltages have the same instants."
        if fault is not None:
            unfit[name] = fault
        values[name] = factor * (channel.a * rows.values[k] + channel.b)
    times = None if rate is not None else header.tick_s * rows.times
    return Columns(values, rate, times, _of_phases(voltages), unfit)


def _judged(channel: Channel, name: str) -> tuple[tuple[str, str] | None, float]:
    """Why a channel is no voltage of a phase, or None; and V of the primary side for one of its unit."""
    volts = volts_of(channel.unit)
    if volts is None:
        return unfit_unit(name, channel.unit), 1.0
    if _is_between(channel):
        return (f'"{name}" is between two phases ("{channel.phase}")', _NEUTRAL), volts
    if not channel.secondary:
        return None, volts
    if channel.ratio is None:
        problem = f'"{name}" is of the secondary side, and its .cfg does not say the ratio of its transformer'
        return (problem, "Correct the fields primary and secondary of the channel in the .cfg."), volts
    return None, volts * channel.ratio


def _of_phases(voltages: dict[str, str]) -> tuple[str, ...]:
    """The three voltages of the phases a, b, c if each is there once, by its phase; else all of them."""
    for phases in _PHASES:
        found = [name for phase in phases for name in voltages if voltages[name] == phase]
        if [voltages[name] for name in found] == list(phases):
            return tuple(found)
    return tuple(voltages)


def _is_between(channel: Channel) -> bool:
    return re.sub(r"[^A-Z0-9]", "", channel.phase.upper()) in _BETWEEN


def _one_rate(header: Header) -> float | None:
    """The sampling rate; None where the times of the samples count. Raises RecordError for several."""
    rates = {rate for rate, _ in header.rates}
    if len(rates) == 1:
        return header.rates[0][0] or None
    first, parts = 1, []
    for rate, last in header.rates:
        parts.append(f"{rate:.6g} Hz (samples {first} to {last})")
        first = last + 1
    raise RecordError(
        ("file", f"it has several sampling rates: {', '.join(parts)}", "Export the part that you need at one rate.")
    )


class _Lines:
    """The lines of a .cfg, one after the other. Raises RecordError with the number of the line."""

    def __init__(self, text: bytes) -> None:
        try:
            decoded = text.decode("utf-8-sig")
        except UnicodeDecodeError:
            decoded = text.decode("latin-1")
        self._lines = decoded.replace("\x1a", "").splitlines()
        self._at = 0

    def header(self) -> Header:
        """All of it."""
        station = self._next("station, recorder and year", 2)
        year = station[2] if len(station) > 2 and station[2] else "1991"
        counts = self._next("the numbers of channels", 3)
        analog = self._value(counts[1].rstrip("Aa"), int, "a number of analog channels")
        status = self._value(counts[2].rstrip("Dd"), int, "a number of status channels")
        channels = tuple(self._channel() for _ in range(analog))
        for _ in range(status):
            self._next("a status channel", 2)
        self._next("the frequency of the grid", 1)
        (parts,) = self._next("the number of sampling rates", 1)[:1]
        rates = []
        for _ in range(max(self._value(parts, int, "a number of sampling rates"), 1)):
            rate, last = self._next("a sampling rate and its last sample", 2)[:2]
            rates.append((self._value(rate, float, "a sampling rate"), self._value(last, int, "a last sample")))
        stamps = [",".join(self._next(f"the time of the {what}", 1)) for what in ("first sample", "trigger")]
        (form,) = self._next("the form of the samples", 1)[:1]
        if form.upper() != "ASCII" and form.upper() not in _BINARY:
            self._wrong(f'"{form}" is no form of samples: ASCII, {", ".join(_BINARY)}')
        multiple = "1"
        if year != "1991" and self._at < len(self._lines):
            multiple = self._next("the multiple of the times", 1)[0] or "1"
        # Six digits after the second count microseconds, more of them nanoseconds.
        fine = any(len(stamp.rpartition(".")[2]) > 6 for stamp in stamps if "." in stamp)
        tick_s = (1e-9 if fine else 1e-6) * self._value(multiple, float, "a multiple of the times")
        return Header(year, channels, status, tuple(rates), form.upper(), tick_s)

    def _channel(self) -> Channel:
        cells = self._next("an analog channel", 10)
        a, b, skew, low, primary, secondary = (
            self._value(cell or default, float, f"a number ({what})")
            for cell, default, what in (
                (cells[5], "1", "a"),
                (cells[6], "0", "b"),
                (cells[7], "0", "skew"),
                (cells[8], "-inf", "min"),
                ((*cells, "", "", "")[10], "0", "primary"),
                ((*cells, "", "", "")[11], "0", "secondary"),
            )
        )
        if a == 0.0 or not math.isfinite(a + b):
            self._wrong(f"a = {a:g}, b = {b:g} scale no channel")
        side = cells[12].upper() if len(cells) > 12 else "P"
        ratio = primary / secondary if primary > 0.0 and secondary > 0.0 else None
        return Channel(cells[1], cells[2], cells[4], a, b, 1e-6 * skew, low, ratio, side == "S")

    def _next(self, what: str, least: int) -> list[str]:
        """The cells of the next line."""
        self._at += 1
        if self._at > len(self._lines):
            self._wrong(f"the .cfg ends, and {what} should follow")
        cells = [cell.strip() for cell in self._lines[self._at - 1].split(",")]
        if len(cells) < least:
            self._wrong(f"a line with {what} has {least} fields or more, and this one has {len(cells)}")
        return cells

    def _value(self, text: str, kind: Callable[[str], T], what: str) -> T:
        try:
            return kind(text)
        except ValueError:
            self._wrong(f'"{text[:40]}" is not {what}')

    def _wrong(self, problem: str) -> NoReturn:
        raise RecordError(("file", f"cannot be read as COMTRADE: line {self._at} of its .cfg: {problem}", _EXPORT))


class _Rows(NamedTuple):
    """The samples as they are counted, by channel: NaN where one is missing."""

    numbers: NDArray[np.int64]
    times: Array
    values: list[Array]


_MARK = re.compile(rb"^--- *file type: *([a-z]+)(?: +([a-z0-9]+))?(?: *: *([0-9]+))? *---[ \t]*\r?\n?", re.I | re.M)


def _parts_of_cff(data: bytes) -> tuple[bytes, int | None, bytes]:
    """The text of the .cfg, the number of bytes of the samples where it is said, and these."""
    text, begin = None, 0
    while (mark := _MARK.search(data, begin)) is not None:
        kind = mark.group(1).upper()
        after = _MARK.search(data, mark.end())
        if kind == b"CFG":
            text = data[mark.end() : after.start() if after else len(data)].rstrip(b"\r\n")
        elif kind == b"DAT" and text is not None:
            binary = (mark.group(2) or b"").upper() != b"ASCII"
            size = int(mark.group(3)) if mark.group(3) and binary else 0
            return text, size or None, data[mark.end() :] if binary or not after else data[mark.end() : after.start()]
        begin = mark.end()
    missing = "DAT" if text else "CFG"
    problem = f'cannot be read as COMTRADE: its part "--- file type: {missing} ---" is missing'
    raise RecordError(("file", problem, "Export the record again."))


def _ascii_rows(header: Header, data: bytes) -> _Rows:
    text = data.replace(b"\x1a", b"").decode("latin-1")
    lines = [line for line in text.splitlines() if line.strip()]
    width = 2 + len(header.channels)
    try:
        cells = np.loadtxt(lines, delimiter=",", converters=_cell, ndmin=2, encoding=None, usecols=range(width))
    except (ValueError, IndexError):
        bad = next((k for k, line in enumerate(lines) if not _numbers(line, width)), 0)
        problem = f"row {bad + 1} of its .dat is not {width + header.status} numbers"
        advice = "Export the record again, or correct the channels in its .cfg."
        raise RecordError(("file", f"cannot be read as COMTRADE: {problem}", advice)) from None
    if header.year != "1991":
        cells[:, 2:][cells[:, 2:] == _MISSING_ASCII] = np.nan
    numbers, times = cells[:, 0], cells[:, 1]
    if np.isnan(numbers).any():
        raise RecordError(("file", "rows of its .dat have no number", "Export the record again."))
    return _Rows(numbers.astype(np.int64), times, list(cells[:, 2:].T))


def _cell(text: str) -> float:
    return float(text) if text.strip() else math.nan


def _numbers(line: str, least: int) -> bool:
    cells = line.split(",")
    try:
        return len([_cell(cell) for cell in cells]) >= least
    except ValueError:
        return False


def _binary_rows(header: Header, data: bytes) -> _Rows:
    kind, words = _BINARY[header.form], math.ceil(header.status / 16)
    row = np.dtype([("n", "<u4"), ("t", "<u4"), ("v", kind, (len(header.channels),)), ("d", "<u2", (words,))])
    if len(data) % row.itemsize:
        problem = f"its samples have {len(data)} bytes, and each has {row.itemsize}"
        advice = "Copy the .dat again as a binary file, or correct the channels in its .cfg."
        raise RecordError(("file", f"cannot be read as COMTRADE: {problem}", advice))
    rows = np.frombuffer(data, dtype=row)
    values = []
    for k, channel in enumerate(header.channels):
        counted = rows["v"][:, k]
        found = counted.astype(np.float64)
        if header.form == "FLOAT32":
            found[counted <= np.finfo(np.float32).min] = np.nan
        elif header.year == "1991":
            found[(found == -1.0) & (channel.low >= 0.0)] = np.nan  # FFFF, where it is outside of the range
        else:
            found[counted == np.iinfo(kind).min] = np.nan
        values.append(found)
    times = rows["t"].astype(np.float64)
    times[rows["t"] == 0xFFFFFFFF] = np.nan
    return _Rows(rows["n"].astype(np.int64), times, values)


def _check_numbers(rows: _Rows, header: Header) -> None:
    """No sample may be missing."""
    faults: list[tuple[str, str, str]] = []
    told, there = header.rates[-1][1], len(rows.numbers)
    if told != there:
        problem = f"its .cfg says {told} samples, and its .dat has {there}"
        faults.append(("file", problem, "Copy both files again: one is cut, or of another record."))
    odd = np.flatnonzero(np.diff(rows.numbers) != 1)
    if len(odd):
        before, after = rows.numbers[odd[0] : odd[0] + 2]
        problem = f"samples are missing: number {after} follows number {before}"
        faults.append(("file", problem, "Cut the record there, or export it again."))
    if faults:
        raise RecordError(*faults)
