"""How an integrator and a low-pass filter of the controller move from one sample to the next."""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.equations.notation import Integrated

TURN = 6.283185307179586
"""One full turn, rad."""


def advanced(x: Any, dx: Any) -> Integrated:
    """The integrator x after its change dx in one sample: x + dx.

    Every integrator of the controller (θ, ω_i, V and those of both inner loops) is advanced by this function alone. A
    target with single precision can therefore replace it by a compensated sum: there dx may be smaller than the last
    digit of x, and a plain sum would lose it permanently. A low-pass filter does not need this, because the effect of
    a lost digit decays.
    """
    return x + dx


def low_pass_share(tau: float, T_s: float) -> float:
    """1 − exp(−T_s/τ): the share of its way that a low-pass filter goes in one sample. ``tau``: time constant, s; zero
    means no filter, with a share of 1. ``T_s``: sampling period, s."""
    return 1.0 if tau == 0.0 else -math.expm1(-T_s / tau)


def within_a_turn(theta: Any) -> Any:
    """Moves an angle in rad that has just passed ±2π back by one turn, so that it never loses digits."""
    return theta - TURN * (theta > TURN) + TURN * (theta < -TURN)
