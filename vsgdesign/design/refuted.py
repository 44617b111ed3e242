"""Grids at which the full-order model alone refutes a table, though every node around them keeps its promises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate import Region
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.points import least_decay
from vsgdesign.design.between import PointCheck, check_points
from vsgdesign.design.evaluation import LawOfStudy
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.runtime.table import table_schedule
from vsgdesign.study.parameters.specification import Specification, settled_decay
from vsgdesign.study.parameters.study import ControllerSpec, Study

_SLOW = 0.25
"""Of the decay that the settling time stands for, below which a mode counts as too slow: a mode that hardly takes part
in a step may be slower than that."""


def refuted_between(
    study: Study, controller: ControllerSpec, law: LawOfStudy, spec: Specification, table: GainTable, seed: int
) -> tuple[PointCheck, ...]:
    """The grid at which a search over the table's whole box finds the slowest mode of the full-order model, where that
    grows or is far too slow; of equal units the same of their modes against each other. Empty where the table promises
    nothing there.

    ``missed`` has the settling time that would have to be allowed, infinite where the mode grows, or the decay between
    units.
    """
    box = table.validity
    region = Region(box.scr, box.x_over_r, box.P, box.Q, box.error, error_Z=box.error_Z)
    own = replace(study.with_limit_of(controller), scr_basis=spec.scr_basis)
    system, _ = prepared(own, controller, region, NOTHING, table_schedule(table), None)
    settles = settled_decay(spec.settling_time) if spec.settles else 0.0
    found: list[PointCheck] = []
    for apart, asked in ((False, settles), (True, spec.differential_decay)):
        if apart and asked == 0.0:
            continue
        try:
            slowest = least_decay(own, replace(system, apart=apart), region, seed)
        except InfeasibleStudyError:  # no point within the static limits
            continue
        decay = slowest.decay or 0.0
        if decay > _SLOW * asked:
            continue
        missed = (
            {"differential_decay": decay}
            if apart
            else {"settling_time": spec.settling_time * settles / decay if decay > 0.0 else np.inf}
        )
        grid = np.array([[slowest.scr, slowest.x_over_r]])
        found += [replace(at, missed=missed) for at in check_points(study, law, spec, table, grid) if at.promised]
    return tuple(found)
