"""Evidence of a verdict as a CSV file: the trace of a run with fewer rows, and the envelopes that it was judged by."""

from __future__ import annotations

import dataclasses
import gzip
import hashlib
import math
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.time_series import write_comtrade
from vsgdesign.campaigns.compliance.measuring import Trace
from vsgdesign.campaigns.compliance.rows import FAIL
from vsgdesign.equations.frames import clarke_inverse, rms_to_peak
from vsgdesign.errors import ArtifactError
from vsgdesign.study.given_files import RESULT_BYTES, read_given
from vsgdesign.study.parameters.converter import Converter

Array = NDArray[np.float64]

SIGNALS = tuple(field.name for field in dataclasses.fields(Trace))
"""Names of the columns of a trace, in the order of the file."""

UNITS = {"t_s": "s", "f_hz": "Hz", "delta_rad": "rad", "limited": "1"}
"""Units of the columns; all others are in pu."""

_DECIMALS = {"t_s": 7}
_USUAL_DECIMALS = 6
"""A millionth of the rating: less than a sensor sees, more than a figure shows."""

_MOST = 1e9
"""Larger values are written in scientific notation, number by number."""


MOST_FIGURES = 200
"""Tests with a failing row that get a figure: more are neither drawn in seconds nor looked at."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Two curves between which a signal must stay, at the times of the trace (n,). NaN: no limit at this time."""

    signal: str
    low: Array
    high: Array


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """A trace with the envelopes that were asked of it."""

    trace: Trace
    limits: tuple[Limits, ...] = ()


def slug(*parts: str) -> str:
    """A file name of these texts: letters, digits, dashes, and eight hexadecimal digits that tell all texts apart."""
    words = re.sub(r"[^a-z0-9.]+", "-", " ".join(parts).lower().replace("+", " plus ")).strip("-.")
    return f"{words[:80].strip('-.')}-{zlib.crc32(chr(0).join(parts).encode()):08x}"


def csv_path(suite: str, test: str, controller: str) -> str:
    """Where the evidence of a row lies, relative to the folder of the result."""
    return f"traces/{slug(suite, test, controller)}.csv"


def figure_path(suite: str, test: str) -> str:
    """Where the figure of a test with a failing row lies: one for all controllers."""
    return f"figures/{slug(suite, test)}.svg"


def figures_of(rows: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], str]:
    """Which tests get a figure, and where it lies: (suite, test) of the first :data:`MOST_FIGURES` that a controller
    fails and that have a trace. ``rows`` as in results.json.

    First come those that the controller with the fewest failures fails, because they are the ones that are looked at.
    """
    failing: dict[tuple[str, str], set[str]] = {}
    for row in rows:
        if row["verdict"] == FAIL:
            failing.setdefault((row["suite"], row["test"]), set()).add(row["controller"])
    traced = {(row["suite"], row["test"]) for row in rows if row.get("csv")}
    names = dict.fromkeys(row["controller"] for row in rows)
    best = min(names, key=lambda name: sum(name in who for who in failing.values()), default="")
    chosen = [key for key in failing if key in traced]
    chosen.sort(key=lambda key: best not in failing[key])
    return {key: figure_path(*key) for key in chosen[:MOST_FIGURES]}


def limits_at(t_s: Array, signal: str, times: Array, low: Array, high: Array) -> Limits:
    """Limits that are given at ``times`` (m,), linear between them, at the times of a trace; NaN outside of them."""
    inside = (t_s >= times[0] - 1e-9) & (t_s <= times[-1] + 1e-9)
    return Limits(
        signal=signal,
        low=np.where(inside, np.interp(t_s, times, low), np.nan),
        high=np.where(inside, np.interp(t_s, times, high), np.nan),
    )


def write_evidence(path: str | Path, evidence: Evidence) -> str:
    """One row for each instant of the trace, units in the header. A name that ends in ``.gz`` is compressed. Returns
    the file's SHA-256."""
    columns = {name: getattr(evidence.trace, name) for name in SIGNALS}
    for one in evidence.limits:
        columns |= {f"{one.signal} low": one.low, f"{one.signal} high": one.high}
    header = ",".join(f"{name} [{_unit(name)}]" for name in columns)
    content = header.encode() + b"\n" + _text(columns)
    if str(path).endswith(".gz"):
        content = gzip.compress(content, compresslevel=3, mtime=0)
    Path(path).write_bytes(content)
    return hashlib.sha256(content).hexdigest()


