"""Disturbances as data: per unit of a converter, so that one set of them serves every converter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.background import BackgroundSpec
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.event import BASIS, Event
from vsgdesign.study.parameters.grid import Grid, GridSource, Place
from vsgdesign.study.parameters.sensors import SensorSpec
from vsgdesign.study.parameters.study import Study

LEAD_S = 0.1
"""A run is at rest for this long before its disturbance begins, s."""

LEARNING_S = 1.6
"""The same where an estimator that is told nothing has to learn its grid first, s."""

FOR_EVER = math.inf
"""``GridKnowledge.silent_s`` of an estimator that never answers again."""


@dataclass(frozen=True, kw_only=True)
class GridState:
    """A grid and the references on it, per unit."""

    scr: float
    x_over_r: float
    P_pu: float
    Q_pu: float
    V_g_pu: float = 1.0
    df_hz: float = 0.0
    """Frequency of the grid above nominal, Hz."""


@dataclass(frozen=True, kw_only=True)
class GridKnowledge:
    """What the scheduler is told of the grid: how late it is told, and how wrong."""

    silent_s: float = 0.02
    """After every change of the grid or its source the estimator gives no answer for this long, s. The schedule is
    stale for this time. FOR_EVER: it never answers again."""
    magnitude: float = 1.0
    """Estimated |Z| over the true one, at all times."""
    angle_deg: float = 0.0
    """Estimated angle of Z minus the true one, degrees, at all times."""

    def seen(self, grid: Grid, omega_n: float) -> Grid:
        """The estimate of a grid. Its resistance and inductance are never negative."""
        if self.exact:
            return grid
        Z = complex(grid.R_g, omega_n * grid.L_g)
        turned = self.magnitude * abs(Z)
        angle = math.atan2(Z.imag, Z.real) + math.radians(self.angle_deg)
        return Grid(max(turned * math.cos(angle), 0.0), max(turned * math.sin(angle), 0.0) / omega_n)

    @property
    def exact(self) -> bool:
        """Whether the estimate has no error where there is one."""
        return self.magnitude == 1.0 and self.angle_deg == 0.0


@dataclass(frozen=True, kw_only=True)
class SurvivalCase:
    """One disturbance of a converter that is at rest, and what is known of the grid."""

    group: str
    """Which class of disturbances it belongs to, for the tables."""
    start: GridState
    changes: tuple[Event, ...]
    """Per unit, in the order of time after the beginning of the disturbance."""
    cleared_s: float
    """When the last change is over, s after the beginning of the disturbance."""
    knowledge: GridKnowledge = GridKnowledge()
    lead_s: float = LEAD_S
    """For how long the converter is at rest before the disturbance, s."""
    draw: int | None = None
    """Seed with which the study's background and sensors are drawn anew for this case; None: those of the study."""

    def __post_init__(self) -> None:
        faults = list(_faults(self))
        if faults:
            raise ValueError(f"case of group {self.group}: {' '.join(faults)}")

    @property
    def name(self) -> str:
        """The case in words, such as ``SCR 1.5, X/R 3, P 0.5, Q 0: SCR 20, X/R 3; stale 0.2 s``."""
        s, k = self.start, self.knowledge
        head = f"SCR {s.scr:.3g}, X/R {s.x_over_r:.3g}, P {s.P_pu:.3g}, Q {s.Q_pu:.3g}"
        head += f", V_g {s.V_g_pu:.3g}" * (s.V_g_pu != 1.0) + f", {s.df_hz:+.3g} Hz" * (s.df_hz != 0.0)
        parts = [f"{change.words_pu} at {change.t_s:.4g} s" for change in self.changes]
        known = "for ever" if math.isinf(k.silent_s) else f"{k.silent_s:.3g} s"
        error = "" if k.exact else f", |Z| × {k.magnitude:.3g}, arg Z {k.angle_deg:+.3g}°"
        return f"{head}: {'; '.join(parts)}; stale {known}{error}"

    @property
    def for_ever(self) -> bool:
        """Whether the schedule stays stale for ever."""
        return math.isinf(self.knowledge.silent_s)

    @property
    def largest_phase_deg(self) -> float:
        """Largest jump of the phase, degrees."""
        return max(abs(change.phase_deg) for change in self.changes)

    @property
    def instants_s(self) -> tuple[float, ...]:
        """Times of a run at which something changes suddenly, s; the end of a ramp does not."""
        return tuple(self.lead_s + change.t_s for change in self.changes)

    def within(self, scr: tuple[float, float], x_over_r: tuple[float, float]) -> bool:
        """Whether every grid of the case lies within these limits; SCR on the basis of the cases."""
        places = [change.place for change in self.changes if change.place is not None]
        return all(
            scr[0] <= one.scr <= scr[1] and x_over_r[0] <= one.x_over_r <= x_over_r[1] for one in (self.start, *places)
        )

    @property
    def scr_at_the_end(self) -> float:
        """Short-circuit ratio after the last change."""
        return next((one.place.scr for one in reversed(self.changes) if one.place is not None), self.start.scr)

    def study(self, study: Study, after_s: float) -> Study:
        """The study with the start and the events of this case, for ``after_s`` s after the clearing."""
        c, s = study.converter, self.start
        return replace(
            study,
            background=_redrawn(study.background, self.draw),
            sensors=_redrawn(study.sensors, self.draw),
            grid=Place(s.scr, s.x_over_r, BASIS).grid(c),
            grid_source=GridSource(s.V_g_pu * c.V_rated_rms, c.omega_n + 2.0 * math.pi * s.df_hz),
            events=tuple(_event(c, change, self.lead_s) for change in self.changes),
            simulation=replace(
                study.simulation,
                duration=self.lead_s + self.cleared_s + after_s,
                start="steady_state",
                log_interval=c.T_s,
                P_ref=s.P_pu * c.S_rated,
                Q_ref=s.Q_pu * c.S_rated,
            ),
        )

    def told(self, study: Study, timeline: Timeline) -> tuple[tuple[float, Grid | None], ...]:
        """What the estimator says from each instant of a run on; None: it gives no answer."""
        omega_n = study.converter.omega_n
        said: list[tuple[float, Grid | None]] = [(0.0, self.knowledge.seen(timeline.grid_at(0.0), omega_n))]
        silent = [self.lead_s + change.t_s for change in self.changes if change.of_grid]
        for k, instant in enumerate(silent):
            said.append((instant, None))
            answer_s = instant + self.knowledge.silent_s
            if self.for_ever:
                break
            if k + 1 == len(silent) or answer_s < silent[k + 1]:
                said.append((answer_s, self.knowledge.seen(timeline.grid_at(instant + 1e-9), omega_n)))
        return tuple(said)


