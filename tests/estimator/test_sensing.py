"""What sensors make of waveforms: background harmonics against EMT, noise, quantisation, channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.studies import FAST_GAINS, lc_study, lcl_study
from vsgdesign.estimator.recipes import PUBLISHED, WindowRecipe
from vsgdesign.estimator.windows import background_vectors, harmonic_phasors, measured_channels
from vsgdesign.simulation import FixedGains, Recorder, run_state, simulate
from vsgdesign.simulation.timeline import SourceSegment, Timeline, build_timeline

AMPLITUDES = {-5: 1.2 * np.exp(0.4j), 7: 0.8 * np.exp(-2.0j)}
"""V peak; 0.5 to 0.8 % of the fundamental."""


def distorted(timeline: Timeline, T_s: float, samples: int) -> Timeline:
    """The same timeline with the harmonics in the source, as one ramp of amplitude and frequency per sample."""
    base = timeline.sources[0]
    t = T_s * np.arange(1, samples + 1)
    turn = base.phase + base.omega * t
    vector = np.sqrt(2.0) * base.V_g_rms * np.exp(1j * turn)
    slope = 1j * base.omega * vector
    for order, amplitude in AMPLITUDES.items():
        part = (amplitude if order > 0 else np.conj(amplitude)) * np.exp(1j * order * turn)
        vector = vector + part
        slope = slope + 1j * order * base.omega * part
    phase, V = np.unwrap(np.angle(vector)), np.abs(vector) / np.sqrt(2.0)
    omega = (slope / vector).imag
    segments = [
        SourceSegment(
            t[k],
            V[k],
            (V[k + 1] - V[k]) / T_s,
            omega[k],
            2.0 * (phase[k + 1] - phase[k] - omega[k] * T_s) / T_s**2,
            phase[k],
        )
        for k in range(samples - 1)
    ]
    return replace(timeline, sources=(base, *segments))


@pytest.mark.parametrize("kind", ["lc", "lcl"])
def test_background_harmonics_are_the_emts_own_response(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ramp per sample misses a harmonic of 350 Hz by (ωh)²/8 = 1e-3; the inner loops' transient dies in 50 ms.

    An answer of the wrong sequence, or of the circuit without control, is off by more than half.
    """
    study = (lc_study if kind == "lc" else lcl_study)("80 ms")
    clean, dirty = Recorder(FixedGains(FAST_GAINS)), Recorder(FixedGains(FAST_GAINS))
    simulate(study, clean)
    monkeypatch.setattr(run_state, "build_timeline", lambda s: distorted(build_timeline(s), 50e-6, 1601))
    simulate(study, dirty)
    references = (study.simulation.P_ref, study.simulation.Q_ref)
    phasors = harmonic_phasors(study, study.grid, FAST_GAINS, references, list(AMPLITUDES))
    window = clean.windows[-1]
    angles = window.source_phase + study.grid_source.omega_g * 200e-6 * np.arange(100, dtype=float)
    expected = background_vectors(phasors, AMPLITUDES, angles)
    for row, name in enumerate(("v_pcc", "i_pcc")):
        found = getattr(dirty.windows[-1], name) - getattr(window, name)
        # The power loops' answer to the step of the source stays at the fundamental; harmonics have their own lines.
        lines = np.fft.fft(found[:, 0] + 1j * found[:, 1])
        exact = np.fft.fft(expected[row, 0] + 1j * expected[row, 1])
        for order in AMPLITUDES:
            assert abs(lines[order] - exact[order]) < 0.01 * abs(exact[order]), (name, order)


def channels(recipe: WindowRecipe, vectors: np.ndarray, noise: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    theta = 2.0 * np.pi * np.arange(vectors.shape[-1]) / vectors.shape[-1] + np.zeros((len(vectors), 1))
    converter = lc_study("1 s").converter
    return measured_channels(converter, recipe, vectors, theta, noise, np.random.default_rng(3))


def phasor_windows(count: int = 1) -> np.ndarray:
    """Voltage 100 V at 30° and current 10 A at −20°, one cycle in 100 samples."""
    turn = np.exp(2j * np.pi * np.arange(100) / 100)
    vectors = [100.0 * np.exp(1j * np.pi / 6.0) * turn, 10.0 * np.exp(-1j * np.pi / 9.0) * turn]
    return np.repeat(np.array([[[v.real, v.imag] for v in vectors]]), count, axis=0)


def test_the_layout_is_voltage_then_current() -> None:
    vectors = phasor_windows()
    a = channels(PUBLISHED, vectors)
    assert a.shape == (1, 200)
    np.testing.assert_allclose(a[0, :100], vectors[0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(a[0, 100:], vectors[0, 1, 0], atol=1e-12)
    both = channels(replace(PUBLISHED, channels="alpha_beta"), vectors)
    np.testing.assert_allclose(both.reshape(2, 2, 100), vectors[0], atol=1e-12)


def test_in_the_converters_frame_a_steady_window_stands_still() -> None:
    x = channels(replace(PUBLISHED, channels="dq"), phasor_windows()).reshape(2, 2, 100)
    for row, value in enumerate((100.0 * np.exp(1j * np.pi / 6.0), 10.0 * np.exp(-1j * np.pi / 9.0))):
        np.testing.assert_allclose(x[row, 0], value.real, atol=1e-11)
        np.testing.assert_allclose(x[row, 1], value.imag, atol=1e-11)


@pytest.mark.parametrize("name", ["phase_a", "alpha_beta"])
def test_noise_is_relative_to_the_rated_peak(name: str) -> None:
    """40,000 samples: the standard deviation is known to 0.4 %. Clarke keeps α's from three phases: √(2/3)."""
    recipe, vectors = replace(PUBLISHED, channels=name), phasor_windows(400)
    error = (channels(recipe, vectors, (0.01, 0.02)) - channels(recipe, vectors)).reshape(400, 2, -1, 100)
    share = 1.0 if name == "phase_a" else np.sqrt(2.0 / 3.0)
    V_pk, I_pk = 110.0 * np.sqrt(2.0), 5000.0 / 330.0 * np.sqrt(2.0)
    assert error[:, 0, 0].std() == pytest.approx(0.01 * V_pk * share, rel=0.02)
    assert error[:, 1, 0].std() == pytest.approx(0.02 * I_pk * share, rel=0.02)
    assert abs(np.corrcoef(error[:, 0, 0].ravel(), error[:, 1, 0].ravel())[0, 1]) < 0.02


@pytest.mark.parametrize("bits", [8, 12])
def test_quantisation_rounds_to_its_step_and_clips(bits: int) -> None:
    recipe = replace(PUBLISHED, adc_bits=bits, adc_range_pu=0.5)
    x, exact = channels(recipe, phasor_windows())[0], channels(PUBLISHED, phasor_windows())[0]
    full = np.repeat([0.5 * 110.0 * np.sqrt(2.0), 0.5 * 5000.0 / 330.0 * np.sqrt(2.0)], 100)
    step = 2.0 * full / 2.0**bits
    np.testing.assert_allclose(x / step, np.round(x / step), atol=1e-9)
    inside = np.abs(exact) < full - step
    assert np.max(np.abs(x - exact)[inside] / step[inside]) <= 0.5 + 1e-9
    assert len(np.unique(x[:100])) > 20
    assert x[:100].max() == pytest.approx((full - step)[0])  # 100 V is beyond ±78 V
    assert x[:100].min() == pytest.approx(-full[0])
