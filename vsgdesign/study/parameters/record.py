"""Reads recorded waveforms of a voltage: CSV, WAV or npz files with one or three phases at a constant sampling rate."""

from __future__ import annotations

import functools
import itertools
import os
import wave
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TIMES = ("time", "t", "t_s", "seconds")
"""Names that a column of times may have."""

RATES = ("sampling_rate", "rate", "fs")
"""Names that the sampling rate may have in an npz file."""

_JITTER = 0.05
"""How far a time may be off its place, in sampling intervals."""


class RecordError(Exception):
    """What is wrong with a file, in one or several sentences: (field of [replay], problem, advice) each."""

    def __init__(self, *faults: tuple[str, str, str]) -> None:
        super().__init__("; ".join(problem for _, problem, _ in faults))
        self.faults = faults


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
        stat = os.stat(path)
    except OSError as error:
        raise RecordError(("file", f"cannot be read ({error.strerror})", "Check the name.")) from None
    return _read(path, (stat.st_mtime_ns, stat.st_size), columns, rate)


@functools.lru_cache(maxsize=4)
def _read(path: str, _: tuple[int, int], columns: tuple[str, ...] | None, rate: float | None) -> Record:
    kind = Path(path).suffix.lower()
    readers = {".csv": _read_csv, ".txt": _read_csv, ".wav": _read_wav, ".npz": _read_npz}
    if kind not in readers:
        raise RecordError(("file", f'"{kind}" is no format of a record', "Known: .csv, .txt, .wav, .npz."))
    table, own_rate = readers[kind](path)
    faults: list[tuple[str, str, str]] = []
    times = next((table.pop(name) for name in list(table) if name.lower() in TIMES), None)
    chosen = _chosen(table, columns, faults)
    lengths = {len(values) for values in chosen}
    if len(lengths) > 1:
        faults.append(("columns", f"they have {' and '.join(map(str, sorted(lengths)))} samples", "Choose others."))
    values = np.stack(chosen, axis=1) if chosen and len(lengths) == 1 else np.zeros((0, 1))
    if times is not None:
        own_rate = _rate_of(times, faults)
    found = _one_rate(own_rate, rate, faults)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        place = f"the first is sample {bad[0] + 1}"
        problem = f"{len(bad)} of {len(values)} samples are missing or no numbers ({place})"
        faults.append(("file", problem, "Cut the record there, or fill the gap."))
    if faults:
        raise RecordError(*faults)
    return Record(found, values)


def _chosen(
    table: dict[str, Array], columns: tuple[str, ...] | None, faults: list[tuple[str, str, str]]
) -> list[Array]:
    names = list(table)
    there = f"The file has {', '.join(names)}." if names else "The file has no other columns."
    if columns is None:
        columns = tuple(names)
        if len(names) not in (1, 3):
            faults.append(
                ("columns", f"the file has {len(names)} columns, not one or three phases", f"Choose. {there}")
            )
            return []
    chosen = []
    for column in columns:
        place = int(column) - 1 if column.isdecimal() and column not in table else None
        if place is not None and 0 <= place < len(names):
            chosen.append(table[names[place]])
        elif column in table:
            chosen.append(table[column])
        else:
            faults.append(("columns", f'there is no column "{column}"', there))
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


def _read_csv(path: str) -> tuple[dict[str, Array], float | None]:
    try:
        with open(path, encoding="utf-8-sig") as file:
            head = [line for line in (file.readline() for _ in range(100)) if line.strip() and line[0] != "#"]
        if not head:
            raise ValueError("it is empty")
        first = head[0].strip()
        delimiter = next((mark for mark in (";", "\t", ",") if mark in first), ",")
        cells = [cell.strip().strip('"') for cell in first.split(delimiter)]
        named = any(_number(cell) is None for cell in cells)
        with open(path, encoding="utf-8-sig") as file:
            lines = (line for line in file if line.strip() and line[0] != "#")
            if named:
                next(lines, None)
            first_row = next(lines, None)
            if first_row is None:
                raise ValueError("it has no rows")
            rows = np.loadtxt(
                itertools.chain([first_row], lines), delimiter=delimiter, converters=_cell, ndmin=2, encoding=None
            )
    except (ValueError, IndexError, StopIteration, UnicodeDecodeError) as error:
        problem = f"cannot be read as numbers in columns: {error}"
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


def _read_wav(path: str) -> tuple[dict[str, Array], float | None]:
    try:
        with wave.open(path, "rb") as file:
            width, channels, rate = file.getsampwidth(), file.getnchannels(), file.getframerate()
            raw = np.frombuffer(file.readframes(file.getnframes()), dtype=np.uint8)
    except (wave.Error, EOFError) as error:
        problem = f"cannot be read as WAV: {error}"
        raise RecordError(("file", problem, "Integer PCM of 8 to 32 bits; convert others.")) from None
    frames = raw[: len(raw) // (width * channels) * width * channels].reshape(-1, channels, width)
    if width == 1:
        values = (frames[:, :, 0].astype(np.float64) - 128.0) / 128.0
    else:
        padded = np.zeros((*frames.shape[:2], 4), dtype=np.uint8)
        padded[:, :, 4 - width :] = frames
        values = padded.view("<i4")[:, :, 0] / 2.0**31
    return {str(k + 1): values[:, k] for k in range(channels)}, float(rate)


def _read_npz(path: str) -> tuple[dict[str, Array], float | None]:
    table: dict[str, Array] = {}
    rate = None
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                values = np.asarray(archive[name], dtype=np.float64)
                if values.ndim == 0:
                    rate = float(values) if name.lower() in RATES else rate
                elif values.ndim == 1:
                    table[name] = values
                elif values.ndim == 2:
                    table |= {f"{name}_{k + 1}": values[:, k] for k in range(values.shape[1])}
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise RecordError(("file", f"cannot be read as npz: {error}", "Write it with numpy.savez.")) from None
    return table, rate
