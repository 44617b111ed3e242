"""The source and the grid of many lanes over time: piece by piece, as arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.timeline import Timeline

Array = NDArray[np.float64]

START_PHASE = -0.5 * math.pi
"""Angle of the source's space vector at t = 0, rad: that of every run (:func:`vsgdesign.simulation.timeline`)."""


class Segments(NamedTuple):
    """What holds from an instant on: arrays (N, M) in ascending order of time, or (N,) of one instant each. Entries
    that are not used are at t = inf."""

    t_s: Array
    R_g: Array
    L_g: Array
    V_g_rms: Array
    V_slope: Array
    """V/s"""
    omega: Array
    omega_slope: Array
    """rad/s²"""
    phase: Array
    """Of the source at t_s, rad, after a jump."""
    place: Any
    """Which of a list of circuits it is (:class:`vsgdesign.simulation.circuits.Circuits`); 0 where there is no list."""

    def column(self, k: int) -> Segments:
        """The k-th segment of every lane, (N,)."""
        return Segments(*(values[:, k] for values in self))

    def at_column(self, rows: NDArray[np.intp], column: NDArray[np.intp]) -> Segments:
        """One segment of each of these lanes, (n,)."""
        return Segments(*(values[rows, column] for values in self))

    def take(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Segments:
        """Some lanes."""
        return Segments(*(values[chosen] for values in self))

    def at(self, t_s: Any) -> Segments:
        """The same source and grid, described from a later instant on, s (N,); of (N,) segments."""
        dt = t_s - self.t_s
        return self._replace(
            t_s=t_s,
            V_g_rms=self.V_g_rms + self.V_slope * dt,
            omega=self.omega + self.omega_slope * dt,
            phase=self.phase + self.omega * dt + 0.5 * self.omega_slope * dt * dt,
        )


def segments_of(cases: LaneCases) -> Segments:
    """The segments of every lane: one from the start on, one from each event on, and one from the end of each ramp on.

    An event that changes no more than a reference has none.
    """
    count, events = len(cases), cases.events
    rows = np.arange(count)
    present = Segments(
        t_s=np.zeros(count),
        R_g=cases.R_g.astype(float),
        L_g=cases.L_g.astype(float),
        V_g_rms=cases.V_g_rms.astype(float),
        V_slope=np.zeros(count),
        omega=cases.omega_g.astype(float),
        omega_slope=np.zeros(count),
        phase=np.full(count, START_PHASE),
        place=np.zeros(count, dtype=np.int64),
    )
    found = [present]
    # The end of the ramp that runs, and the value that is held from there on.
    V_end_s, V_goal = np.full(count, np.inf), np.zeros(count)
    omega_end_s, omega_goal = np.full(count, np.inf), np.zeros(count)
    following = np.zeros(count, dtype=np.intp)
    padded = {name: np.column_stack([getattr(events, name), np.full(count, np.nan)]) for name in _OF_PLANT}
    times = np.column_stack([events.t_s, np.full(count, np.inf)])
    while True:
        event_s = times[rows, following]
        t_s = np.minimum(event_s, np.minimum(V_end_s, omega_end_s))
        some = np.isfinite(t_s)
        if not some.any():
            break
        now = present.at(np.where(some, t_s, present.t_s))
        V, V_slope, omega, omega_slope, phase = now.V_g_rms, now.V_slope, now.omega, now.omega_slope, now.phase
        ends = some & (t_s == V_end_s)
        V, V_slope, V_end_s = np.where(ends, V_goal, V), np.where(ends, 0.0, V_slope), np.where(ends, np.inf, V_end_s)
        ends = some & (t_s == omega_end_s)
        omega, omega_slope = np.where(ends, omega_goal, omega), np.where(ends, 0.0, omega_slope)
        omega_end_s = np.where(ends, np.inf, omega_end_s)
        comes = some & (t_s == event_s)
        given = {name: np.where(comes, values[rows, following], np.nan) for name, values in padded.items()}
        phase = phase + np.where(comes, np.nan_to_num(given["phase_jump"]), 0.0)
        over = np.where(comes, np.nan_to_num(given["over"]), 0.0)
        V, V_slope, V_end_s, V_goal = _ramped(V, V_slope, V_end_s, V_goal, given["V_g_rms"], over, t_s)
        omega, omega_slope, omega_end_s, omega_goal = _ramped(
            omega, omega_slope, omega_end_s, omega_goal, given["omega_g"], over, t_s
        )
        jumps = np.isfinite(given["R_g"])
        present = Segments(
            t_s=now.t_s,
            R_g=np.where(jumps, given["R_g"], now.R_g),
            L_g=np.where(jumps, given["L_g"], now.L_g),
            V_g_rms=V,
            V_slope=V_slope,
            omega=omega,
            omega_slope=omega_slope,
            phase=phase,
            place=now.place,
        )
        following = following + comes
        changed = some & np.any([new != old for new, old in zip(present[1:], now[1:], strict=True)], axis=0)
        found.append(present._replace(t_s=np.where(changed, t_s, np.inf)))
    stacked = Segments(*(np.stack(values, axis=1) for values in zip(*found, strict=True)))
    order = np.argsort(stacked.t_s, axis=1, kind="stable")
    most = int(np.isfinite(stacked.t_s).sum(axis=1).max(initial=1))
    return Segments(*(np.take_along_axis(values, order, axis=1)[:, :most] for values in stacked))


def segments_of_timelines(timelines: Sequence[Timeline], place: Callable[[Timeline, float], int]) -> Segments:
    """The segments of runs with timelines of their own. ``place``: which circuit it is from an instant on."""
    found = []
    for one in timelines:
        instants = [0.0, *one.plant_changes()]
        found.append([(one.source_at(t_s).at(t_s), one.grid_at(t_s), place(one, t_s)) for t_s in instants])
    most = max(map(len, found))
    values = np.zeros((len(found), most, 9))
    values[:, :, 0] = np.inf
    for run, segments in enumerate(found):
        for k, (s, grid, at) in enumerate(segments):
            values[run, k] = s.t_s, grid.R_g, grid.L_g, s.V_g_rms, s.V_slope, s.omega, s.omega_slope, s.phase, at
    parts = [values[:, :, k] for k in range(8)]
    return Segments(*parts, place=values[:, :, 8].astype(np.int64))


_OF_PLANT = ("R_g", "L_g", "V_g_rms", "omega_g", "over", "phase_jump")


def _ramped(
    value: Array, slope: Array, end_s: Array, held: Array, goal: Array, over: Array, t_s: Array
) -> tuple[Array, Array, Array, Array]:
    """Value, slope, end and final value after an event that steps or ramps to ``goal`` (NaN: does not)."""
    steps, ramps = np.isfinite(goal) & (over == 0.0), np.isfinite(goal) & (over > 0.0)
    safe = np.where(ramps, over, 1.0)
    return (
        np.where(steps, goal, value),
        np.where(steps, 0.0, np.where(ramps, (goal - value) / safe, slope)),
        np.where(steps, np.inf, np.where(ramps, t_s + over, end_s)),
        np.where(ramps, goal, held),
    )


def last_before(segments: Segments, t_s: Array) -> Segments:
    """The segment of every lane that holds right before an instant (N,), described from it on."""
    index = np.maximum((segments.t_s < t_s[:, None]).sum(axis=1) - 1, 0)
    rows = np.arange(len(t_s))
    return segments.at_column(rows, index).at(t_s)
