"""[controllers.knowledge]: a schedule that knows its grid wrongly and late, in runs, rests and promises."""

from __future__ import annotations

import numpy as np
import pytest

from tests import gain_tables
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.simulation import build_timeline
from vsgdesign.simulation.feeds import told_at, told_of
from vsgdesign.simulation.following import ScheduledAnswers
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.scenario.checking import expected_rests, knows_its_rests
from vsgdesign.simulation.scenario.judging import promises_kept
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.grid import GridEstimate

JUMP = """
[[events]]
time = "0.205 s"
grid = { scr = 6 }
"""


def study(*controllers: str, events: str = JUMP, duration: str = "0.6 s", more: str = "") -> Study:
    tables = "\n".join(f"[[controllers]]\nname = 'c{k}'\n{text}" for k, text in enumerate(controllers))
    return study_from_text(f"""
base = "case:hoang2025_5kva"
[grid]
scr_basis = "impedance"
scr = 3
x_over_r = 2
[simulation]
duration = "{duration}"
P_ref = "2 kW"
Q_ref = "0.5 kvar"
{more}
{tables}
{events}
""")


@pytest.mark.parametrize(("structure", "apart"), [("published", 1e-8), ("angle_damped", 0.0)])
def test_exact_knowledge_is_the_truth(structure: str, apart: float) -> None:
    """The gains of a design point are computed with arrays or without, which differ in the last bit."""
    kind = f'kind = "scheduled"\nstructure = "{structure}"\n'
    truth, told = run_scenario(study(kind, kind + "knowledge = {}")).controllers
    np.testing.assert_allclose(truth.simulation.log, told.simulation.log, rtol=0.0, atol=apart)
    assert [change.t_s for change in truth.gain_changes] == [change.t_s for change in told.gain_changes]


def test_a_wrong_grid_gives_the_gains_that_are_designed_for_it() -> None:
    wrong = 'kind = "scheduled"\nknowledge = { error_R = "20 %", error_X = "-20 %" }'
    at = study(wrong, events="").grid
    fixed = f'kind = "fixed"\ndesign_grid = {{ R_g = {1.2 * at.R_g!r}, L_g = {0.8 * at.L_g!r} }}'
    step = '[[events]]\ntime = "0.1 s"\nP_ref = "2.2 kW"\n'
    result = run_scenario(study(wrong, fixed, 'kind = "scheduled"', events=step))
    told, designed, truth = result.controllers
    np.testing.assert_allclose(told.simulation.log, designed.simulation.log, rtol=0.0, atol=1e-9)
    assert np.abs(told.simulation.log - truth.simulation.log).max() > 1.0
    kept = {name: [one for one in promises_kept(result) if one.controller == name] for name in ("c0", "c1", "c2")}
    for one, other, exact in zip(kept["c0"], kept["c1"], kept["c2"], strict=True):
        assert one.ideal == pytest.approx(other.ideal, rel=1e-9)
        assert one.full_order == pytest.approx(other.full_order, rel=1e-9)
        if one.name == "damping_ratio":
            assert one.ideal != pytest.approx(exact.ideal, rel=1e-3)


def test_a_new_grid_is_known_late() -> None:
    late = 'kind = "scheduled"\nknowledge = { silent = "100 ms" }'
    changes = run_scenario(study(late)).controllers[0].gain_changes
    # The answer comes at 0.305 s, between two updates.
    assert [change.t_s for change in changes] == pytest.approx([0.0, 0.32])
    of_truth = run_scenario(study('kind = "scheduled"')).controllers[0].gain_changes
    assert [change.t_s for change in of_truth] == pytest.approx([0.0, 0.22])
    assert [change.gains for change in changes] == [change.gains for change in of_truth]


def test_a_second_change_prolongs_the_silence() -> None:
    events = JUMP + '[[events]]\ntime = "0.25 s"\nphase_jump = "5 deg"\n[[events]]\ntime = "0.5 s"\nP_ref = "2.1 kW"\n'
    one = study('kind = "scheduled"', events=events)
    timeline = build_timeline(one)
    told = told_of(one, GridEstimate(error_X=0.5, silent_s=0.1), timeline)
    assert [t_s for t_s, grid in told if grid is None] == [0.205, 0.25]
    assert [t_s for t_s, grid in told if grid is not None] == [0.0, 0.35]
    grid, known = told_at(told, 0.34)
    assert (grid.L_g, known) == (1.5 * one.grid.L_g, False)
    assert told_at(told, 0.36)[0].L_g == pytest.approx(1.5 * timeline.grid_at(0.3).L_g)


def test_a_stale_closed_form_of_the_published_structure_goes_to_the_middle_of_the_specification() -> None:
    late = 'kind = "scheduled"\nknowledge = { silent = "2 s" }'
    specification = "[specification]\nscr = [1.5, 24]\nx_over_r = [1, 4]\n"
    middle = 'kind = "fixed"\ndesign_grid = { scr = 6, x_over_r = 2 }'
    one = study(late, middle, duration="1 s", more=specification)
    told, fixed = run_scenario(one).controllers
    # 0.6 s after the change at 0.205 s.
    assert [change.t_s for change in told.gain_changes] == pytest.approx([0.0, 0.82])
    np.testing.assert_allclose(told.gain_changes[-1].gains, fixed.gain_changes[0].gains, rtol=1e-12)
    assert not knows_its_rests(one, one.controllers[0], build_timeline(one))


TABLE = 'kind = "scheduled"\nschedule = "table"\ntable = "t.json"\n'


