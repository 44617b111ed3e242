"""The field estimator's network: what it is given once per cycle, when it may speak, and what it adds to an answer.

It is given numbers of order one of the recursions, which are always finite. It answers with a posterior of y = ln(Z/Ẑ),
where Ẑ is the estimate that the recursions hold. It is never asked alone: its inputs are the recursions' own
quantities, and it speaks only for some cycles after these have flagged an event. docs/theory/field-network.md derives
the equations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import DOUBT, LEARN, FieldAnswer, FieldSettings, LockIn
from vsgdesign.equations.field.doubt import NEVER, impedance_of_step, step_of_grid
from vsgdesign.equations.field.noise import left_over
from vsgdesign.equations.field.state import FieldTrack, grid_sigma
from vsgdesign.equations.field.tracks import Fit
from vsgdesign.equations.integration import TURN

LN_10 = 2.302585092994046


class FieldFeatures(NamedTuple):
    """Features of one cycle. "lg" is the logarithm to base 10, "ln" the natural one; all are clipped."""

    learning: Any
    doubting: Any
    """1 or 0"""
    used: Any
    """Tenths of the cycles that the fast track has taken in since the event, up to 1; 0 outside a doubt."""
    waited: Any
    """Tenths of the cycles since the event, up to 1; 0 outside a doubt."""
    lg_sigma: Any
    """Relative standard deviation of the answer."""
    lg_S_1: Any
    lg_S_2: Any
    """Noise of both lines over 1e-8."""
    lg_chip_1: Any
    lg_chip_2: Any
    """Noise of the chips over that of the cycles."""
    lg_a_1: Any
    lg_a_2: Any
    """Amplitudes of both lines in the next cycle over 1e-3."""
    since_flip: Any
    """Tenths of the cycles since the code's last change of sign, up to 1."""
    fast_ln: Any
    fast_turn: Any
    """ln of the fast track's |Z| over the answer's, and the angle between them, rad."""
    lg_fast_sigma: Any
    """Relative standard deviation of the fast track."""
    fast_known: Any
    step_ln: Any
    step_turn: Any
    """The same for the impedance of the step."""
    lg_step_sigma: Any
    step_known: Any
    lg_step_misfit: Any
    """Scatter of the grid's phasor if the impedance is that of the step, over its usual scatter."""
    lg_grid_misfit: Any
    """Scatter of the grid's phasor about its new value if the impedance has not changed."""
    lg_grid_step: Any
    """Step of the grid's phasor if the impedance has not changed."""
    ln_d_old: Any
    ln_d_step: Any
    """ln(1 + squared distance) of the fast track to the old impedance and to that of the step."""
    current: Any
    """Length of the current, pu."""
    ln_Z: Any
    angle: Any
    """Of the answer's impedance."""
    lg_variance: Any
    """Variance of the grid's phasor over 1e-7."""
    ln_misfit: Any
    """ln(1 + squared residual of the answer over its variance)."""
    slip: Any
    """Mean turn of the grid's phasor per cycle, mrad, up to 3."""
    limited: Any
    """Share of the cycle's samples in which the current limiter acted."""
    lg_slow: Any
    """Cycles in the slow track."""


def lg(x: Any, least: Any, most: Any) -> Any:
    """Logarithm to base 10 of what is clipped."""
    return np.log(np.minimum(np.maximum(x, least), most)) / LN_10


def ratio_of(fit: Fit, answer: Fit) -> tuple[Any, Any]:
    """Length (ln) and angle of an impedance over another one's. Returns (ratio, turn)."""
    size = np.sqrt(fit.R * fit.R + fit.X * fit.X)
    own = np.sqrt(answer.R * answer.R + answer.X * answer.X)
    ratio = np.log(np.maximum(size, 1e-4) / np.maximum(own, 1e-4))
    turn = np.arctan2(fit.X, fit.R) - np.arctan2(answer.X, answer.R)
    turn = turn - TURN * np.floor(turn / TURN + 0.5)
    known = fit.known > 0.5
    ratio = np.minimum(np.maximum(ratio, -4.0), 4.0) if known else 0.0
    turn = turn if known else 0.0
    return ratio, turn


