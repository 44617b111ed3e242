"""What is told of the events of a study besides its run: that its dc side cannot give or take their power."""

from __future__ import annotations

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.linear.operating_point.many import DC_SOURCE, said_of
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.lanes.cases import LaneCases, segments_of
from vsgdesign.simulation.lanes.rests import rests_of
from vsgdesign.simulation.lanes.results import LaneResults
from vsgdesign.simulation.lanes.telling import OfTrueGrid, learns, telling
from vsgdesign.simulation.run import simulate
from vsgdesign.simulation.scenario.controllers import told_if_blocked
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.study import ControllerSpec, Study

MOST_SAMPLES = 400_000
"""Of a run that is made for nothing but what is told: about a second."""


def told_beforehand(study: Study, ready: Ready = NOTHING, *, run: bool = True) -> tuple[str, ...]:
    """One sentence on each controller whose dc side cannot do what the events of its study ask for, as ``verify`` and
    ``survive`` tell it of a case. None with an ideal link, in a plant, with a record as the source, or with a table
    that is not built yet.

    ``run``: whether the events are simulated for it, where they take no more than MOST_SAMPLES. A command that
    simulates them anyway tells it of its own run.
    """
    if study.dc is None or study.plant is not None or study.replay is not None or not study.events:
        return ()
    found = []
    for spec in study.controllers:
        if spec.schedule == "table" and spec.name not in ready.tables:
            continue
        own = study.with_limit_of(spec)
        told = said_of(DC_SOURCE) if _rest_fault(own, spec, ready) == DC_SOURCE else None
        if told is None and run and study.simulation.duration <= MOST_SAMPLES * study.converter.T_s:
            told = _of_run(own, spec, ready)
        found += [] if told is None else [f"{spec.name}: {told}."]
    return tuple(found)


def _rest_fault(study: Study, spec: ControllerSpec, ready: Ready) -> int:
    cases = LaneCases.of_studies([study]).in_study(study)
    demand = demand_of(study.converter, settling_time_of(spec, ready))
    law = gain_law(study, spec, ready)
    told = OfTrueGrid(law, cases) if learns(spec) else telling(study, spec, ready, cases)
    results = LaneResults.of_none(1)
    rests_of(study, cases, segments_of(cases), told, demand, results)
    return int(results.fault[0])


def _of_run(study: Study, spec: ControllerSpec, ready: Ready) -> str | None:
    try:
        found = simulate(study, feed_of(study, spec, build_timeline(study), ready), bridge="averaged", finds=spec)
    except (InfeasibleStudyError, SimulationDivergedError):  # what else is wrong is said elsewhere
        return None
    lost = found.divergence
    return told_if_blocked(found.study, spec, ready, "averaged") if lost is not None and lost.blocked else None


__all__ = ["told_beforehand"]