@pytest.mark.parametrize(
    ("knowledge", "scr"), [('knowledge = { error_R = "-90 %", error_X = "-90 %" }', 3), ("", 30)], ids=["told", "true"]
)
def test_a_table_has_settled_beyond_its_edge(knowledge: str, scr: float) -> None:
    """SCR 30, or 3 that is taken for 30: the gains are those of the nearest place from the start on, and do not travel
    there."""
    step = '[[events]]\ntime = "0.1 s"\nP_ref = "2.1 kW"\n'
    one = study(TABLE + knowledge, events=step, duration="0.2 s").with_changes(grid={"scr": scr})
    changes = run_scenario(one, Ready(tables={"c0": gain_tables.table()})).controllers[0].gain_changes
    assert len(changes) > 1
    for change in changes[1:]:
        np.testing.assert_allclose(change.gains, changes[0].gains, rtol=2e-2)


def test_a_step_soon_after_a_start_outside_a_table_is_any_step() -> None:
    """The gains travelled for half a second, and this was measured as the response: 1.36 s and 6.9 %."""
    measured = []
    for t_s in (0.05, 1.1):
        step = f'[[events]]\ntime = "{t_s} s"\nP_ref = "0.7 kW"\n'
        one = study(TABLE, events=step, duration=f"{t_s + 3.0} s").with_changes(
            grid={"scr": 1.4, "x_over_r": 3}, simulation={"P_ref": "0.5 kW", "bridge": "averaged"}
        )
        (run,) = run_scenario(one, Ready(tables={"c0": gain_tables.table()})).controllers
        measured += [event.raw for event in run.events if event.signal == "P_pcc"]
    early, late = measured
    assert early.settling_time_s == pytest.approx(late.settling_time_s, abs=1e-4)
    assert early.overshoot_pct == pytest.approx(late.overshoot_pct, abs=1e-3)


@pytest.mark.parametrize(("scr", "x_over_r"), [(1.5, 0.3), (1.5, 10.0), (20.0, 0.3), (20.0, 10.0)])
def test_a_table_starts_in_its_own_corners(scr: float, x_over_r: float) -> None:
    """R_g and L_g of a corner give its SCR and X/R but for the last bit. The safe place is another one."""
    table = gain_tables.table()
    assert (scr in table.validity.scr, x_over_r in table.validity.x_over_r) == (True, True)
    kind = 'kind = "scheduled"\nschedule = "table"\ntable = "t.json"\n'
    one = study(kind, events="").with_changes(grid={"scr": scr, "x_over_r": x_over_r}, simulation={"P_ref": "0.5 kW"})
    answers = ScheduledAnswers(one, one.controllers[0], Ready(tables={"c0": table}))
    answers.first()
    # Single precision: 2⁻²³ in SCR and in R/X.
    assert answers.grid.R_g == pytest.approx(one.grid.R_g, rel=2.5e-7)
    assert answers.grid.L_g == pytest.approx(one.grid.L_g, rel=2.5e-7)


def test_the_rest_is_that_of_the_wrong_gains() -> None:
    """D_q of the published structure depends on the grid that is known, and with it the Q of a low voltage."""
    low = '[[events]]\ntime = "0.1 s"\nV_g_pu = 0.97\n'
    wrong = (
        'kind = "scheduled"\nsettling_time = 0.2\ndroop_ratio = 0.5\nknowledge = { error_R = "40 %", error_X = "40 %" }'
    )
    one = study(wrong, wrong.partition("knowledge")[0], events=low, duration="1.5 s")
    result = run_scenario(one)
    ends = [controller.series["Q_pcc"][-1] for controller in result.controllers]
    found = [expected_rests(one, result.timeline, spec)[-1].Q_pcc for spec in one.controllers]
    assert abs(ends[0] - ends[1]) > 5.0
    np.testing.assert_allclose(found, ends, atol=0.2)


def test_every_fault_is_named() -> None:
    with pytest.raises(StudyError) as caught:
        study(
            'kind = "fixed"\nknowledge = { error_R = 0.1 }',
            'kind = "scheduled"\nestimate = "field"\nknowledge = {}',
            'kind = "scheduled"\nknowledge = { error_R = -2, error_X = nan, silent = "1 V", late = 3 }',
            'kind = "scheduled"\nknowledge = 3',
        )
    for text in (
        'controllers[0].knowledge: a controller with kind = "fixed" is told nothing of the grid',
        'controllers[1].knowledge: has no effect with estimate = "field"',
        "controllers[2].knowledge.error_R = -2",
        "controllers[2].knowledge.error_X = nan",
        "controllers[2].knowledge.silent",
        "controllers[2].knowledge.late: unknown field",
        "controllers[3].knowledge = 3: expected a table",
    ):
        assert text in str(caught.value), str(caught.value)


def test_references_that_only_a_droop_brings_home_are_possible() -> None:
    """At 0.92 pu the droop of 5 % moves Q by 1.6 times the rating. The reference contains it, the grid carries 0.14."""
    step = '[[events]]\ntime = "0.1 s"\nP_ref = "2.1 kW"\n'
    one = study('kind = "scheduled"\nstructure = "angle_damped"', events=step, duration="0.2 s")
    asked = one.with_changes(grid={"V_g_pu": 0.92, "scr": 5}, simulation={"Q_ref": "-8 kvar"})
    result = run_scenario(asked)
    assert all(rest.point is not None for rest in result.controllers[0].rests)
    assert abs(result.controllers[0].series["Q_pcc"]).max() < 1000.0
    with pytest.raises(InfeasibleStudyError, match="no operating point"):
        run_scenario(asked.with_changes(controllers=[{"name": "c0", "kind": "scheduled"}]))
