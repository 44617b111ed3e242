"""Training: the goal, metrics, seeds, an interruption, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimator.phasor_data import phasor_data
from vsgdesign.errors import StudyError
from vsgdesign.estimator.levenberg_marquardt import Damping
from vsgdesign.estimator.training import Training, TrainingSettings, train_network

INPUTS, TARGETS, SPLIT = phasor_data(600, 0, samples=20, noise=1e-4)
SHORT = TrainingSettings(hidden=4, starts=2, damping=Damping(goal=1e-9, epochs=12))
"""Two starts that do not reach their goal."""


def same(one: Training, other: Training) -> bool:
    arrays = ("W_1", "b_1", "W_2", "b_2")
    equal = all(np.array_equal(getattr(one.network, name), getattr(other.network, name)) for name in arrays)
    counted = one.epochs == other.epochs
    return equal and counted and repr(one.history) == repr(other.history) and one.metrics == other.metrics


@pytest.mark.parametrize("form", ["components", "full"])
def test_the_goal_is_reached_and_the_metrics_are_those_of_the_network(form: str) -> None:
    training = train_network(INPUTS, TARGETS, SPLIT, TrainingSettings(form=form), seed=1)
    assert training.stop == "goal"
    assert training.network.W_1.shape == (8, 40)
    assert training.components == 40 if form == "full" else training.components < 12
    for part, rows in vars(SPLIT).items():
        metrics, estimated = training.metrics[part], training.network.evaluate(INPUTS[rows])
        assert metrics.windows == len(rows)
        for k in (0, 1):
            expected = np.corrcoef(estimated[:, k], TARGETS[rows, k])[0, 1]
            assert metrics.correlation[k] == pytest.approx(expected, rel=1e-12)
            assert metrics.correlation[k] > 0.9999
            assert metrics.rms_error[k] == pytest.approx(np.sqrt(np.mean((estimated - TARGETS[rows])[:, k] ** 2)))
    # mse is of targets scaled to [−1, 1] by the training part, and is what the search had as its cost.
    low, high = TARGETS[SPLIT.training].min(axis=0), TARGETS[SPLIT.training].max(axis=0)
    error = training.network.evaluate(INPUTS[SPLIT.training]) - TARGETS[SPLIT.training]
    mse = np.mean((2.0 * error / (high - low)) ** 2)
    assert training.metrics["training"].mse == pytest.approx(mse, rel=1e-9)
    best = training.history[training.best_epoch]
    assert best.cost == pytest.approx(mse, rel=1e-6)
    assert training.metrics["validation"].mse == pytest.approx(best.validation, rel=1e-6)
    assert training.metrics["test"].mse == pytest.approx(best.test, rel=1e-6)


def test_a_seed_means_one_network() -> None:
    one, again, other = (train_network(INPUTS, TARGETS, SPLIT, SHORT, seed) for seed in (3, 3, 4))
    assert same(one, again)
    assert not same(one, other)


def test_nothing_is_learned_from_what_is_not_for_training() -> None:
    """Scaling and projection included: other test windows, same network."""
    changed = INPUTS.copy()
    changed[SPLIT.test] *= 3.0
    one, other = (train_network(x, TARGETS, SPLIT, SHORT) for x in (INPUTS, changed))
    assert np.array_equal(one.network.W_1, other.network.W_1)
    assert one.metrics["test"] != other.metrics["test"]


def test_a_second_start_is_only_taken_where_it_is_better() -> None:
    one = train_network(INPUTS, TARGETS, SPLIT, replace(SHORT, starts=1), seed=2)
    three = train_network(INPUTS, TARGETS, SPLIT, replace(SHORT, starts=3), seed=2)
    assert three.metrics["validation"].mse <= one.metrics["validation"].mse


def test_the_epochs_of_all_starts_are_counted() -> None:
    """Both starts of SHORT use up their 12 epochs. The history is that of one start: its first point and 12 more."""
    training = train_network(INPUTS, TARGETS, SPLIT, SHORT)
    assert training.stop == "epochs"
    assert len(training.history) == 13
    assert training.epochs == 24


def test_regularisation_keeps_the_weights_small() -> None:
    free = train_network(INPUTS, TARGETS, SPLIT, SHORT)
    held = train_network(INPUTS, TARGETS, SPLIT, replace(SHORT, regularisation=0.1))
    assert np.sum(held.network.W_2**2) < np.sum(free.network.W_2**2)
    assert held.metrics["training"].mse > free.metrics["training"].mse


def test_an_interruption_ends_it() -> None:
    def stopped(_what: str, _share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_network(INPUTS, TARGETS, SPLIT, SHORT, progress=stopped)


def test_all_faults_at_once() -> None:
    bad = INPUTS.copy()
    bad[7, 3] = np.nan
    split = replace(SPLIT, test=SPLIT.training[:3])
    settings = TrainingSettings(form="both", regularisation=1.0, starts=0, damping=Damping(mu=0.0, checks=0))
    with pytest.raises(StudyError) as caught:
        train_network(bad, TARGETS, split, settings, seed=-1)
    named = [fault.field for fault in caught.value.faults]
    assert named == ["inputs", "split", "form", "starts", "regularisation", "damping", "damping", "seed"]
    assert "row 7" in str(caught.value)


def test_targets_of_another_shape_are_refused() -> None:
    with pytest.raises(StudyError, match="targets"):
        train_network(INPUTS, TARGETS[:-1], SPLIT)
