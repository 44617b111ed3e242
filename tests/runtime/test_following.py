"""An estimate with a covariance: when it is followed fully, by how much otherwise, and what it may never do."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.gain_tables import table
from tests.runtime.schedulers import OMEGA, POWERS, Z_BASE, grid, made, settle
from vsgdesign.equations.scheduler_data import DOUBT, FRESH, HELD, IMPLAUSIBLE, JUMP, NOT_FINITE, PARTLY, REFUSED
from vsgdesign.errors import ArtifactError
from vsgdesign.identification import Estimate, Needs
from vsgdesign.runtime import Answer, Scheduler, scheduler_of, settings_of, status_text
from vsgdesign.runtime.error_set import NOT_DESIGNED, ErrorSet, error_set_of

TABLE = table()


def round_covariance(scr: float, sigma: float) -> tuple[float, float, float]:
    """Of an error that is alike in R and X: √(var R + var X)/|Z| = sigma."""
    var = 0.5 * (sigma * Z_BASE / scr) ** 2
    return var, 0.0, var / OMEGA**2


def following(scheduler: Scheduler, scr: float, x_over_r: float, sigma: float, **more: Any) -> Answer:
    return scheduler.update_estimate(*grid(scr, x_over_r), *POWERS, covariance=round_covariance(scr, sigma), **more)


def goal(scheduler: Scheduler) -> np.ndarray:
    """ln SCR and ln R/X of the goal."""
    state = scheduler.state()
    return np.log([state["goal_scr"], state["goal_r_over_x"]])


def reach_of(covariance: np.ndarray) -> np.ndarray:
    """How far the 95 % ellipse goes in each coordinate: from points on it, not from a formula. −2 ln 0.05 is the
    quantile of χ²."""
    angle = np.linspace(0.0, 2.0 * np.pi, 100_001)
    circle = np.array([np.cos(angle), np.sin(angle)])
    return np.abs(np.linalg.cholesky(covariance) @ circle * np.sqrt(-2.0 * np.log(0.05))).max(axis=1)


@pytest.mark.parametrize("seed", range(20))
def test_the_share_is_that_of_the_ellipse_in_the_box(seed: int) -> None:
    """A step of 30 % in SCR and X/R at a random covariance, against points on the ellipse."""
    rng = np.random.default_rng(seed)
    error_R, error_X = rng.uniform(0.05, 0.3, 2).tolist()
    errors = ErrorSet(error_R, error_X, float(rng.choice([0.0, 0.03, 0.1])))
    scheduler = made(**errors._asdict())
    settle(scheduler, 6.0, 1.5)
    R, L = grid(6.0 * 1.3, 1.5 / 1.3)
    X, Z = OMEGA * L, np.hypot(R, OMEGA * L)
    half = np.array([max(errors.error_R * R, errors.error_Z * Z), max(errors.error_X * X, errors.error_Z * Z)])
    sizes, rho = 0.1 * Z * np.exp(rng.normal(size=2)), rng.uniform(-0.95, 0.95)
    covariance = np.outer(sizes, sizes) * [[1.0, rho], [rho, 1.0]]
    share = min(1.0, (half / reach_of(covariance)).min())
    before = goal(scheduler)
    answer = scheduler.update_estimate(
        R, L, *POWERS, covariance=(covariance[0, 0], covariance[0, 1] / OMEGA, covariance[1, 1] / OMEGA**2)
    )
    assert bool(answer.status & PARTLY) == (share < 1.0)
    np.testing.assert_allclose(goal(scheduler) - before, share * np.log([1.3, 1.3]), rtol=1e-6)


def test_the_needed_sigma_is_where_following_in_part_begins() -> None:
    for x_over_r in (0.3, 1.0, 3.0, 10.0):
        scheduler = made()
        needed = scheduler.settings.error_set.needed_sigma(1.0, x_over_r)
        for factor, partly in ((0.999, 0), (1.001, PARTLY)):
            settle(scheduler, 6.0, x_over_r)
            assert following(scheduler, 6.0, x_over_r, factor * needed).status & PARTLY == partly


def test_precise_estimates_are_followed_as_without_covariance() -> None:
    a, b, rng = made(), made(), np.random.default_rng(1)
    for _ in range(300):
        scr, x_over_r = rng.choice([2.0, 2.05, 7.0, 18.0]), rng.choice([0.7, 3.0])
        precise = following(b, scr, x_over_r, 0.01)
        assert a.update_estimate(*grid(scr, x_over_r), *POWERS) == precise
    assert goal(a).tolist() == goal(b).tolist()


def test_a_change_confirms_a_jump_at_once() -> None:
    for sigma in (None, 0.01):
        scheduler = made()
        settle(scheduler, 2.0, 1.0)
        covariance = None if sigma is None else round_covariance(18.0, sigma)
        answer = scheduler.update_estimate(*grid(18.0, 1.0), *POWERS, covariance=covariance, changed=True)
        assert answer.status & FRESH
        assert goal(scheduler) == pytest.approx(np.log([18.0, 1.0]))
    scheduler = made()
    settle(scheduler, 2.0, 1.0)
    assert scheduler.update_estimate(*grid(18.0, 1.0), *POWERS).reason == JUMP


def test_a_change_that_comes_before_its_estimate_is_remembered() -> None:
    """It begins a doubt, confirms the first estimate, and only that one."""
    scheduler, again = made(), made()
    settle(scheduler, 2.0, 1.0)
    scheduler.tell(changed=True)
    for _ in range(5):
        assert scheduler.hold(*POWERS).status == HELD | DOUBT
    again.restore(json.loads(json.dumps(scheduler.state())))
    for one in (scheduler, again):
        assert following(one, 18.0, 1.0, 0.01).status & FRESH
        assert following(one, 2.0, 1.0, 0.01).reason == JUMP
    assert again.state() == scheduler.state()


def test_a_wide_estimate_of_a_new_grid_is_approached_without_new_confirmations() -> None:
    scheduler = made()
    settle(scheduler, 2.0, 1.0)
    reasons = [following(scheduler, 18.0, 1.0, 0.25).reason for _ in range(10)]
    assert reasons == [JUMP, JUMP] + [0] * 8  # three windows that agree, as without covariance
    scheduler.hold(*POWERS)  # a window without an estimate does not take the confirmation away
    assert following(scheduler, 18.0, 1.0, 0.25).reason == 0
    assert following(scheduler, 1.6, 1.0, 0.25).reason == JUMP  # another grid is another jump


def test_a_wide_estimate_still_arrives() -> None:
    scheduler = made()
    settle(scheduler, 2.0, 1.0)
    following(scheduler, 18.0, 1.0, 0.3, changed=True)
    distance = [abs(goal(scheduler) - np.log([18.0, 1.0])).max()]
    for _ in range(60):
        answer = following(scheduler, 18.0, 1.0, 0.3)
        assert answer.status & (FRESH | PARTLY) == FRESH | PARTLY
        distance.append(abs(goal(scheduler) - np.log([18.0, 1.0])).max())
    assert np.all(np.diff(distance) <= 0.0)
    assert distance[-1] < np.log(1.02)  # within the hysteresis


STEPS = st.lists(
    st.tuples(st.floats(0.5, 2.95), st.floats(-2.2, 1.1), st.sampled_from([0.1, 0.2, 0.29])), min_size=1, max_size=28
)


@examples(30)
@given(STEPS)
def test_after_a_change_no_wide_estimate_brings_the_goal_back(steps: list[Any]) -> None:
    """In (ln SCR, ln R/X), the distance to the place that was left never shrinks while no estimate fits, for 0.6 s."""
    scheduler = made(jump=999.0)  # the confirmation is not what is tested here
    settle(scheduler, 5.0, 1.0)
    left, before = goal(scheduler), 0.0
    scheduler.tell(changed=True)
    for ln_scr, ln_r, sigma in steps:
        answer = following(scheduler, float(np.exp(ln_scr)), float(np.exp(-ln_r)), sigma)
        assert answer.status & PARTLY
        distance = float(np.hypot(*(goal(scheduler) - left)))
        assert distance >= before - 1e-9
        before = distance


CALLS = st.lists(
    st.tuples(
        st.sampled_from(["hold", "wide", "precise", "plain", "nonsense"]),
        st.floats(0.3, 3.2),
        st.floats(-2.4, 1.3),
        st.integers(0, 7),
        st.sampled_from([20_000, 20_000, 20_000, 0, 400_000, 11_000_000, -5]),
    ),
    max_size=40,
)


@examples(30)
@given(CALLS, st.floats(0.5, 2.9), st.floats(-1.1, 2.2))
def test_whatever_came_before_an_estimate_that_stays_is_reached(calls: list[Any], ln_scr: float, ln_x: float) -> None:
    """No sequence of estimates, silence, changes and refusals locks the schedule: a lasting estimate, three times as
    uncertain as the design allows, has its place after 1.6 s."""
    scheduler, ticks = made(), 0
    for kind, ln_other, ln_r, told, step in calls:
        ticks += step
        scheduler.tell(limited=bool(told & 1), surprised=bool(told & 2), changed=bool(told & 4))
        scr, x_over_r = float(np.exp(ln_other)), float(np.exp(-ln_r))
        if kind == "hold":
            scheduler.hold(*POWERS, ticks=ticks)
        elif kind == "nonsense":
            scheduler.update_estimate(np.nan, -1.0, *POWERS, ticks, (1.0, 2.0, -3.0), True)
        elif kind == "plain":
            scheduler.update_estimate(*grid(scr, x_over_r), *POWERS, ticks)
        else:
            following(scheduler, scr, x_over_r, 0.25 if kind == "wide" else 0.005, ticks=ticks)
    scr, x_over_r = float(np.exp(ln_scr)), float(np.exp(ln_x))
    sigma = 3.0 * scheduler.settings.error_set.needed_sigma(1.0, x_over_r)
    answers = [following(scheduler, scr, x_over_r, sigma, ticks=ticks + 20_000 * k) for k in range(1, 81)]
    answer = answers[-1]
    assert answer.status & ~PARTLY == FRESH
    assert answer.scr == pytest.approx(scr, rel=0.021)
    assert answer.r_over_x == pytest.approx(1.0 / x_over_r, rel=0.021)


def test_what_was_left_is_forgotten_with_an_estimate_that_fits_or_after_the_doubts_time() -> None:
    def away() -> Scheduler:
        scheduler = made(jump=999.0)
        settle(scheduler, 5.0, 1.0)
        scheduler.update_estimate(*grid(12.0, 1.0), *POWERS, covariance=round_covariance(12.0, 0.2), changed=True)
        return scheduler

    scheduler = away()
    there = goal(scheduler)[0]
    for _ in range(28):
        following(scheduler, 5.0, 1.0, 0.2)
        assert goal(scheduler)[0] >= there - 1e-12
    following(scheduler, 5.0, 1.0, 0.2)
    following(scheduler, 5.0, 1.0, 0.2)
    assert goal(scheduler)[0] < there - 0.01

    scheduler = away()
    following(scheduler, 12.0, 1.0, 0.01)
    there = goal(scheduler)[0]
    following(scheduler, 5.0, 1.0, 0.2)
    assert goal(scheduler)[0] < there - 0.01


def test_there_and_back_is_no_way_back_to_what_was_refuted() -> None:
    """The second change leaves the place of the first: the goal may return, however wide the estimates are."""
    scheduler = made()
    settle(scheduler, 3.0, 1.0)
    following(scheduler, 12.0, 1.0, 0.2, changed=True)
    following(scheduler, 3.0, 1.0, 0.2, changed=True)
    for _ in range(40):
        following(scheduler, 3.0, 1.0, 0.2)
    assert goal(scheduler)[0] == pytest.approx(np.log(3.0), abs=0.021)


def test_beyond_the_box_the_way_ends_at_its_edge() -> None:
    scheduler = made()
    settle(scheduler, 10.0, 1.0)
    R, L = grid(10.0, 1.0)
    for _ in range(300):
        scheduler.update_estimate(-0.02 * R, L, *POWERS, covariance=round_covariance(10.0, 0.2))
    c = scheduler.settings
    assert goal(scheduler)[1] == pytest.approx(np.log(c.r_over_x[0]), abs=0.03)
    assert status_text(scheduler.hold(*POWERS).status) == "held"


@pytest.mark.parametrize(
    ("covariance", "status", "reason"),
    [
        ((np.nan, 0.0, 1e-8), HELD | REFUSED, NOT_FINITE),
        ((0.01, np.inf, 1e-8), HELD | REFUSED, NOT_FINITE),
        ((0.01, 0.0, True), HELD | REFUSED, NOT_FINITE),
        ((-0.01, 0.0, 1e-8), HELD, IMPLAUSIBLE),
        ((0.01, 0.0, -1e-8), HELD, IMPLAUSIBLE),
        ((0.01, 1.1e-5, 1e-8), HELD, IMPLAUSIBLE),  # a correlation of 1.1
    ],
)
def test_what_is_no_covariance_is_not_followed(covariance: Any, status: int, reason: int) -> None:
    scheduler = made()
    before = settle(scheduler, 3.0, 1.0)
    answer = scheduler.update_estimate(*grid(3.0, 1.0), *POWERS, covariance=covariance)
    assert answer == before._replace(status=status, reason=reason)


@pytest.mark.parametrize("covariance", [(1.0, 2.0), 3.0, "abcd", (1.0, 2.0, 3.0, 4.0)])
def test_three_values_or_a_sentence(covariance: Any) -> None:
    with pytest.raises(ValueError, match=r"covariance = .*: must be three values, var R_g in Ω²"):
        made().update_estimate(*grid(3.0, 1.0), *POWERS, covariance=covariance)


def test_an_exact_estimate_has_no_covariance_to_speak_of() -> None:
    scheduler = made()
    settle(scheduler, 3.0, 1.0)
    assert scheduler.update_estimate(*grid(3.1, 1.0), *POWERS, covariance=(0.0, 0.0, 0.0)).status & PARTLY == 0


def test_the_error_set_is_the_tables() -> None:
    box = {"error_R": 0.1, "error_X": 0.15, "error_Z": 0.04}
    asked = replace(TABLE, specification={"box": box})
    assert error_set_of(asked) == ErrorSet(0.1, 0.15, 0.04)
    assert settings_of(asked).error_X == float(np.float32(0.15))
    assert settings_of(asked, error_X=0.3).error_X == float(np.float32(0.3))
    before = replace(TABLE, specification={"box": {"error_R": 0.1, "error_X": 0.15}})  # a table without error_Z
    assert error_set_of(before) == ErrorSet(0.1, 0.15, 0.0)
    by_hand = replace(TABLE, specification={}, validity=replace(TABLE.validity, error=0.12))
    assert error_set_of(by_hand) == ErrorSet(0.12, 0.12, 0.0)
    exact = replace(TABLE, specification={}, validity=replace(TABLE.validity, error=0.0))
    assert error_set_of(exact) == ErrorSet(NOT_DESIGNED.error_R, NOT_DESIGNED.error_X, 0.0)
    assert scheduler_of(exact).settings.error_set.needed_sigma(1.0, 1.0) > 0.0


def test_errors_that_nothing_fits_are_refused() -> None:
    with pytest.raises(ArtifactError, match=r"error_R = 0, error_X = 0\.2, error_Z = 0: no estimate would ever fit"):
        settings_of(TABLE, error_R=0.0, error_X=0.2, error_Z=0.0)
    with pytest.raises(ArtifactError, match=r"error_Z = -0\.1: must be a share"):
        settings_of(TABLE, error_Z=-0.1)


def test_states_of_before_are_refused_with_a_sentence() -> None:
    scheduler = made()
    old = scheduler.state() | {"schema": 3}
    for name in ("refuted", "left_scr", "left_r_over_x"):
        del old[name]
    with pytest.raises(ArtifactError, match="schema 3, but this version reads 4; start afresh"):
        scheduler.restore(old)


def test_a_schedule_waits_as_long_as_its_estimator_may_be_silent() -> None:
    speaker = Speaker((), calibrated=True)
    assert scheduler_of(TABLE, speaker).settings.stale_ticks == 1_000_000
    assert scheduler_of(TABLE, speaker, stale_ticks=800_000).settings.stale_ticks == 800_000
    assert scheduler_of(TABLE, replace(speaker, finds_within=0.1)).settings.stale_ticks == 600_000
    assert scheduler_of(TABLE).settings.stale_ticks == 600_000


class Said(NamedTuple):
    times: int


@dataclass(frozen=True)
class Speaker:
    """An estimator that says what it is told to, once a sample."""

    answers: tuple[Estimate, ...]
    calibrated: bool
    finds_within: float = 1.0
    title: str = "the speaker"
    signals: str = "other"
    needs: Needs = field(default_factory=lambda: Needs(samples=1, sample_interval=1e-4))

    def first(self) -> Said:
        return Said(0)

    def update(self, state: Said, samples: Any) -> tuple[Said, Estimate]:  # noqa: ARG002
        return Said(state.times + 1), self.answers[state.times]

    def probe(self, state: Said) -> None:  # noqa: ARG002
        return None


@pytest.mark.parametrize("calibrated", [True, False])
def test_an_estimators_own_words_reach_the_scheduler(calibrated: bool) -> None:
    """Surprise begins a doubt, a change confirms, and the covariance counts if it is calibrated."""
    (var_R, cov, var_L), there = round_covariance(18.0, 0.2), grid(18.0, 1.0)
    covariance = np.array([[var_R, cov], [cov, var_L]])
    answers = (
        Estimate(*grid(2.0, 1.0), "uncertain", covariance, surprised=True),
        Estimate(*there, "uncertain", covariance, changed=True),
        Estimate(*there, "ok", covariance),
    )
    scheduler = Scheduler(made().lookup, made().settings, Speaker(answers, calibrated))
    settle(scheduler, 2.0, 1.0)
    found = []
    for _ in answers:
        assert scheduler.push([1.0, 0.0], [0.0, 0.0])
        found.append(scheduler.update_pushed(*POWERS))
    assert [answer.status for answer in found[:2]] == [HELD | DOUBT] * 2
    assert found[2].status & (FRESH | PARTLY) == (FRESH | PARTLY if calibrated else FRESH)
    assert (goal(scheduler)[0] == pytest.approx(np.log(18.0))) == (not calibrated)
