"""Runs as a whole: repeatable to the bit, interruptible, honest about divergence."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.studies import FAST_GAINS, GAINS, lc_study, lcl_study
from vsgdesign.errors import SimulationDivergedError
from vsgdesign.simulation import GainChange, Simulation, added_source, run, simulate
from vsgdesign.simulation.circuit_sample import carrier, modulation
from vsgdesign.simulation.loop import LOG_COLUMNS

JUMP = '[[events]]\ntime = "7.013 ms"\nphase_jump = "5 deg"\n'
EVENTS = """
[[events]]
time = "20.013 ms"
phase_jump = "5 deg"
[[events]]
time = "30 ms"
f_g = "50.4 Hz"
over = "40 ms"
"""
CHANGES = [GainChange(0.0, GAINS), GainChange(0.05, FAST_GAINS)]


def same(a: Simulation, b: Simulation) -> bool:
    return (
        a.log.tobytes() == b.log.tobytes()
        and a.controller_log.tobytes() == b.controller_log.tobytes()
        and a.final_plant.tobytes() == b.final_plant.tobytes()
        and tuple(a.final_state) == tuple(b.final_state)
    )


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_runs_repeat_to_the_bit(bridge: str) -> None:
    study = lc_study("0.1 s", EVENTS)
    one = simulate(study, CHANGES, bridge=bridge, log_states=500)
    two = simulate(study, CHANGES, bridge=bridge, log_states=500)
    watched = simulate(study, CHANGES, bridge=bridge, log_states=500, progress=[].append)
    assert same(one, two)
    assert same(one, watched)


def test_where_the_run_is_cut_for_progress_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the source's turning restarts at a cut, so it differs by its rounding: no more than 1e-11 of rated."""
    study = lc_study("0.1 s", EVENTS)
    whole = simulate(study, CHANGES, bridge="pwm")
    times: list[float] = []
    monkeypatch.setattr(added_source, "PROGRESS_STRETCH", 1.25e-3)
    monkeypatch.setattr(run, "_SPELL_STRETCHES", 1)
    cut = simulate(study, CHANGES, bridge="pwm", progress=times.append)
    assert len(times) >= 80
    counts = LOG_COLUMNS.index("limited_samples")
    scale = np.max(np.abs(whole.log[:, :counts]), axis=0)
    assert np.max(np.abs(whole.log[:, :counts] - cut.log[:, :counts]) / scale) < 1e-11


def test_progress_tells_the_time_and_may_stop_the_run() -> None:
    study = lc_study("3.2 s", log="200 us")
    times: list[float] = []
    simulate(study, CHANGES, progress=times.append)
    assert times == sorted(times)
    assert times[-1] == pytest.approx(3.2, rel=1e-12)
    assert {1.0, 2.0, 3.0} <= {round(t, 9) for t in times}

    seen: list[float] = []

    def stop(t_s: float) -> None:
        seen.append(t_s)
        if t_s > 1.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(study, CHANGES, progress=stop)
    assert seen[-1] == pytest.approx(2.0)


def test_the_log_is_a_subset_of_every_sample() -> None:
    """Logging less changes nothing but the number of rows."""
    fine, coarse = (simulate(lc_study("20 ms", JUMP, log=log), CHANGES) for log in ("50 us", "350 us"))
    assert coarse.log.tobytes() == fine.log[::7].tobytes()
    np.testing.assert_allclose(coarse.t_s, np.arange(len(coarse.t_s)) * 350e-6, rtol=1e-14)
    assert len(coarse.t_s) == -(-400 // 7)
    assert coarse.column("theta").tobytes() == coarse.log[:, LOG_COLUMNS.index("theta")].tobytes()


def test_the_first_gains_must_be_there_from_the_start() -> None:
    for changes in ([], [GainChange(0.1, GAINS)]):
        with pytest.raises(ValueError, match="at or before t = 0"):
            simulate(lc_study("1 ms"), changes)


def test_divergence_is_said_with_its_time() -> None:
    """Inner loops far too fast for this grid blow up; the message says when and what to do, the log ends before."""
    study = lcl_study("60 s", current_response_time='"0.2 ms"', voltage_response_time='"0.3 ms"')
    run = simulate(study, [GainChange(0.0, GAINS._replace(K_ip=1e5))], bridge="averaged")
    assert run.divergence is not None
    assert run.t_s[-1] < run.divergence.t_s < 0.1
    assert np.isfinite(run.log).all()
    with pytest.raises(SimulationDivergedError, match=r"diverged at 0\.\d+ s: .*power loops"):
        run.to_its_end()


def test_gains_and_references_act_at_the_first_sample_at_or_after_their_time() -> None:
    """49.9 of a sampling period late is the next sample, a rounding error early is this one."""
    step = '[[events]]\ntime = {time}\nP_ref = "3 kW"\n'
    on, early, late = (
        simulate(lc_study("10 ms", step.format(time=t)), CHANGES).column("omega")
        for t in ("0.005", "0.004999999999999999", "0.00500001")
    )
    assert np.array_equal(on, early)
    k = 100
    assert np.array_equal(on[: k + 1], late[: k + 1])
    assert on[k + 1] != late[k + 1]
    np.testing.assert_allclose(late[k + 2], on[k + 1], rtol=1e-4)


@pytest.mark.parametrize("zero_sequence", [False, True])
def test_modulation_fills_the_dc_link(zero_sequence: bool) -> None:
    """Indices reach ±1 at the linear limit and keep the line-to-line voltages."""
    limit = 700.0 / 3.0**0.5 if zero_sequence else 350.0
    largest = 0.0
    for angle in np.linspace(0.0, 2.0 * np.pi, 721):
        m = modulation(limit * np.cos(angle), limit * np.sin(angle), 700.0, zero_sequence)
        largest = max(largest, *(abs(x) for x in m))
        line = limit * 3.0**0.5 * np.cos(angle + np.pi / 6.0)
        assert (m[0] - m[1]) * 350.0 == pytest.approx(line, abs=1e-9)
    assert largest == pytest.approx(1.0, abs=1e-4)


def test_carrier_is_a_triangle_with_its_valley_at_zero() -> None:
    p = np.linspace(0.0, 1.0, 101)
    expected = 2.0 / np.pi * np.arcsin(-np.cos(2.0 * np.pi * p))
    np.testing.assert_allclose([carrier(x) for x in p], expected, atol=1e-7)
