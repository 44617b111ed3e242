"""Gains of each power-loop structure from the Jacobian A, B, C, D at an operating point, in closed form."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.power_loops import PowerLoopGains

STRUCTURES = ("published", "decoupled", "angle_damped")
"""Power-loop structures that a study or a table may name."""


class NormalisedGains(NamedTuple):
    """What a schedule says of a grid; the Jacobian makes gains of it (:eq:`structure-gains`).

    Law ``poles``: k_1 (1/s²) and d_1 (1/s), δ by s² + d_1 s + k_1. Law ``inertia``: H (s) and ζ instead.
    k_2 (1/s): V by s + k_2. q: droop D_q as a share of D, the published structure's. share_P, share_Q: how much
    of the coupling is taken out.
    """

    k_1_or_H: Any
    d_1_or_zeta: Any
    k_2: Any
    q: Any
    share_P: Any
    share_Q: Any


def decoupling(A: Any, B: Any, C: Any, D: Any, D_q: Any, share_P: Any, share_Q: Any) -> Any:
    """w11, w12, w21, w22: inverse of the Jacobian that the loops see (:eq:`decoupling`).

    J + diag(0, D_q), since the Q loop acts on Q + D_q V, with B scaled by share_P and C by share_Q: 0 leaves
    the coupling in (the published diagonal), 1 takes it out. share_P = 0 keeps the swing row pure.
    """
    b, c, d = share_P * B, share_Q * C, D + D_q
    determinant = A * d - b * c
    # 0 − b, not −b: without a share the entry is 0, not −0.
    return d / determinant, (0.0 - b) / determinant, (0.0 - c) / determinant, A / determinant


def decoupled_gains(
    A: Any, B: Any, C: Any, D: Any, k_1: Any, d_1: Any, k_2: Any, D_q: Any, share_P: Any, share_Q: Any
) -> PowerLoopGains:
    """The decoupled structure (:eq:`decoupled-gains`): W on the errors, damping through the P–f droop.

    Without coupling left, δ moves by s² + d_1 s + k_1 and V by s + k_2. Without shares and with D_q = q·D it is
    the published structure.
    """
    w11, w12, w21, w22 = decoupling(A, B, C, D, D_q, share_P, share_Q)
    return PowerLoopGains(k_1 * w11, d_1 / (k_1 * w11), k_2 * w22, D_q, k_1 * w12, k_2 * w21, 0.0, 0.0)


def voltage_row(A: Any, B: Any, C: Any, D: Any, k_2: Any, D_p: Any, D_q: Any, share_P: Any, share_Q: Any) -> Any:
    """sigma, v1, v2: the V row of the angle-damped structure (:eq:`voltage-row`), K_qp = k_2 v1 and K_iq = k_2 v2.

    The droop is part of e_P, so a moving δ pushes V by K_qp D_p δ̇. With A − k_2 D_p in place of A this row answers
    δ by K_qp D_p (s + k_2), which V's own pole cancels. sigma (W/rad) is k_2 D_p, less where that comes near to
    1/w11: the row's determinant keeps at least 0.47 of its size, so no droop makes the gains grow without bound.
    """
    b, c, d = share_P * B, share_Q * C, D + D_q
    pull = k_2 * D_p
    x = pull * (d / (A * d - b * c))
    sigma = pull / (1.0 + x * x * x)
    a = A - sigma
    determinant = a * d - b * c
    return sigma, (0.0 - c) / determinant, a / determinant


def angle_damped_gains(
    A: Any,
    B: Any,
    C: Any,
    D: Any,
    k_1: Any,
    d_1: Any,
    k_2: Any,
    D_p: Any,
    D_q: Any,
    share_P: Any,
    share_Q: Any,
    D_p_V: Any,
) -> PowerLoopGains:
    """The angle-damped structure (:eq:`angle-damped-gains`): both droops free, damping through the angle.

    What the droop D_p damps already, k_1 w11 D_p, is taken off d_1, so δ moves by s² + d_1 s + k_1 on every
    grid and V by s + k_2. The droop's push on V is taken out of the V row (:eq:`voltage-row`), so that a step of
    a reference is answered by these two and nothing else. ``D_p_V``: the droop that is taken out there, D_p, or 0 to
    leave its push in.
    """
    w11, w12, _, _ = decoupling(A, B, C, D, D_q, share_P, share_Q)
    _, v1, v2 = voltage_row(A, B, C, D, k_2, D_p_V, D_q, share_P, share_Q)
    k_d = d_1 - k_1 * w11 * D_p
    return PowerLoopGains(k_1 * w11, D_p, k_2 * v2, D_q, k_1 * w12, k_2 * v1, k_d * w11, k_d * w12)


def poles_of_inertia(A: Any, H: Any, zeta: Any, S_rated: Any, omega_0: Any) -> Any:
    """k_1 = Aω_0/(2HS) and d_1 = 2ζ√k_1 for an inertia constant H and a damping ratio ζ (:eq:`constant-inertia`).

    A ramp of frequency then asks for the power of H whatever the shares (:eq:`effective-inertia`).
    """
    k_1 = A * omega_0 / (2.0 * H * S_rated)
    return k_1, 2.0 * zeta * np.sqrt(k_1)


def effective_inertia(gains: PowerLoopGains, S_rated: Any, omega_0: Any) -> Any:
    """H in s that a ramp of frequency meets, of gains of any structure (:eq:`effective-inertia`)."""
    return omega_0 / (2.0 * S_rated * (gains.K_ip - gains.K_pq * gains.K_qp / gains.K_iq))


def structure_gains(
    A: Any,
    B: Any,
    C: Any,
    D: Any,
    normalised: NormalisedGains,
    D_p: Any,
    D_q: Any,
    S_rated: Any,
    omega_0: Any,
    angle_damped: bool,
    by_inertia: bool,
) -> PowerLoopGains:
    """Gains of every structure under either law (:eq:`structure-gains`).

    The published structure is the decoupled one with shares 0, D_q = 0 and q > 0; the other structures have
    q = 0. D_p is used by the angle-damped structure alone. S_rated (VA) and omega_0 (rad/s) are used by law
    ``inertia`` alone.
    """
    k_1, d_1 = normalised.k_1_or_H, normalised.d_1_or_zeta
    if by_inertia:
        k_1, d_1 = poles_of_inertia(A, k_1, d_1, S_rated, omega_0)
    droop = D_q + normalised.q * D
    if angle_damped:
        # A V row without the droop's part would change the inertia, which law ``inertia`` promises.
        return angle_damped_gains(
            A,
            B,
            C,
            D,
            k_1,
            d_1,
            normalised.k_2,
            D_p,
            droop,
            normalised.share_P,
            normalised.share_Q,
            0.0 if by_inertia else D_p,
        )
    return decoupled_gains(A, B, C, D, k_1, d_1, normalised.k_2, droop, normalised.share_P, normalised.share_Q)
