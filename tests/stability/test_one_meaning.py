"""The gains of a cell are one thing: in maps, in the design's evaluation, in the runtime that ships and in EMT."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.design.robust_studies import controller, law, robust_study, specification
from tests.gain_tables import table
from vsgdesign.artifacts.ready import Ready
from vsgdesign.design.box import Scenarios
from vsgdesign.design.comparison import compare_on_grids, contender_of
from vsgdesign.design.evaluation import evaluate_pairs
from vsgdesign.design.verification import full_order_figures
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.stability.maps import MarginMap, estimate_error_map, margin_map, stale_schedule_matrix
from vsgdesign.linear.stability.verdict import describe_cell, left_out, worst_cases
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.runtime.scheduler import scheduler_of
from vsgdesign.runtime.table import table_schedule
from vsgdesign.simulation import build_timeline, gain_feed, simulate
from vsgdesign.simulation.steps import references_at
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import ControllerSpec

SEED = 5


def tabled(structure: str = "angle_damped") -> tuple[Study, ControllerSpec, Ready]:
    """The robust study, alone with a controller that has a table of that structure; normalised columns that vary."""
    study = replace(robust_study(), scr_basis="impedance")
    base = controller(study, structure)
    rng = np.random.default_rng(SEED)
    droop = 318.3 if structure == "angle_damped" else 0.0
    # Designed on every node, also where the grid does not carry the design point.
    columns = {"k_1": 16.0 * rng.uniform(0.8, 1.2, (4, 4)), "k_2": 4.0 * rng.uniform(0.8, 1.2, (4, 4))}
    made = table(structure, parameters=columns, D_p=droop, status=np.full((4, 4), "met"), D_q=law(study, structure).D_q)
    spec = replace(base, schedule="table")
    return replace(study, controllers=(spec,), events=()), spec, Ready(tables={spec.name: made})


def random_cells(study: Study, count: int) -> list[tuple[float, float, float, float]]:
    """SCR, X/R, P, Q of steady states within the converter's limits."""
    rng, found = np.random.default_rng(SEED), []
    fixed = replace(
        controller(robust_study()), kind="fixed", gains=PowerLoopGains(1e-3, 300.0, 0.01, 10.0), schedule=""
    )
    while len(found) < count:
        scr, ratio = float(rng.uniform(1.6, 19.0)), float(rng.uniform(0.4, 9.0))
        P, Q = float(rng.uniform(-4500.0, 4500.0)), float(rng.uniform(-2000.0, 2000.0))
        one = margin_map(study, gain_law(study, fixed), [scr], [ratio], [P], [Q])
        if one.faults == (None,) and one.cells.outside == (None,):
            found.append((scr, ratio, P, Q))
    return found


def cell_gains(field: MarginMap, k: int = 0) -> PowerLoopGains:
    return PowerLoopGains(*(float(value[k]) for value in field.cells.gains))


def scenario(study: Study, field: MarginMap) -> Scenarios:
    """The one cell of a map as the optimizer has it."""
    c, f, w = field.cells, study.filter, study.converter.omega_n
    R, X = c.R_g + f.R_2, w * (c.L_g + f.L_2)
    return Scenarios(R, X, R, X, np.array([study.grid_source.V_g_rms]), np.array([w]), c.P, c.Q, c.V_rms, c.delta)


