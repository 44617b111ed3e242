"""Scheduled gains in closed form: grid impedance in, the gains of any structure out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.equations.closed_form import power_loop_gains
from vsgdesign.equations.power_flow import jacobian_from_powers, largest_scale, operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import angle_damped_gains, decoupled_gains
from vsgdesign.errors import NoOperatingPointError

if TYPE_CHECKING:  # reading study files is no part of what ships
    from vsgdesign.parameters.study import ClosedFormTarget, Study


@dataclass(frozen=True)
class ClosedFormSchedule:
    """A gain schedule for any structure, target, operating point and filter.

    The Jacobian is taken at the operating point (P, Q), from the estimated R_g and L_g plus the known
    grid-side inductor. ``published`` uses ``damping_ratio`` and ``droop_ratio`` (:eq:`closed-form-gains`); the
    other structures the pole placement k_1, d_1, k_2, the droops and the shares of decoupling
    (:eq:`decoupled-gains`, :eq:`angle-damped-gains`).
    """

    P: float
    Q: float
    V_g_rms: float
    omega: float
    settling_time: float
    damping_ratio: float
    droop_ratio: float
    R_2: float = 0.0
    L_2: float = 0.0
    structure: str = "published"
    k_1: float = 15.8
    d_1: float = 6.6
    k_2: float = 4.0
    D_p: float = 0.0
    D_q: float = 0.0
    share_P: float = 1.0
    share_Q: float = 1.0

    def gains(self, R_g: float, L_g: float) -> PowerLoopGains:
        """Gains for a grid of R_g (Ω) and L_g (H).

        Raises NoOperatingPointError where this grid cannot carry (P, Q), or where A or D is not positive there
        so that no positive gain closes the loop.
        """
        A, B, C, D = self.plant_gains(R_g, L_g)
        if not (A > 0.0 and D > 0.0):
            what, advice = f"makes A = {A:.4g} W/rad, D = {D:.4g} var/V", "Design for another power"
            shortfall_w = float("nan")
            if np.isnan(A):
                share = float(largest_scale(self.P, self.Q, self.V_g_rms, *self._path(R_g, L_g)))
                what, advice = "has no operating point", f"Design for {100.0 * share:.3g} % of that power"
                shortfall_w = (1.0 - share) * abs(self.P)
            raise NoOperatingPointError(
                f"no closed-form gains: P = {self.P / 1e3:.4g} kW, Q = {self.Q / 1e3:.4g} kvar {what} at "
                f"R_g = {R_g:.4g} Ω, L_g = {L_g * 1e3:.4g} mH. {advice} (P_design, Q_design), or leave this grid out.",
                shortfall_w=shortfall_w,
            )
        return PowerLoopGains(*(float(value) for value in self._from_plant(A, B, C, D)))

    def gains_over(self, R_g: Any, L_g: Any) -> PowerLoopGains:
        """Gains for arrays of grids; NaN where :meth:`gains` would raise."""
        A, B, C, D = self.plant_gains(R_g, L_g)
        good = np.where((A > 0.0) & (D > 0.0), 1.0, np.nan)
        return PowerLoopGains(*(value * good for value in self._from_plant(A, B, C, D)))

    def gains_measured(self, R_g: Any, L_g: Any, P: Any, Q: Any, V_rms: Any) -> PowerLoopGains:
        """Gains from an estimated grid and the measured P, Q, V at the control point, for arrays or scalars.

        The Jacobian needs no operating point to be solved for (:eq:`jacobian-from-powers`), so an error of the
        estimate does not also move V.
        """
        return PowerLoopGains(*self._from_plant(*jacobian_from_powers(P, Q, V_rms, *self._path(R_g, L_g))))

    def plant_gains(self, R_g: Any, L_g: Any) -> tuple[Any, Any, Any, Any]:
        """A, B, C, D at (P, Q) on a grid; NaN where it has no operating point."""
        R, X = self._path(R_g, L_g)
        with np.errstate(invalid="ignore"):
            V_rms, _ = operating_point(self.P, self.Q, self.V_g_rms, R, X)
        return jacobian_from_powers(self.P, self.Q, V_rms, R, X)

    def _path(self, R_g: Any, L_g: Any) -> tuple[Any, Any]:
        return R_g + self.R_2, self.omega * (L_g + self.L_2)

    def _from_plant(self, A: Any, B: Any, C: Any, D: Any) -> PowerLoopGains:
        if self.structure == "published":
            return PowerLoopGains(*power_loop_gains(A, D, self.settling_time, self.damping_ratio, self.droop_ratio))
        poles = (self.k_1, self.d_1, self.k_2)
        if self.structure == "decoupled":
            return decoupled_gains(A, B, C, D, *poles, self.D_q, self.share_P, self.share_Q)
        return angle_damped_gains(A, B, C, D, *poles, self.D_p, self.D_q, self.share_P, self.share_Q)


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
    )
