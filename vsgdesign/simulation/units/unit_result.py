"""Figures, series and verdicts of one unit of a plant, as of one converter; and of its inverters their series, and
their powers at each rest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.frames import instantaneous_power, peak_to_rms
from vsgdesign.linear.operating_point.rest_of_units import UnitsAtRest
from vsgdesign.metrics.step_response import cycle_mean
from vsgdesign.metrics.survival import BLOCKED, ExpectedRest, Survival, judge_survival
from vsgdesign.simulation.dc_start import dc_figures
from vsgdesign.simulation.every_sample import SignalsAtPcc
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.outcome import Divergence, outcome_of
from vsgdesign.simulation.rest import Rest
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.scenario.controllers import (
    AT_PCC,
    ControllerResult,
    derive_series,
    means_of,
    measure_events,
    put_vectors,
    rest_at_limit,
    samples_per_mean,
)
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of, silent_s_of
from vsgdesign.simulation.survival.running import own_rest_of, record_of, with_protection
from vsgdesign.simulation.twin import never_rests
from vsgdesign.simulation.units.run import InverterRun, PlantRun, UnitRun
from vsgdesign.simulation.units.timeline import spec_of
from vsgdesign.study.parameters.study import ControllerSpec, Study


def unit_result(
    study: Study,
    spec: ControllerSpec,
    ready: Ready,
    run: PlantRun,
    k: int,
    found: tuple[Rest, ...],
    expected: Sequence[ExpectedRest],
    feed: FieldScheduler | None,
    twins: Mapping[float, PlantRun],
    blocked: Divergence | None = None,
) -> ControllerResult:
    """Figures and series of a unit, as of one converter. ``found``, ``expected``: its rests; ``twins``: the run without
    each step that has one; ``blocked``: when and why its bridge has blocked."""
    unit, own_spec = run.units[k], spec_of(run.units[k].study, spec)
    own, i_g = unit.study, unit.log[:, 4:6]
    seen = signals_of(run, k)
    without = {t_s: _beside(seen, signals_of(twin, k)) for t_s, twin in twins.items()}
    simulation = as_simulation(run, unit, k)
    at_limit = None if run.divergence else rest_at_limit(own, simulation, seen)
    events = measure_events(
        own,
        seen,
        found,
        ripples=study.simulation.bridge == "pwm" or study.has_components,
        divergence=run.divergence,
        without=without,
        restless=never_rests(study, own_spec),
    )
    every = max(round(study.simulation.log_interval / (run.t_s[1] - run.t_s[0])), 1)
    logged, figures = simulation, None
    if simulation.dc_log is not None:
        whole = len(run.t_s) if blocked is None else max(int(np.searchsorted(run.t_s, blocked.t_s)), 1)
        figures = dc_figures(own, simulation.dc_log[whole - 1])
        gone = np.arange(len(run.t_s))[:, None] >= whole  # nothing is known of a link behind a blocked bridge
        logged = replace(simulation, dc_log=np.where(gone, np.nan, simulation.dc_log))
    logged = logged.every(every)
    per_mean = samples_per_mean(own, run.t_s)
    means = {name: cycle_mean(getattr(seen, name), per_mean)[::every] for name in ("P_pcc", "Q_pcc")}
    at_pcc = unit.terminals[::every].copy(), i_g[::every].copy()  # series are derived later, and need no other row
    return ControllerResult(
        spec=own_spec,
        bridge=study.simulation.bridge,
        gain_changes=unit.gain_changes,
        simulation=logged,
        derives=partial(derive_series, own, logged, at_pcc, run.timeline.shared.source_phase(logged.t_s, 1e-9)),
        means=means,
        without={t_s: means_of(own, one) for t_s, one in without.items()},
        events=events,
        outcome=outcome_of(blocked or run.divergence, found, events, at_limit, own.converter.S_rated),
        rests=found,
        estimates=None if feed is None else feed.log(run.timeline.timelines[k]),
        distorted=study.has_components,
        survival=_survival(own, own_spec, ready, replace(simulation, divergence=blocked or run.divergence), expected)
        if study.simulation.survival
        else None,
        dc=figures,
    )


def signals_of(run: PlantRun, k: int) -> SignalsAtPcc:
    """Powers and currents at the terminals of a unit."""
    unit = run.units[k]
    i_g, i_s = unit.log[:, 4:6], unit.log[:, 0:2]
    P, Q = instantaneous_power(*unit.terminals.T, *i_g.T)
    return SignalsAtPcc(run.t_s, P, Q, *(np.square(np.hypot(*one.T)) for one in (i_g, i_s)))


def _beside(seen: SignalsAtPcc, twin: SignalsAtPcc) -> SignalsAtPcc:
    """The powers of a twin, as long as those of the run, and equal to them after its end."""
    count = len(twin.t_s)
    powers = {name: np.append(getattr(twin, name), getattr(seen, name)[count:]) for name in ("P_pcc", "Q_pcc")}
    return seen._replace(**powers)


def _survival(
    study: Study, spec: ControllerSpec, ready: Ready, run: Simulation, rests: Sequence[ExpectedRest]
) -> Survival:
    """The verdict on a unit where the events of a study are one disturbance. It is judged as a converter that stands
    alone (:func:`vsgdesign.simulation.survival.verdicts.judged_by_rest`), by its rests in the plant."""
    if run.divergence is not None and run.divergence.blocked:  # its breaker has opened, so that it has no rest
        return Survival(status=BLOCKED, reason=run.divergence.reason)
    c, end_s = study.converter, study.simulation.duration
    longest, own_s = study.simulation.survival_settling_time, settling_time_of(spec, ready)
    demand = demand_of(
        c,
        own_s if longest is None else min(own_s, longest),
        silent_s=silent_s_of(spec),
        cycle_s=2.0 * math.pi / run.timeline.source_at(end_s).omega,
    )
    for rest, where in ((rests[0], "before the events"), (rests[-1], "after the events")):
        refused = rest.refused(c.current_limit_pu)
        if refused is not None:
            return Survival(status=refused[0], reason=f"{where}: {refused[1]}")
    instants = sorted({event.t_s for event in study.events if event.t_s > 0.0})
    cleared_s = max(event.t_s + event.over for event in study.events)
    record, rest = record_of(study, run), rests[-1]
    if study.simulation.bridge == "pwm":
        rest = own_rest_of(rest, record, demand)
    verdict = judge_survival(record, instants, cleared_s, rest, demand)
    return with_protection(verdict, study, run, instants[0])


def as_simulation(run: PlantRun, unit: UnitRun, k: int) -> Simulation:
    """The part of a unit in a run, as the run of one converter."""
    rows = len(run.t_s)
    return Simulation(
        t_s=run.t_s,
        log=unit.log,
        circuit_log=np.empty((rows, 0)),
        controller_log=np.empty((0, 0)),
        study=unit.study,
        timeline=run.timeline.timelines[k],
        gain_changes=unit.gain_changes,
        final_state=unit.final_state,
        final_plant=unit.log[-1, :6].copy(),
        dc_log=unit.dc_log,
        loop_seconds=run.loop_seconds,
        divergence=run.divergence,
    )


Array = NDArray[np.float64]


@dataclass(frozen=True)
class InverterRest:
    """An inverter where a plant rests: its powers (W, var) and its voltage (phase rms V) at its terminals, and the
    share of its rated current that it gives."""

    name: str
    P_pcc: float
    Q_pcc: float
    V_rms: float
    I_pu: float


def terminals_at_rest(rest: UnitsAtRest, converter: int) -> tuple[complex, complex]:
    """Voltage and current at the terminals of a converter, behind L_2, peak."""
    model = rest.model
    y, v_g = model.states(rest.z), model.situation.phasors
    per_state, per_source = model.network.terminals
    return complex(per_state[converter] @ y + per_source[converter] @ v_g), complex(y[3 * converter + 2])


def inverters_at_rest(rest: UnitsAtRest) -> tuple[InverterRest, ...]:
    """All inverters that are connected."""
    found = []
    for k, one in enumerate(rest.model.situation.inverters, len(rest.model.situation.units)):
        v, i = terminals_at_rest(rest, k)
        P, Q = instantaneous_power(v.real, v.imag, i.real, i.imag)
        own = one.inverter
        amps = float(peak_to_rms(abs(i))) * 3.0 * own.V_rated_rms / own.S_rated
        found.append(InverterRest(own.name, float(P), float(Q), float(peak_to_rms(abs(v))), amps))
    return tuple(found)


def inverter_series(run: InverterRun, t_s: Array, phase: Array, every: int) -> dict[str, Array]:
    """Phases and powers at its terminals, its frequency, the voltage that it takes for its capacitor's, and its angle
    to the grid's source, of every n-th row."""
    rows = slice(None, None, every)
    v, i = run.terminals[rows], run.log[rows, 4:6]
    series = {"t_s": t_s[rows]} | {name: np.empty(len(v)) for name in AT_PCC}
    put_vectors([series[name] for name in AT_PCC], v.T, i.T)
    delta = np.mod(run.column("theta")[rows] - phase[rows] + math.pi, 2.0 * math.pi) - math.pi
    return series | {"omega": run.column("omega")[rows], "V_rms": run.column("V_rms")[rows], "delta": delta}
