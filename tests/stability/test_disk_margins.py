"""Disk margins of both models, at output and input: against python-control and slycot, and what they mean."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from tests.stability.loops_by_control import OpenLoop, open_full_order, open_reduced
from tests.stability.studies import PUBLISHED, Situation, case_study, designed, random_situations, situation
from vsgdesign.linear.model.coupled import CoupledModel
from vsgdesign.linear.operating_point import solve_operating_point
from vsgdesign.linear.operating_point.full_order import Cell
from vsgdesign.linear.stability.loops import FullOrderLoop, ReducedLoop
from vsgdesign.linear.stability.maps import cell_set, reduced_cells
from vsgdesign.linear.stability.margins import (
    MarginTable,
    _around_modes,
    _on_both,
    frequency_grid,
    full_order_margins,
    reduced_margins,
)
from vsgdesign.metrics.margins import disk_margin_per_frequency, guaranteed_margins, largest_singular_value
from vsgdesign.study.parameters.grid import Place

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

BREAKS = ("output", "input")
MODELS = ("reduced", "full_order")


def reduced_of(s: Situation) -> CoupledModel:
    """The coupled reduced model at a situation's operating point."""
    c = s.study.converter
    state = dict(zip(s.model.states, s.model.z[0], strict=True))
    R, X = s.study.path_to_grid(s.cell.grid)
    source = s.cell.source or s.study.grid_source
    E = state["V"] * np.exp(1j * state["delta"])
    S = 3.0 * E * np.conj((E - source.V_g_rms) / complex(R, X))
    assert solve_operating_point(S.real, S.imag, source.V_g_rms, R, X).V_rms == pytest.approx(state["V"], rel=1e-6)
    cells = cell_set(s.study, s.cell.grid.R_g, s.cell.grid.L_g, S.real, S.imag, s.cell.gains)
    assert c.S_rated > 0.0
    return reduced_cells(s.study, cells)


@pytest.fixture(scope="module")
def situations() -> list[Situation]:
    return [s for s in random_situations(26, seed=41) if s.growth < 0.0]


@pytest.fixture(scope="module")
def reduced(situations: list[Situation]) -> list[CoupledModel]:
    return [m for m in map(reduced_of, situations) if np.linalg.eigvals(m.A[0]).real.max() < 0.0]


Case = tuple[OpenLoop, MarginTable, Callable[[Array], Complex], Array]
"""A loop of python-control, the library's table and its S(jω) on a grid, and the grid."""


def cases(which: str, at: str, situations: list[Situation], reduced: list[CoupledModel]) -> list[Case]:
    if which == "reduced":
        return [
            (open_reduced(m, 0, at), reduced_margins(m), lambda w, m=m: ReducedLoop(m, at).on(w)[0], frequency_grid())
            for m in reduced
        ]
    return [
        (
            open_full_order(s.model, 0, at),
            full_order_margins(s.model),
            lambda w, s=s: FullOrderLoop(s.model, at).on(w)[0],
            frequency_grid(s.model.T_s),
        )
        for s in situations
    ]


@pytest.mark.parametrize("at", BREAKS)
@pytest.mark.parametrize("which", MODELS)
def test_against_controls_disk_margins(which: str, at: str, situations, reduced) -> None:
    """control.disk_margins (slycot's μ) on the same 60 frequencies, every one.

    AB13MD bounds μ from above and stops up to 1e-6 early (measured 9.8e-7), so control's margin may be that much lower;
    where it is higher is rounding at low frequencies, where the loop's gain is large (2e-8 on one processor, 2.4e-7 on
    another).
    """
    errors = []
    for open_, _, S, grid in cases(which, at, situations, reduced)[:8]:
        omega = np.ascontiguousarray(grid[np.linspace(40, 490, 60).astype(int)])
        got = disk_margin_per_frequency(S(omega))
        expected, _, _ = control.disk_margins(open_.system(), omega, skew=0.0, returnall=True)
        errors.append(got / expected - 1.0)
    print(f"{which}, {at}: {len(errors)} loops, {np.min(errors):.1e} to {np.max(errors):.1e}")
    assert len(errors) == 8
    assert np.min(errors) > -1e-6
    assert np.max(errors) < 2e-6