def features(lock: LockIn, track: FieldTrack, answer: FieldAnswer, settings: FieldSettings) -> FieldFeatures:
    """The features of the cycle that :func:`conclude` has just concluded, from what it returned."""
    fit, noise, doubt, phasor = track.answer, track.noise, track.doubt, track.phasor
    doubting = 1.0 if track.mode == DOUBT else 0.0
    learning = 1.0 if track.mode == LEARN else 0.0
    step = impedance_of_step(doubt, phasor)
    known = doubting * step.known
    step = Fit(R=step.R, X=step.X, P_RR=step.P_RR, P_RX=0.0, P_XX=step.P_XX, known=known)
    fast_ratio, fast_turn = ratio_of(track.fast.fit, fit)
    step_ratio, step_turn = ratio_of(step, fit)
    usual = np.sqrt(phasor.variance)
    n = np.maximum(doubt.cycles - 1.0, 1.0)
    g_re, g_im, scatter = step_of_grid(doubt, fit)
    of_step = np.sqrt(left_over(doubt.squares, step.R, step.X) / n)
    present = doubting if doubt.cycles > 0.5 else 0.0
    fast_sigma = grid_sigma(track.fast.fit, settings)
    step_sigma = grid_sigma(step, settings)
    current = np.sqrt(phasor.i_re * phasor.i_re + phasor.i_im * phasor.i_im)
    fast_known = track.fast.fit.known
    d_step = doubt.d_step if doubting > 0.5 else NEVER
    slip = np.minimum(np.maximum(1e3 * phasor.slip, -3.0), 3.0)
    line_1, line_2 = noise.line_1, noise.line_2
    return FieldFeatures(
        learning=learning,
        doubting=doubting,
        used=doubting * np.minimum(0.1 * doubt.used, 1.0),
        waited=doubting * np.minimum(0.1 * doubt.cycles, 1.0),
        lg_sigma=lg(answer.sigma, 1e-3, 10.0),
        lg_S_1=lg(1e8 * line_1.S, 1e-4, 1e6),
        lg_S_2=lg(1e8 * line_2.S, 1e-4, 1e6),
        lg_chip_1=lg(line_1.chip / np.maximum(line_1.cycle, 1e-30), 1e-2, 1e2),
        lg_chip_2=lg(line_2.chip / np.maximum(line_2.cycle, 1e-30), 1e-2, 1e2),
        lg_a_1=lg(1e3 * np.abs(lock.a_1), 1e-2, 1e2),
        lg_a_2=lg(1e3 * np.abs(lock.a_2), 1e-2, 1e2),
        since_flip=np.minimum(0.1 * track.code.since_flip, 1.0),
        fast_ln=fast_ratio,
        fast_turn=fast_turn,
        lg_fast_sigma=fast_known * lg(fast_sigma, 1e-3, 10.0) + (1.0 - fast_known),
        fast_known=fast_known,
        step_ln=step_ratio,
        step_turn=step_turn,
        lg_step_sigma=known * lg(step_sigma, 1e-3, 10.0) + (1.0 - known),
        step_known=known,
        lg_step_misfit=known * lg(of_step / usual + 1e-2, 1e-2, 1e4),
        lg_grid_misfit=present * lg(scatter / usual + 1e-2, 1e-2, 1e4),
        lg_grid_step=present * lg(np.sqrt(g_re * g_re + g_im * g_im) / usual + 1e-2, 1e-2, 1e4),
        ln_d_old=doubting * np.log(1.0 + np.minimum(doubt.d_old, 1e4)),
        ln_d_step=np.log(1.0 + np.minimum(d_step, 1e4)),
        current=np.minimum(current, 3.0),
        ln_Z=np.log(np.minimum(np.maximum(np.sqrt(fit.R * fit.R + fit.X * fit.X), 1e-3), 1e2)),
        angle=np.arctan2(fit.X, fit.R),
        lg_variance=lg(1e7 * phasor.variance, 1e-2, 1e6),
        ln_misfit=np.log(1.0 + np.minimum(track.misfit, 1e4)),
        slip=slip,
        limited=answer.limited,
        lg_slow=lg(track.slow.count, 1.0, 1e3),
    )


