"""Reads recorded waveforms of a voltage: one or three phases at a constant sampling rate, from files of any format.
PSCAD writes NAME.inf with the names of the channels, and NAME_01.out, … with ten channels each.
"""

from __future__ import annotations

import functools
import io
import itertools
import math
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from vsgdesign.study.given_files import RECORD_BYTES, TABLE_BYTES, check_unpacked, open_given, read_given
from vsgdesign.study.parameters.comtrade import comtrade_files, read_comtrade
from vsgdesign.study.parameters.record_columns import Array, Columns, RecordError, says_volts, unfit_unit, volts_of

_OF_A_FILE = 10
"""Channels in one .out."""

_NUMBERED = re.compile(r"(.+)_(\d+)")
_ENTRY = re.compile(r"^\s*PGB\(\s*(\d+)\s*\)(.*)$", re.MULTILINE)
_FIELD = re.compile(r'(\w+)="([^"]*)"')


class Channel(NamedTuple):
    """A channel as the .inf describes it."""

    name: str
    unit: str


def pscad_files(path: str) -> tuple[str, ...]:
    """The files of an output, of which one is given: of a .inf all .out; of an .out itself, with the .inf if there is
    one. Raises RecordError."""
    place = Path(path)
    if place.suffix.lower() == ".inf":
        outs = sorted(one for one in place.parent.glob(f"{_escaped(place.stem)}_*") if _is_part(one, place.stem))
        if not outs:
            advice = "Put them into the folder of the .inf. Of a COMTRADE record give the .cfg."
            raise RecordError(("file", f'there is no "{place.stem}_01.out" beside it, which has its samples', advice))
        return (path, *map(str, outs))
    numbered = _NUMBERED.fullmatch(place.stem)
    likely = [place.with_name(f"{numbered.group(1)}{kind}") for kind in (".inf", ".INF")] if numbered else []
    beside = next((one for one in likely if one.exists()), None)
    return (path,) if beside is None else (str(beside), path)


def read_pscad(path: str) -> Columns:
    """The channels of an output, in V where the .inf says a unit of voltages. Raises RecordError and OSError."""
    files = pscad_files(path)
    outs = [one for one in files if Path(one).suffix.lower() == ".out"]
    known = _channels(files[0]) if len(outs) < len(files) else {}
    times: Array | None = None
    found: dict[int, Array] = {}
    for place in outs:
        numbered = _NUMBERED.fullmatch(Path(place).stem)
        first = _OF_A_FILE * (int(numbered.group(2)) - 1) if numbered else 0
        rows = _rows(place)
        if times is not None and (len(times) != len(rows) or not np.array_equal(times, rows[:, 0])):
            problem = f'"{Path(place).name}" has other times than "{Path(outs[0]).name}"'
            raise RecordError(("file", problem, "Take the files of one run."))
        times = rows[:, 0]
        found |= {first + k: rows[:, k].copy() for k in range(1, rows.shape[1])}
    missing = sorted(set(known) - set(found)) if len(outs) < len(files) and Path(path).suffix.lower() == ".inf" else []
    if missing:
        name = f"{Path(path).stem}_{math.ceil(missing[0] / _OF_A_FILE):02d}.out"
        problem = f'the channel "{known[missing[0]].name}" of its .inf is missing in its .out files'
        raise RecordError(("file", problem, f'Put "{name}" beside it, with all channels of the run.'))
    return _named(found, known, times)


def _named(found: dict[int, Array], known: dict[int, Channel], times: Array | None) -> Columns:
    values, unfit, voltages = {}, {}, []
    for number, column in sorted(found.items()):
        channel = known.get(number)
        if channel is None:
            values[str(number)] = column
            continue
        volts = volts_of(channel.unit)
        values[channel.name] = column if volts is None else volts * column
        if volts is None:
            unfit[channel.name] = unfit_unit(channel.name, channel.unit)
        elif says_volts(channel.unit):
            voltages.append(channel.name)
    return Columns(values, None, times, tuple(voltages) if known else None, unfit)


def _channels(path: str) -> dict[int, Channel]:
    """The channels of a .inf by their number. A name that several groups have is GROUP/NAME."""
    text = read_given(path, TABLE_BYTES).decode("utf-8", errors="replace")
    entries = {int(one.group(1)): dict(_FIELD.findall(one.group(2))) for one in _ENTRY.finditer(text)}
    if not entries:
        problem = f'"{Path(path).name}" has no line that begins with PGB(1)'
        raise RecordError(("file", problem, "Give the .inf of PSCAD. Of a COMTRADE record give the .cfg."))
    plain = [fields.get("Desc", "") for fields in entries.values()]
    found: dict[int, Channel] = {}
    for number, fields in entries.items():
        name = fields.get("Desc", "")
        name = f"{fields.get('Group', '')}/{name}" if plain.count(name) > 1 else name
        taken = {channel.name for channel in found.values()}
        found[number] = Channel(f"{name}#{number}" if name in taken or not name else name, fields.get("Units", ""))
    return found


