"""The coupled model: against differences of an independent ODE, its limits, and the formulas of the theory page."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.stability.ideal_converter import IdealConverter
from vsgdesign.equations.power_flow import Lags
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.model import decoupled_loops
from vsgdesign.linear.model.coupled import INPUTS, OUTPUTS, CoupledModel, coupled_model

Array = NDArray[np.float64]

V_N, OMEGA_0 = 110.0, 100.0 * np.pi
GAINS = PowerLoopGains(K_ip=0.00767, D_p=2087.0, K_iq=0.115, D_q=0.687)


def random_point(rng: np.random.Generator) -> dict[str, float]:
    Z, angle = rng.uniform(0.3, 6.0), rng.uniform(0.2, 1.5)
    return {
        "delta": rng.uniform(-0.4, 0.6),
        "V": V_N * rng.uniform(0.85, 1.2),
        "V_g": V_N * rng.uniform(0.9, 1.1),
        "R": Z * np.cos(angle),
        "X": Z * np.sin(angle),
    }


def random_gains(rng: np.random.Generator) -> PowerLoopGains:
    """The published structure's four gains."""
    return PowerLoopGains(*(float(value * 10.0 ** rng.uniform(-1.0, 1.0)) for value in GAINS[:4]))


def random_structure(rng: np.random.Generator) -> PowerLoopGains:
    """All eight: off-diagonal integral gains of either sign, and damping through the angle."""
    sizes = {"K_pq": 0.01, "K_qp": 0.05, "k_P": 1e-3, "k_Q": 1e-3}
    return random_gains(rng)._replace(**{name: float(size * rng.uniform(-1.0, 1.0)) for name, size in sizes.items()})


def model_at(point: dict[str, float], gains: PowerLoopGains, tau_P=0.0, tau_Q=0.0, coupling=True) -> CoupledModel:
    return coupled_model(*point.values(), gains=gains, lags=Lags(tau_P, tau_Q), coupling=coupling)


@pytest.mark.parametrize(("tau_P", "tau_Q"), [(0.0, 0.0), (0.0, 0.03), (0.02, 0.0), (0.02, 0.03)])
def test_matrices_against_differences_of_an_independent_ode(tau_P: float, tau_Q: float) -> None:
    """A, B, C, D of ten random cells, by central differences: 1e-8 of the largest of a row (measured 4e-10)."""
    rng = np.random.default_rng(11)
    states = ["delta", "omega_i", "V", *(["P_f"] if tau_P else []), *(["Q_f"] if tau_Q else [])]
    kept = [0, 1, 2, *([3] if tau_P else []), *([4] if tau_Q else [])]
    for _ in range(10):
        point, gains = random_point(rng), random_structure(rng)
        c = IdealConverter(
            point["R"], point["X"], omega_0=OMEGA_0, V_n=V_N, tau_P=tau_P, tau_Q=tau_Q, **gains._asdict()
        )
        S = c.power(point["delta"], point["V"], point["V_g"])
        x = np.array([point["delta"], OMEGA_0, point["V"], S.real, S.imag])
        u = np.array([S.real + 100.0, S.imag - 50.0, OMEGA_0, point["V_g"]])

        def rates_and_outputs(x: Array, u: Array, c: IdealConverter = c) -> Array:
            S = c.power(x[0], x[2], u[3])
            return np.array([*np.array(c.rates(x, *u))[kept], S.real, S.imag, c.frequency(x, u[3]), x[2]])

        size = np.array([1.0, OMEGA_0, V_N, c.scale, c.scale, c.scale, c.scale, OMEGA_0, V_N])
        both = np.concatenate([x, u])
        columns = []
        for k in [*kept, 5, 6, 7, 8]:
            h = np.zeros(9)
            h[k] = 1e-5 * size[k]
            up, down = both + h, both - h
            change = rates_and_outputs(up[:5], up[5:]) - rates_and_outputs(down[:5], down[5:])
            columns.append(change / (2.0 * h[k]) * size[k])
        expected = np.stack(columns, axis=1)
        m = model_at(point, gains, tau_P, tau_Q)
        assert list(m.states) == states
        scale = size[[*kept, 5, 6, 7, 8]]
        got = np.block([[m.A[0], m.B[0]], [m.C[0], m.D[0]]]) * scale
        error = np.abs(got - expected) / np.abs(expected).max(axis=1, keepdims=True)
        assert error.max() < 1e-8, error.max()


def test_the_loop_is_the_plant_around_the_controller() -> None:
    """C_K (sI − A_K)⁻¹ B_K closed by J has the model's poles: det(I − J K(s)) = det(sI − A)/det(sI − A_K)."""
    rng = np.random.default_rng(12)
    for _ in range(10):
        m = model_at(random_point(rng), random_structure(rng), 0.02, 0.03)
        for s in (1.0j, 3.0 - 2.0j, 40.0 + 5.0j):
            eye = np.eye(5)
            K = m.C_K[0] @ np.linalg.solve(s * eye - m.A_K[0], m.B_K[0])
            left = np.linalg.det(np.eye(2) - m.J[0] @ K)
            right = np.linalg.det(s * eye - m.A[0]) / np.linalg.det(s * eye - m.A_K[0])
            assert left == pytest.approx(right, rel=1e-9)