CHI_SQUARE_95 = 5.991464547107979
"""Square of the radius that contains 95 % of a Gaussian in two dimensions, −2 ln 0.05."""

LONG_AGO = 1000.0
"""Cycles since an event beyond which nothing is counted any more."""

LARGEST = 4.0
"""Largest |ln|Z/Ẑ|| that the network may answer, a factor of 55: more is an input that it never saw."""


CHI_SQUARE_999 = 13.815510557964274
"""The same for 99.9 %: beyond it, the network refutes the held estimate and announces a change."""

MOSTLY_LIMITED = 0.3
"""Share of limited samples in a cycle above which the network does not speak: the current shows the limiter then."""


class GateLimits(NamedTuple):
    """When the network may speak. Cycles are counted from the event flag of the recursions, which is cycle 0."""

    first: Any
    """First cycle in which it may speak."""
    first_refuted: Any
    """The same if the step itself already refutes that the impedance moved."""
    last: Any
    """Last cycle in which it may speak."""
    confident: Any
    """It speaks if the standard deviation of the grid's impedance is below this share of its length."""


class NetworkGate(NamedTuple):
    """What the gate remembers from cycle to cycle."""

    since: Any
    """Cycles since the last event flag."""
    told: Any
    """1 after the network has said, since this flag, that the grid has changed, else 0."""


class Posterior(NamedTuple):
    """The network's five outputs: mean of y and the factor of its covariance (:eq:`field-posterior`)."""

    mean_size: Any
    """Mean of ln|Z/Ẑ|."""
    mean_angle: Any
    """Mean of arg Z − arg Ẑ, rad."""
    log_first: Any
    log_second: Any
    """Logarithms of the diagonal of the factor."""
    slope: Any
    """How far the angle follows the size."""


class FusedImpedance(NamedTuple):
    """An impedance with its covariance, in the unit of the Ẑ that was given."""

    R: Any
    X: Any
    var_R: Any
    cov_RX: Any
    var_X: Any
    distance: Any
    """Squared Mahalanobis distance of Ẑ from this answer: above CHI_SQUARE_999, it says that the grid has changed."""


FIRST_GATE = NetworkGate(LONG_AGO, 0.0)
"""Before any event."""


def next_gate(gate: NetworkGate, event: Any) -> NetworkGate:
    """The gate after a cycle. ``event`` is 1 in a cycle in which the recursions have flagged an event, else 0."""
    begins = event > 0.5
    return NetworkGate(
        since=np.where(begins, 0.0, np.minimum(gate.since + 1.0, LONG_AGO)),
        told=np.where(begins, 0.0, gate.told),
    )


def may_speak(gate: NetworkGate, refuted: Any, limits: GateLimits) -> Any:
    """1 if the network may speak in this cycle (:eq:`field-gate`). ``refuted`` is 1 if Z did not move, by the step."""
    first = np.where(refuted > 0.5, limits.first_refuted, limits.first)
    late = np.where(gate.since >= first, 1.0, 0.0)
    return np.where(gate.since <= limits.last, late, 0.0)


def step_refuted(seen: FieldFeatures) -> Any:
    """1 if no impedance explains the step: the best one leaves ten times the usual scatter of the phasor, else 0."""
    told = seen.step_known > 0.5 and seen.waited > 0.15
    return 1.0 if told and seen.lg_step_misfit > 1.0 else 0.0


