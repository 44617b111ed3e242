"""The [replay] section: a recorded voltage that takes the place of the grid's source.

Before it is played, its fundamental, sequences, offset and clipping are looked at. The fundamental's phasor and the
mean of each phase are those of the first cycles under a Hann window, at the frequency with the largest magnitude.
Whether a record is clipped is counted over all of its samples.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import clarke, peak_to_rms
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import names, number, picked, text, values
from vsgdesign.study.parameters.reader import TableReader
from vsgdesign.study.parameters.record import Record, read_record, record_files
from vsgdesign.study.parameters.record_columns import RecordError

LARGEST_NEGATIVE = 0.1
"""Largest negative sequence over the positive one."""

LARGEST_OFF_NOMINAL = 0.05
"""Largest distance of the fundamental from the nominal frequency, relative to it."""

LARGEST_OFFSET = 0.1
"""Largest mean of a phase over the amplitude of the fundamental."""

LARGEST_CLIPPED = 0.01
"""Largest share of the samples of a phase at the same extreme."""

MORE_THAN_NEXT = 6.0
"""A sine of few bits has many samples at its extreme, too, but at most this many times those of the next value."""

PER_CYCLE = 40
"""Instants in a nominal cycle at which the beginning is looked at."""

_PADDED = 16
"""How much finer than its length the spectrum of the beginning is."""

_NO_SWING = 1e-3
"""A phase that moves by less than this share of its largest value is no voltage."""

Wrong = tuple[str, str]
"""A problem and what to do about it."""


class Seen(NamedTuple):
    """What is told of a record."""

    hz: float
    """Frequency of the fundamental."""
    negative: float
    """Negative over positive sequence; 0 of one phase."""
    offset: float
    """Largest mean over the fundamental's amplitude."""
    clipped: float
    """Largest share of a phase's samples at the same extreme."""


NOTHING_SEEN = Seen(math.nan, math.nan, math.nan, math.nan)


def look_at(beginning: NDArray[np.float64], values: NDArray[np.float64], f_n: float) -> tuple[Seen, list[Wrong]]:
    """What is seen of a record, and everything that is wrong with it.

    ``beginning`` (n, 1 or 3): ``PER_CYCLE`` instants in each nominal cycle of the beginning. ``values``: all samples.
    ``f_n`` in Hz.
    """
    window = np.hanning(len(beginning) + 1)[:-1, None]
    means = (window * beginning).sum(axis=0) / window.sum()
    swings = beginning - means
    strongest = int(np.argmax(np.abs(swings).max(axis=0)))
    if not np.abs(swings[:, strongest]).max() > _NO_SWING * np.abs(beginning).max():
        nothing = "no phase changes in the first cycles: there is no voltage", "Choose other columns, or a later begin."
        return NOTHING_SEEN, [nothing]
    lines = np.abs(np.fft.rfft(window[:, 0] * swings[:, strongest], _PADDED * len(beginning)))
    hz = f_n * PER_CYCLE * _peak(lines) / (_PADDED * len(beginning))
    if not abs(hz / f_n - 1.0) <= LARGEST_OFF_NOMINAL:
        problem = f"its fundamental is at {hz:.4g} Hz, and the converter's f_n is {f_n:g} Hz"
        return NOTHING_SEEN, [(problem, "Check sampling_rate; or take another record.")]
    turn = np.exp(-2j * math.pi * hz / (f_n * PER_CYCLE) * np.arange(len(beginning)))
    phasors = 2.0 * (window[:, 0] * turn) @ swings / window.sum()
    offset = float((np.abs(means) / np.abs(phasors).max()).max())
    clipped = max(_clipped(column) for column in values.T)
    negative, wrong = 0.0, []
    if len(phasors) == 3:
        negative, wrong = _sequences(phasors)
    if offset > LARGEST_OFFSET:
        wrong.append(
            (
                f"its mean is {_percent(offset)} of the fundamental, and the limit is {_percent(LARGEST_OFFSET)}",
                "Take the recorder's offset away.",
            )
        )
    if clipped > LARGEST_CLIPPED:
        wrong.append(
            (
                f"it is clipped: {_percent(clipped)} of the samples of a phase are at the same extreme, and the limit "
                f"is {_percent(LARGEST_CLIPPED)}",
                "Take a record whose range is larger than the voltage.",
            )
        )
    return Seen(hz, negative, offset, clipped), wrong


