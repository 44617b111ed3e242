"""One disturbance in a dirty grid, with the schedule driven by the field estimator or by the truth, and the verdict."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from evidence._field_converters import Converter, after, bridge_current, events_of, references
from evidence._field_draws import FieldDraw
from evidence._field_runs import converter_of, simulate_field, study_of
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.metrics.answers import (
    VERY_WRONG,
    WRONG,
    Answers,
    longest_silence,
    time_to_stay,
    valid_and_wrong,
)
from vsgdesign.metrics.survival import (
    NO_REST,
    ExpectedRest,
    Survival,
    SurvivalDemand,
    SurvivalRecord,
    judge_survival,
)
from vsgdesign.operating_point.equilibrium import solve_with_droop
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.sensors import CHANNELS
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.feeds import LateSchedule
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.survival.demand import demand_of
from vsgdesign.simulation.timeline import Timeline, build_timeline

Array = NDArray[np.float64]

VARIANTS = ("field", "truth")
"""The schedule follows the estimator, or it is told the true grid, one update late. Grid and sensors are alike."""

AT_REST_AFTER_S = 2.0
"""A converter must be at rest this long after the clearing, s."""

MEAN_S = 0.04
"""P and Q are judged by their means over this, s."""

BAND, BAND_OF_SCR = 0.03, 0.005
"""Half-width of the band about the rest, of the rating: the first and, for each unit of SCR, the second. The grid's
phasor walks, and this moves P the more, the stronger the grid is."""

SHARE_INSIDE = 0.95
"""Share of the time after AT_REST_AFTER_S in which P and Q must be in the band."""

SWITCHING_SHIFT_PU = {"1 MVA": 0.08}
"""By how much of the rating a switched bridge may rest beside the equations. With 3 kHz the ripple at the samples moves
Q by 4 to 7 % against the averaged bridge; of the other converters it is at most 1 %, and they get nothing."""

_LATE_S = 0.02

_SAME_INSTANT = 1e-6
"""Share of a sample by which a row may lie before an event and is still after it: times are rounded."""


class Task(NamedTuple):
    """A run."""

    draw: FieldDraw
    variant: str


class Late(NamedTuple):
    """The grid's voltage over the time in which the rest is judged."""

    V_g_rms: float
    omega: float


def run_survival(task: Task) -> dict[str, Any]:
    """A draw through the EMT, and its verdict and figures."""
    begin = time.process_time()
    draw, converter = task.draw, converter_of(task.draw.converter)
    c = converter.study.converter
    study = study_of(converter, draw)
    study = replace(study, simulation=replace(study.simulation, log_interval=c.T_s))
    answers = None
    try:
        if task.variant == "field":
            simulation, answers = simulate_field(converter, study)
        else:
            simulation = simulate(study, LateSchedule(study, converter.spec, _told(build_timeline(study))))
        verdict = judged(converter, draw, study, simulation)
    except InfeasibleStudyError as error:
        verdict = Survival(status=NO_REST, reason=f"before the event: {error}")
    found: dict[str, Any] = {
        "group": draw.group,
        "converter": draw.converter,
        "seed": draw.seed,
        "variant": task.variant,
        "case": f"{draw.start} {draw.changes}",
        "verdict": vars(verdict),
    }
    if answers is not None:
        found |= answered(draw, answers)
    return found | {"seconds": round(time.process_time() - begin, 3)}


def _told(timeline: Timeline) -> tuple[tuple[float, Grid | None], ...]:
    """The true grid from one update after every change of it on."""
    return tuple((t_s if t_s <= 0.0 else t_s + _LATE_S, grid) for t_s, grid in timeline.grids)


def judged(converter: Converter, draw: FieldDraw, study: Study, simulation: Simulation) -> Survival:
    """The verdict: as on a clean grid, with a wider band and for a share of the time."""
    c, last = study.converter, draw.changes[-1]
    cleared_s, T_s = last.end_s, c.T_s
    log, t_s = simulation.log, simulation.t_s
    counted = simulation.column("limited_samples")
    record = SurvivalRecord(
        t_s=t_s,
        P=simulation.column("P"),
        Q=simulation.column("Q"),
        delta=simulation.column("theta") - simulation.timeline.source_phase(t_s + _SAME_INSTANT * T_s),
        i_s_pu=np.hypot(log[:, 0], log[:, 1]) / c.I_rated_pk,
        limited=np.diff(counted, prepend=counted[:1]),
        diverged=simulation.divergence is not None,
    )
    late = grid_over(simulation.timeline, cleared_s + AT_REST_AFTER_S, study.simulation.duration, T_s)
    scr = next((one.place.scr for one in reversed(draw.changes) if one.place is not None), draw.start.scr)
    demand = replace(
        demand_of(c, 1.0, cycle_s=MEAN_S),
        settling_times=AT_REST_AFTER_S,
        grace_s=0.0,
        band=BAND + BAND_OF_SCR * scr,
        share_inside=SHARE_INSIDE,
    )
    rest = _moved(rest_seen(converter, draw, study, late), record, demand, cleared_s, draw.converter)
    return judge_survival(record, [one.t_s for one in draw.changes], cleared_s, rest, demand)


