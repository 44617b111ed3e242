"""One exact step of the circuit against the matrix exponential and quadrature, on gentle and on nasty circuits."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad_vec
from scipy.linalg import expm

from tests.simulation.studies import GAINS, lc_study
from vsgdesign.equations.grid import FilterGrid
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.plant import plant_step, state_matrices
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.circuit_sample import Coefficients, polynomial
from vsgdesign.simulation.run_kind import LARGEST_DEGREE

OMEGA = 100.0 * np.pi
CIRCUITS = {
    "published": FilterGrid(1e-3, 1e-3, 50e-6, 0.0, 0.0, 0.0, 3.63, 3.63 / OMEGA),
    "no resistance at all (A is singular)": FilterGrid(1e-3, 0.0, 50e-6, 0.0, 0.0, 0.0, 0.0, 3.63 / OMEGA),
    "X/R 0.001": FilterGrid(1e-3, 1e-3, 50e-6, 0.0, 0.0, 0.0, 3.63, 3.63e-3 / OMEGA),
    "damped LCL": FilterGrid(2e-3, 0.05, 20e-6, 2.0, 0.5e-3, 0.02, 0.8, 5e-3),
    "1 MVA": FilterGrid(190e-6, 2.4e-3, 280e-6, 0.03, 76e-6, 1.2e-3, 0.02, 0.3e-3),
}
STEPS = [25e-6, 100e-6, 1e-3, 3e-3]


def augmented(A: NDArray[np.float64], b: NDArray[np.float64], t: float) -> NDArray[np.float64]:
    """Response from rest to a unit step of the bridge voltage that began t ago."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = A * t, b * t
    return np.array(expm(matrix)[:3, 3], dtype=np.float64)


def by_hand(f: FilterGrid) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Kirchhoff's laws as matrices."""
    L, R = f.L_2 + f.L_g, f.R_2 + f.R_g
    A = [
        [-(f.R_1 + f.R_c) / f.L_1, -1.0 / f.L_1, f.R_c / f.L_1],
        [1.0 / f.C, 0.0, -1.0 / f.C],
        [f.R_c / L, 1.0 / L, -(R + f.R_c) / L],
    ]
    return np.array(A), np.array([1.0 / f.L_1, 0.0, 0.0]), np.array([0.0, 0.0, -1.0 / L])


@pytest.mark.parametrize("name", CIRCUITS)
def test_matrices(name: str) -> None:
    for found, expected in zip(state_matrices(CIRCUITS[name]), by_hand(CIRCUITS[name]), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("h", STEPS)
@pytest.mark.parametrize("name", CIRCUITS)
def test_transition_and_bridge(name: str, h: float) -> None:
    A, b, _ = by_hand(CIRCUITS[name])
    step = plant_step(CIRCUITS[name], h, OMEGA)
    exact = expm(A * h)
    # Of each entry's natural size √(row scale · column scale); expm itself is good to about 1e-13 there.
    np.testing.assert_allclose(step.transition, exact, rtol=1e-11, atol=1e-12 * np.max(np.abs(exact)))
    integral, _ = quad_vec(lambda s: expm(A * s) @ b, 0.0, h, epsrel=1e-12, norm="max")
    np.testing.assert_allclose(step.bridge, integral, rtol=1e-9, atol=1e-12 * np.max(np.abs(integral)))


@pytest.mark.parametrize("h", STEPS)
@pytest.mark.parametrize("name", CIRCUITS)
def test_source_responses(name: str, h: float) -> None:
    """∫ Φ(h − s) e s^m e^{jωs} ds for m = 0, 1, 2: a held, a ramped and a bent source."""
    A, _, e = by_hand(CIRCUITS[name])
    step = plant_step(CIRCUITS[name], h, OMEGA)
    for m in range(3):

        def response(s: float, m: int = m) -> NDArray[np.complex128]:
            return expm(A * (h - s)) @ e * (s / h) ** m * np.exp(1j * OMEGA * s)

        integral, _ = quad_vec(response, 0.0, h, epsrel=1e-12, norm="max")
        # The closed form of the higher ones subtracts resolvents 1/(ωh)^m larger; they multiply small terms.
        tolerance = 1e-12 / min(OMEGA * h, 1.0) ** m * np.max(np.abs(integral))
        assert np.max(np.abs(step.source[m] / h**m - integral)) < tolerance


@pytest.mark.parametrize("h", STEPS)
@pytest.mark.parametrize("name", CIRCUITS)
def test_edge_polynomial_at_fresh_points(name: str, h: float) -> None:
    A, b, _ = by_hand(CIRCUITS[name])
    step = plant_step(CIRCUITS[name], h, OMEGA)
    stiff = np.max(np.abs(np.linalg.eigvals(A))) * h
    if not np.isfinite(step.edge).all():
        assert stiff > 40.0  # only where the fastest mode dies out many times over
        return
    points = np.append(np.random.default_rng(7).uniform(0.0, h, 25), [0.0, h])
    exact = np.array([augmented(A, b, t) for t in points])
    found = np.polynomial.polynomial.polyval(2.0 * points / h - 1.0, step.edge).T
    if len(step.edge) <= LARGEST_DEGREE + 1:  # what the loop has for a circuit that is not stiff: to the last bit
        padded = np.zeros((LARGEST_DEGREE + 1, 3))
        padded[: len(step.edge)] = step.edge
        written_out = [polynomial(Coefficients(*column), 2.0 * points / h - 1.0) for column in padded.T]
        assert np.array_equal(np.array(written_out).T, found)
    # The series is taken in the middle: rounding grows with e^{λh/2}; 16 is the largest λh/2 that converges well.
    tolerance = 1e-13 + 1e-16 * np.exp(0.5 * stiff)
    np.testing.assert_array_less(np.max(np.abs(found - exact), axis=0), tolerance * np.max(np.abs(exact), axis=0))


def test_two_steps_are_one_of_their_sum() -> None:
    """Semigroup: 30 µs and 70 µs are 100 µs, for a bridge step, a source and an initial state."""
    circuit = CIRCUITS["damped LCL"]
    first, second, whole = (plant_step(circuit, h, OMEGA) for h in (30e-6, 70e-6, 100e-6))
    x = np.array([3.0 + 1.0j, 150.0 - 20.0j, -2.0 + 4.0j])
    v_b, v_g = 200.0 - 30.0j, 155.0 * np.exp(0.3j)
    half_way = first.transition @ x + first.bridge * v_b + first.source[0] * v_g
    there = second.transition @ half_way + second.bridge * v_b + second.source[0] * v_g * np.exp(1j * OMEGA * 30e-6)
    directly = whole.transition @ x + whole.bridge * v_b + whole.source[0] * v_g
    np.testing.assert_allclose(there, directly, rtol=1e-13)


def test_a_circuit_too_stiff_to_switch_is_refused_not_garbled() -> None:
    """Before this was said, the edge series of such a circuit returned 1e29 instead of amperes."""
    sections = '[converter]\nf_sw = "1.25 kHz"\nsamples_per_carrier = 1\n[grid]\nscr = 2\nx_over_r = 0.003\n'
    sections += "[filter]\nC = 2e-3\nL_1 = 5e-3\n[inner_loops]\nvoltage_response_time = 0.1\n"
    study = lc_study("5 ms", sections=sections, log="800 us", simulation='start = "cold"')
    with pytest.raises(InfeasibleStudyError, match="too stiff to switch"):
        simulate(study, [GainChange(0.0, GAINS)], bridge="pwm")
    assert np.isfinite(simulate(study, [GainChange(0.0, GAINS)], bridge="averaged").log).all()