def _peak(lines: NDArray[np.float64]) -> float:
    """The place of the largest of these magnitudes, between the places of a parabola through their logarithms."""
    k = int(np.argmax(lines))
    if not 0 < k < len(lines) - 1 or not lines[k - 1 : k + 2].min() > 0.0:
        return float(k)
    left, top, right = np.log(lines[k - 1 : k + 2])
    return k + 0.5 * float((left - right) / (left - 2.0 * top + right))


def _sequences(phasors: NDArray[np.complex128]) -> tuple[float, list[Wrong]]:
    """The negative sequence over the positive one, and what makes it too large."""
    negative = _unbalance(phasors)
    if negative <= LARGEST_NEGATIVE:
        return negative, []
    sizes = np.abs(phasors)
    if np.ptp(phasors.real) + np.ptp(phasors.imag) < LARGEST_NEGATIVE * sizes.max():
        return negative, [("its three phases are the same", "Choose three different columns, or one phase alone.")]
    weak = [f"{k + 1}" for k in range(3) if sizes[k] < LARGEST_NEGATIVE * sizes.max()]
    if weak:
        said = f"phase {' and '.join(weak)} of its columns has no fundamental"
        return negative, [(said, "Choose the columns of all three phases, or one phase alone.")]
    if _unbalance(phasors[[0, 2, 1]]) <= LARGEST_NEGATIVE:
        return negative, [("its phases are in the order a, c, b", "Exchange the second and the third of `columns`.")]
    for k in range(3):
        signs = np.ones(3)
        signs[k] = -1.0
        if _unbalance(signs * phasors) <= LARGEST_NEGATIVE:
            return negative, [(f"phase {k + 1} of its columns has the wrong sign", "Turn the sign in the file.")]
    problem = (
        f"its negative sequence is {_percent(negative)} of the positive one, and the limit is "
        f"{_percent(LARGEST_NEGATIVE)}"
    )
    return negative, [(problem, "Check the order and the signs of the phases; or begin later, or take another record.")]


def _unbalance(phasors: NDArray[np.complex128]) -> float:
    """Negative over positive sequence of the phasors of the phases a, b, c; infinite without a positive one."""
    alpha, beta = clarke(*phasors)
    negative, positive = abs(alpha - 1j * beta), abs(alpha + 1j * beta)
    return float(negative / positive) if positive > 1e-9 * np.abs(phasors).max() else math.inf


def _clipped(column: NDArray[np.float64]) -> float:
    """The share of samples at an extreme, if they are too many for a sine of these steps; else 0."""
    share = 0.0
    for signed in (column, -column):
        top = float(signed.max())
        below = signed[signed < top]
        at_top = len(signed) - len(below)
        beside = int(np.count_nonzero(below == below.max())) if len(below) else 0
        if at_top > MORE_THAN_NEXT * beside or at_top > 0.25 * len(signed):
            share = max(share, at_top / len(signed))
    return share


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


NEIGHBOURS = 16
"""Samples on either side of an instant that its value is interpolated from."""

_SHAPE = 9.0
"""Of the Kaiser window over them: what it adds to a component below 0.8 of half the sampling rate is under 1e-4."""

_CYCLES = 10
"""Cycles at the beginning, to which the fundamental of the start is fitted."""

_SCALE = 'Give V for one unit of the file, or "rated".'

RATED = "rated"
"""The scale that makes the fundamental the rated voltage."""


@dataclass(frozen=True, kw_only=True)
class ReplaySpec:
    """A record and how it is used, with the fundamental of its first cycles."""

    file: str
    files: tuple[str, ...] = ()
    """All files of the record."""
    columns: tuple[str, ...] | None
    rate: float | None
    """Sampling rate where the file does not say it, 1/s."""
    begin: float
    """Time of the record at which the simulation begins, s after the first instant that can be used."""
    scale: float
    """V for one unit of the file."""
    V_g_rms: float = math.nan
    omega_g: float = math.nan
    phase: float = math.nan
    """Of the space vector at the beginning: V, rad/s and rad."""
    origin: float = 0.0
    """Time of the record at t = 0, s."""
    usable: float = 0.0
    """Up to which time of the simulation there is a voltage, s."""
    seen: Seen = NOTHING_SEEN
    """What was looked at when the file was read."""

    def vector(self, t_s: NDArray[np.float64]) -> NDArray[np.complex128]:
        """The space vector of the recorded voltage, V peak, at times of the simulation (s), increasing."""
        record = read_record(self.file, self.columns, self.rate)
        return self.scale * _vectors(record, self.omega_g, self.origin + t_s)

    def check_usable(self, duration: float, converter: Converter) -> None:
        """Raises InfeasibleStudyError where the record is too short for a run of ``duration`` s."""
        needed = duration + 4.0 * converter.T_s + 0.5 * 2.0 * math.pi / (0.8 * converter.omega_n)
        if needed > self.usable:
            raise InfeasibleStudyError(
                f"replay.file: the record has a voltage for {self.usable:.6g} s, and a case needs {needed:.6g} s. Take "
                "a longer one, or begin earlier in it."
            )

    def document(self) -> dict[str, Any]:
        """What the record was and what it says at the beginning."""
        return {
            "file": self.file,
            "begin_s": self.begin,
            "scale": self.scale,
            "V_g_rms": self.V_g_rms,
            "f_g": self.omega_g / (2.0 * math.pi),
            "phase": self.phase,
            "negative_sequence": self.seen.negative,
            "offset": self.seen.offset,
            "clipped": self.seen.clipped,
        }


