"""A node keeps its promises for all true grids on the table's edge that may be looked up at it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from tests.design.robust_studies import controller, law, specification, with_specification
from vsgdesign.design import record as recording
from vsgdesign.design.box import Scenarios, joined, scenarios_of_estimate, scenarios_on_edge
from vsgdesign.design.cell import CellDesign
from vsgdesign.design.evaluation import LawOfStudy, evaluate, shortfalls, worst
from vsgdesign.design.record import CellRecord, CellTask, run_task
from vsgdesign.design.search import variables
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import Place

EASY = {"settling_time": 2.0, "overshoot": 0.2, "disk_margin": 0.8, "damping_ratio": 0.4, "H_min": 0.0}
NODE = (3.0, 3.0)


def study_with(**changes: float) -> Study:
    """A table from SCR 3 to 6 and X/R 1 to 3."""
    return with_specification(**EASY | changes)


def centre(study: Study) -> np.ndarray:
    """y of the closed form for 1.2 s."""
    gains = NormalisedGains(15.8 / 1.2**2, 6.6 / 1.2, 4.0 / 1.2, 0.01, 1.0, 1.0)
    return variables(law(study).structure, specification(study)).of(gains)


def scenarios_at(study: Study, node: tuple[float, float]) -> tuple[Scenarios, Scenarios]:
    """What a node is designed for, and the rest of the table's edge."""
    target = controller(study).target
    arguments = study, specification(study), *node, target.P, target.Q
    return scenarios_of_estimate(*arguments), scenarios_on_edge(*arguments)


def design_of(study: Study, y: np.ndarray, s: Scenarios) -> CellDesign:
    """A design without a search, with its figures over ``s``."""
    spec, of = specification(study), law(study)
    normalised = NormalisedGains(*(float(value) for value in variables(of.structure, spec).normalised(y)))
    one = NormalisedGains(*(np.array([value]) for value in normalised))
    figures = worst(evaluate(of, one, s, spec.settling_time))
    return CellDesign(
        normalised=normalised,
        figures=figures,
        inertia=5.0,
        active="",
        price=0.0,
        shortfalls=shortfalls(spec, figures, 5.0),
        scenarios=len(s),
        iterations=0,
    )


def run(study: Study, monkeypatch: pytest.MonkeyPatch) -> tuple[CellRecord, list[int]]:
    """The record of ``NODE`` with given designs for found ones: a better damped one where more than the usual scenarios
    are asked for. With the numbers of scenarios that were asked for."""
    y = centre(study)
    usual, asked = len(scenarios_at(study, NODE)[0]), []

    def designs(task: CellTask, of: LawOfStudy, s: Scenarios, _shares: tuple[float, ...]) -> Iterator[CellDesign]:
        asked.append(len(s))
        damped = y.copy()
        damped[variables(of.structure, task.spec).names.index("d_1_or_zeta")] += 0.2 * (len(s) > usual)
        yield design_of(task.study, damped, s)

    monkeypatch.setattr(recording, "designs_of", designs)
    spec = specification(study)
    task = CellTask(
        study=study, target=controller(study).target, spec=spec, scr=3.0, x_over_r=3.0, centre=tuple(y), seed=0
    )
    return run_task(task), asked


def test_a_design_that_keeps_its_promises_on_the_edge_stays_and_its_figures_say_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    study = study_with()
    record, asked = run(study, monkeypatch)
    s, edge = scenarios_at(study, NODE)
    assert record.design is not None
    alone, whole = (design_of(study, centre(study), one) for one in (s, joined([s, edge])))
    assert asked == [len(s)]
    assert record.design.normalised == alone.normalised
    assert record.missed == {}
    assert record.design.figures == whole.figures != alone.figures
    assert record.design.scenarios == whole.scenarios


def test_a_design_that_breaks_a_promise_on_the_edge_is_made_again_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The damping ratio is 0.83 for the usual scenarios and 0.80 for the others."""
    study = study_with(damping_ratio=0.81)
    s, edge = scenarios_at(study, NODE)
    alone, whole = (design_of(study, centre(study), one) for one in (s, joined([s, edge])))
    assert alone.met
    assert set(whole.shortfalls) == {"damping_ratio"}
    record, asked = run(study, monkeypatch)
    assert asked == [len(s), len(s) + len(edge)]
    assert record.missed == {}
    assert record.design is not None
    assert record.design.figures.damping_ratio >= 0.81


def test_a_grid_on_the_edge_whose_estimate_is_a_node_is_known_there() -> None:
    """R is 14 % more than at the node (SCR 3, X/R 1) and the SCR the same: R̂ is 12 % less and X̂ 19 % more than the true
    ones. Of the usual scenarios, none has so much."""
    study = with_specification(scr=(3.0, 6.0), x_over_r=(0.3, 3.0))
    usual, edge = scenarios_at(study, (3.0, 1.0))
    c, f = study.converter, study.filter
    node = Place(3.0, 1.0, "impedance").grid(c)
    R = 1.14 * node.R_g
    X = np.sqrt((c.Z_base / 3.0) ** 2 - R**2)
    assert abs(c.omega_n * node.L_g / X - 1.0) < 0.2
    assert (usual.R - f.R_2).max() < R
    assert (edge.R - f.R_2).max() > R


def test_a_node_far_from_the_edge_has_no_others() -> None:
    study = with_specification(scr=(1.2, 20.0), x_over_r=(0.3, 20.0))
    assert len(scenarios_at(study, (5.0, 2.0))[1]) == 0


def test_a_node_for_exact_estimates_has_no_others() -> None:
    assert len(scenarios_at(with_specification(error_R=0.0, error_X=0.0), NODE)[1]) == 0
