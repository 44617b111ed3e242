"""Disturbances as data, per unit of a converter, so that one set of them serves every converter; and what each asks of
a converter: by when it must be at rest, and below which current."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.metrics.survival import GRACE_S, SETTLING_TIMES, ExpectedRest, SurvivalDemand
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.study.parameters.background import BackgroundSpec
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.event import BASIS, Event
from vsgdesign.study.parameters.grid import Grid, GridSource, Place
from vsgdesign.study.parameters.sensors import SensorSpec
from vsgdesign.study.parameters.study import ControllerSpec, Study

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


SETTLING_TIMES_FOR_EVER = 3.0
"""The deadline in settling times for a schedule that stays stale for ever (:func:`settling_times_asked`)."""


def settling_time_of(spec: ControllerSpec, ready: Ready) -> float:
    """T of a controller: that of its table's specification, or of its closed form, s."""
    table = ready.table(spec)
    if table is not None and "settling_time" in table.specification:
        return float(table.specification["settling_time"])
    return spec.target.settling_time


def silent_s_of(spec: ControllerSpec) -> float:
    """For how long a controller is told nothing after a change of the grid, s; 0 where it is told at once or finds the
    grid by itself."""
    return 0.0 if spec.knowledge is None else spec.knowledge.silent_s


def settling_times_asked(silent_s: Any, settling_time: float) -> Any:
    """The deadline in settling times T (s) for a schedule that is silent for ``silent_s`` after a change; an array or a
    number.

    A schedule that is silent until after the longest deadline, 3 T + 0.2 s, stays stale for ever as far as a run can
    tell, and has this deadline. All others have 2 T + 0.2 s.
    """
    for_ever = np.asarray(silent_s) >= SETTLING_TIMES_FOR_EVER * settling_time + GRACE_S
    return np.where(for_ever, SETTLING_TIMES_FOR_EVER, SETTLING_TIMES)


def demand_of(
    converter: Converter,
    settling_time: float,
    *,
    silent_s: float = 0.0,
    limit_pu: float | None = None,
    cycle_s: float | None = None,
) -> SurvivalDemand:
    """What is asked of a converter whose power loops have the settling time T (s).

    ``silent_s``: for how long its schedule is told nothing after a change, s, which decides the deadline. ``limit_pu``:
    limit of its current; None: the converter's own. ``cycle_s``: period of the grid at the end, s; None: nominal.
    """
    return SurvivalDemand(
        S_rated=converter.S_rated,
        settling_time=settling_time,
        cycle_s=2.0 * math.pi / converter.omega_n if cycle_s is None else cycle_s,
        i_max_pu=converter.current_limit_pu if limit_pu is None else limit_pu,
        settling_times=float(settling_times_asked(silent_s, settling_time)),
    )


LEAST_SHARE = 0.8
"""A converter at its limit must still carry this share of the power that is asked for, or of what the grid carries with
this current where that is less. It is this project's choice; a converter that has latched up carries about half."""

_LAST_S = 0.1
"""Means at the end of a run are over this time, s."""


def held_fault(study: Study, simulation: Simulation, asked: ExpectedRest) -> str | None:
    """Why a converter at rest at its current limit has latched up; None: it does what its current allows.

    ``asked`` is the rest without a limit. A power loop that still integrates while the limiter holds the current leaves
    the limits of the voltage, or the converter carries far less than it could. In a grid whose voltage is below its
    limits the current may be reactive, so that the power is not looked at. The largest power is V_g·I − R·I² at the
    limit if the converter takes it, and about V_g·I if it sends it, at unity power factor.
    """
    c, timeline, end_s = study.converter, simulation.timeline, study.simulation.duration
    limit_pu = c.current_limit_pu
    if limit_pu is None:
        return None
    rows = max(round(_LAST_S / float(simulation.each_s[1] - simulation.each_s[0])), 1)
    V_pu, P_pu = (
        float(np.mean(simulation.each(name)[-rows:])) / base
        for name, base in (("V_rms", c.V_rated_rms), ("P", c.S_rated))
    )
    if not c.V_min_pu <= V_pu <= c.V_max_pu:
        return (
            f"held by its limiter with a voltage reference of {V_pu:.3g} pu, outside of {c.V_min_pu:g} to "
            f"{c.V_max_pu:g} pu"
        )
    source, network = timeline.source_at(end_s), timeline.network_at(end_s)
    V_g = source.V_g_rms / c.V_rated_rms
    if network.load is not None or not network.connected or V_g < c.V_min_pu:
        return None
    asked_pu = asked.P / c.S_rated
    if asked.obstacle is not None:  # then the droops ask for what was set, if the frequency is nominal
        if not math.isclose(source.omega, c.omega_n, rel_tol=1e-9):
            return None
        asked_pu = timeline.references_at(end_s).P_ref / c.S_rated
    most = V_g * limit_pu
    if asked_pu < 0.0:
        R = study.path_to_grid(timeline.grid_at(end_s), c.omega_n)[0] / c.Z_base
        i = min(limit_pu, V_g / (2.0 * R)) if R > 0.0 else limit_pu
        most = V_g * i - R * i * i
    needed = LEAST_SHARE * min(abs(asked_pu), most)
    if P_pu * math.copysign(1.0, asked_pu) >= needed:
        return None
    return (
        f"held by its limiter at P = {P_pu:.3g} pu: {asked_pu:.3g} pu is asked for, and the grid carries {most:.3g} pu "
        f"with this current; at least {LEAST_SHARE:g} of the smaller one is asked of a converter at its limit"
    )


