"""What a source adds to the circuit's states, sample by sample, besides its fundamental: its wander, its negative
sequence, its harmonics, a line, or a recorded voltage in its place.

The circuit is linear, so every component of the source adds its own exact response (:eq:`source-components`), whatever
the converter does. It can therefore be computed before the samples run, for a whole stretch at once.

What a source that wanders adds is computed by machine code for eight samples side by side. A sample of the path follows
from the one before it. What it adds does not: the phasors of all waves, which are whole powers of the fundamental's,
and their sum over all that they add.
"""

from __future__ import annotations

import cmath
import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.blocks import Part, Writer, joined
from vsgdesign.codegen.expressions import Expression, Number, Variable
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.llvm import LoopSpec, aligned_zeros, compiled_loop, empty_rows
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid import FilterGrid, moved_phasor
from vsgdesign.linear.operating_point.plant import plant_step, sources_of_grid, straight_line_responses
from vsgdesign.simulation.circuits import CircuitOfConnection, Connection, states_of
from vsgdesign.simulation.timeline import SourceSegment, Timeline
from vsgdesign.study.parameters.background import BackgroundSpec
from vsgdesign.study.parameters.grid import SourceComponent

Array = NDArray[np.float64]

LANES = 8
"""Samples side by side, on every processor: the numbers of a run do not depend on it."""

_OF_ALL = ("omega", "cosine", "sine", "T_s")