def _rows(path: str) -> Array:
    """The rows of an .out, of which the first line may be a title."""
    text = read_given(path, RECORD_BYTES).decode("latin-1").splitlines()
    lines = [line for line in text[1:] if line.strip()]
    if text and _are_numbers(text[0]):
        lines.insert(0, text[0])
    try:
        rows = np.loadtxt(lines, ndmin=2) if lines else np.zeros((0, 0))
    except ValueError:
        bad = next((line for line in lines if not _are_numbers(line)), lines[0])
        problem = f'"{Path(path).name}" cannot be read as numbers in columns: line {text.index(bad) + 1}'
        raise RecordError(("file", problem, "Give the text output of PSCAD; of .psout export it as text.")) from None
    if rows.shape[0] < 2 or rows.shape[1] < 2:
        problem = f'"{Path(path).name}" has fewer than two rows of a time and a channel'
        raise RecordError(("file", problem, "Give the text output of PSCAD."))
    return rows


def _are_numbers(line: str) -> bool:
    try:
        return bool([float(cell) for cell in line.split()])
    except ValueError:
        return False


def _is_part(path: Path, stem: str) -> bool:
    numbered = _NUMBERED.fullmatch(path.stem)
    return path.suffix.lower() == ".out" and numbered is not None and numbered.group(1) == stem


def _escaped(stem: str) -> str:
    return re.sub(r"([*?\[])", r"[\1]", stem)


TIMES = ("time", "t", "t_s", "seconds")
"""Names that a column of times may have."""

RATES = ("sampling_rate", "rate", "fs")
"""Names that the sampling rate may have in an npz file."""

_JITTER = 0.05
"""How far a time may be off its place, in sampling intervals."""


class Record(NamedTuple):
    """A recorded voltage: one column for each phase, in the unit of the file."""

    rate: float
    """Samples in a second, 1/s."""
    values: Array
    """(n, 1) or (n, 3)."""


def read_record(path: str, columns: tuple[str, ...] | None, rate: float | None) -> Record:
    """A record from a file. ``columns``: names, or numbers from 1 on, of the phases; None: all that are there. ``rate``
    (1/s): where the file does not say it. Raises RecordError with everything that is wrong."""
    try:
        stamps = tuple(_stamp(one) for one in record_files(path))
        return _read(path, stamps, columns, rate)
    except OSError as error:
        raise RecordError(("file", f"cannot be read: {error.strerror}", "Give a file, and check its name.")) from None


def record_files(path: str) -> tuple[str, ...]:
    """All files of a record, of which one is given. Raises RecordError where one that it needs is not there."""
    of_kind = _SEVERAL.get(Path(path).suffix.lower())
    return (path,) if of_kind is None or not Path(path).exists() else of_kind[0](path)


def _stamp(path: str) -> tuple[int, int]:
    with open_given(path, RECORD_BYTES) as file:
        stat = os.fstat(file.fileno())
    return stat.st_mtime_ns, stat.st_size


@functools.lru_cache(maxsize=4)
def _read(path: str, _: tuple[tuple[int, int], ...], columns: tuple[str, ...] | None, rate: float | None) -> Record:
    there = _columns(path)
    faults: list[tuple[str, str, str]] = []
    chosen = _chosen(there, columns, faults)
    lengths = {len(values) for values in chosen}
    if len(lengths) > 1:
        faults.append(("columns", f"they have {' and '.join(map(str, sorted(lengths)))} samples", "Choose others."))
    values = np.stack(chosen, axis=1) if chosen and len(lengths) == 1 else np.zeros((0, 1))
    own_rate = there.rate if there.times is None else _rate_of(there.times, faults)
    found = _one_rate(own_rate, rate, faults)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        place = f"the first is sample {bad[0] + 1}"
        problem = f"{len(bad)} of {len(values)} samples are missing or no numbers ({place})"
        faults.append(("file", problem, "Cut the record there, or fill the gap."))
    if faults:
        raise RecordError(*faults)
    return Record(found, values)


