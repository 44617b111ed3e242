"""What is told of the events of a study before its run: that its dc side cannot give or take their power."""

from __future__ import annotations

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.linear.operating_point.many import DC_FAULTS, said_of
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.lanes.cases import LaneCases, segments_of
from vsgdesign.simulation.lanes.rests import rests_of
from vsgdesign.simulation.lanes.results import LaneResults
from vsgdesign.simulation.lanes.telling import OfTrueGrid, learns, telling
from vsgdesign.simulation.survival.demand import demand_of, settling_time_of
from vsgdesign.study.parameters.study import ControllerSpec, Study


def told_beforehand(study: Study, ready: Ready = NOTHING) -> tuple[str, ...]:
    """One sentence on each controller whose dc side cannot do what the events of its study ask for, as ``verify`` and
    ``survive`` tell it of a case (:eq:`dc-told`). None with an ideal link, in a plant, with a record as the source, or
    with a table that is not built yet."""
    if study.dc is None or study.plant is not None or study.replay is not None or not study.events:
        return ()
    found = []
    for spec in study.controllers:
        if spec.schedule == "table" and spec.name not in ready.tables:
            continue
        fault = _fault(study.with_limit_of(spec), spec, ready)
        if fault in DC_FAULTS:
            found.append(f"{spec.name}: {said_of(fault)}.")
    return tuple(found)


def _fault(study: Study, spec: ControllerSpec, ready: Ready) -> int:
    cases = LaneCases.of_studies([study]).in_study(study)
    demand = demand_of(study.converter, settling_time_of(spec, ready))
    law = gain_law(study, spec, ready)
    told = OfTrueGrid(law, cases) if learns(spec) else telling(study, spec, ready, cases)
    results = LaneResults.of_none(1)
    rests_of(study, cases, segments_of(cases), told, demand, results)
    return int(results.fault[0])


__all__ = ["told_beforehand"]
