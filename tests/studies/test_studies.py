"""Every study that comes with the project validates, runs, and is explained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.network_weights import NetworkWeights
from vsgdesign.artifacts.ready import Ready
from vsgdesign.design.table import build_table
from vsgdesign.estimator.recipes import CONTINUOUS
from vsgdesign.estimator.specification import WINDOW_NETWORK, train
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.units.scenario import run_plant
from vsgdesign.study.parameters import Study, load_study

STUDIES = Path(__file__).resolve().parents[2] / "studies"
FILES = sorted(STUDIES.glob("*/study.toml"))
PLANTS = "plant", "ten_buses"
"""Studies of several converters, which :func:`vsgdesign.simulation.units.scenario.run_plant` runs."""


def name(path: Path) -> str:
    return path.parent.name


def test_there_are_studies() -> None:
    assert {"published", "published_averaged", "continuous", "laboratory", "utility"} <= {name(path) for path in FILES}


@pytest.mark.parametrize("path", FILES, ids=name)
def test_it_validates_under_its_folders_name(path: Path) -> None:
    study = load_study(path)
    assert study.name == path.parent.name
    assert study.title != study.name
    assert study.controllers
    assert study.events


@pytest.mark.parametrize("path", FILES, ids=name)
def test_it_has_a_readme(path: Path) -> None:
    readme = path.parent / "README.md"
    assert readme.is_file()
    assert len(readme.read_text(encoding="utf-8").split()) > 30


def shortened(study: Study, duration: float) -> Study:
    """The same study with all its events squeezed into a shorter run."""
    T_s = study.converter.T_s
    share = duration / study.simulation.duration
    events = tuple(
        replace(event, t_s=round(event.t_s * share / T_s) * T_s, over=event.over * share) for event in study.events
    )
    return replace(study, simulation=replace(study.simulation, duration=duration), events=events)


def small_tables(study: Study, folder: Path) -> dict[str, GainTable]:
    """Tables of two by two nodes where a study asks for tables: enough to run, not to promise anything."""
    if study.specification is None:
        return {}
    c = study.converter
    load = {"P": (0.4 * c.S_rated,), "Q": (0.1 * c.S_rated,)}
    box = replace(study.specification.box, error_R=0.0, error_X=0.0, **load)
    small = replace(study, specification=replace(study.specification, scr=(4.0, 8.0), x_over_r=(3.0, 5.0), box=box))
    return {
        spec.name: build_table(small, spec, folder, smoothings=0, refinements=0, points=20, certificate=False).table
        for spec in study.controllers
        if spec.schedule == "table"
    }


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Finished cells of all studies, found by the hash of what decides them: equal ones are designed once."""
    return tmp_path_factory.mktemp("cells")


@pytest.fixture(scope="module")
def network() -> NetworkWeights:
    """A network from few windows: good enough to run, not to promise anything."""
    study = load_study(STUDIES / "continuous" / "study.toml")
    recipe = replace(CONTINUOUS, scenarios=40, bridge="averaged")
    return train(WINDOW_NETWORK, study, recipe, size={"starts": 1}).weights


@pytest.mark.parametrize("path", [path for path in FILES if name(path) not in PLANTS], ids=name)
def test_every_controller_goes_through_every_event(path: Path, cells: Path, network: NetworkWeights) -> None:
    """Two seconds of it: nothing diverges, the current stays within what the converter could carry."""
    study = shortened(load_study(path), 2.0)
    result = run_scenario(study, Ready(tables=small_tables(study, cells), network=network))
    assert len(result.controllers) == len(study.controllers)
    for controller in result.controllers:
        for values in controller.series.values():
            assert np.isfinite(values).all()
        assert {event.name for event in controller.events} == {event.name for event in study.events}
        for event in controller.events:
            assert event.peak_current_pu is not None
            assert event.peak_current_pu < 5.0


def test_every_unit_of_a_plant_goes_through_every_event() -> None:
    """With the closed form: a table of a plant takes minutes to design."""
    study = shortened(load_study(STUDIES / "plant" / "usual.toml"), 2.0)
    result = run_plant(study, Ready())
    for controller in result.controllers:
        assert len(controller.units) == 4
        for unit in controller.units:
            assert all(np.isfinite(values).all() for values in unit.series.values())
            assert {event.name for event in unit.events} == {event.name for event in study.events}


def test_the_averaged_study_is_the_published_one_but_for_bridge_and_estimate() -> None:
    switched, averaged = (load_study(STUDIES / name / "study.toml") for name in ("published", "published_averaged"))
    assert averaged.simulation == replace(switched.simulation, bridge="averaged")
    assert averaged.controllers == tuple(c for c in switched.controllers if c.estimate == "truth")
    assert averaged.events == switched.events
