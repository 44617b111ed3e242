"""The judge of survival on signals whose verdict and figures are known without it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vsgdesign.metrics.survival import (
    DIVERGED,
    LATCHED,
    NO_REST,
    NOT_AT_REST,
    NOT_KNOWN,
    OVER_LIMIT,
    SLIPPED,
    STATUSES,
    SURVIVED,
    VERDICTS,
    ExpectedRest,
    Survival,
    SurvivalDemand,
    SurvivalRecord,
    judge_survival,
)

S, T, EVENT, CLEARED, CYCLE = 5e3, 1.0, 0.5, 0.7, 0.02
STEP = 1e-4
TIMES = np.arange(0.0, CLEARED + 2.6, STEP)
REST = ExpectedRest(P=2e3, Q=500.0, delta=0.3, i_s_pu=0.5)
DEMAND = SurvivalDemand(S_rated=S, settling_time=T, cycle_s=CYCLE, i_max_pu=1.2)
DECAY = 4.0


def decaying(size: float = 1e3, decay: float = DECAY, t: Any = TIMES) -> Any:
    """A deviation that begins at the event and decays after the clearing."""
    return np.where(t < EVENT, 0.0, size * np.exp(-decay * np.maximum(t - CLEARED, 0.0)))


def record(t: Any = TIMES, **changed: Any) -> SurvivalRecord:
    quiet = {
        "P": REST.P + decaying(t=t),
        "Q": np.full_like(t, REST.Q),
        "delta": np.full_like(t, REST.delta),
        "i_s_pu": np.full_like(t, 0.5),
        "limited": np.zeros_like(t),
    }
    return SurvivalRecord(t_s=t, **{**quiet, **changed})


def verdict(given: SurvivalRecord, events: Any = (EVENT, CLEARED), **changed: Any) -> Survival:
    return judge_survival(given, events, CLEARED, changed.get("rest", REST), changed.get("demand", DEMAND))


def mean_of_cycle(size: float, since: float) -> float:
    """Mean over the last cycle of size·exp(−DECAY·t): the integral in closed form."""
    return size * math.exp(-DECAY * since) * math.expm1(DECAY * CYCLE) / (DECAY * CYCLE)


def test_recovery_is_when_the_mean_of_the_exponential_enters_the_band() -> None:
    found = verdict(record())
    expected = math.log(mean_of_cycle(1e3, 0.0) / (0.02 * S)) / DECAY
    assert found.status == SURVIVED
    assert found.survived
    assert found.reason is None
    assert found.recovery_s == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("signal", ["P", "Q"])
def test_either_power_may_be_the_late_one(signal: str) -> None:
    rest = {"P": REST.P, "Q": REST.Q}[signal]
    found = verdict(record(**{signal: rest + decaying(4e3, decay=2.0)}))
    assert found.recovery_s is not None
    assert found.recovery_s > math.log(4e3 / (0.02 * S)) / 2.0 > verdict(record()).recovery_s  # type: ignore[operator]


@pytest.mark.parametrize(("settles_at", "status"), [(2.19, SURVIVED), (2.21, NOT_AT_REST)])
def test_the_deadline_is_two_settling_times_and_a_fifth_of_a_second(settles_at: float, status: str) -> None:
    """A step back into the band enters it, in the mean of a cycle, at most a cycle later."""
    late = np.where(settles_at - CYCLE > TIMES - CLEARED, 0.2 * S, 0.0)
    found = verdict(record(P=REST.P + np.where(TIMES < EVENT, 0.0, late)))
    assert found.recovery_s == pytest.approx(settles_at - 0.1 * CYCLE, abs=2e-3)
    assert found.status == status


def test_a_later_deadline_can_be_asked_for() -> None:
    t = np.arange(0.0, CLEARED + 3.5, STEP)
    late = record(t, P=REST.P + np.where(t < CLEARED + 2.5, 0.2 * S, 0.0))
    assert verdict(late).status == NOT_AT_REST
    assert verdict(late, demand=replace(DEMAND, settling_times=3.0)).status == SURVIVED


def test_what_leaves_the_band_again_is_not_at_rest() -> None:
    back = REST.P + np.where(TIMES > CLEARED + 2.4, 0.03 * S, 0.0)
    found = verdict(record(P=back))
    assert (found.status, found.recovery_s) == (NOT_AT_REST, None)
    assert "at the end" not in str(found.reason)


def outside_for(share: float) -> SurvivalRecord:
    """P is 4 % of S off its rest for a share of the time from the deadline on, in four pulses."""
    since, deadline = TIMES - CLEARED, DEMAND.deadline_s
    period = (TIMES[-1] - CLEARED - deadline) / 4.0
    pulses = (since > deadline) & ((since - deadline) % period < share * period)
    return record(P=REST.P + 0.04 * S * pulses)


def test_a_share_of_the_time_outside_can_be_allowed() -> None:
    assert verdict(outside_for(0.03), demand=replace(DEMAND, cycle_s=STEP)).status == NOT_AT_REST
    some = replace(DEMAND, share_inside=0.95, cycle_s=STEP)
    assert verdict(outside_for(0.03), demand=some).status == SURVIVED
    assert verdict(outside_for(0.03), demand=some).recovery_s == pytest.approx(0.0, abs=STEP)
    assert verdict(outside_for(0.07), demand=some).status == NOT_AT_REST
    # What is late for all of the time is early for a share of it; what never comes is neither.
    before = verdict(record(), demand=replace(some, cycle_s=CYCLE))
    assert before.recovery_s == pytest.approx(verdict(record()).recovery_s)
    slow = record(P=REST.P + decaying(decay=0.1))
    assert verdict(slow, demand=some).status == NOT_AT_REST


def test_the_band_can_be_wider() -> None:
    one, two = (verdict(record(), demand=replace(DEMAND, band=band)).recovery_s for band in (0.02, 0.05))
    assert one is not None
    assert two is not None
    assert one - two == pytest.approx(math.log(0.05 / 0.02) / DECAY, abs=2e-4)
    with pytest.raises(ValueError, match=r"share_inside = 0: .*band = -1: must be positive"):
        verdict(record(), demand=replace(DEMAND, band=-1.0, share_inside=0.0))


def test_ripple_at_the_grids_frequency_is_not_seen() -> None:
    assert verdict(record(P=REST.P + 0.5 * S * np.sin(2.0 * np.pi * TIMES / CYCLE))).recovery_s == 0.0


@pytest.mark.parametrize("turns", [-2, 0, 1])
def test_the_branch_of_the_angle_does_not_matter(turns: int) -> None:
    wrapped = np.full_like(TIMES, REST.delta + 2.0 * np.pi * turns)
    found = verdict(record(delta=wrapped))
    assert found.status == SURVIVED
    assert found.swing_rad == pytest.approx(0.0, abs=1e-12)


def test_the_swing_is_measured_from_the_rest() -> None:
    found = verdict(record(delta=REST.delta + decaying(1.2)))
    assert found.swing_rad == pytest.approx(1.2)
    assert found.status == SURVIVED


@pytest.mark.parametrize("turns", [1, -1, 9])
def test_coming_to_rest_a_turn_further_on_is_a_slip(turns: int) -> None:
    """Even where the angle never passes a whole turn: it approaches the next rest from below."""
    slipping = REST.delta + np.clip(TIMES - CLEARED, 0.0, 1.0) * 2.0 * np.pi * turns
    for delta in (slipping, np.angle(np.exp(1j * slipping))):
        found = verdict(record(delta=delta))
        assert found.status == SLIPPED
        assert found.swing_rad == pytest.approx(2.0 * np.pi * abs(turns), rel=1e-6)


def test_a_slip_within_a_fault_is_a_slip_even_if_it_comes_back() -> None:
    away = np.interp(TIMES, [EVENT, 0.6, CLEARED], [0.0, 7.0, 0.0])
    assert verdict(record(delta=REST.delta + away)).status == SLIPPED


@pytest.mark.parametrize("way", [0.0, -2.0 * np.pi])
def test_half_a_turn_may_be_gone_either_way_round(way: float) -> None:
    gone = np.exp(-3.0 * np.maximum(TIMES - EVENT, 0.0)) * (-np.pi - way) + way
    found = judge_survival(
        record(delta=REST.delta + np.where(TIMES < EVENT, 0.0, gone)), (EVENT,), CLEARED, REST, DEMAND
    )
    assert found.status == SURVIVED
    assert found.swing_rad == pytest.approx(np.pi, abs=1e-3)


@pytest.mark.parametrize(
    ("lead", "jump", "turns", "status"),
    [
        (0.0, 120.0, 1, SLIPPED),
        (0.0, 165.0, 1, SURVIVED),
        (0.0, -120.0, -1, SLIPPED),
        (35.0, 150.0, 1, SURVIVED),  # the unstable equilibrium is at 180° − 2·35° = 110° from the rest
        (35.0, 80.0, 1, SLIPPED),
        (35.0, -150.0, -1, SLIPPED),  # on the other side it is 250° away
        (-35.0, -150.0, -1, SURVIVED),
        (-35.0, 150.0, 1, SLIPPED),
        (35.0 + 360.0, 150.0, 1, SURVIVED),
    ],
)
def test_beyond_the_unstable_equilibrium_the_next_rest_is_its_own(
    lead: float, jump: float, turns: int, status: str
) -> None:
    rest = replace(REST, delta=math.radians(lead))
    start, end = math.radians(jump), 2.0 * np.pi * turns
    gone = end + (start - end) * np.exp(-5.0 * np.maximum(TIMES - EVENT, 0.0))
    moved = record(delta=rest.delta + np.where(TIMES < EVENT, 0.0, gone))
    assert judge_survival(moved, (EVENT,), CLEARED, rest, DEMAND).status == status


def test_a_jump_a_little_after_a_row_is_not_seen_in_this_row() -> None:
    """The jump of half a turn comes 5e-4 of a step after a row, whose angle is still that of the rest before."""
    event = EVENT + 5e-4 * STEP
    start, end = math.radians(177.0), 2.0 * np.pi
    gone = end + (start - end) * np.exp(-5.0 * np.maximum(TIMES - event, 0.0))
    moved = record(delta=REST.delta + np.where(event > TIMES, 0.0, gone))
    assert judge_survival(moved, (event,), CLEARED, REST, DEMAND).status == SURVIVED


def test_currents_within_and_after_five_milliseconds() -> None:
    current = np.full_like(TIMES, 0.5)
    for instant, height in ((0.4, 9.0), (0.5, 1.6), (0.5049, 1.5), (0.5051, 1.3), (0.7049, 1.7), (0.71, 1.2)):
        current[round(instant / STEP)] = height
    found = verdict(record(i_s_pu=current))
    assert found.first_peak_pu == 1.7  # and what was before the first event does not count
    assert found.peak_pu == 1.3


def test_time_in_the_limit() -> None:
    limited = np.where((TIMES > 0.55) & (TIMES <= 0.65), 0.5, 0.0)
    found = verdict(record(limited=limited))
    assert found.limited_s == pytest.approx(0.05, abs=STEP)
    assert found.limited_at_end == 0.0


@pytest.mark.parametrize(("share", "status"), [(1.0, LATCHED), (0.6, LATCHED), (0.4, NOT_AT_REST)])
def test_a_limiter_that_holds_it_away_from_the_rest_has_latched(share: float, status: str) -> None:
    away = REST.P + np.where(TIMES < EVENT, 0.0, 0.3 * S)
    found = verdict(record(P=away, limited=np.full_like(TIMES, share)))
    assert found.status == status
    assert found.limited_at_end == pytest.approx(share)


def test_a_limiter_that_acts_at_the_rest_has_not() -> None:
    assert verdict(record(limited=np.ones_like(TIMES))).status == SURVIVED


def test_a_short_record_is_not_known() -> None:
    found = verdict(record(TIMES[TIMES < CLEARED + 2.3]))
    assert found.status == NOT_KNOWN
    assert "2.45 s" in str(found.reason)
    assert not found.judged


def test_a_short_record_with_a_slip_is_a_slip() -> None:
    t = TIMES[TIMES < CLEARED + 1.0]
    assert verdict(record(t, delta=REST.delta + 20.0 * np.maximum(t - EVENT, 0.0))).status == SLIPPED


@pytest.mark.parametrize("signal", ["P", "delta", "i_s_pu"])
def test_no_number_is_a_divergence(signal: str) -> None:
    values = np.array(getattr(record(), signal))
    values[-100:] = np.nan
    assert verdict(record(**{signal: values})).status == DIVERGED


def test_a_broken_off_run_is_a_divergence() -> None:
    found = verdict(record(TIMES[TIMES < 0.9], diverged=True))
    assert found.status == DIVERGED
    assert found.judged
    assert not found.survived
    assert verdict(record(TIMES[TIMES < 0.3], diverged=True)).status == DIVERGED


def test_a_record_that_ends_before_the_event_is_not_known() -> None:
    assert verdict(record(TIMES[TIMES < 0.3])).status == NOT_KNOWN


def test_no_rest_is_no_verdict() -> None:
    found = verdict(record(), rest=ExpectedRest.none("the grid cannot carry it"))
    assert (found.status, found.reason) == (NO_REST, "the grid cannot carry it")
    assert found.peak_pu is None
    assert verdict(record(), rest=replace(REST, delta=math.nan)).status == NO_REST


@pytest.mark.parametrize(
    ("i_s", "limit", "status"), [(1.07, 1.2, SURVIVED), (1.09, 1.2, OVER_LIMIT), (1.09, None, SURVIVED)]
)
def test_a_rest_above_nine_tenths_of_the_limit_is_no_verdict(i_s: float, limit: float | None, status: str) -> None:
    rest, demand = replace(REST, i_s_pu=i_s), replace(DEMAND, i_max_pu=limit)
    assert verdict(record(), rest=rest, demand=demand).status == status


def test_the_words_are_all_there() -> None:
    assert set(VERDICTS) < set(STATUSES)
    assert len(set(STATUSES)) == 10


def test_all_faults_at_once() -> None:
    ragged = record(P=np.zeros(3))
    with pytest.raises(ValueError, match="shapes") as caught:
        judge_survival(ragged, (0.5, 0.4), 0.3, REST, replace(DEMAND, S_rated=-1.0))
    for word in ("record", "events_s", "ascending", "S_rated = -1"):
        assert word in str(caught.value)


@pytest.mark.parametrize("events", [(), (math.nan,), (0.9,)])
def test_wrong_events(events: Any) -> None:
    with pytest.raises(ValueError, match=r"events_s|cleared_s"):
        verdict(record(), events)


def test_uneven_rows() -> None:
    t = TIMES.copy()
    t[5] += 0.3 * STEP
    with pytest.raises(ValueError, match="equally spaced"):
        verdict(record(t))


def test_a_row_just_before_an_event_is_not_after_it() -> None:
    """Half a turn between two rows: the row before would say that the angle was at its rest."""
    event = EVENT + 0.4 * STEP
    start, end = -math.radians(179.0), -2.0 * np.pi
    gone = end + (start - end) * np.exp(-5.0 * np.maximum(TIMES - event, 0.0))
    moved = record(delta=REST.delta + np.where(TIMES - event < 0.0, 0.0, gone))
    assert judge_survival(moved, (event,), CLEARED, REST, DEMAND).status == SURVIVED
