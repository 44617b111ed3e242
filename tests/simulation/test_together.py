"""Runs of one controller side by side are those alone, to the bit, whatever becomes of the others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.simulation.studies import GAINS
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.errors import InfeasibleStudyError, VsgDesignError
from vsgdesign.simulation import GainChange, build_timeline, run
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation, simulated, simulated_together
from vsgdesign.simulation.run_asked import RunOf
from vsgdesign.simulation.run_state import RunState
from vsgdesign.study.parameters import Study, study_from_text

EVENTS = {
    "step": 'time = "0.05 s"\nP_ref = "3 kW"',
    "jump between samples": 'time = "0.0600123 s"\nphase_jump = "20 deg"',
    "grid": 'time = "0.07 s"\ngrid = { scr = 3 }',
    "ramp": 'time = "0.0300321 s"\nf_g = "49.5 Hz"\nV_g_pu = 0.95\nover = "60 ms"',
    "longer ramp": 'time = "0.0451 s"\nf_g = "50.7 Hz"\nover = "0.1 s"',
    "harmonics": 'time = "0.04 s"\ncomponents = [{ order = -5, amplitude_pu = 0.02, phase = 0.3 }]',
}


def study_of(event: str, duration: float, scr: float = 5.0) -> Study:
    study = study_from_text(f"""
base = "case:hoang2025_5kva"
[converter]
current_limit_pu = 1.2
[power_loops]
structure = "angle_damped"
P_droop = "5 %"
[grid]
scr = {scr}
[simulation]
duration = {duration}
P_ref = "2.5 kW"
Q_ref = "0 var"
[[controllers]]
name = "a"
kind = "scheduled"
[[events]]
{event}
""")
    return replace(study, simulation=replace(study.simulation, log_interval=study.converter.T_s))


def of(study: Study) -> RunOf:
    spec = study.controllers[0]
    return RunOf(study, feed_of(study, spec, build_timeline(study), NOTHING), finds=spec)


def outcomes(asked: list[RunOf]) -> list[Simulation | VsgDesignError]:
    found = dict(simulated_together(asked))
    return [found[k] for k in range(len(asked))]


def test_each_has_the_bits_that_it_has_alone() -> None:
    studies = [study_of(event, 0.13 + 0.01 * k) for k, event in enumerate(EVENTS.values())]
    assert len({RunState(of(one)).like for one in studies}) == 2  # three of each go beside each other
    for study, beside in zip(studies, outcomes([of(one) for one in studies]), strict=True):
        alone = simulated(of(study))
        assert isinstance(beside, Simulation)
        np.testing.assert_array_equal(beside.log, alone.log)
        np.testing.assert_array_equal(beside.final_plant, alone.final_plant)
        assert beside.final_state == alone.final_state
        assert beside.gain_changes == alone.gain_changes
        assert beside.study == study


def test_one_that_diverges_ends_alone() -> None:
    studies = [study_of(EVENTS["step"], 0.2, scr) for scr in (5.0, 6.0, 7.0)]
    wild = GAINS._replace(K_ip=1e5)
    asked = [RunOf(one, [GainChange(0.0, gains)]) for one, gains in zip(studies, (GAINS, wild, GAINS), strict=True)]
    alone = [simulated(one) for one in asked]
    assert [one.divergence is not None for one in alone] == [False, True, False]
    for one, beside in zip(alone, outcomes(asked), strict=True):
        assert isinstance(beside, Simulation)
        assert beside.divergence == one.divergence
        np.testing.assert_array_equal(beside.log, one.log)


def test_one_that_cannot_begin_says_so_and_the_others_run() -> None:
    weak = study_of(EVENTS["step"], 0.12, scr=0.4)
    good = study_of(EVENTS["step"], 0.12)
    fixed = [GainChange(0.0, GAINS)]
    first, second, third = outcomes([RunOf(one, fixed) for one in (good, weak, good)])
    assert isinstance(second, InfeasibleStudyError)
    with pytest.raises(InfeasibleStudyError, match="the start") as error:
        simulated(RunOf(weak, fixed))
    assert str(second) == str(error.value)
    alone = simulated(RunOf(good, fixed))
    for one in (first, third):
        assert isinstance(one, Simulation)
        np.testing.assert_array_equal(one.log, alone.log)


def test_long_runs_go_in_smaller_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their logs take no more memory than those of eight short ones."""
    sizes, together = [], run.run_together

    def seen(runs: list[RunState], **others: Any) -> None:
        sizes.append(len(runs))
        together(runs, **others)

    monkeypatch.setattr(run, "run_together", seen)
    monkeypatch.setattr(run, "_LOGGED_TOGETHER", 6000)
    asked = [of(study_of(EVENTS["step"], duration)) for duration in (0.1, 0.1, 0.11, 0.2, 0.4)]
    for one, beside in zip(asked, outcomes(asked), strict=True):
        assert isinstance(beside, Simulation)
        assert len(beside.t_s) == RunState(one).samples
    assert sizes == [2, 1, 1, 1]  # 2000, 2200, 4000 and 8000 samples, of which 6000 fit
