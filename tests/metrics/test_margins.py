"""Disk margins, peaks and crossings of 2×2 sensitivities: closed forms against slycot, numpy and finer grids."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import slycot
from numpy.typing import NDArray

from vsgdesign.metrics.margins import (
    SensitivityAt,
    disk_margin_per_frequency,
    disk_margin_steps,
    guaranteed_margins,
    largest_singular_value,
    loop_margins_steps,
    peak_sensitivity_steps,
    refined,
)

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]


def random_matrices(rng: np.random.Generator, count: int) -> Complex:
    """2×2 complex matrices over six decades, some of them triangular or diagonal."""
    M = rng.standard_normal((count, 2, 2)) + 1j * rng.standard_normal((count, 2, 2))
    M *= 10.0 ** rng.uniform(-2.0, 2.0, (count, 2, 2))
    M[::10, 0, 1] = 0.0
    M[::30, 1, 0] = 0.0
    return M


def test_mu_against_slycot() -> None:
    """AB13MD for two complex scalars, where its upper bound is exact: 300 random matrices, ≤ 1e-9 relative.

    Where entries lie decades apart AB13MD stops early (7e-7 too high, measured): there ours must not be above.
    """
    rng = np.random.default_rng(1)
    alike = rng.standard_normal((300, 2, 2)) + 1j * rng.standard_normal((300, 2, 2))
    for matrices, below, above in ((alike, 1e-9, 1e-12), (random_matrices(rng, 300), 2e-6, 1e-12)):
        mu = np.array([slycot.ab13md(M, np.array([1, 1]), np.array([2, 2]))[0] for M in matrices])
        error = 1.0 / disk_margin_per_frequency(matrices + 0.5 * np.eye(2)) / mu - 1.0
        print(f"mu: {error.min():.1e} to {error.max():.1e}")
        assert error.max() < above
        assert error.min() > -below


def test_mu_is_reached_and_not_undercut() -> None:
    """μ = max over phases of the spectral radius of M diag(1, e^{jφ}): scanned, from below, to 1e-5."""
    turns = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 2001))
    for M in random_matrices(np.random.default_rng(2), 40):
        mu = 1.0 / disk_margin_per_frequency(M + 0.5 * np.eye(2))
        turned = np.broadcast_to(M, (len(turns), 2, 2)).copy()
        turned[:, :, 1] *= turns[:, None]
        scanned = np.abs(np.linalg.eigvals(turned)).max()
        assert scanned <= mu * (1.0 + 1e-12)
        assert scanned >= mu * (1.0 - 1e-5)


def test_largest_singular_value_against_svd() -> None:
    S = random_matrices(np.random.default_rng(3), 500)
    np.testing.assert_allclose(largest_singular_value(S), np.linalg.svd(S, compute_uv=False)[:, 0], rtol=1e-12)


def test_guaranteed_margins() -> None:
    """Where the disk of complex factors (1 + z/2)/(1 − z/2), \\|z\\| ≤ α, cuts the real axis and the unit circle."""
    alpha = np.array([0.1, 0.7, 1.3, 1.9])
    factor, degrees = guaranteed_margins(alpha)
    z = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 200001))
    for a, f, phi in zip(alpha, factor, degrees, strict=True):
        edge = (1.0 + 0.5 * a * z) / (1.0 - 0.5 * a * z)
        assert f == pytest.approx(edge.real.max(), rel=1e-9)
        assert 1.0 / f == pytest.approx(edge.real.min(), rel=1e-6)
        on_circle = np.argmin(np.abs(np.abs(edge) - 1.0))
        assert phi == pytest.approx(abs(np.degrees(np.angle(edge[on_circle]))), abs=1e-2)
    factor, degrees = guaranteed_margins(np.array([2.0, 3.0]))
    assert np.all(np.isinf(factor))
    assert degrees[0] == pytest.approx(90.0)


def sensitivities(rng: np.random.Generator, count: int) -> tuple[SensitivityAt, list[tuple]]:
    """S of ``count`` stable random 2×2 loops of order 4."""
    systems = []
    while len(systems) < count:
        A = rng.standard_normal((4, 4)) * 3.0
        B, C = rng.standard_normal((4, 2)), rng.standard_normal((2, 4))
        A -= (np.linalg.eigvals(A).real.max() + 10.0 ** rng.uniform(-1.3, 0.5)) * np.eye(4)
        systems.append((A, B, C))

    def at(cells: NDArray[np.intp], omega: Array) -> Complex:
        values = [
            np.eye(2) + systems[c][2] @ np.linalg.solve(1j * w * np.eye(4) - systems[c][0], systems[c][1])
            for c, w in zip(cells, omega, strict=True)
        ]
        return np.array(values).reshape(-1, 2, 2)

    return at, systems


def on_grid(at: SensitivityAt, count: int, omega: Array) -> Complex:
    return np.stack([at(np.full(len(omega), k), omega) for k in range(count)])


@pytest.mark.parametrize(
    ("find", "value", "sign"),
    [
        (disk_margin_steps, disk_margin_per_frequency, -1.0),
        (peak_sensitivity_steps, largest_singular_value, 1.0),
    ],
)
def test_refined_peaks(find, value, sign: float) -> None:
    """Never worse than a grid point, and within 1e-6 of a grid 20 times as fine around it (then ten times more)."""
    count, omega = 25, np.geomspace(1e-2, 1e3, 200)
    at, _ = sensitivities(np.random.default_rng(4), count)
    S = on_grid(at, count, omega)
    peak = refined([find(S, omega, at)])[0]
    grid = sign * value(S)
    assert np.all(sign * peak.value >= grid.max(axis=1) - 1e-12)
    for k in range(count):
        at_peak = value(at(np.array([k]), peak.omega[k : k + 1]))[0]
        assert at_peak == pytest.approx(peak.value[k], rel=1e-12)
        best = int(np.argmax(grid[k]))
        low, high = omega[max(best - 1, 0)], omega[min(best + 1, len(omega) - 1)]
        fine = np.geomspace(low, high, 401)
        found = (
            sign * value(at(np.full(len(fine), k), fine)).max()
            if sign > 0
            else -value(at(np.full(len(fine), k), fine)).min()
        )
        assert sign * peak.value[k] >= found - 1e-12
        assert sign * peak.value[k] == pytest.approx(found, rel=1e-4)
        step = (fine[1] / fine[0]) ** 2
        finer = np.geomspace(max(peak.omega[k] / step, low), min(peak.omega[k] * step, high), 101)
        closest = value(at(np.full(len(finer), k), finer))
        assert peak.value[k] == pytest.approx(closest.max() if sign > 0 else closest.min(), rel=1e-6)


def test_an_extreme_at_the_edge_of_the_grid() -> None:
    """A peak that lies below the first frequency: the first point is taken."""
    omega = np.geomspace(1.0, 10.0, 20)

    def at(_: NDArray[np.intp], w: Array) -> Complex:
        return np.eye(2) * (1.0 + 1.0 / w)[:, None, None] + 0j

    S = on_grid(at, 1, omega)
    peak = refined([peak_sensitivity_steps(S, omega, at)])[0]
    assert peak.value[0] == pytest.approx(2.0, rel=1e-9)
    assert peak.omega[0] == pytest.approx(1.0, rel=1e-6)


def third_order_loop(gain: float) -> SensitivityAt:
    """S with L = gain/(s (s + 1)²) in loop 0 and nothing that crosses in loop 1."""

    def at(_: NDArray[np.intp], w: Array) -> Complex:
        s = 1j * w
        S = np.zeros((len(w), 2, 2), complex)
        S[:, 0, 0] = 1.0 / (1.0 + gain / (s * (s + 1.0) ** 2))
        S[:, 1, 1] = 1.0 / (1.0 + 0.5 / (s + 1.0))
        return S

    return at


def test_crossings_on_paper() -> None:
    """L = k/(s(s+1)²): phase −180° at 1 rad/s with gain k/2; a first-order loop crosses nothing."""
    omega = np.geomspace(1e-3, 1e3, 300)
    for k in (0.3, 1.0, 1.7):
        at = third_order_loop(k)
        margins = refined([loop_margins_steps(on_grid(at, 1, omega), omega, at, 0)])[0]
        assert margins.gain_margin_db[0] == pytest.approx(20.0 * np.log10(2.0 / k), rel=1e-10)
        assert margins.gain_crossing_rad_s[0] == pytest.approx(1.0, rel=1e-10)
        w = float(margins.phase_crossing_rad_s[0])
        assert w * (w * w + 1.0) == pytest.approx(k, rel=1e-10)
        phase = 90.0 - 2.0 * np.degrees(np.arctan(w))
        assert margins.phase_margin_deg[0] == pytest.approx(phase, rel=1e-9)
        assert margins.delay_margin_s[0] == pytest.approx(np.radians(phase) / w, rel=1e-9)
        assert margins.delay_crossing_rad_s[0] == pytest.approx(w, rel=1e-12)
        nothing = refined([loop_margins_steps(on_grid(at, 1, omega), omega, at, 1)])[0]
        for name in ("gain_margin_db", "phase_margin_deg", "delay_margin_s"):
            assert getattr(nothing, name)[0] == np.inf, name
        for name in ("gain_crossing_rad_s", "phase_crossing_rad_s", "delay_crossing_rad_s"):
            assert np.isnan(getattr(nothing, name)[0]), name


def test_gain_may_fall_too() -> None:
    """L = k (s + 1)²/s³ is stable for k > 1/2 only: −180° at 1 rad/s with gain 2k, and less gain is the danger."""
    omega = np.geomspace(1e-3, 1e3, 400)
    for k in (0.8, 2.0):

        def at(_: NDArray[np.intp], w: Array, k: float = k) -> Complex:
            s = 1j * w
            S = np.zeros((len(w), 2, 2), complex)
            S[:, 0, 0], S[:, 1, 1] = 1.0 / (1.0 + k * (s + 1.0) ** 2 / s**3), 1.0
            return S

        margins = refined([loop_margins_steps(on_grid(at, 1, omega), omega, at, 0)])[0]
        assert margins.gain_margin_db[0] == pytest.approx(20.0 * np.log10(2.0 * k), rel=1e-10)
        assert margins.gain_crossing_rad_s[0] == pytest.approx(1.0, rel=1e-10)


def test_a_pair_of_crossings_between_grid_points() -> None:
    """A resonance of 0.2 % width lifts a gain of 0.5 above one, between two points: its phase margin counts."""
    zeta, peak, w_0, low = 1e-3, 3.0, 7.777, 0.5

    def loop(w: Array) -> Complex:
        s = 1j * w
        slow = low / (1.0 + s / 1e4)
        return slow * (1.0 + peak * 2.0 * zeta * w_0 * s / (s * s + 2.0 * zeta * w_0 * s + w_0 * w_0))

    def at(_: NDArray[np.intp], w: Array) -> Complex:
        S = np.zeros((len(w), 2, 2), complex)
        S[:, 0, 0], S[:, 1, 1] = 1.0 / (1.0 + loop(w)), 1.0
        return S

    fine = np.linspace(0.99 * w_0, 1.01 * w_0, 2000001)
    inside = np.flatnonzero(np.abs(loop(fine)) > 1.0)
    ends = fine[[inside[0], inside[-1]]]
    expected = np.abs(np.degrees(np.angle(-loop(ends)))).min()
    for points in (60, 200, 500):
        omega = np.geomspace(1e-3, 1e4, points)
        assert not np.any((omega > ends[0]) & (omega < ends[1]))
        margins = refined([loop_margins_steps(on_grid(at, 1, omega), omega, at, 0)])[0]
        assert margins.phase_margin_deg[0] == pytest.approx(expected, rel=1e-5), points


def test_the_second_peak_of_the_grid_may_be_the_first() -> None:
    """Two resonances, the narrower seen only by its skirts: refined, it wins."""

    def at(_: NDArray[np.intp], w: Array) -> Complex:
        s = 1j * w
        wide = 4.0 * 0.2 * s / (s * s + 0.2 * s + 1.0)
        narrow = 9.0 * 0.1 * s / (s * s + 0.1 * s + 50.0**2)
        return (wide + narrow)[:, None, None] * np.eye(2)

    fine = np.geomspace(49.0, 51.0, 100001)
    expected = largest_singular_value(at(np.zeros(1, dtype=np.intp), fine)).max()
    omega = np.geomspace(1e-2, 1e3, 120)
    S = on_grid(at, 1, omega)
    grid = largest_singular_value(S)[0]
    assert grid[np.abs(np.log(omega / 50.0)) < 0.3].max() < 0.8 * grid.max()
    peak = refined([peak_sensitivity_steps(S, omega, at)])[0]
    assert peak.value[0] == pytest.approx(expected, rel=1e-6)
    # Cells may have grids of their own.
    own = np.stack([omega, omega * 1.01])
    both = refined([peak_sensitivity_steps(np.stack([at(np.zeros(1, dtype=np.intp), w) for w in own]), own, at)])[0]
    np.testing.assert_allclose(both.value, expected, rtol=1e-6)


def test_no_cells() -> None:
    """An empty batch gives empty tables."""
    omega = np.geomspace(1.0, 10.0, 5)
    S = np.empty((0, 5, 2, 2), complex)

    def at(_: NDArray[np.intp], w: Array) -> Complex:
        return np.empty((len(w), 2, 2), complex)

    asked = [disk_margin_steps(S, omega, at), peak_sensitivity_steps(S, omega, at), loop_margins_steps(S, omega, at, 0)]
    disk, peak, loop = refined(asked)
    assert disk.value.shape == peak.value.shape == loop.phase_margin_deg.shape == (0,)
