"""What the field estimator's network adds to an answer: when it may speak, and the mean and covariance that it gives.

The network answers with a posterior of y = ln(Z/Ẑ), where Ẑ is the estimate that the recursions hold. It is never asked
alone: its inputs are the recursions' own quantities, and it speaks only for some cycles after these have flagged an
event. docs/theory/field-network.md derives the equations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import FieldAnswer, FieldSettings
from vsgdesign.equations.field.features import FieldFeatures

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