@pytest.mark.parametrize("structure", ["angle_damped", "published"])
def test_map_optimizer_runtime_and_emt_have_the_same_cell(structure: str) -> None:
    """Gains to 1e-6 (limits of the runtime are rounded to float32), modes to 1e-5, in random cells."""
    study, spec, ready = tabled(structure)
    made = ready.tables[spec.name]
    schedule, shown = table_schedule(made), gain_law(study, spec, ready)
    rule = law(robust_study(), structure)
    for scr, ratio, P, Q in random_cells(study, 4):
        reduced, full = (margin_map(study, shown, [scr], [ratio], [P], [Q], m) for m in ("reduced", "full_order"))
        assert full.faults == (None,), (full.faults, scr, ratio, P, Q)
        R_g, L_g, V = (float(value[0]) for value in (full.cells.R_g, full.cells.L_g, full.cells.V_rms))
        # What ships.
        runtime = scheduler_of(made)
        runtime.start(R_g, L_g)
        shipped = runtime.update_estimate(R_g, L_g, P, Q, V).gains
        np.testing.assert_allclose(cell_gains(full), shipped, rtol=1e-6, atol=1e-15)
        # The optimizer's own evaluation, and its look at the full order.
        s = scenario(study, full)
        own = evaluate_pairs(rule, schedule.normalised(full.cells.R_g, full.cells.L_g), s, 1.3)
        assert own.abscissa[0] == pytest.approx(reduced.table.spectral_abscissa[0], rel=1e-5)
        assert own.damping_ratio[0] == pytest.approx(reduced.table.least_damping[0], rel=1e-5)
        if reduced.table.stable[0]:
            assert own["disk_margin"][0] == pytest.approx(reduced.table.disk_output.value[0], rel=0.03)
        whole = full_order_figures(study, rule.gains(schedule.normalised(full.cells.R_g, full.cells.L_g), s), s, 1.3)
        assert whole.abscissa[0] == pytest.approx(full.table.spectral_abscissa[0], rel=1e-5, abs=1e-6)
        # The comparison.
        np.testing.assert_allclose(
            np.array(contender_of(study, spec, ready).gains_in(s))[:, 0], shipped, rtol=1e-6, atol=1e-15
        )
        # EMT, at rest from the first sample on.
        if not full.table.stable[0]:
            continue
        here = Place(scr, ratio, study.scr_basis).grid(study.converter)
        P_ref, Q_ref = references_at(study, here, PowerLoopGains(*shipped), P, Q)
        run_spec = replace(
            study.simulation, duration=0.1, start="steady_state", bridge="averaged", P_ref=P_ref, Q_ref=Q_ref
        )
        there = replace(study, grid=here, simulation=run_spec)
        run = simulate(there, gain_feed(there, spec, build_timeline(there), ready))
        assert len(run.gain_changes) > 1
        for change in (run.gain_changes[0], run.gain_changes[-1]):
            np.testing.assert_allclose(change.gains, shipped, rtol=1e-6, atol=1e-15)
        assert np.ptp(run.column("P")) < 1e-5 * study.converter.S_rated


def test_a_closed_form_is_at_its_design_point_or_at_what_is_measured() -> None:
    """operating_point decides, and EMT and map decide alike."""
    study = replace(robust_study(), scr_basis="impedance", events=())
    for structure, measured in (("published", False), ("angle_damped", True)):
        spec = controller(study, structure)
        rule = gain_law(study, spec)
        assert rule.measured == measured
        grid = Place(5.0, 2.0, study.scr_basis).grid(study.converter)
        one = margin_map(study, rule, [5.0], [2.0], [-2000.0], [-500.0])
        at_design = rule.schedule.gains(grid.R_g, grid.L_g)
        assert np.allclose(cell_gains(one), at_design, rtol=1e-9) != measured
        P_ref, Q_ref = references_at(study, grid, cell_gains(one), -2000.0, -500.0)
        run_spec = replace(
            study.simulation, duration=0.06, start="steady_state", bridge="averaged", P_ref=P_ref, Q_ref=Q_ref
        )
        there = replace(study, grid=grid, simulation=run_spec)
        run = simulate(there, gain_feed(there, spec, build_timeline(there)))
        np.testing.assert_allclose(run.gain_changes[-1].gains, cell_gains(one), rtol=1e-6, atol=1e-15)


def test_powers_of_the_other_sign_have_gains_of_their_own() -> None:
    """SCR 2, X/R 0.5, P = −0.5 pu: the design point's gains are other gains, with another margin."""
    study, spec, ready = tabled()
    rule = gain_law(study, spec, ready)
    one = margin_map(study, rule, [2.0], [0.5], [-2500.0], [0.0])
    grid = Place(2.0, 0.5, study.scr_basis).grid(study.converter)
    at_design = rule.schedule.gains_over(grid.R_g, grid.L_g)
    other = margin_map(study, lambda *_: PowerLoopGains(*(float(v) for v in at_design)), [2.0], [0.5], [-2500.0], [0.0])
    assert abs(one.table.disk_output.value[0] / other.table.disk_output.value[0] - 1.0) > 0.2


