"""The network: its normal equations against a Jacobian by the complex step; projection; phasor windows."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from tests.estimator.phasor_data import OMEGA, phasor_data
from tests.estimator.phasors import phasor_windows
from vsgdesign.artifacts.network_weights import fit_scaling
from vsgdesign.estimator.levenberg_marquardt import (
    NetworkProblem,
    Shape,
    initial_parameters,
    outputs,
    principal_components,
    with_ones,
)

Array = NDArray[np.float64]


def residuals(shape: Shape, x: NDArray, u: Array, t: Array) -> NDArray:
    """y − t of every sample and output in NumPy, for real or complex parameters: independent of the code under test."""
    n, h, m = shape.inputs, shape.hidden, shape.outputs
    first = x[: h * (n + 1)].reshape(h, n + 1)
    second = x[h * (n + 1) :].reshape(m, h + 1)
    hidden = np.tanh(u @ first[:, :n].T + first[:, n])
    return (hidden @ second[:, :h].T + second[:, h] - t).ravel()


def jacobian(shape: Shape, x: Array, u: Array, t: Array) -> Array:
    """By the complex step: exact to rounding."""
    columns = []
    for k in range(len(x)):
        moved = x.astype(complex)
        moved[k] += 1e-30j
        columns.append(np.imag(residuals(shape, moved, u, t)) / 1e-30)
    return np.column_stack(columns)


@pytest.mark.parametrize("shape", [Shape(3, 4, 2), Shape(1, 1, 1), Shape(7, 5, 3)])
@pytest.mark.parametrize("share", [0.0, 0.1])
def test_normal_equations_are_those_of_the_jacobian(shape: Shape, share: float) -> None:
    rng = np.random.default_rng(5)
    u, t = rng.standard_normal((40, shape.inputs)), rng.standard_normal((40, shape.outputs))
    x = initial_parameters(shape, 1)
    assert len(x) == shape.parameters
    problem = NetworkProblem(shape, with_ones(torch.from_numpy(u)), torch.from_numpy(t), share)
    here = problem.linearise(x)
    r, J = residuals(shape, x.numpy(), u, t), jacobian(shape, x.numpy(), u, t)
    keep, own = (1.0 - share) / len(r), share / len(x)
    assert here.cost == pytest.approx(keep * r @ r + own * float(x @ x), rel=1e-13)
    assert here.cost == pytest.approx(problem.cost(x), rel=1e-13)
    gradient = keep * J.T @ r + own * x.numpy()
    assert here.gradient_norm == pytest.approx(2.0 * np.linalg.norm(gradient), rel=1e-12)
    mu = 1e-3  # conditions the system: 1e-10 is rounding times its condition number
    expected = np.linalg.solve(keep * J.T @ J + (own + mu) * np.eye(len(x)), -gradient)
    step = here.step(mu)
    assert step is not None
    np.testing.assert_allclose(step.numpy(), expected, rtol=1e-10, atol=1e-13)


def test_starts_are_seeded_and_differ() -> None:
    shape = Shape(4, 8, 2)
    first = initial_parameters(shape, 3)
    assert torch.equal(first, initial_parameters(shape, 3))
    assert not torch.equal(first, initial_parameters(shape, 4))
    assert not torch.equal(first, initial_parameters(shape, 3, 1))


def test_a_network_on_components_is_one_on_all_inputs() -> None:
    windows, _, _ = phasor_data(300, 1)
    u = fit_scaling(windows).apply(windows)
    projection = principal_components(u)
    assert 3 <= projection.basis.shape[1] <= 10
    projected = projection.project(u)
    np.testing.assert_allclose(projected.std(axis=0), 1.0, rtol=1e-9)
    np.testing.assert_allclose(np.cov(projected.T, bias=True), np.eye(projected.shape[1]), atol=1e-9)
    shape = Shape(projected.shape[1], 8, 2)
    x = initial_parameters(shape, 0)
    weights, bias = projection.fold(*(part.numpy() for part in (shape.layers(x)[0][:, :-1], shape.layers(x)[0][:, -1])))
    folded = torch.from_numpy(np.concatenate([np.column_stack([weights, bias]).ravel(), shape.layers(x)[1].ravel()]))
    small = outputs(shape, x, with_ones(torch.from_numpy(projected)))
    large = outputs(Shape(200, 8, 2), folded, with_ones(torch.from_numpy(u)))
    assert float((small - large).abs().max()) < 1e-12


def test_noise_free_windows_of_synchronised_phasors_have_four_components() -> None:
    """Two phasors: two real and two imaginary parts."""
    windows, _, _ = phasor_data(300, 1, noise=0.0)
    assert principal_components(windows).basis.shape[1] == 4
    assert principal_components(windows, 3).basis.shape[1] == 3
    assert principal_components(windows, 50).basis.shape[1] <= 6  # what is rounding is not used


def test_in_the_full_form_directions_without_input_stay_as_they_were() -> None:
    """Why components are no restriction for inputs of low rank: the step has no part outside their span."""
    rng = np.random.default_rng(8)
    span = np.linalg.qr(rng.standard_normal((12, 12)))[0]
    u = rng.standard_normal((60, 3)) @ span[:, :3].T
    shape = Shape(12, 4, 2)
    problem = NetworkProblem(shape, with_ones(torch.from_numpy(u)), torch.from_numpy(rng.standard_normal((60, 2))))
    step = problem.linearise(initial_parameters(shape, 0)).step(1e-2)
    assert step is not None
    first = shape.layers(step)[0][:, :12].numpy()
    assert np.abs(first @ span[:, :3]).max() > 1e-2
    assert np.abs(first @ span[:, 3:]).max() < 1e-12


def test_phasor_windows_carry_their_power_through_their_grid() -> None:
    """Power, voltage drop and phase from the samples alone."""
    R_g, L_g, P, Q, V_g = 1.1, 4e-3, 2500.0, 800.0, 112.0
    t_s = 2e-4 * np.arange(100, dtype=float)
    v, i = phasor_windows(R_g, [L_g], P, Q, V_g, OMEGA, t_s, 0.3)
    assert v.shape == i.shape == (1, 100)
    turn = np.exp(-1j * OMEGA * t_s) * 2.0 / 100.0 / math.sqrt(2.0)
    V, current = 1j * (v[0] @ turn), 1j * (i[0] @ turn)  # of sines
    S = 3.0 * V * current.conjugate()
    assert S.real == pytest.approx(P, rel=1e-12)
    assert S.imag == pytest.approx(Q, rel=1e-12)
    source = V - current * complex(R_g, OMEGA * L_g)
    assert abs(source) == pytest.approx(V_g, rel=1e-12)
    assert cmath.phase(source) == pytest.approx(0.3, rel=1e-12)


def test_phasor_windows_of_what_the_grid_cannot_carry_are_not_numbers() -> None:
    v, _ = phasor_windows(3.6, [11.6e-3], 2e4, 0.0, 110.0, OMEGA, np.zeros(3))
    assert np.isnan(v).all()