@pytest.mark.parametrize("at", BREAKS)
@pytest.mark.parametrize("which", MODELS)
def test_refined_peaks_against_a_finer_grid(which: str, at: str, situations, reduced) -> None:
    """A grid 20 times as fine over all frequencies finds nothing worse, beyond 1e-6; no grid point is worse at all."""
    for _, table, S, grid in cases(which, at, situations, reduced):
        disk = table.disk_output if at == "output" else table.disk_input
        fine = np.geomspace(grid[0], grid[-1], 20 * len(grid))
        assert disk.value[0] <= disk_margin_per_frequency(S(grid)).min() * (1.0 + 1e-12)
        fine_S = S(fine)
        assert disk.value[0] <= disk_margin_per_frequency(fine_S).min() * (1.0 + 1e-6)
        if at == "output":
            assert table.M_s.value[0] >= largest_singular_value(fine_S).max() * (1.0 - 1e-6)
            here = np.linalg.svd(S(table.M_s.omega)[0], compute_uv=False)[0]
            assert table.M_s.value[0] == pytest.approx(here, rel=1e-9)
        # The value belongs to its frequency.
        assert disk.value[0] == pytest.approx(disk_margin_per_frequency(S(disk.omega))[0], rel=1e-9)


@pytest.mark.parametrize("at", BREAKS)
@pytest.mark.parametrize("which", MODELS)
def test_guaranteed_gains_and_phases_keep_the_loop_stable(which: str, at: str, situations, reduced) -> None:
    """Every combination of the guaranteed factor, its inverse, one, and the guaranteed phase either way."""
    for open_, table, _, _ in cases(which, at, situations, reduced):
        disk = table.disk_output if at == "output" else table.disk_input
        factor, degrees = (float(x[0]) for x in guaranteed_margins(disk.value))
        factor = min(factor, 1e3) * (1.0 - 1e-9)
        turn = np.exp(1j * np.radians(degrees * (1.0 - 1e-9)))
        gains, phases = (1.0 / factor, 1.0, factor), (1.0 / turn, 1.0, turn)
        for choices in (gains, phases):
            for first in choices:
                for second in choices:
                    assert open_.growth(np.array([first, second])) < 0.0, (disk.value, first, second)


def critical_factors(M: Complex, alpha: float, share: float) -> Complex:
    """(1 + δ_i/2)/(1 − δ_i/2) with the δ_i of modulus share·α that make det(I − M diag(δ)) = 0 at share 1.

    D M D⁻¹, its two off-diagonal moduli made equal, has its largest singular value at μ, with singular vectors whose
    entries are alike in modulus: δ_i = v_i/(μ u_i).
    """
    d = np.sqrt(np.abs(M[1, 0]) / np.abs(M[0, 1])) if M[0, 1] != 0.0 and M[1, 0] != 0.0 else 1.0
    D = np.diag([np.sqrt(d), 1.0 / np.sqrt(d)])
    u, sigma, vh = np.linalg.svd(D @ M @ np.linalg.inv(D))
    assert 1.0 / sigma[0] == pytest.approx(alpha, rel=1e-6)
    delta = vh[0].conj() / u[:, 0]
    delta *= share * alpha / np.abs(delta)
    return (1.0 + 0.5 * delta) / (1.0 - 0.5 * delta)


