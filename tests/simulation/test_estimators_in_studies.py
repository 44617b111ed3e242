"""Every estimator in the loop of a small study: what it finds, what it does not claim, and what is refused."""

from __future__ import annotations

import functools
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import StudyError
from vsgdesign.identification import ESTIMATORS
from vsgdesign.report.scenario.page import limits_of_validity
from vsgdesign.simulation.estimated import ALL_STATUSES, EstimateLog
from vsgdesign.simulation.scenario import ControllerResult, run_scenario
from vsgdesign.study.parameters import load_study, study_from_text
from vsgdesign.verbs.pipeline.run import run_study

NAMES = tuple(name for name, kind in ESTIMATORS.items() if not (kind.trained or kind.by_sample))

TEXT = """
base = "case:hoang2025_5kva"
simulation = { duration = "1 s", P_ref = "2 kW", Q_ref = "1 kvar" }
events = [{ time = "0.4 s", P_ref = "3 kW" }]
controllers = [CONTROLLERS]
"""


def text(*names: str, extra: str = "") -> str:
    rows = (f'{{ name = "{name}", kind = "scheduled", estimate = "{name}"{extra} }}' for name in names)
    return TEXT.replace("CONTROLLERS", ", ".join(rows))


@functools.cache
def runs() -> dict[str, ControllerResult]:
    return {run.spec.name: run for run in run_scenario(study_from_text(text(*NAMES))).controllers}


def log_of(name: str) -> EstimateLog:
    log = runs()[name].estimates
    assert log is not None
    return log


@pytest.mark.parametrize("name", NAMES)
def test_it_runs_and_says_something_after_every_window(name: str) -> None:
    log = log_of(name)
    np.testing.assert_allclose(log.t_s, 0.02 * np.arange(1, 51))
    assert log.period == pytest.approx(0.02)
    assert set(log.status) <= set(ALL_STATUSES)
    assert runs()[name].spec.update_period == pytest.approx(0.02)


@pytest.mark.parametrize(("name", "within"), [("injection", 0.01), ("prbs", 0.002)])
def test_a_probe_finds_the_grid_at_rest(name: str, within: float) -> None:
    """Averaged bridge, ideal sensors, before the step: what remains is the power's own creeping."""
    log = log_of(name)
    rest = (log.t_s > 0.2) & (log.t_s < 0.4)
    np.testing.assert_allclose(log.R_g_hat[rest], log.R_g[rest], rtol=within)
    np.testing.assert_allclose(log.L_g_hat[rest], log.L_g[rest], rtol=within)
    assert {log.status[k] for k in np.flatnonzero(rest)} == {"ok"}


@pytest.mark.parametrize("name", ["rls", "kalman"])
def test_a_passive_method_claims_nothing_before_the_step(name: str) -> None:
    """The gains stay those of the start: an estimate that is not believed is not followed."""
    log = log_of(name)
    assert Counter(log.status[:20]) == {"uncertain": 20}
    assert np.isfinite(log.R_g_deviation[:20]).all()
    changes = runs()[name].gain_changes
    assert all(change.t_s > 0.4 for change in changes[1:])
    assert len(changes) > 1
    guess = 7.26 / 6.3
    assert log.R_g_hat[10] == pytest.approx(guess, rel=0.01)  # of SCR 6.3: nobody told it the study's grid


def test_the_statuses_of_files_are_counted_as_ever() -> None:
    """A column of numbers, so an order that files rely on: new ones are added at its end."""
    assert ALL_STATUSES[:5] == ("ok", "not finite", "saturated", "outside", "no design")


def test_a_table_goes_to_its_safe_place_while_nothing_is_known() -> None:
    """The guards are those that ship: after a long silence the gains leave the grid of the start."""
    study = study_from_text(text("kalman", extra=', schedule = "table", table = "t.json", structure = "angle_damped"'))
    study = replace(study, events=(), tau_P=5e-3, tau_Q=5e-3)
    (run,) = run_scenario(study, Ready(tables={"kalman": table()})).controllers
    assert run.estimates is not None
    assert set(run.estimates.status) == {"uncertain"}
    settings_rate = run.estimates.rate
    assert settings_rate is not None
    assert len(run.gain_changes) > 1


def test_another_converter_takes_windows_of_its_own() -> None:
    """1 MVA, 60 Hz, 6 kHz, LCL: a cycle is 16.7 ms, and the sequence finds the grid at the PCC, beyond L_2."""
    study = study_from_text(
        """
base = "case:utility_1mva_60hz"
simulation = { duration = "0.5 s", P_ref = "400 kW", Q_ref = 0 }
controllers = [{ name = "prbs", kind = "scheduled", estimate = "prbs" }]
"""
    )
    (run,) = run_scenario(study, bridge="averaged").controllers
    log = run.estimates
    assert log is not None
    assert log.period == pytest.approx(1.0 / 60.0)
    assert log.R_g_hat[-1] == pytest.approx(log.R_g[-1], rel=0.005)  # measured 0.001
    assert log.L_g_hat[-1] == pytest.approx(log.L_g[-1], rel=0.005)


def test_a_limited_current_gives_no_estimate() -> None:
    """A sag to half for 0.1 s, and a limit of 1 pu: while it acts nothing is learnt, and the gains stay."""
    limited = text("prbs").replace(
        'events = [{ time = "0.4 s", P_ref = "3 kW" }]',
        """
converter = { current_limit_pu = 1.0 }
events = [{ time = "0.4 s", V_g_pu = 0.5 }, { time = "0.5 s", V_g_pu = 1.0 }]""",
    )
    (run,) = run_scenario(study_from_text(limited)).controllers
    log = run.estimates
    assert log is not None
    assert log.status[20] == "limited"
    assert set(log.status[20:26]) == {"limited", "waiting"}  # five windows more than the limited one
    assert "limited" not in log.status[:20]
    assert not any(0.4 < change.t_s < 0.5 for change in run.gain_changes)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (text("kalmann"), r'estimate = "kalmann".*"truth", "constant", "two_windows", "rls", "kalman"'),
        (text("kalman", extra=", update_period = 0.02"), r'update_period = "0\.02 s".*Leave it out'),
        (text("neural"), r'estimate = "neural": there is no network to estimate with.*\[estimator\]'),
    ],
)
def test_what_a_study_may_not_ask(changed: str, said: str) -> None:
    with pytest.raises(StudyError, match=said):
        study_from_text(changed)


def test_a_run_leaves_out_the_c_that_there_is_not_and_says_so(tmp_path: Path) -> None:
    """The scheduler's C is there, without an estimator; the sentence is on the terminal and on the page."""
    write_table_file(table(), tmp_path / "t.json")
    short = text("kalman", extra=', schedule = "table", table = "t.json", structure = "angle_damped"')
    short = short.replace('"1 s"', '"0.1 s"').replace('events = [{ time = "0.4 s", P_ref = "3 kW" }]', "")
    (tmp_path / "study.toml").write_text(short)
    said: list[str] = []
    study = load_study(tmp_path / "study.toml")
    run_study(study, tmp_path / "out", report=False, warn=said.append)
    sentence = "kalman: there is no C for the extended Kalman filter yet."
    assert any(one.startswith(sentence) for one in said)
    result = run_scenario(study, Ready(tables={"kalman": table()}))
    assert any(one.startswith(sentence) for one in limits_of_validity(result))
    manifest = json.loads((tmp_path / "out" / "kalman.c" / "manifest.json").read_text())
    assert manifest["weights"] is None
