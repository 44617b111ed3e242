"""Power-loop structures: the gains of each from the Jacobian A, B, C, D, and all else in which they differ."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.closed_form import closed_form_poles
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import UnknownNameError


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


class ClosedFormAim(NamedTuple):
    """What closed forms are made of: those of a structure take what they need. T_s in s, k_1 in 1/s², d_1 and k_2 in
    1/s; ``droop_ratio`` is q in D_q = q·D."""

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

    J + diag(0, D_q), since the Q loop acts on Q + D_q V, with B scaled by share_P and C by share_Q: 0 leaves
    the coupling in (the published diagonal), 1 takes it out. share_P = 0 keeps the swing row pure.
    """
    b, c, d = share_P * B, share_Q * C, D + D_q
    determinant = A * d - b * c
    # 0 − b, not −b: without a share the entry is 0, not −0.
    return d / determinant, (0.0 - b) / determinant, (0.0 - c) / determinant, A / determinant


def voltage_row(A: Any, B: Any, C: Any, D: Any, k_2: Any, D_p: Any, D_q: Any, share_P: Any, share_Q: Any) -> Any:
    """The V row of the angle-damped structure (:eq:`voltage-row`): K_qp = k_2 v1 and K_iq = k_2 v2.

    The droop is part of e_P, so a moving δ pushes V by K_qp D_p δ̇. With A − k_2 D_p in place of A this row answers
    δ by K_qp D_p (s + k_2), which V's own pole cancels. Returns (sigma, v1, v2). sigma (W/rad) is k_2 D_p, less where
    that comes near to 1/w11: the row's determinant keeps at least 0.47 of its size, so no droop makes the gains grow
    without bound.
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

    A ramp of frequency then asks for the power of H whatever the shares (:eq:`effective-inertia`). Returns
    (k_1, d_1) in 1/s² and 1/s.
    """
    k_1 = A * omega_0 / (2.0 * H * S_rated)
    return k_1, 2.0 * zeta * np.sqrt(k_1)


def effective_inertia(gains: PowerLoopGains, S_rated: Any, omega_0: Any) -> Any:
    """H in s that a ramp of frequency meets, of gains of any structure (:eq:`effective-inertia`)."""
    return omega_0 / (2.0 * S_rated * (gains.K_ip - gains.K_pq * gains.K_qp / gains.K_iq))


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
    """The decoupled structure (:eq:`decoupled-gains`): W on the errors, damping through the P–f droop.

    Without coupling left, δ moves by s² + d_1 s + k_1 and V by s + k_2. Without shares, with D_q = 0 and q > 0 it is
    the published structure. D_p is not used: the damping makes it. S_rated (VA) and omega_0 (rad/s) are used by law
    ``inertia`` alone.
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
    """The angle-damped structure (:eq:`angle-damped-gains`): both droops free, damping through the angle.

    What the droop D_p damps already, k_1 w11 D_p, is taken off d_1, so δ moves by s² + d_1 s + k_1 on every
    grid and V by s + k_2. The droop's push on V is taken out of the V row (:eq:`voltage-row`), so that a step of
    a reference is answered by these two and nothing else; under law ``inertia`` that push is left in. S_rated (VA) and
    omega_0 (rad/s) are used by law ``inertia`` alone.
    """
    k_1, d_1, k_2, D_p_V = normalised.k_1_or_H, normalised.d_1_or_zeta, normalised.k_2, D_p
    if by_inertia:
        k_1, d_1 = poles_of_inertia(A, k_1, d_1, S_rated, omega_0)
        # A V row without the droop's part would change the inertia, which this law promises.
        D_p_V = 0.0
    droop = D_q + normalised.q * D
    w11, w12, _, _ = decoupling(A, B, C, D, droop, normalised.share_P, normalised.share_Q)
    _, v1, v2 = voltage_row(A, B, C, D, k_2, D_p_V, droop, normalised.share_P, normalised.share_Q)
    k_d = d_1 - k_1 * w11 * D_p
    return PowerLoopGains(k_1 * w11, D_p, k_2 * v2, droop, k_1 * w12, k_2 * v1, k_d * w11, k_d * w12)


def published_closed_form(aim: ClosedFormAim) -> NormalisedGains:
    """Normalised gains of the published structure: a settling time, a damping ratio and q (:eq:`closed-form-gains`)."""
    k_1, d_1, k_2 = closed_form_poles(aim.settling_time, aim.damping_ratio)
    return NormalisedGains(k_1, d_1, k_2, aim.droop_ratio, 0.0, 0.0)


def placed_closed_form(aim: ClosedFormAim) -> NormalisedGains:
    """Normalised gains of a structure that takes the coupling out: the poles and shares as they are asked for."""
    return NormalisedGains(aim.k_1, aim.d_1, aim.k_2, 0.0, aim.share_P, aim.share_Q)


StructureGains = Callable[
    [Any, Any, Any, Any, NormalisedGains, Any, Any, Any, Any, bool],
    PowerLoopGains,
]
"""A, B, C, D, normalised gains, D_p, D_q, S_rated, omega_0, by_inertia to gains (:eq:`structure-gains`)."""


class FreeParameter(NamedTuple):
    """A field of :class:`NormalisedGains` that an optimizer may choose between two limits, by its logarithm or not."""

    name: str
    low: float
    high: float
    logarithmic: bool


_SHARES = FreeParameter("share_P", 0.0, 1.0, False), FreeParameter("share_Q", 0.0, 1.0, False)


@dataclass(frozen=True)
class Structure:
    """A power-loop structure: everything in which one differs from another.

    ``gains`` is a plain function of scalars like every equation (CONTRIBUTING.md): it runs with floats, is traced by
    CasADi and by the certificate, compiled by Numba and printed as C.
    """

    name: str
    """As study files and tables name it."""
    gains: StructureGains
    closed_form: Callable[[ClosedFormAim], NormalisedGains]
    """Normalised gains of closed forms, law ``poles``."""
    free: tuple[FreeParameter, ...]
    """What an optimizer may choose besides the poles, which every structure has."""
    tuned: tuple[str, ...]
    """Fields of PowerLoopGains that a single fixed tuning may choose; the other gains are zero, the droops given."""
    start_share: float
    """Share of the coupling that searches begin with taken out."""
    P_droop: bool
    """Whether the P–f droop D_p is the study's to choose; otherwise the gains make it."""
    Q_droop: bool
    """Whether the Q–V droop D_q is the study's to choose; otherwise it is q·D."""
    uncoupled: bool = False
    """Whether it is designed as the paper's two loops, without the coupling: their margins and responses are then
    what it promises, in place of those of each loop with the other closed."""
    follows_references: bool = True
    """Where closed forms take the Jacobian unless told: at the measured P, Q and V, or at the design point."""

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
        """Its name in a report."""
        return self.name.replace("_", "-")

    def droops(self, D_p: float, D_q: float) -> tuple[float, float]:
        """D_p (W·s/rad) and D_q (var/V), each 0 where it is not the study's to choose."""
        return (D_p if self.P_droop else 0.0), (D_q if self.Q_droop else 0.0)

    def rated_droops(
        self, P_droop: float, Q_droop: float, S_rated: float, omega_0: float, V_n: float
    ) -> tuple[float, float]:
        """:meth:`droops` that answer a deviation of P_droop (Q_droop), per unit, by rated power; 0: no droop."""
        D_p = S_rated / (P_droop * omega_0) if P_droop > 0.0 else 0.0
        D_q = S_rated / (Q_droop * V_n) if Q_droop > 0.0 else 0.0
        return self.droops(D_p, D_q)


