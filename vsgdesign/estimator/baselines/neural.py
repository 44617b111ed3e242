"""The trained network, as it ships, on the windows that it was trained for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsgdesign.artifacts.network_weights import NetworkWeights
from vsgdesign.errors import ArtifactError
from vsgdesign.estimator.baselines.record import Estimates, Record
from vsgdesign.runtime.network import neural_estimator


@dataclass(frozen=True, eq=False)
class NeuralMethod:
    """A network on windows of its own channels. It is given the grid's phase, as published: the comparison is in
    its favour.

    Answers beyond its trained range are clipped, as on the controller.
    """

    weights: NetworkWeights
    name: str = "Neural, published"
    probe: None = None
    signals: str = "steady"

    def estimate(self, record: Record) -> Estimates:
        """One window, one estimate. Raises ArtifactError for weights of another kind of window."""
        window = self.weights.window
        if window.samples != record.samples:
            raise ArtifactError(f"the weights take {window.samples} samples, the windows have {record.samples}.")
        estimator = neural_estimator(
            self.weights, sample_interval=record.sample_interval, channels=window.channels, grid_phase=True
        )
        half = window.length // 2
        found = np.array(
            [
                [estimator.estimate(one[:half], one[half:])[:2] for one in run]
                for run in record.channels[window.channels]
            ]
        )
        return Estimates(found[:, :, 0], found[:, :, 1])
