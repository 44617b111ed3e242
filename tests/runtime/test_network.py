"""The neural estimator as it ships: folding, statuses, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.artifacts.networks import random_weights
from tests.runtime.test_light_import import HEAVY, imported
from vsgdesign.artifacts.network_weights import write_network_weights
from vsgdesign.errors import ArtifactError
from vsgdesign.identification import STATUSES
from vsgdesign.identification.neural import NeuralEstimator, neural_estimator
from vsgdesign.runtime import load_neural_estimator

RNG = np.random.default_rng(6)


def windows(count: int, length: int = 100) -> tuple[np.ndarray, np.ndarray]:
    return 200.0 * RNG.standard_normal((count, length)), 20.0 * RNG.standard_normal((count, length))


def made(channels: str = "phase_a", margin: float = 1e6, **fit: Any) -> NeuralEstimator:
    return neural_estimator(
        random_weights(channels=channels), sample_interval=200e-6, channels=channels, margin=margin, **fit
    )


@pytest.mark.parametrize("channels", ["phase_a", "alpha_beta", "dq"])
def test_folded_is_unfolded(channels: str) -> None:
    """To 1e-12 of the trained range."""
    weights, estimator = random_weights(channels=channels), made(channels)
    v, i = windows(20, 100 * estimator.components)
    expected = weights.network.evaluate(np.hstack([v, i]))
    got = np.array([estimator.estimate(*pair)[:2] for pair in zip(v, i, strict=True)])
    assert np.all(np.abs(got - expected) < np.array([3.0, 0.0095]) * 1e-12)
    if estimator.components == 2:
        again = [estimator.estimate(a.reshape(2, 100), b.reshape(2, 100))[:2] for a, b in zip(v, i, strict=True)]
        assert np.array_equal(again, got)


def test_beyond_what_was_trained_on_is_clipped_and_said() -> None:
    weights = random_weights()
    v, i = windows(30)
    raw = weights.network.evaluate(np.hstack([v, i]))
    estimator = made(margin=0.0)
    seen = set()
    for a, b, (R, L) in zip(v, i, raw, strict=True):
        estimate = estimator.estimate(a, b)
        inside = 0.5 <= R <= 3.5 and 1.5e-3 <= L <= 11e-3
        assert estimate.status == ("ok" if inside else "outside")
        assert estimate.R_g == pytest.approx(np.clip(R, 0.5, 3.5), rel=1e-10)
        assert estimate.L_g == pytest.approx(np.clip(L, 1.5e-3, 11e-3), rel=1e-10)
        seen.add(estimate.status)
    shifted = replace(weights, trained_on=weights.trained_on | {"R_g": (50.0, 60.0)})
    estimate = neural_estimator(shifted, sample_interval=200e-6, margin=0.1).estimate(v[0], i[0])
    assert (estimate.R_g, estimate.status) == (49.0, "outside")
    assert "ok" in seen
    assert seen <= set(STATUSES)


@pytest.mark.parametrize("at", [0, 57, 99])
@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize(
    ("value", "status"),
    [
        (np.nan, "not finite"),
        (np.inf, "not finite"),
        (-np.inf, "not finite"),
        (900.0, "saturated"),
        (-900.0, "saturated"),
    ],
)
def test_a_spoiled_sample_gives_no_estimate(at: int, side: int, value: float, status: str) -> None:
    pair = [np.full(100, 10.0), np.full(100, 10.0)]
    estimator = made(v_limit=900.0, i_limit=900.0)
    assert estimator.estimate(*pair).status == "ok"
    pair[side][at] = value
    estimate = estimator.estimate(*pair)
    assert estimate.status == status
    assert np.isnan(estimate.R_g)
    assert np.isnan(estimate.L_g)


def test_not_finite_is_seen_without_limits_too() -> None:
    v, i = windows(1)
    v[0, 3] = np.inf
    assert made().estimate(v[0], i[0]).status == "not finite"
    i[0, 3] = np.nan
    assert made().estimate(v[0], i[0]).status == "not finite"


@pytest.mark.parametrize(
    ("v", "i"), [((99,), (99,)), ((100,), (99,)), ((2, 100), (2, 100)), ((50, 2), (100,)), ((0,), (0,))]
)
def test_windows_of_another_shape_are_refused(v: tuple[int, ...], i: tuple[int, ...]) -> None:
    with pytest.raises(ArtifactError, match="1 × 100 samples"):
        made().estimate(np.zeros(v), np.zeros(i))


def test_what_does_not_fit_is_refused_by_name_all_at_once() -> None:
    weights = random_weights(synchronised=True)
    with pytest.raises(ArtifactError) as caught:
        neural_estimator(weights, sample_interval=100e-6, channels="dq", v_limit=-1.0, i_limit=np.nan, margin=np.nan)
    for name in ("sample_interval = 100 µs", "channels = dq", "grid_phase", "v_limit", "i_limit", "margin"):
        assert name in str(caught.value)


def test_synchronised_weights_need_a_grid_phase() -> None:
    weights = random_weights(synchronised=True)
    with pytest.raises(ArtifactError, match="grid_phase = false"):
        neural_estimator(weights, sample_interval=200e-6)
    assert neural_estimator(weights, sample_interval=200e-6, grid_phase=True).samples == 100
    assert neural_estimator(random_weights(), sample_interval=200e-6).samples == 100


def test_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "weights.json"
    write_network_weights(random_weights(), path)
    v, i = windows(1)
    assert load_neural_estimator(path, sample_interval=200e-6).estimate(v[0], i[0]) == neural_estimator(
        random_weights(), sample_interval=200e-6
    ).estimate(v[0], i[0])


def test_reading_weights_needs_numpy_alone(tmp_path: Path) -> None:
    path = tmp_path / "weights.json"
    write_network_weights(random_weights(), path)
    names = imported(
        "from vsgdesign.runtime import load_neural_estimator; import numpy; "
        f"load_neural_estimator({str(path)!r}, sample_interval=200e-6).estimate(numpy.zeros(100), numpy.zeros(100))"
    )
    assert "vsgdesign" in names
    assert names.isdisjoint(HEAVY)