def test_a_filter_that_gets_faster_disappears() -> None:
    """τ_Q → 0: three modes go to those of the 3-state model in proportion to τ_Q, the fourth to −1/τ_Q."""
    rng = np.random.default_rng(13)
    for _ in range(10):
        point, gains = random_point(rng), random_gains(rng)
        without = model_at(point, gains, tau_Q=0.0)
        assert without.states == ("delta", "omega_i", "V")
        limit = np.linalg.eigvals(without.A[0])
        fast = float(np.abs(limit).max())
        distances = []
        for tau in (1e-3 / fast, 1e-4 / fast, 1e-5 / fast):
            m = model_at(point, gains, tau_Q=tau)
            assert m.states == ("delta", "omega_i", "V", "Q_f")
            modes = np.linalg.eigvals(m.A[0])
            modes = modes[np.argsort(np.abs(modes))]
            assert modes[3].real == pytest.approx(-1.0 / tau, rel=3e-3)
            distances.append(max(np.abs(limit - mode).min() for mode in modes[:3]) / fast)
        assert distances[0] < 2e-2
        # In proportion to τ, or to its root where two modes of the limit fall together; then rounding.
        assert distances[2] < 0.2 * distances[0] + 1e-9


def test_without_coupling_the_papers_loops_are_left() -> None:
    """B = C = 0: modes and step responses of ``decoupled_loops``, closed by python-control."""
    rng = np.random.default_rng(14)
    t = np.linspace(0.0, 3.0, 200)
    for _ in range(10):
        point = random_point(rng)
        gains = PowerLoopGains(*(float(value * 10.0 ** rng.uniform(-0.3, 0.3)) for value in GAINS[:4]))
        full, m = model_at(point, gains), model_at(point, gains, coupling=False)
        A, D = full.J[0, 0, 0], full.J[0, 1, 1]
        assert abs(full.J[0, 0, 1]) > 1e-3 * A / V_N
        np.testing.assert_array_equal(m.J[0], np.diag([A, D]))
        closed: list[Any] = [
            control.feedback(control.ss(loop.A, loop.b, loop.c, 0.0), 1) for loop in decoupled_loops(gains, A, D)
        ]
        poles = np.concatenate([system.poles() for system in closed])
        # Two equal poles part by the root of rounding.
        np.testing.assert_allclose(
            np.sort_complex(np.linalg.eigvals(m.A[0])), np.sort_complex(poles), rtol=1e-6, atol=1e-6
        )
        system: Any = control.ss(m.A[0], m.B[0], m.C[0], m.D[0])
        for k in (0, 1):
            expected = control.step_response(closed[k], t).outputs
            got = control.step_response(system[k, k], t).outputs
            np.testing.assert_allclose(got, expected, atol=1e-9)
            crossed = control.step_response(system[1 - k, k], t).outputs
            np.testing.assert_allclose(crossed, 0.0, atol=1e-9)


def test_the_coupled_channel_of_the_theory_page() -> None:
    """ΔP/ΔP_ref = k₁(s + κ − k₂c)/((s² + d₁s + k₁)(s + κ) − k₁k₂c), c = BC/(AD)."""
    rng = np.random.default_rng(15)
    row, column = OUTPUTS.index("P"), INPUTS.index("P_ref")
    for _ in range(10):
        point, gains = random_point(rng), random_gains(rng)
        m = model_at(point, gains)
        (A, B), (C, D) = m.J[0]
        k_1, d_1, k_2 = gains.K_ip * A, gains.K_ip * gains.D_p, gains.K_iq * D
        kappa, c = gains.K_iq * (D + gains.D_q), B * C / (A * D)
        for s in (0.5j, 4.0j, -1.0 + 9.0j):
            expected = k_1 * (s + kappa - k_2 * c) / ((s * s + d_1 * s + k_1) * (s + kappa) - k_1 * k_2 * c)
            got = m.C[0, row] @ np.linalg.solve(s * np.eye(3) - m.A[0], m.B[0, :, column]) + m.D[0, row, column]
            assert got == pytest.approx(expected, rel=1e-9)


def test_at_rest_the_droops_hold() -> None:
    """dP/dω_g = −D_p at rest, and Q + D_q V is held: the model's gains at s = 0."""
    rng = np.random.default_rng(16)
    for _ in range(5):
        point, gains = random_point(rng), random_structure(rng)
        m = model_at(point, gains, 0.01, 0.02)
        rest = m.D[0] - m.C[0] @ np.linalg.solve(m.A[0], m.B[0])
        P, Q, omega, V = (rest[OUTPUTS.index(n)] for n in ("P", "Q", "omega", "V"))
        np.testing.assert_allclose(P, [1.0, 0.0, -gains.D_p, 0.0], rtol=1e-9, atol=1e-9 * gains.D_p)
        np.testing.assert_allclose(omega, [0.0, 0.0, 1.0, 0.0], atol=1e-9)
        scale = np.abs(Q) + np.abs(gains.D_q * V) + 1.0
        np.testing.assert_allclose((Q + gains.D_q * V) / scale, np.array([0.0, 1.0, 0.0, 0.0]) / scale, atol=1e-9)


def test_many_cells_at_once_are_each_cell_alone() -> None:
    """Scalars spread over arrays; every matrix to the last bit."""
    rng = np.random.default_rng(17)
    R, X, K_ip = rng.uniform(0.2, 2.0, 7), rng.uniform(0.5, 4.0, 7), GAINS.K_ip * rng.uniform(0.5, 2.0, 7)
    many = coupled_model(0.2, 112.0, V_N, R, X, GAINS._replace(K_ip=K_ip), lags=Lags(tau_Q=0.01))
    for k in range(7):
        one = coupled_model(0.2, 112.0, V_N, R[k], X[k], GAINS._replace(K_ip=K_ip[k]), lags=Lags(tau_Q=0.01))
        for name in ("A", "B", "C", "D", "A_K", "B_K", "C_K", "J"):
            np.testing.assert_array_equal(getattr(many, name)[k], getattr(one, name)[0], err_msg=name)
