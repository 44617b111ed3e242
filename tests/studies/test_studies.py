"""Every study that comes with the project validates, runs, and is explained."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.design.table import build_table
from vsgdesign.parameters import Study, load_study
from vsgdesign.simulation import run_scenario

STUDIES = Path(__file__).resolve().parents[2] / "studies"
FILES = sorted(STUDIES.glob("*/study.toml"))


def name(path: Path) -> str:
    return path.parent.name


def test_there_are_studies() -> None:
    assert {"published", "published_pwm", "laboratory", "utility"} <= {name(path) for path in FILES}


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


def with_small_tables(study: Study, folder: Path) -> Study:
    """The study with tables of two by two nodes where it asks for tables: enough to run, not to promise anything."""
    if study.specification is None:
        return study
    small = replace(study, specification=replace(study.specification, scr=(2.0, 8.0), x_over_r=(1.0, 2.0)))
    controllers = tuple(
        replace(spec, table=build_table(small, spec, folder / spec.name, refinements=0).table)
        if spec.schedule == "table"
        else spec
        for spec in study.controllers
    )
    return replace(study, controllers=controllers)


@pytest.mark.parametrize("path", FILES, ids=name)
def test_every_controller_goes_through_every_event(path: Path, tmp_path: Path) -> None:
    """Two seconds of it: nothing diverges, the current stays within what the converter could carry."""
    study = with_small_tables(shortened(load_study(path), 2.0), tmp_path)
    result = run_scenario(study)
    assert len(result.controllers) == len(study.controllers)
    for controller in result.controllers:
        for values in controller.series.values():
            assert np.isfinite(values).all()
        assert {event.name for event in controller.events} == {event.name for event in study.events}
        assert max(event.peak_current_pu for event in controller.events) < 5.0


def test_the_switched_study_is_the_published_one_but_for_the_bridge() -> None:
    averaged, switched = (load_study(STUDIES / name / "study.toml") for name in ("published", "published_pwm"))
    assert switched.simulation == replace(averaged.simulation, bridge="pwm")
    assert (switched.controllers, switched.events) == (averaged.controllers, averaged.events)
    own = tomllib.loads((STUDIES / "published_pwm" / "study.toml").read_text(encoding="utf-8"))
    assert set(own) == {"base", "study", "simulation"}
