"""Cases in words: what happens in them, and why they are bad."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests import gain_tables
from tests.verification.test_summary import STUDY
from vsgdesign.campaigns.verification.counting import FIGURES
from vsgdesign.campaigns.verification.worst import beside_relaxed, end_of, start_of, what_of, why_of
from vsgdesign.simulation.lanes.cases import LaneCases, no_events
from vsgdesign.study.parameters.grid import Place

C = STUDY.converter


def case(silent_s: float = 0.0, **event: float) -> LaneCases:
    """One case at SCR 2 and X/R 1 (of the study's basis) with one event at 0.1 s."""
    grid = Place(2.0, 1.0, STUDY.scr_basis).grid(C)
    events, one = no_events(1), np.ones(1)
    events.t_s[:] = 0.1
    for name, value in event.items():
        getattr(events, name)[:] = value
    return LaneCases(
        R_g=grid.R_g * one,
        L_g=grid.L_g * one,
        V_g_rms=C.V_rated_rms * one,
        omega_g=C.omega_n * one,
        P_ref=0.4 * C.S_rated * one,
        Q_ref=0.1 * C.S_rated * one,
        events=events,
        error_R=0.1 * one,
        error_X=-0.2 * one,
        silent_s=silent_s * one,
        cleared_s=0.1 * one,
        kind=np.zeros(1, np.int8),
        signal=np.zeros(1, np.int8),
    )


WEAKER = Place(1.0, 0.5, STUDY.scr_basis).grid(C)


@pytest.mark.parametrize(
    ("event", "said"),
    [
        ({"P_ref": 0.45 * C.S_rated}, "At 0.1 s P_ref changes by +0.05 pu"),
        ({"Q_ref": 0.05 * C.S_rated}, "At 0.1 s Q_ref changes by -0.05 pu"),
        ({"R_g": WEAKER.R_g, "L_g": WEAKER.L_g}, "At 0.1 s SCR changes from 2 to 1 (X/R 0.5)"),
        (
            {"V_g_rms": 0.3 * C.V_rated_rms, "phase_jump": -0.5},
            "the voltage goes to 0.3 pu and the phase jumps by -28.6°",
        ),
        ({"omega_g": 1.01 * C.omega_n, "over": 0.5}, "the frequency goes to 50.5 Hz in 0.5 s"),
        ({"phase_jump": 0.5, "silent_s": 0.3}, "+28.6°; the schedule is told 0.3 s later"),
    ],
)
def test_what_happens(event: dict[str, float], said: str) -> None:
    assert said in what_of(STUDY, case(**event), 0)


def test_where_a_case_begins_and_ends() -> None:
    found = case(R_g=WEAKER.R_g, L_g=WEAKER.L_g)
    start = start_of(STUDY, found, 0, (0.3 * C.S_rated, 0.0))
    assert (start["scr"], start["x_over_r"]) == pytest.approx((2.0, 1.0))
    assert (start["P_pu"], start["Q_pu"], start["f_hz"]) == pytest.approx((0.3, 0.0, 50.0))
    assert (start["error_R"], start["error_X"]) == (0.1, -0.2)
    assert end_of(STUDY, found, 0) == pytest.approx({"scr": 1.0, "x_over_r": 0.5})


def figures(**given: float) -> tuple[float, ...]:
    return tuple((dict.fromkeys(FIGURES, 0.0) | given).values())


def test_why() -> None:
    assert why_of(figures(), "settling", {"SCR": 0.5}, decay=100.0, limit=1.0) is None
    said = why_of(figures(limited_s=0.0123), "settling", {"SCR": 0.001, "P": 0.5}, relaxed=True, decay=4.0, limit=1.0)
    assert said == (
        "A node of the table beside the estimated grid is relaxed: it gives up a requirement. The current limiter acts "
        "for 12.3 ms. The slowest mode of the linear model decays with 4 1/s, for which 2 % take 0.978 s. It lies at "
        "the edge of what is drawn in SCR."
    )
    said = why_of(figures(peak_pu=2.345), "survival", {}, status="slipped", limited=False, decay=math.nan, limit=1.0)
    assert said == "The angle slips by a turn. The controller has no current limit, and the current reaches 2.35 pu."
    said = why_of(figures(), "settling", {}, decay=-1.0, limit=1.0)
    assert said == "The linear model is unstable at the new rest."


def test_a_relaxed_node_is_seen_from_its_own_cells_alone() -> None:
    status = np.full((4, 4), "met", dtype="<U7")
    status[0, 0] = "relaxed"
    table = gain_tables.table(status=status)
    for scr, x_over_r, seen in ((1.6, 0.5, True), (1.6, 1.5, False), (3.0, 0.5, False), (1.0, 0.1, True)):
        grid = Place(scr, x_over_r, table.base.scr_basis).grid(C)
        assert beside_relaxed(table, STUDY, grid.R_g, grid.L_g) is seen
    assert not beside_relaxed(None, STUDY, 1.0, 1e-3)
