"""Gains from an estimate: a network that always says the same, spoiled windows, refusals, the grid's phase."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.artifacts.networks import random_weights
from tests.gain_tables import table
from tests.simulation.studies import GAINS
from vsgdesign.artifacts.network_weights import Network, NetworkWeights
from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import References
from vsgdesign.errors import ArtifactError, InfeasibleStudyError
from vsgdesign.report.scenario.estimate_tables import estimate_text
from vsgdesign.runtime.of_study import schedule_of
from vsgdesign.simulation import MeasuredWindow, simulate
from vsgdesign.simulation.estimated import NO_DESIGN, TRAINED_PHASE, EstimatedScheduler, window_channels
from vsgdesign.simulation.gains import GainChange, settled_changes
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.scenario.checking import check_scenario
from vsgdesign.simulation.scenario.judging import judge_estimates
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.grid import Grid

TEXT = """
base = "case:hoang2025_5kva"
simulation = { duration = "0.2 s", P_ref = "2 kW", Q_ref = "1 kvar" }
controllers = [
    { name = "truth", kind = "scheduled" },
    { name = "network", kind = "scheduled", estimate = "neural" },
]
events = [{ time = "0.1 s", grid = { scr = 8 } }]
[estimator]
"""


def always(R_g: float, L_g: float, **changes: Any) -> NetworkWeights:
    """A network that has one answer."""
    weights = random_weights(**changes)
    network, (R, L) = weights.network, (weights.network.outputs.apply(np.array([R_g, L_g])))
    constant = Network(
        network.W_1, network.b_1, np.zeros_like(network.W_2), np.array([R, L]), network.inputs, network.outputs
    )
    return replace(weights, network=constant)


def study_with(weights: NetworkWeights, lines: str = "", text: str = TEXT) -> tuple[Study, Ready]:
    return study_from_text(text + lines), Ready(network=weights)


def network_of(study: Study, ready: Ready):
    result = run_scenario(study, ready)
    return next(c for c in result.controllers if c.spec.name == "network"), result


def test_the_answer_acts_where_its_window_ends_and_goes_through_the_schedule() -> None:
    study, ready = study_with(always(0.9, 2.9e-3))
    run, result = network_of(study, ready)
    first, then = run.gain_changes
    truth = schedule_of(study, study.controllers[0])
    assert (first.t_s, first.gains) == (0.0, truth.gains(study.grid.R_g, study.grid.L_g))
    assert then.t_s == pytest.approx(0.02)
    np.testing.assert_allclose(then.gains, truth.gains(0.9, 2.9e-3), rtol=1e-9)
    log = run.estimates
    assert log is not None
    np.testing.assert_allclose(log.t_s, 0.02 * np.arange(1, 11))
    np.testing.assert_allclose(log.R_g_hat, 0.9)
    # A change that coincides with the end of a window is seen by the next one.
    later = study.events[0].grid
    assert later is not None
    np.testing.assert_allclose(log.L_g, [study.grid.L_g] * 5 + [later.L_g] * 5)
    (judged,) = judge_estimates(result)
    assert (judged.name, judged.with_the_truth, judged.statuses) == ("network", "truth", {"ok": 10})
    assert len(judged.rest) == 2


def test_the_truth_as_an_estimate_is_the_truth() -> None:
    """The same run as with the true impedance; only its gains are rounded by the network's scaling."""
    study, ready = study_with(always(3.0, 9e-3))
    study = replace(study, events=(), grid=Grid(3.0, 9e-3))
    run, result = network_of(study, ready)
    truth = result.controllers[0]
    np.testing.assert_allclose(run.series["P_pcc"], truth.series["P_pcc"], rtol=1e-9)
    np.testing.assert_allclose(run.series["K_ip"], truth.series["K_ip"], rtol=1e-9)


def test_a_window_without_an_estimate_holds_the_gains() -> None:
    run, _ = network_of(*study_with(always(0.9, 2.9e-3), "v_limit_pu = 1.0"))
    log = run.estimates
    assert log is not None
    assert set(log.status) == {"saturated"}
    assert len(run.gain_changes) == 1
    assert np.isnan(log.R_g_hat).all()
    assert np.isfinite(log.series()["status"]).all()


