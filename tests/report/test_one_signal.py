"""One signal in every verb: the mean over one nominal cycle, with an averaged bridge as with a switched one."""

from __future__ import annotations

import numpy as np
import pytest

from vsgdesign.report.drawing.quantities import number, percent
from vsgdesign.report.scenario.outcomes import step_outcomes
from vsgdesign.report.scenario.tables import metrics_table, responses_table, targets_table
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import study_from_text
from vsgdesign.verbs.pipeline.results import results_document

STUDY = """
base = "case:hoang2025_5kva"
controllers = [{{ name = "c", kind = "fixed", structure = "angle_damped", settling_time = 0.2 }}]
events = [{{ time = "0.5 s", P_ref = "2.15 kW" }}]

[simulation]
duration = "1.1 s"
bridge = "{bridge}"
log_interval = "50 us"
P_ref = "2 kW"
Q_ref = "0 var"
"""


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_simulate_run_and_results_have_the_same_figures(bridge: str) -> None:
    """Before: with a switched bridge ``simulate`` printed when the last ripple peak left the band, ``run`` the mean."""
    study = study_from_text(STUDY.format(bridge=bridge))
    result = run_scenario(study)
    (controller,) = result.controllers
    (step,) = (event for event in results_document(result, {})["controllers"]["c"]["events"] if event["kind"] == "step")
    settling, overshoot = f"{number(step['settling_time_s'])} s", percent(step["overshoot_pct"])
    # simulate prints these rows, run's page has the others.
    (terminal,) = (row for row in responses_table(result).rows if row[3] == "P_pcc")
    (judged,) = targets_table(step_outcomes(result)).rows
    measured = next(row for row in metrics_table(result, controller).rows if row[2] == "P, step")
    assert (terminal[4], terminal[5]) == (f"{overshoot} %", settling)
    assert (judged[6], judged[3]) == (overshoot, number(step["settling_time_s"]))
    assert (measured[3], measured[4]) == (overshoot, number(step["settling_time_s"]))
    # They are those of a mean that is made here.
    P, t = controller.series["P_pcc"], controller.series["t_s"]
    mean = np.convolve(P, np.full(400, 1.0 / 400.0), "full")[: len(P)]
    begin, initial = 10_000, float(mean[9999])
    final = float(np.mean(P[-1200:])) if bridge == "pwm" else step["final"]  # whole cycles of the last tenth
    error = np.abs((mean[begin:] - final) / (final - initial))
    last = t[begin + np.flatnonzero(error > 0.02)[-1]] - 0.5
    assert last <= step["settling_time_s"] <= last + 50e-6
    beyond = 100.0 * max((mean[begin:].max() - final) / (final - initial), 0.0)
    assert step["overshoot_pct"] == pytest.approx(beyond, abs=1e-6)
    # Those of the power itself say so, and differ.
    raw = step["instantaneous"]
    if bridge == "pwm":
        assert raw["settling_time_s"] is None or raw["settling_time_s"] > step["settling_time_s"] + 0.1
    else:
        assert raw["settling_time_s"] == pytest.approx(step["settling_time_s"] - 0.01, abs=1e-3)
    assert (measured[8], measured[9]) != (measured[3], measured[4])
