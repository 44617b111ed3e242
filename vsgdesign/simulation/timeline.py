"""Events as data to a timeline: what grid, source and references hold at any instant; and source and grid of many runs
over time, piece by piece, as arrays."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.grid import grid_behind_load
from vsgdesign.equations.power_loops import References
from vsgdesign.simulation.wander import Replay, Wander
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.grid import PLAIN, Grid, GridSource, Network, SourceComponent
from vsgdesign.study.parameters.study import Event, Study

_T = TypeVar("_T")


@dataclass(frozen=True)
class SourceSegment:
    """The grid source from t_s on: V_g and ω_g with their slopes, and the phase at t_s."""

    t_s: float
    V_g_rms: float
    V_slope: float
    omega: float
    omega_slope: float
    phase: float

    def at(self, t_s: float) -> SourceSegment:
        """The same source, described from a later instant on."""
        dt = t_s - self.t_s
        return SourceSegment(
            t_s,
            self.V_g_rms + self.V_slope * dt,
            self.V_slope,
            self.omega + self.omega_slope * dt,
            self.omega_slope,
            self.phase + self.omega * dt + 0.5 * self.omega_slope * dt * dt,
        )

    @property
    def held(self) -> SourceSegment:
        """The same without its slopes."""
        return replace(self, V_slope=0.0, omega_slope=0.0)

    @property
    def steady(self) -> bool:
        """Neither amplitude nor frequency is being ramped."""
        return self.V_slope == 0.0 and self.omega_slope == 0.0


@dataclass(frozen=True)
class Timeline:
    """Piecewise descriptions, each sorted by time and starting at or before zero."""

    sources: tuple[SourceSegment, ...]
    grids: tuple[tuple[float, Grid], ...]
    references: tuple[tuple[float, References], ...]
    """The set points of the power loops."""
    components: tuple[tuple[float, tuple[SourceComponent, ...]], ...] = ((0.0, ()),)
    """What the source has besides its fundamental."""
    networks: tuple[tuple[float, Network], ...] = ((0.0, PLAIN),)
    """Load, fault and breaker."""
    links: tuple[tuple[float, DcLink], ...] = ()
    """The dc link and what feeds it; empty where it is ideal."""
    wander: Wander | None = field(default=None, compare=False)
    """By how much the fundamental differs from ``sources``: the study's background, where it has one."""
    replay: Replay | None = field(default=None, compare=False)
    """The recorded voltage that is the source, where the study has one; ``sources`` then holds its fundamental."""

    def source_at(self, t_s: float) -> SourceSegment:
        """The source described from t_s on (after a change at t_s), without what its background does over time."""
        return _last(self.sources, t_s, lambda s: s.t_s).at(t_s)

    def grid_at(self, t_s: float) -> Grid:
        """The grid from t_s on."""
        return _last(self.grids, t_s, lambda g: g[0])[1]

    def references_at(self, t_s: float) -> References:
        """The set points of the power loops from t_s on."""
        return _last(self.references, t_s, lambda r: r[0])[1]

    def components_at(self, t_s: float) -> tuple[SourceComponent, ...]:
        """What the source has besides its fundamental, from t_s on."""
        return _last(self.components, t_s, lambda c: c[0])[1]

    def network_at(self, t_s: float) -> Network:
        """Load, fault and breaker from t_s on."""
        return _last(self.networks, t_s, lambda n: n[0])[1]

    def link_at(self, t_s: float) -> DcLink | None:
        """The dc link from t_s on; None where it is ideal."""
        return _last(self.links, t_s, lambda one: one[0])[1] if self.links else None

    @property
    def islanded(self) -> bool:
        """Whether the breaker to the grid is open at any time."""
        return not all(network.connected for _, network in self.networks)

    def true_grid_at(self, t_s: float) -> Grid:
        """What an estimate is compared with from t_s on: the grid together with a load at the PCC, since nobody can
        tell the two apart there (:eq:`grid-behind-load`). NaN while the breaker is open or a fault is there."""
        network, grid = self.network_at(t_s), self.grid_at(t_s)
        if network.fault is not None or not network.connected:
            return Grid(math.nan, math.nan)
        if network.load is None:
            return grid
        omega = self.source_at(t_s).omega
        Y = network.load.admittance(omega)
        R, X, _, _ = grid_behind_load(grid.R_g, omega * grid.L_g, Y.real, Y.imag)
        return Grid(R, X / omega)

    def truth_changes(self) -> tuple[float, ...]:
        """Instants after the start at which an estimate finds another grid than before."""
        found = {t_s for t_s, _ in self.grids if t_s > 0.0}
        for (_, before), (t_s, after) in itertools.pairwise(self.networks):
            if t_s > 0.0 and (after.load != before.load or (before.connected, before.fault) != (True, None)):
                found.add(t_s)
        return tuple(t_s for t_s in sorted(found) if math.isfinite(self.true_grid_at(t_s).R_g))

    def plant_changes(self) -> tuple[float, ...]:
        """Instants at which the circuit or its source changes."""
        listed = (self.grids, self.components, self.networks)
        times = {s.t_s for s in self.sources} | {t for one in listed for t, _ in one}
        return tuple(sorted(times - {0.0}))

    def source_phase(self, t_s: NDArray[np.float64], slack: float = 0.0) -> NDArray[np.float64]:
        """Phase of the source's fundamental in rad at each instant of a sorted array. What a background or a record
        adds to it is that of the sample before the instant. An instant that lies at most ``slack`` (s) before a change
        of the source belongs to what comes after it."""
        cuts = np.searchsorted(t_s, [s.t_s - slack for s in self.sources[1:]]).tolist()
        phase = np.empty(len(t_s))
        for s, begin, end in zip(self.sources, [0, *cuts], [*cuts, len(t_s)], strict=True):
            dt = t_s[begin:end] - s.t_s
            part = phase[begin:end]
            np.multiply(dt, s.omega, out=part)
            part += s.phase
            if s.omega_slope != 0.0:
                part += 0.5 * s.omega_slope * dt * dt
        moving = self.wander or self.replay
        if moving is not None and len(t_s):
            phase += moving.angle_at(np.floor(t_s / moving.T_s + 1e-6).astype(np.int64))
        return phase


