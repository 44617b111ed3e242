"""The figures and verdicts of a run are those of every sample, whatever its study logs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.simulation.studies import GAINS, lc_study
from vsgdesign.artifacts import read_npz
from vsgdesign.equations.frames import instantaneous_power
from vsgdesign.metrics.step_response import cycle_mean
from vsgdesign.simulation import GainChange, build_timeline, every_sample, simulate
from vsgdesign.simulation.every_sample import MOST_SAMPLES, AtPcc, EverySample, spacing_of_figures
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import study_from_text
from vsgdesign.verbs.pipeline.run import run_study

DIP = """
base = "case:hoang2025_5kva"
converter = {{ current_limit_pu = 1.2, current_limiter = "projection" }}
controllers = [
  {{ name = "held", kind = "fixed", structure = "angle_damped", settling_time = 0.3 }},
  {{ name = "told", kind = "scheduled", structure = "angle_damped", settling_time = 0.3, estimate = "kalman" }},
]
events = [
  {{ time = "0.21 s", P_ref = "3.5 kW" }},
  {{ time = "0.813 s", V_g_pu = 0.1, phase_jump = 0.6 }},
  {{ time = "0.93 s", V_g_pu = 1, phase_jump = -0.6 }},
]

[simulation]
duration = "2.4 s"
bridge = "{bridge}"
survival = true
P_ref = "3 kW"
Q_ref = "0 var"
log_interval = "{log}"
csv_interval = "{csv}"
"""

_OF_THE_FILES = ("study", "timing_s", "files", "sha256", "real_time_factor", "loop_s")


def figures(document: Any) -> Any:
    """A document without what belongs to its study, its files and the clock."""
    if isinstance(document, dict):
        return {key: figures(value) for key, value in document.items() if key not in _OF_THE_FILES}
    return [figures(one) for one in document] if isinstance(document, list) else document


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_a_coarse_log_changes_no_figure_and_no_verdict(tmp_path: Path, bridge: str) -> None:
    """Settling times, overshoots, peaks, survival and the rest after the run: the same to the bit."""
    texts = [DIP.format(bridge=bridge, log=log, csv=csv) for log, csv in (("0.2 ms", "2 ms"), ("0.1 s", "0.7 s"))]
    outs = [tmp_path / name for name in ("fine", "coarse")]
    fine, coarse = (run_study(study_from_text(text), out, report=False) for text, out in zip(texts, outs, strict=True))
    # As text, because a figure that is no number is not equal to itself.
    assert json.dumps(figures(coarse)) == json.dumps(figures(fine))
    assert fine["figures_every_s"] == 50e-6
    survival = fine["controllers"]["held"]["survival"]
    assert survival["recovery_s"] > 0.0  # there is something to compare
    assert survival["limited_s"] > 0.0
    # The coarse log is a decimation of the fine one.
    every, few = (read_npz(out / "told.npz") for out in outs)
    assert list(every) == list(few)
    for name, values in few.items():
        np.testing.assert_array_equal(values, every[name][::500])


def test_figures_are_those_of_a_log_of_every_sample() -> None:
    """Against a reading of such a log that knows nothing of how a run is measured."""
    events = '[[events]]\ntime = "1.0001 s"\nP_ref = "2.5 kW"\n'
    study = lc_study("6 s", events, log="1 s")
    (coarse,) = run_scenario(study).controllers
    (fine,) = run_scenario(replace(study, simulation=replace(study.simulation, log_interval=50e-6))).controllers
    (step,) = (event for event in coarse.events if event.signal == "P_pcc")
    rows = fine.series["t_s"] > 1.0001 - 1e-6
    t, P = fine.series["t_s"][rows], fine.series["P_pcc"][rows]
    assert step.raw.overshoot_pct == pytest.approx(100.0 * max(P.max() - 2500.0, 0.0) / 500.0, abs=1e-6)
    assert step.raw.final is not None
    assert step.raw.settling_time_s is not None
    last = float(t[np.flatnonzero(np.abs(P - step.raw.final) > 10.0)[-1]]) - 1.0001
    assert last <= step.raw.settling_time_s <= last + 50e-6
    # The phases' sum of squares is 3/2 of the peak.
    length = np.sqrt(sum(fine.series[f"i_pcc_{phase}"][rows] ** 2 for phase in "abc") / 1.5)
    assert step.peak_current_pu == pytest.approx(length.max() / study.converter.I_rated_pk, rel=1e-12)
    assert len(coarse.series["t_s"]) == 6


@pytest.mark.parametrize("apart", [1, 5])
def test_parts_of_a_run_are_the_whole_of_it(monkeypatch: pytest.MonkeyPatch, apart: int) -> None:
    """What is taken while a run goes on, second by second, has the bits of NumPy on a log of all of it, with two grids.
    No part is as long as the run."""
    events = '[[events]]\ntime = "1.0001 s"\nP_ref = "2.5 kW"\n[[events]]\ntime = "1.70003 s"\ngrid = { scr = 5 }\n'
    study = lc_study("2.5 s", events, log="50 us")
    whole, coarse = (replace(study, simulation=replace(study.simulation, log_interval=s)) for s in (50e-6, 0.25))
    monkeypatch.setattr(every_sample, "MOST_SAMPLES", 50_000 // apart)
    timeline, gains, per_mean = build_timeline(study), [GainChange(0.0, GAINS)], 400 // apart
    seen, parts = EverySample(coarse, timeline, per_mean), []
    take = seen.take
    monkeypatch.setattr(seen, "take", lambda *given: (parts.append(len(given[2])), take(*given)))
    run, logged = simulate(coarse, gains, every_sample=seen), simulate(whole, gains)
    assert max(parts) <= 20_001
    log, t_s = logged.log[::apart], logged.t_s[::apart]
    v, i = AtPcc(study, timeline).rows(t_s, log, logged.circuit_log[::apart])
    powers = instantaneous_power(*v.T, *i.T)
    for found, power, mean in zip(seen.signals[1:3], powers, seen.means, strict=True):
        np.testing.assert_array_equal(found, power)
        np.testing.assert_array_equal(mean, cycle_mean(power, per_mean)[:: 5000 // apart])
    for found, vector in ((seen.signals.i_sq, i), (seen.signals.i_s_sq, log[:, :2])):
        np.testing.assert_array_equal(found, vector[:, 0] ** 2 + vector[:, 1] ** 2)
    np.testing.assert_array_equal(seen.end_of(run).log, log[-len(seen.end_of(run).log) :])
    np.testing.assert_array_equal(run.log, logged.log[::5000])


def test_long_runs_are_kept_in_part() -> None:
    """No run takes more rows than its memory holds, and which of them is decided by the least that is needed."""

    def spacing(duration: float, log_interval: float) -> int:
        study = lc_study("1 s", log="1 s")
        return spacing_of_figures(
            replace(study, simulation=replace(study.simulation, duration=duration, log_interval=log_interval))
        )

    assert spacing(60.0, 1.0) == spacing(MOST_SAMPLES * 50e-6, 200e-6) == 1
    assert spacing(36000.0, 1.0) == 40  # 36 would do, and does not divide 20,000
    assert spacing(1000.1, 300e-6) == 2
