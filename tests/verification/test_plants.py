"""Random cases of a plant: what is drawn, and that a case of a batch is the same as a run of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import UNIFORMS, cases_of, families, uniforms_of
from vsgdesign.campaigns.verification.plants import ALL, OF_PLANT, PLANTS, PlantCases, draw_plants, plants_of, run_drawn
from vsgdesign.campaigns.verification.worst import what_of
from vsgdesign.errors import StudyError
from vsgdesign.simulation.lanes.results import JUDGED
from vsgdesign.simulation.units.timeline import plant_timeline
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.verify import Asked, check_verifiable

ROOT = Path(__file__).resolve().parents[2]

PLANT = """
base = "{root}/studies/plant/study.toml"

[study]
name = "two"
title = "Two"

[power_loops]
structure = "angle_damped"
P_droop = "5 %"
Q_droop = "5 %"
settling_time = "0.2 s"

[plant]
units = [1, 3]
reactance = 0.06
resistance = 0.006

[verification]
scr = [6, 20]
silent = [0.02, 0.1]
more_reactance = [0.0, 0.02]

[[controllers]]
name = "closed_form"
kind = "scheduled"
update_period = "20 ms"

[[events]]
time = "1 s"
P_ref = "7 kW"
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """Up to three equal units with a quick closed form."""
    file = tmp_path_factory.mktemp("plant") / "study.toml"
    file.write_text(PLANT.format(root=ROOT.as_posix()), encoding="utf-8")
    return load_study(file)


def drawn(study: Study, count: int = 400) -> tuple[PlantCases, np.ndarray]:
    """The first cases of a study."""
    return draw_plants(study, study.controllers[0], 0, count)


def test_every_number_of_units_is_drawn_as_often_and_a_loss_leaves_one(plant: Study) -> None:
    cases, family = drawn(plant)
    loss = family == families().index("loss")
    assert set(cases.units[~loss].tolist()) == {1, 2, 3}
    assert set(cases.units[loss].tolist()) == {2, 3}
    assert np.abs(np.bincount(cases.units[~loss])[1:] / (~loss).sum() - 1 / 3).max() < 0.08
    assert (cases.who < cases.units).all()
    assert (cases.who[loss] >= 0).all()
    assert set(cases.who[family == families().index("step")].tolist()) > {ALL, 0}


def test_the_mean_of_the_units_is_the_case_of_one_converter(plant: Study) -> None:
    """With all units on line a unit sees the grid that is drawn; with fewer of them a share of it."""
    spec, unit = plant.controllers[0], plant_timeline(plant).units[0]
    numbers = uniforms_of(1, 0, 60, len(OF_PLANT))
    numbers[:, UNIFORMS] = 0.999
    cases, _ = plants_of(plant, spec, numbers, families().index("phase"))
    alone, _ = cases_of(unit, spec, numbers[:, :UNIFORMS], families().index("phase"))
    assert (cases.units == 3).all()
    for name in ("R_g", "L_g", "P_ref", "Q_ref", "V_g_rms", "silent_s"):
        np.testing.assert_allclose(getattr(cases, name), getattr(alone, name), rtol=1e-12)
    assert np.abs(cases.P_apart.sum(axis=1)).max() < 1e-9 * plant.converter.S_rated
    assert np.abs(cases.P_apart).max() <= 0.1 * plant.converter.S_rated
    numbers[:, UNIFORMS] = 0.0
    one, _ = plants_of(plant, spec, numbers, families().index("phase"))
    np.testing.assert_allclose(one.L_g, cases.L_g, rtol=1e-12)
    assert (one.units == 1).all()
    assert not one.P_apart.any()


@pytest.mark.parametrize(
    ("name", "bridge"),
    [
        ("loss", "averaged"),
        ("loss", "pwm"),
        ("step", "averaged"),
        ("grid", "averaged"),
        ("phase", "averaged"),
        ("sag", "averaged"),
        ("step", "pwm"),
        ("grid", "pwm"),
    ],
)
def test_a_case_as_a_study_has_the_figures_of_the_batch(plant: Study, tmp_path: Path, name: str, bridge: str) -> None:
    """Of the worst unit, with transformers that differ."""
    spec = plant.controllers[0]
    cases, family = drawn(plant, 60)
    case = np.flatnonzero((family == families().index(name)) & (cases.units > 1))[:1]
    some = cases.take(case)
    results = run_drawn(plant, spec, NOTHING, some, bridge=bridge)
    assert results.status.tolist() == [JUDGED]
    (tmp_path / "worst").mkdir()
    file = tmp_path / "worst" / "case.toml"
    file.write_text(PLANTS.written(plant, spec, NOTHING, some, 0, file, bridge), encoding="utf-8")
    again = PLANTS.simulated(file, NOTHING)
    assert len(again.figures) >= 2
    for figure, value in again.figures.items():
        assert getattr(results, figure)[0] == pytest.approx(value, rel=1e-9, abs=1e-9)
    assert (f"unit {some.who[0] + 1} is lost" in what_of(plant, some, 0)) == (name == "loss")


DC = """
[verification.dc_power]
weight = 1
size = [0.8, 0.95]
[verification.dc_charge]
weight = 1
size = [0.0, 1.0]

[dc]
source = "battery"
C = "2 mF"
control = "CONTROL"
[dc.battery]
R_i = "0.3 ohm"
i_max = 24
capacity_Ah = 0.5
charge = 0.5
"""


@pytest.fixture(scope="module", params=["none", "power_clamp"])
def linked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Study:
    """The same units, each with a battery of its own."""
    file = tmp_path_factory.mktemp("linked") / "study.toml"
    file.write_text(PLANT.format(root=ROOT.as_posix()) + DC.replace("CONTROL", request.param), encoding="utf-8")
    return load_study(file)


def test_links_that_move_have_averaged_bridges(linked: Study) -> None:
    with pytest.raises(StudyError, match="a dc link that moves has an averaged bridge in a plant"):
        check_verifiable(linked, Asked(bridge="pwm"))


@pytest.mark.parametrize("name", ["dc_power", "phase", "step"])
def test_a_case_with_dc_links_has_the_figures_of_the_batch(linked: Study, tmp_path: Path, name: str) -> None:
    """Of the worst unit, where all units lose a share of their source, where one does, and where it is not touched."""
    test_a_case_as_a_study_has_the_figures_of_the_batch(linked, tmp_path, name, "averaged")
