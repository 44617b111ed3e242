"""What no limited current can carry: the converter rests at its limit, says so, and comes back when it ends."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.report.scenario.outcomes import step_outcomes
from vsgdesign.report.scenario.verdict import verdict
from vsgdesign.simulation.outcome import LimitedSamples, limited_end
from vsgdesign.simulation.scenario import ScenarioResult, run_scenario
from vsgdesign.study.parameters import study_from_text

STUDY = """base = "case:hoang2025_5kva"
[converter]
current_limit_pu = 1.2
current_limiter = "projection"
[inner_loops]
transient_resistance_pu = 0.08
[power_loops]
structure = "angle_damped"
tau_P = "5 ms"
tau_Q = "5 ms"
P_droop = "5 %"
Q_droop = "5 %"
[grid]
scr_basis = "impedance"
scr = {scr}
x_over_r = {x_over_r}
[simulation]
duration = "{duration} s"
log_interval = "200 us"
bridge = "averaged"
P_ref = "{P_ref} kW"
Q_ref = "0 var"
[[controllers]]
name = "a"
{kind}
[[events]]
time = "0.2 s"
{event}
"""
BACK = '[[events]]\ntime = "2 s"\n{back}\n'

CASES = {
    "more than the rating": (5.0, 3.0, 2.5, 'P_ref = "7.5 kW"', 'P_ref = "2.5 kW"'),
    "more than a stiff grid needs": (20.0, 10.0, 2.5, 'P_ref = "7.5 kW"', 'P_ref = "2.5 kW"'),
    "import that a resistive grid cannot carry": (1.5, 1.0, -1.5, 'P_ref = "-7.5 kW"', 'P_ref = "-1.5 kW"'),
    "no grid voltage": (5.0, 3.0, 2.5, "V_g_pu = 0", "V_g_pu = 1"),
    "no grid voltage near by": (20.0, 10.0, 4.5, "V_g_pu = 0", "V_g_pu = 1"),
    "an island with too large a load": (
        5.0,
        3.0,
        2.5,
        "V_g_pu = 0\ngrid = { scr = 2, x_over_r = 0.05 }",
        "V_g_pu = 1\ngrid = { scr = 5, x_over_r = 3 }",
    ),
}


def scenario(case: str, back: bool) -> ScenarioResult:
    """The run with or without the end of the event."""
    scr, x_over_r, P_ref, event, ending = CASES[case]
    # In an island, a schedule that is told the truth would be told the load.
    kind = 'kind = "fixed"\ndesign_grid = { scr = 5, x_over_r = 3 }' if "island" in case else 'kind = "scheduled"'
    duration, end = (5, BACK.format(back=ending)) if back else (2.5, "")
    text = STUDY.format(scr=scr, x_over_r=x_over_r, P_ref=P_ref, event=event, kind=kind, duration=duration) + end
    return run_scenario(study_from_text(text))


DESIGNED = """K_pv = 0.16594
K_iv = 74.024
K_pc = 10.543
K_ic = 279.38
current_feedforward = 0.57889
transient_resistance_pu = 0.02648
transient_reactance_pu = 0.25832
transient_corner = "48.732 Hz\""""
"""Inner loops designed from the datasheet."""

RIPPLE = """
[[grid.components]]
order = -1
amplitude_pu = 0.02
[[grid.components]]
order = -5
amplitude_pu = 0.02
[[grid.components]]
order = 7
amplitude_pu = 0.015
"""


@pytest.mark.parametrize(("filter_time", "lost"), [("3 ms", 0.0), ("0 s", 0.05)])
def test_the_soft_limit_does_not_rectify_what_the_grid_brings(filter_time: str, lost: float) -> None:
    """At rated power on SCR 20. Without the low-pass, the crests act on P: the test sees it."""
    text = STUDY.replace("transient_resistance_pu = 0.08", DESIGNED).format(
        scr=20, x_over_r=3, P_ref=4.9, event='P_ref = "5 kW"', duration=2, kind='kind = "scheduled"'
    )
    study = study_from_text(text + RIPPLE + f'[converter.limiter]\nfilter_time = "{filter_time}"\n')
    log = run_scenario(study).controllers[0].simulation.log
    P = log[-2500:, 8].mean()  # 25 cycles
    if lost == 0.0:
        assert log[-1, 13] == 0.0
        assert abs(P - 5000.0) < 5.0
    else:
        assert lost < (5000.0 - P) / 5000.0


@pytest.mark.parametrize("case", CASES)
def test_it_rests_at_its_limit_and_says_so(case: str) -> None:
    result = scenario(case, back=False)
    run, rated = result.controllers[0], result.study.converter.I_rated_pk
    assert run.outcome.status == "limited"
    assert "rests at its current limit with P = " in str(run.outcome.reason)
    paragraphs = verdict(result, step_outcomes(result))
    assert sum("At the end: a: it rests at its current limit with P = " in text for text in paragraphs) == 1
    log, t_s = run.simulation.log, run.simulation.t_s
    late = t_s > 0.205
    assert np.hypot(log[late, 0], log[late, 1]).max() < 1.32 * rated
    if "island" not in case:  # without a grid there is no angle to keep
        angle = np.unwrap(log[:, 12]) - run.simulation.timeline.source_phase(t_s)
        assert np.ptp(angle) < math.pi / 2.0
    frequency = log[late, 10] / (2.0 * math.pi)
    assert np.abs(frequency - 50.0).max() < 5.0


