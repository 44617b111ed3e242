"""The scheduler: what it answers to good estimates, and each guard by itself."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.artifacts.networks import random_weights
from tests.gain_tables import PUBLISHED_BASE, table
from tests.runtime.schedulers import MIDDLE, OMEGA, POWERS, SHAPED, Z_BASE, grid, made, settle
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.equations.scheduler_data import (
    CLAMPED,
    DOUBT,
    FALLBACK,
    FRESH,
    HELD,
    JUMP,
    LIMITED,
    NO_ESTIMATE,
    UNDESIGNED,
    interval,
)
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime import (
    ClosedFormSchedule,
    Scheduler,
    box_settings,
    closed_form_scheduler,
    gain_lookup,
    neural_estimator,
    scheduler_of,
    settings_of,
    status_text,
    table_schedule,
)
from vsgdesign.runtime.guards import REASONS
from vsgdesign.runtime.schedule import on_floats
from vsgdesign.runtime.table import locate


@pytest.mark.parametrize(
    ("structure", "law"),
    [("published", "poles"), ("decoupled", "poles"), ("angle_damped", "poles"), ("angle_damped", "inertia")],
)
def test_a_settled_scheduler_has_the_gains_of_its_table(structure: str, law: str) -> None:
    """The same as the schedule on arrays, to rounding: place to grid and back costs a few last bits."""
    scheduler = made(structure, law)
    shaped = SHAPED if law == "poles" else {"H": np.linspace(1.0, 3.0, 16).reshape(4, 4)}
    schedule = table_schedule(table(structure, law, parameters=shaped))
    for scr, x_over_r in ((3.0, 1.4), (7.7, 0.8), (15.0, 6.0)):
        answer = settle(scheduler, scr, x_over_r)
        assert (answer.status, answer.why) == (FRESH, "")
        expected = schedule.gains_measured(*grid(scr, x_over_r), *POWERS)
        np.testing.assert_allclose(answer.gains, expected, rtol=1e-12)
        assert all(type(value) is float for value in answer.gains)


def test_on_the_reactance_basis() -> None:
    base = replace(PUBLISHED_BASE, scr_basis="reactance", L_2=5e-4, R_2=0.02)
    bare = table(base=base)
    scheduler, L_g = scheduler_of(bare), Z_BASE / 3.0 / OMEGA
    answer = [scheduler.update_estimate(OMEGA * L_g / 2.0, L_g, *POWERS) for _ in range(40)][-1]
    expected = table_schedule(bare).gains_measured(OMEGA * L_g / 2.0, L_g, *POWERS)
    np.testing.assert_allclose(answer.gains, expected, rtol=1e-12)
    assert (answer.scr, answer.r_over_x) == pytest.approx((3.0, 0.5), rel=1e-12)


def test_starts_at_the_safe_place_and_says_so() -> None:
    scheduler = made()
    answer = scheduler.hold(*POWERS)
    assert answer.status == HELD | FALLBACK
    assert answer.reason == NO_ESTIMATE
    assert answer.scr == pytest.approx(MIDDLE, rel=1e-6)
    assert answer.r_over_x == pytest.approx(1.0 / np.sqrt(0.3 * 10.0), rel=1e-7)


@pytest.mark.parametrize("scr", [2.0, 19.0])
def test_a_jump_waits_for_confirmation_then_goes_at_the_rate(scr: float) -> None:
    scheduler = made()
    settle(scheduler, 6.0, 1.0)
    answer = present = scheduler.hold(*POWERS)
    for _ in range(2):
        answer = scheduler.update_estimate(*grid(scr, 1.0), *POWERS)
        assert (answer.status, answer.reason, answer.scr) == (HELD | DOUBT, JUMP, present.scr)
    before = present.scr
    for _ in range(100):
        answer = scheduler.update_estimate(*grid(scr, 1.0), *POWERS)
        assert answer.status in (FRESH, FRESH | LIMITED)
        assert abs(np.log(answer.scr / before)) <= 10.0 * 0.02
        before = answer.scr
    assert answer.status == FRESH
    assert answer.scr == pytest.approx(scr, rel=1e-12)


def test_estimates_that_jump_about_are_never_followed() -> None:
    scheduler = made()
    present = settle(scheduler, 6.0, 1.0)
    for k in range(30):  # less than the 0.6 s that a doubt may last
        answer = scheduler.update_estimate(*grid((2.0, 18.0)[k % 2], 1.0), *POWERS)
        assert (answer.status, answer.reason, answer.scr) == (HELD | DOUBT, JUMP, present.scr)


def test_hysteresis_leaves_the_goal() -> None:
    scheduler = made()
    present = settle(scheduler, 6.0, 1.0)
    answer = settle(scheduler, 6.0 * 1.019, 1.0)
    assert (answer.status, answer.scr) == (FRESH, present.scr)
    assert settle(scheduler, 6.0 * 1.021, 1.0).scr == pytest.approx(6.0 * 1.021, rel=1e-12)


def test_without_estimates_it_falls_back_in_time_and_comes_back() -> None:
    scheduler = made()
    settle(scheduler, 3.0, 1.0)
    texts = [status_text(scheduler.hold(*POWERS).status) for _ in range(530)]
    assert texts[:500] == ["held"] * 500
    assert texts[500] == "held limited fallback"
    assert texts[-1] == "held fallback"
    assert scheduler.hold(*POWERS).scr == pytest.approx(MIDDLE, rel=1e-6)
    assert settle(scheduler, 3.0, 1.0).status == FRESH


@pytest.mark.parametrize("told", [{"limited": True}, {"surprised": True}, {"limited": True, "surprised": True}])
def test_a_doubt_holds_the_place_then_leaves_it(told: dict[str, bool]) -> None:
    """For 0.6 s, in which an estimator finds the new grid; without a doubt 10 s do nothing."""
    scheduler = made()
    present = settle(scheduler, 3.0, 1.0)
    scheduler.tell(**told)
    texts = []
    for _ in range(80):
        answer = scheduler.hold(*POWERS)
        texts.append(status_text(answer.status))
        assert (answer.scr == present.scr) == (len(texts) <= 30)
    assert texts[:30] == ["held doubt"] * 30
    assert texts[30] == "held limited fallback doubt"
    assert texts[-1] == "held fallback doubt"
    assert scheduler.hold(*POWERS).scr == pytest.approx(MIDDLE, rel=1e-6)
    assert settle(scheduler, 3.0, 1.0).status == FRESH
    assert status_text(scheduler.hold(*POWERS).status) == "held"  # an estimate ends the doubt


def test_an_estimate_ends_a_doubt_and_what_is_told_with_it_begins_none() -> None:
    scheduler = made()
    settle(scheduler, 3.0, 1.0)
    for _ in range(200):  # a converter that is limited all the time, and an estimator that works all the same
        scheduler.tell(limited=True)
        assert scheduler.update_estimate(*grid(3.0, 1.0), *POWERS).status == FRESH
    scheduler.tell(limited=True)
    assert scheduler.hold(*POWERS).status == HELD | DOUBT
    assert scheduler.update_estimate(*grid(3.0, 1.0), *POWERS).status == FRESH
    scheduler.tell()
    assert scheduler.hold(*POWERS).status == HELD


def test_a_new_surprise_begins_the_doubt_anew() -> None:
    """A dip lasts for 0.4 s, and after its clearance an estimator needs as long again as after any other event."""
    scheduler = made()
    present = settle(scheduler, 3.0, 1.0)
    for k in range(50):
        scheduler.tell(limited=True, surprised=k in (0, 20))
        answer = scheduler.hold(*POWERS)
        assert (status_text(answer.status), answer.scr) == ("held doubt", present.scr)
    scheduler.tell(limited=True)
    assert status_text(scheduler.hold(*POWERS).status) == "held limited fallback doubt"


def test_the_same_surprise_is_not_new() -> None:
    """Told in every update, and on across a saved state, it is one surprise, and ends with the safe place."""
    scheduler, again = made(), made()
    settle(scheduler, 3.0, 1.0)
    for _ in range(30):
        scheduler.tell(surprised=True)
        assert not scheduler.hold(*POWERS).status & LIMITED
        again.restore(json.loads(json.dumps(scheduler.state())))
        scheduler = again
        again = made()
    scheduler.tell(surprised=True)
    assert status_text(scheduler.hold(*POWERS).status) == "held limited fallback doubt"


def test_what_is_told_is_part_of_the_state() -> None:
    scheduler, again = made(), made()
    settle(scheduler, 3.0, 1.0)
    scheduler.tell(surprised=True)
    again.restore(json.loads(json.dumps(scheduler.state())))
    assert again.hold(*POWERS) == scheduler.hold(*POWERS)
    assert again.state() == scheduler.state()
    assert again.state()["doubt"] == 1


def test_the_place_stays_in_the_box_and_says_clamped() -> None:
    scheduler = made()
    answer = settle(scheduler, 25.0, 1.0)
    assert answer.status == FRESH | CLAMPED
    assert answer.scr == 20.0
    answer = scheduler.update_estimate(*grid(19.9, 1.0), 4.6e3, 0.0, 112.0)
    assert answer.status & CLAMPED
    np.testing.assert_array_equal(
        answer.gains, scheduler.update_estimate(*grid(19.9, 1.0), 4.5e3, 0.0, 112.0).gains
    )  # P beyond the box: the gains of its edge


def test_no_gains_where_nothing_is_designed() -> None:
    status = np.full((4, 4), "met", dtype="<U8")
    status[1, :] = "outside"
    scheduler = scheduler_of(table(status=status))
    answers = [scheduler.update_estimate(*grid(1.5, 1.0), *POWERS) for _ in range(40)]
    assert all(answer.scr >= 5.0 for answer in answers)
    assert answers[-1].reason == UNDESIGNED
    assert answers[-1].status & HELD
    with pytest.raises(ArtifactError, match="safe place SCR 2"):
        scheduler_of(table(status=status), safe_scr=2.0)


def test_gains_stay_bounded_where_the_grid_cannot_carry_the_power() -> None:
    """At 0.9 of what the estimated grid carries, and beyond: gains as on the grid that has the margin."""
    scheduler = made()
    settle(scheduler, 1.6, 1.0)
    R, L = grid(1.6, 1.0)
    P, Q, V_rms = 4.4e3, -2e3, 94.0
    answer = scheduler.update_estimate(R, L, P, Q, V_rms)
    assert answer.status & FRESH
    omega = scheduler.lookup.omega
    carried = 3.0 * V_rms**2 / np.hypot(R, omega * L)
    share = carried / (1.3 * np.hypot(P, Q))
    assert share < 1.0
    normalised = scheduler.lookup.normalised(answer.scr, answer.r_over_x)
    assert normalised is not None
    J = np.array(jacobian_from_powers(P, Q, V_rms, share * R, share * omega * L)).reshape(2, 2)
    J *= [[1.0, normalised.share_P], [normalised.share_Q, 1.0]]
    J[1, 1] += answer.gains.D_q
    # The place is where the scheduler's hysteresis left it, within 2 %.
    np.testing.assert_allclose(
        [answer.gains.K_ip, answer.gains.K_pq], normalised.k_1_or_H * np.linalg.inv(J)[0], rtol=0.05
    )


def test_the_certificate_narrows_box_and_rate() -> None:
    region = {"scr": [2.0, 15.0], "x_over_r": [0.5, 20.0], "P": [-4e3, 4e3], "Q": [-2e3, 2e3], "rate": 2.0}
    certified = settings_of(table(certificate={"region": region}))
    assert certified.scr == (2.0, 15.0)
    assert certified.r_over_x == pytest.approx((0.1, 2.0), rel=1e-7)
    assert certified.r_over_x[0] >= 0.1
    assert certified.P == (-4e3, 4e3)
    assert certified.rate == 2.0
    assert settings_of(table(certificate={"decay": 1.0})).scr == (1.5, 20.0)
    refuted = settings_of(table(certificate={"certified": False, "region": region}))
    assert (refuted.scr, refuted.rate) == ((1.5, 20.0), 10.0)
    assert settings_of(table(certificate={"region": {"rate": None}})).rate == 10.0


def test_settings_that_make_no_sense_are_refused_all_at_once() -> None:
    with pytest.raises(ArtifactError) as caught:
        settings_of(table(), rate=-1.0, confirm=0, stale_ticks=0, jump=0.01, safe_r_over_x=99.0)
    for name in ("rate", "confirm", "stale_ticks", "jump", "safe_r_over_x"):
        assert name in str(caught.value)
    with pytest.raises(ArtifactError, match="scr = 30 20: the box is empty"):
        settings_of(table(certificate={"region": {"scr": [30.0, 40.0]}}))


def test_known_grid_at_the_start() -> None:
    scheduler = made()
    gains = scheduler.start(*grid(3.0, 1.0))
    assert gains == scheduler.gains
    assert scheduler.update_estimate(*grid(3.0, 1.0), *POWERS).status == FRESH
    for bad in ((grid(40.0, 1.0)), (np.nan, 1e-3), (1.0, -1.0)):
        with pytest.raises(ArtifactError, match="not in the schedule's box"):
            scheduler.start(*bad)


def test_a_grid_outside_the_box_may_be_taken_for_the_nearest_place() -> None:
    """The gains are then those that updates on this grid lead to in the end."""
    started, updated = made(), made()
    started.start(*grid(40.0, 1.0), nearest=True)
    updated.start(*grid(19.0, 1.0))
    for k in range(100):
        updated.update_estimate(*grid(40.0, 1.0), *POWERS, 20_000 * k)
    started.update_estimate(*grid(40.0, 1.0), *POWERS)
    np.testing.assert_allclose(started.gains, updated.gains, rtol=1e-9)
    with pytest.raises(ArtifactError, match="not in the schedule's box"):
        started.start(np.nan, 1e-3, nearest=True)


def test_the_closed_form_needs_no_table() -> None:
    schedule = ClosedFormSchedule(
        P=4500.0,
        Q=1000.0,
        V_g_rms=110.0,
        omega=OMEGA,
        settling_time=1.0,
        damping_ratio=1.0,
        droop_ratio=0.01,
        structure="angle_damped",
        D_p=318.3,
        D_q=90.9,
        S_rated=5e3,
    )
    limits = box_settings(
        scr=(1.5, 20.0),
        r_over_x=(0.1, 3.0),
        P=(-4500.0, 4500.0),
        Q=(-2e3, 2e3),
        V_rms=(93.5, 137.5),
        S_rated=5e3,
        V_rated_rms=110.0,
        omega=OMEGA,
    )
    scheduler = closed_form_scheduler(schedule, limits, V_n_rms=110.0)
    answer = settle(scheduler, 4.0, 0.7)
    assert answer.status == FRESH
    np.testing.assert_allclose(answer.gains, schedule.gains_measured(*grid(4.0, 0.7), *POWERS), rtol=1e-12)


def test_one_axis_value_is_located_to_the_same_bits() -> None:
    rng = np.random.default_rng(4)
    for n in (1, 2, 7):
        axis = np.sort(rng.uniform(0.1, 9.0, n))
        for value in [*rng.uniform(-1.0, 11.0, 50), *axis, -np.inf, np.inf]:
            one, many = on_floats(interval)(tuple(axis.tolist()), float(value)), locate(axis, value)
            assert all(np.array_equal(a, b) for a, b in zip(one, many[:3], strict=True))


@pytest.mark.parametrize("windows", [False, True])
def test_restored_is_bit_equal(windows: bool) -> None:
    rng = np.random.default_rng(8)

    def fresh() -> Scheduler:
        estimator = neural_estimator(random_weights(), sample_interval=200e-6) if windows else None
        return scheduler_of(table(parameters=SHAPED), estimator)

    a, b = fresh(), fresh()
    for k in range(40):
        if windows:
            assert a.push(*rng.normal(size=2)) is (k >= 99)
        a.update_estimate(*grid(rng.uniform(1.2, 25.0), 1.0), *POWERS, ticks=k * 20_000)
        if k % 10 == 7:
            b.restore(json.loads(json.dumps(a.state())))
            assert b.state() == a.state()
            R, L = grid(rng.uniform(1.2, 25.0), 1.0)
            assert a.update_estimate(R, L, *POWERS) == b.update_estimate(R, L, *POWERS)


def test_the_closed_lookup_is_the_tables() -> None:
    lookup = gain_lookup(table_schedule(table()), V_n_rms=110.0)
    assert lookup.grid(*lookup.coordinates(1.3, 4e-3)) == pytest.approx((1.3, 4e-3), rel=1e-14)
    assert len(REASONS) == 9