def test_a_network_that_was_trained_with_another_bridge_is_told_of() -> None:
    """A switched bridge biases the samples of its windows, and only a network that was trained so takes it away."""
    study, ready = study_with(replace(always(0.9, 2.9e-3), recipe={"bridge": "pwm"}))
    said: list[str] = []
    run_scenario(study, ready, warn=said.append)
    (told,) = (text for text in said if "trained with" in text)
    assert told.startswith(
        "network: its network was trained with a switched bridge (PWM), and this run has an averaged"
    )
    assert told in check_scenario(study, ready)
    assert not any("trained with" in text for text in check_scenario(study, ready, bridge="pwm"))
    unknown = Ready(network=always(0.9, 2.9e-3))
    assert not any("trained with" in text for text in check_scenario(study, unknown))


def test_an_estimate_that_has_no_gains_holds_them() -> None:
    """A short grid delivers the 4.5 kW that the design absorbs, 4 Ω and 11 mH do not."""
    text = TEXT.replace('kind = "scheduled"', 'kind = "scheduled", P_design = "-4.5 kW"')
    study, ready = study_with(always(4.0, 11e-3), "[grid]\nscr = 8\nx_over_r = 1", text)
    run, _ = network_of(study, ready)
    log = run.estimates
    assert log is not None
    assert set(log.status) == {NO_DESIGN}
    np.testing.assert_allclose(log.R_g_hat, 4.0)
    assert len(run.gain_changes) == 1


def test_a_table_takes_estimates_too() -> None:
    """Through the scheduler that ships: gains at the measured powers, as soon as its rate limit lets them."""
    text = TEXT.replace('estimate = "neural"', 'estimate = "neural", structure = "angle_damped", P_design = "2 kW"')
    text = text.replace('duration = "0.2 s"', 'duration = "2 s"')
    study, ready = study_with(always(0.9, 2.9e-3), text=text)
    made = replace(study.controllers[1], schedule="table")
    ready = ready.with_table(made.name, table())
    study = replace(study, controllers=(made,), tau_P=5e-3, tau_Q=5e-3)
    run, result = network_of(study, ready)
    P, Q, V_rms = (float(run.simulation.column(name)[-1]) for name in ("P", "Q", "V_rms"))
    expected = schedule_of(study, made, ready).gains_measured(0.9, 2.9e-3, P, Q, V_rms)
    np.testing.assert_allclose(run.gain_changes[-1].gains, expected, rtol=2e-3)
    assert len({change.gains for change in run.gain_changes}) > 3  # in steps, not in one
    judged = judge_estimates(result)[0]
    assert judged.with_the_truth is None
    # SCR 1.41 is not in the box, so it begins at the nearest one, 1.5, and goes to 5.67, by 1.2 a window:
    # ln(5.67/1.5)/ln 1.2 = 7.3, the eighth window arrives.
    assert judged.rate_limit is not None
    assert judged.rate_limit[0] == 10.0
    assert judged.rate_limit[1] == pytest.approx(7 * 0.02)
    assert "held the gains behind the estimate" in estimate_text(result, [judged])[0]
    assert "certificate" not in estimate_text(result, [judged])[0]


@pytest.mark.parametrize("with_table", [False, True])
def test_it_says_which_grid_its_gains_are_for(with_table: bool) -> None:
    """At first the study's own, or the nearest one of a table that has no such grid; in the end the estimate."""
    text = TEXT.replace('estimate = "neural"', 'estimate = "neural", structure = "angle_damped", P_design = "2 kW"')
    study, ready = study_with(always(0.9, 2.9e-3), text=text)
    spec = study.controllers[1]
    if with_table:
        spec = replace(spec, schedule="table")
        ready = ready.with_table(spec.name, table())
    scheduler = EstimatedScheduler(study, spec, ready)
    scheduler.first_gains()
    first = scheduler.grid
    assert first.scr(study.converter, "impedance") == pytest.approx(
        1.5 if with_table else study.grid.scr(study.converter, "impedance"), rel=1e-6
    )
    simulate(study, scheduler)
    assert (scheduler.grid.R_g, scheduler.grid.L_g) == pytest.approx((0.9, 2.9e-3), rel=2e-3)


def test_the_rate_of_a_certificate_that_holds_gains_back_is_said() -> None:
    text = TEXT.replace('estimate = "neural"', 'estimate = "neural", structure = "angle_damped", P_design = "2 kW"')
    study, ready = study_with(always(0.9, 2.9e-3), text=text)
    slow = table(certificate={"region": {"rate": 0.05}, "decay": 1.0})
    study = replace(study, controllers=(replace(study.controllers[1], schedule="table"),))
    ready = ready.with_table(study.controllers[0].name, slow)
    _, result = network_of(replace(study, tau_P=5e-3, tau_Q=5e-3), ready)
    (judged,) = judge_estimates(result)
    assert judged.rate_limit is not None
    assert judged.rate_limit[0] == pytest.approx(0.05, rel=1e-6)
    assert judged.rate_limit[1:] == pytest.approx((0.16, 0.2))  # all windows but the two that wait to be confirmed
    assert (
        "5 % per second. That is the rate that the table's certificate is good for"
        in estimate_text(result, [judged])[0]
    )


