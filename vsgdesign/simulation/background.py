"""What a source adds to the circuit's states, sample by sample, besides its fundamental: its wander, its negative
sequence, its harmonics, a line, or a recorded voltage in its place.

The circuit is linear, so every component of the source adds its own exact response (:eq:`source-components`), whatever
the converter does. It can therefore be computed before the samples run, for a whole stretch at once.
"""

from __future__ import annotations

import cmath
import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.filters import FilterGrid
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.linear.operating_point.plant import plant_step, straight_line_responses
from vsgdesign.simulation.circuits import CircuitOfConnection, Connection, states_of
from vsgdesign.simulation.timeline import SourceSegment, Timeline
from vsgdesign.study.parameters.background import BackgroundSpec
from vsgdesign.study.parameters.source import SourceComponent

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


_ROWS = 1024
"""Rows of a product at once: so few that the library of linear algebra starts no threads, which cost more than they
save and much more on a busy machine."""


class Interval(NamedTuple):
    """A piece of a sampling interval, or the whole one: its length (s), what the filter is connected to,
    and the source at its beginning."""

    h: float
    connection: Connection
    source: SourceSegment
    components: tuple[SourceComponent, ...]


class Background:
    """What the source adds in each sample of a run. ``V_base_pk`` is the base of the components' amplitudes, V peak.

    ``timeline`` is that of the run if it has a background or a record.
    """

    def __init__(self, circuit: CircuitOfConnection, V_base_pk: float, timeline: Timeline | None = None) -> None:
        self._circuit, self._V_base_pk = circuit, V_base_pk
        self._wander = None if timeline is None else timeline.wander
        self._replay = None if timeline is None else timeline.replay
        self._responses = functools.lru_cache(maxsize=256)(self._response)
        self._lines = functools.lru_cache(maxsize=64)(lambda one, h: straight_line_responses(circuit(one), h))
        self._turned: dict[tuple[float, int, float], Complex] = {}
        self._of_steady: dict[tuple[Any, ...], Array] = {}

    def acts(self, intervals: Sequence[Interval]) -> bool:
        """Whether the source has more than a fundamental of constant amplitude and frequency."""
        of_study = self._replay is not None or (self._wander is not None and self._wander.spec.distorts)
        return of_study or any(one.components or not one.source.steady for one in intervals)

    def _response(self, connection: Connection, h: float, omega: float) -> NDArray[Any]:
        """Rows m = 0, 1, 2: what s^m e^{jωs} adds, complex (3, 2n): the part of Re c and, as −j times it, of Im c."""
        circuit = self._circuit(connection)
        source = plant_step(circuit, h, omega, edges=False).source
        if isinstance(circuit, FilterGrid):  # c·ρ: real part on α, imaginary part on β
            return np.stack([source, -1j * source], axis=-1).reshape(3, -1)
        return source[:, :, 0] - 1j * source[:, :, 1]

    def rows(self, intervals: Sequence[Interval], first: int, count: int, T_s: float) -> Array:
        """What the components add over ``count`` whole samples (one interval), or over each of several intervals
        (:eq:`source-components`).

        ``first``: the sample at which the first interval begins. A row has the states' increments, then the voltage at
        the interval's beginning, α and β.
        """
        if len(intervals) == 1:
            return self._over(intervals[0], first, np.arange(count, dtype=np.float64) * T_s, 0.0)
        begins = np.cumsum([0.0, *(one.h for one in intervals[:-1])])
        return np.concatenate(
            [self._over(one, first, np.zeros(1), at) for one, at in zip(intervals, begins, strict=True)]
        )

    def _over(self, interval: Interval, first: int, since: Array, elapsed: float) -> Array:
        """One row for every instant ``since`` the beginning (s), which is ``elapsed`` s after the sample ``first``."""
        source = interval.source
        drift = source.omega_slope * since
        phase = source.phase + (source.omega + 0.5 * drift) * since
        total = _Total(len(since), states_of(self._circuit(interval.connection)))
        if not source.steady:
            turn, V = np.exp(1j * phase), rms_to_peak(source.V_g_rms + source.V_slope * since)
            self._add_rotating(total, interval, 1.0, V * turn, drift, rms_to_peak(source.V_slope) * turn)
        if self._replay is not None:
            self._add_record(total, interval, first, elapsed, phase)
        if self._wander is None:
            for component in interval.components:
                n = component.order
                c = self._V_base_pk * component.amplitude_pu * np.exp(1j * (n * phase + component.phase))
                self._add_rotating(total, interval, n, c, drift)
            return total.rows
        gain, angle = self._wander.factors(first, len(since))
        moved = np.exp(1j * angle)
        turn = np.exp(1j * phase) if source.omega_slope else cmath.exp(1j * source.phase) * self._turns(source, since)
        moved *= turn
        change = gain * moved
        change -= turn
        components, powers = (*interval.components, *self._wander.spec.components), _Powers(moved)
        orders = [one.order for one in components]
        waves = [powers.of(int(n)) if n.is_integer() else np.exp(1j * (n * (phase + angle))) for n in orders]
        if source.steady:  # without ramps there are no terms of s and s²: one product for all
            total.add([change, *waves], self._steady(interval.connection, interval.h, source, components))
        else:
            V, slope = rms_to_peak(source.V_g_rms + source.V_slope * since), rms_to_peak(source.V_slope)
            self._add_rotating(total, interval, 1.0, V * change, drift, slope * change)
            for one, wave in zip(components, waves, strict=True):
                self._add_rotating(total, interval, one.order, self._phasor(one) * wave, drift)
        if self._wander.spec.interharmonic > 0.0:
            self._add_line(total, interval, first * self._wander.T_s + elapsed + since, self._wander.spec)
        return total.rows

    def _phasor(self, component: SourceComponent) -> complex:
        return self._V_base_pk * component.amplitude_pu * cmath.exp(1j * component.phase)

    def _steady(
        self, connection: Connection, h: float, source: SourceSegment, components: tuple[SourceComponent, ...]
    ) -> Array:
        """What the waves of a steady source add, which are of length 1: its fundamental and its components. It is the
        same in all stretches between two events."""
        key = connection, h, source.omega, source.V_g_rms, components
        if key not in self._of_steady:
            sizes = [rms_to_peak(source.V_g_rms), *map(self._phasor, components)]
            orders = [1.0, *(one.order for one in components)]
            rho = [self._responses(connection, h, n * source.omega)[0] for n in orders]
            self._of_steady = {key: _real_product(np.array(sizes)[:, None] * np.array(rho), sizes)}
        return self._of_steady[key]

    def _turns(self, source: SourceSegment, since: Array) -> Complex:
        """e^{jωs} at instants from the beginning on, which are the same in all stretches of a length."""
        key = source.omega, len(since), float(since[-1])
        if key not in self._turned:
            self._turned = {key: np.exp(1j * source.omega * since)}  # the last one alone: a run has few lengths
        return self._turned[key]

    def _add_rotating(
        self, total: _Total, interval: Interval, n: float, c: NDArray[Any], drift: Array, slope: Any = 0.0
    ) -> None:
        """(c + slope·s) e^{jn(ωs + drift·s + …)}, whose phase turns with n times that of the fundamental."""
        source = interval.source
        # As for the fundamental (:eq:`source-ramp`): what the ramp of the frequency turns within the interval.
        one, two = 1j * n * drift, 0.5j * n * source.omega_slope - 0.5 * (n * drift) ** 2
        weights = c, c * one + slope, c * two + slope * one
        rho = self._responses(interval.connection, interval.h, n * source.omega)
        total.add(weights, _real_product(rho, (1.0, 0.0, 0.0)))

    def _add_line(self, total: _Total, interval: Interval, t_s: Array, spec: BackgroundSpec) -> None:
        """A line at a frequency of its own."""
        turned = 2.0 * math.pi * ((spec.interharmonic_frequency * t_s) % 1.0) + spec.interharmonic_phase
        c = self._V_base_pk * spec.interharmonic * np.exp(1j * turned)
        rho = self._responses(interval.connection, interval.h, 2.0 * math.pi * spec.interharmonic_frequency)
        total.add([c], _real_product(rho[:1], (1.0,)))

    def _add_record(self, total: _Total, interval: Interval, first: int, elapsed: float, phase: Array) -> None:
        """The recorded voltage instead of the fundamental that the compiled loop adds (:eq:`replay`)."""
        replay, source = self._replay, interval.source
        if replay is None:
            return
        v = replay.vectors(first, len(phase) + 1)
        slope: Complex = (v[1:] - v[:-1]) / replay.T_s
        begin: Complex = v[:-1] + elapsed * slope
        lines = self._lines(interval.connection, interval.h)  # for α and β of a voltage, then for those of its slope
        total.add([begin, slope], _real_product(lines[::2] - 1j * lines[1::2], (1.0, 0.0)))
        c = -rms_to_peak(source.V_g_rms) * np.exp(1j * phase)
        rho = self._responses(interval.connection, interval.h, source.omega)
        total.add([c], _real_product(rho[:1], (1.0,)))


