"""Scheduled gains in closed form: the normalised parameters are the same on every grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from vsgdesign.equations.closed_form import closed_form_poles
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.runtime.schedule import Schedule

if TYPE_CHECKING:  # reading study files is no part of what ships
    from vsgdesign.parameters.study import ClosedFormTarget, Study


@dataclass(frozen=True, kw_only=True)
class ClosedFormSchedule(Schedule):
    """A gain schedule for any structure, target, operating point and filter.

    ``published`` uses ``settling_time``, ``damping_ratio`` and ``droop_ratio`` (:eq:`closed-form-gains`); the
    other structures the pole placement k_1, d_1, k_2, the droops and the shares of decoupling
    (:eq:`decoupled-gains`, :eq:`angle-damped-gains`); law ``inertia`` H (s) and zeta.
    """

    settling_time: float
    damping_ratio: float
    droop_ratio: float
    k_1: float = 21.3
    d_1: float = 8.24
    k_2: float = 3.91
    share_P: float = 1.0
    share_Q: float = 1.0
    H: float = 5.0
    zeta: float = 0.7

    def normalised(self, R_g: Any, L_g: Any) -> NormalisedGains:  # noqa: ARG002 - the same on every grid
        """Constant, whatever the grid."""
        k_1, d_1, k_2, q, share_P, share_Q = self.k_1, self.d_1, self.k_2, 0.0, self.share_P, self.share_Q
        if self.structure == "published":
            k_1, d_1, k_2 = closed_form_poles(self.settling_time, self.damping_ratio)
            q, share_P, share_Q = self.droop_ratio, 0.0, 0.0
        if self.law == "inertia":
            k_1, d_1 = self.H, self.zeta
        return NormalisedGains(k_1, d_1, k_2, q, share_P, share_Q)


def closed_form_schedule(
    study: Study, target: ClosedFormTarget, P: float | None = None, Q: float | None = None
) -> ClosedFormSchedule:
    """The schedule of a study's converter for a target; P and Q replace the target's operating point."""
    return ClosedFormSchedule(
        P=target.P if P is None else P,
        Q=target.Q if Q is None else Q,
        V_g_rms=study.grid_source.V_g_rms,
        omega=study.converter.omega_n,
        settling_time=target.settling_time,
        damping_ratio=target.damping_ratio,
        droop_ratio=target.droop_ratio,
        R_2=study.filter.R_2,
        L_2=study.filter.L_2,
        structure=target.structure,
        k_1=target.k_1,
        d_1=target.d_1,
        k_2=target.k_2,
        D_p=study.converter.S_rated / (target.P_droop * study.converter.omega_n) if target.P_droop > 0.0 else 0.0,
        D_q=study.converter.S_rated / (target.Q_droop * study.converter.V_rated_rms) if target.Q_droop > 0.0 else 0.0,
        share_P=target.share_P,
        share_Q=target.share_Q,
        S_rated=study.converter.S_rated,
    )
