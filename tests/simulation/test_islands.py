"""While the breaker is open there is no grid to know: what a schedule is told, and what is not judged then."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests import gain_tables
from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.grid import grid_behind_load
from vsgdesign.metrics.survival import SURVIVED
from vsgdesign.report.page.converter import network_in_words
from vsgdesign.simulation.feeds import LateSchedule, gain_feed, told_of
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.online import WindowPowers
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.scenario.checking import expected_rests, knows_its_rests, refuse_impossible
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.grid import Grid, GridEstimate

ISLAND = """
[[events]]
time = "0.5 s"
breaker = "open"
[[events]]
time = "1 s"
grid = { scr = 6 }
[[events]]
time = "2 s"
breaker = "closed"
"""


def study(controller: str = "", events: str = ISLAND, more: str = "") -> Study:
    return study_from_text(f"""
base = "case:hoang2025_5kva"
[grid]
scr_basis = "impedance"
scr = 3
x_over_r = 2
[simulation]
duration = "3 s"
P_ref = "2 kW"
Q_ref = "0.5 kvar"
[[controllers]]
name = "a"
kind = "scheduled"
{controller}
{more}
{events}
""")


def seen_at(feed: LateSchedule, *instants: float) -> list[tuple[float, Grid]]:
    """The grids of the gains in force, after updates every 20 ms."""
    feed.first_gains()
    found = []
    for k in range(1, 151):
        feed.update(WindowPowers(t_s=0.02 * k, P=2000.0, Q=500.0, V_rms=110.0, limited=0))
        found += [(0.02 * k, feed.grid)] if any(abs(0.02 * k - t) < 1e-9 for t in instants) else []
    return found


def test_nothing_is_told_while_the_breaker_is_open() -> None:
    one = study()
    timeline = build_timeline(one)
    told = told_of(one, GridEstimate(silent_s=0.1), timeline)
    known = timeline.grid_at(2.0)
    assert told == ((0.0, one.grid), (0.5, None), (1.0, None), (2.0, None), (2.1, known))
    assert (timeline.islanded, timeline.truth_changes()) == (True, (2.0,))
    assert math.isnan(timeline.true_grid_at(1.5).R_g)
    assert timeline.true_grid_at(2.0) == known


@pytest.mark.parametrize("controller", ["", 'structure = "angle_damped"\n'])
def test_a_closed_form_goes_on_with_the_grid_before(controller: str) -> None:
    """A line that changes behind the open breaker is first seen after the breaker has closed."""
    one = study(controller)
    timeline = build_timeline(one)
    feed = gain_feed(one, one.controllers[0], timeline)
    assert isinstance(feed, LateSchedule)
    grids = [grid for _, grid in seen_at(feed, 0.48, 1.5, 1.98, 2.02)]
    assert grids == [one.grid, one.grid, one.grid, timeline.grid_at(2.0)]
    plain = study(controller, events='[[events]]\ntime = "1 s"\ngrid = { scr = 6 }\n')
    assert not isinstance(gain_feed(plain, plain.controllers[0], build_timeline(plain)), LateSchedule)


def test_gains_that_are_given_do_not_care() -> None:
    one = study('[[controllers]]\nname = "b"\nkind = "fixed"\n')
    feed = gain_feed(one, one.controllers[1], build_timeline(one))
    assert isinstance(feed, tuple)
    assert isinstance(feed[0], GainChange)


def test_a_table_is_stale_in_the_island() -> None:
    """Its scheduler holds its place, and moves to its safe place as it does when an estimator stays silent."""
    one = study('schedule = "table"\ntable = "t.json"\n', ISLAND.replace('"2 s"', '"2.9 s"'))
    ready = Ready(tables={"a": gain_tables.table()})
    feed = gain_feed(one, one.controllers[0], build_timeline(one), ready)
    assert isinstance(feed, LateSchedule)
    (_, before), (_, held), (_, stale) = seen_at(feed, 0.48, 0.7, 2.8)
    assert held.L_g == pytest.approx(before.L_g, rel=1e-6)
    table = 'schedule = "table"\ntable = "t.json"\n'
    jump = '[[events]]\ntime = "0.5 s"\nphase_jump = "1 deg"\n'
    silent = study(table + 'knowledge = { silent = "9 s" }\n', jump)
    other = gain_feed(silent, silent.controllers[0], build_timeline(silent), ready)
    assert isinstance(other, LateSchedule)
    assert seen_at(other, 2.8) == [(pytest.approx(2.8), stale)]
    assert abs(stale.L_g / before.L_g - 1.0) > 0.05


def test_no_model_judges_an_island_or_a_fault() -> None:
    one = study(events=ISLAND + '[[events]]\ntime = "2.5 s"\nfault = {}\n')
    timeline, spec = build_timeline(one), one.controllers[0]
    found = expected_rests(one, timeline, spec)
    assert [rest.modelled for rest in found] == [True, False, False, True, False]
    assert "the breaker to the grid is open" in str(found[1].obstacle)
    assert "there is a fault" in str(found[4].obstacle)
    assert found[0].end_state("P_pcc", False, 1e-3).modelled
    assert not found[1].end_state("P_pcc", False, 1e-3).modelled
    assert not knows_its_rests(one, spec, timeline)
    assert [rest.point is None for rest in found] == [False, True, True, False, True]
    refuse_impossible(one, timeline)


@pytest.mark.parametrize("Y", [0.05 + 0.0j, 0.02 - 0.03j, 0.04 + 0.01j])
def test_grid_and_load_are_one_source_behind_one_impedance(Y: complex) -> None:
    """Against the voltages and currents of the two-loop circuit itself."""
    Z, v_g, i = 0.8 + 2.1j, 155.0 * np.exp(0.3j), 12.0 - 7.0j
    v_pcc = (v_g + Z * i) / (1.0 + Z * Y)  # i = Y v_pcc + (v_pcc − v_g)/Z
    assert Y * v_pcc + (v_pcc - v_g) / Z == pytest.approx(i)
    R, X, cosine, sine = grid_behind_load(Z.real, Z.imag, Y.real, Y.imag)
    assert (cosine + 1j * sine) * v_g + (R + 1j * X) * i == pytest.approx(v_pcc)


def test_a_run_is_judged_with_its_load() -> None:
    """Powers come to rest with a load, and that rest is the one that the judge expects."""
    events = '[[events]]\ntime = "0.2 s"\nload = { P_pu = 0.3, Q_pu = 0.1 }\n'
    more = '[converter]\ncurrent_limit_pu = 1.5\ncurrent_limiter = "projection"\n'
    one = study('structure = "angle_damped"\n', events, more)
    found = run_scenario(replace(one, simulation=replace(one.simulation, survival=True))).controllers[0].survival
    assert found is not None
    assert (found.status, found.reason) == (SURVIVED, None)


def test_pages_say_what_is_at_the_pcc() -> None:
    one = study(events="", more='[network]\nload = { P_pu = 0.5 }\nbreaker = "open"\n')
    assert network_in_words(one) == ["load 2.5 kW", "breaker open"]
    assert network_in_words(study(events="")) == []


def test_an_estimate_is_compared_with_grid_and_load_together() -> None:
    """Nobody can tell them apart at the PCC. In a fault there is nothing to compare with."""
    events = """
[[events]]
time = "0.2 s"
load = { P_pu = 0.6, Q_pu = 0.2 }
[[events]]
time = "0.6 s"
fault = { R_pu = 1 }
[[events]]
time = "0.7 s"
fault = "cleared"
"""
    one = study('structure = "angle_damped"\nestimate = "kalman"\n', events)
    one = replace(one, simulation=replace(one.simulation, duration=0.8))
    result = run_scenario(one)
    log = result.controllers[0].estimates
    assert log is not None
    assert result.timeline.truth_changes() == (0.2, 0.7)
    at = {t: int(np.argmin(np.abs(log.t_s - t))) for t in (0.18, 0.58, 0.68)}
    Z = one.grid.R_g + 100j * np.pi * one.grid.L_g
    Y = (0.6 - 0.2j) / one.converter.Z_base
    seen = Z / (1.0 + Z * Y)
    assert complex(log.R_g[at[0.58]], 100.0 * np.pi * log.L_g[at[0.58]]) == pytest.approx(seen, rel=1e-6)
    assert log.R_g[at[0.18]] == one.grid.R_g
    assert math.isnan(log.R_g[at[0.68]])
