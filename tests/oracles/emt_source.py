"""The source of the reference EMT: ramps and jumps, wander, a record, and everything beside the fundamental."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.study.parameters import Study

COINCIDENT = 1e-6
"""Part of a sampling period within which an instant counts as the sample itself (a rule of the library)."""


class PiecewiseLinear:
    """A quantity that holds, steps or ramps; and its running integral."""

    def __init__(self, value: float, moves: Sequence[tuple[float, float, float]]) -> None:
        """``moves``: (time, goal, ramp duration), sorted by time; a later move replaces a running one."""
        knots = [(0.0, value, 0.0)]
        for t, goal, over in moves:
            now = self._value(knots, t)
            knots = [knot for knot in knots if knot[0] < t]
            if over > 0.0:
                knots += [(t, now, (goal - now) / over), (t + over, goal, 0.0)]
            else:
                knots.append((t, goal, 0.0))
        self.knots = knots
        self.times = [knot[0] for knot in knots]
        self.areas = [0.0]
        for (t_0, v_0, slope), (t_1, _, _) in itertools.pairwise(knots):
            self.areas.append(self.areas[-1] + 0.5 * (v_0 + (v_0 + slope * (t_1 - t_0))) * (t_1 - t_0))

    @staticmethod
    def _value(knots: list[tuple[float, float, float]], t: float) -> float:
        t_0, v_0, slope = [knot for knot in knots if knot[0] <= t][-1]
        return v_0 + slope * (t - t_0)

    def at(self, t: float) -> tuple[float, float, float]:
        """Value, slope and integral from zero at t (just after a knot that stands at t)."""
        k = max(bisect_right(self.times, t) - 1, 0)
        t_0, v_0, slope = self.knots[k]
        dt = t - t_0
        return v_0 + slope * dt, slope, self.areas[k] + dt * (v_0 + 0.5 * slope * dt)


class StiffSource:
    """√2·V_g·e^{jφ} and its components √2·V_n·a·e^{j(nφ + ψ)} behind the grid impedance, φ(0) = −90° because phase A is
    a sine."""

    def __init__(self, study: Study) -> None:
        events = sorted(study.events, key=lambda event: event.t_s)
        self.amplitude = PiecewiseLinear(
            study.grid_source.V_g_rms,
            [(e.t_s, e.V_g_rms, e.over) for e in events if e.V_g_rms is not None],
        )
        self.frequency = PiecewiseLinear(
            study.grid_source.omega_g,
            [(e.t_s, e.omega_g, e.over) for e in events if e.omega_g is not None],
        )
        self.jumps = [(e.t_s, e.phase_jump) for e in events]
        given = [(0.0, study.grid_source.components)]
        given += [(e.t_s, e.components) for e in events if e.components is not None]
        self.V_rated_rms = study.converter.V_rated_rms
        self.wander: tuple[NDArray[np.float64], NDArray[np.float64], float] | None = None
        self.line: tuple[float, float, float] | None = None
        self.record: tuple[NDArray[np.complex128], float] | None = None
        V_pk = math.sqrt(2.0) * self.V_rated_rms
        self.components = [(t, tuple((c.order, V_pk * c.amplitude_pu, c.phase) for c in some)) for t, some in given]
        self.instants = sorted(
            {
                *self.amplitude.times,
                *self.frequency.times,
                *(t for t, jump in self.jumps if jump),
                *(t for t, _ in self.components),
            }
        )

    def others(self, at: float) -> tuple[tuple[float, float, float], ...]:
        """(order, peak, phase) of every component at an instant."""
        return [some for t, some in self.components if t <= at][-1]

    def follow(self, background: Any, gain: NDArray[np.float64], angle: NDArray[np.float64], T: float) -> None:
        """From now on the fundamental is what the events say times gain·e^{j·angle}, held from sample to sample."""
        for moves in (self.amplitude, self.frequency):
            if moves is self.amplitude:
                moves.knots = [
                    (t, background.voltage_factor * v, background.voltage_factor * s) for t, v, s in moves.knots
                ]
                moves.areas = [background.voltage_factor * area for area in moves.areas]
            else:
                offset = 2.0 * math.pi * background.frequency_offset
                moves.areas = [area + offset * t for area, t in zip(moves.areas, moves.times, strict=True)]
                moves.knots = [(t, v + offset, s) for t, v, s in moves.knots]
        self.jumps = [(-1.0, background.phase), *self.jumps]
        rated = math.sqrt(2.0) * self.V_rated_rms
        more = tuple((c.order, rated * c.amplitude_pu, c.phase) for c in background.components)
        self.components = [(t, some + more) for t, some in self.components]
        self.wander = (gain, angle, T)
        if background.interharmonic > 0.0:
            omega = 2.0 * math.pi * background.interharmonic_frequency
            self.line = (omega, rated * background.interharmonic, background.interharmonic_phase)

    def play(self, vectors: NDArray[np.complex128], T: float) -> None:
        """From now on the source is a straight line from each sample's vector to the next."""
        self.record = (vectors, T)

    def straight(self, at: float, since: float) -> tuple[complex, complex]:
        """Vector and slope of the recorded voltage that holds at an instant, described from ``since``."""
        if self.record is None:
            return 0j, 0j
        vectors, T = self.record
        k = int(at / T + COINCIDENT)
        slope = complex(vectors[k + 1] - vectors[k]) / T
        return complex(vectors[k]) + slope * (since - k * T), slope

    def lines(self, at: float) -> tuple[tuple[float, float, float], ...]:
        """(ω, peak, phase at an instant) of what turns at a frequency of its own."""
        return () if self.line is None else ((self.line[0], self.line[1], self.line[2] + self.line[0] * at),)

    def held(self, at: float, since: float) -> tuple[float, float, float, float, float]:
        """The ramp that holds at an instant, described from ``since``: (peak, its slope, phase, ω, its slope)."""
        V, V_slope, _ = self.amplitude.at(at)
        omega, omega_slope, turned = self.frequency.at(at)
        phase = -0.5 * math.pi + turned + sum(jump for t_jump, jump in self.jumps if t_jump <= at)
        back = since - at
        scale = math.sqrt(2.0) if self.record is None else 0.0
        if self.wander is not None:
            gain, angle, T = self.wander
            k = int(at / T + COINCIDENT)
            scale, phase = scale * gain[k], phase + angle[k]
        return (
            scale * (V + V_slope * back),
            scale * V_slope,
            phase + back * (omega + 0.5 * omega_slope * back),
            omega + omega_slope * back,
            omega_slope,
        )


def build_frequency(study: Study) -> float:
    """ω of the source at the start."""
    offset = 0.0 if study.background is None else study.background.frequency_offset
    return study.grid_source.omega_g + 2.0 * math.pi * offset