@pytest.mark.parametrize("case", CASES)
def test_it_comes_back_when_it_ends(case: str) -> None:
    result = scenario(case, back=True)
    run, rated = result.controllers[0], result.study.converter.I_rated_pk
    assert run.outcome.status in ("settled", "not known"), run.outcome.reason
    log, t_s = run.simulation.log, run.simulation.t_s
    P = log[t_s > 4.5, 8]
    expected = CASES[case][2] * 1e3
    assert np.abs(P - expected).max() < 0.02 * 5000.0
    limited = log[:, 13]
    assert limited[-1] == limited[np.searchsorted(t_s, 4.5)]
    assert np.hypot(log[t_s > 2.005, 0], log[t_s > 2.005, 1]).max() < 1.32 * rated


NAMED = {
    "current": (800, 'P_ref = "7.5 kW"', "its current limit"),
    "bridge voltage": (345, 'Q_ref = "2.5 kvar"', "the limit of its bridge's voltage"),
    "limiter's voltage": (800, 'Q_ref = "4 kvar"\nV_g_pu = 1.2', "a limit that its limiter sets to the voltage"),
}
"""Which limit acts: dc voltage in V, the event, and what is said. "At its current limit" was said of the first two, at
0.28 pu of 1.2 pu for the second, and "not settled" of the third."""


@pytest.mark.parametrize("limit", NAMED)
def test_the_limit_that_acts_is_named(limit: str) -> None:
    V_dc, event, said = NAMED[limit]
    soft = STUDY.replace('Q_droop = "5 %"', 'Q_droop = "50 %"').replace(
        "[inner_loops]", f"V_dc = {V_dc}\n[inner_loops]"
    )
    scr = 5.0 if limit == "current" else 2.0
    kind = 'kind = "scheduled"'
    result = run_scenario(
        study_from_text(soft.format(scr=scr, x_over_r=1, P_ref=1.5, event=event, kind=kind, duration=2.6))
    )
    run, c = result.controllers[0], result.study.converter
    assert run.outcome.status == "limited", run.outcome
    assert run.outcome.limits == (limit,)
    assert f"it rests at {said} with P = " in str(run.outcome.reason)
    # What the run itself shows of the three limits at its end, apart from the samples' flags.
    late = run.simulation.t_s > 2.5
    log = run.simulation.log[late]
    current = float(np.hypot(log[:, 0], log[:, 1]).mean()) / c.I_rated_pk
    V_pu = float(log[:, 11].mean()) / c.V_rated_rms
    assert (current > 1.1) == (limit == "current")
    assert (abs(V_pu - 1.3) < 1e-6) == (limit == "limiter's voltage")


UNSTABLE = """
base = "case:lab_12kva_lcl"
grid = { scr = 14.5405687126407, x_over_r = 0.32446370640118694 }
simulation = { duration = 1.37216, P_ref = 7248.722736438271, Q_ref = -2215.9698634303177, bridge = "averaged" }
events = [{ time = 0.31271, P_ref = -7947.88551416231 }]
power_loops = { tau_P = "5 ms", tau_Q = "5 ms" }
[[controllers]]
name = "fast"
kind = "fixed"
structure = "published"
settling_time = 0.3597705202338238
design_grid = { scr = 1.2263998958819549, x_over_r = 3.6234642880461903 }
"""


def test_an_unstable_rest_is_said_though_the_limiter_acts() -> None:
    """ "It rests at its current limit with P = -6.92 kW" was said of a run that swings by 3 kW."""
    result = run_scenario(study_from_text(UNSTABLE))
    outcome = result.controllers[0].outcome
    assert outcome.status == "unstable"
    assert "grows at 8.65 1/s" in str(outcome.reason)
    assert "fast: unstable: a mode that swings at 3.51 Hz" in " ".join(verdict(result, step_outcomes(result)))


@pytest.mark.parametrize(("moved", "rests"), [(0.018, True), (0.022, False)])
def test_a_rest_keeps_the_means_of_four_quarters_within_two_per_cent(moved: float, rests: bool) -> None:
    """The last quarter of the last second is ``moved`` (of the rating) away from the others."""
    study = study_from_text(
        STUDY.format(scr=5, x_over_r=3, P_ref=1, event="V_g_pu = 0", kind='kind = "fixed"', duration=3)
    )
    t = np.linspace(0.0, 3.0, 15001)
    P, on = np.full(len(t), 1e3), np.ones(len(t))
    P[t > 2.75 + 1e-9] += moved * study.converter.S_rated
    end = limited_end(study, t, P, 0.0 * P, LimitedSamples(on, 0.0 * on, 0.0 * on), 0.2)
    assert end is not None
    assert end.rests == rests
    assert limited_end(study, t, P, 0.0 * P, LimitedSamples(0.0 * on, 0.0 * on, 0.0 * on), 0.2) is None
    assert limited_end(study, t, P, 0.0 * P, LimitedSamples(on, on, on), 2.1) is None
    here = np.where(np.arange(len(t)) % 25 == 0, 1.0, 0.0)
    assert limited_end(study, t, P, 0.0 * P, LimitedSamples(here, here, here), 0.2) is None
