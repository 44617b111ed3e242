"""A second EMT, written from the mathematics alone, against which the library's fast one is held.

Nothing of ``vsgdesign.simulation`` or ``vsgdesign.equations`` is used: the controller is written in complex
numbers, the circuit is Kirchhoff's laws handed to SciPy's DOP853, the source integrates its own ramps and the
bridge places its own pulses. Only the study's data (ratings, filter, events) is read. The integrator is
restarted at every sample, switching edge and event, so that it never steps across a discontinuity.
"""

from __future__ import annotations

import cmath
import itertools
import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from tests.oracles.network_reference import network_matrices, states
from vsgdesign.parameters import Grid, Study
from vsgdesign.parameters.network import PLAIN, Network

_RELATIVE = 1e-10
_ABSOLUTE_PU = 1e-13
"""Integration tolerances; one step per restart usually does, with an error far below either."""

_COINCIDENT = 1e-6
"""Part of a sampling period within which an instant counts as the sample itself (a rule of the library)."""


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


@dataclass
class Start:
    """Initial condition: circuit (i_s, v_c, i_g), controller, and the voltage waiting out the delay."""

    plant: NDArray[np.complex128]
    controller: State
    waiting: complex


@dataclass
class Trace:
    """What the reference saw at every sample."""

    plant: NDArray[np.complex128]
    source: NDArray[np.complex128]
    power: NDArray[np.complex128]
    theta: NDArray[np.float64]
    omega: NDArray[np.float64]
    V: NDArray[np.float64]
    S_f: NDArray[np.complex128]
    xi_v: NDArray[np.complex128]
    xi_i: NDArray[np.complex128]
    i_f: NDArray[np.complex128]
    edges: int = 0
    current_limited: int = 0
    voltage_limited: int = 0
    final_plant: NDArray[np.complex128] = field(default_factory=lambda: np.zeros(3, complex))


class Prober(Protocol):
    """What adds a small voltage u to every sample, relative to the rated one, and hears what became of it."""

    def value(self) -> complex:
        """u in the frame of the converter's own angle."""
        ...

    def hear(self, v: complex, i: complex, u: complex, theta: float, limited: bool) -> None:
        """Node voltage and grid current of the sample (αβ), what was sent, the angle with it, and whether the current
        limit acted."""
        ...


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
        k = int(at / T + _COINCIDENT)
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
            k = int(at / T + _COINCIDENT)
            scale, phase = scale * gain[k], phase + angle[k]
        return (
            scale * (V + V_slope * back),
            scale * V_slope,
            phase + back * (omega + 0.5 * omega_slope * back),
            omega + omega_slope * back,
            omega_slope,
        )


def circuit_matrices(study: Study, grid: Grid) -> tuple[NDArray[np.complex128], Any, Any]:
    """Kirchhoff's laws for (i_s, v_c, i_g): L_1 i_s' = v_b − R_1 i_s − v_n, C v_c' = i_s − i_g, (L_2+L_g) i_g' = …"""
    f = study.filter
    L, R = f.L_2 + grid.L_g, f.R_2 + grid.R_g
    matrix = np.array(
        [
            [-(f.R_1 + f.R_c) / f.L_1, -1.0 / f.L_1, f.R_c / f.L_1],
            [1.0 / f.C, 0.0, -1.0 / f.C],
            [f.R_c / L, 1.0 / L, -(R + f.R_c) / L],
        ],
        dtype=complex,
    )
    return matrix, np.array([1.0 / f.L_1, 0.0, 0.0], complex), np.array([0.0, 0.0, -1.0 / L], complex)


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


def build_frequency(study: Study) -> float:
    """ω of the source at the start."""
    offset = 0.0 if study.background is None else study.background.frequency_offset
    return study.grid_source.omega_g + 2.0 * math.pi * offset


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


