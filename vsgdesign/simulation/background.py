"""What a source adds to the circuit's states, sample by sample, besides its fundamental: its wander, its negative
sequence, its harmonics and a line.

The circuit is linear, so every component of the source adds its own exact response (:eq:`source-components`), whatever
the converter does. It can therefore be computed before the samples run, for a whole stretch at once.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.filters import FilterGrid
from vsgdesign.frames import rms_to_peak
from vsgdesign.operating_point.plant import plant_step
from vsgdesign.parameters.study import Grid, SourceComponent
from vsgdesign.simulation.circuits import CircuitOfGrid, states_of
from vsgdesign.simulation.timeline import SourceSegment
from vsgdesign.simulation.wander import Wander

Array = NDArray[np.float64]


_ROWS = 1024
"""Rows of a product at once: so few that the library of linear algebra starts no threads, which cost more than they
save and much more on a busy machine."""


class Interval(NamedTuple):
    """A piece of a sampling interval, or the whole one: its length (s), its grid, and the source at its beginning."""

    h: float
    grid: Grid
    source: SourceSegment
    components: tuple[SourceComponent, ...]


class Background:
    """Rows of ``PlantPieces.background`` for a run. ``V_base_pk``: what the components' amplitudes are taken on, V.

    ``wander``: the study's background, where it has one.
    """

    def __init__(self, circuit: CircuitOfGrid, V_base_pk: float, wander: Wander | None = None) -> None:
        self._circuit, self._V_base_pk, self._wander = circuit, V_base_pk, wander
        self._responses = functools.lru_cache(maxsize=256)(self._response)

    def acts(self, intervals: Sequence[Interval]) -> bool:
        """Whether the source has more than the fundamental of the events."""
        of_study = self._wander is not None and self._wander.spec.distorts
        return of_study or any(one.components for one in intervals)

    def _response(self, grid: Grid, h: float, omega: float) -> NDArray[Any]:
        """Rows m = 0, 1, 2: what s^m e^{jωs} adds, complex (3, 2n): the part of Re c and, as −j times it, of Im c."""
        circuit = self._circuit(grid)
        source = plant_step(circuit, h, omega, edges=False).source
        if isinstance(circuit, FilterGrid):  # c·ρ: real part on α, imaginary part on β
            return np.stack([source, -1j * source], axis=-1).reshape(3, -1)
        return source[:, :, 0] - 1j * source[:, :, 1]

    def rows(self, intervals: Sequence[Interval], first: int, count: int, T_s: float) -> Array:
        """What the components add over ``count`` whole samples (one interval), or over each of several intervals.

        ``first``: the sample at which the first interval begins.
        """
        if len(intervals) == 1:
            return self._over(intervals[0], first, np.arange(count, dtype=np.float64) * T_s)
        rows, elapsed = [], 0.0
        for one in intervals:
            rows.append(self._over(one, first, np.zeros(1), elapsed))
            elapsed += one.h
        return np.concatenate(rows)

    def _over(self, interval: Interval, first: int, since: Array, elapsed: float = 0.0) -> Array:
        """One row for every instant ``since`` the beginning (s): the states' increments, then the voltage in αβ.

        ``elapsed``: how far into the sampling interval the beginning lies, s.
        """
        source = interval.source
        drift = source.omega_slope * since
        phase = source.phase + (source.omega + 0.5 * drift) * since
        added = np.zeros((len(since), states_of(self._circuit(interval.grid))))
        voltage: NDArray[np.complex128] = np.zeros(len(since), dtype=complex)

        def add(c: Any, n: float, slope: Any = 0.0) -> None:
            """c e^{j(nω + drift)s} and, of the fundamental, (c + slope·s) e^{…}, over every interval."""
            nonlocal added, voltage
            rho = self._responses(interval.grid, interval.h, n * source.omega)
            # As for the fundamental (:eq:`source-ramp`): what the ramp of the frequency turns within the interval.
            first_, second = 1j * n * drift, 0.5j * n * source.omega_slope - 0.5 * (n * drift) ** 2
            weights = np.stack([c, c * first_ + slope, c * second + slope * first_], axis=1)
            added += _product(weights, rho)
            voltage = voltage + c

        components = interval.components
        if self._wander is not None:
            spec = self._wander.spec
            gain, angle = self._wander.factors(first, len(since))
            components = (*components, *spec.components)
            turn = np.exp(1j * phase)
            change = gain * np.exp(1j * angle) - 1.0
            add(
                change * rms_to_peak(source.V_g_rms + source.V_slope * since) * turn,
                1.0,
                change * rms_to_peak(source.V_slope) * turn,
            )
            phase = phase + angle
        for component in components:
            n = component.order
            add(self._V_base_pk * component.amplitude_pu * np.exp(1j * (n * phase + component.phase)), n)
        if self._wander is not None and self._wander.spec.interharmonic > 0.0:
            spec, T_s = self._wander.spec, self._wander.T_s
            turns = spec.interharmonic_frequency * (first * T_s + elapsed + since)
            c = (
                self._V_base_pk
                * spec.interharmonic
                * np.exp(1j * (2.0 * math.pi * (turns % 1.0) + spec.interharmonic_phase))
            )
            rho = self._responses(interval.grid, interval.h, 2.0 * math.pi * spec.interharmonic_frequency)
            added += (c[:, None] * rho[0]).real
            voltage = voltage + c
        return np.ascontiguousarray(np.column_stack([added, voltage.real, voltage.imag]))


def _product(weights: NDArray[Any], rho: NDArray[Any]) -> Array:
    """Re(weights · rho), (n, 2n)."""
    parts = [np.real(weights[k : k + _ROWS] @ rho) for k in range(0, len(weights), _ROWS)]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
