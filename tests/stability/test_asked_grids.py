"""Gates judge the grids that a study asks for, and no others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from vsgdesign.linear.stability.assessment import assess, map_rows
from vsgdesign.linear.stability.maps import NOT_ASKED
from vsgdesign.linear.stability.verdict import EVERY_CELL, FAIL, OWN, PASS, clause_matrix, left_out, worst_cases
from vsgdesign.report.stability.tables import worst_table
from vsgdesign.report.stability.verdict import gates_text, stability_headline
from vsgdesign.simulation.stability_result import StabilityResult
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.specification import MAP_SCR

FIXED = """
base = "case:hoang2025_5kva"
[simulation]
duration = "0.3 s"
P_ref = "2 kW"
Q_ref = "1 kvar"
[stability]
errors = [0]
P = ["2 kW"]
Q = ["0 kvar"]
{axes}
[stability.gates]
settling_time = "5 s"
damping_ratio = 0.25
M_s = 2.5
[[controllers]]
name = "fixed"
kind = "fixed"
[controllers.design_grid]
scr = 2
x_over_r = 1
{specification}
"""
BOX = '[specification]\nscr = [2, 3]\nx_over_r = [1, 1.5]\nP = ["0 kW", "4.5 kW"]\nQ = ["0 kvar", "1 kvar"]\n'


def study_of(axes: str = "", specification: str = BOX) -> Study:
    """Gains that are made for SCR 2 and miss gates on stiff grids."""
    return study_from_text(FIXED.format(axes=axes, specification=specification))


def result_of(study: Study) -> StabilityResult:
    found = (assess(study, study.controllers[0]),)
    return StabilityResult(study, found, {}, clause_matrix(study, found), {})


@pytest.fixture(scope="module")
def asked() -> StabilityResult:
    return result_of(study_of())


@pytest.fixture(scope="module")
def beyond() -> StabilityResult:
    """The same with axes of its own, which leave the box."""
    return result_of(study_of("scr = [2, 3, 20]\nx_over_r = [0.8, 1, 1.5]"))


def ours(result: StabilityResult) -> dict[str, str]:
    return {row.test: row.verdict for row in result.verdicts if row.source == OWN}


def test_axes_are_those_of_the_specification(asked: StabilityResult) -> None:
    stability = asked.study.stability
    assert (stability.scr[0], stability.scr[-1]) == (2.0, 3.0)
    assert (stability.x_over_r[0], stability.x_over_r[-1]) == (1.0, 1.5)
    assert np.max(np.divide(stability.scr[1:], stability.scr[:-1])) < 1.7
    assert study_of(specification="").stability.scr == MAP_SCR
    assert set(ours(asked).values()) == {PASS}
    assert stability_headline(asked) == "fixed meets all of its gates."


def test_a_box_far_from_the_usual_axes_has_an_axis_too() -> None:
    far = study_of(specification=BOX.replace("[2, 3]", "[100, 1000]")).stability.scr
    assert (far[0], far[-1]) == (100.0, 1000.0)
    assert np.max(np.divide(far[1:], far[:-1])) < 1.7


def test_a_box_on_another_basis_is_held_whole_and_not_left() -> None:
    study = study_of(specification=BOX + 'scr_basis = "impedance"\n')
    assert study.scr_basis == "reactance"
    # SCR on |Z| is that on X times sin(arctan(X/R)): 2 at X/R 1.5, and 3 at X/R 1.
    low, high = 2.0 / np.sin(np.arctan(1.5)), 3.0 * np.sqrt(2.0)
    assert low <= study.stability.scr[0] < 1.01 * low
    assert 0.99 * high < study.stability.scr[-1] <= high


def test_a_grid_outside_is_shown_marked_and_not_judged(asked: StabilityResult, beyond: StabilityResult) -> None:
    a = beyond.assessments[0]
    for field in (a.reduced, a.full_order):
        for row in map_rows(field):
            scr, x_over_r, reason = float(str(row[0])), float(str(row[1])), row[-1]
            inside = 2.0 <= scr <= 3.0 and 1.0 <= x_over_r <= 1.5
            assert (reason is None) == inside
            assert inside or str(reason).startswith(NOT_ASKED)
            assert row[-3] is not None  # it has its figures all the same
        assert left_out(field) == ([], 5)
    assert ours(beyond) == ours(asked)
    assert "5 of 9 cells that the specification does not ask for" in worst_table(beyond, a).notes[0]
    assert np.all(a.between_grids[:, 0] <= 3.0)


def test_the_design_point_is_asked_for_whatever_the_powers_of_the_box_are() -> None:
    """Every cell was left out, and the headline said that gates were missed."""
    narrow = BOX.replace('["0 kvar", "1 kvar"]', '["0 kvar"]')
    text = FIXED.replace('Q = ["0 kvar"]\n{axes}', 'Q = ["0.5 kvar"]').format(specification=narrow)
    design = '[power_loops]\nP_design = "2 kW"\nQ_design = "{} kvar"\n[stability]'
    at, beside = (result_of(study_from_text(text.replace("[stability]", design.format(Q), 1))) for Q in ("0.5", "0.4"))
    assert set(ours(at).values()) == {PASS}
    assert left_out(at.assessments[0].reduced) == ([], 0)
    assert not set(ours(beside).values()) & {PASS, FAIL}
    assert stability_headline(beside).startswith("No gate of fixed is missed, but 11 of 11 could not be assessed: no")


def test_without_a_box_the_axes_of_the_study_are_judged_and_the_line_says_where() -> None:
    result = result_of(study_of("scr = [2, 3, 20]\nx_over_r = [1]", specification=""))
    assert FAIL in ours(result).values()
    said = stability_headline(result)
    assert said.startswith("fixed does not meet all of its gates. fixed: ")
    assert "SCR 20, X/R 1" in said
    assert "asked" in said
    # Both models miss the last two; the first is told with its value.
    also = " Also missed: phase margin, peak sensitivity M_s, damping ratio of all modes."
    assert said.endswith(f"asked ≥ 0.25.{also}")
    lines = gates_text(result)
    failed = [row for row in result.verdicts if row.verdict == FAIL]
    assert lines[0] == f"gates (ours, no grid code): {11 - len(failed)} pass, {len(failed)} fail"
    assert [line for line in lines if line.startswith("  fixed: ")] == [
        f"  fixed: {row.test} is {row.value}, asked {row.limit}" for row in failed
    ]


def test_a_margin_without_a_limit_has_no_worst_cell(asked: StabilityResult) -> None:
    """A loop without a phase crossing has an infinite gain margin, and "∞ dB at SCR 2" would be no worst case."""
    a = asked.assessments[0]
    endless = np.full_like(a.reduced.table.loop_P.gain_margin_db, np.inf)
    loops = {
        name: dataclasses.replace(getattr(a.reduced.table, name), gain_margin_db=endless)
        for name in ("loop_P", "loop_Q")
    }
    field = dataclasses.replace(a.reduced, table=dataclasses.replace(a.reduced.table, **loops))
    worst = {one.quantity: one for one in worst_cases(asked.study, field)}["gain margin"]
    assert (worst.value, worst.where, worst.share_below) == (np.inf, EVERY_CELL, 0.0)
    shown = worst_table(asked, dataclasses.replace(a, reduced=field))
    row = next(row for row in shown.rows if row[:2] == ("reduced", "gain margin"))
    assert row[2:4] == (EVERY_CELL, "no limit")
