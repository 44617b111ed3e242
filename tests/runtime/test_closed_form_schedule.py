"""The shipped schedule against the paper's formulas, with A and D from differences of the power flow."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vsgdesign.equations.placing import PLACED
from vsgdesign.errors import NoOperatingPointError
from vsgdesign.runtime import ClosedFormSchedule, closed_form_schedule
from vsgdesign.study.parameters import Grid, load_study, study_from_text

V_G = 110.0
OMEGA = 2.0 * math.pi * 50.0
P, Q = 4500.0, 1000.0

STUDY = """
base = "case:hoang2025_5kva"
[simulation]
duration = "0.1 s"
P_ref = "2 kW"
Q_ref = "1 kvar"
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""


def schedule(settling_time: float = 1.0, damping_ratio: float = 1.0, **changes: Any) -> ClosedFormSchedule:
    given: dict[str, Any] = {
        "P": P,
        "Q": Q,
        "V_g_rms": V_G,
        "omega": OMEGA,
        "settling_time": settling_time,
        "damping_ratio": damping_ratio,
        "droop_ratio": 0.01,
    }
    return ClosedFormSchedule(**(given | changes))


def power(V: float, delta: float, R: float, X: float) -> complex:
    """P + jQ as 3·V·I* with complex phasors: no formula of the library."""
    v = V * np.exp(1j * delta)
    return 3.0 * v * np.conj((v - V_G) / complex(R, X))


def A_and_D(R: float, X: float, P: float = P, Q: float = Q) -> tuple[float, float]:
    """∂P/∂δ and ∂Q/∂V at the upper solution of the power flow, by Newton and central differences."""
    unknown, residual, jacobian = np.array([1.5 * V_G, 0.2]), np.full(2, np.inf), np.eye(2)
    for _ in range(60):
        S = power(*unknown, R=R, X=X)
        residual = np.array([S.real - P, S.imag - Q])
        columns = [(power(*(unknown + h), R=R, X=X) - power(*(unknown - h), R=R, X=X)) / 2e-6 for h in 1e-6 * np.eye(2)]
        jacobian = np.array([[c.real for c in columns], [c.imag for c in columns]])
        unknown = unknown - np.linalg.solve(jacobian, residual)
    assert np.abs(residual).max() < 1e-6
    return jacobian[0, 1], jacobian[1, 0]


GRIDS = [(3.63, 3.63), (0.9075, 0.9075), (0.363, 0.363), (0.5, 2.0), (1.2, 0.9), (0.0, 1.5)]


@pytest.mark.parametrize(("R", "X"), GRIDS)
def test_the_papers_four_gains(R: float, X: float) -> None:
    """At ξ = 1 and T_s = 1 s: D_p = A/2, K_ip = 16/A, D_q = D/100, K_iq = 4/(D + D_q)."""
    A, D = A_and_D(R, X)
    gains = schedule().gains(R, X / OMEGA)
    # Central differences with h = 1e-6 are good to some 1e-8 of A and D.
    assert gains.D_p == pytest.approx(A / 2.0, rel=1e-7)
    assert gains.K_ip == pytest.approx(16.0 / A, rel=1e-7)
    assert gains.D_q == pytest.approx(D / 100.0, rel=1e-7)
    assert gains.K_iq == pytest.approx(4.0 / (1.01 * D), rel=1e-7)
    assert all(isinstance(gain, float) and gain > 0.0 for gain in gains[:4])
    assert gains[4:] == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("settling_time", "damping_ratio"), [(0.5, 1.0), (1.0, 0.7), (2.5, 1.4)])
def test_other_targets(settling_time: float, damping_ratio: float) -> None:
    """K_ip A is ω_n², D_p K_ip is 2ξω_n, with ω_n = 4/(ξ T_s): the loop has the poles asked for."""
    A, D = A_and_D(3.63, 3.63)
    gains = schedule(settling_time, damping_ratio).gains(3.63, 3.63 / OMEGA)
    omega_n = 4.0 / (damping_ratio * settling_time)
    assert gains.K_ip * A == pytest.approx(omega_n**2, rel=1e-7)
    assert gains.K_ip * gains.D_p == pytest.approx(2.0 * damping_ratio * omega_n, rel=1e-7)
    assert gains.K_iq * (D + gains.D_q) == pytest.approx(4.0 / settling_time, rel=1e-7)


