"""The responses of the uncoupled loops, for comparison with those of coupling and other grids."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vsgdesign.equations.closed_form import overshoot_of
from vsgdesign.metrics import step_response
from vsgdesign.metrics.step_response import SETTLING_BAND


@dataclass(frozen=True)
class UncoupledResponse:
    """A step of reference in a loop without coupling. ``damping_ratio`` is None for a first-order loop."""

    omega_n: float
    """Natural angular frequency (first order: the pole), rad/s."""
    damping_ratio: float | None
    settling_time_s: float
    overshoot_pct: float


def uncoupled_P(K_ip: float, D_p: float, A: float) -> UncoupledResponse:
    """The P loop s² + K_ip·D_p s + K_ip·A."""
    omega_n = math.sqrt(K_ip * A)
    damping_ratio = 0.5 * K_ip * D_p / omega_n
    return UncoupledResponse(
        omega_n, damping_ratio, settling_factor(damping_ratio) / omega_n, overshoot_of(damping_ratio)
    )


def uncoupled_Q(K_iq: float, D_q: float, D: float) -> UncoupledResponse:
    """The Q loop s + K_iq·(D + D_q)."""
    rate = K_iq * (D + D_q)
    return UncoupledResponse(rate, None, math.log(1.0 / SETTLING_BAND) / rate, 0.0)


def settling_factor(damping_ratio: float) -> float:
    """ω_n times the 2 % settling time of a second-order loop without zero; infinite without damping."""
    if damping_ratio <= 0.0:
        return math.inf
    x = np.linspace(0.0, 12.0 * max(1.0 / damping_ratio, 2.0 * damping_ratio), 40_001)
    settled = step_response(x, _unit_step(x, damping_ratio), 0.0, 1.0).settling_time_s
    return math.inf if settled is None else settled


def _unit_step(x: np.ndarray, damping_ratio: float) -> np.ndarray:
    root = np.sqrt(complex(damping_ratio * damping_ratio - 1.0))
    if abs(root) < 1e-4:
        return 1.0 - np.exp(-x) * (1.0 + x)
    fast, slow = -damping_ratio - root, -damping_ratio + root
    return (1.0 - (slow * np.exp(fast * x) - fast * np.exp(slow * x)) / (slow - fast)).real