class _Powers:
    """Whole powers of unit phasors. A product takes a fortieth of the time of an exponential."""

    def __init__(self, base: Complex) -> None:
        self._found = {1: base}

    def of(self, n: int) -> Complex:
        """The n-th power, n not 0."""
        if n not in self._found:
            self._found[n] = np.conj(self.of(-n)) if n < 0 else self.of(n // 2) * self.of(n - n // 2)
        return self._found[n]


def _real_product(rho: NDArray[Any], voltage: Sequence[complex]) -> Array:
    """What real and imaginary part of m waves add, (2m, states + 2): ``rho`` (m, states) to the states, ``voltage``
    (m,) to the voltage of the source. Of the complex product the real part alone is wanted: half of its terms."""
    own = np.array(voltage)[:, None]
    full = np.hstack([rho, own, -1j * own])
    return np.stack([np.real(full), -np.imag(full)], axis=1).reshape(2 * len(full), -1)


class _Total:
    """The sum of what parts of a source add: to the states, and to its voltage, ``rows`` (count, states + 2)."""

    def __init__(self, count: int, states: int) -> None:
        self.rows: Array = np.zeros((count, states + 2))

    def add(self, waves: Sequence[NDArray[Any]], parts: Array) -> None:
        """Waves (count,) with what their parts add (:func:`_real_product`)."""
        weights = np.empty((len(self.rows), len(waves)), dtype=complex)
        for k, wave in enumerate(waves):
            weights[:, k] = wave
        of_rows = weights.view(np.float64)
        for k in range(0, len(weights), _ROWS):
            self.rows[k : k + _ROWS] += of_rows[k : k + _ROWS] @ parts
