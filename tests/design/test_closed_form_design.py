"""Designs on every grid of a study: gains, points, and margins from formulas."""

from __future__ import annotations

import math

import pytest

from vsgdesign.design import design_closed_form, distinct_grids
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.stability.loops import loop_margins, power_loops
from vsgdesign.runtime import closed_form_schedule
from vsgdesign.study.parameters import Study, study_from_text

BASE = """
base = "case:hoang2025_5kva"
[simulation]
duration = "1 s"
P_ref = "2 kW"
Q_ref = "1 kvar"
"""

CONTROLLERS = """
[[controllers]]
name = "fixed"
kind = "fixed"
design_grid = { scr = 5, x_over_r = 2 }
[[controllers]]
name = "given"
kind = "fixed"
gains = { K_ip = 0.00767, D_p = 2087, K_iq = 0.115, D_q = 0.687 }
[[controllers]]
name = "scheduled"
kind = "scheduled"
settling_time = "0.8 s"
damping_ratio = 0.9
"""

EVENTS = """
[[events]]
time = "0.2 s"
grid = { scr = 8 }
[[events]]
time = "0.4 s"
P_ref = "3 kW"
[[events]]
time = "0.6 s"
grid = { scr = 20 }
[[events]]
time = "0.8 s"
grid = { scr = 8 }
"""


def study(events: str = EVENTS, controllers: str = CONTROLLERS) -> Study:
    return study_from_text(BASE + controllers + events)


def phase_margin_P(K_ip: float, D_p: float, A: float) -> tuple[float, float]:
    """Crossover and phase margin of K/(s(s + d)): ω² = (√(d⁴ + 4K²) − d²)/2, margin 90° − atan(ω/d)."""
    K, d = K_ip * A, K_ip * D_p
    crossover = math.sqrt(0.5 * (math.sqrt(d**4 + 4.0 * K * K) - d * d))
    return crossover, 90.0 - math.degrees(math.atan(crossover / d))


def test_every_grid_once_in_order_of_appearance() -> None:
    s = study()
    assert [round(grid.scr(s.converter, "reactance")) for grid in distinct_grids(s)] == [2, 8, 20]
    assert distinct_grids(study(events="")) == (s.grid,)


def test_whose_grid_the_gains_are_made_for() -> None:
    s = study()
    fixed, given, scheduled = s.controllers
    for grid in distinct_grids(s):
        assert fixed.design_grid is not None
        made = closed_form_schedule(s, fixed.target).gains(fixed.design_grid.R_g, fixed.design_grid.L_g)
        assert design_closed_form(s, fixed, grid).gains == made
        assert design_closed_form(s, given, grid).gains == given.gains
        made = closed_form_schedule(s, scheduled.target).gains(grid.R_g, grid.L_g)
        assert design_closed_form(s, scheduled, grid).gains == made


def test_the_point_is_the_design_point_on_that_grid() -> None:
    s = study()
    for grid in distinct_grids(s):
        d = design_closed_form(s, s.controllers[0], grid)
        assert (d.controller, d.grid, d.point.P, d.point.Q) == ("fixed", grid, 4500.0, 1000.0)
        v = d.point.V_rms * complex(math.cos(d.point.delta), math.sin(d.point.delta))
        S = 3.0 * v * ((v - 110.0) / complex(grid.R_g, s.converter.omega_n * grid.L_g)).conjugate()
        assert complex(4500.0, 1000.0) == pytest.approx(S, rel=1e-11)
        assert d.point.V_within_limits == (d.point.V_rms < 1.25 * 110.0)


def test_margins_of_the_P_loop_in_closed_form() -> None:
    s = study()
    for spec in s.controllers:
        for grid in distinct_grids(s):
            d = design_closed_form(s, spec, grid)
            crossover, margin = phase_margin_P(d.gains.K_ip, d.gains.D_p, d.point.A)
            # python-control finds the crossover as a polynomial's root: some 1e-9.
            assert d.margins_P.crossover_rad_s == pytest.approx(crossover, rel=1e-7)
            assert d.margins_P.phase_margin_deg == pytest.approx(margin, rel=1e-7)
            assert d.margins_P.delay_margin_s == pytest.approx(math.radians(margin) / crossover, rel=1e-7)
            assert d.margins_P.gain_margin_db is None  # its phase never reaches −180°


def test_margins_of_the_Q_loop_in_closed_form() -> None:
    """K/(s + a) crosses at √(K² − a²) with 180° − atan(ω/a)."""
    s = study()
    for grid in distinct_grids(s):
        d = design_closed_form(s, s.controllers[2], grid)
        K, a = d.gains.K_iq * d.point.D, d.gains.K_iq * d.gains.D_q
        crossover = math.sqrt(K * K - a * a)
        assert d.margins_Q.crossover_rad_s == pytest.approx(crossover, rel=1e-7)
        margin = 180.0 - math.degrees(math.atan(crossover / a))
        assert d.margins_Q.phase_margin_deg == pytest.approx(margin, rel=1e-7)
        assert d.margins_Q.gain_margin_db is None


@pytest.mark.parametrize("zeta", [0.3, 0.7, 1.0, 2.0])
def test_the_phase_margin_depends_on_damping_alone(zeta: float) -> None:
    """tan(margin) = 2ζ/√(√(4ζ⁴ + 1) − 2ζ²): the textbook form; 76.3° at ζ = 1."""
    s = study(controllers=f'[[controllers]]\nname = "s"\nkind = "scheduled"\ndamping_ratio = {zeta}\n')
    margins = [design_closed_form(s, s.controllers[0], grid).margins_P.phase_margin_deg for grid in distinct_grids(s)]
    textbook = math.degrees(math.atan(2.0 * zeta / math.sqrt(math.sqrt(4.0 * zeta**4 + 1.0) - 2.0 * zeta**2)))
    assert margins == pytest.approx([textbook] * 3, rel=1e-7)


def test_a_loop_that_never_crosses_has_no_phase_margin() -> None:
    """So much voltage droop that the Q loop's gain stays below one."""
    gains = study().controllers[1].gains
    assert gains is not None
    margins = loop_margins(power_loops(gains._replace(D_q=100.0), 8348.0, 68.7).Q_open)
    assert margins.phase_margin_deg is None
    assert margins.delay_margin_s is None
    assert margins.crossover_rad_s is None


def test_closed_loops_are_the_papers() -> None:
    gains = study().controllers[1].gains
    assert gains is not None
    loops = power_loops(gains, 8348.0, 68.7)
    s = 1.0 + 2.0j
    K, d = gains.K_ip * 8348.0, gains.K_ip * gains.D_p
    assert complex(loops.P_closed(s)) == pytest.approx(K / (s * s + d * s + K), rel=1e-9)
    Q = gains.K_iq * 68.7
    assert complex(loops.Q_closed(s)) == pytest.approx(Q / (s + Q + gains.K_iq * gains.D_q), rel=1e-9)


@pytest.mark.parametrize("name", ["fixed", "scheduled"])
def test_a_grid_too_weak_for_the_design_point(name: str) -> None:
    s = study(events='[[events]]\ntime = "0.5 s"\ngrid = { scr = 0.3, x_over_r = 3 }\n')
    spec = next(spec for spec in s.controllers if spec.name == name)
    with pytest.raises(InfeasibleStudyError, match=rf"controller {name}: no .*\d %"):
        design_closed_form(s, spec, distinct_grids(s)[1])
