"""How an integrator of the controller moves from one sample to the next."""

from __future__ import annotations

from typing import Any

TURN = 6.283185307179586
"""Once round, rad."""


def advanced(x: Any, dx: Any) -> Any:
    """The integrator x after its change dx of one sample: x + dx.

    This is the one place where an integrator of the controller moves (θ, ω_i, V and the integrators of both inner
    loops), so that a target with single precision can replace it by a compensated sum: there T_s times the rate is
    smaller than the last digit of x, and a plain sum would lose it for ever. A low-pass needs no such care, since it
    forgets what it lost.
    """
    return x + dx


def within_a_turn(theta: Any) -> Any:
    """An angle in rad that has just passed ±2π, back by a turn, so that it keeps its digits for ever."""
    return theta - TURN * (theta > TURN) + TURN * (theta < -TURN)
