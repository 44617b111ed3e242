"""Modes and margins of many cells, from either model, as one table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.margins import LoopMarginTable, PeakTable, disk_margin, loop_margins, peak_sensitivity
from vsgdesign.metrics.modes import damping_ratio, to_continuous
from vsgdesign.model.coupled import CoupledModel
from vsgdesign.operating_point.full_order import FullOrderModel
from vsgdesign.stability.loops import FullOrderLoop, ReducedLoop, SensitivityLoop

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

DEFAULT_POINTS = 500


@dataclass(frozen=True)
class MarginTable:
    """Per cell (N,). An unstable cell has modes but no margins: theirs are NaN.

    ``eigenvalues`` (N, n) are continuous-time, s = ln(z)/T_s for the sampled model.
    """

    eigenvalues: Complex
    stable: NDArray[np.bool_]
    spectral_abscissa: Array
    """Largest real part, 1/s."""
    least_damping: Array
    """Least damping ratio over all modes."""
    least_damped_rad_s: Array
    """Its frequency |s|."""
    disk_output: PeakTable
    disk_input: PeakTable
    """Balanced 2×2 disk margin at the plant's output and input, with the critical frequency."""
    M_s: PeakTable
    """Peak of σ_max(S) at the output."""
    loop_P: LoopMarginTable
    loop_Q: LoopMarginTable
    """Each loop with the other closed."""


def frequency_grid(T_s: float | None = None, points: int = DEFAULT_POINTS) -> Array:
    """Logarithmic grid in rad/s: 1e-3 to 1e4, or to just below the Nyquist frequency of a sampled model."""
    high = 1e4 if T_s is None else 0.999 * np.pi / T_s
    return np.geomspace(1e-3, high, points)


def reduced_margins(model: CoupledModel, omega: Array | None = None) -> MarginTable:
    """Modes and margins of the coupled reduced model."""
    eigenvalues = np.linalg.eigvals(model.A).astype(complex)
    grid = frequency_grid() if omega is None else omega
    return _table(eigenvalues, ReducedLoop(model), ReducedLoop(model, "input"), grid)


def full_order_margins(model: FullOrderModel, omega: Array | None = None) -> MarginTable:
    """Modes and margins of the full-order sampled-data model."""
    eigenvalues = to_continuous(np.linalg.eigvals(model.A), model.T_s)
    grid = frequency_grid(model.T_s) if omega is None else omega
    return _table(eigenvalues, FullOrderLoop(model), FullOrderLoop(model, "input"), grid)


def _table(eigenvalues: Complex, output: SensitivityLoop, input_: SensitivityLoop, omega: Array) -> MarginTable:
    abscissa = eigenvalues.real.max(axis=1)
    damping = damping_ratio(eigenvalues)
    least = np.argmin(damping, axis=1)
    cells = np.arange(len(eigenvalues))
    stable = abscissa < 0.0
    S_out = output.on(omega)
    disk_output = disk_margin(S_out, omega, output.at)
    M_s = peak_sensitivity(S_out, omega, output.at)
    loop_P, loop_Q = (loop_margins(S_out, omega, output.at, k) for k in (0, 1))
    del S_out
    disk_input = disk_margin(input_.on(omega), omega, input_.at)
    return MarginTable(
        eigenvalues,
        stable,
        abscissa,
        damping[cells, least],
        np.abs(eigenvalues[cells, least]),
        _only(disk_output, stable),
        _only(disk_input, stable),
        _only(M_s, stable),
        _only(loop_P, stable),
        _only(loop_Q, stable),
    )


def _only(table: Any, stable: NDArray[np.bool_]) -> Any:
    """The table with NaN in the unstable cells."""
    return type(table)(*(np.where(stable, getattr(table, name), np.nan) for name in table.__dataclass_fields__))
