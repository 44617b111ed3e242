"""Gains in closed form: inner loops from response times, power loops from the Jacobian's A and D."""

from __future__ import annotations

from typing import Any

import numpy as np

from vsgdesign.equations.placing import Poles

LEAST_BANDWIDTH = Poles(15.8, 6.6, 4.0)
"""Poles at which a search begins. ω_n = 3.97 rad/s and ξ = 0.83 settle in 1 s with 1 % overshoot and the least
bandwidth; they are derived beside :eq:`critical-settling`. k_2 is that of the paper."""


def paced(k_1: Any, d_1: Any, k_2: Any, pace: Any) -> Any:
    """Makes the poles ``pace`` times as fast. Returns (k_1, d_1, k_2)."""
    return k_1 * pace * pace, d_1 * pace, k_2 * pace


def inner_loop_bandwidth(response_time: Any) -> Any:
    """Bandwidth ω_x = 2π/T in rad/s of an inner loop with response time T in s (:eq:`inner-gains`)."""
    return 2.0 * np.pi / response_time


def current_loop_gains(response_time: Any, damping_ratio: Any, L_1: Any) -> Any:
    """Returns (K_pc, K_ic), the gains of the current loop in V/A and V/(A·s) (:eq:`inner-gains`)."""
    omega_c = inner_loop_bandwidth(response_time)
    return 2.0 * damping_ratio * omega_c * L_1, omega_c * omega_c * L_1


def voltage_loop_gains(response_time: Any, damping_ratio: Any, C: Any) -> Any:
    """Returns (K_pv, K_iv), the gains of the voltage loop in A/V and A/(V·s) (:eq:`inner-gains`)."""
    omega_v = inner_loop_bandwidth(response_time)
    return 2.0 * damping_ratio * omega_v * C, omega_v * omega_v * C


def closed_form_poles(settling_time: Any, damping_ratio: Any) -> tuple[Any, Any, Any]:
    """Returns (k_1, d_1, k_2) of the published loops in 1/s², 1/s and 1/s (:eq:`closed-form-gains`).

    ω_n = 4/(ξ T_s); k_1 = ω_n², d_1 = 2ξω_n, k_2 = 4/T_s. With the published structure and q = 0.01, ξ = 1 and
    T_s = 1 s give the paper's K_ip = 16/A, D_p = A/2, D_q = D/100 and K_iq = 4/(D + D_q). T_s is the paper's
    4/(ξω_n) rule, which a critically damped loop does not meet: it settles (2 %) in 5.83/ω_n.
    """
    omega_n = 4.0 / (damping_ratio * settling_time)
    return omega_n * omega_n, 2.0 * damping_ratio * omega_n, 4.0 / settling_time


def overshoot_of(damping_ratio: Any) -> Any:
    """Overshoot in percent of a second-order loop without a zero: 0 for ξ ≥ 1, and 100 without damping."""
    xi = np.minimum(np.maximum(damping_ratio, 0.0), 1.0)
    # This needs no branch: from ξ = 1 on, the lower limit of the root makes an exponent that underflows to zero.
    return 100.0 * np.exp(-np.pi * xi / np.sqrt(np.maximum(1.0 - xi * xi, 1e-30)))
