"""The common part of all gain schedules: the gains follow from normalised parameters and the Jacobian of the grid."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from vsgdesign.equations.power_flow import (
    jacobian_from_powers,
    largest_scale,
    operating_point,
    scheduled_jacobian,
)
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import PUBLISHED, STRUCTURES, NormalisedGains, StructureGains
from vsgdesign.errors import NoOperatingPointError
from vsgdesign.runtime.floats import on_floats

_scheduled_jacobian = on_floats(scheduled_jacobian)


@lru_cache(maxsize=64)
def _law_of(structure: str, D_p: float, D_q: float) -> tuple[StructureGains, tuple[float, float]]:
    """The gains of a structure as a function of floats, and its droops."""
    one = STRUCTURES[structure]
    return on_floats(one.gains), one.droops(D_p, D_q)


@dataclass(frozen=True, eq=False, kw_only=True)
class Schedule(ABC):
    """A gain schedule of any structure and law. A subclass adds :meth:`normalised` and the data that it needs.

    The Jacobian is taken from the estimated R_g and L_g plus the known grid-side inductor, at the design point
    (P, Q) or at measured powers and voltage.
    """

    P: float
    """Design point, W."""
    Q: float
    """Design point, var."""
    V_g_rms: float
    omega: float
    R_2: float = 0.0
    L_2: float = 0.0
    structure: str = PUBLISHED.name
    """A name of STRUCTURES."""
    law: str = "poles"
    """``inertia``: H (s) and zeta instead of the first two poles (:eq:`constant-inertia`)."""
    S_rated: float = 1.0
    """Rated power in VA. Law ``inertia`` alone uses it."""
    D_p: float = 0.0
    D_q: float = 0.0

    @abstractmethod
    def normalised(self, R_g: Any, L_g: Any) -> NormalisedGains:
        """Normalised parameters for an estimated grid; R_g and L_g are scalars or arrays."""

    def gains(self, R_g: float, L_g: float) -> PowerLoopGains:
        """Gains for a grid of R_g (Ω) and L_g (H) at the design point.

        Raises NoOperatingPointError if this grid cannot carry (P, Q), or if A or D is not positive there, so that no
        positive gain makes the loop stable.
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
                f"no gains: P = {self.P / 1e3:.4g} kW, Q = {self.Q / 1e3:.4g} kvar {what} at "
                f"R_g = {R_g:.4g} Ω, L_g = {L_g * 1e3:.4g} mH. {advice} (P_design, Q_design), or leave this grid out.",
                shortfall_w=shortfall_w,
            )
        return PowerLoopGains(*(float(value) for value in self._from_plant(self.normalised(R_g, L_g), A, B, C, D)))

    def gains_over(self, R_g: Any, L_g: Any) -> PowerLoopGains:
        """Gains at the design point for arrays of grids; NaN where :meth:`gains` would raise."""
        return self.gains_with(self.normalised(R_g, L_g), R_g, L_g)

    def gains_with(self, normalised: NormalisedGains, R_g: Any, L_g: Any) -> PowerLoopGains:
        """Like :meth:`gains_over`, but with other normalised parameters."""
        A, B, C, D = self.plant_gains(R_g, L_g)
        with np.errstate(invalid="ignore", divide="ignore"):
            good = np.where((A > 0.0) & (D > 0.0), 1.0, np.nan)
            return PowerLoopGains(*(value * good for value in self._from_plant(normalised, A, B, C, D)))

    def gains_measured(self, R_g: Any, L_g: Any, P: Any, Q: Any, V_rms: Any) -> PowerLoopGains:
        """Gains from an estimated grid and the measured P, Q, V at the control point, for arrays or scalars.

        The Jacobian is computed without solving for an operating point (:eq:`jacobian-from-powers`), so an error of the
        estimate does not also change V. The Jacobian is kept away from values without an inverse (:eq:`drawn-in`,
        :eq:`well-posed`).
        """
        with np.errstate(invalid="ignore"):  # an estimate that is not finite gives NaN
            J = scheduled_jacobian(P, Q, V_rms, *self._path(R_g, L_g))
            return self._from_plant(self.normalised(R_g, L_g), *J)

    def gains_of_floats(self, R_g: float, L_g: float, P: float, Q: float, V_rms: float) -> PowerLoopGains:
        """:meth:`gains_measured` of floats, with the same bits at a fifth of the cost."""
        gains, (D_p, D_q) = _law_of(self.structure, self.D_p, self.D_q)
        try:
            A, B, C, D = _scheduled_jacobian(P, Q, V_rms, *self._path(R_g, L_g))
            scale = self.S_rated, self.omega, self.law == "inertia"
            return gains(A, B, C, D, self.normalised(R_g, L_g), D_p, D_q, *scale)
        except ZeroDivisionError:  # where an array has a value that is not finite
            return PowerLoopGains(*(float(x) for x in self.gains_measured(R_g, L_g, P, Q, np.float64(V_rms))))

    def plant_gains(self, R_g: Any, L_g: Any) -> tuple[Any, Any, Any, Any]:
        """The Jacobian A, B, C, D at the design point on a grid. It is NaN where there is no operating point."""
        R, X = self._path(R_g, L_g)
        with np.errstate(invalid="ignore"):
            V_rms, _ = operating_point(self.P, self.Q, self.V_g_rms, R, X)
        return jacobian_from_powers(self.P, self.Q, V_rms, R, X)

    def _path(self, R_g: Any, L_g: Any) -> tuple[Any, Any]:
        return R_g + self.R_2, self.omega * (L_g + self.L_2)

    def _from_plant(self, normalised: NormalisedGains, A: Any, B: Any, C: Any, D: Any) -> PowerLoopGains:
        structure = STRUCTURES[self.structure]
        D_p, D_q = structure.droops(self.D_p, self.D_q)
        return structure.gains(A, B, C, D, normalised, D_p, D_q, self.S_rated, self.omega, self.law == "inertia")