@pytest.mark.parametrize("at", BREAKS)
@pytest.mark.parametrize("which", MODELS)
def test_the_critical_perturbation_is_the_margin(which: str, at: str, situations, reduced) -> None:
    """Built from the singular vectors at the critical frequency: at 99 % of α the loop is stable, at 101 % it is not.

    At 100 % it has a mode at the critical frequency on the limit. That is what the disk margin says.
    """
    count = 0
    for open_, table, _, _ in cases(which, at, situations, reduced):
        disk = table.disk_output if at == "output" else table.disk_input
        alpha, omega = float(disk.value[0]), float(disk.omega[0])
        if abs(alpha - 2.0) < 1e-6:  # S = I: nothing is fed back there, and any factor is allowed
            continue
        M = open_.sensitivity(omega) - 0.5 * np.eye(2)
        assert open_.growth(critical_factors(M, alpha, 0.99)) < 0.0
        assert open_.growth(critical_factors(M, alpha, 1.01)) > 0.0
        on_limit = np.linalg.eigvals(open_.closed(critical_factors(M, alpha, 1.0)))
        point = 1j * omega if open_.dt == 0.0 else np.exp(1j * omega * open_.dt)
        scale = omega if open_.dt == 0.0 else omega * open_.dt
        assert np.abs(on_limit - point).min() < 1e-5 * scale
        count += 1
    print(f"{which}, {at}: {count} critical perturbations")
    assert count >= 8


def test_a_resonance_narrower_than_a_step_of_the_grid() -> None:
    """The synchronous resonance a hair from its limit: 1e-5 of its frequency wide, where the grid has 2 % steps.

    At the loop's limit the disk margin is zero, and here it is nearly so. The grid alone sees nothing of it.
    """
    study = case_study(PUBLISHED)

    def at_ratio(ratio: float) -> Situation:
        grid = Place(12.0, ratio, study.scr_basis).grid(study.converter)
        return situation(study, Cell(grid, designed(study, grid, 0.3), 1500.0, 300.0))

    limit = root_scalar(lambda ratio: at_ratio(ratio).growth, bracket=(12.0, 15.0), method="brentq", xtol=1e-9).root
    s = at_ratio(limit * (1.0 - 1e-4))
    assert -0.01 < s.growth < 0.0
    z = np.linalg.eigvals(s.model.A[0])
    worst = np.log(z[np.argmax(np.abs(z))].astype(complex)) / s.model.T_s
    table, S = full_order_margins(s.model), FullOrderLoop(s.model)
    near = abs(worst.imag) + abs(worst.real) * np.linspace(-20.0, 20.0, 20001)
    expected = disk_margin_per_frequency(S.on(near)[0]).min()
    print(f"alpha {expected:.2e} at {abs(worst.imag):.1f} rad/s, width {abs(worst.real):.1e}")
    on_grid = disk_margin_per_frequency(S.on(frequency_grid(s.model.T_s))[0]).min()
    assert on_grid > 20.0 * expected
    assert table.disk_output.value[0] == pytest.approx(expected, rel=1e-4)
    assert table.M_s.value[0] == pytest.approx(largest_singular_value(S.on(near)[0]).max(), rel=1e-4)


class Slope:
    """S of a first-order slope with a resonance on it too narrow to lift a single grid point above its neighbour."""

    width, frequency, share = 0.001, 50.0, 0.005

    def at(self, cells: NDArray[np.intp], omega: Array) -> Complex:  # noqa: ARG002 - there is one cell
        s = 1j * omega
        resonance = 1.0 + self.share * s / (s * s + 2.0 * self.width * s + self.frequency**2)
        return (3.0 / (1.0 + s / 10.0) * resonance)[:, None, None] * np.eye(2)

    def on(self, omega: Array) -> Complex:
        return self.at(np.zeros(1, dtype=np.intp), omega)[None]


def test_a_resonance_on_a_slope_is_looked_at_where_its_mode_is() -> None:
    """No local maximum on the grid tells of it: only the modes' own frequencies do."""
    loop, omega = Slope(), frequency_grid()
    modes = np.array([[complex(-loop.width, loop.frequency), complex(-loop.width, -loop.frequency), -10.0]])
    size = largest_singular_value(loop.on(omega))[0]
    assert np.all(np.diff(size[(omega > 20.0) & (omega < 100.0)]) < 0.0)
    near = np.linspace(49.5, 50.5, 200001)
    local = largest_singular_value(loop.on(near))[0]
    merged, grid = _on_both(loop, omega, _around_modes(modes, omega))
    assert np.all(np.diff(grid) > 0.0)
    seen = largest_singular_value(merged)[0][np.abs(grid[0] - 50.0) < 0.5]
    assert local.max() > 2.5 * local[0]
    assert seen.max() == pytest.approx(local.max(), rel=1e-2)
