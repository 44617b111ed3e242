"""A scheduler with a network: samples and windows go in, and estimates of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.artifacts.networks import random_weights
from tests.gain_tables import PUBLISHED_BASE, table
from tests.runtime.schedulers import POWERS, made
from vsgdesign.artifacts import GainTable, ValidityBox, write_table_file
from vsgdesign.artifacts.network_weights import write_network_weights
from vsgdesign.equations.scheduler_data import IMPLAUSIBLE, NO_ESTIMATE, NOT_FINITE, SATURATED
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime import (
    load_scheduler,
    neural_estimator,
    scheduler_of,
    settings_of,
)
from vsgdesign.runtime.guards import window_settings


def larger() -> GainTable:
    base = replace(PUBLISHED_BASE, V_g_rms=1100.0, V_rated_rms=1100.0)
    box = ValidityBox((1.5, 20.0), (0.3, 10.0), (-4500.0, 4500.0), (-2000.0, 2000.0), (935.0, 1375.0), 0.2)
    return table(base=base, validity=box)


def test_windows_and_samples_through_a_network() -> None:
    rng = np.random.default_rng(3)
    estimator = neural_estimator(random_weights(), sample_interval=200e-6, v_limit=900.0)
    whole, pushed = scheduler_of(table(), estimator), scheduler_of(table(), estimator)
    seen = set()
    for k in range(30):
        v, i = 200.0 * rng.standard_normal(100), 20.0 * rng.standard_normal(100)
        v[7] = {5: np.nan, 9: 900.0}.get(k, v[7])
        full = [pushed.push(*pair) for pair in zip(v, i, strict=True)]
        assert full == [False] * 99 + [True]
        assert pushed.push(1.0, 2.0)  # left out
        answer = whole.update(v, i, *POWERS)
        assert pushed.update_pushed(*POWERS) == answer
        seen.add(answer.reason)
        assert (answer.reason == NOT_FINITE) == (k == 5)
        assert (answer.reason == SATURATED) == (k == 9)
    assert IMPLAUSIBLE in seen or 0 in seen
    assert whole.update_pushed(*POWERS).reason == NO_ESTIMATE
    with pytest.raises(ArtifactError, match="no network"):
        made().update(np.zeros(100), np.zeros(100), *POWERS)


def test_a_network_of_another_converter_is_refused() -> None:
    estimator = neural_estimator(random_weights(), sample_interval=200e-6)
    with pytest.raises(ArtifactError, match="of different converters"):
        scheduler_of(larger(), estimator)


def test_a_network_answers_once_a_window(tmp_path: Path) -> None:
    """The nominal period is the window's: without ticks, as much time passes as the window took."""
    weights = random_weights()
    write_table_file(table(), tmp_path / "t.json")
    write_network_weights(weights, tmp_path / "w.json")
    fit = {"sample_interval": weights.window.sample_interval, "channels": weights.window.channels}
    c = load_scheduler(tmp_path / "t.json", tmp_path / "w.json", fit=fit).settings
    assert c.update_ticks * c.tick == pytest.approx(weights.window.samples * weights.window.sample_interval)
    slow = window_settings(0.3)
    assert slow == {
        "update_ticks": 300_000,
        "longest_ticks": 600_000,
        "stale_ticks": 1_200_000,
        "lost_ticks": 12_000_000,
    }
    assert window_settings(0.01)["stale_ticks"] == settings_of(table()).stale_ticks