class Structures(Mapping[str, Structure]):
    """Structures by name. Reading an unknown name raises UnknownNameError; only :meth:`register` adds one."""

    def __init__(self, structures: Iterable[Structure]) -> None:
        self._by_name = {structure.name: structure for structure in structures}
        self._first = tuple(self._by_name.values())

    def __getitem__(self, name: str) -> Structure:
        if name not in self._by_name:
            raise UnknownNameError("structure", name, self._by_name)
        return self._by_name[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    @property
    def added(self) -> tuple[Structure, ...]:
        """Those that were registered later: what another process has to be told."""
        return tuple(structure for structure in self.values() if structure not in self._first)

    def register(self, structure: Structure) -> Callable[[], None]:
        """Makes a structure known to studies, tables, designs and exports; returns what takes it out again.

        Raises ValueError where another structure has its name.
        """
        if self._by_name.get(structure.name, structure) != structure:
            raise ValueError(f"structure: {structure.name!r} is the name of another one. Choose a name of its own.")
        self._by_name[structure.name] = structure

        def forget() -> None:
            self._by_name.pop(structure.name, None)

        return forget


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
"""The paper's: a diagonal of integrators, with both droops made by the gains."""

DECOUPLED = Structure(
    name="decoupled",
    gains=decoupled_gains,
    closed_form=placed_closed_form,
    free=_SHARES,
    tuned=("K_ip", "D_p", "K_iq", "K_pq", "K_qp"),
    start_share=1.0,
    P_droop=False,
    Q_droop=True,
)
"""Coupling taken out; the P–f droop does the damping."""

ANGLE_DAMPED = Structure(
    name="angle_damped",
    gains=angle_damped_gains,
    closed_form=placed_closed_form,
    free=_SHARES,
    tuned=("K_ip", "K_iq", "K_pq", "K_qp", "k_P", "k_Q"),
    start_share=1.0,
    P_droop=True,
    Q_droop=True,
)
"""Coupling taken out, both droops free; the measured powers damp through the angle."""

STRUCTURES = Structures((PUBLISHED, DECOUPLED, ANGLE_DAMPED))
"""Power-loop structures that a study or a table may name."""
