"""Cases of a field estimator run one by one: what its lanes are compared with."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.metrics.events import late_mean
from vsgdesign.metrics.step_response import cycle_mean, step_response
from vsgdesign.metrics.survival import (
    ExpectedRest,
    SurvivalDemand,
    judge_survival,
    loads_of,
)
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.every_sample import signals_at_pcc
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.lanes.cases import ACTIVE, STEP, LaneCases, segments_of, study_of_case
from vsgdesign.simulation.lanes.rests import Rests, ends_of, rests_of
from vsgdesign.simulation.lanes.results import DIVERGED, IN_NOISE, JUDGED, NO_REST, STATUSES, LaneResults
from vsgdesign.simulation.lanes.telling import OfTrueGrid
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.scenario import derive_series, samples_per_mean
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.simulation.survival.running import own_rest_of, record_of
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]


def run_alone(
    study: Study, spec: ControllerSpec, ready: Ready, cases: LaneCases, *, bridge: str = "averaged"
) -> LaneResults:
    """Runs every case of a controller that estimates its grid in every sample, one after the other.

    The rests are those with the gains of the true grid, or those that a switched bridge comes to. The figures of a step
    are those of the difference from its twin, in the mean over two nominal cycles, in which the probe does not show
    (:func:`vsgdesign.simulation.scenario.mean_cycles`). All others are as in lanes.
    """
    own = study.with_limit_of(spec)
    results = LaneResults.of_none(len(cases))
    if len(cases) == 0:
        return results
    segments, demand = segments_of(cases), demand_of(own.converter, settling_time_of(spec, ready))
    rests, _ = rests_of(own, cases, segments, OfTrueGrid(gain_law(own, spec, ready), cases), demand, results)
    ends, cycle = ends_of(own, cases, segments, demand, bridge)
    for k in np.flatnonzero(results.status == JUDGED).tolist():
        one = study_of_case(own, cases, k, int(ends[k]))
        try:
            steps = (float(cases.events.t_s[k, 0]),) if cases.kind[k] == STEP else ()
            run = simulate(one, FieldScheduler(one, spec, ready), bridge=bridge, twins=steps)
        except SimulationDivergedError:
            _diverged(results, k, cases.kind[k] == STEP)
            continue
        except InfeasibleStudyError:
            results.status[k] = NO_REST
            continue
        of_case = replace(demand, cycle_s=int(cycle[k]) * own.converter.T_s)
        _judge(one, run, cases, k, rests, of_case, results, own_rest=bridge == "pwm" or one.has_components)
    return results


def _judge(
    study: Study,
    run: Simulation,
    cases: LaneCases,
    k: int,
    rests: Rests,
    demand: SurvivalDemand,
    results: LaneResults,
    *,
    own_rest: bool,
) -> None:
    record = record_of(study, run)
    instants = [float(t_s) for t_s in cases.events.t_s[k] if math.isfinite(t_s)]
    T_s = study.converter.T_s
    # A step begins with the sample that is nearest to it, as in lanes.
    since = [math.ceil(instants[0] / T_s - 0.5) * T_s] if cases.kind[k] == STEP else instants
    results.noise[k] = 0.0 if cases.kind[k] == STEP else results.noise[k]
    for name, value in loads_of(record, since, demand.i_max_pu)._asdict().items():
        getattr(results, name)[k] = 0.0 if value is None else value
    if cases.kind[k] == STEP:
        if record.diverged:
            _diverged(results, k, True)
        else:
            _judge_step(study, run, cases, k, results, round(demand.cycle_s / T_s))
        return
    rest = ExpectedRest(P=rests.P_end[k], Q=rests.Q_end[k], delta=rests.delta_end[k], i_s_pu=0.0)
    if own_rest:
        rest = own_rest_of(rest, record, demand)
    verdict = judge_survival(record, instants, float(cases.cleared_s[k]), rest, demand)
    results.status[k] = JUDGED if verdict.survived else STATUSES.index(verdict.status)
    results.recovery_s[k] = math.inf if verdict.recovery_s is None else verdict.recovery_s
    results.swing_rad[k] = math.nan if verdict.swing_rad is None else verdict.swing_rad
    results.limited_at_end[k] = math.nan if verdict.limited_at_end is None else verdict.limited_at_end


def _judge_step(
    study: Study, run: Simulation, cases: LaneCases, k: int, results: LaneResults, cycle_at_end: int
) -> None:
    """``cycle_at_end``: samples of a cycle of the grid."""
    name = "P_pcc" if cases.signal[k] == ACTIVE else "Q_pcc"
    (twin,), count = run.twins, samples_per_mean(study, run.t_s)
    series, less = derive_series(study, run)[name], getattr(signals_at_pcc(study, twin), name)
    t_s = float(cases.events.t_s[k, 0])
    begin = int(np.searchsorted(run.t_s, t_s - 0.5 * study.converter.T_s))
    without = np.concatenate([series[: len(series) - len(less)], less])  # the same until the step
    left, rest = cycle_mean(series - without, count)[begin:], cycle_mean(without, count)[begin:]
    step = late_mean((series - without)[begin:], cycle_at_end)
    found = step_response(run.t_s[begin:] - t_s, left, 0.0, step)
    results.overshoot[k] = (found.overshoot_pct or 0.0) / 100.0
    results.settling_s[k] = math.inf if found.settling_time_s is None else found.settling_time_s
    seconds = [float(np.std(_second(one[len(one) // 2 :: count // 20], 30))) for one in (left, rest)]
    results.noise[k] = 4.5 * min(seconds[0], 1.5 * seconds[1]) / math.sqrt(6.0) / abs(step)
    if results.noise[k] > 0.02:
        results.status[k] = IN_NOISE


def _second(values: Array, apart: int) -> Array:
    """Second differences, with their mean for zero."""
    found = np.diff(np.column_stack([values[: -2 * apart], values[apart:-apart], values[2 * apart :]]), n=2, axis=1)
    return np.concatenate([found[:, 0], -found[:, 0]])


def _diverged(results: LaneResults, k: int, step: bool) -> None:
    results.status[k] = DIVERGED
    (results.settling_s if step else results.recovery_s)[k] = math.inf
