"""Gains in closed form: inner loops from response times, power loops from the Jacobian's A and D."""

from __future__ import annotations

from typing import Any

import numpy as np


def inner_loop_bandwidth(response_time: Any) -> Any:
    """ω_x = 2π/T of an inner loop's response time (:eq:`inner-gains`)."""
    return 2.0 * np.pi / response_time


def current_loop_gains(response_time: Any, damping_ratio: Any, L_1: Any) -> Any:
    """K_pc (V/A) and K_ic (V/(A·s)) of the current loop (:eq:`inner-gains`)."""
    omega_c = inner_loop_bandwidth(response_time)
    return 2.0 * damping_ratio * omega_c * L_1, omega_c * omega_c * L_1


def voltage_loop_gains(response_time: Any, damping_ratio: Any, C: Any) -> Any:
    """K_pv (A/V) and K_iv (A/(V·s)) of the voltage loop (:eq:`inner-gains`)."""
    omega_v = inner_loop_bandwidth(response_time)
    return 2.0 * damping_ratio * omega_v * C, omega_v * omega_v * C


def closed_form_poles(settling_time: Any, damping_ratio: Any) -> Any:
    """k_1 (1/s²), d_1 and k_2 (1/s) of the published loops (:eq:`closed-form-gains`).

    ω_n = 4/(ξ T_s); k_1 = ω_n², d_1 = 2ξω_n, k_2 = 4/T_s. With the published structure and q = 0.01, ξ = 1 and
    T_s = 1 s give the paper's K_ip = 16/A, D_p = A/2, D_q = D/100 and K_iq = 4/(D + D_q). T_s is the paper's
    4/(ξω_n) rule, which a critically damped loop does not meet: it settles (2 %) in 5.83/ω_n.
    """
    omega_n = 4.0 / (damping_ratio * settling_time)
    return omega_n * omega_n, 2.0 * damping_ratio * omega_n, 4.0 / settling_time


def overshoot_of(damping_ratio: Any) -> Any:
    """Overshoot in percent of a second-order loop without zero: 0 from ξ = 1 on, 100 where nothing damps."""
    xi = np.minimum(np.maximum(damping_ratio, 0.0), 1.0)
    # Without a branch: at ξ = 1 the root's least value makes an exponent that underflows to zero.
    return 100.0 * np.exp(-np.pi * xi / np.sqrt(np.maximum(1.0 - xi * xi, 1e-30)))
