"""The neural estimator of a weights file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vsgdesign.identification.neural import NeuralEstimator, neural_estimator


def load_neural_estimator(path: str | Path, **fit: Any) -> NeuralEstimator:
    """The estimator of a weights file. ``fit`` is as in :func:`vsgdesign.identification.neural.neural_estimator`.

    Raises ArtifactError where the file is damaged or its weights do not fit.
    """
    from vsgdesign.artifacts.network_weights import read_network_weights

    return neural_estimator(read_network_weights(path), **fit)
