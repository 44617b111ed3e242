"""Contenders on the same grids: states, droop, inertia, and what a table promises of itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.design.robust_studies import controller, robust_study, specification
from tests.gain_tables import table
from vsgdesign.artifacts.ready import Ready
from vsgdesign.design.box import scenarios_of_truth
from vsgdesign.design.comparison import (
    Compared,
    Comparison,
    Contender,
    compare_on_grids,
    comparison_axes,
    contender_of,
    gains_at,
    summary_of,
)
from vsgdesign.design.verification import full_order_figures
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.report.comparison.tables import promises_table, verdict_of

GRIDS = ((3.0, 1.0), (6.0, 3.0))


def test_the_axes_have_the_nodes_and_what_lies_between() -> None:
    scr, ratio = comparison_axes(specification(robust_study()))
    assert scr == (3.0, pytest.approx(np.sqrt(18.0), rel=1e-3), 6.0)
    assert ratio == (1.0, pytest.approx(np.sqrt(3.0), rel=1e-3), 3.0)


def test_the_angle_damped_schedule_has_its_droop_and_its_inertia_on_every_grid() -> None:
    """k_1 = 15.8/s² on every grid is H = Aω_0/(2S k_1); A ≈ 3V²X/|Z|² grows with the SCR."""
    study = robust_study()
    contender = contender_of(study, controller(study))
    rows = compare_on_grids(study, specification(study), contender, GRIDS)
    assert [row.D_p for row in rows] == [pytest.approx(contender.droop)] * 2
    assert contender.droop == pytest.approx(5e3 / (0.05 * study.converter.omega_n))
    assert rows[1].inertia > 1.5 * rows[0].inertia
    summary = summary_of(Compared(contender, rows))
    assert summary["droop_W_per_Hz"][0] == pytest.approx(5e3 / (0.05 * 50.0))
    assert summary["kept_exact"] >= summary["kept_wrong"]


def test_fixed_gains_know_no_estimate() -> None:
    study = robust_study()
    gains = PowerLoopGains(2e-3, 1e3, 0.05, 50.0)
    rows = compare_on_grids(study, specification(study), Contender("x", "published", "fixed", 0.0, gains), GRIDS)
    for row in rows:
        assert row.exact is not None
        assert row.wrong is not None
        assert row.exact.overshoot == pytest.approx(row.wrong.overshoot, rel=1e-9)
        assert row.D_p == 1e3
        assert row.inertia == pytest.approx(study.converter.omega_n / (2.0 * 5e3 * 2e-3))


def test_states() -> None:
    """Unstable gains, gains that break promises, a grid without gains."""
    study = robust_study()
    spec = specification(study)

    def states(contender: Contender) -> list[str]:
        return [row.state for row in compare_on_grids(study, spec, contender, GRIDS)]

    published = contender_of(study, controller(study, "published"))
    assert set(states(Contender("x", "published", "fixed", 0.0, PowerLoopGains(1e3, 1e-3, 0.05, 50.0)))) == {"unstable"}
    assert "broken" in states(published)
    assert published.law is not None
    assert not published.law.measured
    nowhere = replace(published, law=replace(published.law, schedule=replace(published.law.schedule, P=9e5)))
    assert set(states(nowhere)) == {"unstable"}
    lenient = replace(spec, overshoot=0.9, settling_time=10.0, disk_margin=0.01, damping_ratio=0.01)
    assert {row.state for row in compare_on_grids(study, lenient, published, GRIDS)} == {"kept"}


def test_a_table_gives_its_own_gains_at_its_nodes() -> None:
    study = robust_study()
    made = table(scr=(3.0, 6.0), x_over_r=(1.0, 3.0), D_p=contender_of(study, controller(study)).droop)
    tabled = replace(controller(study), schedule="table")
    contender = contender_of(study, tabled, Ready(tables={tabled.name: made}))
    gains = gains_at(study, specification(study), contender, 3.0, 1.0, 4500.0, 1000.0)
    assert gains is not None
    for name, values in made.gains._asdict().items():
        assert getattr(gains, name) == pytest.approx(values[0, 0], rel=1e-9), name


def test_kept_means_kept_with_the_real_inner_loops() -> None:
    """Inner loops that are unstable on a stiff grid: what ideal ones keep is not kept, and both are said."""
    study = robust_study()
    spec = replace(specification(study), disk_margin=0.3, damping_ratio=0.1, overshoot=0.3)
    contender = contender_of(study, controller(study))
    grid = [(6.0, 3.0)]
    (good,) = compare_on_grids(study, spec, contender, grid)
    assert (good.state, good.ideal_state) == ("kept", "kept")
    assert good.real_exact is not None
    s = scenarios_of_truth(study, spec, 6.0, 3.0, study.target.P, study.target.Q)
    alone = full_order_figures(study, contender.gains_in(s), s, spec.settling_time).worst()
    assert good.real_wrong == alone
    slow = study.inner_gains._replace(K_pv=study.inner_gains.K_pv * 40.0)
    (bad,) = compare_on_grids(replace(study, inner_gains=slow), spec, contender, grid)
    assert (bad.state, bad.ideal_state) == ("unstable", "kept")
    summary = summary_of(Compared(contender, (bad,)))
    assert (summary["kept_exact"], summary["kept_exact_ideal"]) == (0.0, 1.0)
    assert summary["broken"] == {"unstable": 1}


def test_a_bound_on_the_inertia_is_kept_or_named() -> None:
    study = robust_study()
    lenient = replace(specification(study), disk_margin=0.3, damping_ratio=0.1, overshoot=0.3)
    contender = contender_of(study, controller(study))
    (row,) = compare_on_grids(study, lenient, contender, [(6.0, 3.0)])
    bounded = replace(lenient, H_max=0.9 * row.inertia)
    (row,) = compare_on_grids(study, bounded, contender, [(6.0, 3.0)])
    assert row.state == "broken"
    compared = Compared(contender, (row,))
    assert compared.broken() == {"H_max": 1}
    whole = Comparison(
        study=study, specification=bounded, scr=(6.0,), x_over_r=(3.0,), contenders=(compared,), outside=(), seed=0
    )
    table = promises_table(whole)
    assert any("H ≤" in label for label, _ in table.groups)
    assert "H too large 1" in table.rows[0][-1]
    assert "H too large" in verdict_of(whole, 0)
