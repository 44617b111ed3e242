"""The fast EMT against an independent one that DOP853 integrates, every state at every sample.

The library's step is exact and DOP853 runs at rtol 1e-10, in fact to rounding; what is left is the growth of rounding
errors through the closed loop over thousands of samples (measured: 2e-12 of rated), and in a frequency ramp the
third-order term that the library's source model leaves out (measured: 7e-11). The tolerance is an order of
magnitude above the worst, for other processors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.oracles.emt_controller import State
from tests.oracles.emt_reference import Start, Trace, at_rest, run_reference
from tests.simulation.studies import FAST_GAINS, GAINS, lc_study, lcl_study
from vsgdesign.linear.operating_point.sampled import steady_state
from vsgdesign.simulation import GainChange, Simulation, gain_changes, simulate
from vsgdesign.simulation.added_source import SensorsOfRun
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.simulation.wander import Wander
from vsgdesign.study.parameters import Grid, GridSource, Study, study_from_text

TOLERANCE = 1e-9

SCR_STEP_AND_PHASE_JUMP = """
[[events]]
time = "8 ms"
grid = { scr = 6 }
[[events]]
time = "20.0123 ms"
phase_jump = "10 deg"
[[events]]
time = "36.02 ms"
P_ref = "3 kW"
Q_ref = "1 kvar"
"""

RAMPS = """
[[events]]
time = "5.011 ms"
V_g_pu = 0.9
over = "13.3 ms"
[[events]]
time = "10 ms"
f_g = "50.6 Hz"
over = "20 ms"
[[events]]
time = "14 ms"
V_g_pu = 1.05
over = "9.01 ms"
"""

SAG = """
[[events]]
time = "2.003 ms"
V_g_pu = 0.3
[[events]]
time = "15 ms"
V_g_pu = 1.0
over = "5 ms"
"""


COMPONENTS = """
[[events]]
time = "12.011 ms"
components = [{ order = -1, amplitude_pu = 0.06, phase = "-20 deg" }, { order = 13, amplitude_pu = 0.01 }]
[[events]]
time = "20.3 ms"
phase_jump = "25 deg"
[[events]]
time = "25 ms"
f_g = "50.8 Hz"
over = "20 ms"
[[events]]
time = "33.33 ms"
components = []
"""

FROM_THE_START = """components = [
    { order = -1, amplitude_pu = 0.02, phase = "30 deg" },
    { order = -5, amplitude_pu = 0.03, phase = "100 deg" },
    { order = 7, amplitude_pu = 0.02 },
]
"""


def library_start(study: Study, gains: Sequence[GainChange]) -> Start:
    """The library's steady start as an initial condition. (Whether it is steady has its own test.)"""
    source = build_timeline(study).source_at(0.0)
    spec, phase, at_start = study.simulation, source.phase, GridSource(source.V_g_rms, source.omega)
    start = steady_state(
        study, study.grid, at_start, study.converter.references(spec.P_ref, spec.Q_ref), gains[0].gains, phase
    )
    x, s, pending = start.plant, start.controller, start.pending
    S = complex(s.P_f, s.Q_f)
    state = State(
        s.theta,
        s.omega_i,
        s.V,
        S,
        complex(s.xi_vd, s.xi_vq),
        complex(s.xi_id, s.xi_iq),
        complex(s.i_f_d, s.i_f_q),
        complex(s.u_alpha, s.u_beta),
        (S, S, S, S),
    )
    return Start(x[0::2] + 1j * x[1::2], state, complex(*pending))


def errors_pu(study: Study, run: Simulation, reference: Trace) -> dict[str, float]:
    """Largest difference of every quantity over all samples, each over its rated value."""
    c = study.converter
    I_pk, V_pk = np.sqrt(2.0) * c.S_rated / (3.0 * c.V_rated_rms), np.sqrt(2.0) * c.V_rated_rms
    log, states = run.log, run.controller_log
    assert log.shape[0] == states.shape[0] == reference.plant.shape[0]
    turned = np.angle(np.exp(1j * (states[:, 0] - reference.theta)))
    final = run.final_plant[0:6:2] + 1j * run.final_plant[1:6:2] - reference.final_plant
    differences = {
        "i_s": (log[:, 0] + 1j * log[:, 1] - reference.plant[:, 0]) / I_pk,
        "v_c": (log[:, 2] + 1j * log[:, 3] - reference.plant[:, 1]) / V_pk,
        "i_g": (log[:, 4] + 1j * log[:, 5] - reference.plant[:, 2]) / I_pk,
        "v_g": (log[:, 6] + 1j * log[:, 7] - reference.source) / V_pk,
        "P, Q": (log[:, 8] + 1j * log[:, 9] - reference.power) / c.S_rated,
        "theta": turned,
        "omega": (states[:, 1] - reference.omega) / c.omega_n,
        "V": (states[:, 2] - reference.V) / c.V_rated_rms,
        "S_f": (states[:, 3] + 1j * states[:, 4] - reference.S_f) / c.S_rated,
        "xi_v": (states[:, 5] + 1j * states[:, 6] - reference.xi_v) / I_pk,
        "xi_i": (states[:, 7] + 1j * states[:, 8] - reference.xi_i) / V_pk,
        "i_f": (states[:, 9] + 1j * states[:, 10] - reference.i_f) / I_pk,
        "final": final / np.array([I_pk, V_pk, I_pk]),
    }
    return {name: float(np.max(np.abs(difference))) for name, difference in differences.items()}