_ALL, _EXAMPLE = "all of the file, or all its voltages", '["v_a", "v_b", "v_c"]'


class ReplayFields:
    """The fields of [replay]."""

    file: str = text(limits=".csv, .txt, .wav, .npz, .cfg, .dat, .cff, .inf or .out")
    """The record, relative to the study file. Of COMTRADE (.cfg with .dat, .cff) and PSCAD (.inf with .out) one of its
    files."""
    columns: tuple[str, ...] | None = names(
        (1, 3), '["v_a", "v_b", "v_c"]', default=None, limits="one or three", shown=_ALL
    )
    """The phases a, b, c by name or by number from 1 on. One phase stands for the other two a third and two thirds of a
    cycle later."""
    rate: float | None = number("Hz", 1.0, 1e8, default=None, shown="of the file", name="sampling_rate")
    """Where the file does not say it: a CSV without a column of times, an npz without a number `sampling_rate`."""
    scale: float = number("V", 1e-9, 1e9, hint=_SCALE, limits=f"1e-9 to 1e9, or `{RATED}`")
    """V for one unit of the file, phase to neutral; `rated`: such that the fundamental at the beginning is the rated
    voltage. A file of COMTRADE or PSCAD that says its units is in V, and `1 V` takes it as it is."""
    begin: float = number("s", 0.0, 1e7, default=0.0)
    """Where in the record the simulation begins, counted from the first instant that can be used."""


def _margins(record: Record, omega: float) -> tuple[float, float]:
    """Seconds at the beginning and at the end of a record that cannot be used, with ω at least as given (rad/s).

    An instant needs its neighbours, the phase that a log says needs half a cycle on either side, and one recorded phase
    stands for the other two a third and two thirds of a cycle later.
    """
    turn = 2.0 * math.pi / omega
    end = (NEIGHBOURS + 1) / record.rate + 0.5 * turn
    return end + (2.0 * (turn / 3.0) if record.values.shape[1] == 1 else 0.0), end


