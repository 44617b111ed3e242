"""The sampled controller of the reference EMT in complex notation, its sensors, and the pulses of its bridge."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.oracles.emt_sequence import SequenceController
from tests.oracles.emt_source import build_frequency
from vsgdesign.study.parameters import Study


@dataclass
class State:
    """Controller memory: angle, frequency, rms voltage, filtered powers; in the dq frame the PI integrators and the
    grid current that the transient impedance is used to; the voltage (αβ) that was asked for last."""

    theta: float
    omega: float
    V: float
    S_f: complex
    xi_v: complex
    xi_i: complex
    i_f: complex = 0j
    asked: complex = 0j
    seen: tuple[complex, complex, complex, complex] = (0j, 0j, 0j, 0j)
    """What a notch keeps: the measured power of the last two samples, then what it let through."""


class SampledController:
    """The published control in complex notation, one call per sample."""

    def __init__(self, study: Study) -> None:
        c, f, gains = study.converter, study.filter, study.inner_gains
        self.T = 1.0 / (c.f_sw * c.samples_per_carrier)
        self.omega_0, self.V_n = c.omega_n, c.V_rated_rms
        self.current_pi, self.voltage_pi = (gains.K_pc, gains.K_ic), (gains.K_pv, gains.K_iv)
        self.feedforward = gains.K_ff
        self.impedance, self.used_to = complex(gains.R_t, gains.X_t), 1.0 - math.exp(-study.omega_t * self.T)
        self.ahead = gains.kappa * self.T / f.L_1
        self.Y, self.X = 1j * c.omega_n * f.C, 1j * c.omega_n * f.L_1
        rated_peak = math.sqrt(2.0) * c.S_rated / (3.0 * c.V_rated_rms)
        self.i_max = math.inf if c.current_limit_pu is None else c.current_limit_pu * rated_peak
        self.v_max = c.V_dc / math.sqrt(3.0) if c.zero_sequence else 0.5 * c.V_dc
        self.lead = cmath.exp(1j * c.omega_n * (c.delay_samples + 0.5) * self.T)
        self.smoothing = [1.0 if tau == 0.0 else 1.0 - math.exp(-self.T / tau) for tau in (study.tau_P, study.tau_Q)]
        self.hits = {"current": 0, "voltage": 0}
        self.sequence = SequenceController(study) if study.current_limiter == "balanced_power" else None
        # The notch as a difference equation, in powers of z^-1: zeros on the unit circle, poles within.
        turn = 2.0 * math.cos(2.0 * c.omega_n * self.T)
        if study.has_notch:
            width = study.notch_damping * math.sin(2.0 * c.omega_n * self.T)
            kept = (1.0 - width) / (1.0 + width)
            self.notch = (turn, turn - 1.0 + kept, kept)
        else:
            self.notch = None

    def step(
        self, s: State, v: complex, i_s: complex, i_g: complex, refs: tuple[float, float], gains: Any
    ) -> tuple[State, complex, complex]:
        """Next state, bridge voltage asked for (αβ), and the unfiltered complex power."""
        S = passed = 1.5 * v * i_g.conjugate()
        if self.notch is not None:
            turn, turn_back, kept = self.notch
            before, earlier, let, let_earlier = s.seen
            passed = S - turn * before + earlier + turn_back * let - kept * let_earlier
        S_f = s.S_f + complex(
            self.smoothing[0] * (passed.real - s.S_f.real), self.smoothing[1] * (passed.imag - s.S_f.imag)
        )
        P_ref, Q_ref = refs
        acceleration = gains.K_ip * (P_ref - S_f.real + gains.D_p * (self.omega_0 - s.omega))
        rise = gains.K_iq * (Q_ref - S_f.imag + gains.D_q * (self.V_n - s.V))

        frame = cmath.exp(-1j * s.theta)
        v, i_s, i_g = v * frame, i_s * frame, i_g * frame
        error = math.sqrt(2.0) * s.V - self.impedance * (i_g - s.i_f) - v
        if self.sequence is not None:
            error += self.sequence.nu
            self.sequence.hear(v, i_s, s.omega)
        wanted = self.voltage_pi[0] * error + s.xi_v + self.feedforward * i_g + self.Y * v
        i_ref = self._shorten(wanted, self.i_max, "current")
        xi_v = s.xi_v + self.T * self.voltage_pi[1] * (error + (i_ref - wanted) / self.voltage_pi[0])
        acting = s.asked * frame * cmath.exp(-0.5j * self.omega_0 * self.T)
        error = i_ref - (i_s + self.ahead * (acting - v - self.X * i_s))
        wanted = self.current_pi[0] * error + s.xi_i + v + self.X * i_s
        v_b = self._shorten(wanted, self.v_max, "voltage")
        xi_i = s.xi_i + self.T * self.current_pi[1] * (error + (v_b - wanted) / self.current_pi[0])
        following = State(
            s.theta + self.T * s.omega,
            s.omega + self.T * acceleration,
            s.V + self.T * rise,
            S_f,
            xi_v,
            xi_i,
            s.i_f + self.used_to * (i_g - s.i_f),
            v_b * self.lead / frame,
            (S, s.seen[0], passed, s.seen[2]),
        )
        return following, following.asked, S

    def _shorten(self, vector: complex, limit: float, which: str) -> complex:
        if abs(vector) <= limit:
            return vector
        self.hits[which] += 1
        return vector * (limit / abs(vector))


class NineSensors:
    """Three phases of three vectors, each read by a sensor of its own."""

    def __init__(self, study: Study, noise: NDArray[np.float64]) -> None:
        c, spec = study.converter, study.sensors
        assert spec is not None
        amps = math.sqrt(2.0) * c.S_rated / (3.0 * c.V_rated_rms)
        self.rated = [math.sqrt(2.0) * c.V_rated_rms] * 3 + [amps] * 6
        self.gain_errors, self.offsets, self.noise = spec.gain_errors, spec.offset_errors, noise
        self.bits, self.full = spec.bits, spec.range_pu
        self.late = spec.skew / (c.omega_n / (c.f_sw * c.samples_per_carrier))
        self.before: list[complex] | None = None
        self.first_turn = cmath.exp(-1j * build_frequency(study) / (c.f_sw * c.samples_per_carrier))

    def read(self, sample: int, *vectors: complex) -> list[complex]:
        """What they say of the true vectors at a sample."""
        before = self.before or [vector * self.first_turn for vector in vectors]
        self.before = list(vectors)
        said = []
        for k, (vector, old) in enumerate(zip(vectors, before, strict=True)):
            late = max(-self.late, 0.0) if k == 0 else max(self.late, 0.0)
            value, total = vector * (1.0 - late) + old * late, 0j
            for phase in range(3):
                turn = cmath.exp(2j * math.pi * phase / 3.0)
                total += self._one(sample, 3 * k + phase, (value * turn.conjugate()).real) * turn
            said.append(2.0 / 3.0 * total)
        return said

    def _one(self, sample: int, channel: int, true: float) -> float:
        rated = self.rated[channel]
        value = true * (1.0 + self.gain_errors[channel]) + self.offsets[channel] * rated + self.noise[sample, channel]
        if self.full:
            value = max(-self.full * rated, min(value, self.full * rated))
        if self.bits:
            levels = 2 ** (self.bits - 1)  # two's complement: codes −levels … levels − 1
            code = min(math.floor(value / (self.full * rated) * levels + 0.5), levels - 1)
            value = code * self.full * rated / levels
        return value


def bridge_pieces(
    v_ref: complex, study: Study, sample: int, pwm: bool, cuts: Sequence[float]
) -> list[tuple[float, float, complex]]:
    """(begin, end, bridge voltage) within the period after a sample, times counted from the sample.

    The upper switch of a phase conducts in one pulse per carrier period, centred on the carrier's valley and
    (1 + m)/2 of the period long: natural sampling of a reference that is held over the sampling period.
    """
    c = study.converter
    T = 1.0 / (c.f_sw * c.samples_per_carrier)
    if not pwm:
        instants = [0.0, *cuts, T]
        return [(a, b, v_ref) for a, b in itertools.pairwise(instants)]
    turns = [cmath.exp(2j * math.pi * k / 3.0) for k in range(3)]
    phases = [(v_ref * turn.conjugate()).real for turn in turns]
    common = 0.5 * (max(phases) + min(phases)) if c.zero_sequence else 0.0
    carrier_period = 1.0 / c.f_sw
    since_valley = (sample % c.samples_per_carrier) * T
    valleys = (-since_valley, carrier_period - since_valley)
    pulses = [0.25 * carrier_period * (1.0 + (v - common) / (0.5 * c.V_dc)) for v in phases]
    edges = [valley + sign * half for half in pulses for valley in valleys for sign in (-1.0, 1.0)]
    instants = sorted({0.0, T, *cuts, *(t for t in edges if 0.0 < t < T)})
    pieces = []
    for begin, end in itertools.pairwise(instants):
        middle = 0.5 * (begin + end)
        v_b = 0j
        for half, turn in zip(pulses, turns, strict=True):
            on = any(abs(middle - valley) < half for valley in valleys)
            v_b += (2.0 / 3.0) * turn * (0.5 * c.V_dc if on else -0.5 * c.V_dc)
        pieces.append((begin, end, v_b))
    return pieces
