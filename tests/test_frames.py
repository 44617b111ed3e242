"""Frames and amplitudes against their definitions, in three phases and in complex numbers."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsgdesign.equations import frames

COMPONENT = st.floats(-1e6, 1e6)
ANGLE = st.floats(-10.0, 10.0)
THIRD = 2.0 * math.pi / 3.0


@given(COMPONENT, COMPONENT)
def test_clarke_round_trip(alpha: float, beta: float) -> None:
    phases = frames.clarke_inverse(alpha, beta)
    # A few roundings of the larger component.
    size = 1e-15 * (abs(alpha) + abs(beta)) + 1e-300
    assert sum(phases) == pytest.approx(0.0, abs=4.0 * size)
    back = frames.clarke(*phases)
    assert back == pytest.approx((alpha, beta), abs=4.0 * size)


@given(COMPONENT, COMPONENT, COMPONENT, COMPONENT)
def test_clarke_ignores_what_is_common_to_all_phases(a: float, b: float, c: float, common: float) -> None:
    size = 1e-15 * (abs(a) + abs(b) + abs(c) + abs(common)) + 1e-300
    shifted = frames.clarke(a + common, b + common, c + common)
    assert shifted == pytest.approx(frames.clarke(a, b, c), abs=8.0 * size)


@pytest.mark.parametrize("angle", np.linspace(-3.0, 3.0, 7))
def test_the_space_vector_has_the_length_of_the_phase_peak(angle: float) -> None:
    """A balanced cosine set of peak 155 V is the vector 155·e^{jφ}: amplitude-invariant, positive sequence."""
    phases = [155.0 * math.cos(angle - k * THIRD) for k in range(3)]
    alpha, beta = frames.clarke(*phases)
    assert complex(alpha, beta) == pytest.approx(155.0 * cmath.exp(1j * angle), rel=1e-14)
    assert frames.clarke_inverse(alpha, beta) == pytest.approx(phases, abs=1e-12)


@given(COMPONENT, COMPONENT, ANGLE)
def test_rotations_are_multiplications_by_a_phasor(x: float, y: float, angle: float) -> None:
    cosine, sine = math.cos(angle), math.sin(angle)
    size = 1e-15 * (abs(x) + abs(y)) + 1e-300
    forward = complex(*frames.rotate(x, y, cosine, sine))
    assert forward == pytest.approx(complex(x, y) * cmath.exp(1j * angle), abs=8.0 * size)
    back = frames.rotate_back(forward.real, forward.imag, cosine, sine)
    assert back == pytest.approx((x, y), abs=8.0 * size)


@given(st.floats(0.1, 1e3), st.floats(0.1, 1e3), ANGLE, ANGLE)
def test_power_is_the_sum_over_the_phases(V: float, I_pk: float, angle: float, lag: float) -> None:
    """P = Σ v·i at every instant; Q from v·i of the quadrature set; both equal 3 V I* of the rms phasors."""
    v = [V * math.cos(angle - k * THIRD) for k in range(3)]
    i = [I_pk * math.cos(angle - lag - k * THIRD) for k in range(3)]
    P, Q = frames.instantaneous_power(*frames.clarke(*v), *frames.clarke(*i))
    quadrature = [(v[k - 2] - v[k - 1]) / math.sqrt(3.0) for k in range(3)]
    S = 3.0 * (V / math.sqrt(2.0)) * (I_pk / math.sqrt(2.0)) * cmath.exp(1j * lag)
    size = 1e-14 * V * I_pk
    assert pytest.approx(sum(a * b for a, b in zip(v, i, strict=True)), abs=size) == P
    assert abs(Q) == pytest.approx(abs(sum(a * b for a, b in zip(quadrature, i, strict=True))), abs=size)
    assert complex(P, Q) == pytest.approx(S, abs=size)


def test_power_is_the_same_in_every_frame() -> None:
    v, i, turn = 155.0 + 20.0j, 10.0 - 7.0j, cmath.exp(0.8j)
    still = frames.instantaneous_power(v.real, v.imag, i.real, i.imag)
    v, i = v / turn, i / turn
    assert frames.instantaneous_power(v.real, v.imag, i.real, i.imag) == pytest.approx(still, rel=1e-15)


def test_ratings_and_amplitudes() -> None:
    assert frames.rms_to_peak(110.0) == pytest.approx(155.56349186104046, rel=1e-15)
    assert frames.peak_to_rms(frames.rms_to_peak(110.0)) == pytest.approx(110.0, rel=1e-15)
    assert frames.phase_to_ll(230.0) == pytest.approx(398.3716857408418, rel=1e-15)
    assert frames.ll_to_phase(frames.phase_to_ll(110.0)) == pytest.approx(110.0, rel=1e-15)
    assert frames.rated_current_rms(5000.0, 110.0) == pytest.approx(15.151515151515152, rel=1e-15)
    assert frames.base_impedance(5000.0, 110.0) == pytest.approx(7.26, rel=1e-15)
    assert math.sqrt(2.0) == frames.SQRT_2
    assert math.sqrt(3.0) == frames.SQRT_3


@pytest.mark.parametrize("zero_sequence", [False, True])
def test_the_modulation_limit_is_the_largest_circle(zero_sequence: bool) -> None:
    """At the limit some phase (or pair of phases) just uses up the dc link, and never more, at any angle."""
    limit = frames.linear_modulation_limit(700.0, zero_sequence)
    used = []
    for angle in np.linspace(0.0, 2.0 * math.pi, 3601):
        phases = frames.clarke_inverse(limit * math.cos(angle), limit * math.sin(angle))
        # Plain: each phase against the mid-point. Injected: only the line voltages must fit.
        used.append(max(phases) - min(phases) if zero_sequence else 2.0 * max(map(abs, phases)))
    assert max(used) == pytest.approx(700.0, rel=1e-6)
