"""The field estimator on the seam of all estimators: its settings for a converter, and its run in plain Python.

Its learned part runs on the controller with NumPy alone. Once a cycle it turns the recursions' features into a
posterior of ln(Z/Ẑ). :mod:`vsgdesign.equations.field.fusion` says when this answer may be used and what it makes of the
estimate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field import (
    LEARN,
    FieldAnswer,
    FieldFeatures,
    FieldSettings,
    FieldTrack,
    LockIn,
    conclude,
    features,
    first_lock_in,
    first_track,
    listen,
    probe_value,
)
from vsgdesign.equations.field.fusion import (
    FIRST_GATE,
    GateLimits,
    NetworkGate,
    Posterior,
    fused_answer,
    next_gate,
    step_refuted,
)
from vsgdesign.equations.integration import low_pass_share
from vsgdesign.errors import ArtifactError
from vsgdesign.identification.interface import Array, Estimate, Installation, Needs, Probe, Samples


@dataclass(frozen=True, eq=False)
class FieldNetwork:
    """A network with its scaling folded in. Made by :func:`field_network`."""

    W_1: Array
    """(h, n) for n features."""
    b_1: Array
    W_2: Array
    b_2: Array
    W_3: Array
    """(5, h)."""
    b_3: Array
    radii: tuple[float, float, float]
    """Squared conformal radius while learning, tracking and in doubt."""
    gate: GateLimits

    def posterior(self, features: Sequence[float]) -> Posterior:
        """The five outputs for n features (:eq:`field-network`)."""
        return Posterior(*self.outputs(np.asarray(features, dtype=np.float64)).tolist())

    def behind(
        self, gate: NetworkGate, seen: FieldFeatures, answer: FieldAnswer, settings: FieldSettings
    ) -> tuple[NetworkGate, FieldAnswer]:
        """The answer of a cycle with this network behind the recursions (:eq:`field-fusion`). Returns (gate, answer).

        ``gate`` is that of the cycle before, ``seen`` and ``answer`` are the recursions' features and answer in this
        one.
        """
        moved, spoken = fused_answer(
            answer,
            next_gate(gate, answer.event),
            self.posterior(seen),
            step_refuted(seen),
            self.radii[int(answer.mode)],
            self.gate,
            settings,
        )
        return NetworkGate(*map(float, moved)), FieldAnswer(*map(float, spoken))

    def outputs(self, features: Array) -> Array:
        """(..., 5) for features (..., n)."""
        hidden = np.tanh(features @ self.W_1.T + self.b_1)
        return np.tanh(hidden @ self.W_2.T + self.b_2) @ self.W_3.T + self.b_3


def field_network(weights: Any, features: Sequence[str]) -> FieldNetwork:
    """The network of some weights (artifacts.field_weights.FieldWeights) for recursions with these features.

    Raises ArtifactError if the weights were trained on other features.
    """
    if tuple(features) != tuple(weights.features):
        wanted, given = set(weights.features), set(features)
        parts = [
            f"{words} {', '.join(sorted(names))}"
            for words, names in (("they lack", given - wanted), ("they also take", wanted - given))
            if names
        ]
        raise ArtifactError(
            "these weights are of recursions with other features"
            + (f" ({'; '.join(parts)})" if parts else " (in another order)")
            + ". Train again with this version, or use the packaged weights."
        )
    layers = weights.layers
    gain = 1.0 / layers.deviation
    return FieldNetwork(
        W_1=layers.W_1 * gain,
        b_1=layers.b_1 - layers.W_1 @ (gain * layers.mean),
        W_2=layers.W_2,
        b_2=layers.b_2,
        W_3=layers.W_3,
        b_3=layers.b_3,
        radii=weights.radii,
        gate=weights.gate,
    )


PAIRS = (0.5, -2.5, 2.5, -4.5)
"""Speeds of the first lines of the pairs 1, 2, 3 and 4 in the flywheel's frame. No two pairs have a line in common."""

LOW_PASS = 2e-3
"""Time constant of the low-pass on v, i and the probe, s."""


@dataclass(frozen=True, kw_only=True)
class ProbeLimits:
    """How large the probe may be at rest. It is smaller where less is enough."""

    sigma: float = 0.013
    """Standard deviation of Z relative to |Z| that the probe is to give."""
    amplitude: float = 0.002
    """Largest amplitude of one line at the PCC, relative to the rated voltage, rms over changes of the sign."""
    amplitude_sent: float = 0.01
    """Largest amplitude of one line as it is sent. Less arrives where the converter has a transient impedance."""
    amplitude_burst: float = 0.007
    """Largest amplitude at the PCC while the estimator learns or is in doubt, for some tenths of a second."""
    current: float = 0.03
    """Largest current of one line, relative to the rated current."""
    ripple: float = 0.0048
    """Largest rms value of the power that both lines add, relative to the rated power."""


