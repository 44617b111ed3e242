"""Modes and margins of many cells, from either model, as one table."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.linear.model.coupled import CoupledModel
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.loops import BREAKS, FullOrderLoop, ReducedLoop, SensitivityLoop
from vsgdesign.metrics.margins import (
    LoopMarginTable,
    PeakTable,
    SensitivityAt,
    Steps,
    disk_margin_steps,
    loop_margins_steps,
    peak_sensitivity_steps,
    refined,
)
from vsgdesign.metrics.modes import damping_ratio, to_continuous

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

DEFAULT_POINTS = 500
MARGINS: dict[str, Callable[[Complex, Array, SensitivityAt], Steps]] = {
    "disk_output": disk_margin_steps,
    "disk_input": disk_margin_steps,
    "M_s": peak_sensitivity_steps,
    "loop_P": partial(loop_margins_steps, loop=0),
    "loop_Q": partial(loop_margins_steps, loop=1),
}
"""Functions for the margins by the name of their column in :class:`MarginTable`. All but ``disk_input`` are those of
the loop that is broken at the plant's output."""

_WIDTHS = (-4.0, -1.0, 0.0, 1.0, 4.0)
"""Frequencies at which a resonance is evaluated, in half-widths (−Re s) from its own frequency."""


@dataclass(frozen=True, kw_only=True)
class MarginTable:
    """Values for each cell (N,). An unstable cell has modes but no margins (NaN).

    ``eigenvalues`` (N, n) are continuous-time, s = ln(z)/T_s for the sampled model.
    """

    eigenvalues: Complex
    stable: NDArray[np.bool_]
    spectral_abscissa: Array
    """Largest real part, 1/s."""
    least_damping: Array
    """Smallest damping ratio of all modes."""
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


def reduced_margins(model: CoupledModel) -> MarginTable:
    """Modes and margins of the coupled reduced model."""
    return _table(eigenvalues_of(model), margins_named(model, MARGINS))


def full_order_margins(model: FullOrderModel) -> MarginTable:
    """Modes and margins of the full-order sampled-data model."""
    return _table(eigenvalues_of(model), margins_named(model, MARGINS))


def eigenvalues_of(model: CoupledModel | FullOrderModel) -> Complex:
    """Continuous-time eigenvalues (N, n) of either model."""
    if isinstance(model, FullOrderModel):
        return to_continuous(model.eigen.values, model.T_s)
    return np.linalg.eigvals(model.A).astype(complex)


def margins_named(
    model: CoupledModel | FullOrderModel, names: Collection[str], omega: Array | None = None
) -> dict[str, Any]:
    """Some of the MARGINS of either model by name, each with rows for the cells (N,), NaN in unstable ones.

    They are PeakTables and LoopMarginTables, as in :class:`MarginTable`, and equal to those of the whole table.
    """
    unknown = [name for name in names if name not in MARGINS]
    if unknown:
        raise ValueError(f"names = {unknown}: must be of {', '.join(MARGINS)}")
    sampled = isinstance(model, FullOrderModel)
    eigenvalues = eigenvalues_of(model)
    stable = eigenvalues.real.max(axis=1) < 0.0
    grid = omega if omega is not None else frequency_grid(model.T_s if sampled else None)
    extra = _around_modes(eigenvalues, grid)
    steps: dict[str, Steps] = {}
    for broken_at in BREAKS:
        wanted = [name for name in names if (name == "disk_input") == (broken_at == "input")]
        if not wanted:
            continue
        loop = FullOrderLoop(model, broken_at) if sampled else ReducedLoop(model, broken_at)
        S, merged = _on_both(loop, grid, extra)
        for name in wanted:
            steps[name] = MARGINS[name](S, merged, loop.at)
    tables = dict(zip(steps, refined(list(steps.values())), strict=True))
    return {name: _only(table, stable) for name, table in tables.items()}


def _table(eigenvalues: Complex, margins: dict[str, Any]) -> MarginTable:
    abscissa = eigenvalues.real.max(axis=1)
    damping = damping_ratio(eigenvalues)
    least = np.argmin(damping, axis=1)
    cells = np.arange(len(eigenvalues))
    return MarginTable(
        eigenvalues=eigenvalues,
        stable=abscissa < 0.0,
        spectral_abscissa=abscissa,
        least_damping=damping[cells, least],
        least_damped_rad_s=np.abs(eigenvalues[cells, least]),
        **margins,
    )


def _around_modes(eigenvalues: Complex, omega: Array) -> Array:
    """Frequencies (N, M) at and beside the resonance of every mode, which may be narrower than a step of the grid."""
    pairs = np.argsort(-eigenvalues.imag, axis=1)[:, : eigenvalues.shape[1] // 2]
    modes = np.take_along_axis(eigenvalues, pairs, axis=1)
    width = np.where(np.isfinite(modes), np.abs(modes.real), 0.0)
    points = (modes.imag[..., None] + width[..., None] * np.array(_WIDTHS)).reshape(
        len(modes), modes.shape[1] * len(_WIDTHS)
    )
    # What has no place on the grid goes between its points, where it does no harm.
    spare = np.resize(np.sqrt(omega[:-1] * omega[1:]), points.shape[1])
    return np.asarray(np.where((points > omega[0]) & (points < omega[-1]), points, spare), dtype=np.float64)


def _on_both(loop: SensitivityLoop, omega: Array, extra: Array) -> tuple[Complex, Array]:
    """S on the common grid and on each cell's own frequencies, merged: S (N, F + M, 2, 2) and the grids (N, F + M)."""
    count, own = extra.shape
    cells = np.repeat(np.arange(count), own)
    S = np.concatenate([loop.on(omega), loop.at(cells, extra.ravel()).reshape(count, own, 2, 2)], axis=1)
    grid = np.concatenate([np.broadcast_to(omega, (count, len(omega))), extra], axis=1)
    order = np.argsort(grid, axis=1, kind="stable")
    return np.take_along_axis(S, order[..., None, None], axis=1), np.take_along_axis(grid, order, axis=1)


def _only(table: Any, stable: NDArray[np.bool_]) -> Any:
    """The table with NaN in the unstable cells."""
    return type(table)(*(np.where(stable, getattr(table, name), np.nan) for name in table.__dataclass_fields__))


def rows_of(table: Any, index: NDArray[np.intp]) -> Any:
    """Some rows of a table of margins, in the given order."""
    parts = {name: getattr(table, name) for name in table.__dataclass_fields__}
    taken = {
        name: rows_of(part, index) if hasattr(part, "__dataclass_fields__") else part[index]
        for name, part in parts.items()
    }
    return type(table)(**taken)