def random_numbers(study: Study) -> dict[str, Any]:
    """What a background and sensors draw: data for the oracle, which has its own equations for what becomes of it."""
    found: dict[str, Any] = {}
    c = study.converter
    if study.background is not None:
        wander = Wander(study.background, c.T_s, c.omega_n)
        found["wander"] = lambda count: wander.factors(0, count)
    if study.sensors is not None:
        sensors = SensorsOfRun(study, study.sensors, np.zeros(6), c.omega_n)
        found["noise"] = lambda count: sensors.noise(0, count)
    if (replay := build_timeline(study).replay) is not None:
        found["record"] = lambda count: replay.vectors(0, count)
    return found


def compare(study: Study, gains: Sequence[GainChange], bridge: str, start: Start | None = None) -> Trace:
    """Run both and hold every error under the tolerance."""
    run = simulate(study, gains, bridge=bridge, log_states=10**9)
    start = start or library_start(study, gains)
    reference = run_reference(study, gains, bridge == "pwm", start, **random_numbers(study))
    errors = errors_pu(study, run, reference)
    print(f"{bridge}: worst {max(errors.values()):.1e} pu;", {name: f"{e:.1e}" for name, e in errors.items()})
    assert max(errors.values()) < TOLERANCE, errors
    return reference


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_grid_step_and_phase_jump(build, bridge: str) -> None:
    study = build("64 ms", SCR_STEP_AND_PHASE_JUMP)
    gains = [GainChange(0.0, GAINS), GainChange(0.04801, FAST_GAINS)]
    reference = compare(study, gains, bridge)
    samples = round(0.064 / study.converter.T_s)
    # Each phase switches once in each half carrier period; at the extremes of the carrier an edge may fall out.
    assert reference.edges == 0 if bridge == "averaged" else reference.edges > 2.9 * samples
    # The run goes somewhere: the events move the power by more than a tenth of the rating.
    assert np.ptp(reference.S_f.real) > 0.1 * study.converter.S_rated
    # …and the loops are stable, so that agreement is not asked of an explosion.
    assert np.max(np.abs(reference.plant[:, 0])) < 2.0 * study.converter.I_rated_pk


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_voltage_and_frequency_ramps(bridge: str) -> None:
    compare(lc_study("40 ms", RAMPS), [GainChange(0.0, GAINS)], bridge)


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_negative_sequence_and_harmonics(bridge: str) -> None:
    """They are there from the start, change between samples, turn with a phase jump and a ramp, and stop."""
    sections = f"[grid]\nscr = 8\nx_over_r = 3\n{FROM_THE_START}"
    compare(lc_study("40 ms", COMPONENTS, sections), [GainChange(0.0, GAINS)], bridge)


EVERYTHING = """
[background]
level = "dirty"
seed = 3
phase_noise = "0.2 mrad"
voltage_noise = 2e-4
voltage_wander = 0.002
voltage_deviation = 0.00076
voltage_steps_per_minute = 600
phase_jumps_per_minute = 600
modulation = 0.01
modulation_frequency = "25 Hz"
interharmonic = 0.005
interharmonic_frequency = "75 Hz"
"""

SENSORS = """
[sensors]
level = "dirty"
seed = 5
skew = "0.2 deg"
"""