def test_a_grid_that_cannot_carry_the_design_point_is_analysed() -> None:
    """The runtime has gains there: what is measured is within reach, whatever the design point is."""
    study, spec, ready = tabled()
    strained = ready.with_table(spec.name, replace(ready.tables[spec.name], P_design=9e4))
    field = margin_map(study, gain_law(study, spec, strained), [1.6, 5.0], [0.5, 3.0], [500.0], [0.0], "full_order")
    assert field.faults == (None,) * 4


def test_a_wrong_estimate_is_taken_at_the_true_operating_point() -> None:
    """Errors of ±20 %, and another SCR: what the runtime says once its place has arrived, also beyond its box."""
    study, spec, ready = tabled()
    rule, errors = gain_law(study, spec, ready), (-0.2, 0.0, 0.2)
    P, Q = -1200.0, 500.0

    def shipped(R_hat: float, L_hat: float, V: float) -> PowerLoopGains:
        runtime = scheduler_of(ready.tables[spec.name], hysteresis=0.0, confirm=1)
        for _ in range(40):
            runtime.update_estimate(R_hat, L_hat, P, Q, V)
        return runtime.gains

    wrong = estimate_error_map(study, rule, [1.6, 6.0], [0.6], errors, P, Q)
    stale = stale_schedule_matrix(study, rule, [2.0, 12.0], 0.6, P, Q)
    for k, (e_R, e_L) in enumerate((e_R, e_L) for _ in range(2) for e_R in errors for e_L in errors):
        c = wrong.cells
        told = (c.R_g[k] * (1.0 + e_R), c.L_g[k] * (1.0 + e_L), c.V_rms[k])
        np.testing.assert_allclose(cell_gains(wrong, k), shipped(*map(float, told)), rtol=1e-5, atol=1e-15)
    c = stale.cells
    np.testing.assert_allclose(
        cell_gains(stale, 1), shipped(float(c.R_g[2]), float(c.L_g[2]), float(c.V_rms[0])), rtol=1e-5, atol=1e-15
    )


def test_a_table_is_compared_with_the_gains_that_ship() -> None:
    """The published structure's operating point is its design point by default; its table follows what is measured."""
    study, spec, ready = tabled("published")
    assert not spec.target.follow_references
    measured = replace(spec, target=replace(spec.target, follow_references=True))
    grids = [(3.0, 1.0)]
    rows = [
        compare_on_grids(study, specification(study), contender_of(study, one, ready), grids)
        for one in (spec, measured)
    ]
    assert rows[0] == rows[1]


def test_a_cell_outside_the_limits_is_shown_and_never_the_worst() -> None:
    """P = 1 pu into a resistive grid of SCR 2 lifts the voltage far above its limit."""
    study, spec, ready = tabled()
    c = study.converter
    field = margin_map(study, gain_law(study, spec, ready), [2.0, 20.0], [0.5, 5.0], [4500.0], [1000.0])
    V_pu = (field.cells.V_rms / c.V_rated_rms).reshape(2, 2)
    assert V_pu[0, 0] > c.V_max_pu
    outside = np.array([reason is not None for reason in field.cells.outside]).reshape(2, 2)
    np.testing.assert_array_equal(outside, (V_pu > c.V_max_pu) | (V_pu < c.V_min_pu))
    assert f"V = {V_pu[0, 0]:.3g} pu" in left_out(field)[0][0]
    assert outside.any()
    assert not outside.all()
    assert len(field.table.stable) == 4  # shown all the same
    beyond = {describe_cell(field, int(k)) for k in np.flatnonzero(outside)}
    assert not {worst.where for worst in worst_cases(study, field)} & beyond
    limited = replace(study, converter=replace(c, current_limit_pu=0.5, V_max_pu=9.0))
    strained = margin_map(limited, gain_law(limited, spec, ready), [20.0], [5.0], [4500.0], [1000.0])
    assert "current" in str(strained.cells.outside[0])
    assert all(worst.where == "" and worst.share_below == 0.0 for worst in worst_cases(limited, strained))