def test_everything_that_does_not_fit_is_refused_at_once() -> None:
    weights = random_weights(synchronised=True)
    weights = replace(
        weights,
        window=replace(weights.window, sample_interval=170e-6),
        training={"converter": {"S_rated": 1e6, "f_n": 60.0}},
    )
    with pytest.raises(ArtifactError) as caught:
        run_scenario(*study_with(weights, text=TEXT.replace('"neural"', '"neural", update_period = 0.02')))
    for words in (
        "controller network",
        "update_period = 20 ms",
        "100 × 170 µs = 17 ms",
        "sample_interval = 170 µs",
        "sampling period, 50 µs",
        "S_rated = 5000 VA",
        "1e+06 VA",
        "f_n = 50 Hz",
        "with 60 Hz",
        "grid_phase = false",
        "no converter in the field",
    ):
        assert words in str(caught.value)


def test_a_network_that_is_not_there_is_asked_for() -> None:
    with pytest.raises(InfeasibleStudyError, match=r"controller network: .* estimator train"):
        run_scenario(study_from_text(TEXT))


def window(v: np.ndarray, i: np.ndarray, theta: np.ndarray, source_phase: float) -> MeasuredWindow:
    return MeasuredWindow(
        index=0,
        t_s=0.02,
        sample_interval=200e-6,
        v_pcc=v,
        i_pcc=i,
        theta=theta,
        P=0.0,
        Q=0.0,
        V_rms=110.0,
        omega=314.0,
        refs=References(0.0, 0.0, 314.0, 110.0),
        gains=GAINS,
        source_phase=source_phase,
    )


def vectors(length: float, angle: np.ndarray) -> np.ndarray:
    return length * np.column_stack([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize("off", [0.0, 0.4, -2.0])
def test_synchronised_windows_are_turned_to_the_trained_phase(off: float) -> None:
    turning = 2.0 * math.pi * np.arange(100) / 100
    source = TRAINED_PHASE + off
    seen = window(vectors(150.0, source + turning + 0.3), vectors(20.0, source + turning), turning, source)
    v, i = window_channels(seen, "phase_a", True)
    np.testing.assert_allclose(v, 150.0 * np.cos(TRAINED_PHASE + turning + 0.3), atol=1e-10)
    np.testing.assert_allclose(i, 20.0 * np.sin(turning), atol=1e-11)  # phase A of the grid: zero at the begin
    v, _ = window_channels(seen, "phase_a", False)
    np.testing.assert_allclose(v, seen.v_pcc[:, 0])
    v, i = window_channels(seen, "alpha_beta", False)
    np.testing.assert_allclose(np.stack([v.T, i.T]), [seen.v_pcc, seen.i_pcc])


def test_dq_is_seen_from_the_converter() -> None:
    turning = 2.0 * math.pi * np.arange(100) / 100
    v, i = window_channels(window(vectors(150.0, turning + 0.3), vectors(20.0, turning), turning, 0.0), "dq", False)
    np.testing.assert_allclose(v, np.tile([[150.0 * math.cos(0.3)], [150.0 * math.sin(0.3)]], 100), atol=1e-10)
    np.testing.assert_allclose(i, np.tile([[20.0], [0.0]], 100), atol=1e-11)


def test_the_scheduler_forgets_its_last_run() -> None:
    study, ready = study_with(always(0.9, 2.9e-3))
    scheduler = EstimatedScheduler(study, study.controllers[1], ready)
    angle = 2.0 * math.pi * np.arange(100) / 100
    for _ in range(2):
        scheduler.first_gains()
        scheduler.update(window(vectors(150.0, angle), vectors(20.0, angle), angle, 0.0))
    assert len(scheduler._rows) == 1


def test_the_changes_that_hold_before_an_event() -> None:
    changes = [GainChange(0.02 * k, GAINS._replace(D_p=float(k))) for k in range(100)]
    kept = settled_changes(changes, [0.5, 1.0], 2.0)
    assert [round(change.t_s, 9) for change in kept] == [0.0, 0.48, 0.98, 1.98]
    assert settled_changes(changes[:1], [0.5], 2.0) == (changes[0],)
