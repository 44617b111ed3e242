"""What a source's negative sequence and harmonics add to the circuit's states, sample by sample.

The circuit is linear, so every component of the source adds its own exact response (:eq:`source-components`), whatever
the converter does. It can therefore be computed before the samples run, for a whole stretch at once.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.filters import FilterGrid
from vsgdesign.operating_point.plant import plant_step
from vsgdesign.parameters.study import Grid, SourceComponent
from vsgdesign.simulation.circuits import CircuitOfGrid, states_of
from vsgdesign.simulation.timeline import SourceSegment

Array = NDArray[np.float64]


class Interval(NamedTuple):
    """A piece of a sampling interval, or the whole one: its length (s), its grid, and the source at its beginning."""

    h: float
    grid: Grid
    source: SourceSegment
    components: tuple[SourceComponent, ...]


class Background:
    """Rows of ``PlantPieces.background`` for a run. ``V_base_pk``: what the components' amplitudes are taken on, V."""

    def __init__(self, circuit: CircuitOfGrid, V_base_pk: float) -> None:
        self._circuit, self._V_base_pk = circuit, V_base_pk
        self._responses = functools.lru_cache(maxsize=256)(self._response)

    def _response(self, grid: Grid, h: float, omega: float) -> NDArray[Any]:
        """Rows m = 0, 1, 2: what s^m e^{jωs} adds, complex (3, 2n): the part of Re c and, as −j times it, of Im c."""
        circuit = self._circuit(grid)
        source = plant_step(circuit, h, omega, edges=False).source
        if isinstance(circuit, FilterGrid):  # c·ρ: real part on α, imaginary part on β
            return np.stack([source, -1j * source], axis=-1).reshape(3, -1)
        return source[:, :, 0] - 1j * source[:, :, 1]

    def rows(self, intervals: Sequence[Interval], count: int, T_s: float) -> Array:
        """What the components add over ``count`` whole samples (one interval), or over each of several intervals."""
        if len(intervals) > 1:
            return np.concatenate([self._over(one, np.zeros(1)) for one in intervals])
        return self._over(intervals[0], np.arange(count, dtype=np.float64) * T_s)

    def _over(self, interval: Interval, since: Array) -> Array:
        """One row for every instant ``since`` the beginning (s): the states' increments, then the voltage in αβ."""
        source = interval.source
        drift = source.omega_slope * since
        phase = source.phase + (source.omega + 0.5 * drift) * since
        added = np.zeros((len(since), states_of(self._circuit(interval.grid))))
        voltage: NDArray[np.complex128] = np.zeros(len(since), dtype=complex)
        for component in interval.components:
            n = component.order
            c = self._V_base_pk * component.amplitude_pu * np.exp(1j * (n * phase + component.phase))
            rho = self._responses(interval.grid, interval.h, n * source.omega)
            # As for the fundamental (:eq:`source-ramp`): what the ramp of the frequency turns within the interval.
            first, second = 1j * n * drift, 0.5j * n * source.omega_slope - 0.5 * (n * drift) ** 2
            weights = np.stack([c, c * first, c * second], axis=1)
            added += (weights @ rho).real
            voltage = voltage + c
        return np.ascontiguousarray(np.column_stack([added, voltage.real, voltage.imag]))
