"""Gains in closed form: inner loops from response times, and where the poles of the power loops are placed, so that a
step keeps its settling time as it is judged."""

from __future__ import annotations

import cmath
import functools
import math
from typing import Any, NamedTuple

import numpy as np

SETTLING_BAND = 0.02
"""Half the width of the band of the settling time, over the step or the rating."""

DAMPING_RATIO = 0.92
"""ζ of the placed polynomial of δ. With an estimate that is wrong by 10 %, steps still overshoot by 0.2 % at most."""

OVERSHOOT_PCT = 0.2
"""Overshoot of a step that a closed form promises, in per cent of the step. Its poles are placed for less."""

_KNOWN_WELL = 0.05
_LEAST_MARGIN, _MOVING_GAINS, _OF_ERROR = 0.03, 0.02, 0.35


class Poles(NamedTuple):
    """Poles of the power loops: s² + d_1 s + k_1 for δ and s + k_2 for V.

    k_1 is in 1/s², d_1 and k_2 are in 1/s.
    """

    k_1: float
    d_1: float
    k_2: float


def unit_response_left(x: float, damping_ratio: float) -> float:
    """1 minus the unit step response of 1/(s² + 2ζs + 1) at the time x."""
    root = cmath.sqrt(damping_ratio * damping_ratio - 1.0)
    if abs(root) < 1e-4:
        return math.exp(-x) * (1.0 + x)
    fast, slow = -damping_ratio - root, -damping_ratio + root
    return ((slow * cmath.exp(fast * x) - fast * cmath.exp(slow * x)) / (slow - fast)).real


@functools.lru_cache(maxsize=64)
def settling_factor(damping_ratio: float) -> float:
    """ω_n times the 2 % settling time of a second-order loop without a zero; infinite without damping.

    What is left of the step has its extremes at kπ/√(1 − ζ²), where it is e^(−ζkπ/√(1 − ζ²)). After the last extreme
    outside the band it falls steadily, and the crossing is found by bisection.
    """
    if damping_ratio <= 0.0:
        return math.inf
    low, high, sign = 0.0, 3.0 * math.log(1.0 / SETTLING_BAND) * max(damping_ratio, 1.0), 1.0
    if damping_ratio < 1.0:
        half = math.pi / math.sqrt(1.0 - damping_ratio * damping_ratio)
        last = math.floor(math.log(1.0 / SETTLING_BAND) / (damping_ratio * half))
        low, sign = last * half, -1.0 if last % 2 else 1.0
        high = low + min(half, high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        if sign * unit_response_left(middle, damping_ratio) > SETTLING_BAND:
            low = middle
        else:
            high = middle
    return high


def damping_of(overshoot_pct: float) -> float:
    """The damping ratio ζ with which a second-order loop without a zero overshoots by so many per cent."""
    decay = math.log(100.0 / overshoot_pct)
    return decay / math.hypot(math.pi, decay)


def placed_poles(T_d: float, damping_ratio: float = DAMPING_RATIO) -> Poles:
    """The poles with which δ and V both reach 98 % after T_d (s) (:eq:`placed-poles`)."""
    omega_n = settling_factor(damping_ratio) / T_d
    return Poles(omega_n * omega_n, 2.0 * damping_ratio * omega_n, math.log(1.0 / SETTLING_BAND) / T_d)


def settling_margin(error: float) -> float:
    """Share m of the time that a closed form leaves for gains that move during the step, and for an estimate of the
    grid that is wrong by up to ``error`` (:eq:`placed-poles`)."""
    return _LEAST_MARGIN if error <= _KNOWN_WELL else _MOVING_GAINS + _OF_ERROR * error


def placing_time(T: float, T_mean: float, margin: float) -> float:
    """T_d in s for which poles are placed, so that the mean over T_mean (s) settles within T (s) (:eq:`placed-poles`).

    The delay of the mean takes at most half of T.
    """
    return max(T - 0.5 * T_mean, 0.5 * T) * (1.0 - margin)


PLACED = placed_poles(1.0)
"""The poles for T_d = 1 s."""


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