@pytest.mark.parametrize(("build", "bridge"), [(lc_study, "pwm"), (lcl_study, "averaged"), (lcl_study, "pwm")])
def test_background(build, bridge: str) -> None:
    """All of a background at once, with events, jumps and ramps on top of it."""
    study = build("40 ms", COMPONENTS + RAMPS.replace("10 ms", "12 ms") + EVERYTHING)
    reference = compare(study, [GainChange(0.0, GAINS)], bridge)
    assert np.max(np.abs(reference.plant[:, 0])) < 2.0 * study.converter.I_rated_pk


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_sensors_in_the_loop(build) -> None:
    compare(
        build(
            "32 ms",
            SCR_STEP_AND_PHASE_JUMP.replace("36.02", "30.02").replace("20.0123", "12.0123") + EVERYTHING + SENSORS,
        ),
        [GainChange(0.0, GAINS)],
        "pwm",
    )


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_a_recorded_source(build, tmp_path) -> None:
    """With steps of the grid, on a sample and between two of them, while the recorded voltage sags."""
    t_s = np.arange(2400) / 6400.0
    phases = np.array([np.cos(2.0 * np.pi * (50.2 * t_s - k / 3.0)) for k in range(3)])
    phases = 150.0 * np.where(t_s > 0.035, 0.8, 1.0) * (phases + 0.03 * np.cos(2.0 * np.pi * 250.0 * t_s))
    np.savez(tmp_path / "grid.npz", a=phases[0], b=phases[1], c=phases[2], sampling_rate=6400.0)
    events = '[[events]]\ntime = "10 ms"\ngrid = { scr = 6 }\n[[events]]\ntime = "25.0123 ms"\ngrid = { scr = 4 }\n'
    study = build("30 ms", events + f'[replay]\nfile = "{tmp_path / "grid.npz"}"\nscale = "1 V"\n')
    compare(study, [GainChange(0.0, GAINS)], "pwm")


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_a_notch_before_the_power_filters(build) -> None:
    """The oracle's is a difference equation. It starts at rest; then a negative sequence appears."""
    study = build("60 ms", COMPONENTS)
    study = replace(study, power_filter="notch", notch_damping=0.4, tau_P=2e-3)
    compare(study, [GainChange(0.0, FAST_GAINS)], "averaged")


@pytest.mark.parametrize(("samples_per_carrier", "period"), [(1, "100 us"), (4, "25 us")])
def test_samples_per_carrier(samples_per_carrier: int, period: str) -> None:
    sections = f"[converter]\nsamples_per_carrier = {samples_per_carrier}\ndelay_samples = 1\n"
    sections += '[inner_loops]\ncurrent_response_time = "2 ms"\n'
    event = '[[events]]\ntime = "5.0333 ms"\nphase_jump = "-8 deg"\n'
    reference = compare(lc_study("30 ms", event, sections, log=period), [GainChange(0.0, GAINS)], "pwm")
    assert np.max(np.abs(reference.plant[:, 0])) < 100.0


def test_no_delay_and_filtered_powers() -> None:
    event = '[[events]]\ntime = "5.0111 ms"\ngrid = { scr = 9, x_over_r = 0.5 }\n'
    event += '[power_loops]\ntau_P = "3 ms"\ntau_Q = "5 ms"\n'
    compare(lcl_study("40 ms", event, delay_samples="0"), [GainChange(0.0, GAINS)], "pwm")


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_cold_start(bridge: str) -> None:
    study = lcl_study("30 ms", simulation='start = "cold"')
    reference = compare(study, [GainChange(0.0, GAINS)], bridge, at_rest(study))
    assert np.max(np.abs(reference.plant[-200:, 1])) > 100.0  # the capacitor was charged


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_both_limits_active(bridge: str) -> None:
    sections = '[converter]\ncurrent_limit_pu = 1.2\nV_dc = "380 V"\n[grid]\nscr = 8\n'
    reference = compare(lc_study("30 ms", SAG, sections), [GainChange(0.0, GAINS)], bridge)
    assert reference.current_limited > 50
    assert reference.voltage_limited > 0


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_transient_resistance(bridge: str) -> None:
    """Against a sag, a phase jump and a harder grid, with the current limit in reach."""
    sections = "[converter]\ncurrent_limit_pu = 1.2\n[grid]\nscr = 8\nx_over_r = 5\n"
    sections += '[inner_loops]\ntransient_resistance_pu = 0.15\ntransient_corner = "20 Hz"\n'
    jump = '[[events]]\ntime = "8.0123 ms"\nphase_jump = "20 deg"\n[[events]]\ntime = "20 ms"\ngrid = { scr = 4 }\n'
    reference = compare(lc_study("30 ms", jump + SAG, sections), [GainChange(0.0, GAINS)], bridge)
    assert reference.current_limited > 0
    # The resistance has something to do: what it is used to lags the current by a good part of rated.
    frame = np.exp(-1j * reference.theta)
    assert np.max(np.abs(reference.plant[:, 2] * frame - reference.i_f)) > 10.0


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_transient_reactance_and_prediction(bridge: str) -> None:
    """Against a sag, a phase jump and a harder grid, one sample late, with the current limit in reach."""
    study = lcl_study("30 ms", '[[events]]\ntime = "8.0123 ms"\nphase_jump = "20 deg"\n' + SAG)
    gains = study.inner_gains._replace(
        X_t=0.1 * study.converter.Z_base, R_t=0.1 * study.converter.Z_base, kappa=1.2, K_ff=-0.1
    )
    converter = replace(study.converter, current_limit_pu=0.6)
    reference = compare(replace(study, inner_gains=gains, converter=converter), [GainChange(0.0, GAINS)], bridge)
    assert reference.current_limited > 0


