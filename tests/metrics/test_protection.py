"""Protection limits: signals whose trips are known in closed form, and what a study's verdict makes of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import cases_of, uniforms_of
from vsgdesign.campaigns.verification.emt import case_study
from vsgdesign.errors import StudyError
from vsgdesign.metrics.protection import first_trip
from vsgdesign.simulation.lanes.results import STATUSES
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.specification import ProtectionLimits

STEP, CYCLE = 1e-3, 0.02
T = np.arange(0.0, 3.0, STEP)
FLAT = np.full(len(T), 50.0), np.ones(len(T))


def test_a_ramp_trips_when_its_mean_rate_reaches_the_limit() -> None:
    """2 Hz/s from 1 s on, over 0.5 s: the rate is 4 (t − 1) Hz/s until 1.5 s, so 1 Hz/s is passed at 1.25 s."""
    f = 50.0 + 2.0 * np.clip(T - 1.0, 0.0, 0.6)
    found = first_trip(T, f, FLAT[1], ProtectionLimits(rocof=1.0, rocof_window=0.5), 1.0, CYCLE)
    assert found is not None
    assert found.t_s == pytest.approx(1.25, abs=1.5 * STEP)
    assert "limit 1 Hz/s" in found.reason
    assert first_trip(T, f, FLAT[1], ProtectionLimits(rocof=2.01), 1.0, CYCLE) is None
    assert first_trip(T, f, FLAT[1], ProtectionLimits(rocof=1.0), 2.2, CYCLE) is None  # it was before the first event


@pytest.mark.parametrize(("length", "trips"), [(0.13, False), (0.19, True)])
def test_a_voltage_trips_when_its_mean_is_beyond_for_too_long(length: float, trips: bool) -> None:
    """A sag to 0.4 pu: the mean of a cycle is below 0.7 pu from half a cycle after it begins to half a cycle after it
    ends, so for as long as the sag."""
    V = np.where((T >= 1.0) & (1.0 + length > T), 0.4, 1.0)
    limits = ProtectionLimits(V_low_pu=0.7, V_low_time=0.15)
    found = first_trip(T, FLAT[0], V, limits, 0.5, CYCLE)
    assert (found is not None) == trips
    if found is not None:
        assert found.t_s == pytest.approx(1.0 + 0.5 * CYCLE + 0.15, abs=3.0 * STEP)
    above = first_trip(T, FLAT[0], 2.0 - V, ProtectionLimits(V_high_pu=1.3, V_high_time=0.15), 0.5, CYCLE)
    assert (above is not None) == trips
    twice = np.where((T > 1.1) & (T < 1.15), 1.0, V)  # an interruption begins it anew
    assert first_trip(T, FLAT[0], twice, limits, 0.5, CYCLE) is None


RAMP = """
base = "case:lab_12kva_lcl"
grid = {{ scr = 5, x_over_r = 4, scr_basis = "impedance" }}
power_loops = {{ structure = "angle_damped" }}
controllers = [{{ name = "a", kind = "scheduled" }}]
simulation = {{ duration = "4 s", P_ref = "2 kW", Q_ref = 0, survival = true }}
events = [{{ time = "0.2 s", f_g = "49.5 Hz", over = "0.25 s" }}]
{more}
"""


def judged(more: str = "") -> Any:
    found = run_scenario(study_from_text(RAMP.format(more=more))).controllers[0].survival
    assert found is not None
    return found


def test_a_study_without_limits_has_the_verdict_of_before() -> None:
    assert judged().survived
    assert judged() == judged("[survival.protection]\nV_low_pu = 0.5\n")


def test_a_converter_that_survives_is_tripped_by_its_protection() -> None:
    """The grid falls by 2 Hz/s for a quarter of a second: 1 Hz/s over the half second of the window."""
    slow = judged("[survival.protection]\nrocof = 1.3\n")
    assert slow.survived
    fast = judged("[survival.protection]\nrocof = 0.8\n")
    assert (fast.status, fast.survived, fast.judged) == ("tripped", False, True)
    assert "the protection trips at 0." in fast.reason
    assert fast.recovery_s == slow.recovery_s


DRAWN = """
base = "case:lab_12kva_lcl"
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
grid = { scr = 5, x_over_r = 4, scr_basis = "impedance" }
power_loops = { structure = "angle_damped", settling_time = "0.5 s" }
controllers = [{ name = "a", kind = "scheduled" }]
simulation = { duration = "1 s", P_ref = "2 kW", Q_ref = 0 }
inner_loops = { K_pv = 0.054, K_iv = 29.5, K_pc = 22.2, K_ic = 630, current_feedforward = 0.841, \
  transient_resistance_pu = 0.271, transient_reactance_pu = 0.15, transient_corner = "31.5 Hz", \
  current_prediction = 1.43 }
survival = { protection = { rocof = 4, rocof_window = "0.1 s", V_low_pu = 0.8, V_low_time = "0.15 s" } }
[verification]
grid.weight = 0
step.weight = 0
phase.weight = 1
sag.weight = 1
ramp.weight = 1
"""


@pytest.mark.parametrize(("bridge", "count"), [("averaged", 9), ("pwm", 3)])
def test_a_batch_trips_as_its_cases_do_alone(bridge: str, count: int, tmp_path: Path) -> None:
    """Random disturbances: the verdict of the batch is that of ``simulate`` on the study of each case."""
    study = study_from_text(DRAWN)
    (spec,) = study.controllers
    cases, _ = cases_of(study, spec, uniforms_of(3, 0, count))
    found = run_lanes(study, spec, NOTHING, cases, bridge=bridge)
    alone = []
    for k in range(count):
        one, text = case_study(study, spec, cases, k, folder=tmp_path, bridge=bridge)
        assert "[survival.protection]" in text
        verdict = run_scenario(one).controllers[0].survival
        assert verdict is not None
        alone.append("judged" if verdict.survived else verdict.status)
    assert [STATUSES[status] for status in found.status] == alone
    assert {"judged", "tripped"} <= set(alone)


def test_a_limit_outside_of_its_range_is_a_fault() -> None:
    with pytest.raises(StudyError, match=r"survival\.protection\.V_low_pu"):
        study_from_text(RAMP.format(more="[survival.protection]\nV_low_pu = 1.2\n"))