def _columns(path: str) -> Columns:
    kind = Path(path).suffix.lower()
    if kind in _SEVERAL:
        return _SEVERAL[kind][1](path)
    readers = {".csv": _read_csv, ".txt": _read_csv, ".wav": _read_wav, ".npz": _read_npz}
    if kind not in readers:
        known = ", ".join((*readers, *_SEVERAL))
        raise RecordError(("file", f'"{kind}" is no format of a record', f"Known: {known}."))
    with open_given(path, RECORD_BYTES) as file:
        table, own_rate = readers[kind](file)
    times = next((table.pop(name) for name in list(table) if name.lower() in TIMES), None)
    return Columns(table, own_rate, times)


_SEVERAL: dict[str, tuple[Callable[[str], tuple[str, ...]], Callable[[str], Columns]]] = {
    ".cfg": (comtrade_files, read_comtrade),
    ".dat": (comtrade_files, read_comtrade),
    ".cff": (comtrade_files, read_comtrade),
    ".inf": (pscad_files, read_pscad),
    ".out": (pscad_files, read_pscad),
}
"""Formats that may take several files, of which one is given: which they are, and what is read of them."""


def _chosen(there: Columns, columns: tuple[str, ...] | None, faults: list[tuple[str, str, str]]) -> list[Array]:
    names = list(there.values)
    has = f"The file has {', '.join(names)}." if names else "The file has no other columns."
    if columns is None:
        columns = there.voltages or tuple(names)
        if len(columns) not in (1, 3):
            what = f"voltages ({', '.join(columns)})" if there.voltages else "columns"
            problem = f"the file has {len(columns)} {what}, not one or three phases"
            faults.append(("columns", problem, f"Choose. {has}"))
            return []
    chosen = []
    for column in columns:
        place = int(column) - 1 if column.isdecimal() and column not in there.values else None
        name = names[place] if place is not None and 0 <= place < len(names) else column
        if name not in there.values:
            faults.append(("columns", f'there is no column "{column}"', has))
            continue
        if name in there.unfit:
            faults.append(("columns", *there.unfit[name]))
        chosen.append(there.values[name])
    return chosen


def _rate_of(times: Array, faults: list[tuple[str, str, str]]) -> float:
    """The sampling rate of times (s), which have to be evenly spaced."""
    steps = np.diff(times)
    step = float(np.median(steps)) if len(steps) else np.nan
    if not step > 0.0:
        faults.append(("file", "its times do not increase", "Give them in s."))
        return np.nan
    odd = ~(np.abs(steps - step) <= _JITTER * step)
    if odd.any():
        first = int(np.argmax(odd))
        problem = (
            f"{int(odd.sum())} gap{'s' if odd.sum() > 1 else ''} in its times, the first after {times[first]:g} s "
            f"({steps[first]:g} s instead of {step:g} s)"
        )
        faults.append(("file", problem, "Cut the record there, or sample it again at a constant rate."))
        return np.nan
    return (len(times) - 1) / float(times[-1] - times[0])


def _one_rate(own: float | None, given: float | None, faults: list[tuple[str, str, str]]) -> float:
    if own is None and given is None:
        faults.append(("sampling_rate", "missing", "The file does not say it. Give it, for example 10 kHz."))
        return np.nan
    if own is not None and given is not None and not abs(own / given - 1.0) < 0.01 and not np.isnan(own):
        faults.append(("sampling_rate", f"the file says {own:.6g} Hz", "Leave it out, or correct it."))
    return given if given is not None else float(own or np.nan)


def _read_csv(file: IO[bytes]) -> tuple[dict[str, Array], float | None]:
    try:
        with io.TextIOWrapper(file, encoding="utf-8-sig") as text:
            head = [line for line in (text.readline() for _ in range(100)) if line.strip() and line[0] != "#"]
            if not head:
                raise ValueError("it is empty")
            first = head[0].strip()
            delimiter = next((mark for mark in (";", "\t", ",") if mark in first), ",")
            cells = [cell.strip().strip('"') for cell in first.split(delimiter)]
            named = any(_number(cell) is None for cell in cells)
            text.seek(0)
            lines = (line for line in text if line.strip() and line[0] != "#")
            if named:
                next(lines, None)
            first_row = next(lines, None)
            if first_row is None:
                raise ValueError("it has no rows")
            rows = np.loadtxt(
                itertools.chain([first_row], lines), delimiter=delimiter, converters=_cell, ndmin=2, encoding=None
            )
    except (ValueError, IndexError, StopIteration, UnicodeDecodeError) as error:
        why = re.sub(r"could not convert string .* to float64", "no number", str(error), flags=re.DOTALL)  # its content
        problem = f"cannot be read as numbers in columns: {why.rstrip('.')}"
        raise RecordError(("file", problem, "One row for each sample, with a point for decimals.")) from None
    names = cells if named else [str(k + 1) for k in range(rows.shape[1])]
    if rows.shape[1] != len(names) or len(rows) == 0:
        raise RecordError(("file", "its rows do not fit its header", "One name for each column, one row a sample."))
    return {name: rows[:, k].copy() for k, name in enumerate(names)}, None


