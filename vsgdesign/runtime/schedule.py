"""The common part of all gain schedules, and the one in closed form: the gains follow from normalised parameters, which
in closed form are the same on every grid, and from the Jacobian of the grid.

Equations run on plain floats here: the same code, with Python's arithmetic in place of NumPy's scalars.
"""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from types import FunctionType, SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from vsgdesign.equations.placing import PLACED
from vsgdesign.equations.power_flow import (
    jacobian_from_powers,
    largest_scale,
    operating_point,
    scheduled_jacobian,
)
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import PUBLISHED, STRUCTURES, ClosedFormAim, NormalisedGains, StructureGains
from vsgdesign.errors import NoOperatingPointError

if TYPE_CHECKING:
    from vsgdesign.study.parameters.study import ClosedFormTarget, Study


F = TypeVar("F", bound=Callable[..., Any])


def _sqrt(x: float) -> float:
    return math.sqrt(x) if x >= 0.0 else math.nan


def _maximum(a: float, b: float) -> float:
    return a if a >= b or a != a else b


def _minimum(a: float, b: float) -> float:
    return a if a <= b or a != a else b


def _where(condition: bool, one: float, other: float) -> float:
    return one if condition else other


def _clip(value: float, low: float, high: float) -> float:
    value = value if value >= low or value != value else low
    return value if value <= high or value != value else high


def _search(row: tuple[float, ...], value: float, side: str) -> int:
    del side
    return bisect_right(row, value)


def _as_float(function: Callable[..., Any]) -> Callable[..., float]:
    """Calls NumPy's own function, so that the last bit is the same, and returns its result as a float."""
    return lambda *values: float(function(*values))


_NUMPY = SimpleNamespace(
    pi=math.pi,
    sqrt=_sqrt,
    maximum=_maximum,
    minimum=_minimum,
    where=_where,
    clip=_clip,
    searchsorted=_search,
    abs=abs,
    **{
        name: _as_float(getattr(np, name))
        for name in ("arctan2", "cos", "exp", "floor", "hypot", "log", "sin", "tan", "tanh")
    },
)


@cache
def on_floats(function: F) -> F:
    """A copy of the function, and of those that it calls, for floats alone. It gives the same bits at a third of the
    cost.

    NumPy's functions return NumPy's scalars, whose arithmetic takes several times as long as that of floats. Code that
    runs in every window calls this copy, so the equation itself is written only once.
    """
    scope = dict(function.__globals__)  # type: ignore[attr-defined]
    scope["np"] = _NUMPY
    code = function.__code__  # type: ignore[attr-defined]
    for name in code.co_names:
        if isinstance(scope.get(name), FunctionType):
            scope[name] = on_floats(scope[name])
    copy = FunctionType(code, scope, function.__name__, function.__defaults__, function.__closure__)  # type: ignore
    copy.__kwdefaults__ = function.__kwdefaults__  # type: ignore[attr-defined]
    return copy  # type: ignore[return-value]


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
