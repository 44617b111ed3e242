"""Draws that a converter cannot run: drawn again, counted, reported, and a recipe that is mostly impossible refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.estimator.data_set import REASONS, read_data_set
from vsgdesign.estimator.recipes import CONTINUOUS, PUBLISHED, WIDE
from vsgdesign.estimator.scenarios import check_draws, describe_draws, draw_scenario, why_not
from vsgdesign.estimator.specification import WINDOW_NETWORK, generate
from vsgdesign.linear.operating_point import solve_operating_point
from vsgdesign.linear.operating_point.sampled import steady_state
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.ranges import log_uniform, one_of, uniform

TEXT = """
base = "case:{case}"
simulation = {{ duration = "1 s", P_ref = 0, Q_ref = 0 }}
controllers = [{{ name = "a", kind = "scheduled" }}]
{more}
"""


def study(case: str, more: str = "") -> Study:
    return study_from_text(TEXT.format(case=case, more=more))


UTILITY = study("utility_1mva_60hz")
FEW = replace(CONTINUOUS, name="few", bridge="averaged", scenarios=20, before=1, after=1, every=1)


def test_what_is_kept_can_be_run_and_what_was_thrown_away_is_counted(tmp_path: Path) -> None:
    """By its own steady state, before and after the change; counts do not depend on how the work is shared out."""
    counts = np.zeros(len(REASONS), dtype=int)
    for index in range(20):
        scenario = draw_scenario(UTILITY, FEW, 3, index)
        for grid, gains, refs in zip(scenario.grids, scenario.gains, scenario.references, strict=True):
            steady_state(UTILITY, grid, scenario.source, UTILITY.converter.references(*refs), gains)
        assert scenario.seed == (3, index, sum(scenario.redrawn))
        counts += scenario.redrawn
    data = generate(WINDOW_NETWORK, UTILITY, FEW, 3, out=tmp_path / "w.npz")
    thrown = {name: int(count) for name, count in zip(REASONS, counts, strict=True) if count}
    assert "bridge voltage" in thrown
    assert data.draws == {"scenarios": 20, "draws": 20 + sum(thrown.values()), "thrown_away": thrown}
    assert read_data_set(tmp_path / "w.npz").draws == data.draws
    said = describe_draws(data.draws)
    assert f"drawn again: {sum(thrown.values())} of {data.draws['draws']} draws" in said
    assert "need more voltage than the bridge makes" in said


def test_nothing_is_thrown_away_of_the_published_recipes() -> None:
    published = study("hoang2025_5kva")
    for recipe in (PUBLISHED, CONTINUOUS):
        assert all(sum(draw_scenario(published, recipe, 0, k).redrawn) == 0 for k in range(60))
    assert describe_draws({"scenarios": 60, "draws": 60, "thrown_away": {}}) == ""
    one = {"scenarios": 60, "draws": 63, "thrown_away": {"bridge voltage": 1, "voltage limits": 2}}
    assert describe_draws(one).endswith("1 needs more voltage than the bridge makes, 2 leave V_min_pu to V_max_pu")


@pytest.mark.parametrize(
    ("reason", "case", "change", "more"),
    [
        ("no operating point", "utility_1mva_60hz", {"Q_pu": one_of(-0.4), "scr": uniform(1.0, 3.0)}, ""),
        ("bridge voltage", "utility_1mva_60hz", {"Q_pu": one_of(0.5), "scr": uniform(1.2, 6.0)}, ""),
        ("current", "utility_1mva_60hz", {"P_pu": uniform(0.3, 1.6), "scr": uniform(15.0, 20.0)}, ""),
        ("voltage limits", "utility_1mva_60hz", {"within_V_limits": True}, "[converter]\nV_max_pu = 1.1"),
        # The published inner gains are unstable on a stiff grid without resistance (SCR 20, X/R 20).
        ("unstable", "hoang2025_5kva", {"scr": uniform(10.0, 20.0), "x_over_r": log_uniform(5.0, 30.0)}, ""),
    ],
)
def test_every_reason_is_told(reason: str, case: str, change: dict[str, Any], more: str) -> None:
    recipe, converter = replace(FEW, **change), study(case, more)
    counts = np.sum([draw_scenario(converter, recipe, 0, k).redrawn for k in range(15)], axis=0)
    assert counts[REASONS.index(reason)] > 0
    assert counts[REASONS.index(reason)] == counts.max()


def test_voltage_limits_hold_for_what_is_kept() -> None:
    for index in range(30):
        scenario = draw_scenario(UTILITY, WIDE, 1, index)
        low, high = UTILITY.converter.V_limits_rms
        for grid, gains, (P_ref, Q_ref) in zip(scenario.grids, scenario.gains, scenario.references, strict=True):
            state = steady_state(
                UTILITY, grid, scenario.source, UTILITY.converter.references(P_ref, Q_ref), gains
            ).controller
            point = solve_operating_point(
                state.P_f, state.Q_f, scenario.source.V_g_rms, *UTILITY.path_to_grid(grid, scenario.source.omega_g)
            )
            assert low * (1.0 - 1e-3) <= point.V_rms <= high * (1.0 + 1e-3)


def test_a_recipe_that_is_mostly_impossible_names_the_field() -> None:
    weak = replace(FEW, scr=log_uniform(0.6, 3.0), Q_pu=uniform(-0.6, -0.3), scenarios=500)
    with pytest.raises(InfeasibleStudyError) as caught:
        check_draws(UTILITY, weak, 0)
    text = str(caught.value)
    assert text.startswith("recipe few: ")
    assert "scenarios cannot be run on this converter" in text
    assert "scr decides most: " in text
    assert "% of the draws up to" in text
    assert "Raise the low end of scr" in text
    with pytest.raises(InfeasibleStudyError, match="cannot be run"):
        generate(WINDOW_NETWORK, UTILITY, weak, 0)


def test_why_not_says_what_the_converter_lacks() -> None:
    at_rest = replace(FEW, grid_step_share=0.0, P_pu=one_of(0.5), Q_pu=one_of(0.2), P_step_pu=one_of(0.0))
    assert why_not(UTILITY, replace(at_rest, scr=one_of(8.0)), 0) == ""
    assert "more voltage than the bridge makes" in why_not(UTILITY, replace(at_rest, scr=one_of(1.2)), 0)
    assert "cannot carry" in why_not(UTILITY, replace(at_rest, scr=one_of(0.8), Q_pu=one_of(-0.4)), 0)
