"""Known answers: the answers of Python to a sequence of calls in which every guard acts.

For the field estimator, Python and the self-test simulate the same circuit: a voltage V e^{jθ}(1 + u) on R and L to a
grid that stays 0.3 rad behind, with noise from whole numbers. A record of samples would take many times the flash.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller import (
    ControllerOutput,
    ControllerSettings,
    Measurement,
    controller_step,
)
from vsgdesign.equations.field import FieldAnswer, FieldSettings, conclude, first_lock_in, first_track, listen
from vsgdesign.equations.field import probe_value as probe_of
from vsgdesign.equations.frames import PHASES, rms_to_peak
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import GridEstimate, Limiter, LimiterRatings, LimiterView
from vsgdesign.equations.placing import current_loop_gains, voltage_loop_gains
from vsgdesign.equations.power_loops import (
    NotchConstants,
    PowerLoopGains,
    References,
    frequency_at_rest,
    gain_transfer,
    notch_constants,
)
from vsgdesign.equations.scheduler_data import NO_ESTIMATE, NO_REASON, TOLD_CHANGED, TOLD_LIMITED, TOLD_SURPRISED
from vsgdesign.identification.field import FieldNetwork
from vsgdesign.identification.neural import NeuralEstimator
from vsgdesign.runtime.guards import SchedulerSettings
from vsgdesign.runtime.power_controller import PowerController, state_at_set_points
from vsgdesign.runtime.scheduler import SAID, Scheduler
from vsgdesign.runtime.updating import GainLookup, advance, first_state, given_input, told_state


@dataclass(frozen=True, kw_only=True)
class KnownAnswer:
    """One call and its answer. ``given``: R_g, L_g, P, Q, V, as single precision holds them, or NaN."""

    ticks: int
    hold: bool
    told: int
    """What the scheduler is told before the call."""
    covariance: tuple[float, ...]
    """Of the estimate, as single precision holds it. It is empty if it is not known."""
    given: tuple[float, ...]
    status: int
    reason: int
    answer: PowerLoopGains
    size: tuple[float, ...]
    """The reference values for the relative error of each gain."""


def gain_sizes(gains: PowerLoopGains) -> tuple[float, ...]:
    """The reference values for relative errors of the gains: the larger of a row, since the other may cross zero."""
    K_ip, D_p, K_iq, D_q, K_pq, K_qp, k_P, k_Q = (abs(float(value)) for value in gains)
    P_row, Q_row, damping = max(K_ip, K_pq), max(K_iq, K_qp), max(k_P, k_Q)
    return P_row, D_p, Q_row, D_q, P_row, Q_row, damping, damping


def known_answers(scheduler: Scheduler) -> list[KnownAnswer]:
    """A sequence of calls from the first state on: confirmed jump, rate, edges, refusals, time backwards, doubt that
    ends with an estimate, doubt that lasts, a change to the strongest grid that is followed in part and then fully, a
    NaN in the place of every number, and no estimate for too long."""
    lookup, c = scheduler.lookup, scheduler.settings
    middle = float(np.sqrt(c.scr[0] * c.scr[1])), float(np.sqrt(c.r_over_x[0] * c.r_over_x[1]))
    R, L = lookup.grid(*middle)
    R_weak, L_weak = lookup.grid(0.9 * c.scr[0], 1.3 * middle[1])
    P, Q, V = 0.4 * c.P[1], 0.3 * c.Q[1], 0.5 * (c.V_rms[0] + c.V_rms[1])
    nothing = (0.0, 0.0, P, Q, V)
    calls: list[tuple[int, bool, tuple[float, ...]]] = [(0, True, nothing)]
    calls += [(20_000 * k, False, (R, L, P, Q, V)) for k in range(1, 9)]
    calls += [(20_000 * k, False, (1.01 * R, 1.01 * L, P, -Q, V)) for k in range(9, 11)]
    calls += [
        (220_000, False, (R, L, 20.0 * P, Q, V)),
        (240_000, False, (R, L, 2.0 * c.power_range, Q, V)),
        (260_000, False, (-100.0 * R, L, P, Q, V)),
        (280_000, False, (R, -L, P, Q, V)),
        *((282_000 + 2_000 * j, False, _with_nan((R, L, P, Q, V), j)) for j in range(5)),
        (5, False, (R, L, P, Q, V)),
        (20_005, False, (R, L, P, Q, 1.9 * c.V_rms[1])),
    ]
    calls += [(20_005 + 20_000 * k, False, (R_weak, L_weak, P, Q, V)) for k in range(1, 12)]
    told: dict[int, int] = {}
    last = calls[-1][0]
    for doubt, silent in ((TOLD_LIMITED, c.stale_ticks // 4), (TOLD_SURPRISED, c.stale_ticks)):
        told[last + 20_000] = doubt
        calls += [(last + 20_000, True, nothing), (last + 20_000 + silent, True, nothing)]
        last += 20_000 + silent
        calls += [(last + 20_000 * k, False, (R_weak, L_weak, P, Q, V)) for k in range(1, 6)]
        last += 100_000
    strong = lookup.grid(0.97 * c.scr[1], middle[1])
    calls += [(last + 20_000 * k, False, (*strong, P, Q, V)) for k in range(1, 14)]
    told[last + 20_000] = TOLD_CHANGED
    # Wide around the strong grid, around the grid that was left, around the strong grid again; then precise.
    covariances: dict[int, tuple[float, ...]] = {}
    for k in range(1, 10):
        calls[k - 14] = (last + 20_000 * k, False, (R_weak, L_weak, P, Q, V) if 4 < k < 7 else (*strong, P, Q, V))
        covariances[last + 20_000 * k] = _covariance(*strong, lookup.omega, 0.4 if k < 9 else 1e-3)
    for j in range(3):
        covariances[last + 20_000 * (10 + j)] = _with_nan(covariances[last + 180_000], j)
    last += 260_000
    calls += [(last + c.lost_ticks // 2 * k, True, nothing) for k in range(1, 4)]
    known: list[KnownAnswer] = []
    state = first_state(lookup, c)
    for ticks, hold, values in calls:
        R_g, L_g, P, Q, V = given = tuple(float(np.float32(value)) for value in values)
        state = told_state(state, told.get(ticks, 0))
        said = NO_ESTIMATE if hold else NO_REASON
        covariance = tuple(float(np.float32(value)) for value in covariances.get(ticks, ()))
        known_error = None if covariance == () else (covariance[0], covariance[1], covariance[2])
        state, answer = advance(lookup, c, state, given_input(said, R_g, L_g, P, Q, V, ticks, known_error))
        known.append(
            KnownAnswer(
                ticks=ticks,
                hold=hold,
                told=told.get(ticks, 0),
                covariance=covariance,
                given=given,
                status=answer.status,
                reason=answer.reason,
                answer=answer.gains,
                size=gain_sizes(answer.gains),
            )
        )
    return known


def _with_nan(values: tuple[float, ...], place: int) -> tuple[float, ...]:
    return tuple(math.nan if at == place else value for at, value in enumerate(values))


def _covariance(R: float, L: float, omega: float, sigma: float) -> tuple[float, ...]:
    """Of an estimate with the relative standard deviation sigma of Z, whose R is less certain than its X."""
    var_R, var_L = 0.7 * sigma**2 * (R**2 + (omega * L) ** 2), 0.3 * sigma**2 * (R**2 / omega**2 + L**2)
    return var_R, 0.4 * math.sqrt(var_R * var_L), var_L


def known_windows(estimator: NeuralEstimator) -> tuple[tuple[float, float], list[tuple[float, float, int]]]:
    """The steps of v and i, and R_g, L_g and reason of windows made of whole numbers times them.

    The steps are powers of two, so that every sample is exact in single precision.
    """
    largest = (50.0, 48.0)
    steps = tuple(
        2.0 ** math.floor(math.log2(min(limit / size, bound) * 0.4))
        for limit, size, bound in zip((estimator.v_limit, estimator.i_limit), largest, (8.0, 1.0), strict=True)
    )
    k, found = np.arange(estimator.components * estimator.samples, dtype=np.float64), []
    for j in range(8):
        v = steps[0] * ((37 * k + 11 * j) % 101 - 50.0)
        i = steps[1] * ((53 * k + 7 * j) % 97 - 48.0)
        R_g, L_g, status = estimator.estimate(v, i)[:3]
        found.append((R_g, L_g, SAID[status]))
    return (steps[0], steps[1]), found


@dataclass(frozen=True)
class KnownPowers:
    """Samples of the power loops alone: with the first gains of :class:`KnownSteps`, and then with the second."""

    T_s: float
    smoothing: float
    notch: NotchConstants
    powers: list[tuple[float, float]]
    """P, Q; NaN in one or both of some samples."""
    voltages: list[tuple[float, float, float]]
    """ω, V, θ."""


def known_powers(steps: KnownSteps) -> KnownPowers:
    """The power loops at powers that move, with a notch, without numbers in some samples and with other gains from the
    middle on."""
    T_s, smoothing = steps.settings.T_s, 0.25
    before = _single(notch_constants(2.0 * steps.refs.omega_0, 0.5, T_s))
    loops = PowerController(steps.gains[0], steps.refs, T_s, smoothing, smoothing, before)
    powers, voltages = [], []
    for k in range(_POWERS):
        if k == _POWERS // 2:
            loops.retune(steps.gains[1])
        P = math.nan if k in (3, 10) else (1.0 - 0.4 * (k % 3)) * steps.refs.P_ref
        Q = math.nan if k in (5, 10) else (0.5 + 0.3 * (k % 4)) * steps.refs.Q_ref
        powers.append((float(np.float32(P)), float(np.float32(Q))))
        voltages.append(loops.step(*powers[-1]))
    return KnownPowers(T_s, smoothing, before, powers, voltages)


@dataclass(frozen=True, kw_only=True)
class KnownSteps:
    """Samples of the whole controller from its start on. The gains change in the second half."""

    refs: References
    gains: tuple[PowerLoopGains, PowerLoopGains]
    inner_gains: InnerLoopGains
    grid: GridEstimate
    settings: ControllerSettings
    measured: list[Measurement]
    outputs: list[ControllerOutput]
    size: ControllerOutput
    """The reference values for the relative error of each output."""


def known_steps(lookup: GainLookup, settings: SchedulerSettings, limiter: Limiter) -> KnownSteps:
    """A converter of the table's ratings that is carried through every term: damping through the angle, transient
    impedance, prediction, both limits, a change of gains. All numbers are as single precision holds them."""
    V_pk, Z, omega = rms_to_peak(lookup.V_n_rms), lookup.Z_base, lookup.omega
    S, I_pk = PHASES * lookup.V_n_rms * lookup.V_n_rms / Z, V_pk / Z
    T_s, L_1, C = 1e-4, 0.1 * Z / omega, 0.05 / (Z * omega)
    K_pv, K_iv = voltage_loop_gains(10e-3, 1.0, C)
    K_pc, K_ic = current_loop_gains(1e-3, 1.0, L_1)
    inner = _single(InnerLoopGains(K_pv, K_iv, K_pc, K_ic, K_ff=0.9, R_t=0.1 * Z, X_t=0.05 * Z, kappa=0.5))
    R_g, L_g = lookup.grid(settings.safe_scr, settings.safe_r_over_x)
    ratings = LimiterRatings(
        T_s=T_s, V_rated_pk=V_pk, I_rated_pk=I_pk, i_max_pk=1.2 * I_pk, Z_base=Z, omega_0=omega, R_2=lookup.R_2,
        L_2=lookup.L_2, V_low_pu=0.85, V_high_pu=1.25,
    )  # fmt: skip
    notch = notch_constants(2.0 * omega, 0.5, T_s)
    constants = _single(
        ControllerSettings(
            T_s=T_s, smoothing_P=0.02, smoothing_Q=0.03, omega_C=omega * C, omega_L=omega * L_1, i_max_pk=1.2 * I_pk,
            v_max_pk=1.3 * V_pk, advance_cos=math.cos(1.5 * omega * T_s), advance_sin=math.sin(1.5 * omega * T_s),
            smoothing_t=0.05, half_cos=math.cos(0.5 * omega * T_s), half_sin=math.sin(0.5 * omega * T_s),
            T_over_L=T_s / L_1, notch_gain=notch.gain, notch_step=notch.step, notch_back=notch.back,
            limiter=limiter.constants(ratings),
        )
    )  # fmt: skip
    refs = _single(References(0.4 * S, 0.1 * S, omega, lookup.V_n_rms))
    K = PowerLoopGains(
        K_ip=20.0 / S, D_p=0.3 * S, K_iq=lookup.V_n_rms / S, D_q=2.0 * S / lookup.V_n_rms, K_pq=3.0 / S,
        K_qp=0.2 * lookup.V_n_rms / S, k_P=3.0 / S, k_Q=-1.0 / S,
    )  # fmt: skip
    gains = _single(K), _single(K._replace(K_ip=40.0 / S, k_P=5.0 / S, D_q=3.0 * S / lookup.V_n_rms))
    grid, omega_i = _single(GridEstimate(R_g, L_g)), frequency_at_rest(refs, gains[0])
    view = LimiterView(**dict.fromkeys(LimiterView._fields, 0.0) | {"V": refs.V_n, "omega_i": omega_i})
    memory = limiter.at_rest(view, refs.omega_0, constants)
    state = state_at_set_points(refs, gains[0])._replace(limiter=memory)
    rng, measured, outputs = np.random.default_rng(20), [], []
    for k in range(_STEPS):
        if k == _STEPS // 2:
            old, new = gains
            state = state._replace(omega_i=gain_transfer(state.omega_i, refs, old, new))
        angle, size = 1.01 * omega * T_s * k - 0.1, 2.5 if k % 5 == 4 else 0.5
        wander = rng.uniform(-0.1, 0.1, 4)
        direction = np.array([math.cos(angle), math.sin(angle)])
        v, i_s, i_g = V_pk * direction, I_pk * (size * direction + wander[:2]), I_pk * (0.4 * direction + wander[2:])
        measured.append(_single(Measurement(*v, *i_s, *i_g)))
        state, output = controller_step(
            state, measured[-1], grid, refs, gains[2 * k // _STEPS], inner, constants, limiter.law
        )
        outputs.append(ControllerOutput(*map(float, output)))
    size_of = ControllerOutput(v_b_alpha=V_pk, v_b_beta=V_pk, omega=omega, P=S, Q=S, limited=1.0)
    return KnownSteps(
        refs=refs,
        gains=gains,
        inner_gains=inner,
        grid=grid,
        settings=constants,
        measured=measured,
        outputs=outputs,
        size=size_of,
    )


_STEPS = 20
_POWERS = 14


def _single(record: Any) -> Any:
    """The NamedTuple with its numbers rounded to single precision."""
    return type(record)(*(_single(value) if isinstance(value, tuple) else float(np.float32(value)) for value in record))


CYCLES = 17
"""From learning to the second valid answer and some more. The last one has a sample that is no number."""
OFF_NOMINAL = 1.003
"""Frequency of the circuit over nominal."""
LOAD = 0.3
"""Angle of the grid behind the converter, rad."""
NOISE = 3e-4
"""Largest noise of a sample over rated."""
IMPEDANCE = (0.06, 0.2)
"""R and X of the grid over the base impedance."""


class KnownPlant(NamedTuple):
    """Constants of the circuit, SI."""

    turn_re: float
    turn_im: float
    """e^{jωT_s}."""
    decay: float
    gain: float
    """i ← decay i + gain (v − g) in one sample."""
    grid_re: float
    grid_im: float
    """g over v, without the probe."""
    V_pk: float
    v_noise: float
    i_noise: float
    """V and A for the smallest whole number."""
    omega: float
    Z_size: float
    L_size: float
    """What errors of R_g and L_g are relative to."""


@dataclass(frozen=True)
class KnownCycles:
    """The circuit, and the estimator's answers in order."""

    plant: KnownPlant
    answers: list[FieldAnswer]


