"""Disturbances as data: faults, words, documents, and what an estimator is taken to say."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.simulation.survival.subjects import subject
from vsgdesign.simulation import build_timeline
from vsgdesign.simulation.survival import (
    FOR_EVER,
    GridKnowledge,
    GridState,
    SurvivalCase,
)
from vsgdesign.simulation.survival.cases import LEAD_S
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Grid

START = GridState(scr=2.0, x_over_r=3.0, P_pu=0.5, Q_pu=-0.1)
JUMP = Event.of_pu(0.0, scr=20.0, x_over_r=1.0)


def case(*changes: Event, cleared_s: float = 1.0, **knowledge: float) -> SurvivalCase:
    return SurvivalCase(
        group="test",
        start=START,
        changes=changes or (JUMP,),
        cleared_s=cleared_s,
        knowledge=GridKnowledge(**knowledge),
    )


def test_a_case_is_a_study_with_its_events() -> None:
    sag = Event.of_pu(0.2, V_g_pu=0.5, phase_deg=-30.0)
    ramp = Event.of_pu(0.4, df_hz=-1.0, over_s=0.5, P_pu=0.9, Q_pu=0.2)
    study = subject().study
    c = study.converter
    made = case(JUMP, sag, ramp, cleared_s=0.9).study(study, 2.0)
    assert made.simulation.duration == pytest.approx(LEAD_S + 0.9 + 2.0)
    assert made.simulation.P_ref == 0.5 * c.S_rated
    assert made.simulation.Q_ref == pytest.approx(-0.1 * c.S_rated)
    # |Z| = Z_base/SCR, R = |Z|/√(1 + (X/R)²), by hand.
    assert made.grid.R_g == pytest.approx(c.Z_base / 2.0 / math.hypot(1.0, 3.0))
    first, second, third = made.events
    assert first.t_s == LEAD_S
    assert first.grid is not None
    assert math.hypot(first.grid.R_g, c.omega_n * first.grid.L_g) == pytest.approx(c.Z_base / 20.0)
    assert second.V_g_rms == 0.5 * c.V_rated_rms
    assert second.phase_jump == pytest.approx(-math.pi / 6.0)
    assert third.omega_g == pytest.approx(2.0 * math.pi * 49.0)
    assert (third.over, third.P_ref, third.Q_ref) == (0.5, 0.9 * c.S_rated, 0.2 * c.S_rated)
    assert first.V_g_rms is first.omega_g is first.P_ref is None


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: case(Event.of_pu(0.0)), "changes nothing"),
        (lambda: case(Event.of_pu(0.0, scr=20.0)), "give both"),
        (lambda: case(Event.of_pu(0.5, P_pu=0.1), JUMP), "in the order of time"),
        (lambda: case(Event.of_pu(0.9, df_hz=1.0, over_s=0.5)), "cleared_s = 1 s"),
        (lambda: case(silent_s=-1.0), "silent_s = -1.0"),
        (lambda: case(magnitude=math.nan, silent_s=math.nan), "magnitude = nan"),
        (lambda: case(Event.of_pu(0.0, scr=-2.0, x_over_r=1.0)), "SCR -2"),
    ],
)
def test_a_case_that_cannot_be_is_refused(make: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()


def test_the_name_says_everything() -> None:
    name = case(JUMP, Event.of_pu(0.2, phase_deg=30.0), silent_s=FOR_EVER, magnitude=1.2, angle_deg=-10.0).name
    for word in ("SCR 2, X/R 3, P 0.5, Q -0.1", "SCR 20, X/R 1 at 0 s", "phase +30°", "for ever", "× 1.2", "-10°"):
        assert word in name


def told(one: SurvivalCase) -> list[tuple[float, Grid | None]]:
    study = one.study(subject().study, 1.0)
    return list(one.told(study, build_timeline(study)))


def test_an_estimator_is_silent_after_every_change_of_the_grid_or_its_source() -> None:
    sag, end = Event.of_pu(0.0, V_g_pu=0.2), Event.of_pu(0.5, V_g_pu=1.0, scr=20.0, x_over_r=1.0)
    step = Event.of_pu(0.7, P_pu=0.9)
    said = told(case(sag, end, step, silent_s=0.2))
    assert [t for t, _ in said] == pytest.approx([0.0, 0.1, 0.3, 0.6, 0.8])
    assert [grid is None for _, grid in said] == [False, True, False, True, False]
    before, again, after = (grid for _, grid in said if grid is not None)
    assert before == again
    assert after.R_g == pytest.approx(0.1 * before.R_g * math.hypot(1.0, 3.0) / math.hypot(1.0, 1.0))


def test_a_second_change_within_its_silence_keeps_it_silent() -> None:
    said = told(case(JUMP, Event.of_pu(0.1, V_g_pu=0.9), silent_s=0.2))
    assert [t for t, _ in said] == pytest.approx([0.0, 0.1, 0.2, 0.4])
    assert [grid is None for _, grid in said] == [False, True, True, False]


def test_for_ever_is_for_ever() -> None:
    assert [grid is None for _, grid in told(case(JUMP, JUMP, silent_s=FOR_EVER))] == [False, True]


@pytest.mark.parametrize(("magnitude", "angle"), [(1.2, 10.0), (0.8, -10.0)])
def test_the_error_turns_and_stretches_the_impedance(magnitude: float, angle: float) -> None:
    omega, grid = 314.0, Grid(0.3, 1e-3)
    seen = GridKnowledge(magnitude=magnitude, angle_deg=angle).seen(grid, omega)
    expected = complex(0.3, 0.314) * magnitude * np.exp(1j * math.radians(angle))
    assert complex(seen.R_g, omega * seen.L_g) == pytest.approx(expected)


def test_a_resistance_is_never_negative() -> None:
    assert GridKnowledge(angle_deg=10.0).seen(Grid(0.01, 1e-3), 314.0).R_g == 0.0