def integrate(
    x: NDArray[np.complex128], length: float, v_b: complex, source: tuple, matrices: tuple, atol: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """The circuit state after ``length`` seconds, by DOP853."""
    A, b, e, A_unequal, b_unequal, e_unequal = matrices
    peak, peak_slope, phase, omega, omega_slope, others, lines, (begin, rise) = source
    forced = b * v_b + b_unequal * complex(v_b).conjugate()

    def voltage(t: float) -> complex:
        turned = phase + t * (omega + 0.5 * omega_slope * t)
        v_g = (peak + peak_slope * t) * cmath.exp(1j * turned)
        v_g += sum(size * cmath.exp(1j * (order * turned + angle)) for order, size, angle in others)
        return v_g + begin + rise * t + sum(size * cmath.exp(1j * (own * t + angle)) for own, size, angle in lines)

    def derivative(t: float, y: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return A @ y + forced + e * voltage(t)

    def unequal(t: float, y: NDArray[np.complex128]) -> NDArray[np.complex128]:
        # Real parts are the α axis, imaginary parts the β axis; the conjugate tells them apart.
        return derivative(t, y) + A_unequal @ y.conj() + e_unequal * voltage(t).conjugate()

    alike = not (A_unequal.any() or e_unequal.any())
    absolute: Any = atol  # an array, which SciPy takes and its stub does not
    solver = DOP853(derivative if alike else unequal, 0.0, x, length, rtol=_RELATIVE, atol=absolute, first_step=length)
    while solver.status == "running":
        solver.step()
    if solver.status != "finished":
        raise RuntimeError("DOP853 failed on the reference circuit")
    return solver.y


def integrate_pieces(x: NDArray[np.complex128], pieces: Sequence[tuple], atol: NDArray[np.float64]) -> Any:
    """The state after one piece after another: (length, v_b, source, matrices) each, as for :func:`integrate`.

    One step of DOP853 for every piece, all at once: the circuit is linear, so that each piece is integrated from unit
    states and from nothing, and these are put together. Where the method's own estimate of the error would reject a
    step, or the axes differ, SciPy's solver does the piece.
    """
    if len(pieces) < 3 or any(part.any() for *_, matrices in pieces for part in matrices[3:]):
        return _one_by_one(x, pieces, atol)
    h = np.array([length for length, *_ in pieces])[:, None, None]
    A = np.array([matrices[0] for *_, matrices in pieces])
    peak, peak_slope, phase, omega, omega_slope = np.array([source[:5] for _, _, source, _ in pieces]).T[:, :, None]
    t = np.array(DOP853.C) * h[:, 0]
    turned = phase + t * (omega + 0.5 * omega_slope * t)
    v_g = (peak + peak_slope * t) * np.exp(1j * turned)
    for k, (_, _, source, _) in enumerate(pieces):
        for order, size, angle in source[5]:
            v_g[k] += size * np.exp(1j * (order * turned[k] + angle))
        for own, size, angle in source[6]:
            v_g[k] += size * np.exp(1j * (own * t[k] + angle))
        v_g[k] += source[7][0] + source[7][1] * t[k]
    forced = np.array([matrices[1] * v_b for _, v_b, _, matrices in pieces])
    drive = forced[:, None] + np.array([matrices[2] for *_, matrices in pieces])[:, None] * v_g[..., None]
    n = len(x)
    start = np.broadcast_to(np.eye(n, n + 1, dtype=complex), (len(pieces), n, n + 1))
    K = np.zeros((len(_STAGES), len(pieces), n, n + 1), complex)
    y: Any = start
    for stage, weights in enumerate(_STAGES):
        if stage:
            y = start + h * np.tensordot(weights[:stage], K[:stage], 1)
        K[stage] = A @ y
        K[stage, :, :, n] += drive[:, min(stage, len(_STAGES) - 2)]
    # The last stage's y is the step's result; its slope counts in the estimate of the error, as SciPy weighs it.
    fifth, third = (np.tensordot(weights, K, 1) for weights in (DOP853.E5, DOP853.E3))
    for k, piece in enumerate(pieces):
        after = y[k, :, :n] @ x + y[k, :, n]
        scale = atol + _RELATIVE * np.maximum(np.abs(x), np.abs(after))
        e_5, e_3 = ((e[k, :, :n] @ x + e[k, :, n]) / scale for e in (fifth, third))
        squares_5, squares_3 = np.vdot(e_5, e_5).real, np.vdot(e_3, e_3).real
        whole = squares_5 + 0.01 * squares_3
        if whole > 0.0 and piece[0] * squares_5 >= math.sqrt(3.0 * whole):
            after = _one_by_one(x, [piece], atol)
        x = after
    return x


_STAGES = (*np.array(DOP853.A), np.array(DOP853.B))
"""What every stage, and the step's result after them, takes of the slopes before it."""


def _one_by_one(x: NDArray[np.complex128], pieces: Sequence[tuple], atol: NDArray[np.float64]) -> Any:
    for length, v_b, source, matrices in pieces:
        x = integrate(x, length, v_b, source, matrices, atol)
    return x


def at_rest(study: Study) -> Start:
    """Cold start: dead circuit, controller at nominal voltage and frequency in phase with the source."""
    c = study.converter
    phase = StiffSource(study).held(0.0, 0.0)[2]
    return Start(np.zeros(3, complex), State(phase, c.omega_n, c.V_rated_rms, 0j, 0j, 0j), 0j)


def with_beta(study: Study, grid: Grid, beta: Grid) -> tuple:
    """The circuit with one grid on the α axis and another on the β axis: means, and half the differences."""
    (A, b, e), (A_beta, _, e_beta) = circuit_matrices(study, grid), circuit_matrices(study, beta)
    return 0.5 * (A + A_beta), b, 0.5 * (e + e_beta), 0.5 * (A - A_beta), 0.0 * b, 0.5 * (e - e_beta)


class Changing:
    """The circuit over time. Where its networks change, the state jumps."""

    def __init__(self, study: Study, beta: Callable[[Grid], Grid]) -> None:
        events = sorted(study.events, key=lambda event: event.t_s)
        grids = [(0.0, study.grid), *((e.t_s, e.grid) for e in events if e.grid is not None)]
        networks = [(0.0, study.network), *((e.t_s, e.network) for e in events if e.network is not None)]
        self.instants = sorted({t for t, _ in (*grids, *networks)})
        self.with_networks = any(network != PLAIN for _, network in networks)
        self.names = ["i_s", "v_c", "i_2"]
        self.listed: list[tuple[float, tuple, Any]] = []
        shares = tuple(sorted({n.fault.at for _, n in networks if n.fault is not None} - {0.0}))
        load = any(n.load is not None for _, n in networks)
        if self.with_networks:
            self.names = states(shares, load)
        for instant in self.instants:
            grid = [g for t, g in grids if t <= instant][-1]
            network: Network = [n for t, n in networks if t <= instant][-1]
            if self.with_networks:
                self.listed.append((instant, *network_matrices(study, grid, network, shares, load)))
            else:
                self.listed.append((instant, with_beta(study, grid, beta(grid)), None))
        self.now: Any = self.listed[0][2]

    def at(self, instant: float) -> tuple:
        return [(matrices, jump) for t, matrices, jump in self.listed if t <= instant][-1]

    def begun(self, plant: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """The first state: where nothing but a grid is there, it has the current into the PCC everywhere."""
        x = np.zeros(len(self.names), complex)
        x[: len(plant)] = plant
        if len(plant) == 3:
            x[[k for k, name in enumerate(self.names) if name.startswith("i_g")]] = plant[2]
        return x

    def moved(
        self, x: NDArray[np.complex128], pieces: Sequence[tuple], atol: NDArray[np.float64], _begin: float = 0.0
    ) -> Any:
        """The state after some pieces, the first of which begins at ``_begin``, with the jumps between them."""
        if not self.with_networks:
            return integrate_pieces(x, [(*piece, matrices) for *piece, (matrices, _) in pieces], atol)
        for _, some in itertools.groupby(pieces, lambda piece: id(piece[-1][1])):
            part = list(some)
            P = part[0][-1][1]
            if P is not self.now:
                x, self.now = P[0] @ x + P[1] @ x.conj(), P
            x = integrate_pieces(x, [(*piece, matrices) for *piece, (matrices, _) in part], atol)
        return x


def run_reference(
    study: Study,
    gain_changes: Sequence[Any],
    pwm: bool,
    start: Start,
    beta: Callable[[Grid], Grid] = lambda grid: grid,
    wander: Any = None,
    noise: Any = None,
    record: Any = None,
    prober: Prober | None = None,
    circuits: Changing | None = None,
) -> Trace:
    """Simulate the study from ``start``; ``gain_changes`` have ``t_s`` and ``gains``. ``beta``: what the grid is on the
    β axis. ``wander(count)``: the gains and angles that the background's random numbers give, sample by sample;
    ``noise(count)``: those of the nine sensors, V and A. ``record(count)``: the vectors of a recorded source at the
    samples, V. ``prober``: adds a voltage to every sample, and listens. ``circuits``: the circuit over time; None: what
    the events say at their instants."""
    controller, source, c = SampledController(study), StiffSource(study), study.converter
    T = controller.T
    samples = round(study.simulation.duration / T)
    if study.background is not None:
        gain, angle = wander(samples)
        source.follow(study.background, gain, angle, T)
    if record is not None:
        source.play(record(samples + 1), T)
    sensors = None if study.sensors is None else NineSensors(study, noise(samples))
    events = sorted(study.events, key=lambda event: event.t_s)
    circuits = Changing(study, beta) if circuits is None else circuits
    instants = sorted({*source.instants, *circuits.instants})
    V_pk = math.sqrt(2.0) * c.V_rated_rms
    I_pk = math.sqrt(2.0) * c.S_rated / (3.0 * c.V_rated_rms)
    atol = _ABSOLUTE_PU * np.array([V_pk if name.startswith("v") else I_pk for name in circuits.names])
    x, state, waiting = circuits.begun(start.plant.astype(complex)), start.controller, start.waiting
    complexes, numbers = ([np.empty(samples, kind) for _ in range(6)] for kind in (complex, float))
    trace = Trace(
        plant=np.empty((samples, 3), complex),
        source=complexes[0],
        power=complexes[1],
        theta=numbers[0],
        omega=numbers[1],
        V=numbers[2],
        S_f=complexes[2],
        xi_v=complexes[3],
        xi_i=complexes[4],
        i_f=complexes[5],
    )
    for k in range(samples):
        now = (k + _COINCIDENT) * T
        trace.plant[k] = x[:3]
        peak, _, phase, _, _ = source.held(now, k * T)
        others = (size * cmath.exp(1j * (order * phase + angle)) for order, size, angle in source.others(now))
        lines = (size * cmath.exp(1j * angle) for _, size, angle in source.lines(k * T))
        trace.source[k] = peak * cmath.exp(1j * phase) + sum(others) + sum(lines) + source.straight(now, k * T)[0]
        for name in ("omega", "S_f", "xi_v", "xi_i", "i_f"):
            getattr(trace, name)[k] = getattr(state, name)
        refs = _references(study, events, now)
        gains = [change.gains for change in gain_changes if change.t_s <= now][-1]
        i_s, v_c, i_g = (complex(entry) for entry in x[:3])
        v_node = v_c + study.filter.R_c * (i_s - i_g)
        if sensors is not None:
            v_node, i_s, i_g = sensors.read(k, v_node, i_s, i_g)
        hits = controller.hits["current"]
        u = 0j if prober is None else prober.value()
        whole = state.V + c.V_rated_rms * u
        turned, raised = (0.0, 0.0) if prober is None else (cmath.phase(whole), abs(whole) - state.V)
        state = replace(state, theta=state.theta + turned, V=state.V + raised)
        for name in ("theta", "V"):
            getattr(trace, name)[k] = getattr(state, name)
        theta = state.theta
        state, asked, trace.power[k] = controller.step(state, v_node, i_s, i_g, refs, gains)
        state = replace(state, theta=state.theta - turned, V=state.V - raised)
        if prober is not None:
            prober.hear(v_node, i_g, u, theta, controller.hits["current"] > hits)
        if c.delay_samples == 0:
            applied = asked
        else:
            applied, waiting = waiting, asked
        cuts = [t - k * T for t in instants if _COINCIDENT * T < t - k * T < (1.0 - _COINCIDENT) * T]
        pieces = bridge_pieces(applied, study, k, pwm, cuts)
        trace.edges += len(pieces) - 1 - len(cuts)
        asked_for = []
        for begin, end, v_b in pieces:
            if end - begin < 1e-18:  # shorter than the last bit of any instant here
                continue
            middle = k * T + 0.5 * (begin + end)
            at_begin = (
                *source.held(middle, k * T + begin),
                source.others(middle),
                source.lines(k * T + begin),
                source.straight(middle, k * T + begin),
            )
            asked_for.append((end - begin, v_b, at_begin, circuits.at(middle)))
        x = circuits.moved(x, asked_for, atol, k * T)
    trace.current_limited, trace.voltage_limited = controller.hits["current"], controller.hits["voltage"]
    trace.final_plant = x[:3]
    return trace


def _references(study: Study, events: Sequence[Any], now: float) -> tuple[float, float]:
    P_ref, Q_ref = study.simulation.P_ref, study.simulation.Q_ref
    for event in events:
        if event.t_s <= now:
            P_ref = P_ref if event.P_ref is None else event.P_ref
            Q_ref = Q_ref if event.Q_ref is None else event.Q_ref
    return P_ref, Q_ref
