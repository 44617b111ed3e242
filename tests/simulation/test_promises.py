"""Each controller is held to what it was asked for: a table to its specification, not to the closed form's 0.2 %."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from tests.design.robust_studies import controller, robust_study
from tests.gain_tables import table
from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.stability.maps import cells_under, full_order_cells
from vsgdesign.linear.stability.margins import full_order_margins
from vsgdesign.report.scenario.outcomes import promise_sentences, promises_table, step_outcomes
from vsgdesign.report.scenario.verdict import verdict
from vsgdesign.simulation.scenario import ScenarioResult, run_scenario
from vsgdesign.simulation.scenario.judging import CLOSED_FORM, GATES, TABLE, promises_kept, promises_of
from vsgdesign.study.parameters import Event, Study
from vsgdesign.study.parameters.grid import Grid, Place

ASKED = {"aim": "settling", "settling_time": 1.3, "overshoot": 0.05, "disk_margin": 1.0, "damping_ratio": 0.5}
# s² + 2·0.8·3.6 s + 3.6² overshoots by 1.5 %: within the 5 % asked for, beyond the 0.2 % of the closed form's poles.
SOFT = {"k_1": 3.6**2, "d_1": 2.0 * 0.8 * 3.6, "k_2": 3.6}


def study_with(asked: Mapping[str, object], *events: Event) -> tuple[Study, Ready]:
    study = replace(robust_study(), scr_basis="impedance")
    made = table(
        scr=(3.0, 6.0),
        x_over_r=(1.0, 3.0),
        parameters=SOFT,
        D_p=318.3,
        D_q=90.9,
        specification=asked,
        status=np.full((2, 2), "met"),
    )
    spec = replace(controller(study), name="table", schedule="table")
    run = replace(study.simulation, duration=3.0, bridge="averaged", P_ref=1500.0, Q_ref=0.0)
    grid = Place(5.0, 2.0, "impedance").grid(study.converter)
    return replace(study, controllers=(spec,), events=events, simulation=run, grid=grid), Ready(tables={"table": made})


@functools.cache
def soft_step() -> ScenarioResult:
    return run_scenario(*study_with(ASKED, Event(0.2, "more", P_ref=1750.0)))


def test_a_table_is_judged_by_its_own_specification() -> None:
    """1.5 % of overshoot keeps the 5 % that the table was designed to; the verdict names the specification."""
    result = soft_step()
    (step,) = step_outcomes(result)
    assert 0.5 < step.overshoot_pct < 4.0
    assert step.target_overshoot_pct == 5.0
    assert step.target_settling_time_s == 1.3
    assert not step.misses
    text = " ".join(verdict(result, [step]))
    assert TABLE in text
    assert "5.0 % overshoot" in text
    strict = replace(result, ready=study_with({**ASKED, "overshoot": 0.002})[1])
    (step,) = step_outcomes(strict)
    assert step.misses


def test_a_miss_that_the_table_announced_is_told_with_its_nodes() -> None:
    """The grid of SCR 5 and X/R 2 lies between all four nodes; a node that gives up another promise excuses nothing."""
    result = soft_step()
    ready = study_with({**ASKED, "overshoot": 0.002})[1]

    def said(missed: Mapping[str, float]) -> str:
        cause = {"scr": 6.0, "x_over_r": 3.0, "cause": "inner loops", "missed": missed}
        told = replace(result, ready=Ready(tables={"table": replace(ready.tables["table"], causes=[cause])}))
        (step,) = step_outcomes(told)
        assert step.misses
        return " ".join(verdict(told, [step]))

    other, same = said({"settling_time": 1.6}), said({"overshoot": 0.021})
    assert "gives up" not in other
    assert "on every step: where it misses, its table gives up the promise." in same
    assert "gives up the overshoot there: up to 2.1 % at SCR 6, X/R 3, because of inner loops" in same


def test_constant_inertia_promises_no_settling_time() -> None:
    study, ready = study_with({**ASKED, "aim": "inertia"})
    promises = promises_of(study, study.controllers[0], ready)
    assert promises.settling_time is None
    assert promises.overshoot_pct is None
    assert promises.disk_margin == 1.0


def test_closed_forms_have_their_target_and_given_gains_the_gates() -> None:
    study = robust_study()
    form = promises_of(study, controller(study))
    target = controller(study).target
    assert (form.source, form.settling_time) == (CLOSED_FORM, target.settling_time)
    assert (form.overshoot_pct, form.overshoot_Q_pct) == (0.2, 0.2)  # its poles overshoot by less
    zeta = 0.6
    own = replace(controller(study), target=replace(target, d_1=2.0 * zeta * np.sqrt(target.k_1)))
    expected = 100.0 * np.exp(-np.pi * zeta / np.sqrt(1.0 - zeta**2))
    assert promises_of(study, own).overshoot_pct == pytest.approx(expected)
    assert form.M_s == study.stability.gates.M_s
    given = replace(controller(study), kind="fixed", gains=PowerLoopGains(1e-3, 300.0, 0.01, 10.0))
    assert promises_of(study, given).source == GATES
    assert promises_of(study, given).overshoot_pct is None


def test_nothing_is_promised_outside_the_tables_box() -> None:
    """The step comes on SCR 12, beyond the table's 6: said, and neither met nor missed."""
    strong = Place(12.0, 2.0, "impedance").grid(robust_study().converter)
    events = (Event(0.1, "stronger", grid=Grid(strong.R_g, strong.L_g)), Event(0.6, "more", P_ref=1750.0))
    result = run_scenario(*study_with(ASKED, *events))
    (step,) = step_outcomes(result)
    assert step.excuse == "SCR 12 outside 3 to 6"
    assert not step.judged
    assert "SCR 12 outside 3 to 6" in " ".join(verdict(result, [step]))
    late = [one for one in promises_kept(result) if one.t_s > 0.0]
    assert late
    assert all(one.excuse == step.excuse for one in late)


def test_margins_are_held_to_the_specification_with_both_models() -> None:
    """The full order's disk margin is that of the gains that EMT starts with; what misses is named."""
    result = soft_step()
    kept = promises_kept(result)
    assert {one.name for one in kept} == {"disk_margin", "damping_ratio"}
    first = next(one for one in kept if one.name == "disk_margin")
    study, gains = result.study, result.controllers[0].gain_changes[0].gains
    cells = cells_under(study, lambda *_: gains, first.grid.R_g, first.grid.L_g, first.P, first.Q)
    alone = full_order_margins(full_order_cells(study, cells))
    assert first.full_order == pytest.approx(float(alone.disk_output.value[0]), rel=1e-4)
    assert first.ideal != first.full_order
    limit = first.full_order + 0.5 * (first.ideal - first.full_order)  # what ideal inner loops keep, real ones do not
    assert first.ideal > first.full_order
    strict = replace(result, ready=study_with({**ASKED, "disk_margin": limit})[1])
    missed = [one for one in promises_kept(strict) if not one.kept]
    assert all(one.kept_ideal for one in missed if one.t_s == 0.0)
    assert missed
    (sentence,) = promise_sentences(promises_kept(strict))
    assert "table misses" in sentence
    assert "disk margin" in sentence
    page = promises_table(promises_kept(strict))
    assert page is not None
    assert page.flagged
