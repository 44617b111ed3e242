"""Sensitivities of the sampled model's modes against central differences of steady states solved anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.stability.studies import (
    LABORATORY,
    PUBLISHED,
    UTILITY,
    Situation,
    another_structure,
    case_study,
    designed,
    rated,
    situation,
)
from vsgdesign.linear.model.full_order import PARAMETERS
from vsgdesign.linear.operating_point.full_order import Cell, parameter_sensitivity
from vsgdesign.linear.stability.loci import RANKED, mode_sensitivities
from vsgdesign.metrics.modes import eigenvalue_sensitivity
from vsgdesign.study.parameters.grid import GridSource, Place

Array = NDArray[np.float64]

H = 4e-3
"""Part of a parameter by which it is moved: Richardson's rule leaves H⁴, rounding 1e-11/H (slow modes amplify it)."""


def place(case: str, delay: int, tau: float) -> Situation:
    """A stable cell off nominal frequency and voltage, so that every parameter matters."""
    study = case_study(case, delay=delay, tau_P=tau, tau_Q=0.7 * tau)
    c = study.converter
    if tau > 0.0:
        inner = study.inner_gains._replace(R_t=0.05 * c.Z_base, X_t=-0.03 * c.Z_base)
        kappa = 0.8 if c.delay_samples else 0.0
        study = replace(study, inner_gains=inner._replace(kappa=kappa))
    if case == UTILITY:  # a filter without damping resistor, whose derivative is then one-sided in nature
        study = replace(study, filter=replace(study.filter, R_c=0.0))
    grid = Place(4.0, 1.7, study.scr_basis).grid(c)
    source = GridSource(0.98 * c.V_rated_rms, 1.0002 * c.omega_n)
    gains = designed(study, grid, 0.6, damping_ratio=0.6)  # no double modes: theirs have no derivative
    if delay:
        gains = another_structure(np.random.default_rng(3), gains)
    return situation(study, Cell(grid, gains, 0.4 * c.S_rated, 0.1 * c.S_rated, source))


def moved_matrix(s: Situation, column: int, step: float) -> Array:
    """A at the fixed point of the map for one parameter moved, found by Newton's method in scaled states."""
    p = s.model.p[0].copy()
    p[column] += step
    z_0 = s.model.z[0]
    scale = rated(s.study, s.model.states)

    def residual(y: Array) -> Array:
        z = y * scale
        return (np.array(s.model.map.step(z, p)[0]).ravel() - z) / scale

    def slope(y: Array) -> Array:
        A = np.array(s.model.map.linear(y * scale, p)[0])
        return (A - np.eye(len(y))) * scale / scale[:, None]

    y = z_0 / scale
    for _ in range(8):
        change = np.linalg.solve(slope(y), residual(y))
        y = y - change
        if np.abs(change).max() < 1e-15 * np.abs(y).max():
            break
    assert np.abs(residual(y)).max() < 1e-12
    return np.array(s.model.map.linear(y * scale, p)[0])


def typical(s: Situation, column: int) -> float:
    """The size by which a parameter is measured: its own, or what it is added to where it is zero."""
    grid, gains = s.cell.grid, s.cell.gains
    if PARAMETERS[column] in ("omega_0", "omega_g"):  # the droop moves P by half of rated
        return 0.5 * s.study.converter.S_rated / gains.D_p
    value = abs(float(s.model.p[0, column]))
    if value > 0.0:
        return value
    return {
        "L_2": grid.L_g,
        "R_2": grid.R_g,
        "R_1": grid.R_g,
        "R_c": grid.R_g,
        "R_t": 0.1 * s.study.converter.Z_base,
        "X_t": 0.1 * s.study.converter.Z_base,
        "kappa": 1.0,
        "K_pq": gains.K_ip,
        "K_qp": gains.K_iq,
        "k_P": 1.0 / gains.D_p,
        "k_Q": 1.0 / gains.D_p,
    }[PARAMETERS[column]]