RECORDED = {
    **{f"{name}_{phase}": unit for name, unit in (("v", "V"), ("i_g", "A")) for phase in "abc"},
    **{"P": "W", "Q": "var", "P_dc": "W", "v_dc": "V", "f": "Hz", "V_rms": "V", "delta": "rad"},
    **{"i_s": "A", "i_phase": "A", "limited": "1"},
}
"""Series of a run as COMTRADE, with their units: phases of the capacitor node and of the current into the PCC
(instantaneous), and what a trace has besides, in SI."""


def write_evidence_comtrade(
    path: str | Path, trace: Trace, form: str, converter: Converter, trigger_s: float
) -> list[Path]:
    """Every row of a trace, in SI, as COMTRADE of a form (:func:`vsgdesign.artifacts.time_series.write_comtrade`).

    ``trigger_s``: when the first event of the test comes, s.
    """
    c, v_pk = converter, rms_to_peak(converter.V_rated_rms)
    v = clarke_inverse(v_pk * trace.v_alpha_pu, v_pk * trace.v_beta_pu)
    i_g = clarke_inverse(c.I_rated_pk * trace.i_g_alpha_pu, c.I_rated_pk * trace.i_g_beta_pu)
    powers = (c.S_rated * one for one in (trace.P_pu, trace.Q_pu, trace.P_dc_pu))
    currents = (c.I_rated_pk * one for one in (trace.i_s_pu, trace.i_phase_pu))
    rest = (c.V_dc * trace.v_dc_pu, trace.f_hz, c.V_rated_rms * trace.V_pu, trace.delta_rad, *currents, trace.limited)
    series = {"t_s": trace.t_s} | dict(zip(RECORDED, (*v, *i_g, *powers, *rest), strict=True))
    f_n = c.omega_n / (2.0 * math.pi)
    return write_comtrade(path, series, form, f_n=f_n, station="vsgdesign", trigger_s=trigger_s, units=RECORDED)


def read_evidence(path: str | Path, signals: Sequence[str] = SIGNALS) -> Evidence:
    """What :func:`write_evidence` wrote, rounded as in the file. Raises ArtifactError for any other file.

    ``signals``: columns of the trace that are asked for. Besides these are read the time and whatever has limits; the
    others are NaN.
    """
    try:
        content = read_given(path, RESULT_BYTES)
        content = gzip.decompress(content) if str(path).endswith(".gz") else content
        header, _, body = content.partition(b"\n")
        names = [name.partition(" [")[0] for name in header.decode().split(",")]
        missing = [name for name in SIGNALS if name not in names]
        if missing:
            raise ValueError(f"there is no column {', '.join(missing)}")
        judged = [name[:-4] for name in names if name.endswith(" low") and name[:-4] + " high" in names]
        asked = {"t_s", *signals, *judged, *(f"{name} {end}" for name in judged for end in ("low", "high"))}
        chosen = [k for k, name in enumerate(names) if name in asked]
        columns = _plain_numbers(body, len(names), chosen)
        if columns is None:
            lines = body.decode().splitlines()
            rows = np.loadtxt(lines, delimiter=",", ndmin=2) if body.strip() else np.empty((0, len(names)))
            if rows.shape[1] != len(names):
                raise ValueError(f"the header has {len(names)} columns and the rows have {rows.shape[1]}")
            columns = rows.T[chosen]
        found = dict(zip([names[k] for k in chosen], columns, strict=True))
    except (OSError, ValueError, EOFError, zlib.error) as error:
        raise ArtifactError(f'"{path}" is not a readable trace: {error}') from error
    unread = np.full(columns.shape[1], np.nan)
    return Evidence(
        trace=Trace(**{name: found.get(name, unread) for name in SIGNALS}),
        limits=tuple(Limits(signal=s, low=found[f"{s} low"], high=found[f"{s} high"]) for s in judged),
    )


_MOST_DIGITS = 15
"""So many digits of a number are a whole number that is exact."""


