"""Cases in backgrounds and with sensors of their own: as drawn, as study files, and what cannot be judged."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.gain_tables import table
from tests.simulation.lanes.test_learning import AROUND, WANDERING
from tests.simulation.survival.subjects import TEXT
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.counting import count_block
from vsgdesign.campaigns.verification.draws import FAMILIES, cases_of, uniforms_of
from vsgdesign.campaigns.verification.emt import EMT
from vsgdesign.errors import StudyError
from vsgdesign.simulation.lanes.results import IN_NOISE, JUDGED, LaneResults
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.verify import Asked, check_verifiable, job_of, verified_table

KINDS = ("step", "grid", "sag", "ramp")


def a_study(around: str) -> Study:
    text = TEXT.replace('kind = "scheduled"', 'kind = "scheduled"\nsettling_time = 0.1', 1)
    study = study_from_text(text + around)
    return replace(study, controllers=study.controllers[:1])


@pytest.mark.parametrize(("around", "kinds"), [(AROUND, KINDS), (WANDERING, KINDS[:1])], ids=["distorted", "wandering"])
def test_a_run_of_the_file_has_the_figures_of_the_batch(around: str, kinds: tuple[str, ...], tmp_path: Path) -> None:
    """A run of its own knows no lanes, and judges its log of every sample."""
    study = a_study(around)
    spec, families = study.controllers[0], np.array([FAMILIES.index(name) for name in kinds])
    cases = cases_of(study, spec, uniforms_of(1, 0, len(kinds)), families)[0].later(0.15)
    found = run_lanes(study, spec, NOTHING, cases)
    for k, name in enumerate(kinds):
        path = tmp_path / f"{name}.toml"
        path.write_text(EMT.written(study, spec, NOTHING, cases, k, path, "averaged"), encoding="utf-8")
        figures = EMT.simulated(path, NOTHING).figures
        assert len(figures) == (2 if name == "step" else 5)
        for figure, value in figures.items():
            assert value == pytest.approx(getattr(found, figure)[k], abs=1e-9), (name, figure)


def test_every_case_has_a_draw_of_its_own() -> None:
    study = a_study(AROUND)
    job, _ = job_of(study, study.controllers[0], NOTHING, Asked(runs=8))
    cases, _ = job.drawn(0, 8)
    backgrounds, sensors = cases.around.backgrounds, cases.around.sensors
    assert backgrounds is not None
    assert sensors is not None
    assert len({one.phase for one in backgrounds}) == len({one.gain_errors for one in sensors}) == 8
    # What a background makes of voltage and frequency is in the case itself: both are the study's without it.
    assert {one.voltage_factor for one in backgrounds} == {1.0}
    factor = cases.V_g_rms / study.converter.V_rated_rms
    assert 0.95 <= factor.min() < factor.max() <= 1.05
    assert np.ptp(cases.omega_g) > 2.0 * math.pi * 0.01
    # The seed belongs to the case, whatever block it is drawn in, and to its first digits: a search changes the last.
    again, _ = job.drawn(5, 1)
    assert again.around.backgrounds == backgrounds[5:6]
    near = uniforms_of(job.study.verification.seed, 5, 1) * (1.0 + 1e-15)  # type: ignore[union-attr]
    assert job.cases_of(near, 0).around.sensors == sensors[5:6]
    assert (job.results_of(cases).status == JUDGED).any()


def test_the_file_of_a_case_repeats_its_surroundings(tmp_path: Path) -> None:
    study = a_study(AROUND)
    spec = study.controllers[0]
    cases, _ = cases_of(study, spec, uniforms_of(3, 0, 2), 0)
    again = study_from_text(EMT.written(study, spec, NOTHING, cases, 1, tmp_path / "case.toml", "averaged"))
    assert cases.around.backgrounds is not None
    assert cases.around.sensors is not None
    assert again.background is not None
    assert again.background.components == cases.around.backgrounds[1].components
    assert again.background.phase == cases.around.backgrounds[1].phase
    assert again.sensors is not None
    assert again.sensors.gain_errors == cases.around.sensors[1].gain_errors
    assert again.sensors.seed == cases.around.sensors[1].seed


@pytest.mark.parametrize(
    ("around", "said"),
    [(WANDERING, "wanders"), ('[sensors]\nlevel = "typical"\n', "rests beside the model")],
)
def test_what_leaves_no_rest_to_judge_by_is_refused(around: str, said: str, tmp_path: Path) -> None:
    study = a_study(around)
    with pytest.raises(StudyError, match=said):
        check_verifiable(study, Asked())
    with pytest.raises(StudyError, match=said):  # as a run with [verification] with_run does it
        verified_table(study, study.controllers[0], table(), 8, tmp_path)
    check_verifiable(a_study(AROUND), Asked())
    others = "".join(f"[verification.{name}]\nweight = 0\n" for name in ("grid", "phase", "sag"))
    check_verifiable(a_study(f"{around}{others}"), Asked())  # steps alone are judged beside their twins


def test_a_step_below_its_noise_is_left_out_and_its_noise_is_allowed() -> None:
    study = a_study(AROUND)
    job, _ = job_of(study, study.controllers[0], NOTHING, Asked(runs=3))
    cases, family = job.drawn(0, 3)
    cases, family = cases.take(np.zeros(3, dtype=np.intp)), np.zeros(3, dtype=np.int8)  # the same step three times
    results = LaneResults.of_none(3)
    results.status[:] = JUDGED, JUDGED, IN_NOISE
    most = next(p for p in job.promises if p.figure == "overshoot").most_of(cases.signal)[0]
    results.overshoot[:], results.settling_s[:], results.peak_pu[:] = most + 0.011, 0.05, 0.5
    results.noise[:] = 0.01, 0.012, 0.03
    drawn = {"names": FAMILIES, "promises": job.promises, "axes": job.axes, "converter": study.converter}
    counted = count_block(0, 0, cases, family, results, **drawn, instruction_set="any").families["step"]
    assert (counted.judged, counted.left_out) == (2, {"too small for its noise": 1})
    overshoot = counted.promises["overshoot"]
    assert (overshoot.broken, overshoot.noise) == (1, 0.012)
    assert [case.number for case in overshoot.worst] == [0, 1]
