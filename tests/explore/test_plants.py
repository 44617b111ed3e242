"""The explorer of a plant: one unit behind its transformer, with what the units do against each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.report.explore.linear import linear_answer
from vsgdesign.report.explore.maps import map_cells, quick_figures
from vsgdesign.report.explore.scene import shown_of
from vsgdesign.report.explore.session import session_from
from vsgdesign.simulation.units.scenario import run_plant
from vsgdesign.study.parameters import study_from_text
from vsgdesign.verbs.pipeline.one_unit import written_as_unit

TEXT = """
base = "case:hoang2025_5kva"
[power_loops]
structure = "angle_damped"
settling_time = "0.3 s"
[grid]
scr = 5
x_over_r = 5
[plant]
units = 3
reactance = 0.04
resistance = 0.01
[specification]
settling_time = "1.3 s"
P = ["-4 kW", "4 kW"]
Q = ["-1 kvar", "1 kvar"]
[simulation]
duration = "20 ms"
P_ref = "1.5 kW"
Q_ref = "0 var"
[[controllers]]
name = "damped"
kind = "scheduled"
"""


@pytest.mark.parametrize(("scr", "stable"), [(1.5, False), (80.0, True)])
def test_the_units_against_each_other(scr: float, stable: bool) -> None:
    """Gains for a weak grid let them grow, though the unit alone is stable there: as in the model of the whole
    plant."""
    study = study_from_text(TEXT)
    session = session_from(written_as_unit(study, "this test"), Ready())
    state = session.state({"scr": scr, "x_over_r": 5.0})
    row = linear_answer(session.study_of(state), Ready(), state).header["controllers"][0]
    assert row["decay"] > 0.0
    assert row["stable"] is stable
    split = run_plant(study.with_changes(grid={"scr": scr})).controllers[0].rests[0].split
    assert split is not None
    s = split.differential[0].s.real
    said = row["note"] if stable else row["why"]
    assert f"{'decay' if stable else 'grow'} with {abs(s):.2g} 1/s" in said
    one = shown_of(session.study_of(state), Ready(), state)[-1]
    found = quick_figures(one.study, map_cells(one, state, np.array([scr]), np.array([5.0])), "decay")
    assert found.stable.tolist() == [stable]
    # The page has P and Q themselves, and the plant's Q follows its droop.
    assert found.values[0] == pytest.approx(min(row["decay"], -s), rel=0.05)


def test_a_plant_with_more_than_equal_units() -> None:
    study = study_from_text(TEXT)
    assert study.plant is not None
    first, *others = study.plant.units
    unequal = replace(study, plant=replace(study.plant, units=(replace(first, P_ref=0.0), *others)))
    with pytest.raises(InfeasibleStudyError, match="equal units at one node"):
        written_as_unit(unequal, "vsgdesign explore")