def known_posteriors(network: FieldNetwork) -> tuple[np.ndarray, np.ndarray]:
    """(3, n) features that no single precision rounds, and the (3, 5) outputs of the network for them."""
    inputs = np.round(64.0 * np.random.default_rng(14).normal(size=(3, network.W_1.shape[1]))) / 64.0
    return inputs, network.outputs(inputs)


class Noise:
    """Whole numbers from −32768 to 32767 that every processor draws alike."""

    def __init__(self) -> None:
        self._state = 1

    def next(self) -> int:
        self._state = (self._state * 1664525 + 1013904223) & 0xFFFFFFFF
        return (self._state >> 16) - 32768


def known_cycles(settings: FieldSettings) -> KnownCycles:
    """The answers of the first cycles."""
    Z, omega_n, T_s = settings.Z_base, settings.omega_n, settings.T_s
    V_pk = 1.0 / settings.per_volt
    R, L = IMPEDANCE[0] * Z + settings.R_2 * Z, (IMPEDANCE[1] + settings.X_2) * Z / omega_n
    decay = math.exp(-R * T_s / L)
    turn, grid = cmath.rect(1.0, OFF_NOMINAL * omega_n * T_s), cmath.rect(1.0, -LOAD)
    plant = KnownPlant(
        turn.real, turn.imag, decay, (1.0 - decay) / R, grid.real, grid.imag, V_pk, NOISE * V_pk / 32768.0,
        NOISE / settings.per_ampere / 32768.0, OFF_NOMINAL * omega_n, math.hypot(*IMPEDANCE) * Z,
        math.hypot(*IMPEDANCE) * Z / omega_n,
    )  # fmt: skip
    lock, track, answers, noise = first_lock_in(settings, plant.omega), first_track(settings), [], Noise()
    frame, i = 1.0 + 0.0j, 0.0 + 0.0j
    while len(answers) < CYCLES:
        u = complex(*probe_of(lock, 1.0, settings))
        sent = u * frame
        v = V_pk * (frame + sent)
        v_seen = v + complex(plant.v_noise * noise.next(), plant.v_noise * noise.next())
        i_seen = i + complex(plant.i_noise * noise.next(), plant.i_noise * noise.next())
        if len(answers) == CYCLES - 1 and lock.spoilt < 0.5:
            v_seen = complex(math.nan, v_seen.imag)
        lock = listen(lock, v_seen.real, v_seen.imag, i_seen.real, i_seen.imag, sent.real, sent.imag, 0.0, settings)
        if lock.closed > 0.5:
            lock, track, answer = conclude(lock, track, settings)
            answers.append(FieldAnswer(*map(float, answer)))
        i = plant.decay * i + plant.gain * (v - V_pk * grid * frame)
        frame *= turn
    return KnownCycles(plant, answers)