BAND, BAND_PER_SCR = 0.03, 0.005
"""How far the means of P and Q may be from the rest, as a share of S_rated: a stiff grid's wander moves more power."""

SHARE_INSIDE = 0.95

ROOM = 0.95 / 1.2
"""Largest current of a rest that is asked for where the grid has harmonics, as a share of the limit: theirs come on top
of it."""

CYCLES = 2
"""Powers are judged by their means over so many nominal cycles."""


def field_demand(scr: float, omega_n: float) -> dict[str, Any]:
    """What differs from the demand in a clean grid. ``scr``: of the grid at the end."""
    return {
        "band": BAND + BAND_PER_SCR * scr,
        "share_inside": SHARE_INSIDE,
        "cycle_s": CYCLES * 2.0 * np.pi / omega_n,
    }


def field_cases(cases: tuple[SurvivalCase, ...], seed: int, lead_s: float = LEARNING_S) -> Iterator[SurvivalCase]:
    """The cases, each with a background and sensors of its own and with time to learn the grid before the event."""
    for k, case in enumerate(cases):
        yield replace(case, lead_s=lead_s, draw=int(np.random.SeedSequence([seed, k]).generate_state(1)[0] >> 1))


def at_asked_powers(study: Study, spec: ControllerSpec, ready: Ready) -> Study:
    """The study with references for which it begins at the powers that it asks for.

    The droops answer to the background's voltage and frequency: at 0.5 Hz beside the nominal one a droop of 5 % moves P
    by 0.2 pu. Where the grid cannot carry these powers, nothing is changed, and the case has no rest.
    """
    source, c, at = build_timeline(study).source_at(0.0), study.converter, study.simulation
    grid, wanted = study.grid, (at.P_ref, at.Q_ref)
    V_rms, _ = operating_point(*wanted, source.V_g_rms, *study.path_to_grid(grid, source.omega))
    gains = gain_law(study, spec, ready)(grid.R_g, grid.L_g, *wanted, float(V_rms))
    moved = float(gains.D_p * (source.omega - c.omega_n)), float(gains.D_q * (V_rms - c.V_rated_rms))
    if not np.isfinite(moved).all():
        return study
    events = tuple(
        replace(
            event,
            P_ref=None if event.P_ref is None else event.P_ref + moved[0],
            Q_ref=None if event.Q_ref is None else event.Q_ref + moved[1],
        )
        for event in study.events
    )
    asked = replace(at, P_ref=at.P_ref + moved[0], Q_ref=at.Q_ref + moved[1])
    return replace(study, events=events, simulation=asked)


def late_grid(study: Study, timeline: Timeline, since_s: float) -> tuple[Grid, GridSource]:
    """The grid and the source as the sensors show them, in the mean from ``since_s`` to the end of the run."""
    end_s, T_s = study.simulation.duration, study.converter.T_s
    grid, source = timeline.grid_at(end_s), timeline.source_at(end_s)
    V_rms, omega = source.V_g_rms, source.omega
    first, count = round(since_s / T_s), max(round((end_s - since_s) / T_s), 2)
    if timeline.wander is not None:
        gain, angle = timeline.wander.factors(first, count)
        V_rms *= float(gain.mean())
        omega += float(angle[-1] - angle[0]) / ((count - 1) * T_s)
    if study.sensors is not None:
        errors = 1.0 + np.array(study.sensors.gain_errors)
        of_v, of_i = float(errors[0:3].mean()), float(errors[6:9].mean())
        ratio, part = of_v / of_i, study.filter
        grid = Grid(ratio * (grid.R_g + part.R_2) - part.R_2, ratio * (grid.L_g + part.L_2) - part.L_2)
        V_rms *= of_v
    return grid, GridSource(V_rms, omega)
