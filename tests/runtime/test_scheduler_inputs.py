"""What a scheduler makes of inputs and states that cannot be meant: it refuses them and changes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.artifacts.networks import random_weights
from tests.examples import examples
from tests.gain_tables import table
from tests.runtime.schedulers import POWERS, grid, made, settle
from vsgdesign.equations.scheduler_data import FRESH, HELD, IMPLAUSIBLE, NOT_FINITE, RANGE, REFUSED, TIME
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime import (
    neural_estimator,
    scheduler_of,
)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((*grid(3.0, 1.0), np.nan, 0.0, 112.0), NOT_FINITE),
        ((*grid(3.0, 1.0), 1e3, -np.inf, 112.0), NOT_FINITE),
        ((*grid(3.0, 1.0), 1e3, 0.0, np.nan), NOT_FINITE),
        ((np.nan, 4e-3, 1e3, 0.0, 112.0), NOT_FINITE),
        ((1.0, np.inf, 1e3, 0.0, 112.0), NOT_FINITE),
        ((*grid(3.0, 1.0), 5.1e4, 0.0, 112.0), RANGE),
        ((*grid(3.0, 1.0), 1e3, 0.0, -1.0), RANGE),
        ((*grid(3.0, 1.0), 1e3, 0.0, 331.0), RANGE),
    ],
)
def test_unusable_inputs_are_refused_and_change_nothing(
    arguments: tuple[float, float, float, float, float], reason: int
) -> None:
    scheduler = made()
    before = settle(scheduler, 3.0, 1.0)
    answer = scheduler.update_estimate(*arguments)
    assert answer == before._replace(status=HELD | REFUSED, reason=reason)


def test_time_backwards_is_refused_once_and_ages() -> None:
    scheduler = made()
    settle(scheduler, 3.0, 1.0)
    assert scheduler.update_estimate(*grid(3.0, 1.0), *POWERS, ticks=2**31 - 5).status == FRESH
    answer = scheduler.update_estimate(*grid(3.0, 1.0), *POWERS, ticks=7)
    assert (answer.status, answer.reason) == (HELD | REFUSED, TIME)
    assert scheduler.state()["age"] == 20_000
    assert scheduler.update_estimate(*grid(3.0, 1.0), *POWERS, ticks=20_007).status == FRESH
    # The counter's own overflow is no step backwards.
    scheduler.update_estimate(*grid(3.0, 1.0), *POWERS, ticks=2**31 - 1)
    for ticks in (2**32 - 10, 10, 20_010):
        assert scheduler.update_estimate(*grid(3.0, 1.0), *POWERS, ticks=ticks).status == FRESH


@pytest.mark.parametrize(("R", "L"), [(-5.0, 4e-3), (50.0, 4e-3), (1.0, -1e-3), (1.0, 0.0), (1.0, 1.0)])
def test_implausible_estimates_are_held(R: float, L: float) -> None:
    scheduler = made()
    before = settle(scheduler, 3.0, 1.0)
    assert scheduler.update_estimate(R, L, *POWERS) == before._replace(status=HELD, reason=IMPLAUSIBLE)


NUMBERS = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-1e4, 1e4), st.floats(0.0, 20.0))


@examples(40)
@given(st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.integers(0, 2**32 - 1)), max_size=25))
def test_whatever_comes_the_gains_are_those_of_the_box(calls: list[Any]) -> None:
    scheduler = made()
    c, before = scheduler.settings, scheduler.hold(*POWERS, ticks=0)
    for k, (R, L, P, Q, V, ticks) in enumerate(calls):
        # Now and then good ones, so that it moves.
        if k % 3:
            answer = scheduler.update_estimate(R, L, P, Q, V, ticks)
        else:
            answer = scheduler.update_estimate(*grid(1.0 + abs(k), 1.0), *POWERS, ticks)
        assert c.scr[0] <= answer.scr <= c.scr[1]
        assert c.r_over_x[0] <= answer.r_over_x <= c.r_over_x[1]
        assert abs(np.log(answer.scr / before.scr)) <= 10.0 * 0.04 + 1e-12
        assert abs(np.log(answer.r_over_x / before.r_over_x)) <= 10.0 * 0.04 + 1e-12
        assert np.isfinite(answer.gains).all()
        assert (answer.status & (FRESH | HELD)) in (FRESH, HELD)
        assert (answer.status & FRESH != 0) == (answer.reason == 0)
        before = answer


def test_states_of_something_else_are_refused() -> None:
    scheduler = made()
    good = scheduler.state()
    for change, named in (
        ({"schema": 1}, "schema 1"),
        ({"made_for": "x"}, "another table"),
        ({"age": -1}, "state.age"),
        ({"gains": [1.0]}, "eight numbers"),
        ({"scr": None}, "state.scr"),
        ({"scr": 50.0}, "outside the schedule's box"),
        ({"estimator": {}}, "state.estimator"),
    ):
        with pytest.raises(ArtifactError, match=named):
            scheduler.restore(good | change)
    with pytest.raises(ArtifactError, match="schema"):
        scheduler.restore([])  # type: ignore[arg-type]
    scheduler.restore(good)


@pytest.mark.parametrize("wrong", [True, np.True_, "0.36", None, [1.0], float("nan"), 1j])
@pytest.mark.parametrize("at", range(5))
def test_what_is_no_number_is_refused_and_changes_nothing(wrong: Any, at: int) -> None:
    """True is no 1 and a text no number, whatever Python makes of them."""
    scheduler = made()
    before = settle(scheduler, 8.0, 3.0)
    arguments: list[Any] = [*grid(8.0, 3.0), *POWERS]
    arguments[at] = wrong
    answer = scheduler.update_estimate(*arguments)
    assert (answer.status, answer.reason) == (HELD | REFUSED, NOT_FINITE)
    assert answer.gains == before.gains
    if at >= 2:
        assert scheduler.hold(*arguments[2:]).status & REFUSED


@pytest.mark.parametrize("huge", [10**400, -(10**400), 1e308, float("inf")])
def test_numbers_beyond_all_range_are_refused(huge: Any) -> None:
    scheduler = made()
    before = settle(scheduler, 8.0, 3.0)
    answer = scheduler.update_estimate(*grid(8.0, 3.0), huge, *POWERS[1:])
    assert answer.status == HELD | REFUSED
    assert answer.reason in (NOT_FINITE, RANGE)
    assert scheduler.update_estimate(huge, 4e-3, *POWERS).status & HELD
    assert answer.gains == before.gains


def test_every_kind_of_number_is_one() -> None:
    expected = settle(made(), 8.0, 3.0)
    kinds: tuple[Any, ...] = (np.float64, np.float32, np.array, int)
    for kind in kinds:
        scheduler = made()
        settle(scheduler, 8.0, 3.0, 39)
        answer = scheduler.update_estimate(*grid(8.0, 3.0), kind(3000), kind(500), kind(112))
        assert answer == expected


@pytest.mark.parametrize("ticks", [True, "5", 1.5, None.__class__, np.float64(3.0)])
def test_ticks_are_whole(ticks: Any) -> None:
    with pytest.raises(ValueError, match=r"ticks = .*must be a whole number"):
        made().hold(*POWERS, ticks=ticks)
    assert made().hold(*POWERS, ticks=np.uint32(7)) == made().hold(*POWERS, ticks=7)


def test_samples_that_are_no_numbers_are_refused() -> None:
    weights = random_weights()
    window = weights.window
    estimator = neural_estimator(weights, sample_interval=window.sample_interval, channels=window.channels)
    scheduler = scheduler_of(table(), estimator)
    good = np.ones(window.length // 2)
    for bad in (good > 0.0, good.astype(str), np.array([10**400] * len(good), dtype=object)):
        assert scheduler.update(bad, good, *POWERS).reason == NOT_FINITE
        assert scheduler.update(good, bad, *POWERS).reason == NOT_FINITE
