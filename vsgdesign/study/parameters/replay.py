"""The [replay] section: a recorded voltage that takes the place of the grid's source."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import clarke, peak_to_rms
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import names, number, picked, text, values
from vsgdesign.study.parameters.reader import TableReader
from vsgdesign.study.parameters.record import Record, read_record, record_files
from vsgdesign.study.parameters.record_columns import RecordError
from vsgdesign.study.parameters.replay_checks import NOTHING_SEEN, PER_CYCLE, Seen, look_at

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