class MovedWaves:
    """The loop for the changes of the fundamental and for waves of other orders. It serves one thread."""

    def __init__(self, orders: tuple[int, ...], columns: int) -> None:
        """``orders`` of the waves besides the fundamental, not 0; ``columns``: numbers that a sample adds."""
        spec = waves_spec(orders, columns)
        self._loop, self._columns = compiled_loop(spec), columns
        self._rows = empty_rows(spec, 1)
        self._rows[0, 0] = np.arange(LANES)
        self._fed, self._log = self._room(0)

    def _room(self, steps: int) -> tuple[Array, Array]:
        return aligned_zeros((1, steps, 2, LANES)), aligned_zeros((1, steps, self._columns, LANES))

    def over(self, moved: tuple[Array, Array], turn: tuple[float, float, float], T_s: float, parts: Array) -> Array:
        """What is added in samples whose source is ``moved`` by a gain and an angle (rad), (count,): (count, columns).

        ``turn``: angular frequency (rad/s) of the fundamental, cosine and sine of its phase at the first sample;
        ``parts`` (2m, columns): what real and imaginary part of each wave add."""
        count = len(moved[0])
        steps, (whole, left) = -(-count // LANES), divmod(count, LANES)
        if self._fed.shape[1] < steps:
            self._fed, self._log = self._room(steps)
        for k, values in enumerate(moved):
            self._fed[0, :whole, k] = values[: count - left].reshape(whole, LANES)
            self._fed[0, whole:steps, k, :left] = values[count - left :]
        uniform = np.concatenate([[*turn, T_s], parts.reshape(-1)])
        fed, log = self._fed[:, :steps], self._log[:, :steps]
        self._loop(0, steps, self._rows, uniform, fed=fed, log=log, every=1)
        return log[0].transpose(1, 0, 2).copy().reshape(self._columns, -1)[:, :count].T


@functools.cache
def waves_spec(orders: tuple[int, ...], columns: int) -> LoopSpec:
    """A loop of eight samples each."""
    line = Writer()
    first = line.does("*", line.input("index"), Number(float(LANES)))
    sample = line.does("+", first, line.input("place"))
    since = line.does("*", sample, line.input("T_s"))
    line.output("turned", line.does("*", since, line.input("omega")))
    line.output("next_place", line.input("place"))
    block = joined(Part(line.block()), Part(flat_block(moved_phasor)), Part(_added(orders, columns)))
    return LoopSpec(
        bodies=(block,),
        state=(("place", "next_place"),),
        uniform=(*_OF_ALL, *_parts(len(orders) + 1, columns)),
        fed=("gain", "angle"),
        logged=tuple(f"added_{column}" for column in range(columns)),
        index="index",
        lanes=LANES,
        strict=True,
    )


def _parts(waves: int, columns: int) -> list[str]:
    return [f"part_{row}_{column}" for row in range(2 * waves) for column in range(columns)]


def _added(orders: tuple[int, ...], columns: int) -> Block:
    """The whole powers of the moved phasor, and what they add."""
    line = Writer()
    found: dict[int, tuple[Expression, Expression]] = {1: (line.input("moved_re"), line.input("moved_im"))}

    def power(n: int) -> tuple[Expression, Expression]:
        if n not in found:
            if n < 0:
                re, im = power(-n)
                found[n] = re, line.does("neg", im)
            else:
                (a, b), (c, d) = power(n // 2), power(n - n // 2)
                re = line.does("-", line.does("*", a, c), line.does("*", b, d))
                found[n] = re, line.does("+", line.does("*", a, d), line.does("*", b, c))
        return found[n]

    waves: list[Expression] = [line.input("change_re"), line.input("change_im")]
    for n in orders:
        waves += power(n)
    for column in range(columns):
        terms = [line.does("*", wave, _part(line, row, column)) for row, wave in enumerate(waves)]
        line.output(f"added_{column}", line.sum_of(*terms))
    return line.block()


def _part(line: Writer, row: int, column: int) -> Variable:
    return line.input(f"part_{row}_{column}")


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
        self._waves = functools.cache(MovedWaves)
        self._of_steady: tuple[tuple[Any, ...], MovedWaves, Array] | None = None

    def acts(self, intervals: Sequence[Interval]) -> bool:
        """Whether the source has more than a fundamental of constant amplitude and frequency."""
        of_study = self._replay is not None or (self._wander is not None and self._wander.spec.distorts)
        return of_study or any(one.components or not one.source.steady for one in intervals)

    def _response(self, connection: Connection, h: float, omega: float) -> NDArray[Any]:
        """Rows m = 0, 1, 2: what s^m e^{jωs} adds, complex (3, 2n): the part of Re c and, as −j times it, of Im c."""
        circuit = self._circuit(connection)
        source = plant_step(circuit, h, omega, edges=False).source
        return _on_both_axes(source) if isinstance(circuit, FilterGrid) else source[:, :, 0] - 1j * source[:, :, 1]

    def rows(self, intervals: Sequence[Interval], first: int, count: int, T_s: float) -> Array:
        """What the components add over ``count`` whole samples (one interval), or over each of several intervals
        (:eq:`source-components`).

        ``first``: the sample at which the first interval begins. A row has the states' increments, then the voltage at
        the interval's beginning, α and β.
        """
        if len(intervals) == 1:
            return self.over(intervals[0], first, np.arange(count, dtype=np.float64) * T_s, 0.0)
        begins = np.cumsum([0.0, *(one.h for one in intervals[:-1])])
        return np.concatenate(
            [self.over(one, first, np.zeros(1), at) for one, at in zip(intervals, begins, strict=True)]
        )

    def of_ramp(self, intervals: Sequence[Interval], counts: Sequence[int], T_s: float) -> list[Array]:
        """What a ramped fundamental alone adds over stretches of one ramp, which begin with these intervals and have
        ``counts`` whole samples: :meth:`rows` of each of them, to the bit."""
        first = intervals[0]
        since = np.concatenate([np.arange(count, dtype=np.float64) * T_s for count in counts])
        begins = np.array([(one.source.V_g_rms, one.source.omega, one.source.phase) for one in intervals])
        V, omega, phase = np.repeat(begins, counts, axis=0).T.copy()
        source: Any = replace(first.source, V_g_rms=V, omega=omega, phase=phase)
        total = _Total(np.zeros((len(since), self._states(first.connection) + 2)), counts)
        self._add_any(total, first._replace(source=source), (), 0, since, 0.0)
        return np.split(total.rows, np.cumsum(counts[:-1]))

    def _states(self, connection: Connection) -> int:
        """How many states the circuit has on both axes."""
        return states_of(self._circuit(connection))

    def over(self, interval: Interval, first: int, since: Array, elapsed: float) -> Array:
        """One row for every instant ``since`` the beginning (s), which is ``elapsed`` s after the sample ``first``."""
        source, wander = interval.source, self._wander
        components = (*interval.components, *(() if wander is None else wander.spec.components))
        if wander is not None and source.steady and all(one.order.is_integer() and one.order for one in components):
            total = _Total(self._steady(interval, components, wander.factors(first, len(since)), wander.T_s))
        else:
            total = _Total(np.zeros((len(since), self._states(interval.connection) + 2)))
            self._add_any(total, interval, components, first, since, elapsed)
        if wander is not None and wander.spec.interharmonic > 0.0:
            self._add_line(total, interval, first * wander.T_s + elapsed + since, wander.spec)
        return total.rows

    def _add_any(
        self,
        total: _Total,
        interval: Interval,
        components: tuple[SourceComponent, ...],
        first: int,
        since: Array,
        elapsed: float,
    ) -> None:
        """A fundamental that is ramped, a record in place of it, or components, which may have any order."""
        source = interval.source
        drift = source.omega_slope * since
        phase = source.phase + (source.omega + 0.5 * drift) * since
        V, slope = rms_to_peak(source.V_g_rms + source.V_slope * since), rms_to_peak(source.V_slope)
        turned = phase
        if self._replay is not None:
            self._add_record(total, interval, first, elapsed, phase)
        if self._wander is not None:
            gain, angle = self._wander.factors(first, len(since))
            turned = phase + angle
            # Where it is not ramped, the compiled loop adds the fundamental that is not moved.
            change = gain * np.exp(1j * turned) - np.exp(1j * phase) * source.steady
            self._add_rotating(total, interval, 1.0, V * change, drift, slope * change)
        elif not source.steady:
            turn = np.exp(1j * phase)
            self._add_rotating(total, interval, 1.0, V * turn, drift, slope * turn)
        for one in components:
            wave = np.exp(1j * (one.order * turned + one.phase))
            self._add_rotating(total, interval, one.order, self._V_base_pk * one.amplitude_pu * wave, drift)

    def _phasor(self, component: SourceComponent) -> complex:
        return self._V_base_pk * component.amplitude_pu * cmath.exp(1j * component.phase)

    def _steady(
        self, interval: Interval, components: tuple[SourceComponent, ...], moved: tuple[Array, Array], T_s: float
    ) -> Array:
        """What a wandering source adds that is not ramped: there are no terms of s and s², and one product for all."""
        connection, h, source = interval.connection, interval.h, interval.source
        key = connection, h, source.omega, source.V_g_rms, components
        if self._of_steady is None or self._of_steady[0] != key:  # the same in all stretches between two events
            sizes = [rms_to_peak(source.V_g_rms), *map(self._phasor, components)]
            orders = [1.0, *(one.order for one in components)]
            rho = [self._responses(connection, h, n * source.omega)[0] for n in orders]
            parts = _real_product(np.array(sizes)[:, None] * np.array(rho), sizes)
            waves = self._waves(tuple(int(n) for n in orders[1:]), parts.shape[1])
            self._of_steady = key, waves, parts
        _, waves, parts = self._of_steady
        return waves.over(moved, (source.omega, math.cos(source.phase), math.sin(source.phase)), T_s, parts)

    def _add_rotating(
        self, total: _Total, interval: Interval, n: float, c: NDArray[Any], drift: Array, slope: Any = 0.0
    ) -> None:
        """(c + slope·s) e^{jn(ωs + drift·s + …)}, whose phase turns with n times that of the fundamental."""
        source = interval.source
        # As for the fundamental (:eq:`source-ramp`): what the ramp of the frequency turns within the interval.
        one, two = 1j * n * drift, 0.5j * n * source.omega_slope - 0.5 * (n * drift) ** 2
        weights = c, c * one + slope, c * two + slope * one
        begins = total.begins
        omegas = np.atleast_1d(source.omega)[begins].tolist()
        responses = self._all_responses(interval.connection, interval.h, [n * omega for omega in omegas])
        for begin, end, rho in zip(begins, [*begins[1:], len(total.rows)], responses, strict=True):
            some = [wave[begin:end] for wave in weights]
            total.add(some, _real_product(rho, (1.0, 0.0, 0.0)), begin)

    def _all_responses(self, connection: Connection, h: float, omegas: Sequence[float]) -> Sequence[NDArray[Any]]:
        """:meth:`_response` at several frequencies."""
        circuit = self._circuit(connection)
        if len(omegas) == 1 or not isinstance(circuit, FilterGrid):
            return [self._responses(connection, h, omega) for omega in omegas]
        return [_on_both_axes(one) for one in sources_of_grid(circuit, h, omegas)]

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


def _real_product(rho: NDArray[Any], voltage: Sequence[complex]) -> Array:
    """What real and imaginary part of m waves add, (2m, states + 2): ``rho`` (m, states) to the states, ``voltage``
    (m,) to the voltage of the source. Of the complex product the real part alone is wanted: half of its terms."""
    own = np.array(voltage)[:, None]
    full = np.hstack([rho, own, -1j * own])
    return np.stack([np.real(full), -np.imag(full)], axis=1).reshape(2 * len(full), -1)


def _on_both_axes(source: NDArray[Any]) -> NDArray[Any]:
    """What equal axes do (3, n), as complex (3, 2n): c·ρ has its real part on α and its imaginary part on β."""
    return np.stack([source, -1j * source], axis=-1).reshape(3, -1)


class _Total:
    """The sum of what parts of a source add: to the states, and to its voltage, ``rows`` (count, states + 2). They are
    those of one stretch, or of several of ``counts`` rows each."""

    def __init__(self, rows: Array, counts: Sequence[int] = ()) -> None:
        self.rows = rows
        self.begins = [0, *np.cumsum(counts[:-1]).tolist()]
        """The first row of each stretch."""

    def add(self, waves: Sequence[NDArray[Any]], parts: Array, first: int = 0) -> None:
        """Waves (count,) with what their parts add (:func:`_real_product`), from row ``first`` on."""
        weights = np.empty((len(waves[0]), len(waves)), dtype=complex)
        for k, wave in enumerate(waves):
            weights[:, k] = wave
        of_rows = weights.view(np.float64)
        for k in range(0, len(weights), _ROWS):
            some = of_rows[k : k + _ROWS] @ parts
            self.rows[first + k : first + k + len(some)] += some
