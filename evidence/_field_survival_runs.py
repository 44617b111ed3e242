"""One disturbance in a dirty grid, with the schedule driven by the field estimator or by the truth, and the verdict."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from evidence._field_converters import Converter, bridge_current
from evidence._field_draws import FieldDraw
from evidence._field_runs import converter_of, found_after, simulate_field, study_of, wrong_and_silent
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.linear.operating_point.equilibrium import solve_with_droop
from vsgdesign.metrics.answers import (
    WRONG,
    Answers,
)
from vsgdesign.metrics.survival import (
    NO_REST,
    ExpectedRest,
    Survival,
    SurvivalDemand,
    SurvivalRecord,
    judge_survival,
)
from vsgdesign.simulation.feeds import LateSchedule
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.survival.cases import demand_of, field_demand, late_grid
from vsgdesign.simulation.survival.running import record_of
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

VARIANTS = ("field", "truth")
"""The schedule follows the estimator, or it is told the true grid, one update late. Grid and sensors are alike."""

AT_REST_AFTER_S = 2.0
"""A converter must be at rest this long after the clearing, s."""

MEAN_S = 0.04
"""P and Q are judged by their means over this, s."""

SWITCHING_SHIFT_PU = {"1 MVA": 0.08}
"""By how much of the rating a switched bridge may rest beside the equations. With 3 kHz the ripple at the samples moves
Q by 4 to 7 % against the averaged bridge; of the other converters it is at most 1 %, and they get nothing."""

_LATE_S = 0.02


class Task(NamedTuple):
    """A run."""

    draw: FieldDraw
    variant: str


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
    c, cleared_s = study.converter, draw.changes[-1].end_s
    record = record_of(study, simulation)
    scr = next((one.place.scr for one in reversed(draw.changes) if one.place is not None), draw.start.scr)
    in_the_field = field_demand(scr, c.omega_n) | {"cycle_s": MEAN_S}
    demand = replace(demand_of(c, 1.0), settling_times=AT_REST_AFTER_S, grace_s=0.0, **in_the_field)
    rest = _moved(rest_seen(converter, study, cleared_s + AT_REST_AFTER_S), record, demand, cleared_s, draw.converter)
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


def rest_seen(converter: Converter, study: Study, since_s: float) -> ExpectedRest:
    """The rest after the last change on the grid of the time from ``since_s`` on, as the converter's sensors see it."""
    c, (D_p, D_q) = converter.study.converter, converter.droops
    timeline = build_timeline(study)
    refs, (grid, source) = timeline.references_at(study.simulation.duration), late_grid(study, timeline, since_s)
    P = refs.P_ref - D_p * (source.omega_g - c.omega_n)
    R, X = study.path_to_grid(grid, source.omega_g)
    try:
        point = solve_with_droop(P, refs.Q_ref, D_q, c.V_rated_rms, source.V_g_rms, R, X)
    except NoOperatingPointError as error:
        return ExpectedRest.none(str(error))
    return ExpectedRest(P=point.P, Q=point.Q, delta=point.delta, i_s_pu=bridge_current(converter, point))


def answered(draw: FieldDraw, answers: Answers) -> dict[str, Any]:
    """What the estimator said from the disturbance on."""
    events, end = draw.events_s, draw.duration_s
    since = [one.t_s for one in draw.changes if one.place is not None or one.V_g_rms is not None]
    late = answers.rows(draw.changes[-1].end_s + AT_REST_AFTER_S, end)
    return {
        "found_s": found_after(answers, max(since, default=events[0]), end),
        "wrong_at_end": bool((answers.error[late & answers.valid] > WRONG).any()),
        "valid_at_end": bool(answers.valid[late].any()),
        **wrong_and_silent(answers, events, events[0], end),
    }