def _plain_numbers(body: bytes, count: int, chosen: Sequence[int]) -> Array | None:
    """Some of the ``count`` columns of a text, (len(chosen), n), where they are written as :func:`write_evidence`
    mostly does: with as many decimals in every row of a column and without an exponent, or as nan or inf; else None.
    They are those of :func:`float`: a whole number over a power of ten rounds once."""
    chars = np.frombuffer(body, dtype=np.uint8)
    ends = np.flatnonzero((chars == ord(",")) | (chars == ord("\n")))
    if len(ends) == 0 or len(ends) % count or ends[-1] != len(chars) - 1:
        return None
    if ((chars[ends] == ord("\n")) != (np.arange(1, len(ends) + 1) % count == 0)).any():
        return None
    starts = np.append(0, ends[:-1] + 1).reshape(-1, count).T[chosen]
    stops = ends.reshape(-1, count).T[chosen]
    below = chars[starts] == ord("-")
    starts += below
    values = np.empty(stops.shape)
    named = np.zeros(stops.shape, dtype=bool)
    for name, value in ((b"nan", np.nan), (b"inf", np.inf)):
        found = chars[starts] == name[0]
        if found.any():
            ends = stops[found]
            if (ends - starts[found] != len(name)).any():
                return None
            if any((chars[ends - len(name) + k] != letter).any() for k, letter in enumerate(name)):
                return None
            values[found], named[found] = value, True
    lengths = np.where(named, 0, stops - starts)
    decimals = [_decimals(body, *ends_of) for ends_of in zip(starts, stops, named, strict=True)]
    for one in set(decimals):
        these = [k for k, other in enumerate(decimals) if other == one]
        read = _read_digits(chars, stops[these], lengths[these], one)
        if read is None:
            return None
        values[these] = np.where(named[these], values[these], read)
    return np.where(below, -values, values)


def _decimals(body: bytes, starts: NDArray[np.intp], stops: NDArray[np.intp], named: NDArray[np.bool_]) -> int:
    """How many decimals the first number of a column has; 0 where it has no point, or there is none."""
    first = int(np.argmin(named))
    return 0 if named[first] else int(stops[first]) - 1 - body.find(b".", starts[first], stops[first])


def _read_digits(
    chars: NDArray[np.uint8], stops: NDArray[np.intp], lengths: NDArray[np.intp], decimals: int
) -> Array | None:
    """The numbers before some ``stops`` in so many characters, without their signs; None where one has other decimals
    or another character. A length of 0 is not read."""
    read, widest = lengths > 0, int(lengths.max(initial=0))
    if widest == 0:
        return np.zeros(stops.shape)
    if decimals < 1 or lengths[read].min() < decimals + 2 or widest > _MOST_DIGITS + 1:
        return None
    places = np.arange(widest)
    found = chars[stops[..., None] - 1 - places]  # the last character first
    found -= np.uint8(ord("0"))
    if (found[..., decimals][read] != (ord(".") - ord("0")) % 256).any():
        return None
    found[..., decimals] = 0
    found[places >= lengths[..., None]] = 0
    if found.max() > 9:
        return None
    powers = 10.0 ** np.where(places > decimals, places - 1, places)
    return found @ powers / 10.0**decimals


class EvidenceFiles(Mapping[str, Evidence]):
    """The evidence of rows (as in results.json) by the name of its file, read from the folder when asked for, with the
    ``signals`` of :func:`read_evidence`."""

    def __init__(self, folder: str | Path, rows: Sequence[Mapping[str, Any]], signals: Sequence[str] = SIGNALS) -> None:
        self._folder, self._signals = Path(folder), signals
        self._names = dict.fromkeys(str(row["csv"]) for row in rows if row.get("csv"))

    def __getitem__(self, name: str) -> Evidence:
        if name not in self._names:
            raise KeyError(name)
        return read_evidence(self._folder / name, self._signals)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _unit(name: str) -> str:
    return UNITS.get(name.partition(" ")[0], "pu")


def _text(columns: Mapping[str, Array]) -> bytes:
    """The rows. Digits are made for all columns of one precision at once: one number at a time takes far longer."""
    rows = len(next(iter(columns.values())))
    precisions = groupby(columns, key=lambda name: _DECIMALS.get(name, _USUAL_DECIMALS))
    parts = [_digits(np.stack([columns[name] for name in names], axis=1), one) for one, names in precisions]
    parts[-1][:, -1, -1] = ord("\n")
    joined = np.concatenate([part.reshape(rows, -1) for part in parts], axis=1) if rows else np.empty(0, np.uint8)
    return joined.tobytes().translate(None, b" ")


