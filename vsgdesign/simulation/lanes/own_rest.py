"""Figures of a switched bridge, which is judged by the rest that it comes to itself.

Its powers ripple, so their means over a cycle are judged, and it rests beside the averaged bridge. Where it rests is
known at the end of a run alone: the means are logged until then. It is what :func:`vsgdesign.metrics.measure_event` and
:func:`vsgdesign.simulation.survival.running.judge_scenario` do with one run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.events import SIGMAS, late_rows, noise_left
from vsgdesign.metrics.step_response import SETTLING_BAND, cycle_mean
from vsgdesign.metrics.survival import SurvivalDemand
from vsgdesign.simulation.batch import Log
from vsgdesign.simulation.lanes.cases import STEP, LaneCases
from vsgdesign.simulation.lanes.part import PROTECTION_COLUMNS, Watched, first_judged
from vsgdesign.simulation.lanes.rests import Rests
from vsgdesign.simulation.lanes.results import IN_NOISE, LaneResults, LastEntry
from vsgdesign.simulation.survival.running import OWN_REST_CYCLES, own_powers

Array = NDArray[np.float64]
Samples = NDArray[np.int64]

LOG_BYTES = 256_000_000
"""Memory for the logs of the lanes that run at once."""

_LANES = 16
"""Lanes of a group: fewer at once save nothing."""

_ROWS = 2048
"""Rows of a log that are looked at together."""


def pieces(
    ends: Samples,
    cases: LaneCases,
    T_s: float,
    *,
    own_rest: bool = True,
    guarded: bool = False,
    beside: bool = False,
    units: int = 1,
) -> Iterator[NDArray[np.intp]]:
    """The cases, which run for ``ends`` samples, in pieces whose logs have room in LOG_BYTES together, by index.

    ``own_rest``: whether the means of the powers are logged; ``guarded``: whether disturbances are judged by a
    protection, too; ``beside``: whether steps have twins; ``units``: how many are judged in each case.
    """
    first = np.where(guarded & (cases.kind != STEP), 0, first_judged(cases, T_s))
    order = np.lexsort((first, cases.kind))
    begin = 0
    while begin < len(order):
        left = order[begin:]
        left = left[cases.kind[left] == cases.kind[left[0]]]
        slots = np.maximum.accumulate(ends[left]) + 1 - first[left[0]]
        step = cases.kind[left[0]] == STEP
        logged = max((1 + beside if step else 2) * own_rest + PROTECTION_COLUMNS * (guarded and not step), 1) * units
        room = int(np.searchsorted(8 * logged * slots * np.arange(1, len(left) + 1), LOG_BYTES, side="right"))
        count = min(max(room // _LANES, 1) * _LANES, len(left))
        yield left[:count]
        begin += count


def judge_steps(part: Watched, found: LaneResults) -> None:
    """Overshoot and settling time of each step, by the mean over a nominal cycle, or by its difference from that of its
    twin (:eq:`twin`)."""
    T_s, log_begin = part.study.converter.T_s, _logged(part).begin
    begin = first_judged(part.cases, T_s)
    final = part.watched("late") / late_rows(part.ends - begin, part.cycle_at_end)
    t_s = part.cases.events.t_s[:, 0]
    for lanes, power in _groups(part):
        log = cycle_mean(power.T, part.cycle).T
        start = log[np.maximum(begin[lanes] - 1 - log_begin, 0), 0, np.arange(log.shape[2])]
        step = final[lanes] - start
        if part.beside:
            twins, lanes = slice(lanes.start + 1, lanes.stop, 2), slice(lanes.start, lanes.stop, 2)
            start, step = np.zeros(log.shape[2] // 2), final[lanes] - final[twins]
            difference = log[:, :, ::2] - log[:, :, 1::2]
            for k, (first, end) in enumerate(zip(begin[lanes].tolist(), part.ends[lanes].tolist(), strict=True)):
                rows = slice(first - log_begin, end - log_begin)
                left = noise_left(difference[rows, 0, k], log[rows, 0, 2 * k + 1], part.cycle)
                found.noise[lanes.start + 2 * k] = SIGMAS * left / abs(step[k])
            log = difference

        def error(means: Array, start: Array = start, step: Array = step) -> Array:
            return np.abs((means[..., 0, :] - start) / step - 1.0)

        _cut(log, begin[lanes] - log_begin, part.ends[lanes] - log_begin)
        most = (np.where(step > 0.0, log[:, 0].max(axis=0), log[:, 0].min(axis=0)) - start) / step
        found.overshoot[lanes] = np.maximum(most - 1.0, 0.0)
        entry = _last_entry(log, log_begin, begin[lanes], part.ends[lanes], error, SETTLING_BAND)
        found.settling_s[lanes] = entry.time(SETTLING_BAND, T_s, t_s[lanes])
    found.status[found.noise > SETTLING_BAND] = IN_NOISE


def recovered(part: Watched, rests: Rests, demand: SurvivalDemand) -> Array:
    """Time from the clearing on from which the means of P and Q over a cycle stay at the rest, s (n,)."""
    T_s, S = part.study.converter.T_s, part.study.converter.S_rated
    begin, cycle, log_begin = first_judged(part.cases, T_s), part.cycle, _logged(part).begin
    averaged = np.stack([rests.P_end, rests.Q_end])[:, part.index]
    recovery = np.empty(len(part))
    for lanes, log in _groups(part):
        width = len(part.ends[lanes])
        ends = part.ends[lanes] - log_begin
        rest = averaged[:, lanes].copy()
        for k in range(width):
            own = log[ends[k] - (OWN_REST_CYCLES - 1) * cycle : ends[k], :, k].mean(axis=0) / cycle
            rest[:, k] = own_powers(own[0], own[1], rest[0, k], rest[1, k], S)

        def error(sums: Array, rest: Array = rest) -> Array:
            return np.abs(sums / cycle - rest).max(axis=-2) / S

        entry = _last_entry(log, log_begin, begin[lanes], part.ends[lanes], error, demand.band)
        recovery[lanes] = entry.time(demand.band, T_s, part.cases.cleared_s[lanes])
    return recovery


def _logged(part: Watched) -> Log:
    if part.means is None:
        raise ValueError("the means of this part were not logged")
    return part.means


def _groups(part: Watched) -> Iterator[tuple[slice, Array]]:
    """The lanes of each group of a part, with their log of the means (S, n, W)."""
    return part.logged(slice(-PROTECTION_COLUMNS if part.guarded else None))


def _cut(log: Array, begin: Samples, end: Samples) -> None:
    """Leaves the rows ``begin`` to ``end`` − 1 of each lane, (W,), of a log (S, n, W): those around them repeat the
    first and the last."""
    for k, (first, stop) in enumerate(zip(begin.tolist(), end.tolist(), strict=True)):
        log[:first, :, k] = log[first, :, k]
        log[stop:, :, k] = log[stop - 1, :, k]


def _last_entry(
    log: Array, log_begin: int, begin: Samples, end: Samples, error: Callable[[Array], Array], band: float
) -> LastEntry:
    """When the signal of each lane, (W,), entered its band for the last time, from the samples ``begin`` to ``end`` −
    1 of its log (S, n, W), whose first is sample ``log_begin``. ``error``: from (…, n, W) to (…, W)."""
    lanes, last = np.arange(len(begin)), np.full(len(begin), -1)
    for stop in range(int(end.max()) - log_begin, int(begin.min()) - log_begin, -_ROWS):
        rows = np.arange(max(stop - _ROWS, 0), stop)
        samples = log_begin + rows[:, None]
        outside = (error(log[rows[0] : stop]) > band) & (samples >= begin) & (samples < end)
        here = outside.any(axis=0) & (last < 0)
        last[here] = (rows[-1] - np.argmax(outside[::-1], axis=0))[here]
        if (last >= 0).all():
            break
    after = np.minimum(last + 1, end - 1 - log_begin)
    out, into = (error(log[rows, :, lanes].T) for rows in (np.maximum(last, 0), after))
    return LastEntry(
        last_out=np.where(last < 0, -1.0, last + float(log_begin)),
        error_out=out,
        error_in=into,
        was_out=1.0 * (last == end - 1 - log_begin),
    )
