"""What every estimator has in common: its name, its needs, its state, and what it says of samples that are no good."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.artifacts.networks import random_weights
from tests.identification.signals import AT, H, N, V, W, answers, error, power_step, windows_of, z
from vsgdesign.errors import ArtifactError, StudyError
from vsgdesign.identification import ESTIMATORS, SIGNAL_SETS, STATUSES, Estimator, Samples, build_estimator
from vsgdesign.identification.interface import CHANNELS, FOLLOWED
from vsgdesign.identification.recursive import RecursiveLeastSquares

TRAINED = replace(AT, weights=random_weights())
NAMES = tuple(name for name, kind in ESTIMATORS.items() if not kind.by_sample)
LOOKING = tuple(name for name in NAMES if name != "constant")


def made(name: str) -> Estimator:
    return build_estimator(name, replace(TRAINED, v_limit=2.0 * V, i_limit=100.0))


def some(estimator: Estimator) -> list[Samples]:
    windows = power_step()
    if estimator.needs.channels == "phase_a":
        windows = [one._replace(v=one.v[0], i=one.i[0]) for one in windows]
    return windows


def test_an_unknown_name_is_one_error_with_the_known_names() -> None:
    with pytest.raises(StudyError, match=r"estimate = kalmann: unknown\. Known: .*rls, kalman, .*neural"):
        build_estimator("kalmann", AT)


def test_a_network_needs_its_weights() -> None:
    with pytest.raises(ArtifactError, match="trained weights"):
        build_estimator("neural", AT)


@pytest.mark.parametrize("name", NAMES)
def test_what_an_estimator_says_of_itself(name: str) -> None:
    estimator = made(name)
    needs = estimator.needs
    assert estimator.title
    assert estimator.signals in SIGNAL_SETS
    assert (needs.samples, needs.sample_interval) == (N, H)
    assert needs.channels in CHANNELS
    assert (estimator.probe(estimator.first()) is None) is (needs.probe_hold is None)
    assert set(FOLLOWED) <= set(STATUSES)


@pytest.mark.parametrize("name", NAMES)
def test_the_state_alone_is_what_it_remembers(name: str) -> None:
    """Two runs from one state say the same, and one that was interrupted in between goes on."""
    estimator = made(name)
    windows = some(estimator)
    once, again = answers(estimator, windows), answers(estimator, windows)
    for one, other in zip(once, again, strict=True):
        np.testing.assert_array_equal(one[:2], other[:2])
        assert one.status == other.status
    state: Any = estimator.first()
    assert state._fields == estimator.update(state, windows[0])[0]._fields
    assert isinstance(state, tuple)


@pytest.mark.parametrize("name", LOOKING)
@pytest.mark.parametrize(
    ("spoil", "status"),
    [
        (lambda one: one._replace(v=np.full_like(one.v, np.nan)), "not finite"),
        (lambda one: one._replace(i=np.full_like(one.i, np.inf)), "not finite"),
        (lambda one: one._replace(v=3.0 * one.v), "saturated"),
        (lambda one: one._replace(limited=1), "limited"),
    ],
)
def test_samples_that_are_no_good_give_no_estimate_and_a_reason(name: str, spoil, status: str) -> None:
    """And the ones that follow are as good as ever: the frame has gone on turning in between."""
    estimator = made(name)
    windows = some(estimator)
    windows[10] = spoil(windows[10])
    found = answers(estimator, windows)
    assert found[10].status == status
    assert found[10].why
    assert np.isnan(found[10].R_g)
    assert np.isnan(found[10].L_g)
    assert np.isfinite(found[-1].R_g) or name in ("injection", "prbs")


def test_a_gap_does_not_turn_the_frame() -> None:
    """A window is lost before the step: recursive least squares find the grid all the same."""
    windows = power_step()
    windows[5] = windows[5]._replace(limited=3)
    assert error(answers(RecursiveLeastSquares(AT), windows)[-1]) < 0.03


def test_no_frequency_is_no_measurement() -> None:
    windows = [one._replace(omega=float("nan")) for one in power_step()]
    assert {one.status for one in answers(RecursiveLeastSquares(AT), windows)} == {"not finite"}


def test_the_frequency_is_averaged() -> None:
    """The converter's own frequency swings by 0.2 rad/s, as it does while power settles: the frame follows slowly."""
    i = np.full(W * N, 12.0 + 1.0j)
    swinging = windows_of(i, V + z(100.0 * np.pi) * i)
    swinging = [one._replace(omega=one.omega + 0.2 * (-1) ** k) for k, one in enumerate(swinging)]
    state, estimator = RecursiveLeastSquares(AT).first(), RecursiveLeastSquares(AT)
    for one in swinging:
        state, _ = estimator.update(state, one)
    # A first-order average of 1 s begins at the first value, 0.2 above, and forgets it as e^(−t/1 s) in 0.8 s.
    assert state.blocks.omega - 100.0 * np.pi == pytest.approx(0.2 * np.exp(-0.8), rel=0.05)
