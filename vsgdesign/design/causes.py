"""Why a node of a table gives a promise up: what it would keep if one thing were out of the way.

The node is designed anew without the sampling delay, with ideal inner loops, with an exact estimate and with half of
the powers, far from the static limits. The first of these that brings its promises back is the cause.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from vsgdesign.design.box import limit_uses, scenarios_of_estimate
from vsgdesign.design.cell import CellDesign
from vsgdesign.design.evaluation import Figures, law_of
from vsgdesign.design.record import CellRecord, CellTask, designs_of, run_task, with_full_order
from vsgdesign.execution.executors import one_thread

DELAY, INNER, ERROR, LIMIT = "delay", "inner loops", "estimate error", "static limit"
BOTH, NEIGHBOURS, BETWEEN, NONE = "inner loops and estimate error", "neighbours", "interpolation", "specification"

CAUSES = (DELAY, INNER, ERROR, BOTH, LIMIT, NEIGHBOURS, BETWEEN, NONE)

_POWER_SHARE = 0.5
"""Of the box of powers: what a grid at its static limit is asked for to be far from it."""


@dataclass(frozen=True, kw_only=True)
class Cause:
    """Why one node is relaxed. ``keeps``: figures of the node without the cause, None where nothing helped.

    ``limit``, ``limit_use``: the static limit that the node's scenarios come nearest to, and how much of it they use.
    """

    scr: float
    x_over_r: float
    cause: str
    missed: dict[str, float]
    """Promises not kept, with what would have to be allowed."""
    keeps: dict[str, float] | None
    limit: str
    limit_use: float

    def as_document(self) -> dict[str, Any]:
        """JSON's types; what is not finite is null."""
        return asdict(self)


def explain(task: CellTask, record: CellRecord) -> Cause:
    """The cause of a node that misses a promise; ``task`` is how it was designed."""
    with one_thread():
        return _explain(replace(task, pull=1.0), record)


def explain_pair(pair: tuple[CellTask, CellRecord]) -> Cause:
    """:func:`explain` of one argument: for workers."""
    return explain(*pair)


def explained_between(record: CellRecord, missed: dict[str, float]) -> Cause:
    """A node that keeps its promises itself, and is relaxed because what lies between it and another one does not."""
    return Cause(
        scr=record.scr,
        x_over_r=record.x_over_r,
        cause=BETWEEN,
        missed=missed,
        keeps=_kept(record),
        limit="",
        limit_use=float("nan"),
    )


def _explain(task: CellTask, record: CellRecord) -> Cause:
    target, spec, study = task.target, task.spec, task.study
    law = law_of(study, target, spec.aim)
    s = scenarios_of_estimate(study, spec, task.scr, task.x_over_r, target.P, target.Q)
    uses = {name: float(np.nanmax(use)) for name, use in limit_uses(study, s).items()}
    nearest = max(uses, key=lambda name: uses[name])

    def found(cause: str, keeps: dict[str, float] | None) -> Cause:
        return Cause(
            scr=task.scr,
            x_over_r=task.x_over_r,
            cause=cause,
            missed=record.missed,
            keeps=keeps,
            limit=nearest,
            limit_use=uses[nearest],
        )

    ideal: CellDesign | None = None
    undelayed = _without_delay(task)
    # Where ideal inner loops are no cure, less bandwidth and no delay are none.
    for design in designs_of(task, law, s) if record.ideal else ():
        if ideal is None and not (own := with_full_order(task, law, s, design)).missed:
            return found(NEIGHBOURS, _kept(own))
        ideal = ideal or design
        if undelayed is not None and not (seen := with_full_order(undelayed, law, s, design)).missed:
            return found(DELAY, _kept(seen))
    if ideal is not None and not ideal.shortfalls:
        return found(INNER, _figures(ideal.figures, ideal.inertia))
    exact = replace(task, spec=replace(spec, box=spec.box.exact()))
    if any(spec.box.errors):
        if not (seen := run_task(exact)).missed and seen.design is not None:
            return found(ERROR, _kept(seen))
        truth = scenarios_of_estimate(study, exact.spec, task.scr, task.x_over_r, target.P, target.Q)
        first = next(designs_of(exact, law, truth))
        if not first.shortfalls:
            return found(BOTH, _figures(first.figures, first.inertia))
    if not (seen := run_task(_with_less_power(task))).missed and seen.design is not None:
        return found(LIMIT, _kept(seen))
    return found(NONE, None)


def _without_delay(task: CellTask) -> CellTask | None:
    """The same converter, answering in the sample that it measures in; None where it does."""
    c = task.study.converter
    if c.delay_samples == 0:
        return None
    gains = task.study.inner_gains._replace(kappa=0.0)  # nothing to predict over
    return replace(task, study=replace(task.study, converter=replace(c, delay_samples=0), inner_gains=gains))


def _with_less_power(task: CellTask) -> CellTask:
    box, target = task.spec.box, task.target
    less = replace(box, P=tuple(_POWER_SHARE * p for p in box.P), Q=tuple(_POWER_SHARE * q for q in box.Q))
    return replace(
        task,
        spec=replace(task.spec, box=less),
        target=replace(target, P=_POWER_SHARE * target.P, Q=_POWER_SHARE * target.Q),
    )


def _kept(record: CellRecord) -> dict[str, float] | None:
    """The worst of both models."""
    design, full = record.design, record.full_order
    if design is None or full is None:
        return None
    ours = design.figures
    worse = replace(
        ours,
        overshoot_P=max(ours.overshoot_P, full.overshoot_P),
        overshoot_Q=max(ours.overshoot_Q, full.overshoot_Q),
        settling_P=max(ours.settling_P, full.settling_P),
        settling_Q=max(ours.settling_Q, full.settling_Q),
        disk_margin=min(ours.disk_margin, full.disk_margin),
    )
    return _figures(worse, design.inertia)


def _figures(f: Figures, inertia: float) -> dict[str, float]:
    return {
        "settling_time": f.settling_time,
        "overshoot": f.overshoot,
        "disk_margin": f.disk_margin,
        "damping_ratio": f.damping_ratio,
        "H": inertia,
    }