def test_check_vector_of_the_authors_model() -> None:
    """R_g and L_g of the authors' released model and the 0.5 s design that Table II prints rounded."""
    gains = schedule(settling_time=0.5).gains(3.64097929, 3.64422703 / OMEGA)
    # The numbers have nine digits.
    assert gains.D_p == pytest.approx(2087.05416, rel=1e-8)
    assert gains.K_ip == pytest.approx(0.00766630799, rel=1e-8)
    assert gains.D_q == pytest.approx(0.686969676, rel=1e-8)
    assert gains.K_iq == pytest.approx(0.115300462, rel=1e-8)
    assert 4.0 * gains.D_p == pytest.approx(8348.21665, rel=1e-8)  # A
    assert 100.0 * gains.D_q == pytest.approx(68.6969676, rel=1e-8)  # D


def test_the_grid_side_inductor_is_part_of_the_path() -> None:
    with_inductor = schedule(R_2=0.2, L_2=1e-3)
    whole = schedule()
    assert with_inductor.gains(0.8, 4e-3) == pytest.approx(whole.gains(1.0, 5e-3), rel=1e-14)


def test_built_from_a_study() -> None:
    study = study_from_text(STUDY)
    built = closed_form_schedule(study, study.controllers[0].target)
    # Droops and poles belong to the other structures, the rating to the other law: this one does not look at them.
    other = {"D_p": 0.0, "D_q": 0.0, "S_rated": 1.0, **PLACED._asdict()}
    assert replace(built, **other) == schedule()
    assert built.gains(study.grid.R_g, study.grid.L_g) == schedule().gains(3.63, 3.63 / OMEGA)


def test_built_from_a_study_with_an_lcl_filter() -> None:
    study = study_from_text(STUDY.replace("hoang2025_5kva", "lab_12kva_lcl"))
    built = closed_form_schedule(study, study.target)
    assert (built.R_2, built.L_2) == (study.filter.R_2, study.filter.L_2) == (0.08, 3e-3)


@pytest.mark.parametrize("scale", [1.001, 1.2, 4.0])
def test_no_operating_point(scale: float) -> None:
    """Beyond the nose it says by how much; just short of it there are gains."""
    # V²'s discriminant with s·(R, X): zero at s = V_g²/(2|Z||S|/3 − 2(RP + XQ)/3).
    R, X = 1.0, 3.0
    edge = V_G**2 / (2.0 * math.hypot(R, X) * math.hypot(P, Q) / 3.0 - 2.0 * (R * P + X * Q) / 3.0)
    grid = Grid(scale * edge * R, scale * edge * X / OMEGA)
    with pytest.raises(NoOperatingPointError) as caught:
        schedule().gains(grid.R_g, grid.L_g)
    assert f"{100.0 / scale:.3g} % of that power" in str(caught.value)
    assert caught.value.shortfall_w == pytest.approx((1.0 - 1.0 / scale) * P, rel=1e-9)


def test_just_short_of_the_nose_the_gains_are_refused_as_not_positive_or_finite() -> None:
    """A or D passes zero before the nose is reached: then the message names them instead."""
    R, X = 0.3, 3.0
    edge = V_G**2 / (2.0 * math.hypot(R, X) * math.hypot(P, Q) / 3.0 - 2.0 * (R * P + X * Q) / 3.0)
    seen = set()
    for scale in np.linspace(0.2, 0.999999, 400):
        try:
            gains = schedule().gains(scale * edge * R, scale * edge * X / OMEGA)
        except NoOperatingPointError as error:
            assert "makes A = " in str(error)  # noqa: PT017 -- both outcomes are right, at different scales
            seen.add("refused")
        else:
            assert all(math.isfinite(gain) and gain > 0.0 for gain in gains[:4])
            seen.add("given")
    assert "given" in seen


def test_absorbing_reactive_power_makes_D_negative() -> None:
    """D = (3V²X/Z² + Q)/V: on a resistive grid an operating point exists whose D has the wrong sign."""
    with pytest.raises(NoOperatingPointError, match=r"makes A = .*, D = -.*Design for another power") as caught:
        schedule(P=100.0, Q=-1000.0).gains(3.0, 0.1 / OMEGA)
    assert math.isnan(caught.value.shortfall_w)


def test_published_study_reproduces_table_ii() -> None:
    study = load_study("studies/published/study.toml")
    fixed = study.controllers[0]
    assert fixed.design_grid is not None
    gains = closed_form_schedule(study, fixed.target).gains(fixed.design_grid.R_g, fixed.design_grid.L_g)
    # Table II prints K_ip 0.00767, D_p 2087, K_iq 0.115, D_q 0.687.
    assert gains[:4] == pytest.approx((0.00767, 2087.0, 0.115, 0.687), rel=3e-3)
