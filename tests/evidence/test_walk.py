"""One value for each definition: what a study's documents say of the same quantity at the same place.

``python -m evidence same_figures`` walks the files of all verbs for three studies. Here the documents of one small
study with a table of four nodes are made without drawing anything.
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import pytest

from evidence._walk import Fact, Walk, csv_rows, differences, said
from vsgdesign.artifacts import read_table_file
from vsgdesign.artifacts.definitions import DEFINITIONS, FULL_ORDER, REDUCED
from vsgdesign.artifacts.gain_table_file import table_document
from vsgdesign.artifacts.ready import Ready
from vsgdesign.artifacts.time_series import write_table
from vsgdesign.design.comparison import Compared, Comparison, compare_on_grids, contender_of
from vsgdesign.export.c_code import export_c_files
from vsgdesign.linear.stability.assessment import map_header, map_rows
from vsgdesign.report.explore.linear import linear_answer
from vsgdesign.report.explore.state import state_of
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.stability_result import maps_of
from vsgdesign.study.parameters import load_study
from vsgdesign.verbs.pipeline.comparison import CSV_HEADER, comparison_document
from vsgdesign.verbs.pipeline.comparison import csv_rows as compared_rows
from vsgdesign.verbs.pipeline.margins import assess_study, stability_document
from vsgdesign.verbs.pipeline.results import results_document

WALK = Path(__file__).parent / "walk"


@pytest.fixture(scope="module")
def facts(tmp_path_factory: pytest.TempPathFactory) -> list[Fact]:
    """What every document says."""
    folder, study = tmp_path_factory.mktemp("walk"), load_study(WALK / "study.toml")
    spec, table = study.controllers[0], read_table_file(WALK / "table.json")
    ready, asked = Ready(tables={spec.name: table}), study.specification
    assert asked is not None
    walk = Walk(study, {table.name: spec.name})
    walk.table(json.loads((WALK / "table.json").read_text(encoding="utf-8")), "table")
    walk.table(table_document(table), "table show")
    export_c_files(WALK / "table.json", folder / "c")
    walk.c_data((folder / "c" / "vsg_data.c").read_text(encoding="utf-8"), spec.name, "C")

    assessed = assess_study(study, ready, evidence=False)
    walk.assessed(stability_document(assessed), "margins")
    maps = maps_of(assessed.assessments[0])
    for kind, model in (("reduced", REDUCED), ("full_order", FULL_ORDER)):
        write_table(folder / f"{kind}.csv", map_header(maps[kind]), map_rows(maps[kind]))
        walk.map(csv_rows(folder / f"{kind}.csv"), spec.name, model, f"map, {kind}")

    grids = list(itertools.product(asked.scr, asked.x_over_r))
    contender = contender_of(study, spec, ready)
    compared = Comparison(
        study=study,
        specification=asked,
        scr=asked.scr,
        x_over_r=asked.x_over_r,
        contenders=(Compared(contender, compare_on_grids(study, asked, contender, grids)),),
        outside=(),
        seed=0,
    )
    walk.compared(comparison_document(compared), "compare")
    write_table(folder / "comparison.csv", CSV_HEADER, compared_rows(compared))
    walk.compared_rows(csv_rows(folder / "comparison.csv"), "comparison.csv")

    run = results_document(run_scenario(study, ready), {})
    walk.run(run, "run")
    places = [(*grid, study.target.P, study.target.Q) for grid in grids]
    for rest in run["operating_points"]:
        grid = study.grid if rest["t_s"] < 2.5 else study.events[-1].grid
        assert grid is not None
        at = grid.place(study.converter, study.scr_basis)
        places.append((at.scr, at.x_over_r, rest["P"], rest["Q"]))
    for scr, ratio, P, Q in places:
        S = study.converter.S_rated
        state = state_of({"scr": scr, "x_over_r": ratio, "P_pu": P / S, "Q_pu": Q / S}, study)
        walk.explorer(linear_answer(study, ready, state).header, scr, ratio, "explorer")
    return walk.facts


def test_the_same_quantity_has_one_value_in_all_documents(facts: list[Fact]) -> None:
    found, several = differences(facts)
    assert not found, "\n".join(said(found))
    assert several > 250


@pytest.mark.parametrize("quantity", ["disk_margin_output", "decay_1_s", "K_ip", "H_s", "node k_1"])
def test_a_difference_of_a_millionth_is_found(facts: list[Fact], quantity: str) -> None:
    k, fact = next(
        (k, fact) for k, fact in enumerate(facts) if fact.quantity == quantity and fact.file not in ("table", "run")
    )
    changed = [*facts[:k], fact._replace(value=fact.value * (1.0 + 1e-6)), *facts[k + 1 :]]
    found, _ = differences(changed)
    assert {one.quantity for one in found} == {quantity}


def test_margins_and_damping_are_called_by_their_definitions(facts: list[Fact]) -> None:
    """``compare`` wrote ``damping_ratio`` for the power loops and for all modes of one grid: 0.841 and 0.740."""
    margins = {one.quantity for one in facts if "disk_margin" in one.quantity or "damping" in one.quantity}
    names = {name.removeprefix("worst_").removesuffix("_rad_s") for name in margins}
    titles = {one.title for one in DEFINITIONS.values()}
    assert names - titles <= DEFINITIONS.keys()
    assert {"disk_margin_output", "damping_power_loops", "damping_all_modes"} <= names