def _cell(text: str) -> float:
    """A cell; an empty one is a gap."""
    return float(text) if text.strip() else np.nan


def _number(text: str) -> float | None:
    try:
        return float(text) if text else np.nan
    except ValueError:
        return None


_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_WIDTHS = {(_PCM, 8), (_PCM, 16), (_PCM, 24), (_PCM, 32), (_FLOAT, 32), (_FLOAT, 64)}
"""Kinds of samples in a WAV file, with their bits, that are read."""


class _Wav(NamedTuple):
    """What the header says: kind of samples, channels, samples in a second, bits."""

    kind: int
    channels: int
    rate: int
    bits: int


def _read_wav(file: IO[bytes]) -> tuple[dict[str, Array], float | None]:
    try:
        form, data = _wav_chunks(file)
    except (ValueError, struct.error) as error:
        advice = "Integers of 8 to 32 bits and floats of 32 or 64 are read; convert others."
        raise RecordError(("file", f"cannot be read as WAV: {error}", advice)) from None
    width = form.bits // 8
    raw = np.frombuffer(data, dtype=np.uint8)
    frames = raw[: len(raw) // (width * form.channels) * width * form.channels].reshape(-1, form.channels, width)
    if form.kind == _FLOAT:
        values = frames.copy().view(f"<f{width}")[:, :, 0].astype(np.float64)
    elif width == 1:
        values = (frames[:, :, 0].astype(np.float64) - 128.0) / 128.0
    else:
        padded = np.zeros((*frames.shape[:2], 4), dtype=np.uint8)
        padded[:, :, 4 - width :] = frames
        values = padded.view("<i4")[:, :, 0] / 2.0**31
    return {str(k + 1): values[:, k] for k in range(form.channels)}, float(form.rate)


def _wav_chunks(file: IO[bytes]) -> tuple[_Wav, bytes]:
    """The header of a WAV file and its samples. Raises ValueError."""
    head = file.read(12)
    if len(head) < 12:
        raise ValueError(f"its header is cut after {len(head)} bytes")
    if (head[:4], head[8:]) != (b"RIFF", b"WAVE"):
        raise ValueError("it does not begin with RIFF and WAVE")
    form = None
    while True:
        name = file.read(8)
        if len(name) < 8:
            raise ValueError(f"its header is cut: it ends before the {'format' if form is None else 'samples'}")
        size = int.from_bytes(name[4:], "little")
        if name[:4] == b"data":
            break
        chunk = file.read(size + size % 2)
        if len(chunk) < size:
            raise ValueError(f"its header is cut: {len(chunk)} of the {size} bytes of a part are there")
        if name[:4] == b"fmt ":
            kind, channels, rate, _, _, bits = struct.unpack_from("<HHIIHH", chunk)
            form = _Wav(*struct.unpack_from("<H", chunk, 24) if kind == _EXTENSIBLE else (kind,), channels, rate, bits)
    if form is None:
        raise ValueError("its header says no format")
    if (form.kind, form.bits) not in _WIDTHS or not form.channels or not form.rate:
        raise ValueError(f"{form.channels} channels, {form.rate} Hz, samples of kind {form.kind} with {form.bits} bits")
    return form, file.read(size)


def _read_npz(file: IO[bytes]) -> tuple[dict[str, Array], float | None]:
    table: dict[str, Array] = {}
    rate = None
    try:
        check_unpacked(file, RECORD_BYTES)
        with np.load(file, allow_pickle=False) as archive:
            for name in archive.files:
                values = np.asarray(archive[name], dtype=np.float64)
                if values.ndim == 0:
                    rate = float(values) if name.lower() in RATES else rate
                elif values.ndim == 1:
                    table[name] = values
                elif values.ndim == 2:
                    table |= {f"{name}_{k + 1}": values[:, k] for k in range(values.shape[1])}
    except (ValueError, TypeError, KeyError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise RecordError(("file", f"cannot be read as npz: {error}", "Write it with numpy.savez.")) from None
    return table, rate
