"""What became of a run, in one typed word: settled, unstable, infeasible, diverged, not known."""

from __future__ import annotations

import typing
from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.studies import GAINS, lc_study
from vsgdesign.simulation.outcome import BOUND_PU, RunStatus
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import Study
from vsgdesign.verbs.pipeline.results import results_document

STEP = '[[events]]\ntime = "0.1 s"\nP_ref = "2.5 kW"\n'
TO_STRONG = '[[events]]\ntime = "0.1 s"\ngrid = { scr = 20, x_over_r = 20 }\n'
TOO_MUCH = '[[events]]\ntime = "0.1 s"\nP_ref = "4.9 kW"\n'
LIMIT = "[converter]\ncurrent_limit_pu = 0.6\n"
RAMP = '[[events]]\ntime = "0.1 s"\nf_g = "50.2 Hz"\nover = "0.3 s"\n'


def study_with(duration: str, events: str, sections: str = "", **gains: float) -> Study:
    study = lc_study(duration, events, sections, log="200 us")
    spec = replace(study.controllers[0], gains=GAINS._replace(**gains))
    return replace(study, controllers=(spec,))


@pytest.mark.parametrize(
    ("status", "reason", "study"),
    [
        ("settled", None, study_with("6 s", STEP)),
        ("not known", "too short", study_with("0.3 s", STEP)),
        ("not known", "ramp", study_with("0.3 s", RAMP)),
        ("not known", "there is no measurement after the start", study_with("0.3 s", "")),
        ("infeasible", "current_limit_pu", study_with("1 s", TOO_MUCH, LIMIT)),
        ("unstable", "unstable", study_with("1 s", TO_STRONG)),
        ("diverged", "power loops", study_with("1 s", STEP, K_ip=1e5)),
    ],
    ids=["settled", "short", "ramp", "no event", "infeasible", "unstable", "diverged"],
)
def test_the_outcome_says_which_and_why(status: str, reason: str | None, study: Study) -> None:
    result = run_scenario(study)
    outcome = result.controllers[0].outcome
    assert outcome.status == status
    assert status in typing.get_args(RunStatus)
    assert (outcome.reason is None) == (reason is None)
    assert reason is None or reason in str(outcome.reason)
    assert (outcome.t_s is not None) == (status == "diverged")
    said = results_document(result, {})["controllers"]["fixed"]["outcome"]
    assert said == {"status": status, "reason": outcome.reason, "t_s": outcome.t_s, "limits": ()}


def test_one_that_diverges_leaves_the_others_alone() -> None:
    """The log of the one ends before it diverges, every number in it within the bound; the other runs to its end."""
    study = study_with("6 s", STEP)
    bad = replace(study.controllers[0], name="bad", gains=GAINS._replace(K_ip=1e5))
    both = run_scenario(replace(study, controllers=(bad, *study.controllers)))
    diverged, good = both.controllers
    alone = run_scenario(study).controllers[0]
    assert good.simulation.log.tobytes() == alone.simulation.log.tobytes()
    assert (good.outcome.status, diverged.outcome.status) == ("settled", "diverged")
    assert diverged.outcome.t_s is not None
    assert 0.0 < diverged.series["t_s"][-1] < diverged.outcome.t_s < 1.0
    assert np.isfinite(diverged.simulation.log).all()
    assert np.abs(diverged.simulation.log[:, 0:2]).max() < BOUND_PU * study.converter.I_rated_pk
    assert {event.status for event in diverged.events} == {"diverged"}
