"""What a page says of the time for which closed forms place their poles, and of the inertia that this costs."""

from __future__ import annotations

import math
from dataclasses import replace

from vsgdesign.equations.placing import OVERSHOOT_PCT, Poles, damping_of, placed_poles
from vsgdesign.equations.structures import STRUCTURES, effective_inertia, steady_droops
from vsgdesign.linear.stability.cells import cell_set, full_order_cells
from vsgdesign.linear.stability.step_responses import full_order_settling
from vsgdesign.report.drawing.quantities import number, percent, plain, plain_quantity
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult
from vsgdesign.study.parameters.study import ControllerSpec, Study


def placing_text(result: ScenarioResult) -> str:
    """T, T_d, m and H of the controllers whose closed form places its poles (:eq:`placed-poles`); empty without one."""
    said = []
    for controller in result.controllers:
        spec, target = controller.spec, controller.spec.target
        closed = spec.gains is None and result.ready.table(spec) is None
        if not closed or STRUCTURES[target.structure].uncoupled or set(target.given) == set(Poles._fields):
            continue
        but = f" all but {', '.join(target.given)}, which the study gives," if target.given else " its poles"
        said.append(
            f"{spec.name}: the closed form for T = {plain(target.settling_time)} s places{but} for T_d = "
            f"(T − {plain_quantity(0.5 * target.mean_s, 's')})(1 − m) = {number(target.placing_time)} s with "
            f"m = {plain(target.margin)}{_inertia(result.study, controller)}.{_price(result.study, controller)}"
        )
    if not said:
        return ""
    error = 0.0 if result.study.specification is None else result.study.specification.error
    known = f" and for an estimate that is wrong by up to {plain(100.0 * error)} %" if error else ""
    why = (
        f"Steps are judged by a mean, which is late by half its length. m is for gains that move during a step{known}."
    )
    return " ".join((*said, why))


def _inertia(study: Study, controller: ControllerResult) -> str:
    """The inertia at the first rest, and what poles for T itself would give there; empty without a rest."""
    rest = next((rest for rest in controller.rests if rest.point is not None), None)
    spec, target = controller.spec, controller.spec.target
    before = placed_poles(target.settling_time, damping_of(OVERSHOOT_PCT))._asdict()
    at_T = replace(target, **{name: value for name, value in before.items() if name not in target.given})
    if rest is None or rest.point is None:
        return ""
    point = rest.grid.R_g, rest.grid.L_g, rest.point.P, rest.point.Q, rest.point.V_rms
    H, without = (_H(study, replace(spec, target=one), point) for one in (target, at_T))
    if not math.isfinite(H) or not math.isfinite(without):
        return ""
    return f"; at its first rest H is {number(H)} s, and poles for T itself would give {number(without)} s"


def _price(study: Study, controller: ControllerResult) -> str:
    """What a fast V loop costs: overshoot of Q and droop at the first rest; empty for other structures."""
    rest = next((rest for rest in controller.rests if rest.point is not None), None)
    target = controller.spec.target
    if STRUCTURES[target.structure].fast_V is None or rest is None or rest.point is None:
        return ""
    c, gains = study.converter, rest.gains
    own = replace(study.with_limit_of(controller.spec), grid_source=rest.source)
    model = full_order_cells(own, cell_set(own, rest.grid.R_g, rest.grid.L_g, rest.point.P, rest.point.Q, gains))
    _, overshoot = full_order_settling(model, "Q_ref", "Q")
    droop = 100.0 * float(steady_droops(gains, c.S_rated, c.omega_n, c.V_rated_rms)[0])
    stable = len(overshoot) and math.isfinite(overshoot[0])
    of_Q = f"a small step of Q_ref overshoots by {percent(100.0 * overshoot[0])} %" if stable else "it is unstable"
    return f" Its V loop has k_2 = {plain(target.k_2)} 1/s: there {of_Q}, and the P–f droop is {percent(droop)} %."


def _H(study: Study, spec: ControllerSpec, point: tuple[float, ...]) -> float:
    gains = gain_law(study, spec)(*point)
    return float(effective_inertia(gains, study.converter.S_rated, study.converter.omega_n))