_PAIRS = np.frombuffer("".join(f"{k:02d}" for k in range(100)).encode(), dtype=np.uint16)
"""The two digits of each number below a hundred."""


def _digits(values: Array, decimals: int) -> NDArray[np.uint8]:
    """Texts of columns (n, m), each with a comma behind it: (n, m, width) bytes, filled up with blanks."""
    known = np.isfinite(values)
    usual = values if known.all() else np.where(known, values, 0.0)
    beyond = np.abs(usual).max(axis=0, initial=0.0) >= _MOST
    if beyond.any():
        usual = np.where(beyond, 0.0, usual)
    scaled = np.rint(usual * 10.0**decimals)
    most = float(np.abs(scaled).max(initial=0.0))
    whole = scaled.astype(np.int32 if most < 2.0**31 else np.int64)  # half the width in a third of the time
    rest, width = np.abs(whole), decimals + len(str(int(np.abs(usual).max(initial=0.0)) + 1))
    found = np.full((*values.shape, 1 + max(width + 2, 24 * bool(beyond.any()))), ord(" "), dtype=np.uint8)
    found[..., -1] = ord(",")
    text = found[..., :-1]
    zero = ord("0")
    for place in range(0, decimals - 1, 2):
        hundreds = rest // 100
        pair = text[..., text.shape[-1] - place - 2 : text.shape[-1] - place].view(np.uint16)
        pair[..., 0] = _PAIRS.take(rest - 100 * hundreds)
        rest = hundreds
    if decimals % 2:
        tens = rest // 10
        text[..., -decimals] = rest - 10 * tens + zero
        rest = tens
    text[..., -1 - decimals] = ord(".")
    tens = rest // 10
    text[..., -2 - decimals] = rest - 10 * tens + zero
    for place in range(decimals + 2, width + 1):
        rest = tens
        tens = rest // 10
        np.copyto(text[..., -1 - place], rest - 10 * tens + zero, where=rest > 0, casting="unsafe")
    text[whole < 0, 0] = ord("-")
    for n, m in np.argwhere(beyond & known).tolist():
        text[n, m] = np.frombuffer(f"{values[n, m]:.9g}".rjust(text.shape[-1]).encode(), dtype=np.uint8)
    if usual is not values:
        for value, where in (("nan", np.isnan(values)), ("inf", values == np.inf), ("-inf", values == -np.inf)):
            text[where] = np.frombuffer(value.rjust(text.shape[-1]).encode(), dtype=np.uint8)
    return found


BEFORE_S, AFTER_S = 0.02, 0.15
"""Around each event every row is kept: from so long before it to so long after it, s."""

REST_S = 5e-3
"""Elsewhere one row is kept in so many seconds."""

LARGEST, MEAN = ("i_s_pu", "i_phase_pu"), ("P_dc_pu", "limited")
"""Columns of which a kept row has the largest, or the mean, of itself and of the rows left out before it."""


def thinned(evidence: Evidence, events_s: Sequence[float]) -> Evidence:
    """The evidence with fewer rows. All other columns have their value at the instant of the row."""
    trace = evidence.trace
    t, rows = trace.t_s, len(trace.t_s)
    if rows < 3:
        return evidence
    step = float(t[-1] - t[0]) / (rows - 1)
    keep = np.zeros(rows, dtype=bool)
    keep[:: max(round(REST_S / step), 1)] = True
    keep[-1] = True
    for event_s in events_s:
        keep |= (t >= event_s - BEFORE_S - 0.5 * step) & (t <= event_s + AFTER_S + 0.5 * step)
    kept = np.flatnonzero(keep)
    begins = np.concatenate(([0], kept[:-1] + 1))
    counts = np.diff(np.append(begins, kept[-1] + 1))
    columns: dict[str, Array] = {}
    for name, values in vars(trace).items():
        if name in LARGEST:
            columns[name] = np.maximum.reduceat(values, begins)
        elif name in MEAN:
            columns[name] = np.add.reduceat(values, begins) / counts
        else:
            columns[name] = values[kept]
    limits = tuple(replace(one, low=one.low[kept], high=one.high[kept]) for one in evidence.limits)
    return Evidence(trace=Trace(**columns), limits=limits)
