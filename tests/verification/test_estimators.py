"""Controllers that estimate their grid: which are run as they are, and which are told what a case says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.simulation.survival.subjects import TEXT
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.study.parameters import study_from_text
from vsgdesign.verbs.pipeline.verify import Asked, job_of

SECTION = "[specification]\nscr = [2, 10]\nx_over_r = [1, 5]\nP = [-2500, 2500]\nQ = [-1000, 1000]\nerror = 0.2\n"
SPECIFIED = TEXT.replace("[simulation]", f"{SECTION}[simulation]")


@pytest.mark.parametrize(("estimate", "run_as"), [("truth", "truth"), ("rls", "truth"), ("field", "field")])
def test_a_field_estimator_runs_as_it_is(estimate: str, run_as: str) -> None:
    study = study_from_text(SPECIFIED)
    job, _ = job_of(study, replace(study.controllers[0], estimate=estimate), NOTHING, Asked(runs=2))
    assert job.spec.estimate == run_as
    cases, _ = job.batch.draw(job.study, job.spec, 0, 20, job.ready)
    learns = run_as == "field"
    # It learns its grid before anything happens, and nothing is told to it.
    assert (cases.events.t_s[:, 0] > 1.0).all() == learns
    assert (cases.error_X == 0.0).all() == learns
