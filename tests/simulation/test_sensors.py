"""Sensors in the loop: their errors in the controller's powers and in the windows of estimators."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.studies import GAINS, lc_study, lcl_study
from vsgdesign.simulation import FixedGains, GainChange, Recorder, Simulation, simulate
from vsgdesign.simulation.added_source import NOISE_BLOCK, SensorsOfRun
from vsgdesign.simulation.scenario import derive_series
from vsgdesign.study.parameters import Study

DIRTY = '[sensors]\nlevel = "dirty"\nseed = 2\nskew = "0.3 deg"\n'


def with_windows(study: Study) -> tuple[Simulation, np.ndarray, np.ndarray]:
    """A run, and v_pcc and i_pcc (n) of all its windows, complex."""
    recorder = Recorder(FixedGains(GAINS, sample_interval=50e-6))
    run = simulate(study, recorder, bridge="pwm")
    found = (np.concatenate([getattr(w, name) for w in recorder.windows]) for name in ("v_pcc", "i_pcc"))
    v, i = (vectors[:, 0] + 1j * vectors[:, 1] for vectors in found)
    return run, v, i


def test_windows_hold_what_the_controller_measures() -> None:
    """With an LC filter the PCC is the capacitor node: the controller's P and Q follow from the window's v and i."""
    run, v, i = with_windows(lc_study("0.1 s", DIRTY))
    S = 1.5 * v * np.conj(i)
    measured = run.column("P") + 1j * run.column("Q")
    np.testing.assert_allclose(S, measured[: len(S)], rtol=0.0, atol=1e-9 * 5e3)
    # …and they are not those of the circuit, which judge the run.
    series = derive_series(lc_study("0.1 s", DIRTY), run)
    assert 10.0 < np.std(series["P_pcc"] - measured.real) < 100.0


def test_behind_a_second_inductor_the_voltage_has_the_same_error() -> None:
    """And an error of 1 % in every gain is one of 1 % in what is measured there, but for the inductor's voltage."""
    study = lcl_study("0.1 s", "[sensors]\ngain_errors = [" + "0.01, " * 9 + "]\n")
    run, v, i = with_windows(study)
    i_g = run.column("i_g_alpha") + 1j * run.column("i_g_beta")
    np.testing.assert_allclose(i, 1.01 * i_g[: len(i)], rtol=1e-12)
    node = run.log[:, 2] + 1j * run.log[:, 3] + study.filter.R_c * (run.log[:, 0] + 1j * run.log[:, 1] - i_g)
    series, turns = derive_series(study, run), np.exp(2j * np.pi * np.arange(3) / 3.0)
    true = 2.0 / 3.0 * turns @ np.array([series[f"v_pcc_{phase}"] for phase in "abc"])
    np.testing.assert_allclose(v - true[: len(v)], 0.01 * node[: len(v)], rtol=0.0, atol=1e-9)


def test_bits_and_saturation() -> None:
    """Every reading is a whole number of steps within the range; a sag's current runs into it."""
    sag = '[[events]]\ntime = "40 ms"\nV_g_pu = 0.3\n'
    study = lc_study("0.1 s", sag + "[sensors]\nbits = 8\nrange_pu = 1.2\n", "[grid]\nscr = 8\n")
    recorder = Recorder(FixedGains(GAINS, sample_interval=50e-6))
    simulate(study, recorder)
    i = np.concatenate([w.i_pcc for w in recorder.windows])
    step = 2.0 * 1.2 * study.converter.I_rated_pk / 2**8
    phases = np.array([i[:, 0], -0.5 * i[:, 0] + np.sqrt(0.75) * i[:, 1]]) / step
    # A zero sequence is lost in αβ: thirds of a step remain.
    assert np.max(np.abs(3.0 * phases - np.round(3.0 * phases))) < 1e-6
    assert np.max(np.abs(i)) <= 4.0 / 3.0 * 1.2 * study.converter.I_rated_pk


def test_noise_has_its_size_and_no_colour() -> None:
    study = lc_study("0.4 s", "[sensors]\nnoise = 0.01\nseed = 8\n")
    run, _, i = with_windows(study)
    i_g = (run.column("i_g_alpha") + 1j * run.column("i_g_beta"))[: len(i)]
    noise = (i - i_g) / study.converter.I_rated_pk
    # Three independent phases make √(2/3) of their rms value on each axis; 8,000 samples are right to 0.8 %.
    assert np.std(noise.real) == pytest.approx(0.01 * np.sqrt(2.0 / 3.0), rel=0.04)
    assert np.std(noise.imag) == pytest.approx(0.01 * np.sqrt(2.0 / 3.0), rel=0.04)
    assert abs(np.corrcoef(noise.real[1:], noise.real[:-1])[0, 1]) < 0.05
    assert abs(np.corrcoef(noise.real, noise.imag)[0, 1]) < 0.05


def test_skew_is_a_delay_of_the_currents() -> None:
    """Of the fundamental at rest, by the angle at the nominal frequency; the other way round for a negative one."""
    for skew in (0.5, -0.5):
        study = lc_study("0.1 s", f'[sensors]\nskew = "{skew} deg"\n')
        recorder = Recorder(FixedGains(GAINS, sample_interval=50e-6))
        run = simulate(study, recorder, bridge="averaged")
        window = recorder.windows[-1]
        late = run.log[1600:2000, 4:6] if skew > 0.0 else run.log[1600:2000, 2:4]
        said = window.i_pcc if skew > 0.0 else window.v_pcc
        turned = np.angle((said @ [1.0, 1j]) / (late @ [1.0, 1j]))
        np.testing.assert_allclose(np.degrees(turned), -0.5, atol=1e-4)
        other = window.v_pcc if skew > 0.0 else window.i_pcc
        exact = run.log[1600:2000, 2:4] if skew > 0.0 else run.log[1600:2000, 4:6]
        np.testing.assert_allclose(other, exact, rtol=0.0, atol=1e-9)


def test_a_run_with_sensors_starts_as_if_it_had_always_run() -> None:
    """The first sample of a late current is a sample of the steady state too."""
    run = simulate(lc_study("20 ms", '[sensors]\nskew = "0.9 deg"\n'), [GainChange(0.0, GAINS)], bridge="averaged")
    P = run.column("P")
    assert abs(P[1] - P[0]) < 0.5  # W of 2 kW
    assert 2000.0 - P[0] > 5.0  # what the delay makes of 0.5 kvar; it would be missing in a first sample without it


def test_noise_is_the_same_however_a_run_is_cut() -> None:
    """Also across the border of two streams, and where a run goes back."""
    study = lc_study("0.1 s", "[sensors]\nnoise = 0.01\nseed = 8\n")
    assert study.sensors is not None
    sensors = [SensorsOfRun(study, study.sensors, np.zeros(6), study.converter.omega_n) for _ in range(2)]
    whole = sensors[0].noise(0, 2 * NOISE_BLOCK)
    begins = [0, 1, 400, NOISE_BLOCK - 3, NOISE_BLOCK + 5, 100, 2 * NOISE_BLOCK - 7]
    for begin, count in zip(begins, [1, 399, NOISE_BLOCK - 403, 8, 1000, 60, 7], strict=True):
        np.testing.assert_array_equal(sensors[1].noise(begin, count), whole[begin : begin + count])
    assert np.std(whole / sensors[0].rms, axis=0) == pytest.approx(1.0, rel=0.05)
