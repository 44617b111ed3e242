"""Cases of a field estimator, one by one: the figures of a simulated scenario."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.lanes.alone import run_alone
from tests.simulation.survival.subjects import TEXT
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.simulation.lanes.cases import DISTURBANCE, STEP, LaneCases, no_events, segments_of, study_of_case
from vsgdesign.simulation.lanes.rests import ends_of
from vsgdesign.simulation.lanes.results import JUDGED, OVER_LIMIT
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.study.parameters import study_from_text

FIELD = TEXT.replace('kind = "scheduled"', 'kind = "scheduled"\nestimate = "field"', 1)


def cases() -> LaneCases:
    """A step of P, a jump of the grid, and a rest that the converter cannot have."""
    events = no_events(3)
    events.t_s[:, 0] = 1.2, 1.2003, 1.2
    events.P_ref[0, 0], events.P_ref[2, 0] = 3500.0, 4e3
    events.R_g[1, 0], events.L_g[1, 0] = 0.6, 1.2e-3
    zeros, c = np.zeros(3), study_from_text(FIELD).converter
    return LaneCases(
        R_g=zeros + 0.3,
        L_g=zeros + 1.8e-3,
        V_g_rms=zeros + c.V_rated_rms,
        omega_g=zeros + 1.001 * c.omega_n,
        P_ref=np.array([1e3, 1e3, 9e3]),
        Q_ref=zeros,
        events=events,
        error_R=zeros,
        error_X=zeros,
        silent_s=zeros,
        cleared_s=events.t_s[:, 0].copy(),
        kind=np.array([STEP, DISTURBANCE, DISTURBANCE], dtype=np.int8),
        signal=np.zeros(3, dtype=np.int8),
    )


def test_a_switched_bridge_is_judged_by_its_own_rest() -> None:
    """As ``simulate`` judges the study of the case."""
    study = study_from_text(FIELD.replace('estimate = "field"', 'estimate = "field"\nsettling_time = 0.2', 1))
    spec, drawn = study.controllers[0], cases().take(np.array([0, 1]))
    found = run_alone(study, spec, NOTHING, drawn, bridge="pwm")
    demand = demand_of(study.converter, settling_time_of(spec, NOTHING))
    samples = ends_of(study, drawn, segments_of(drawn), demand, "pwm")[0]
    runs = []
    for k in range(2):
        one = replace(study_of_case(study, drawn, k, int(samples[k])), controllers=(spec,))
        one = replace(one, simulation=replace(one.simulation, survival=k == 1))
        runs.append(run_scenario(one, bridge="pwm").controllers[0])
    step, verdict = runs[0].events[0].cycle_mean, runs[1].survival
    assert step.overshoot_pct is not None
    assert verdict is not None
    assert found.overshoot[0] == pytest.approx(step.overshoot_pct / 100.0, abs=1e-6)
    assert found.settling_s[0] == pytest.approx(step.settling_time_s, abs=1e-6)
    assert found.recovery_s[1] == pytest.approx(verdict.recovery_s, abs=1e-6)


def test_figures_of_cases_that_run_alone_are_those_of_scenarios() -> None:
    study = study_from_text(FIELD)
    spec, drawn = study.controllers[0], cases()
    found = run_alone(study, spec, NOTHING, drawn)
    np.testing.assert_array_equal(found.status, [JUDGED, JUDGED, OVER_LIMIT])
    one = study_of_case(study, drawn, 0, round(3.05 / study.converter.T_s))
    result = run_scenario(replace(one, controllers=(spec,))).controllers[0]
    step = result.events[0].cycle_mean
    assert step.overshoot_pct is not None
    assert found.overshoot[0] == pytest.approx(step.overshoot_pct / 100.0, abs=1e-6)
    assert found.settling_s[0] == pytest.approx(step.settling_time_s, abs=1e-6)
    current = np.hypot(*result.simulation.log[:, :2].T) / study.converter.I_rated_pk
    later = result.simulation.t_s > 1.205 - 0.5 * study.converter.T_s
    assert found.peak_pu[0] == pytest.approx(float(current[later].max()), rel=1e-9)
    assert 0.0 < found.recovery_s[1] < 1.0
    assert 0.0 < found.swing_rad[1] < 0.5
    assert math.isnan(found.recovery_s[0])
    assert math.isnan(found.settling_s[1])
