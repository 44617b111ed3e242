"""Reference frames and amplitude conventions. The factors √2, √3, 3 and 3/2 live here and nowhere else.

Space vectors are amplitude-invariant: the length of (alpha, beta), and of (d, q), is the *peak* of the
phase quantity. ``_rms`` is phase-to-neutral rms, ``_ll_rms`` is line-to-line rms. All functions are plain
scalar expressions: floats, NumPy arrays and CasADi symbols go through them, and they are compiled and printed as C.
"""

from __future__ import annotations

from typing import Any

PHASES = 3.0
"""Three-phase power over one phase's."""

SPACE_VECTOR_POWER = 1.5
"""Three-phase power over v·i of amplitude-invariant space vectors (:eq:`instantaneous-power`)."""

SQRT_2 = 1.4142135623730951
SQRT_3 = 1.7320508075688772


def rms_to_peak(x_rms: Any) -> Any:
    """Phase rms to phase peak."""
    return x_rms * SQRT_2


def peak_to_rms(x_pk: Any) -> Any:
    """Phase peak to phase rms."""
    return x_pk / SQRT_2


def ll_to_phase(v_ll_rms: Any) -> Any:
    """Line-to-line rms to phase-to-neutral rms."""
    return v_ll_rms / SQRT_3


def phase_to_ll(v_rms: Any) -> Any:
    """Phase-to-neutral rms to line-to-line rms."""
    return v_rms * SQRT_3


def rated_current_rms(S_rated: Any, V_rated_rms: Any) -> Any:
    """Rated phase current in A rms of a three-phase rating in VA."""
    return S_rated / (PHASES * V_rated_rms)


def base_impedance(S_rated: Any, V_rated_rms: Any) -> Any:
    """Base impedance in Ω: V_ll²/S = 3V²/S."""
    return PHASES * V_rated_rms * V_rated_rms / S_rated


def delta_to_star(Z: Any) -> Any:
    """Impedance of each of three in star that are as three of Z in delta."""
    return Z / PHASES


def delta_to_star_capacitance(C: Any) -> Any:
    """Capacitance of each of three in star that are as three of C in delta."""
    return C * PHASES


def clarke(a: Any, b: Any, c: Any) -> Any:
    """Phases to the amplitude-invariant space vector. Returns (alpha, beta)."""
    return (2.0 * a - b - c) / 3.0, (b - c) / SQRT_3


def clarke_inverse(alpha: Any, beta: Any) -> Any:
    """(alpha, beta) to phases without zero sequence. Returns (a, b, c)."""
    half = -0.5 * alpha
    quadrature = 0.5 * SQRT_3 * beta
    return alpha, half + quadrature, half - quadrature


def rotate(x: Any, y: Any, cosine: Any, sine: Any) -> Any:
    """The vector (x, y) turned forward by an angle given by its cosine and sine (dq to αβ).

    Returns (turned_x, turned_y).
    """
    return x * cosine - y * sine, x * sine + y * cosine


def rotate_back(x: Any, y: Any, cosine: Any, sine: Any) -> Any:
    """The vector (x, y) turned backward by an angle given by its cosine and sine (αβ to dq).

    Returns (turned_x, turned_y).
    """
    return x * cosine + y * sine, y * cosine - x * sine


def instantaneous_power(v_alpha: Any, v_beta: Any, i_alpha: Any, i_beta: Any) -> Any:
    """Three-phase power of peak space vectors in αβ or dq (:eq:`instantaneous-power`). Returns (P, Q) in W and var."""
    return (
        SPACE_VECTOR_POWER * (v_alpha * i_alpha + v_beta * i_beta),
        SPACE_VECTOR_POWER * (v_beta * i_alpha - v_alpha * i_beta),
    )


def linear_modulation_limit(dc_voltage: Any, zero_sequence: bool) -> Any:
    """Largest phase peak in V that a two-level bridge makes without overmodulation.

    V_dc/2 with plain sine-triangle modulation, V_dc/√3 with min-max zero-sequence injection.
    """
    return dc_voltage / SQRT_3 if zero_sequence else dc_voltage / 2.0
