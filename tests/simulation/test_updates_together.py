"""Updates of a gain table for all runs at once are those that each run makes by itself in Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gain_tables import table
from tests.simulation.test_together import EVENTS, outcomes, study_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.simulation import build_timeline
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.following import KnownFirst
from vsgdesign.simulation.run import Simulation, simulated
from vsgdesign.simulation.run_asked import RunOf
from vsgdesign.simulation.run_state import RunState
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import GridEstimate

READY = Ready(tables={"a": table(scr=(1.2, 2.0, 5.0, 20.0))})
ONES = {
    "step": EVENTS["step"],
    "jump, and silence": EVENTS["jump between samples"],
    "grid": EVENTS["grid"],
    "so strong that the current is limited": 'time = "0.07 s"\nphase_jump = "60 deg"',
    "out of the box": 'time = "0.05 s"\ngrid = { scr = 30 }',
}


def told(study: Study) -> Study:
    """The study with a controller that takes its gains from the table, and knows its grid late and wrong."""
    knows = GridEstimate(error_R=0.1, error_X=-0.1, silent_s=0.05)
    spec = replace(study.controllers[0], schedule="table", update_period=0.01, knowledge=knows)
    return replace(study, controllers=(spec,))


def of(study: Study, *, together: bool, known: KnownFirst | None = None) -> RunOf:
    spec = study.controllers[0]
    feed = feed_of(study, spec, build_timeline(study), READY, known)
    return RunOf(study, feed, finds=spec, together=together)


@pytest.fixture(scope="module")
def studies() -> list[Study]:
    return [told(study_of(event, 0.2 + 0.01 * k)) for k, event in enumerate(ONES.values())]


def test_gains_and_states_are_those_of_a_run_that_asks_its_own_scheduler(studies: list[Study]) -> None:
    """The sines of the machine code differ from the library's in their last bit: 1e-15 of a gain, which has grown to
    some 1e-12 of the rated values after 0.2 s."""
    known: KnownFirst = {}
    beside = outcomes([of(study, together=True, known=known) for study in studies])
    assert len(known) == 1  # all begin on the same grid at the same powers
    limited = 0.0
    for study, one in zip(studies, beside, strict=True):
        own = simulated(of(study, together=False))
        assert isinstance(one, Simulation)
        scale = np.abs(own.log).max(axis=0) + 1e-12
        assert (np.abs(one.log - own.log).max(axis=0) / scale).max() < 1e-10
        assert [change.t_s for change in one.gain_changes] == [change.t_s for change in own.gain_changes]
        changes = [np.array([change.gains for change in run.gain_changes]) for run in (one, own)]
        np.testing.assert_allclose(*changes, rtol=1e-10, atol=1e-18)
        assert len(changes[0]) > 10
        limited = max(limited, float(own.column("limited_samples")[-1]))
    assert limited > 0.0  # a scheduler is told so


def test_a_run_beside_others_has_the_bits_of_one_alone(studies: list[Study]) -> None:
    beside = outcomes([of(study, together=True) for study in studies])
    for study, one in zip(studies, beside, strict=True):
        assert RunState(of(study, together=True)).late is not None
        alone = simulated(of(study, together=True))
        assert isinstance(one, Simulation)
        np.testing.assert_array_equal(one.log, alone.log)
        assert one.gain_changes == alone.gain_changes
        assert one.final_state == alone.final_state
