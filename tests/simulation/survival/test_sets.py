"""The set of disturbances: what it covers, that it stays the same, and that a seed makes it."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import asdict

import pytest

from vsgdesign.simulation.survival import SurvivalCase, fixed_set, random_set
from vsgdesign.simulation.survival.cases import LEAD_S
from vsgdesign.simulation.survival.sets import RANDOM
from vsgdesign.study.parameters.event import Event

FIXED = fixed_set()


def per_unit(event: Event) -> dict[str, float | None]:
    """An event by the names under which it was first written down."""
    at = event.place
    return {
        "t_s": event.t_s,
        "scr": None if at is None else at.scr,
        "x_over_r": None if at is None else at.x_over_r,
        "V_g_pu": event.V_g_rms,
        "df_hz": event.df_hz,
        "over_s": event.over,
        "phase_deg": event.phase_deg,
        "P_pu": event.P_ref,
        "Q_pu": event.Q_ref,
    }


def values(name: str) -> set[float]:
    return {value for case in FIXED for change in case.changes if (value := per_unit(change)[name]) is not None}


def test_the_fixed_part_is_always_the_same() -> None:
    """Figures of different dates are about the same events. Who changes the set on purpose changes this line."""
    assert {(case.lead_s, case.draw) for case in FIXED} == {(LEAD_S, None)}
    parts = ("group", "start", "changes", "cleared_s", "knowledge")
    written = [asdict(case) | {"changes": [per_unit(change) for change in case.changes]} for case in FIXED]
    text = json.dumps([{name: case[name] for name in parts} for case in written])
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "d0ea7232d79b7123"


def test_no_case_is_there_twice() -> None:
    assert len({case.name for case in FIXED}) == len(FIXED) >= 1900


def test_it_covers_what_is_asked() -> None:
    starts = {case.start.scr for case in FIXED}
    assert {1.2, 1.5, 2.0, 5.0, 20.0} <= starts
    assert {1.2, 1.5, 2.0, 5.0, 20.0} <= values("scr")
    assert {0.3, 1.0, 3.0, 10.0, 20.0} <= values("x_over_r")
    assert {sign * size for sign in (-1, 1) for size in (10, 30, 60, 90, 120, 150)} | {180} <= values("phase_deg")
    assert {0.0, 0.05, 0.2, 0.5, 0.7, 1.2} <= values("V_g_pu")
    assert {-1.0, -0.5, 0.0, 0.5, 1.0} <= values("df_hz")
    assert {-1.5, -0.9, 0.9, 1.5} <= values("P_pu")
    assert {-0.3, 0.3} <= values("Q_pu")
    assert {0.02, 0.2, 1.0, float("inf")} <= {case.knowledge.silent_s for case in FIXED}
    assert {0.8, 1.2} <= {case.knowledge.magnitude for case in FIXED}
    assert {-10.0, 10.0} <= {case.knowledge.angle_deg for case in FIXED}
    rates = {
        round(abs(change.df_hz - before) / change.over, 6)
        for case in FIXED
        for change, before in zip(case.changes, (0.0, *(c.df_hz or 0.0 for c in case.changes)), strict=False)
        if change.df_hz is not None and change.over > 0.0
    }
    assert rates == {1.0, 2.0, 4.0}
    lengths = {round(case.changes[1].t_s, 3) for case in FIXED if case.group == "sag"}  # 50 ms to 1 s
    assert (min(lengths), max(lengths)) == (0.05, 1.0)
    assert {len(case.changes) for case in FIXED if case.group == "repeated sags"} == {6}


def test_random_cases_come_from_their_seed() -> None:
    once = random_set(7, 200)
    assert once == random_set(7, 200)
    assert once[:50] == random_set(7, 50)
    assert once != random_set(8, 200)
    assert {case.group for case in once} == {RANDOM}
    assert len({case.name for case in once}) == 200


def test_random_cases_stay_in_their_box() -> None:
    cases = random_set(3, 500)
    assert all(1.2 <= case.start.scr <= 20.0 and 0.3 <= case.start.x_over_r <= 20.0 for case in cases)
    assert all(abs(case.start.P_pu) <= 0.9 and abs(case.start.Q_pu) <= 0.3 for case in cases)
    assert all(0.02 <= case.knowledge.silent_s <= 1.0 for case in cases)
    assert all(0.8 <= case.knowledge.magnitude <= 1.2 and abs(case.knowledge.angle_deg) <= 10.0 for case in cases)
    assert all(0.0 <= case.changes[0].t_s <= 0.02 for case in cases)
    kinds = Counter(len(case.changes) for case in cases)
    assert set(kinds) == {1, 2, 4, 6, 8}  # single changes, pairs, and two to four sags in a row


@pytest.mark.parametrize("case", [case for case in random_set(3, 60) if len(case.changes) == 2])
def test_what_begins_beside_nominal_ends_there(case: SurvivalCase) -> None:
    """A fault that is cleared leaves the voltage that was there before."""
    last = case.changes[-1].V_g_rms
    assert last is None or last == case.start.V_g_pu
