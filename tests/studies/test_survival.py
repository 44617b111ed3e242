"""A seeded sample of the disturbances of studies/survival: all are survived with projection, many are lost without."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.errors import StudyError
from vsgdesign.simulation.survival import CaseResult, SurvivalCase, figures_of, run_case
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.verbs.pipeline.survival import subjects_of, survival_cases, survival_document, write_cases

STUDIES = Path(__file__).resolve().parents[2] / "studies" / "survival"
CONVERTERS = ("study", "laboratory", "utility")
COUNT = 14


def sample(study: Study, seed: int) -> list[SurvivalCase]:
    """Cases of all groups, without those whose schedule stays stale for ever or for a second."""
    cases = [case for case in survival_cases(study) if case.knowledge.silent_s < 1.0]
    return [cases[k] for k in np.random.default_rng(seed).permutation(len(cases))[:COUNT]]


def results(study: Study, limiter: str, seed: int = 1) -> list[CaseResult]:
    (subject,) = subjects_of(study, NOTHING, controllers=("angle_damped",), limiters=(limiter,)).values()
    return [run_case(subject, case) for case in sample(study, seed)]


@pytest.mark.parametrize("name", CONVERTERS)
def test_projection_survives_the_sample(name: str) -> None:
    found = results(load_study(STUDIES / f"{name}.toml"), "projection")
    figures = figures_of(found, settling_time=1.0)
    assert [one.case.name for one in found if one.verdict.judged and not one.verdict.survived] == []
    assert figures.judged >= 0.7 * COUNT
    assert figures.peak_pu is not None
    assert figures.peak_pu <= 1.32  # of the asked figures
    assert figures.recovery_worst is not None
    assert figures.recovery_worst <= 2.0


def test_the_circular_limit_does_not() -> None:
    """So the sample is no easy one, and the judge can say no."""
    figures = figures_of(results(load_study(STUDIES / "study.toml"), "circular"), settling_time=1.0)
    assert figures.survived <= 0.8 * figures.judged


def test_the_three_studies_ask_for_the_same() -> None:
    studies = [load_study(STUDIES / f"{name}.toml") for name in CONVERTERS]
    assert len({study.survival for study in studies}) == 1
    assert len({study.converter.current_limit_pu for study in studies}) == 1
    assert len({tuple(spec.name for spec in study.controllers) for study in studies}) == 1
    assert len(survival_cases(studies[0])) == 1993 + 600


def test_the_document_counts_what_happened(tmp_path: Path) -> None:
    study = load_study(STUDIES / "study.toml")
    subjects = subjects_of(study, NOTHING, controllers=("angle_damped",), limiters=("circular",))
    found = {name: [run_case(subject, case) for case in sample(study, 3)[:5]] for name, subject in subjects.items()}
    document = survival_document(study, subjects, found)
    one = document["variants"]["angle_damped, circular"]
    verdicts = [result.verdict for result in found["angle_damped, circular"]]
    assert one["stale_to_1_s"]["survived"] == sum(verdict.survived for verdict in verdicts)
    assert len(one["lost"]) == sum(verdict.judged and not verdict.survived for verdict in verdicts)
    assert sum(figures["cases"] for figures in one["groups"].values()) == 5
    assert one["for_ever"]["judged"] == 0
    write_cases(tmp_path / "cases.csv", found)
    rows = (tmp_path / "cases.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 6
    assert rows[0].startswith("variant,group,case,status,recovery_s,peak_pu")


def test_what_cannot_be_measured_is_said_at_once() -> None:
    study = load_study(STUDIES / "study.toml")
    free = replace(study, converter=replace(study.converter, current_limit_pu=None))
    with pytest.raises(StudyError) as caught:
        subjects_of(free, NOTHING, controllers=("angle_damped", "nobody"))
    assert [fault.field for fault in caught.value.faults] == ["converter.current_limit_pu", "controller"]
    assert "angle_damped" in caught.value.faults[1].advice
