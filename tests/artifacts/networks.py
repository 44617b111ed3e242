"""A small network's weights, random."""

from __future__ import annotations

import numpy as np

from vsgdesign.artifacts.network_weights import Network, NetworkWeights, WindowFormat, fit_scaling


def span(values: np.ndarray) -> tuple[float, float]:
    """The least and the largest of some values."""
    return float(values.min()), float(values.max())


def random_weights(
    seed: int = 0, channels: str = "phase_a", samples: int = 100, synchronised: bool = False
) -> NetworkWeights:
    """An untrained network for windows of 200 V and 20 A."""
    rng = np.random.default_rng(seed)
    window = WindowFormat(samples, 200e-6, channels, synchronised)
    n, h = window.length, 8
    x = rng.standard_normal((50, n)) * np.where(np.arange(n) < n // 2, 200.0, 20.0) + 3.0
    y = np.column_stack([rng.uniform(0.5, 3.5, 50), rng.uniform(1.5e-3, 11e-3, 50)])
    network = Network(
        rng.standard_normal((h, n)) / np.sqrt(n),
        rng.standard_normal(h),
        0.1 * rng.standard_normal((2, h)),
        0.1 * rng.standard_normal(2),
        fit_scaling(x),
        fit_scaling(y),
    )
    return NetworkWeights(
        network=network,
        window=window,
        trained_on={"R_g": span(y[:, 0]), "L_g": span(y[:, 1]), "P": (1e3, 3e3)},
        data_hash="0" * 64,
        recipe={"name": "published"},
        seed=seed,
        training={"stop": "goal", "mse": 1e-5},
    )
