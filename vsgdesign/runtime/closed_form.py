"""Scheduled gains in closed form: grid impedance in, four gains out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.equations.closed_form import power_loop_gains
from vsgdesign.equations.power_flow import jacobian_from_powers, largest_scale, operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import NoOperatingPointError

if TYPE_CHECKING:  # reading study files is no part of what ships
    from vsgdesign.parameters.study import ClosedFormTarget, Study


@dataclass(frozen=True)
class ClosedFormSchedule:
    """The paper's gain schedule for any target, operating point and filter (:eq:`closed-form-gains`).

    A and D are taken at the fixed operating point (P, Q), as published, from the estimated R_g and L_g plus
    the known grid-side inductor.
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

    def gains(self, R_g: float, L_g: float) -> PowerLoopGains:
        """Gains for a grid of R_g (Ω) and L_g (H).

        Raises NoOperatingPointError where this grid cannot carry (P, Q), or where A or D is not positive there
        so that no positive gain closes the loop.
        """
        A, D = self.plant_gains(R_g, L_g)
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
        return PowerLoopGains(*(float(value) for value in self._from_plant(A, D)))

    def gains_over(self, R_g: Any, L_g: Any) -> PowerLoopGains:
        """Gains for arrays of grids; NaN where :meth:`gains` would raise."""
        A, D = self.plant_gains(R_g, L_g)
        A, D = np.where((A > 0.0) & (D > 0.0), A, np.nan), np.where((A > 0.0) & (D > 0.0), D, np.nan)
        return PowerLoopGains(*self._from_plant(A, D))

    def plant_gains(self, R_g: Any, L_g: Any) -> tuple[Any, Any]:
        """A (W/rad) and D (var/V) at (P, Q) on a grid; NaN where it has no operating point."""
        R, X = self._path(R_g, L_g)
        with np.errstate(invalid="ignore"):
            V_rms, _ = operating_point(self.P, self.Q, self.V_g_rms, R, X)
        A, _, _, D = jacobian_from_powers(self.P, self.Q, V_rms, R, X)
        return A, D

    def _path(self, R_g: Any, L_g: Any) -> tuple[Any, Any]:
        return R_g + self.R_2, self.omega * (L_g + self.L_2)

    def _from_plant(self, A: Any, D: Any) -> Any:
        return power_loop_gains(A, D, self.settling_time, self.damping_ratio, self.droop_ratio)


def closed_form_schedule(study: Study, target: ClosedFormTarget) -> ClosedFormSchedule:
    """The closed-form schedule of a study's converter for a target."""
    return ClosedFormSchedule(
        P=target.P,
        Q=target.Q,
        V_g_rms=study.grid_source.V_g_rms,
        omega=study.converter.omega_n,
        settling_time=target.settling_time,
        damping_ratio=target.damping_ratio,
        droop_ratio=target.droop_ratio,
        R_2=study.filter.R_2,
        L_2=study.filter.L_2,
    )
