"""Disturbances side by side against the runs of one after the other, each judged from the log of every sample."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from tests.simulation.survival.subjects import TEXT, subject
from vsgdesign.campaigns.survival import share_a_loop, verdicts_of
from vsgdesign.metrics.survival import LATCHED, NO_REST, NOT_AT_REST, OVER_LIMIT, SLIPPED, SURVIVED, TRIPPED
from vsgdesign.simulation.survival import (
    FOR_EVER,
    GridKnowledge,
    GridState,
    Subject,
    SurvivalCase,
    random_set,
    run_case,
)
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Load, Network
from vsgdesign.study.parameters.specification import ProtectionLimits

START = GridState(scr=5.0, x_over_r=3.0, P_pu=0.5, Q_pu=0.0)


def case(*changes: Event, start: GridState = START, **known: float) -> SurvivalCase:
    end_s = max(one.end_s for one in changes)
    return SurvivalCase(group="a", start=start, changes=changes, cleared_s=end_s, knowledge=GridKnowledge(**known))


def sag(V_pu: float, length_s: float) -> tuple[Event, Event]:
    return Event.of_pu(0.0, V_g_pu=V_pu), Event.of_pu(length_s, V_g_pu=1.0)


CASES = (
    case(Event.of_pu(0.0, scr=1.5, x_over_r=0.5), start=replace(START, scr=20.0), magnitude=0.8, angle_deg=10.0),
    case(Event.of_pu(0.0, scr=20.0, x_over_r=3.0), silent_s=FOR_EVER),
    case(Event.of_pu(0.0, phase_deg=150.0)),
    case(*sag(0.0, 1.0)),
    case(Event.of_pu(0.0, df_hz=1.0, over_s=0.5), Event.of_pu(1.0, df_hz=0.0, over_s=0.5)),
    case(Event.of_pu(0.0, P_pu=1.5), Event.of_pu(0.5, P_pu=0.5)),
    case(Event.of_pu(0.0, P_pu=5.0)),
    case(Event.of_pu(0.0, P_pu=0.9), start=replace(START, V_g_pu=0.97, df_hz=0.1), silent_s=0.2),
)


def test_the_protection_of_the_study_is_judged_in_runs_of_their_own() -> None:
    """Two jumps of the grid are survived; that from SCR 20 to 1.5 moves the frequency by more than 3 Hz/s."""
    one = subject()
    limits = ProtectionLimits(rocof=3.0, rocof_window=0.1)
    guarded = replace(one, study=replace(one.study, survival=replace(one.study.survival, protection=limits)))
    assert share_a_loop(one)
    assert not share_a_loop(guarded)
    free, found = (verdicts_of(each, CASES[:2]) for each in (one, guarded))
    assert [verdict.status for verdict in free] == [SURVIVED, SURVIVED]
    assert [verdict.status for verdict in found] == [TRIPPED, SURVIVED]
    assert "limit 3 Hz/s" in str(found[0].reason)


def same(one: Subject, cases: tuple[SurvivalCase, ...]) -> set[str]:
    """Compares both ways; the statuses that occurred."""
    together, alone = verdicts_of(one, cases), [run_case(one, each).verdict for each in cases]
    for each, found, true in zip(cases, together, alone, strict=True):
        assert (found.status, found.reason) == (true.status, true.reason), each.name
        for name, value in asdict(true).items():
            if isinstance(value, float):  # the angle of a log is that a millionth of a sample later
                assert getattr(found, name) == pytest.approx(value, rel=1e-9, abs=3e-8), (each.name, name)
            else:
                assert getattr(found, name) == value
    return {verdict.status for verdict in alone}


def test_a_jump_a_little_after_a_sample_is_not_seen_in_this_sample() -> None:
    """5e-4 of a sample after it, by nearly half a turn, so that the angle goes on to the next rest."""
    one = subject(TEXT.replace("[inner_loops]", 'current_limiter = "projection"\n[inner_loops]'))
    start = GridState(scr=18.0, x_over_r=0.48, P_pu=-0.4, Q_pu=0.0)
    late = case(Event.of_pu(5e-4 * one.study.converter.T_s, phase_deg=179.0), start=start)
    assert same(one, (late,)) == {SURVIVED}


def test_the_verdicts_are_those_of_single_runs() -> None:
    found = same(subject(), CASES) | same(subject(structure='"published"', current_limit_pu="1.2"), CASES)
    assert found >= {SURVIVED, NO_REST, OVER_LIMIT}
    assert found & {SLIPPED, LATCHED, NOT_AT_REST}


def test_a_load_at_the_pcc_is_in_every_lane() -> None:
    one = subject()
    Z, omega = one.study.converter.Z_base, one.study.converter.omega_n
    load = Load(R_parallel=3.0 * Z, R_series=Z, L_series=2.0 * Z / omega)
    loaded = replace(one, study=replace(one.study, network=Network(load=load)))
    assert share_a_loop(loaded)
    assert SURVIVED in same(loaded, (CASES[0], CASES[4], CASES[7]))
    beside = [verdicts_of(each, CASES[:1])[0].peak_pu or 0.0 for each in (one, loaded)]
    assert abs(beside[0] - beside[1]) > 0.01  # and it is not what it would be without the load


def test_fixed_gains_and_gains_of_another_source_are_judged_alike() -> None:
    """Gains at a design point are made for the source of the case: such a case has a run of its own."""
    drawn = random_set(7, 4)
    assert SURVIVED in same(subject(controller=1), (*CASES[:3], *drawn))
    assert SURVIVED in same(subject(TEXT.replace('tau_P = "5 ms"', 'tau_P = "0 s"')), drawn)


def test_the_place_in_a_batch_changes_no_bit() -> None:
    one = subject()
    whole = verdicts_of(one, CASES)
    assert [verdicts_of(one, [each])[0] for each in CASES[:4]] == whole[:4]
    assert verdicts_of(one, CASES[::-1]) == whole[::-1]


def test_what_cannot_share_a_loop_runs_alone() -> None:
    assert share_a_loop(subject())
    assert not share_a_loop(replace(subject(), bridge="pwm"))
    assert verdicts_of(subject(), []) == []
    assert np.isfinite(verdicts_of(replace(subject(), bridge="pwm"), CASES[:1])[0].peak_pu or np.nan)
