"""Responses, faults, inertia and oscillations on traces whose figures are known in closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.compliance.made_runs import made_run, made_trace, times
from vsgdesign.campaigns.compliance.measures import MEASURES
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Fault

W = 2.0 * math.pi * 50.0
JUMP = Event.of_pu(0.1, phase_deg=-10.0)
FAULT = (
    Event.of_pu(0.1, fault=Fault(kind="phase_to_phase")),
    Event.of_pu(0.3, fault="cleared"),
)


def of_vectors(v: Any, i: Any) -> dict[str, Any]:
    """The signals of a trace whose voltage and current are these space vectors."""
    return {"v_alpha_pu": v.real, "v_beta_pu": v.imag, "i_g_alpha_pu": i.real, "i_g_beta_pu": i.imag}


def value(name: str, run: object, **given: float) -> float:
    found = MEASURES[name].of(run, given)  # type: ignore[arg-type]
    assert found.value is not None, found.why
    return found.value


def test_onset_of_a_power_that_rises_exponentially() -> None:
    t = times(0.5)
    since = np.clip(t - 0.1, 0.0, None)
    rise = 0.4 * (1.0 - np.exp(-since / 8e-3))
    run = made_run(made_trace(t, P_pu=0.5 + rise, Q_pu=-rise), JUMP)
    largest = 1.0 - math.exp(-0.05 / 8e-3)
    for share in (0.1, 0.5):
        expected = -8.0 * math.log(1.0 - share * largest)
        assert value("response_ms", run, share=share) == pytest.approx(expected, abs=0.01)  # chords: h²/(8τ)
        assert value("response_Q_ms", run, share=share) == pytest.approx(expected, abs=0.01)
    assert MEASURES["response_ms"].of(run).plus_minus == pytest.approx(0.5)
    assert MEASURES["response_i_ms"].of(run).value is None


def test_power_after_a_jump_counts_against_the_jump() -> None:
    t = times(0.5)
    P = 0.5 + np.where((t >= 0.1 - 1e-9) & (t < 0.16), 0.3, 0.0) - np.where(t >= 0.3, 0.9, 0.0)
    trace = made_trace(t, P_pu=P)
    assert value("dP_pu", made_run(trace, JUMP)) == pytest.approx(0.3)
    assert value("dP_pu", made_run(trace, Event.of_pu(0.1, phase_deg=10.0))) == pytest.approx(0.0, abs=1e-12)
    assert value("dP_pu", made_run(trace, JUMP), within_s=0.01) == pytest.approx(0.3 * 21 / 40)
    assert value("dP_pu", made_run(trace, Event.of_pu(0.1, df_hz=-0.5))) == pytest.approx(0.3)
    assert MEASURES["dP_pu"].of(made_run(trace, Event.of_pu(0.1, P_pu=0.6))).value is None


def test_droop_is_the_change_of_frequency_over_that_of_power() -> None:
    t = times(3.1)
    share = 1.0 - np.exp(-np.clip(t - 0.1, 0.0, None) / 0.1)
    trace = made_trace(t, P_pu=0.5 + 0.2 * share, f_hz=50.0 - 0.5 * share)
    assert value("droop_pu", made_run(trace, Event.of_pu(0.1, df_hz=-0.5))) == pytest.approx(0.05, rel=1e-6)
    still = made_run(made_trace(t, f_hz=50.0 - 0.5 * share), Event.of_pu(0.1, df_hz=-0.5))
    assert "no droop" in MEASURES["droop_pu"].of(still).why
    moving = made_run(made_trace(t, P_pu=0.5 + 0.1 * t), Event.of_pu(0.1, df_hz=-0.5))
    assert "rest" in MEASURES["droop_pu"].of(moving).why


def test_a_ramp_of_a_pure_inertia() -> None:
    """P is 2H/f_n times the rate, and jumps with it; a second ramp back does not matter."""
    t = times(2.1)
    f = 50.0 - np.clip(t - 0.1, 0.0, 0.5) - 0.2 * np.sin(np.clip(t - 0.1, 0.0, 1.0) * 2.0 * math.pi)
    rate = np.where((t >= 0.1 - 1e-9) & (t < 0.6), -1.0, 0.0) - np.where(
        (t >= 0.1 - 1e-9) & (t < 1.1), 0.4 * math.pi * np.cos((t - 0.1) * 2.0 * math.pi), 0.0
    )
    P = 0.5 - 2.0 * 4.0 / 50.0 * rate - 20.0 * (f - 50.0) / 50.0
    run = made_run(made_trace(t, P_pu=P, f_hz=f), Event.of_pu(0.1, df_hz=-0.5, over_s=0.5))
    assert value("H_s", run) == pytest.approx(4.0, rel=0.01)
    assert value("inertial_power_pu", run) == pytest.approx(2.0 * 4.0 / 50.0 * 1.0, rel=0.01)
    limited = made_run(made_trace(t, P_pu=P, f_hz=f, limited=0.5), Event.of_pu(0.1, df_hz=-0.5, over_s=0.5))
    assert "limiter" in MEASURES["H_s"].of(limited).why
    clipped = made_run(made_trace(t, P_pu=np.clip(P, 0.45, 0.6), f_hz=f), Event.of_pu(0.1, df_hz=-0.5, over_s=0.5))
    assert "unexplained" in MEASURES["H_s"].of(clipped).why


@pytest.mark.parametrize("hz", [50.0, 60.0])
def test_sequences_during_a_fault(hz: float) -> None:
    t = times(0.6)
    angle = 2.0 * math.pi * hz * t
    inside = (t >= 0.1 - 1e-9) & (t < 0.3 - 1e-9)
    V1, V2, I1, I2 = 0.6, 0.3 * np.exp(0.4j), 0.8 * np.exp(-0.9j), 0.25 * np.exp(1.0j)

    def vector(before: complex, positive: complex, negative: complex) -> np.ndarray:
        turning = np.exp(1j * angle)
        return np.where(inside, positive * turning + np.conj(negative * turning), before * turning)

    v, i = vector(1.0, V1, V2), vector(0.5, I1, I2)
    trace = made_trace(t, hz, **of_vectors(v, i))
    run = made_run(trace, *FAULT, f_n=hz)
    assert value("positive_sequence_pu", run) == pytest.approx(0.8)
    assert value("negative_sequence_pu", run) == pytest.approx(0.25)
    assert value("V1_pu", run) == pytest.approx(0.6)
    assert value("V2_pu", run) == pytest.approx(0.3)
    turn = np.exp(2j * math.pi / 3.0)
    assert value("fault_current_pu", run) == pytest.approx(max(abs(I1 + I2 * turn**k) for k in range(3)))
    assert value("V_min_pu", run) == pytest.approx(0.6, abs=0.02)  # windows with an edge in them are no phasors
    assert value("P_back_s", run) == 0.0


@pytest.mark.parametrize("hz", [50.0, 60.0])
def test_ripple_of_the_dc_link(hz: float) -> None:
    """A ripple on a drift; the power of a row is the mean since the row before. An ideal link has no ripple of v."""
    t = times(0.6)
    W_2, step = 4.0 * math.pi * hz, t[1] - t[0]
    inside = (t >= 0.1 - 1e-9) & (t < 0.3 - 1e-9)
    mean = 0.3 * (np.sin(W_2 * t) - np.sin(W_2 * (t - step))) / (W_2 * step)
    v = 1.0 - 0.05 * (t - 0.1) + 0.004 * np.cos(W_2 * t + 0.5)
    trace = made_trace(t, hz, P_dc_pu=np.where(inside, 0.5 + 0.2 * t + mean, 0.5), v_dc_pu=np.where(inside, v, 1.0))
    run = made_run(trace, *FAULT, f_n=hz)
    assert value("P_dc_ripple_pu", run) == pytest.approx(0.3, rel=1e-9 if hz == 50.0 else 0.01)
    assert value("v_dc_ripple_pu", run) == pytest.approx(0.004, rel=1e-9 if hz == 50.0 else 0.01)
    assert "ideal" in MEASURES["v_dc_ripple_pu"].of(made_run(made_trace(t, hz), *FAULT, f_n=hz)).why
    assert "no fault" in MEASURES["P_dc_ripple_pu"].of(made_run(made_trace(t), JUMP)).why


def test_reactive_current_arrives_a_cycle_s_share_after_a_step() -> None:
    """The fit's positive sequence of a step of the current follows a line: 90 % is reached at 0.9 cycles."""
    t = times(0.6)
    inside = (t >= 0.1 - 1e-9) & (t < 0.3 - 1e-9)
    v, i = np.exp(1j * W * t), np.where(inside, 0.5 - 0.6j, 0.5) * np.exp(1j * W * t)
    trace = made_trace(t, **of_vectors(v, i))
    sag = (Event.of_pu(0.1, V_g_pu=0.5), Event.of_pu(0.3, V_g_pu=1.0))
    assert value("Iq_90_ms", made_run(trace, *sag)) == pytest.approx(18.0, abs=1.0)
    # A current that takes reactive power from a voltage that falls arrives as soon, and is no support.
    low = np.where(inside, 0.5, 1.0) * v
    assert value("Iq_90_ms", made_run(made_trace(t, **of_vectors(low, i)), *sag)) == pytest.approx(18.0, abs=1.5)
    taken = made_trace(t, **of_vectors(low, np.where(inside, 0.5 + 0.6j, 0.5) * np.exp(1j * W * t)))
    found = MEASURES["Iq_90_ms"].of(made_run(taken, *sag))
    assert (found.value, found.why) == (
        None,
        "the reactive current changes by -0.6 pu, which does not support the voltage",
    )
    dead = made_trace(t, **of_vectors(0.0 * v, i))
    assert "no reference" in MEASURES["Iq_90_ms"].of(made_run(dead, *sag)).why
    assert MEASURES["Iq_90_ms"].of(made_run(made_trace(t), *sag)).value is None