def _moved(
    rest: ExpectedRest, record: SurvivalRecord, demand: SurvivalDemand, cleared_s: float, name: str
) -> ExpectedRest:
    """The rest, moved towards the mean powers at the end by what the switching of the bridge may move it."""
    most = SWITCHING_SHIFT_PU.get(name, 0.0) * demand.S_rated
    late = record.t_s >= cleared_s + demand.deadline_s
    if record.diverged or rest.obstacle is not None or not late.any():
        return rest
    P, Q = (
        at + float(np.clip(np.mean(values[late]) - at, -most, most))
        for at, values in ((rest.P, record.P), (rest.Q, record.Q))
    )
    return replace(rest, P=P, Q=Q)


def rest_seen(converter: Converter, draw: FieldDraw, study: Study, late: Late) -> ExpectedRest:
    """The rest after the last change, as the converter's sensors see it.

    With gains k_v and k_i of its sensors a converter sees the voltage k_v V_g behind the impedance Z k_v/k_i, and its
    droops hold for these.
    """
    c, (D_p, D_q) = converter.study.converter, converter.droops
    state, (P_ref, Q_ref) = draw.start, references(converter, draw.start)
    for change, event in zip(draw.changes, events_of(converter, draw.start, draw.changes), strict=True):
        state = after(state, change)
        P_ref = P_ref if event.P_ref is None else event.P_ref
        Q_ref = Q_ref if event.Q_ref is None else event.Q_ref
    k_v, k_i = sensor_gains(study)
    grid = build_timeline(study).grid_at(study.simulation.duration)
    R, X = (part * k_v / k_i for part in study.path_to_grid(grid, late.omega))
    try:
        point = solve_with_droop(
            P_ref - D_p * (late.omega - c.omega_n), Q_ref, D_q, c.V_rated_rms, k_v * late.V_g_rms, R, X
        )
    except NoOperatingPointError as error:
        return ExpectedRest.none(str(error))
    return ExpectedRest(P=point.P, Q=point.Q, delta=point.delta, i_s_pu=bridge_current(converter, point))


def grid_over(timeline: Timeline, begin_s: float, end_s: float, T_s: float) -> Late:
    """Mean voltage and frequency of the grid over a time without events, with its wander."""
    source = timeline.source_at(begin_s)
    gain = 1.0
    if timeline.wander is not None:
        first = round(begin_s / T_s)
        gain = float(np.mean(timeline.wander.factors(first, round(end_s / T_s) - first)[0]))
    begin, end = timeline.source_phase(np.array([begin_s, end_s]))
    return Late(gain * source.V_g_rms, float(end - begin) / (end_s - begin_s))


def sensor_gains(study: Study) -> tuple[float, float]:
    """Mean gain of the voltage sensors and of those of the current into the grid."""
    if study.sensors is None:
        return 1.0, 1.0
    errors = {str(name): error for name, error in zip(CHANNELS, study.sensors.gain_errors, strict=True)}
    k_v, k_i = (1.0 + sum(errors[f"{name}_{phase}"] for phase in "abc") / 3.0 for name in ("v", "i_g"))
    return k_v, k_i


def answered(draw: FieldDraw, answers: Answers) -> dict[str, Any]:
    """What the estimator said from the disturbance on."""
    events, end = draw.events_s, draw.duration_s
    cleared_s = draw.changes[-1].end_s
    of_grid = [one.t_s for one in draw.changes if one.place is not None]
    of_voltage = [one.t_s for one in draw.changes if one.V_g_rms is not None]
    since = max([*of_grid, *of_voltage], default=events[0])
    found_s = time_to_stay(answers, since, end)
    wrong = valid_and_wrong(answers, events[0], end, events)
    late = answers.rows(cleared_s + AT_REST_AFTER_S, end)
    return {
        "found_s": found_s if math.isfinite(found_s) else None,
        "wrong_s": wrong.seconds,
        "worst": wrong.worst,
        "very_wrong_s": valid_and_wrong(answers, events[0], end, events, above=VERY_WRONG).seconds,
        "wrong_at_end": bool((answers.error[late & answers.valid] > WRONG).any()),
        "valid_at_end": bool(answers.valid[late].any()),
        "longest_silence_s": max(
            longest_silence(answers, t, until) for t, until in zip(events, (*events[1:], end), strict=True)
        ),
    }
