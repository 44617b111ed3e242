"""The transient impedance in the coupled model, against complex phasors, the sampled model and the proof's matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import TableBase
from vsgdesign.certificate import Region
from vsgdesign.certificate.region import System, random_points
from vsgdesign.design.box import Scenarios
from vsgdesign.design.evaluation import evaluate_gains
from vsgdesign.equations.power_flow import Lags, power_angle
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.model.coupled import CoupledModel, coupled_model
from vsgdesign.linear.stability.loops import ReducedLoop
from vsgdesign.linear.stability.maps import cells_under, full_order_cells, reduced_cells
from vsgdesign.linear.stability.margins import eigenvalues_of
from vsgdesign.metrics.margins import disk_margin_per_frequency
from vsgdesign.runtime import closed_form_schedule
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.study.parameters.grid import Place

Array = NDArray[np.float64]

LAGS = Lags(0.02, 0.03, 0.4, 2.5, 35.0)
GAINS = PowerLoopGains(0.0077, 900.0, 0.11, 0.69, 0.001, 0.02, 1e-3, -2e-4)
V_N, OMEGA_0 = 110.0, 100.0 * np.pi


def phasor_rates(x: Array, u: Array, path: complex) -> Array:
    """Rates and outputs of the loops on complex phasors: P_f, Q_f and i_f are the states behind δ, ω_i and V."""
    delta, omega_i, V, P_f, Q_f = x[:5]
    P_ref, Q_ref, omega_g, V_g = u
    i_f, Z_t, g = complex(x[5], x[6]), complex(LAGS.R_t, LAGS.X_t), GAINS
    # The voltage V + Z_t i_f lies behind both impedances in series.
    i = (V + Z_t * i_f - V_g * np.exp(-1j * delta)) / (path + Z_t)
    S = 3.0 * (V - Z_t * (i - i_f)) * np.conj(i)
    omega = omega_i - g.k_P * P_f - g.k_Q * (Q_f + g.D_q * V)
    e_P, e_Q = P_ref - P_f + g.D_p * (OMEGA_0 - omega), Q_ref - Q_f + g.D_q * (V_N - V)
    change = LAGS.omega_t * (i - i_f)
    return np.array(
        [
            *(omega - omega_g, g.K_ip * e_P + g.K_pq * e_Q, g.K_qp * e_P + g.K_iq * e_Q),
            *((S.real - P_f) / LAGS.tau_P, (S.imag - Q_f) / LAGS.tau_Q, change.real, change.imag),
            *(S.real, S.imag, omega, V),
        ]
    )


def model_at(delta: float, V: float, V_g: float, path: complex) -> CoupledModel:
    return coupled_model(delta, V, V_g, path.real, path.imag, GAINS, lags=LAGS)


@pytest.fixture(scope="module")
def cells() -> list[tuple[float, float, float, complex]]:
    rng = np.random.default_rng(5)
    return [
        (
            rng.uniform(-0.4, 0.6),
            V_N * rng.uniform(0.9, 1.1),
            V_N,
            rng.uniform(0.4, 5.0) * np.exp(1j * rng.uniform(0.3, 1.5)),
        )
        for _ in range(8)
    ]


def test_matrices_are_the_differences_of_phasors(cells: list[tuple[float, float, float, complex]]) -> None:
    for delta, V, V_g, path in cells:
        i = (V - V_g * np.exp(-1j * delta)) / path
        S = 3.0 * V * np.conj(i)
        x, u = np.array([delta, OMEGA_0, V, S.real, S.imag, i.real, i.imag]), np.array([0.0, 0.0, OMEGA_0, V_g])
        size = np.array([1.0, OMEGA_0, V_N, 1e4, 1e4, 30.0, 30.0, 1e4, 1e4, OMEGA_0, V_N])
        columns = []
        for k in range(11):
            h = np.zeros(11)
            h[k] = 1e-5 * size[k]
            up, down = (np.concatenate([x, u]) + sign * h for sign in (1.0, -1.0))
            change = phasor_rates(up[:7], up[7:], path) - phasor_rates(down[:7], down[7:], path)
            columns.append(change / (2.0 * h[k]) * size[k])
        expected = np.stack(columns, axis=1)
        m = model_at(delta, V, V_g, path)
        assert m.states == ("delta", "omega_i", "V", "P_f", "Q_f", "i_f_d", "i_f_q")
        got = np.block([[m.A[0], m.B[0]], [m.C[0], m.D[0]]]) * size
        error = np.abs(got - expected) / np.abs(expected).max(axis=1, keepdims=True)
        assert error.max() < 1e-7


def test_the_plant_at_rest_is_the_jacobian(cells: list[tuple[float, float, float, complex]]) -> None:
    """s/(s + ω_t) is zero at rest: J_p − C_p A_p⁻¹ B_p = J, which knows no transient impedance."""
    for cell in cells:
        m = model_at(*cell)
        static = coupled_model(cell[0], cell[1], cell[2], cell[3].real, cell[3].imag, GAINS, lags=Lags(0.02, 0.03))
        np.testing.assert_array_equal(m.J, static.J)
        rest = m.J_p[0] - m.C_p[0] @ np.linalg.solve(m.A_p[0], m.B_p[0])
        np.testing.assert_allclose(rest, m.J[0], rtol=1e-9, atol=1e-9 * np.abs(m.J[0]).max())


def test_both_breaks_see_the_loop_that_is_closed(cells: list[tuple[float, float, float, complex]]) -> None:
    """det(I + L) is det(sI − A) over the open poles, at the powers as at the angle and the voltage."""
    for cell in cells:
        m = model_at(*cell)
        s = 1j * np.array([0.7, 4.0, 30.0])
        closed, open_K, open_p = (
            [np.linalg.det(point * np.eye(len(A)) - A) for point in s] for A in (m.A[0], m.A_K[0], m.A_p[0])
        )
        wanted = np.array(closed) / (np.array(open_K) * np.array(open_p))
        for where in ("output", "input"):
            S = ReducedLoop(m, where).on(s.imag)[0]
            np.testing.assert_allclose(1.0 / np.linalg.det(S), wanted, rtol=1e-8)


def test_compiled_margins_are_those_of_the_loop() -> None:
    one = np.ones(1)
    path, V, P, Q = 0.6 + 1.8j, 111.0, 2000.0, 300.0
    delta = power_angle(P, Q, V * V, path.real, path.imag)
    every = path.real, path.imag, path.real, path.imag, 110.0, OMEGA_0, P, Q, V, delta
    s = Scenarios(*(value * one for value in every))
    gains = PowerLoopGains(*(value * one for value in GAINS))
    found = evaluate_gains(gains, s, 1.0, LAGS)
    m = coupled_model(s.delta, s.V_rms, s.V_g_rms, s.R, s.X, gains, lags=LAGS)
    assert found.abscissa[0] == pytest.approx(eigenvalues_of(m).real.max(), rel=1e-9)
    exact = disk_margin_per_frequency(ReducedLoop(m).on(np.geomspace(0.5, 400.0, 28)))[0].min()
    assert found["disk_margin"][0] == pytest.approx(exact, rel=1e-9)


def yielding(R_t_pu: float, X_t_pu: float, corner_hz: float) -> Study:
    study = load_study("studies/survival/laboratory.toml")
    Z = study.converter.Z_base
    inner = study.inner_gains._replace(R_t=R_t_pu * Z, X_t=X_t_pu * Z)
    return replace(study, inner_gains=inner, omega_t=2.0 * np.pi * corner_hz)


@pytest.mark.parametrize("scr", [2.0, 20.0])
def test_slow_modes_are_those_of_the_sampled_model(scr: float) -> None:
    """A reactance of 0.3 pu above 5.5 Hz moves the slow modes by up to 50 %: they are met within 6 %."""
    study = yielding(0.0, 0.3, 5.5)
    spec = next(one for one in study.controllers if one.name == "angle_damped")
    grid, S = Place(scr, 5.0, study.scr_basis).grid(study.converter), study.converter.S_rated
    at = (np.array([value]) for value in (grid.R_g, grid.L_g, 0.4 * S, 0.1 * S))
    cells = cells_under(study, gain_law(study, spec), *at)
    slow, whole = eigenvalues_of(reduced_cells(study, cells))[0], eigenvalues_of(full_order_cells(study, cells))[0]
    for mode in slow[slow.real > -12.0]:
        assert np.abs(whole - mode).min() < 0.06 * abs(mode)


def test_the_certificates_columns_are_the_models() -> None:
    """The state matrices of the proof and of the model have the same eigenvalues: one is written out, one generated."""
    study = yielding(0.1, 0.3, 5.5)
    spec = next(one for one in study.controllers if one.name == "angle_damped")
    S = study.converter.S_rated
    region = Region((2.0, 20.0), (0.5, 20.0), (-0.9 * S, 0.9 * S), (-0.3 * S, 0.3 * S), 0.1)
    system = System(study, closed_form_schedule(study, spec.target), region)
    assert system.states == ("delta", "omega_r", "V", "i_f_d", "i_f_q")
    points, A = system.matrices(random_points(region, 60, np.random.default_rng(0)))
    at = system.cells(points)
    delta = power_angle(points[:, 2], points[:, 3], at.V_rms**2, at.R, at.X)
    model = coupled_model(delta, at.V_rms, study.grid_source.V_g_rms, at.R, at.X, at.gains, lags=system.lags)
    found, wanted = (np.sort_complex(np.linalg.eigvals(one)) for one in (A, model.A))
    np.testing.assert_allclose(found, wanted, rtol=1e-8)


def test_a_base_without_a_transient_impedance_has_no_lags_of_it() -> None:
    base = TableBase(S_rated=5e3, V_rated_rms=110.0, omega_n=OMEGA_0, V_g_rms=110.0, tau_P=0.005)
    assert not base.lags.yields
    assert replace(base, X_t=1.0, omega_t=30.0).lags == Lags(0.005, 0.0, 0.0, 1.0, 30.0)