def fused_impedance(R: Any, X: Any, posterior: Posterior, radius_squared: Any) -> FusedImpedance:
    """The network's answer from the held estimate Ẑ = R + jX and its five outputs (:eq:`field-fusion`).

    ``radius_squared`` is the conformal radius squared: 95 % of the validation runs' answers lie within it. The
    covariance is scaled so that its 95 % ellipse is the one with this radius.
    """
    size = np.exp(np.minimum(np.maximum(posterior.mean_size, -LARGEST), LARGEST))
    cosine, sine = np.cos(posterior.mean_angle), np.sin(posterior.mean_angle)
    a = size * (R * cosine - X * sine)
    b = size * (R * sine + X * cosine)
    first, second = _deviations(posterior)
    below = posterior.slope * first
    scale = radius_squared / CHI_SQUARE_95
    c_11 = scale * first * first
    c_12 = scale * first * below
    c_22 = scale * (below * below + second * second)
    return FusedImpedance(
        R=a,
        X=b,
        var_R=a * a * c_11 - 2.0 * a * b * c_12 + b * b * c_22,
        cov_RX=a * b * (c_11 - c_22) + (a * a - b * b) * c_12,
        var_X=b * b * c_11 + 2.0 * a * b * c_12 + a * a * c_22,
        distance=posterior_distance(0.0, 0.0, posterior) / scale,
    )


def posterior_distance(size: Any, angle: Any, posterior: Posterior) -> Any:
    """Squared Mahalanobis distance of y = (size, angle) from the posterior, before any scaling by a radius."""
    first, second = _deviations(posterior)
    u = (size - posterior.mean_size) / first
    w = (angle - posterior.mean_angle - posterior.slope * (size - posterior.mean_size)) / second
    return u * u + w * w


def _deviations(posterior: Posterior) -> tuple[Any, Any]:
    """Returns (first, second): the diagonal of the factor, from 0.25 % to a factor of 7."""
    return (
        np.exp(np.minimum(np.maximum(posterior.log_first, -6.0), 2.0)),
        np.exp(np.minimum(np.maximum(posterior.log_second, -6.0), 2.0)),
    )


def fused_answer(
    answer: FieldAnswer,
    gate: NetworkGate,
    posterior: Posterior,
    refuted: Any,
    radius_squared: Any,
    limits: GateLimits,
    settings: FieldSettings,
) -> tuple[NetworkGate, FieldAnswer]:
    """The answer of a cycle with the network behind it.

    Where the recursions have no valid answer and the network may speak, the answer is the network's. A valid answer of
    the recursions keeps its impedance; if the network is less sure of it than they are, its covariance is the
    network's, and it is no longer valid where this is too large.

    ``gate`` is that after this cycle's :func:`next_gate`; ``refuted`` and ``radius_squared`` are as in
    :func:`may_speak` and :func:`fused_impedance`. Returns (gate, answer).
    """
    ohm = settings.Z_base
    henry = settings.Z_base / settings.omega_n
    R = answer.R_g / ohm + settings.R_2
    X = answer.L_g / henry + settings.X_2
    fused = fused_impedance(R, X, posterior, radius_squared)
    quiet = answer.spoilt < 0.5 and answer.limited <= MOSTLY_LIMITED and answer.foreign < 0.5 and answer.passive > 0.5
    open_ = quiet and answer.valid < 0.5 and may_speak(gate, refuted, limits) > 0.5
    R_g, X_g = fused.R - settings.R_2, fused.X - settings.X_2
    sigma = np.sqrt((fused.var_R + fused.var_X) / np.maximum(R_g * R_g + X_g * X_g, 1e-12))
    speaks = open_ and sigma < limits.confident
    refutes = speaks and fused.distance > CHI_SQUARE_999
    announces = refutes and gate.told < 0.5
    moved = NetworkGate(since=gate.since, told=1.0 if announces else gate.told)
    spoken = answer._replace(
        R_g=R_g * ohm,
        L_g=X_g * henry,
        var_R=fused.var_R * ohm * ohm,
        cov_RL=fused.cov_RX * ohm * henry,
        var_L=fused.var_X * henry * henry,
        sigma=sigma,
        valid=1.0,
        changed=1.0 if announces else answer.changed,
    )
    doubts = quiet and answer.valid > 0.5 and sigma > answer.sigma
    widened = answer._replace(
        var_R=spoken.var_R,
        cov_RL=spoken.cov_RL,
        var_L=spoken.var_L,
        sigma=sigma,
        valid=1.0 if sigma < settings.sigma_valid else 0.0,
    )
    kept = widened if doubts else answer
    return moved, spoken if speaks else kept