@pytest.mark.parametrize(
    ("case", "delay", "tau"),
    [
        (PUBLISHED, 0, 0.0),
        (PUBLISHED, 1, 0.003),
        (LABORATORY, 0, 0.003),
        (LABORATORY, 1, 0.0),
        (UTILITY, 1, 0.002),
    ],
)
def test_every_parameter_against_differences(case: str, delay: int, tau: float) -> None:
    """dA/dp, and dλ/dp of every mode: by central differences of steady states solved anew.

    The map itself and its derivative by z are held elsewhere; here what follows the parameter, and the chain of
    derivatives. The controller's constants (ωC, ωL, the limits) do not follow the plant. In per unit, relative to the
    largest entry; modes relative to the one that moves most.
    """
    s = place(case, delay, tau)
    A, n = s.model.A[0], s.model.A.shape[1]
    scale = rated(s.study, s.model.states)
    worst_A, worst_mode = 0.0, 0.0
    for column, name in enumerate(PARAMETERS):
        size = typical(s, column)
        differences = []
        for h in (H * size, 0.5 * H * size):
            differences.append((moved_matrix(s, column, h) - moved_matrix(s, column, -h)) / (2.0 * h))
        expected = (4.0 * differences[1] - differences[0]) / 3.0
        got = parameter_sensitivity(s.model, 0, name)
        in_units = size * scale / scale[:, None]
        largest = max(np.abs(expected * in_units).max(), 1e-2)  # what matters less is rounding's
        worst_A = max(worst_A, float(np.abs((got - expected) * in_units).max() / largest))
        eigenvalues, derivatives = eigenvalue_sensitivity(A, got)
        motion = []
        for h in (0.1 * H * size, 0.05 * H * size):  # modes close together turn soon
            up, down = (np.linalg.eigvals(moved_matrix(s, column, sign * h)) for sign in (1.0, -1.0))
            near = [up[np.argmin(abs(up - e))] - down[np.argmin(abs(down - e))] for e in eigenvalues]
            motion.append(np.array(near) / (2.0 * h))
        moved = (4.0 * motion[1] - motion[0]) / 3.0
        reach = max(float(np.abs(derivatives).max()) * size, 1e-3)
        worst_mode = max(worst_mode, float(np.abs(derivatives - moved).max() * size / reach))
    print(f"{case}, delay {delay}: {n} states; dA {worst_A:.1e}, dlambda {worst_mode:.1e}")
    assert worst_A < 2e-6
    assert worst_mode < 5e-5


def test_sensitivities_are_sorted_and_relative() -> None:
    """ds/dp of the mode asked for: against the continuous eigenvalues' motion; p·ds/dp, the largest first."""
    s = place(PUBLISHED, 0, 0.0)
    T_s = s.model.T_s
    modes = np.log(np.linalg.eigvals(s.model.A[0]).astype(complex)) / T_s
    slowest = complex(modes[np.argmin(np.abs(modes))])
    found = mode_sensitivities(s.model, 0, slowest, PARAMETERS)
    assert [item.parameter for item in found] != list(PARAMETERS)
    assert {item.parameter for item in found} == set(PARAMETERS)
    by_default = mode_sensitivities(s.model, 0, slowest)
    assert {item.parameter for item in by_default} == set(RANKED) < set(PARAMETERS)
    sizes = [abs(item.relative) for item in found]
    assert sizes == sorted(sizes, reverse=True)
    for item in found[:6]:
        column = PARAMETERS.index(item.parameter)
        assert item.value == s.model.p[0, column]
        assert item.relative == pytest.approx(item.value * item.ds_dp)
        h = 1e-4 * typical(s, column)
        ends = []
        for sign in (1.0, -1.0):
            moved = np.log(np.linalg.eigvals(moved_matrix(s, column, sign * h)).astype(complex)) / T_s
            ends.append(moved[np.argmin(np.abs(moved - slowest))])
        assert item.ds_dp == pytest.approx((ends[0] - ends[1]) / (2.0 * h), rel=1e-3, abs=1e-6 * sizes[0] / item.value)


def test_an_unknown_parameter_is_named() -> None:
    s = place(PUBLISHED, 0, 0.0)
    with pytest.raises(ValueError, match="must be one of L_1"):
        parameter_sensitivity(s.model, 0, "gain")
