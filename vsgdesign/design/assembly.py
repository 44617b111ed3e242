"""A gain table of the cells that were designed, and what it no longer promises."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.design_inputs import design_inputs
from vsgdesign.artifacts.gain_table import COLUMNS, GainTable, ValidityBox, base_of, fill_outside, to_dimensionless
from vsgdesign.artifacts.provenance import provenance
from vsgdesign.design.between import BetweenCheck
from vsgdesign.design.smoothing import around
from vsgdesign.design.table_nodes import TableJob, TableNodes, look_at_random
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.parameters.specification import Specification
from vsgdesign.runtime.table import table_grids, with_node_gains
from vsgdesign.stability.gain_table import margins_of

Array = NDArray[np.float64]

_LARGE = {
    "overshoot_P_pct": ("overshoot_P", 100.0),
    "settling_P_s": ("settling_P", 1.0),
    "overshoot_Q_pct": ("overshoot_Q", 100.0),
    "settling_Q_s": ("settling_Q", 1.0),
    "cross_peak": ("cross_peak", 1.0),
}
"""Figures of which the largest is the worst: name in the table, name in Figures, scale."""

_LOOKS = 3
"""How often nodes lose their promise, each time after a look at new random grids."""


@dataclass(frozen=True)
class Withdrawn:
    """A table that promises no more than the last look found to hold."""

    table: GainTable
    checked: BetweenCheck
    lost: dict[int, dict[str, float]]
    """By the number of a node: what was missed at a grid beside it."""


def withdraw_promises(job: TableJob, table: GainTable, checked: BetweenCheck, seeds: Iterator[int]) -> Withdrawn:
    """Nodes around grids at which a promise is broken lose theirs, and new random grids are looked at, a few times."""
    lost: dict[int, dict[str, float]] = {}
    for _ in range(_LOOKS):
        if not checked.broken:
            break
        for point in checked.broken:
            lost = dict.fromkeys(around(table, point), point.missed) | lost
        table = demote(table, checked)
        checked = look_at_random(job, table, seeds)
    return Withdrawn(table, checked, lost)


def demote(table: GainTable, checked: BetweenCheck) -> GainTable:
    """The table without a promise where one was broken between nodes: the nodes around become ``relaxed``.

    What is not kept at a grid between them is said as their active constraint.
    """
    status, active = table.status.astype("<U8"), table.active.astype(object)
    for point in checked.broken:
        for k in around(table, point):
            at = divmod(k, len(table.x_over_r))
            if status[at] == "met":
                status[at], active[at] = "relaxed", "between nodes: " + _active("", point.missed)
    return replace(table, status=status, active=active.astype(str))


def assemble(job: TableJob, nodes: TableNodes) -> GainTable:
    """The table of designed cells."""
    study, spec, law, records = job.study, job.spec, job.law, nodes.records
    scr, x_over_r = np.array(nodes.scr), np.array(nodes.x_over_r)
    shape = (len(scr), len(x_over_r))
    designs = [record.design for record in records]
    valid = np.array([d is not None for d in designs]).reshape(shape)

    def cells(value: Any, outside: float = np.nan) -> Array:
        return np.array(
            [outside if d is None else value(d, r) for d, r in zip(designs, records, strict=True)], dtype=float
        ).reshape(shape)

    normalised = {
        name: fill_outside(cells(lambda d, _, k=k: float(d.normalised[k]), 0.0), valid)
        for k, name in enumerate(COLUMNS[law.law])
    }
    margins = {
        f"worst_{name}": cells(lambda d, r, f=field, k=scale: k * max(getattr(d.figures, f), getattr(r.full_order, f)))
        for name, (field, scale) in _LARGE.items()
    }
    margins |= {
        "worst_disk_margin": cells(lambda d, r: min(d.figures.disk_margin, r.full_order.disk_margin)),
        "worst_least_damping": cells(lambda d, _: d.figures.damping_ratio),
        "full_order_decay_1_s": cells(lambda _, r: -r.full_order.abscissa),
        "scenarios": cells(lambda d, _: d.scenarios),
    }
    margins = {name: np.where(np.isfinite(values), values, np.nan) for name, values in margins.items()}
    status = np.array(["outside" if d is None else "met" if d.met else "relaxed" for d in designs]).reshape(shape)
    active = np.array(["" if d is None else _active(d.active, d.shortfalls) for d in designs]).reshape(shape)
    base = base_of(study, spec.scr_basis)
    box = spec.box
    validity = ValidityBox(
        scr=(float(scr[0]), float(scr[-1])),
        x_over_r=(float(x_over_r[0]), float(x_over_r[-1])),
        P=(min(box.P), max(box.P)),
        Q=(min(box.Q), max(box.Q)),
        V_rms=study.converter.V_limits_rms,
        error=max(box.error_R, box.error_X),
        error_Z=box.error_Z,
    )
    table = GainTable(
        name=job.controller.name,
        structure=law.structure,
        law=law.law,
        study=study.name,
        study_hash=study.hash,
        base=base,
        D_p=law.D_p,
        D_q=law.D_q,
        P_design=job.controller.target.P,
        Q_design=job.controller.target.Q,
        time_scale=spec.settling_time if spec.settles else 1.0,
        scr=scr,
        x_over_r=x_over_r,
        columns=to_dimensionless(normalised, spec.settling_time if spec.settles else 1.0),
        gains=PowerLoopGains(**dict.fromkeys(PowerLoopGains._fields, np.full(shape, np.nan))),
        status=status,
        active=active,
        price=cells(lambda d, _: d.price),
        margins=margins,
        specification=_document(spec),
        validity=validity,
        provenance=provenance(),
        design_inputs=design_inputs(study, job.controller.target),
    )
    table = with_node_gains(table)
    R_g, L_g = table_grids(table)
    return replace(table, margins=margins | margins_of(base, R_g, L_g, table.P_design, table.Q_design, table.gains))


def _document(spec: Specification) -> dict[str, Any]:
    """A specification as a table keeps it. An error that is not asked for is left out, as in tables of before."""
    found = asdict(spec)
    if spec.box.error_Z == 0.0:
        del found["box"]["error_Z"]
    return found


def _active(active: str, missed: dict[str, float]) -> str:
    """The active promise, or what would have to be allowed for the cell to be feasible."""
    if not missed:
        return active
    return "; ".join(f"{name} → {value:.4g}" for name, value in missed.items())
