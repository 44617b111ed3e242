"""Power-loop structures: how each computes its gains from the Jacobian, and everything else in which they differ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.placing import OVERSHOOT_PCT, closed_form_poles
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.registry import Registry


class NormalisedGains(NamedTuple):
    """The parameters of a schedule for one grid. With the Jacobian they give the gains (:eq:`structure-gains`).

    With law ``poles``, k_1 (1/s²) and d_1 (1/s) give δ the characteristic polynomial s² + d_1 s + k_1. With law
    ``inertia``, these two fields hold H (s) and ζ instead. k_2 (1/s) gives V the polynomial s + k_2. q is the droop D_q
    as a share of D, for the published structure alone. share_P and share_Q are the cancelled shares of the coupling.
    """

    k_1_or_H: Any
    d_1_or_zeta: Any
    k_2: Any
    q: Any
    share_P: Any
    share_Q: Any


class ClosedFormAim(NamedTuple):
    """Data of the closed forms. The closed form of a structure uses those that it needs.

    The settling time is in s, k_1 in 1/s², d_1 and k_2 in 1/s. ``droop_ratio`` is q in D_q = q·D.
    """

    settling_time: Any
    damping_ratio: Any
    droop_ratio: Any
    k_1: Any
    d_1: Any
    k_2: Any
    share_P: Any
    share_Q: Any


def decoupling(A: Any, B: Any, C: Any, D: Any, D_q: Any, share_P: Any, share_Q: Any) -> Any:
    """Inverse of the Jacobian that the loops see (:eq:`decoupling`). Returns (w11, w12, w21, w22).

    The loops see J + diag(0, D_q), since the Q loop acts on Q + D_q V. B is scaled by share_P and C by share_Q. A share
    of 0 leaves the coupling as it is (the published diagonal), and a share of 1 cancels it. With share_P = 0 the
    frequency depends on P alone.
    """
    b, c, d = share_P * B, share_Q * C, D + D_q
    determinant = A * d - b * c
    # It is 0 − b and not −b, so that an entry with a share of 0 is 0 and not −0.
    return d / determinant, (0.0 - b) / determinant, (0.0 - c) / determinant, A / determinant


def voltage_row(A: Any, B: Any, C: Any, D: Any, k_2: Any, D_p: Any, D_q: Any, share_P: Any, share_Q: Any) -> Any:
    """The V row of the angle-damped structure (:eq:`voltage-row`): K_qp = k_2 v1 and K_iq = k_2 v2.

    The droop is part of e_P, so a changing δ drives V by K_qp D_p δ̇. With A − k_2 D_p in place of A, the response of V
    to δ is proportional to K_qp D_p (s + k_2), and the pole of V cancels this zero. Returns (sigma, v1, v2). sigma
    (W/rad) is k_2 D_p, or less where k_2 D_p comes close to 1/w11. The determinant of the row thus keeps at least 0.47
    of its size, and no droop makes the gains grow without bound.
    """
    b, c, d = share_P * B, share_Q * C, D + D_q
    pull = k_2 * D_p
    x = pull * (d / (A * d - b * c))
    sigma = pull / (1.0 + x * x * x)
    a = A - sigma
    determinant = a * d - b * c
    return sigma, (0.0 - c) / determinant, a / determinant


def poles_of_inertia(A: Any, H: Any, zeta: Any, S_rated: Any, omega_0: Any) -> Any:
    """k_1 = Aω_0/(2HS) and d_1 = 2ζ√k_1 for an inertia constant H and a damping ratio ζ (:eq:`constant-inertia`).

    A ramp of the frequency then draws the inertial power of H, whatever the shares are (:eq:`effective-inertia`).
    Returns (k_1, d_1) in 1/s² and 1/s.
    """
    k_1 = A * omega_0 / (2.0 * H * S_rated)
    return k_1, 2.0 * zeta * np.sqrt(k_1)


def effective_inertia(gains: PowerLoopGains, S_rated: Any, omega_0: Any) -> Any:
    """Effective inertia constant H in s during a ramp of the frequency, for any structure (:eq:`effective-inertia`)."""
    return omega_0 / (2.0 * S_rated * (gains.K_ip - gains.K_pq * gains.K_qp / gains.K_iq))


def steady_droops(gains: PowerLoopGains, S_rated: Any, omega_0: Any, V_n: Any) -> tuple[Any, Any]:
    """P–f and Q–V droop in per unit, as measured in the steady state, for any structure (:eq:`measured-droop`).

    At rest both errors of the loops are zero, so a deviation of the frequency by Δω changes P by −D_p Δω, and one of
    the voltage by ΔV changes Q by −D_q ΔV. The droop is the deviation that changes the power by S_rated (VA), over
    omega_0 (rad/s) or V_n (phase rms, V). A value of 0 means no droop, as in :meth:`Structure.rated_droops`. Returns
    (P_droop, Q_droop).
    """
    has_P, has_Q = gains.D_p > 0.0, gains.D_q > 0.0
    P_droop = np.where(has_P, S_rated / (np.where(has_P, gains.D_p, 1.0) * omega_0), 0.0)
    Q_droop = np.where(has_Q, S_rated / (np.where(has_Q, gains.D_q, 1.0) * V_n), 0.0)
    return P_droop, Q_droop


def decoupled_gains(
    A: Any,
    B: Any,
    C: Any,
    D: Any,
    normalised: NormalisedGains,
    D_p: Any,  # noqa: ARG001 - every structure's gains take the same arguments
    D_q: Any,
    S_rated: Any,
    omega_0: Any,
    by_inertia: bool,
) -> PowerLoopGains:
    """The decoupled structure (:eq:`decoupled-gains`): W acts on the errors, and the P–f droop damps.

    Where no coupling is left, δ has the polynomial s² + d_1 s + k_1 and V has s + k_2. With both shares 0, D_q = 0 and
    q > 0 it is the published structure. D_p is not used, because the damping determines it. Law ``inertia`` alone uses
    S_rated (VA) and omega_0 (rad/s).
    """
    k_1, d_1, k_2 = normalised.k_1_or_H, normalised.d_1_or_zeta, normalised.k_2
    if by_inertia:
        k_1, d_1 = poles_of_inertia(A, k_1, d_1, S_rated, omega_0)
    droop = D_q + normalised.q * D
    w11, w12, w21, w22 = decoupling(A, B, C, D, droop, normalised.share_P, normalised.share_Q)
    return PowerLoopGains(k_1 * w11, d_1 / (k_1 * w11), k_2 * w22, droop, k_1 * w12, k_2 * w21, 0.0, 0.0)


def angle_damped_gains(
    A: Any,
    B: Any,
    C: Any,
    D: Any,
    normalised: NormalisedGains,
    D_p: Any,
    D_q: Any,
    S_rated: Any,
    omega_0: Any,
    by_inertia: bool,
) -> PowerLoopGains:
    """The angle-damped structure (:eq:`angle-damped-gains`): both droops are free, and the angle path damps.

    The droop D_p already damps by k_1 w11 D_p. This is subtracted from d_1, so δ has the polynomial s² + d_1 s + k_1
    and V has s + k_2 on every grid. The V row cancels the effect of the droop on V (:eq:`voltage-row`), so the response
    to a step of a reference has these poles alone. Law ``inertia`` keeps that effect, and it alone uses S_rated (VA)
    and omega_0 (rad/s).
    """
    k_1, d_1, k_2, D_p_V = normalised.k_1_or_H, normalised.d_1_or_zeta, normalised.k_2, D_p
    if by_inertia:
        k_1, d_1 = poles_of_inertia(A, k_1, d_1, S_rated, omega_0)
        # To cancel the effect of the droop in the V row would change the inertia, which this law promises.
        D_p_V = 0.0
    droop = D_q + normalised.q * D
    w11, w12, _, _ = decoupling(A, B, C, D, droop, normalised.share_P, normalised.share_Q)
    _, v1, v2 = voltage_row(A, B, C, D, k_2, D_p_V, droop, normalised.share_P, normalised.share_Q)
    k_d = d_1 - k_1 * w11 * D_p
    return PowerLoopGains(k_1 * w11, D_p, k_2 * v2, droop, k_1 * w12, k_2 * v1, k_d * w11, k_d * w12)


def fast_voltage_gains(
    A: Any,
    B: Any,
    C: Any,
    D: Any,
    normalised: NormalisedGains,
    D_p: Any,  # noqa: ARG001 - every structure's gains take the same arguments
    D_q: Any,
    S_rated: Any,
    omega_0: Any,
    by_inertia: bool,
) -> PowerLoopGains:
    """The published law with a fast V loop (:eq:`fast-voltage-gains`): its four gains, for P as it is with Q held.

    While V follows δ at once, P sees A − BC/(D + D_q), which is 1/w11 of the decoupled structure. D_p is not used,
    because the damping determines it. Law ``inertia`` alone uses S_rated (VA) and omega_0 (rad/s).
    """
    k_1, d_1 = normalised.k_1_or_H, normalised.d_1_or_zeta
    droop = D_q + normalised.q * D
    w11, _, _, _ = decoupling(A, B, C, D, droop, 1.0, 1.0)
    if by_inertia:
        k_1, d_1 = poles_of_inertia(1.0 / w11, k_1, d_1, S_rated, omega_0)
    return PowerLoopGains(k_1 * w11, d_1 / (k_1 * w11), normalised.k_2 / (D + droop), droop, 0.0, 0.0, 0.0, 0.0)


def published_closed_form(aim: ClosedFormAim) -> NormalisedGains:
    """Normalised gains of the published structure from settling time, damping ratio and q (:eq:`closed-form-gains`)."""
    k_1, d_1, k_2 = closed_form_poles(aim.settling_time, aim.damping_ratio)
    return NormalisedGains(k_1, d_1, k_2, aim.droop_ratio, 0.0, 0.0)


def placed_closed_form(aim: ClosedFormAim) -> NormalisedGains:
    """Normalised gains of a structure that cancels the coupling. They are the poles and shares that are asked for."""
    return NormalisedGains(aim.k_1, aim.d_1, aim.k_2, 0.0, aim.share_P, aim.share_Q)


def fast_voltage_closed_form(aim: ClosedFormAim) -> NormalisedGains:
    """Normalised gains of the published law with a fast V loop: the poles and q that are asked for."""
    return NormalisedGains(aim.k_1, aim.d_1, aim.k_2, aim.droop_ratio, 0.0, 0.0)


StructureGains = Callable[
    [Any, Any, Any, Any, NormalisedGains, Any, Any, Any, Any, bool],
    PowerLoopGains,
]
"""Function of A, B, C, D, normalised gains, D_p, D_q, S_rated, omega_0 and by_inertia that returns the gains
(:eq:`structure-gains`)."""


class FreeParameter(NamedTuple):
    """A field of :class:`NormalisedGains` that an optimizer may choose between two limits, linearly or by logarithm."""

    name: str
    low: float
    high: float
    logarithmic: bool


_SHARES = FreeParameter("share_P", 0.0, 1.0, False), FreeParameter("share_Q", 0.0, 1.0, False)


@dataclass(frozen=True)
class Structure:
    """A power-loop structure, with everything in which one structure differs from another.

    ``gains`` is a plain function of scalars like every equation (CONTRIBUTING.md). It runs with floats, CasADi and the
    certificate trace it, the EMT compiles it, and it is printed as C.
    """

    name: str
    """The name of the structure in study files and tables."""
    gains: StructureGains
    closed_form: Callable[[ClosedFormAim], NormalisedGains]
    """Function that returns the normalised gains of the closed form with law ``poles``."""
    free: tuple[FreeParameter, ...]
    """The parameters that an optimizer may choose besides the poles, which every structure has."""
    tuned: tuple[str, ...]
    """Fields of PowerLoopGains that a single fixed tuning may choose. The droops are given; other gains are zero."""
    start_share: float
    """Share of the coupling that is cancelled at the start of a search."""
    P_droop: bool
    """Whether the study chooses the P–f droop D_p. Otherwise the gains determine it."""
    Q_droop: bool
    """Whether the study chooses the Q–V droop D_q. Otherwise it is q·D."""
    uncoupled: bool = False
    """Whether it is designed as the two separate loops of the paper, without the coupling. Its promises are then the
    margins and responses of these loops; otherwise they are those of each loop with the other one closed."""
    safe_in_the_middle: bool = False
    """Whether gains of a grid between the others are stable on all of them, so that a schedule may wait for an estimate
    at a place that is searched (:eq:`safe-place`). Otherwise it waits at the strongest grid."""
    fast_V: float | None = None
    """k_2 times the settling time where a study gives no k_2 and V is to be faster than δ. None: V is as fast as δ."""
    overshoot_pct: tuple[float, float] = (OVERSHOOT_PCT, OVERSHOOT_PCT)
    """Overshoot of a step of P_ref and of one of Q_ref that a closed form promises, in per cent of the step, where its
    own poles do not overshoot by more. A structure that is designed without the coupling promises that of its loops."""
    follows_references: bool = True
    """The default point for the Jacobian of the closed form: the measured P, Q and V, or the design point."""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ValueError(f"structure: name = {self.name!r}: must be letters, digits and underscores")
        for field, given, known in (
            ("free", [p.name for p in self.free], NormalisedGains._fields[3:]),
            ("tuned", self.tuned, PowerLoopGains._fields),
        ):
            if unknown := [name for name in given if name not in known]:
                raise ValueError(f"structure {self.name}: {field} = {unknown}: must be of {', '.join(known)}")

    @property
    def label(self) -> str:
        """The name of the structure in a report."""
        return self.name.replace("_", "-")

    def droops(self, D_p: float, D_q: float) -> tuple[float, float]:
        """D_p (W·s/rad) and D_q (var/V). Each is 0 where the study cannot choose it."""
        return (D_p if self.P_droop else 0.0), (D_q if self.Q_droop else 0.0)

    def rated_droops(
        self, P_droop: float, Q_droop: float, S_rated: float, omega_0: float, V_n: float
    ) -> tuple[float, float]:
        """:meth:`droops` with which a deviation of P_droop (Q_droop) in per unit changes the power by the rated power.

        A value of 0 means no droop.
        """
        D_p = S_rated / (P_droop * omega_0) if P_droop > 0.0 else 0.0
        D_q = S_rated / (Q_droop * V_n) if Q_droop > 0.0 else 0.0
        return self.droops(D_p, D_q)


class Structures(Registry[Structure]):
    """Structures by name, known to studies, tables, designs and exports."""

    what = "structure"


PUBLISHED = Structure(
    name="published",
    gains=decoupled_gains,
    closed_form=published_closed_form,
    free=(FreeParameter("q", 1e-4, 1.0, True),),
    tuned=("K_ip", "D_p", "K_iq", "D_q"),
    start_share=0.0,
    P_droop=False,
    Q_droop=False,
    uncoupled=True,
    follows_references=False,
)
"""The structure of the paper: a diagonal of integrators. The gains determine both droops."""

DECOUPLED = Structure(
    name="decoupled",
    gains=decoupled_gains,
    closed_form=placed_closed_form,
    free=_SHARES,
    tuned=("K_ip", "D_p", "K_iq", "K_pq", "K_qp"),
    start_share=1.0,
    P_droop=False,
    Q_droop=True,
    safe_in_the_middle=True,
)
"""The coupling is cancelled, and the P–f droop does the damping."""

ANGLE_DAMPED = Structure(
    name="angle_damped",
    gains=angle_damped_gains,
    closed_form=placed_closed_form,
    free=_SHARES,
    tuned=("K_ip", "K_iq", "K_pq", "K_qp", "k_P", "k_Q"),
    start_share=1.0,
    P_droop=True,
    Q_droop=True,
    safe_in_the_middle=True,
)
"""The coupling is cancelled, both droops are free, and the measured powers damp through the angle."""

FAST_VOLTAGE = Structure(
    name="fast_voltage",
    gains=fast_voltage_gains,
    closed_form=fast_voltage_closed_form,
    free=PUBLISHED.free,
    tuned=PUBLISHED.tuned,
    start_share=0.0,
    P_droop=False,
    Q_droop=False,
    fast_V=20.0,
    overshoot_pct=(2.0, 50.0),
)
"""The published law and its four gains, designed for P with a V loop that is five times as fast."""

STRUCTURES = Structures((PUBLISHED, DECOUPLED, ANGLE_DAMPED, FAST_VOLTAGE))
"""Power-loop structures that a study or a table may name."""