def _last(items: Sequence[_T], t_s: float, key: Callable[[_T], float]) -> _T:
    if len(items) == 1:
        return items[0]
    return items[max(bisect_right(items, t_s, key=key) - 1, 0)]


def build_timeline(study: Study) -> Timeline:
    """The timeline of a study's events.

    The published source is √2·V_g·sin(ωt) on phase A, so its space vector starts at −90°. A background adds its phase
    and its frequency and multiplies every voltage by its factor.
    """
    present, factor, offset, wander, replay = _at_start(study)
    sources = [present]
    grids = [(0.0, study.grid)]
    references = [(0.0, study.converter.references(study.simulation.P_ref, study.simulation.Q_ref))]
    components = [(0.0, study.grid_source.components)]
    networks = [(0.0, study.network)]
    V_end, omega_end = (math.inf, 0.0), (math.inf, 0.0)  # (end of the running ramp, value held from there)
    pending = sorted(study.events, key=lambda event: event.t_s)
    while pending or V_end[0] < math.inf or omega_end[0] < math.inf:
        t_event = pending[0].t_s if pending else math.inf
        t_s = min(t_event, V_end[0], omega_end[0])
        now = present.at(t_s)
        V, V_slope, omega, omega_slope, phase = now.V_g_rms, now.V_slope, now.omega, now.omega_slope, now.phase
        if t_s == V_end[0]:
            V, V_slope, V_end = V_end[1], 0.0, (math.inf, 0.0)
        if t_s == omega_end[0]:
            omega, omega_slope, omega_end = omega_end[1], 0.0, (math.inf, 0.0)
        if t_s == t_event:
            event = pending.pop(0)
            phase += event.phase_jump
            if event.V_g_rms is not None:
                V, V_slope, V_end = _ramp(V, factor * event.V_g_rms, event)
            if event.omega_g is not None:
                omega, omega_slope, omega_end = _ramp(omega, event.omega_g + offset, event)
            if event.grid is not None:
                grids.append((t_s, event.grid))
            if event.components is not None:
                components.append((t_s, event.components))
            if event.network is not None:
                networks.append((t_s, event.network))
            if event.set_points:
                references.append((t_s, references[-1][1]._replace(**event.set_points)))
        changed = SourceSegment(t_s, V, V_slope, omega, omega_slope, phase)
        if changed != now:
            present = changed
            sources = [s for s in sources if s.t_s < t_s or s.t_s == 0.0 < t_s] + [changed]
    held = (sources, grids, references, components, networks, _links(study))
    return Timeline(*map(tuple, held), wander, replay)  # type: ignore[arg-type]


def _links(study: Study) -> list[tuple[float, DcLink]]:
    """The dc link from each instant on at which its source changes; none where it is ideal."""
    if study.dc is None:
        return []
    found, now = [(0.0, study.dc)], dict[str, float]()
    for event in sorted(study.events, key=lambda event: event.t_s):
        if event.of_dc:
            now |= event.of_dc
            found.append((event.t_s, study.dc.after(now)))
    return found


def _at_start(study: Study) -> tuple[SourceSegment, float, float, Wander | None, Replay | None]:
    """The source at t = 0, the factor and the offset (rad/s) of all its voltages and frequencies, and what moves it
    besides the events."""
    c, source, background, phase = study.converter, study.grid_source, study.background, -0.5 * math.pi
    factor, offset, wander, replay = 1.0, 0.0, None, None
    if study.replay is not None:
        played = study.replay
        source, phase, replay = GridSource(played.V_g_rms, played.omega_g), played.phase, Replay(played, c.T_s)
    elif background is not None:
        factor, offset = background.voltage_factor, 2.0 * math.pi * background.frequency_offset
        phase, wander = background.phase + phase, Wander(background, c.T_s, c.omega_n)
    first = SourceSegment(0.0, factor * source.V_g_rms, 0.0, source.omega_g + offset, 0.0, phase)
    return first, factor, offset, wander, replay


def _ramp(value: float, goal: float, event: Event) -> tuple[float, float, tuple[float, float]]:
    """(value, slope, (end, final value)) after an event that steps or ramps to ``goal``."""
    if event.over == 0.0:
        return goal, 0.0, (math.inf, 0.0)
    return value, (goal - value) / event.over, (event.t_s + event.over, goal)


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