def test_a_fault_of_less_than_a_cycle_has_no_phasors() -> None:
    short = (FAULT[0], Event.of_pu(0.11, fault="cleared"))
    assert "less than a cycle" in MEASURES["V1_pu"].of(made_run(made_trace(times(0.5)), *short)).why


def test_power_that_comes_back_within_its_band() -> None:
    t = times(2.0)
    P = 0.5 + np.where(t >= 0.3 - 1e-9, -0.4 * np.exp(-np.clip(t - 0.3, 0.0, None) / 0.2), 0.0)
    run = made_run(made_trace(t, P_pu=P), *FAULT)
    # Of the mean over a cycle h: 0.4·e^{−t/τ}·(e^{h/τ} − 1)·τ/h = 0.05.
    late = math.log((math.exp(0.02 / 0.2) - 1.0) * 0.2 / 0.02)
    assert value("P_back_s", run) == pytest.approx(0.2 * (math.log(0.4 / 0.05) + late), abs=1e-3)
    gone = made_run(made_trace(t, P_pu=np.where(t > 0.3, 0.4, 0.5)), *FAULT)
    assert MEASURES["P_back_s"].of(gone).value is None


def test_impedance_of_a_voltage_behind_an_impedance() -> None:
    """E = 1 stands still behind Z; the grid's jump changes V and the current, which also has a dc component."""
    t = times(0.4)
    Z, Z_g = 0.02 + 0.3j, 0.01 + 0.2j
    late = t >= 0.1 - 1e-9
    jump = np.exp(1j * math.radians(-10.0))
    i_before, i_after = (1.0 - 0.95) / (Z + Z_g), (1.0 - 0.95 * jump) / (Z + Z_g)
    phasor = np.where(late, i_after, i_before)
    i = phasor * np.exp(1j * W * t) + late * (0.1 - 0.2j)
    v = (1.0 - Z * phasor) * np.exp(1j * W * t)
    run = made_run(made_trace(t, **of_vectors(v, i)), JUMP)
    assert value("Z_effective_pu", run) == pytest.approx(abs(Z), rel=1e-9)
    assert MEASURES["Z_effective_pu"].of(made_run(made_trace(t), JUMP)).value is None


