"""Disturbances of a plant of equal units, against the run of one converter on the grid of the common mode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns import survival as campaigns_survival
from vsgdesign.campaigns.survival import plant_verdict, verdicts_of
from vsgdesign.errors import StudyError
from vsgdesign.metrics.survival import NO_REST, OVER_LIMIT, SURVIVED
from vsgdesign.simulation.survival import GridKnowledge, Subject, SurvivalCase, fixed_set, plant_set, run_case
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.verbs.pipeline import verify
from vsgdesign.verbs.pipeline.one_unit import as_unit
from vsgdesign.verbs.pipeline.survival import Asked, report_survival, subjects_of, survival_cases
from vsgdesign.verbs.pipeline.verify import prepared_job


@pytest.fixture(scope="module")
def study() -> Study:
    """Two units, with the closed form: a plant needs no table for this."""
    found = load_study("studies/plant/study.toml").with_changes(plant={"units": 2}, events=[])
    return replace(found, controllers=(replace(found.controllers[0], schedule="closed_form"),))


@pytest.fixture(scope="module")
def subject(study: Study) -> Subject:
    return subjects_of(study, Ready(), limiters=None)["table"]


@pytest.mark.parametrize(
    ("group", "scr"), [("jump down", 20.0), ("sag", 5.0), ("wrong estimate", 2.0), ("frequency", 1.5)]
)
def test_units_that_move_alike_are_one_converter(study: Study, subject: Subject, group: str, scr: float) -> None:
    """All units have the same disturbance, so each is one converter on x_t + N Z_g, with the same figures."""
    some = [one for one in fixed_set() if one.group == group and one.start.P_pu == 0.5]
    case = next(one for one in some if (one.start.scr, one.start.x_over_r) == (scr, 3.0))
    if group == "frequency":
        case = next(one for one in some if any(change.over for change in one.changes))
    case = replace(case, knowledge=replace(case.knowledge, silent_s=0.05))
    alone = replace(subject, study=as_unit(study, "this test"))
    found, expected = plant_verdict(subject, case), run_case(alone, case).verdict
    assert expected.status == SURVIVED
    assert found.status == expected.status
    for name in ("recovery_s", "peak_pu", "first_peak_pu", "limited_s", "swing_rad"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-6, abs=1e-9), name


def test_side_by_side_and_one_after_the_other(subject: Subject) -> None:
    """Plants that share a loop have the verdicts of runs of their own, also where these alone have the words."""
    groups: dict[str, list[SurvivalCase]] = {}
    for one in plant_set(fixed_set(), 2):
        groups.setdefault(one.group, []).append(one)
    names = "jump down", "phase 90–180°", "sag with trip", "reference", "wrong estimate", "sag with loss of a unit"
    cases = [groups[name][len(groups[name]) // 2] for name in names]
    found = verdicts_of(subject, cases)
    assert {one.status for one in found} == {SURVIVED, NO_REST, OVER_LIMIT}
    for case, one in zip(cases, found, strict=True):
        alone = plant_verdict(subject, case)
        assert (one.status, one.reason) == (alone.status, alone.reason), case.group
        for name in ("recovery_s", "peak_pu", "first_peak_pu", "limited_s", "limited_at_end", "swing_rad"):
            expected = getattr(alone, name)
            close = expected if expected is None else pytest.approx(expected, rel=1e-6, abs=1e-9)
            assert getattr(one, name) == close, (case.group, name)


def test_dc_links_side_by_side_and_one_after_the_other() -> None:
    """Half of the source of every unit is lost: what is left gives the power, or it does not."""
    source = {"p_max": "12 kW", "p_charge_max": "12 kW", "tau": "2 ms"}
    dc = {"source": "converter", "C": "2 mF", "converter": source}
    found = load_study("studies/plant/study.toml").with_changes(plant={"units": 2}, events=[], dc=dc)
    study = replace(found, controllers=(replace(found.controllers[0], schedule="closed_form"),))
    subject = subjects_of(study, Ready(), limiters=None)["table"]
    some = [one for one in survival_cases(study, random=False) if one.group == "dc source"]
    cases = [next(one for one in some if one.start.P_pu < 0.45), next(one for one in some if one.start.P_pu > 0.8)]
    together = verdicts_of(subject, cases)
    assert [one.status for one in together] == [SURVIVED, NO_REST]
    for case, one in zip(cases, together, strict=True):
        alone = plant_verdict(subject, case)
        assert (one.status, one.reason) == (alone.status, alone.reason)
        assert one.peak_pu == (alone.peak_pu if alone.peak_pu is None else pytest.approx(alone.peak_pu, rel=1e-6))


def test_units_whose_full_batteries_are_pushed_are_told_so() -> None:
    """Without power at the start, a jump of the phase pushes back what no unit can take."""
    found = load_study("studies/plant/study.toml")
    c = found.converter
    V, S = c.V_dc, c.S_rated
    battery = {"R_i": 0.05 * V * V / S, "i_max": 1.5 * S / V, "capacity_Ah": S / V, "charge": 1.0}
    dc = {"source": "battery", "C": 0.04 * S / V**2, "control": "power_clamp", "battery": battery}
    dc["battery"] |= {"open_circuit": [(1.03 + 0.02 * k) * V for k in range(6)]}
    found = found.with_changes(plant={"units": 2}, events=[], dc=dc)
    study = replace(found, controllers=(replace(found.controllers[0], schedule="closed_form"),))
    subject = subjects_of(study, Ready(), limiters=None)["table"]
    some = [one for one in survival_cases(study, random=False) if one.largest_phase_deg == 60.0]
    cases = [replace(one, start=replace(one.start, P_pu=0.02)) for one in some if one.start.P_pu == 0.5][:2]
    first, second = sorted(verdicts_of(subject, cases), key=lambda one: one.status)
    assert (first.status, second.status) == (NO_REST, SURVIVED)
    assert str(first.reason).startswith("unit1: not possible, because the events move ")


def test_the_loss_of_a_unit(subject: Subject) -> None:
    """What is asked of those that are left is asked at the rest of one; a plant of one has none to lose."""
    cases = [one for one in plant_set(fixed_set(), 2) if one.group == "loss of a unit"]
    case = next(one for one in cases if (one.start.scr, one.start.P_pu) == (2.0, 0.3))
    assert case.changes[0].element in ("unit1", "unit2")
    assert "is lost" in case.name
    assert plant_verdict(subject, case).status == SURVIVED
    hopeless = replace(case, start=replace(case.start, scr=0.3, P_pu=-0.7), knowledge=GridKnowledge())
    found = plant_verdict(subject, hopeless)
    assert found.status == NO_REST
    assert "before the event" in (found.reason or "")
    assert not any(one.group.endswith("loss of a unit") for one in plant_set(fixed_set(), 1))
    assert tuple(plant_set(fixed_set(), 2))[: len(fixed_set())] == tuple(fixed_set())


def test_what_a_plant_does_not_have(study: Study) -> None:
    learns = replace(study, controllers=(replace(study.controllers[0], estimate="field"),))
    with pytest.raises(StudyError, match="2 faults") as error:
        subjects_of(learns, Ready(), bridge="pwm")
    assert len(error.value.faults) == 2


def test_fixed_gains_stay_whatever_the_grid_of_a_case_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are made for what a unit sees in the study, also in the cases of survive and verify, which draw grids."""
    plant, controllers = {"units": 2}, [{"name": "fixed", "kind": "fixed"}]
    fixed = load_study("studies/plant/study.toml").with_changes(plant=plant, events=[], controllers=controllers)
    seen, given = as_unit(fixed, "this test").grid, list[Study]()

    def run_many(subjects: Mapping[str, Subject], *_: object, **__: object) -> None:
        given.extend(one.study for one in subjects.values())
        raise KeyboardInterrupt

    monkeypatch.setattr(campaigns_survival, "run_many", run_many)
    with pytest.raises(KeyboardInterrupt):
        report_survival(fixed, tmp_path / "out", Asked(limiters=None))
    given.append(prepared_job(fixed, verify.Asked(runs=2), tmp_path / "verified")[0].study)
    assert fixed.controllers[0].design_grid is None
    assert [one.controllers[0].design_grid for one in given] == [seen, seen]
