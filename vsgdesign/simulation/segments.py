"""The source and the grid of many runs over time: piece by piece, as arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.simulation.timeline import Timeline

Array = NDArray[np.float64]

START_PHASE = -0.5 * math.pi
"""Angle of the source's space vector at t = 0, rad: that of every run (:func:`vsgdesign.simulation.timeline`)."""


class Waves(NamedTuple):
    """What the sources of many runs have besides their fundamental and turns with it: arrays (N, W)."""

    order: Array
    """How often it turns while the fundamental turns once; negative: backwards."""
    size: Array
    """V peak."""
    phase: Array
    """Where it is when the fundamental is at zero, rad."""

    def at(self, phase: Array) -> Array:
        """Where they are, rad (N, W), when the fundamental is at these angles (N,)."""
        return self.order * phase[:, None] + self.phase

    def take(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Waves:
        """Those of some runs."""
        return Waves(*(values[chosen] for values in self))


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


def last_before(segments: Segments, t_s: Array) -> Segments:
    """The segment of every lane that holds right before an instant (N,), described from it on."""
    index = np.maximum((segments.t_s < t_s[:, None]).sum(axis=1) - 1, 0)
    rows = np.arange(len(t_s))
    return segments.at_column(rows, index).at(t_s)
