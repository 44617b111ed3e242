"""A synchro-check: when the breaker of an island closes, against Fourier components of both voltages."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.parameters.documents import build, case_document, the_fault
from tests.simulation.finding import found_in
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.report.scenario.tables import metrics_table
from vsgdesign.simulation import build_timeline, simulate
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import Study, study_from_text


def island(check: str, more: str = "", P_ref: str = "1.5 kW") -> Study:
    """An island whose load takes 2 kW: with less P_ref, its frequency is lower than the grid's."""
    study = study_from_text(f"""
base = "case:hoang2025_5kva"
[grid]
scr_basis = "impedance"
scr = 3
x_over_r = 2
[network]
load = {{ P_pu = 0.4, Q_pu = 0.1 }}
[simulation]
duration = "3 s"
P_ref = "{P_ref}"
Q_ref = "0 var"
[[controllers]]
name = "a"
kind = "scheduled"
structure = "angle_damped"
[[events]]
time = "0.2 s"
breaker = "open"
[[events]]
time = "0.5 s"
breaker = "closed"
synchro_check = {check}
{more}
""")
    return replace(study, simulation=replace(study.simulation, log_interval=study.converter.T_s))


def run_of(study: Study) -> Simulation:
    return simulate(study, feed_of(study, study.controllers[0], build_timeline(study), NOTHING))


def lead_before(run: Simulation, study: Study, t_s: float) -> tuple[float, float]:
    """By how much the capacitor's voltage leads the grid's, degrees, over the cycle before an instant, and how fast
    this grows, degrees a second."""
    T_s = study.converter.T_s
    cycle, end = round(0.02 / T_s), round(t_s / T_s)

    def lead(last: int) -> float:
        t = run.t_s[last - cycle : last]
        vectors = (run.column(f"{name}_alpha") + 1j * run.column(f"{name}_beta") for name in ("v_c", "v_g"))
        v, v_g = (np.mean(vector[last - cycle : last] * np.exp(-100j * math.pi * t)) for vector in vectors)
        return math.degrees(np.angle(v / v_g))

    now, earlier = lead(end), lead(end - cycle)
    return now, math.remainder(now - earlier, 360.0) / 0.02


@pytest.mark.parametrize(("around", "angle"), [(-25.0, 5.0), (-60.0, 4.0)])
def test_the_breaker_closes_at_the_first_sample_that_is_near(around: float, angle: float) -> None:
    study = island(f'{{ angle = "{angle} deg", around = "{around} deg", V_pu = 0.2, df = "2 Hz" }}')
    found = found_in(study)
    closing = next(event for event in found.events if event.name.startswith("breaker closes"))
    assert closing.t_s > 0.55
    assert closing.network is not None
    assert closing.network.connected
    assert build_timeline(found).network_at(closing.t_s - 1e-4).connected is False
    run = run_of(found)
    lead, speed = lead_before(run, study, closing.t_s)
    assert abs(speed) > 30.0
    # Half a cycle has passed since the middle of the measured one. The relay's lag is that of a loop of 30 rad/s.
    edge = math.remainder(lead + 0.01 * speed - around, 360.0)
    assert abs(edge) == pytest.approx(angle, abs=1.5)
    assert edge * speed < 0.0  # it comes from outside
    waiting = run_of(study)
    rows = round(closing.t_s / study.converter.T_s)
    scale = np.abs(run.log[:rows]).max(axis=0)
    same = np.abs(waiting.log[:rows] - run.log[:rows]) <= 1e-9 * scale
    assert same.all()


def test_later_events_know_that_it_is_closed() -> None:
    more = '[[events]]\ntime = "2.9 s"\nload = "none"\n[[events]]\ntime = "0.51 s"\nload = { P_pu = 0.35 }\n'
    study = island('{ angle = "5 deg", around = "-30 deg", V_pu = 0.2, df = "2 Hz" }', more)
    found = found_in(study)
    timeline = build_timeline(found)
    assert [timeline.network_at(t).connected for t in (0.1, 0.52, 2.95)] == [True, False, True]
    assert timeline.network_at(2.95).load is None


def test_a_breaker_whose_conditions_never_hold_stays_open() -> None:
    study = island('{ angle = "1 deg", around = "170 deg", df = "0.001 Hz" }')
    result = run_scenario(study)
    names = {event.name for event in result.controllers[0].events}
    assert names == {"breaker opens", "breaker waits to close within 1° around +170°: the breaker never closes"}
    assert not result.controllers[0].simulation.timeline.network_at(2.9).connected


@pytest.mark.parametrize(
    ("events", "field", "problem"),
    [
        ([{"synchro_check": {}}], "events[0].synchro_check", "which this event does not"),
        (
            [{"breaker": "open"}, {"breaker": "closed", "synchro_check": {}}, {"breaker": "open"}],
            "events[2].breaker",
            "events[1] closes it at an instant that is not known beforehand",
        ),
        (
            [{"breaker": "open"}, {"breaker": "closed", "synchro_check": {"angle": "100 deg"}}],
            "events[1].synchro_check.angle",
            "outside",
        ),
        (
            [{"breaker": "open"}, {"breaker": "closed", "synchro_check": {"rate": 1}}],
            "events[1].synchro_check.rate",
            "unknown field",
        ),
    ],
)
def test_faults_of_a_synchro_check(events: list[dict[str, Any]], field: str, problem: str) -> None:
    timed = [{"time": 1.0 + k} | event for k, event in enumerate(events)]
    assert problem in the_fault(case_document() | {"events": timed}, field).problem
    study = build(case_document() | {"events": []})
    assert found_in(study) is study


def test_pages_tell_the_instants_that_each_run_found() -> None:
    """Two controllers close at different instants; the tables of both have all events of their own runs."""
    more = '[[controllers]]\nname = "b"\nkind = "fixed"\nstructure = "angle_damped"\n'
    more += "design_grid = { scr = 8, x_over_r = 2 }\n"
    study = island('{ angle = "5 deg", around = "-30 deg", V_pu = 0.2, df = "2 Hz" }', more)
    result = run_scenario(replace(study, simulation=replace(study.simulation, log_interval=4.0 * study.converter.T_s)))
    closings = [event for event in result.study.events if "breaker closes" in event.name]
    assert sorted(event.name.partition(":")[0] for event in closings) == ["a", "b"]
    assert closings[0].t_s < closings[1].t_s
    assert result.given is not None
    assert result.given.events == study.events
    for controller in result.controllers:
        (found,) = controller.found
        assert controller.simulation.timeline.network_at(found.t_s).connected
        rows = [row[1] for row in metrics_table(result, controller).rows]
        assert rows.count(found.name) == 2
