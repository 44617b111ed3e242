"""A small network of the field estimator, random."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsgdesign.artifacts.field_weights import MODES, FieldLayers, FieldWeights
from vsgdesign.equations.field.fusion import GateLimits


def random_field_weights(features: Sequence[str] = ("size", "angle", "doubt"), seed: int = 0) -> FieldWeights:
    """An untrained network of 4 and 4 units."""
    rng = np.random.default_rng(seed)
    n, h = len(features), 4
    return FieldWeights(
        features=tuple(features),
        layers=FieldLayers(
            mean=rng.standard_normal(n),
            deviation=rng.uniform(0.5, 2.0, n),
            W_1=rng.standard_normal((h, n)),
            b_1=rng.standard_normal(h),
            W_2=rng.standard_normal((h, h)),
            b_2=rng.standard_normal(h),
            W_3=0.1 * rng.standard_normal((5, h)),
            b_3=np.array([0.0, 0.0, -2.5, -2.5, 0.0]),
        ),
        radius_squared=dict(zip(MODES, (5.0, 6.0, 7.0), strict=True)),
        gate=GateLimits(first=4.0, first_refuted=2.0, last=25.0, confident=0.15),
        converters=({"name": "made up", "S_rated": 5e3, "V_rated_rms": 63.5, "f_n": 50.0, "T_s": 5e-5},),
        data_hash="0" * 64,
        recipe={"name": "field"},
        seed=seed,
        training={"best_epoch": 3},
    )
