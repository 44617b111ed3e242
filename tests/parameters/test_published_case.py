"""The published case as the project reads it, number by number, and the two bases of the short-circuit ratio."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.parameters.documents import PUBLISHED, build, changed
from vsgdesign.study.parameters import Study, case_names, load_study


@pytest.fixture(scope="module")
def study() -> Study:
    return load_study(PUBLISHED)


def test_ratings(study: Study) -> None:
    c = study.converter
    assert (c.S_rated, c.V_rated_rms, c.V_dc, c.f_sw) == (5000.0, 110.0, 800.0, 10e3)
    assert c.omega_n == 2.0 * math.pi * 50.0
    assert (c.samples_per_carrier, c.delay_samples, c.zero_sequence) == (2, 0, False)
    assert c.T_s == 50e-6
    assert c.Z_base == pytest.approx(7.26, rel=1e-15)
    assert c.I_rated_pk == pytest.approx(21.427, rel=1e-4)
    assert c.v_max_pk == 400.0
    assert c.current_limit_pu is None


def test_filter_and_inner_loops(study: Study) -> None:
    """The filter's numbers, and Table II's four inner gains from the response times."""
    assert (study.filter.L_1, study.filter.R_1, study.filter.C) == (1e-3, 1e-3, 5e-5)
    assert (study.filter.L_2, study.filter.R_2, study.filter.R_c) == (0.0, 0.0, 0.0)
    gains = study.inner_gains
    assert f"{gains.K_pc:.4f}" == "12.5664"
    assert f"{gains.K_ic:.4e}" == "3.9478e+04"
    assert f"{gains.K_pv:.4f}" == "0.0628"
    assert f"{gains.K_iv:.4f}" == "19.7392"


def test_grids_take_the_ratio_on_the_reactance(study: Study) -> None:
    """SCR 2 is X_g = 3.63 Ω (11.5546 mH), SCR 15 is 1.5406 mH: the range that the paper trains on."""
    assert study.scr_basis == "reactance"
    assert study.grid.R_g == pytest.approx(3.63, rel=1e-15)
    assert f"{study.grid.L_g * 1e3:.4f}" == "11.5546"
    assert f"{build(changed('grid.scr', 15)).grid.L_g * 1e3:.4f}" == "1.5406"
    assert f"{build(changed('grid.scr', 15)).grid.R_g:.3f}" == "0.484"
    scrs = [event.grid.scr(study.converter, "reactance") for event in study.events if event.grid]
    assert scrs == pytest.approx([8.0, 20.0], rel=1e-12)


def test_scenario(study: Study) -> None:
    assert [event.t_s for event in study.events] == [10.0, 20.0, 30.0, 40.0, 50.0]
    assert [event.P_ref for event in study.events] == [2500.0, None, 3000.0, None, None]
    assert study.events[4].Q_ref == 1500.0
    assert study.simulation.duration == 60.0
    assert study.simulation.P_ref == 2000.0
    assert (study.simulation.bridge, study.simulation.start) == ("pwm", "steady_state")
    fixed, scheduled, estimated = study.controllers[:3]
    assert (fixed.name, fixed.kind, fixed.target.settling_time) == ("CVSG", "fixed", 0.5)
    assert fixed.design_grid is not None
    assert (fixed.design_grid.R_g, fixed.design_grid.L_g) == (3.64097929, 0.0116)
    assert (scheduled.name, scheduled.kind, scheduled.update_period) == ("AVSG", "scheduled", 0.02)
    for spec in study.controllers:
        assert (spec.target.P, spec.target.Q, spec.target.droop_ratio) == (4500.0, 1000.0, 0.01)
    assert scheduled.target.settling_time == 1.0
    assert replace(estimated, name="AVSG", estimate="truth") == scheduled
    assert estimated.estimate == "neural"
    assert study.estimator is not None
    assert (study.estimator.recipe, study.estimator.hidden, study.estimator.grid_phase) == ("published", None, True)


def test_the_case_names_where_it_comes_from(study: Study) -> None:
    assert "hoang2025_5kva" in case_names()
    assert "Hoang" in study.source
    assert study.name == "published"


def test_the_two_bases_differ_by_root_two_at_unity_x_over_r() -> None:
    reactance = build(changed("grid.scr_basis", "reactance")).grid
    impedance = build(changed("grid.scr_basis", "impedance")).grid
    assert reactance.R_g / impedance.R_g == pytest.approx(math.sqrt(2.0), rel=1e-14)
    assert reactance.L_g / impedance.L_g == pytest.approx(math.sqrt(2.0), rel=1e-14)


@pytest.mark.parametrize("basis", ["reactance", "impedance"])
@pytest.mark.parametrize(("scr", "x_over_r"), [(0.06, 0.02), (2.0, 1.0), (8.0, 0.35), (20.0, 12.0), (200.0, 9e3)])
def test_scr_and_x_over_r_come_back_from_ohms(study: Study, basis: str, scr: float, x_over_r: float) -> None:
    document = changed("grid", {"scr": scr, "x_over_r": x_over_r, "scr_basis": basis})
    document["controllers"][0].pop("design_grid")
    grid = build(document).grid
    assert grid.scr(study.converter, basis) == pytest.approx(scr, rel=1e-13)
    assert grid.x_over_r(study.converter.omega_n) == pytest.approx(x_over_r, rel=1e-13)
    if basis == "impedance":
        magnitude = abs(complex(grid.R_g, study.converter.omega_n * grid.L_g))
        assert magnitude == pytest.approx(7.26 / scr, rel=1e-13)
