"""Small synchronised data sets from phasors: five grids as published, no EMT."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tests.estimator.phasors import phasor_windows
from vsgdesign.equations.frames import base_impedance
from vsgdesign.estimator.data_set import Split

Array = NDArray[np.float64]

OMEGA = 2.0 * math.pi * 50.0


def phasor_data(count: int, seed: int, samples: int = 100, noise: float = 1e-3) -> tuple[Array, Array, Split]:
    """Windows (count, 2·samples), targets (count, 2) in Ω and H, and a 70/15/15 split."""
    rng = np.random.default_rng(seed)
    X = base_impedance(5e3, 110.0) / rng.choice([2.0, 4.5, 7.0, 9.5, 15.0], count)
    P, Q = rng.uniform(1e3, 3.5e3, count), rng.uniform(0.0, 2e3, count)
    t_s = 0.02 / samples * np.arange(samples, dtype=float)
    v, i = phasor_windows(X, X / OMEGA, P, Q, 110.0, OMEGA, t_s)
    v = v + noise * 155.0 * rng.standard_normal(v.shape)
    i = i + noise * 21.0 * rng.standard_normal(i.shape)
    ends = (round(0.7 * count), round(0.85 * count))
    rows = np.split(rng.permutation(count), ends)
    return np.hstack([v, i]), np.column_stack([X, X / OMEGA]), Split(*(np.sort(part) for part in rows))
