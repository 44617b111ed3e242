"""Training on made-up cycles with a known answer: the loss, the split by run, the radii, and the same bits twice."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.estimator.field.made_up import PER_RUN, made_up_cycles, told_cycles
from vsgdesign.equations.field.fusion import posterior_distance
from vsgdesign.errors import StudyError
from vsgdesign.estimator.data_set import FieldCycles
from vsgdesign.estimator.training import FieldTraining, FieldTrainingSettings, evaluate, train_layers

SETTINGS = FieldTrainingSettings(hidden=8, epochs=40, batch=128, rate=2e-2, decay=0.01)


@pytest.fixture(scope="module")
def cycles() -> FieldCycles:
    return told_cycles()


@pytest.fixture(scope="module")
def training(cycles: FieldCycles) -> FieldTraining:
    return train_layers(cycles, cycles.split(), SETTINGS)


def test_no_run_is_in_two_parts(cycles: FieldCycles) -> None:
    split = cycles.split(3)
    runs = [set(cycles.run[rows].tolist()) for rows in vars(split).values()]
    assert len(set.union(*runs)) == sum(len(one) for one in runs)
    assert [len(one) for one in runs] == [42, 9, 9]
    assert sum(len(rows) for rows in vars(split).values()) == 60 * PER_RUN
    assert not np.array_equal(split.test, cycles.split(4).test)


def test_too_few_runs_are_refused() -> None:
    with pytest.raises(StudyError, match=r"runs = 3: too few to be split 70/15/15 .* \(least: 6\)"):
        made_up_cycles(runs=3).split()


def test_it_learns_mean_and_deviation(cycles: FieldCycles, training: FieldTraining) -> None:
    """The answer of the made-up cycles is known: y is the first two features, with deviation 5 % × e^spread."""
    rows = cycles.split().test
    posterior = evaluate(training.layers, cycles.features[rows])
    apart = cycles.targets[rows] - np.column_stack([posterior.mean_size, posterior.mean_angle])
    # The best that can be known is the noise: 5 % × rms of e^spread, √(sinh 2/2) = 1.35. A fifth more is allowed.
    assert np.sqrt(np.mean(apart[:, 0] ** 2)) < 1.2 * 0.05 * 1.35
    spread = cycles.features[rows, 2]
    # ln of the deviation follows the third feature with slope 1 about ln 0.05.
    slope, offset = np.polyfit(spread, posterior.log_first, 1)
    assert slope == pytest.approx(1.0, abs=0.3)
    assert math.exp(offset) == pytest.approx(0.05, rel=0.3)


def test_radius_holds_95_percent_of_the_validation_runs(cycles: FieldCycles, training: FieldTraining) -> None:
    rows = cycles.split().validation
    y = cycles.targets[rows]
    distance = posterior_distance(y[:, 0], y[:, 1], evaluate(training.layers, cycles.features[rows]))
    tracking = cycles.mode[rows] == 1
    assert np.mean(distance[tracking] <= training.radius_squared["tracking"]) == pytest.approx(0.95, abs=0.01)
    # Fewer than 100 cycles in doubt: a radius from all cycles, and not below that of a Gaussian.
    assert np.sum(cycles.mode[rows] == 2) < 100
    assert training.radius_squared["doubt"] == max(float(np.quantile(distance, 0.95)), -2.0 * math.log(0.05))


def test_same_seed_gives_same_bits(cycles: FieldCycles) -> None:
    short = replace(SETTINGS, epochs=3)
    first, again = (train_layers(cycles, cycles.split(), short, seed=5) for _ in range(2))
    other = train_layers(cycles, cycles.split(), short, seed=6)
    assert all(
        np.array_equal(a, b) for a, b in zip(vars(first.layers).values(), vars(again.layers).values(), strict=True)
    )
    assert not np.array_equal(first.layers.W_1, other.layers.W_1)


def test_faults_are_told_together(cycles: FieldCycles) -> None:
    broken = replace(cycles, features=np.where(np.arange(len(cycles))[:, None] == 7, np.nan, cycles.features))
    with pytest.raises(StudyError) as caught:
        train_layers(broken, cycles.split(), FieldTrainingSettings(hidden=0, rate=math.nan), seed=-1)
    assert [fault.field for fault in caught.value.faults] == ["features", "hidden", "rate", "seed"]
