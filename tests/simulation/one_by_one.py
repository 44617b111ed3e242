"""A case of a batch as one run: what the batch is compared with."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.artifacts.ready import Ready
from vsgdesign.metrics.step_response import step_response
from vsgdesign.metrics.survival import GRACE_S, ExpectedRest, Survival, SurvivalDemand, SurvivalRecord, judge_survival
from vsgdesign.simulation.feeds import LateSchedule, safe_grid
from vsgdesign.simulation.gains import gain_changes
from vsgdesign.simulation.lanes.cases import ACTIVE, STEP, LaneCases
from vsgdesign.simulation.lanes.rests import STEP_WINDOW
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.scenario import derive_series
from vsgdesign.simulation.survival.cases import settling_time_of
from vsgdesign.simulation.survival.running import record_of
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.study.parameters.event_kinds import DC_QUANTITIES
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import ControllerSpec, Event, Study


def study_of(study: Study, cases: LaneCases, k: int, T: float) -> Study:
    """The study of one case, logged at every sample."""
    e, c = cases.events, study.converter

    def given(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    # The controller is designed for the study's source; an event at t = 0 says what the source is.
    events = [Event(0.0, "start", V_g_rms=float(cases.V_g_rms[k]), omega_g=float(cases.omega_g[k]))]
    for j in np.flatnonzero(np.isfinite(e.t_s[k])):
        of_the_source: dict[str, Any] = {name: given(getattr(e, name)[k, j]) for name in DC_QUANTITIES}
        grid = Grid(float(e.R_g[k, j]), float(e.L_g[k, j])) if np.isfinite(e.R_g[k, j]) else None
        events.append(
            Event(
                t_s=float(e.t_s[k, j]),
                name=f"event {j}",
                grid=grid,
                V_g_rms=given(e.V_g_rms[k, j]),
                omega_g=given(e.omega_g[k, j]),
                over=float(e.over[k, j]),
                phase_jump=float(e.phase_jump[k, j]),
                P_ref=given(e.P_ref[k, j]),
                Q_ref=given(e.Q_ref[k, j]),
                **of_the_source,
            )
        )
    omega_end = next((float(w) for w in e.omega_g[k, ::-1] if np.isfinite(w)), float(cases.omega_g[k]))
    needed = 2.25 * T + GRACE_S + 2.0 * (2.0 * math.pi / omega_end)
    end_s = e.t_s[k, 0] + STEP_WINDOW * T if cases.kind[k] == STEP else cases.cleared_s[k] + needed
    return replace(
        study,
        grid=Grid(float(cases.R_g[k]), float(cases.L_g[k])),
        events=tuple(events),
        simulation=replace(
            study.simulation,
            duration=math.ceil(end_s / c.T_s - 1e-6) * c.T_s,
            start="steady_state",
            log_interval=c.T_s,
            P_ref=float(cases.P_ref[k]),
            Q_ref=float(cases.Q_ref[k]),
        ),
    )


def told_of(cases: LaneCases, k: int, timeline: Timeline) -> tuple[tuple[float, Grid | None], ...]:
    """What the estimator says in a case."""
    e = cases.events

    def seen(grid: Grid) -> Grid:
        return Grid(grid.R_g * (1.0 + float(cases.error_R[k])), grid.L_g * (1.0 + float(cases.error_X[k])))

    said: list[tuple[float, Grid | None]] = [(0.0, seen(timeline.grid_at(0.0)))]
    of_grid = np.isfinite(e.R_g[k]) | np.isfinite(e.V_g_rms[k]) | np.isfinite(e.omega_g[k]) | (e.phase_jump[k] != 0.0)
    instants = [float(t) for t, touched in zip(e.t_s[k], of_grid, strict=True) if touched and np.isfinite(t)]
    for j, t_s in enumerate(instants):
        said.append((t_s, None))
        answer_s = t_s + float(cases.silent_s[k])
        if j + 1 == len(instants) or answer_s < instants[j + 1]:
            said.append((answer_s, seen(timeline.grid_at(t_s + 1e-9))))
    return tuple(said)


def run_one(study: Study, spec: ControllerSpec, ready: Ready, cases: LaneCases, k: int, bridge: str) -> Simulation:
    """One case through ``simulate``."""
    T = settling_time_of(spec, ready)
    own = study_of(study.with_limit_of(spec), cases, k, T)
    timeline = build_timeline(own)
    if spec.kind == "fixed":
        return simulate(own, gain_changes(own, spec, timeline), bridge=bridge)
    feed = LateSchedule(own, spec, told_of(cases, k, timeline), ready, safe=safe_grid(own, spec, ready))
    return simulate(own, feed, bridge=bridge)


def step_of(study: Study, run: Simulation, cases: LaneCases, k: int, final: float) -> tuple[float, float]:
    """Overshoot as a share and settling time in s of the mean over one nominal cycle after the step of a case."""
    signal = "P_pcc" if cases.signal[k] == ACTIVE else "Q_pcc"
    series = derive_series(study, run)[signal]
    begin = int(np.searchsorted(run.t_s, cases.events.t_s[k, 0] - 0.5 * study.converter.T_s))
    cycle = round(2.0 * math.pi / study.converter.omega_n / study.converter.T_s)
    mean = np.convolve(series, np.full(cycle, 1.0 / cycle), "valid")  # its first row is that of sample cycle - 1
    at = begin - cycle + 1
    found = step_response(run.t_s[begin:] - cases.events.t_s[k, 0], mean[at:], float(mean[at - 1]), final)
    settled = math.inf if found.settling_time_s is None else found.settling_time_s
    return (found.overshoot_pct or 0.0) / 100.0, settled


def verdict_of(
    study: Study, run: Simulation, cases: LaneCases, k: int, rest: ExpectedRest, T: float, omega_end: float
) -> tuple[Survival, SurvivalRecord]:
    """The judge's verdict on a disturbance."""
    c = study.converter
    cycle_s = round(2.0 * math.pi / omega_end / c.T_s) * c.T_s
    demand = SurvivalDemand(
        S_rated=c.S_rated, settling_time=T, cycle_s=cycle_s, i_max_pu=c.current_limit_pu, grace_s=GRACE_S
    )
    record = record_of(replace(study, simulation=replace(study.simulation, log_interval=c.T_s)), run)
    instants = [float(t) for t in cases.events.t_s[k] if np.isfinite(t)]
    return judge_survival(record, instants, float(cases.cleared_s[k]), rest, demand), record


def numbers(run: Simulation) -> Any:
    """Every state at the end."""
    s = run.final_state
    return np.array([*run.final_plant, *s[:-1], *s.limiter])