def _vectors(record: Record, omega: float, places: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Space vectors at times of the record, s."""
    if record.values.shape[1] == 3:
        phases = [interpolated(record.values[:, k], record.rate * places) for k in range(3)]
    else:
        third = 2.0 * math.pi / omega / 3.0
        phases = [interpolated(record.values[:, 0], record.rate * (places - k * third)) for k in range(3)]
    alpha, beta = clarke(*phases)
    return alpha + 1j * beta


def interpolated(values: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Samples (n) at places between them, in sampling intervals: a sum of sinc functions under a Kaiser window."""
    found = np.empty(len(places))
    offsets = np.arange(-NEIGHBOURS + 1, NEIGHBOURS + 1)
    for k in range(0, len(places), 4096):
        some = places[k : k + 4096]
        whole = np.floor(some).astype(np.int64)
        share = some - whole
        distance = share[:, None] - offsets
        weights = np.sinc(distance) * np.interp(np.abs(distance), *_window())
        found[k : k + 4096] = (weights * values[whole[:, None] + offsets]).sum(axis=1)
    return found


@functools.cache
def _window() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x = np.linspace(0.0, NEIGHBOURS, 20_001)
    return x, np.i0(_SHAPE * np.sqrt(1.0 - (x / NEIGHBOURS) ** 2)) / np.i0(_SHAPE)


def read_replay(table: TableReader | None, converter: Converter, duration: float) -> ReplaySpec | None:
    """The section; None where a study has none. The file is read, so that everything wrong with it is said too."""
    if table is None:
        return None
    told = len(table.faults)
    path = values(picked(ReplayFields, "file"), table)["file"]
    f_n = converter.omega_n / (2.0 * math.pi)
    scale = None
    if not table.has("scale"):
        table.fault("scale", None, "missing", _SCALE)
    if table.table.get("scale", RATED) == RATED:
        table.skip("scale")
    else:
        scale = values(picked(ReplayFields, "scale"), table)["scale"]
    rest = values(picked(ReplayFields, "columns", "sampling_rate", "begin"), table)
    spec = ReplaySpec(file=path, **rest, scale=1.0 if scale is None else scale)
    table.finish()
    if not path:
        return None
    try:
        record = read_record(spec.file, spec.columns, spec.rate)
        spec = replace(spec, files=record_files(spec.file))
    except RecordError as error:
        for field, problem, advice in error.faults:
            table.fault(field, table.table.get(field), problem, advice)
        return None
    if len(table.faults) > told or math.isnan(f_n + converter.T_s + converter.V_rated_rms):
        return None
    return _checked(table, spec, record, converter, duration, scale)


def _checked(
    table: TableReader,
    spec: ReplaySpec,
    record: Record,
    converter: Converter,
    duration: float,
    scale: float | None,
) -> ReplaySpec | None:
    """The specification with the fundamental of its beginning; None, with the faults told, where it cannot be used."""
    f_n, length = converter.omega_n / (2.0 * math.pi), len(record.values) / record.rate
    if record.rate < 6.0 * f_n:
        problem = f"{record.rate:.6g} Hz is fewer than six samples in a cycle of {f_n:g} Hz"
        table.fault("sampling_rate", None, problem, "Take a faster record, or correct the sampling rate.")
        return None
    before, after = _margins(record, 0.8 * converter.omega_n)
    begin = before + spec.begin
    needed = begin + max(duration + 4.0 * converter.T_s, _CYCLES / f_n) + after
    if not needed <= length:
        problem = f"the record is {length:.6g} s long, and {needed:.6g} s are needed"
        advice = f"Take a longer one, or shorten the simulation or begin by {needed - length:.3g} s."
        table.fault("file", spec.file, problem, advice)
        return None
    spec = replace(spec, origin=begin, usable=length - begin - (NEIGHBOURS + 1) / record.rate)
    t_s = np.arange(_CYCLES * PER_CYCLE) / (f_n * PER_CYCLE)
    beginning = [interpolated(column, record.rate * (spec.origin + t_s)) for column in record.values.T]
    seen, wrong = look_at(np.stack(beginning, axis=1), record.values, f_n)
    for problem, advice in wrong:
        table.fault("file", spec.file, problem, advice)
    if wrong:
        return None
    V_g_rms, omega, phase = _fundamental(spec, record, t_s, 2.0 * math.pi * seen.hz)
    V_rated = converter.V_rated_rms
    if scale is None:
        spec, V_g_rms = replace(spec, scale=V_rated / V_g_rms), V_rated
    if not 0.1 <= V_g_rms / V_rated <= 2.0:
        problem = f"the fundamental is {V_g_rms:.4g} V rms, {V_g_rms / V_rated:.3g} of the rated voltage"
        table.fault("scale", table.table["scale"], problem, _SCALE)
        return None
    return replace(spec, V_g_rms=V_g_rms, omega_g=omega, phase=phase, seen=seen)


def _fundamental(
    spec: ReplaySpec, record: Record, t_s: NDArray[np.float64], omega: float
) -> tuple[float, float, float]:
    """V_g rms, ω and phase at the beginning: of the windowed mean over the first cycles (times t_s), with the ω near
    the given one at which its phase does not move between both halves."""
    window, half = np.hanning(len(t_s) + 1)[:-1], len(t_s) // 2
    for _ in range(6):
        down = _vectors(record, omega, spec.origin + t_s) * np.exp(-1j * omega * t_s)
        early, late = ((down[part] * window[::2]).sum() for part in (slice(0, half), slice(half, None)))
        omega += float(np.angle(late * np.conj(early))) / (t_s[half] - t_s[0])
    down = _vectors(record, omega, spec.origin + t_s) * np.exp(-1j * omega * t_s)
    phasor = spec.scale * complex((down * window).sum() / window.sum())
    return peak_to_rms(abs(phasor)), omega, math.atan2(phasor.imag, phasor.real)
