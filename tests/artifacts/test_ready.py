"""What was designed and trained lies beside the study, by the name of its controller; what is missing is asked for."""

from __future__ import annotations

import pickle
from dataclasses import FrozenInstanceError, fields, replace
from multiprocessing.reduction import ForkingPickler

import numpy as np
import pytest

from tests.artifacts.networks import random_weights
from tests.design.robust_studies import controller, robust_study
from tests.gain_tables import table
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.stability.assessment import assess
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters.estimator import EstimatorSpec
from vsgdesign.study.parameters.study import ControllerSpec
from vsgdesign.verbs.pipeline import make_ready

TABLED = replace(controller(robust_study()), name="tabled", schedule="table")


def test_a_study_has_no_place_for_what_is_made_later() -> None:
    assert {f.name for f in fields(ControllerSpec)}.isdisjoint({"table", "weights"})
    assert "weights" not in {f.name for f in fields(EstimatorSpec)}


def test_a_table_belongs_to_the_controller_of_that_name() -> None:
    made = table()
    ready = NOTHING.with_table("tabled", made)
    assert ready.table(TABLED) is made
    assert ready.table(controller(robust_study())) is None  # takes its gains from no table, whatever lies there
    assert NOTHING.tables == {}  # a new object, the one before is as it was
    with pytest.raises(InfeasibleStudyError, match="controller other: its gain table is missing"):
        ready.table(replace(TABLED, name="other"))


def test_it_cannot_be_changed() -> None:
    tables = {"tabled": table()}
    ready = Ready(tables=tables)
    tables.clear()
    assert list(ready.tables) == ["tabled"]
    with pytest.raises(TypeError):
        ready.tables["other"] = table()  # type: ignore[index]
    with pytest.raises(FrozenInstanceError):
        ready.network = random_weights()  # type: ignore[misc]


def test_it_goes_to_other_processes() -> None:
    """Before: "cannot pickle 'mappingproxy' object"."""
    ready = Ready(tables={"tabled": table()})
    there = pickle.loads(ForkingPickler.dumps(ready))  # noqa: S301 - its own
    np.testing.assert_array_equal(there.tables["tabled"].scr, ready.tables["tabled"].scr)
    with pytest.raises(TypeError):
        there.tables["other"] = table()


@pytest.mark.parametrize(
    "ask",
    [
        lambda study: gain_law(study, TABLED),
        lambda study: run_scenario(replace(study, controllers=(TABLED,))),
        lambda study: assess(study, TABLED),
    ],
    ids=["gain_law", "run_scenario", "assess"],
)
def test_a_missing_table_is_asked_for_with_what_to_do(ask) -> None:
    with pytest.raises(InfeasibleStudyError, match="controller tabled: its gain table is missing") as caught:
        ask(robust_study())
    for way in ("vsgdesign run", "vsgdesign table build", 'table = "FILE.json"', "make_ready(study)"):
        assert way in str(caught.value)


def test_the_window_of_the_network_sets_the_pace_that_is_left_open() -> None:
    own, left_open = replace(TABLED, update_period=0.1), replace(TABLED, update_period=None)
    network = random_weights()
    period = network.window.samples * network.window.sample_interval
    assert Ready(network=network).update_period(left_open) == pytest.approx(period)
    assert Ready(network=network).update_period(own) == 0.1
    assert NOTHING.update_period(left_open) is None


def test_nothing_is_made_for_a_study_that_asks_for_nothing() -> None:
    assert make_ready(robust_study()) == NOTHING