def field_settings(
    *,
    T_s: float,
    omega_n: float,
    V_base: float,
    Z_base: float,
    R_2: float = 0.0,
    L_2: float = 0.0,
    guess: tuple[float, float] = (0.0, 0.0),
    limits: ProbeLimits | None = None,
    seed: int = 1,
    pair: int = 1,
) -> FieldSettings:
    """The settings of a converter from its datasheet, in SI units and peak values.

    V_base is the rated phase voltage (V peak) and Z_base the base impedance (Ω). R_2 (Ω) and L_2 (H) lie between the
    measured voltage and the PCC. ``guess`` (Ω, H) is the grid with which learning begins; zeros mean a short-circuit
    ratio of about 3. ``seed`` is any whole number: the sign code of the probe. ``pair`` (1 to 4) says on
    which lines it is sent: units on one grid take different ones.
    """
    limits = limits or ProbeLimits()
    R_1, L_1 = guess if max(guess) > 0.0 else (0.1 * Z_base, 0.3 * Z_base / omega_n)
    return FieldSettings(
        T_s=T_s,
        omega_n=omega_n,
        per_volt=1.0 / V_base,
        per_ampere=Z_base / V_base,
        Z_base=Z_base,
        R_2=R_2 / Z_base,
        X_2=omega_n * L_2 / Z_base,
        smoothing=low_pass_share(LOW_PASS, T_s),
        R_first=(R_1 + R_2) / Z_base,
        X_first=omega_n * (L_1 + L_2) / Z_base,
        amplitude_least=0.0002,
        amplitude_sent=limits.amplitude_sent,
        amplitude_rest=limits.amplitude,
        amplitude_burst=limits.amplitude_burst,
        current_rest=limits.current,
        ripple_rest=limits.ripple,
        sigma_rest=limits.sigma,
        sigma_burst=0.01,
        noise_first=3e-8,
        gain_class=math.hypot(0.0045, 0.13 * omega_n * T_s),
        sigma_valid=0.15,
        seed=float(seed % 511 + 1),
        line=PAIRS[pair - 1],
        neighbours=0.0,
    )


FOREIGN = "another converter sends its probe on the same lines: give it another pair ([estimator.probe] pair)"
"""What an answer says that hears another probe."""

NOT_PASSIVE = "not a passive R-L-C grid: another converter answers the probe, or something else than R, L and C"
"""What an answer says whose lines no passive grid explains."""

FINDS_WITHIN = 1.0
"""Time after any event within which the estimator has an answer again, s."""


class FieldState(NamedTuple):
    """State of the method in plain Python."""

    lock: LockIn
    track: FieldTrack
    gate: NetworkGate = FIRST_GATE
    """Of the network, if there is one."""


@dataclass(frozen=True)
class FieldEstimator:
    """The field estimator (docs/theory/field-estimator.md). It takes single samples and answers once per cycle."""

    settings: FieldSettings
    title: str = "the field estimator"
    signals: str = "field"
    calibrated: bool = True
    finds_within: float = FINDS_WITHIN
    network: FieldNetwork | None = None
    """A network behind the recursions (docs/theory/field-network.md)."""
    needs: Needs = field(init=False)

    def __post_init__(self) -> None:
        T_s = self.settings.T_s
        object.__setattr__(self, "needs", Needs(samples=1, sample_interval=T_s, probe_hold=T_s))

    def first(self) -> FieldState:
        """Nothing measured."""
        return FieldState(first_lock_in(self.settings, self.settings.omega_n), first_track(self.settings))

    def probe(self, state: FieldState) -> Probe:
        """The value of the probe for the coming sample."""
        u_d, u_q = probe_value(state.lock, 1.0, self.settings)
        return Probe(np.array([complex(u_d, u_q)]), self.settings.T_s)

    def update(self, state: FieldState, samples: Samples) -> tuple[FieldState, Estimate | None]:
        """The state after one sample, and the answer where a cycle ended."""
        v, i = np.ravel(samples.v), np.ravel(samples.i)
        theta = float(samples.theta[0])
        sent = complex(samples.sent[0]) * complex(math.cos(theta), math.sin(theta)) if math.isfinite(theta) else 0j
        limited = 1.0 if samples.limited > 0 else 0.0
        lock = listen(
            state.lock,
            float(v[0]),
            float(v[1]),
            float(i[0]),
            float(i[1]),
            sent.real,
            sent.imag,
            limited,
            self.settings,
        )
        if lock.closed < 0.5:
            return state._replace(lock=lock), None
        lock, track, answer = conclude(lock, state.track, self.settings)
        gate = state.gate
        if self.network is not None:
            seen = features(lock, track, answer, self.settings)
            gate, answer = self.network.behind(gate, seen, answer, self.settings)
        return FieldState(lock, track, gate), estimate_of(answer)


def estimate_of(answer: FieldAnswer) -> Estimate:
    """The answer of a cycle as an estimate with its status."""
    covariance = np.array([[answer.var_R, answer.cov_RL], [answer.cov_RL, answer.var_L]], dtype=float)
    status, reason = "uncertain", ""
    if answer.passive < 0.5:
        reason = NOT_PASSIVE
    if answer.foreign > 0.5:
        reason = FOREIGN
    if answer.spoilt > 0.5:
        status = "not finite"
    elif answer.valid > 0.5:
        status = "ok"
    elif answer.mode == LEARN:
        status = "waiting"
    elif answer.doubt > 0.5:
        reason = "the grid has changed and the estimator does not know yet how: keep the estimate before"
    changed, surprised = answer.changed > 0.5, answer.event > 0.5
    return Estimate(float(answer.R_g), float(answer.L_g), status, covariance, reason, changed, surprised)


def field_estimator(at: Installation) -> FieldEstimator:
    """The field estimator of an installation."""
    return FieldEstimator(
        field_settings(T_s=at.T_s, omega_n=at.omega_n, V_base=at.V_base, Z_base=at.Z_base, guess=at.guess)
    )


def field_network_estimator(at: Installation) -> FieldEstimator:
    """The same with the network of an installation's weights (artifacts.field_weights.FieldWeights) behind it.

    Raises ArtifactError if there are none, or if they are of recursions with other features.
    """
    if at.weights is None:
        raise ArtifactError("there is no network to put behind the field estimator. Give trained field weights.")
    network = field_network(at.weights, FieldFeatures._fields)
    return replace(field_estimator(at), title="the field estimator with its network", network=network)
