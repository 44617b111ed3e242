"""Gains of each power-loop structure from the Jacobian A, B, C, D at an operating point, in closed form."""

from __future__ import annotations

from typing import Any

from vsgdesign.equations.power_loops import PowerLoopGains


def decoupling(A: Any, B: Any, C: Any, D: Any, D_q: Any, share_P: Any, share_Q: Any) -> Any:
    """w11, w12, w21, w22: inverse of the Jacobian that the loops see (:eq:`decoupling`).

    J + diag(0, D_q), since the Q loop acts on Q + D_q V, with B scaled by share_P and C by share_Q: 0 leaves
    the coupling in (the published diagonal), 1 takes it out. share_P = 0 keeps the swing row pure.
    """
    b, c, d = share_P * B, share_Q * C, D + D_q
    determinant = A * d - b * c
    return d / determinant, -b / determinant, -c / determinant, A / determinant


def decoupled_gains(
    A: Any, B: Any, C: Any, D: Any, k_1: Any, d_1: Any, k_2: Any, D_q: Any, share_P: Any, share_Q: Any
) -> PowerLoopGains:
    """The decoupled structure (:eq:`decoupled-gains`): W on the errors, damping through the P–f droop.

    Without coupling left, δ moves by s² + d_1 s + k_1 and V by s + k_2.
    """
    w11, w12, w21, w22 = decoupling(A, B, C, D, D_q, share_P, share_Q)
    return PowerLoopGains(k_1 * w11, d_1 / (k_1 * w11), k_2 * w22, D_q, k_1 * w12, k_2 * w21)


def angle_damped_gains(
    A: Any, B: Any, C: Any, D: Any, k_1: Any, d_1: Any, k_2: Any, D_p: Any, D_q: Any, share_P: Any, share_Q: Any
) -> PowerLoopGains:
    """The angle-damped structure (:eq:`angle-damped-gains`): both droops free, damping through the angle.

    What the droop D_p damps already, k_1 w11 D_p, is taken off d_1, so δ moves by s² + d_1 s + k_1 on every
    grid and V by s + k_2.
    """
    w11, w12, w21, w22 = decoupling(A, B, C, D, D_q, share_P, share_Q)
    k_d = d_1 - k_1 * w11 * D_p
    return PowerLoopGains(k_1 * w11, D_p, k_2 * w22, D_q, k_1 * w12, k_2 * w21, k_d * w11, k_d * w12)