def test_damping_of_an_oscillation_and_of_none() -> None:
    t = times(3.0)
    since = np.clip(t - 0.1, 0.0, None)
    s = complex(-2.0, 2.0 * math.pi * 3.0)
    swing = made_run(made_trace(t, P_pu=0.5 + 0.2 * np.real(np.exp(s * since)) * (t >= 0.1)), JUMP)
    assert value("damping_ratio", swing) == pytest.approx(2.0 / abs(s), rel=1e-3)
    assert value("oscillation_hz", swing) == pytest.approx(3.0, rel=1e-3)
    smooth = made_run(made_trace(t, P_pu=0.5 + 0.2 * np.exp(-5.0 * since)), JUMP)
    assert value("damping_ratio", smooth) == 1.0
    assert MEASURES["oscillation_hz"].of(smooth).value is None
    still = made_run(made_trace(t), JUMP)
    assert "moves by less" in MEASURES["damping_ratio"].of(still).why


def test_nfp_of_a_first_order_response() -> None:
    """ΔP = −K/(1 + sτ)·Δω: −K at low frequencies, and half the power at 1/(2πτ), from the model and the run."""
    K, tau = 20.0, 0.05
    t = times(2.0)
    since = np.clip(t - 0.1, 0.0, None)
    P = 0.5 + K * 0.1 / 50.0 * (1.0 - np.exp(-since / tau))
    run = made_run(made_trace(t, P_pu=P), Event.of_pu(0.1, df_hz=-0.1), nfp=lambda w: -K / (1.0 + 1j * w * tau))
    assert value("nfp_peak_db", run) == pytest.approx(20.0 * math.log10(K), abs=0.01)
    assert value("nfp_at_hz", run) == pytest.approx(0.1, rel=1e-6)
    at = 1.0 / (2.0 * math.pi * tau)
    half = value("nfp_run_peak_db", run, at_least_hz=at)
    # The next bin above the corner is at most 0.25 Hz away.
    assert half == pytest.approx(20.0 * math.log10(K) - 10.0 * math.log10(2.0), abs=0.4)
    assert "no linear model" in MEASURES["nfp_peak_db"].of(made_run(made_trace(t), JUMP)).why
    assert "changes more" in MEASURES["nfp_run_peak_db"].of(made_run(made_trace(t, P_pu=P), *FAULT)).why
