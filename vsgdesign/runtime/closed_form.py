"""Scheduled gains in closed form: the normalised parameters are the same on every grid."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from vsgdesign.equations.placing import PLACED
from vsgdesign.equations.structures import STRUCTURES, ClosedFormAim, NormalisedGains
from vsgdesign.runtime.schedule import Schedule

if TYPE_CHECKING:  # the controller does not read study files
    from vsgdesign.study.parameters.study import ClosedFormTarget, Study


@dataclass(frozen=True, kw_only=True)
class ClosedFormSchedule(Schedule):
    """A gain schedule for any structure, target, operating point and filter.

    The structure determines which fields are used. The published one uses ``settling_time``, ``damping_ratio`` and
    ``droop_ratio`` (:eq:`closed-form-gains`). The others use the pole placement k_1, d_1, k_2 and the shares of
    decoupling (:eq:`decoupled-gains`, :eq:`angle-damped-gains`). Law ``inertia`` uses H (s) and zeta.
    """

    settling_time: float
    damping_ratio: float
    droop_ratio: float
    k_1: float = PLACED.k_1
    d_1: float = PLACED.d_1
    k_2: float = PLACED.k_2
    share_P: float = 1.0
    share_Q: float = 1.0
    H: float = 5.0
    zeta: float = 0.7

    def normalised(self, R_g: Any, L_g: Any) -> NormalisedGains:  # noqa: ARG002 - the same on every grid
        """The normalised parameters, which are the same for every grid."""
        return self._everywhere

    @functools.cached_property
    def _everywhere(self) -> NormalisedGains:
        aim = ClosedFormAim(**{name: getattr(self, name) for name in ClosedFormAim._fields})
        normalised = STRUCTURES[self.structure].closed_form(aim)
        if self.law == "inertia":
            return normalised._replace(k_1_or_H=self.H, d_1_or_zeta=self.zeta)
        return normalised


def closed_form_schedule(
    study: Study, target: ClosedFormTarget, P: float | None = None, Q: float | None = None
) -> ClosedFormSchedule:
    """The schedule of a study's converter for a target. P and Q replace the operating point of the target."""
    c = study.converter
    droops = target.P_droop, target.Q_droop
    D_p, D_q = STRUCTURES[target.structure].rated_droops(*droops, c.S_rated, c.omega_n, c.V_rated_rms)
    return ClosedFormSchedule(
        P=target.P if P is None else P,
        Q=target.Q if Q is None else Q,
        V_g_rms=study.grid_source.V_g_rms,
        omega=c.omega_n,
        settling_time=target.settling_time,
        damping_ratio=target.damping_ratio,
        droop_ratio=target.droop_ratio,
        R_2=study.filter.R_2,
        L_2=study.filter.L_2,
        structure=target.structure,
        k_1=target.k_1,
        d_1=target.d_1,
        k_2=target.k_2,
        D_p=D_p,
        D_q=D_q,
        share_P=target.share_P,
        share_Q=target.share_Q,
        S_rated=c.S_rated,
    )
