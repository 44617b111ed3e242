"""The learned part of the field estimator as it runs on the controller, with NumPy alone.

Once a cycle it turns the recursions' features into a posterior of ln(Z/Ẑ). :mod:`vsgdesign.equations.field.fusion` says
when this answer may be used and what it makes of the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.equations.field import FieldAnswer, FieldFeatures, FieldSettings
from vsgdesign.equations.field.fusion import GateLimits, NetworkGate, Posterior, fused_answer, next_gate, step_refuted
from vsgdesign.errors import ArtifactError
from vsgdesign.identification.interface import Array


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
