"""The background's course of time: repeatable whatever the cuts, and with the statistics that were asked for."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from tests.simulation.studies import GAINS, lc_study
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.online import FixedGains
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.simulation.wander import BLOCK, FORGOTTEN_S, Wander
from vsgdesign.study.parameters.background import BackgroundSpec, draw_background

OMEGA_N = 100.0 * math.pi
EVERYTHING = {
    "voltage_steps_per_minute": (200.0, 200.0),
    "phase_jumps_per_minute": (200.0, 200.0),
    "phasor_walk": (3e-4, 3e-4),
    "modulation": (0.01, 0.01),
}


def spec_of(seed: int = 1, level: str = "clean", **given: float | tuple[float, float]) -> BackgroundSpec:
    ranges = {name: value if isinstance(value, tuple) else (value, value) for name, value in given.items()}
    return draw_background(ranges, seed, level)


def course(spec: BackgroundSpec, duration: float, T_s: float = 1e-3, omega_n: float = OMEGA_N) -> tuple[Any, Any]:
    return Wander(spec, T_s, omega_n).factors(0, round(duration / T_s))


def test_the_course_does_not_depend_on_cuts_nor_on_where_one_begins() -> None:
    spec = draw_background(EVERYTHING, 4, "measured")
    gain, angle = Wander(spec, 50e-6, OMEGA_N).factors(0, 3 * BLOCK + 100)
    other, rng = Wander(spec, 50e-6, OMEGA_N), np.random.default_rng(0)
    cuts = np.unique([0, BLOCK - 1, BLOCK, BLOCK + 1, *rng.integers(1, 3 * BLOCK, 40), 3 * BLOCK + 100])
    parts = [other.factors(int(a), int(b - a)) for a, b in itertools.pairwise(cuts)]
    for k, whole in enumerate((gain, angle)):
        assert np.concatenate([part[k] for part in parts]).tobytes() == whole.tobytes()
    # One that is asked for its end first, and then for its beginning again.
    late = Wander(spec, 50e-6, OMEGA_N)
    assert late.factors(3 * BLOCK, 100)[1].tobytes() == angle[3 * BLOCK :].tobytes()
    assert late.angle_at(np.array([5, BLOCK + 7, 3 * BLOCK])).tobytes() == angle[[5, BLOCK + 7, 3 * BLOCK]].tobytes()
    assert np.ptp(angle) > 1e-3
    assert not np.array_equal(angle, Wander(spec.redrawn(5), 50e-6, OMEGA_N).factors(0, len(angle))[1])


def test_few_blocks_are_kept() -> None:
    wander = Wander(spec_of(frequency_wander=0.01, frequency_deviation=0.02), 1e-3, OMEGA_N)
    wander.factors(0, 40 * BLOCK)
    assert len(wander._blocks) <= 3


def test_measured_is_what_was_measured() -> None:
    """One-cycle phasors of half an hour against 14 hours of public mains records: tenth and ninetieth percentile over
    the records of the rms second difference of the phase (mrad) and of the change of the magnitude (%), by their lag.

    What the recorder adds shows at one cycle, so that only the upper limit holds there. Large steps are rare and count
    in no percentile of the magnitude; here they are off.
    """
    table = {  # cycles: phase low, high; magnitude low, high
        1: (0.0, 0.73, 0.0, 0.048),
        10: (0.94, 1.38, 0.051, 0.104),
        20: (2.2, 2.8, 0.059, 0.119),
        50: (9.7, 12.0, 0.064, 0.126),
        100: (30.0, 41.0, 0.074, 0.142),
    }
    spec = draw_background({"voltage_steps_per_minute": (0.0, 0.0)}, 11, "measured")
    gain, angle = course(spec, 1800.0)
    phasors = (gain * np.exp(1j * angle)).reshape(-1, 20).mean(axis=1)
    phase, magnitude = np.unwrap(np.angle(phasors)), np.abs(phasors)
    for lag, (low, high, least, most) in table.items():
        second = phase[2 * lag :] - 2.0 * phase[lag:-lag] + phase[: -2 * lag]
        assert low <= 1e3 * np.sqrt(np.mean(second**2)) <= high, lag
        assert least <= 100.0 * np.sqrt(np.mean((magnitude[lag:] - magnitude[:-lag]) ** 2)) <= most, lag


@pytest.mark.parametrize("f_n", [50.0, 60.0])
def test_walk_and_noise_have_their_size_in_a_cycle(f_n: float) -> None:
    omega_n, per_cycle = 2.0 * math.pi * f_n, 20
    T_s = 1.0 / (f_n * per_cycle)
    cycles = 20_000  # a variance of so many independent numbers is right to 1 %; four times that is allowed
    _, angle = course(spec_of(phasor_walk=3e-4), cycles / f_n, T_s, omega_n)
    steps = np.diff(angle[::per_cycle])
    assert np.var(steps) == pytest.approx(0.5 * 3e-4**2, rel=0.04)
    assert abs(np.corrcoef(steps[1:], steps[:-1])[0, 1]) < 0.03
    gain, angle = course(spec_of(phase_noise=1e-3, voltage_noise=2e-3), cycles / f_n, T_s, omega_n)
    for values, rms in ((angle, 1e-3), (np.log(gain), 2e-3)):
        means = values.reshape(-1, per_cycle).mean(axis=1)
        assert np.sqrt(np.mean(means**2)) == pytest.approx(rms, rel=0.03)


def test_frequency_and_voltage_wander() -> None:
    """A free walk at first, its rms value in the long run, and nothing at the start; over 400 draws."""
    pairs = {"frequency_wander": 0.01, "frequency_deviation": 0.005, "voltage_wander": 0.02, "voltage_deviation": 0.01}
    given = {name: (value, value) for name, value in pairs.items()}
    duration, T_s = 4.0, 10e-3  # time constants of both: 0.5 s
    runs = [course(draw_background(given, seed), duration, T_s) for seed in range(400)]
    f = np.diff([angle for _, angle in runs], axis=1) / (2.0 * math.pi * T_s)
    ln_g = np.log([gain for gain, _ in runs])
    early, late = 5, -1  # a variance of 400 draws is right to 7 %; three times that is allowed
    for values, wander, deviation in ((f, 0.01, 0.005), (ln_g, 0.02, 0.01)):
        assert np.all(values[:, 0] == 0.0)
        expected = deviation**2 * (1.0 - math.exp(-early * T_s * (wander / deviation) ** 2))
        assert np.var(values[:, early]) == pytest.approx(expected, rel=0.21)
        assert np.var(values[:, late]) == pytest.approx(deviation**2, rel=0.21)


def test_steps_and_jumps() -> None:
    """As many as asked, of the sizes that are asked, in both directions; steps of the magnitude are taken back."""
    spec = spec_of(
        3,
        voltage_steps_per_minute=30.0,
        voltage_step=(0.003, 0.01),
        phase_jumps_per_minute=20.0,
        phase_jump=(0.02, 0.05),
    )
    minutes = 40.0
    gain, angle = course(spec, 60.0 * minutes, 5e-3)
    jumps = np.diff(angle)
    jumps = jumps[jumps != 0.0]
    assert len(jumps) == pytest.approx(20.0 * minutes, abs=4.0 * math.sqrt(20.0 * minutes))
    assert np.all((np.abs(jumps) >= 0.02) & (np.abs(jumps) <= 0.05))
    assert 0.4 < np.mean(jumps > 0.0) < 0.6
    ln_g = np.log(gain)
    steps = ln_g[1:] - ln_g[:-1] * math.exp(-5e-3 / FORGOTTEN_S)
    steps = steps[np.abs(steps) > 1e-9]
    assert len(steps) == pytest.approx(30.0 * minutes, abs=4.0 * math.sqrt(30.0 * minutes))
    assert np.all((np.abs(steps) > 0.0029) & (np.abs(steps) < 0.0101 * 2.0))
    assert np.max(np.abs(ln_g)) < 0.2


def test_modulation() -> None:
    gain, angle = course(spec_of(modulation=0.02, modulation_frequency=(8.8, 8.8)), 10.0)
    spectrum = np.abs(np.fft.rfft(gain)) / len(gain) * 2.0
    assert int(np.argmax(spectrum[1:])) + 1 == 88
    assert spectrum[88] == pytest.approx(0.02, rel=1e-9)
    assert np.all(angle == 0.0)


def test_a_run_repeats_to_the_bit_and_does_not_depend_on_its_cuts() -> None:
    """A run with a scheduler is cut every 20 ms. What is left is rounding of the phase that a stretch begins with."""
    sections = '[background]\nlevel = "dirty"\nphase_noise = "0.2 mrad"\n[sensors]\nlevel = "dirty"\nbits = 0\n'
    study = lc_study("0.2 s", sections)
    gains = [GainChange(0.0, GAINS)]
    first, second = (simulate(study, gains, bridge="pwm") for _ in range(2))
    assert first.log.tobytes() == second.log.tobytes()
    cut = simulate(study, FixedGains(GAINS), bridge="pwm")
    c = study.converter
    scale = np.array([*[c.I_rated_pk] * 2, *[c.V_rated_rms] * 2, *[c.I_rated_pk] * 2])
    assert np.max(np.abs(cut.log[:, :6] - first.log[:, :6]) / scale) < 1e-10
    longer = simulate(lc_study("0.3 s", sections), gains, bridge="pwm")
    assert np.max(np.abs(longer.log[: len(first.log), :6] - first.log[:, :6]) / scale) < 1e-10


def test_the_logged_source_and_its_phase_agree() -> None:
    """The phase that judges use is that of the voltage in the log, jumps and an event's ramp among it."""
    event = '[[events]]\ntime = "50 ms"\nf_g = "50.3 Hz"\nover = "20 ms"\n'
    event += '[[events]]\ntime = "90.01 ms"\nphase_jump = "9 deg"\n'
    sections = '[background]\nphase = [-3, 3]\nfrequency_offset = "0.1 Hz"\nvoltage_factor = 0.95\nphasor_walk = 0.01\n'
    sections += "phase_jumps_per_minute = 600\nseed = 3\n"
    run = simulate(lc_study("0.15 s", event, sections), [GainChange(0.0, GAINS)])
    v_g = run.column("v_g_alpha") + 1j * run.column("v_g_beta")
    turned = np.angle(v_g * np.exp(-1j * run.timeline.source_phase(run.t_s)))
    assert np.max(np.abs(turned)) < 1e-10
    assert run.timeline.source_at(0.0).V_g_rms == pytest.approx(0.95 * 110.0)
    assert run.timeline.source_at(0.0).omega == pytest.approx(2.0 * math.pi * 50.1)
    assert run.timeline.source_at(0.1).omega == pytest.approx(2.0 * math.pi * 50.4)
    assert np.ptp(np.abs(v_g)) > 1.0  # it wanders


def test_without_the_sections_nothing_changes() -> None:
    plain, clean = lc_study("20 ms"), lc_study("20 ms", "[background]\n[sensors]\n")
    runs = [simulate(study, [GainChange(0.0, GAINS)], bridge="pwm") for study in (plain, clean)]
    assert runs[0].log.tobytes() == runs[1].log.tobytes()
    assert not clean.has_components
    assert build_timeline(clean).source_at(0.0) == build_timeline(plain).source_at(0.0)