_Drawn = TypeVar("_Drawn", BackgroundSpec | None, SensorSpec | None)


def _redrawn(spec: _Drawn, seed: int | None) -> _Drawn:
    return spec if spec is None or seed is None else spec.redrawn(seed)


def _event(c: Converter, change: Event, lead_s: float) -> Event:
    event = replace(change.on(c, lead_s), name=change.words_pu)
    if change.df_hz is None:
        return event
    # The frequency has been rounded in this order in every measurement so far, which a study file does not.
    return replace(event, omega_g=c.omega_n + 2.0 * math.pi * change.df_hz)


def _faults(case: SurvivalCase) -> Any:
    times = [change.t_s for change in case.changes]
    if not times or times != sorted(times) or times[0] < 0.0:
        yield f"changes at {times} s: there must be at least one, in the order of time and not before zero."
    elif case.cleared_s < max(change.end_s for change in case.changes):
        yield f"cleared_s = {case.cleared_s:g} s: must not be before the end of the last change."
    for change in case.changes:
        if not (change.of_grid or change.set_points or change.of_dc):
            yield f"the change at {change.t_s:g} s changes nothing."
    start = Place(case.start.scr, case.start.x_over_r, BASIS)
    for place in (start, *(change.place for change in case.changes if change.place is not None)):
        if not (place.scr > 0.0 and place.x_over_r >= 0.0):
            yield f"SCR {place.scr}, X/R {place.x_over_r}: SCR must be above and X/R at or above zero."
    if not case.lead_s > 0.0:
        yield f"lead_s = {case.lead_s}: must be positive."
    if not case.knowledge.silent_s >= 0.0:
        yield f"silent_s = {case.knowledge.silent_s}: must not be negative."
    if not case.knowledge.magnitude > 0.0:
        yield f"magnitude = {case.knowledge.magnitude}: must be positive."