@pytest.mark.parametrize(
    ("case", "P_ref", "log"),
    [
        ("lab_12kva_lcl", "6 kW", '"50 us"'),
        ("utility_1mva_60hz", "500 kW", repr(1.0 / 6000.0)),
    ],
)
def test_cases_that_come_with_the_package(case: str, P_ref: str, log: str) -> None:
    text = f"""
base = "case:{case}"
[simulation]
duration = "50 ms"
P_ref = "{P_ref}"
Q_ref = 0
log_interval = {log}
[[controllers]]
name = "fixed"
kind = "fixed"
[[events]]
time = "7.077 ms"
phase_jump = "10 deg"
[[events]]
time = "20 ms"
grid = {{ scr = 1.5 }}
"""
    study = study_from_text(text)
    changes = gain_changes(study, study.controllers[0], build_timeline(study))
    compare(study, changes, "pwm")


def test_a_millionth_of_the_grid_shows() -> None:
    """The comparison can fail: a grid resistance wrong by 1 ppm stands out a hundredfold after 10 ms."""
    study = lc_study("10 ms", '[[events]]\ntime = "1.01 ms"\nphase_jump = "10 deg"\n')
    gains = [GainChange(0.0, GAINS)]
    wrong = replace(study, grid=Grid(study.grid.R_g * (1.0 + 1e-6), study.grid.L_g))
    run = simulate(study, gains, bridge="pwm", log_states=10**9)
    errors = errors_pu(study, run, run_reference(wrong, gains, True, library_start(study, gains)))
    assert errors["i_g"] > 100.0 * TOLERANCE


@pytest.mark.parametrize("seed", range(12))
def test_random_converters(seed: int) -> None:
    """Whatever the combination of sampling, delay, modulation, filter and events; 12 seeded draws of each."""
    rng = np.random.default_rng(seed)

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    samples_per_carrier, f_sw = int(rng.integers(1, 6)), float(rng.choice([8e3, 10e3, 13e3, 20e3]))
    T_s = 1.0 / (f_sw * samples_per_carrier)
    times = sorted(draw(0.5e-3, 9e-3) for _ in range(4))
    times[1] = round(times[1] / T_s) * T_s  # one on a sample, the others anywhere
    times[2] = times[1] + 0.3 * T_s  # two within one sampling period of each other
    times[3] = times[1] + 0.8 * T_s
    events = f"""
[[events]]
time = {times[0]}
V_g_pu = {draw(0.8, 1.1)}
over = {draw(0.0, 5e-3)}
[[events]]
time = {times[1]}
grid = {{ scr = {draw(2.0, 15.0)}, x_over_r = {draw(0.2, 8.0)} }}
[[events]]
time = {times[2]}
phase_jump = {draw(-0.3, 0.3)}
[[events]]
time = {times[3]}
grid = {{ scr = {draw(2.0, 15.0)} }}
f_g = {draw(49.5, 50.5)}
"""
    study = lcl_study(
        "10 ms",
        events,
        log=repr(T_s),
        f_sw=repr(f_sw),
        samples_per_carrier=str(samples_per_carrier),
        current_feedforward=repr(draw(0.0, 1.0)),
        delay_samples=str(rng.integers(0, 2)),
        modulation=str(rng.choice(['"min_max"', '"sine_triangle"'])),
        V_dc=repr(draw(420.0, 800.0)),
        R_c=repr(draw(0.0, 6.0)),
        L_2=repr(draw(1e-4, 2e-3)),
        transient_resistance_pu=repr(draw(0.0, 0.2)),
    )
    compare(study, [GainChange(0.0, GAINS), GainChange(5.003e-3, FAST_GAINS)], "pwm")
