"""The region of a certificate, and the state matrices of the power loops in it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import StaticLimits
from vsgdesign.equations.frames import base_impedance, rated_current_rms
from vsgdesign.equations.grid import MOST_ERROR_Z, SCR_BASES, error_half_widths
from vsgdesign.equations.power_flow import (
    Lags,
    admittance,
    converter_side,
    jacobian_from_powers,
    operating_point,
    yielding_columns,
)
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops_about_rest
from vsgdesign.errors import Fault, InfeasibleStudyError
from vsgdesign.linear.operating_point.equilibrium import HasFilter, converter_side_of, static_limits, uses_of
from vsgdesign.runtime.schedule import Schedule
from vsgdesign.runtime.table import TableSchedule
from vsgdesign.study.parameters.grid import GridSource
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

STATES = ("delta", "omega_r", "V")
"""ω_r is the frequency at which the integrator would rest: it is continuous when the gains change
(:eq:`gain-transfer`)."""

YIELDING = ("i_f_d", "i_f_q")
"""With a transient impedance the current behind its low-pass, in the converter's frame, follows: it is continuous when
the gains or the grid change."""

OMEGA_SCALE = 4.0
"""Scale of ω_r in rad/s, so that all three states have a similar size."""


class MeasuredSchedule(Protocol):
    """A gain schedule as in the runtime: a function of arrays of estimated R_g (Ω), L_g (H) and measured P, Q, V.

    Any such schedule can be certified on points, a closed form or a gain table without gaps, too.
    """

    def gains_measured(self, R_g: Any, L_g: Any, P: Any, Q: Any, V_rms: Any) -> PowerLoopGains:
        """Gains from an estimated grid and the measured P, Q, V."""
        ...


@dataclass(frozen=True)
class AtDesignPoint:
    """A closed form with the Jacobian of its design point, as in a run. The measured P, Q and V have no effect."""

    schedule: Schedule

    def gains_measured(self, R_g: Any, L_g: Any, P: Any, Q: Any, V_rms: Any) -> PowerLoopGains:  # noqa: ARG002
        """Gains of an estimated grid; NaN where the design point does not exist on it."""
        return self.schedule.gains_over(R_g, L_g)


@dataclass(frozen=True)
class Region:
    """Where a certificate is asked for. Limits of SCR (on the study's basis), X/R, P (W), Q (var); the error is
    relative, of R_g and of L_g, each anywhere within ± it. ``rate``: largest |d ln SCR/dt| and |d ln(X/R)/dt| in
    1/s; infinite: the grid may jump."""

    scr: tuple[float, float]
    x_over_r: tuple[float, float]
    P: tuple[float, float]
    Q: tuple[float, float]
    error: float = 0.0
    rate: float = np.inf
    error_Z: float = 0.0
    """The same of each, relative to \\|Z_g\\|: the larger of the two counts (:eq:`error-set`)."""

    @property
    def largest_error(self) -> float:
        """What the coordinates of both errors run to, on both sides."""
        return max(self.error, self.error_Z)

    def error_scales(self, angle: Any) -> tuple[Any, Any]:
        """Half-widths of the error set of a true grid with this angle, rad, relative to its R and X, over the largest
        error: what the coordinates of the errors are multiplied with."""
        R, X = np.cos(angle), np.sin(angle)
        w_R, w_X = error_half_widths(R, X, self.error, self.error, self.error_Z)
        return w_R / R / self.largest_error, w_X / X / self.largest_error

    def holds(self, angle: Any, e_R: Any, e_L: Any) -> Any:
        """Whether relative errors of R_g and L_g lie in the error set of a true grid with this angle, rad."""
        if not self.error_Z:
            return (np.abs(e_R) <= self.error) & (np.abs(e_L) <= self.error)
        most = self.largest_error * (1.0 + 1e-12)
        scale_R, scale_L = self.error_scales(angle)
        return (np.abs(e_R) <= most * scale_R) & (np.abs(e_L) <= most * scale_L)

    def as_document(self) -> dict[str, Any]:
        """As a table's file has it."""
        found = asdict(self)
        if self.error_Z == 0.0:  # as in a certificate of before
            del found["error_Z"]
        return found

    @property
    def limits(self) -> tuple[Array, Array]:
        """The region's box in the coordinates of :class:`System`, (6,) each. With ``error_Z``, those of the errors are
        shares of the error set's half-widths, as in the columns of :func:`point_of`."""
        scr, error = (1.0 / self.scr[1], 1.0 / self.scr[0]), (-self.largest_error, self.largest_error)
        rows = [scr, np.arctan(self.x_over_r), self.P, self.Q, error, error]
        low, high = np.array(rows, dtype=float).T
        return low, high


def region_faults(region: Region) -> list[Fault]:
    """All faults of a region."""
    faults = []
    for name, (low, high), least, most in (
        ("scr", region.scr, 0.05, 1e3),
        ("x-over-r", region.x_over_r, 1e-2, 1e3),
        ("P", region.P, -np.inf, np.inf),
        ("Q", region.Q, -np.inf, np.inf),
    ):
        if not (least <= low <= high <= most and np.isfinite([low, high]).all()):
            within = f" from {least:g} to {most:g}" if np.isfinite(least) else ""
            faults.append(Fault(name, f"{low:g} {high:g}", f"must be two numbers{within}, the smaller first"))
    if not 0.0 <= region.error < 0.9:
        faults.append(Fault("error", f"{region.error:g}", "must be from 0 to 0.9, a fraction of the value"))
    if not 0.0 <= region.error_Z <= MOST_ERROR_Z:
        limit = f"must be from 0 to {MOST_ERROR_Z:g}, a fraction of |Z_g|"
        faults.append(Fault("error-z", f"{region.error_Z:g}", limit))
    elif region.error_Z >= (share := float(np.sin(np.arctan(region.x_over_r[0])))):
        limit = f"leaves no inductance in an estimate at X/R {region.x_over_r[0]:g}: must be less than {share:.3g}"
        faults.append(Fault("error-z", f"{region.error_Z:g}", limit, "Begin x-over-r higher, or ask for less."))
    if not region.rate >= 0.0:
        faults.append(Fault("rate", f"{region.rate:g}", "must be zero or more, in 1/s", "inf: the grid may jump."))
    return faults


class Cells(NamedTuple):
    """M points of a region with what follows from them, arrays (M,)."""

    points: Array
    """(M, 6)."""
    R: Array
    X: Array
    """Path from the control point to the grid source at the grid's frequency, Ω; of units against each other to their
    node."""
    V_rms: Array
    gains: PowerLoopGains

    @property
    def jacobian(self) -> tuple[Any, Any, Any, Any]:
        """A, B, C, D of the true grid (:eq:`jacobian-from-powers`)."""
        return jacobian_from_powers(self.points[:, 2], self.points[:, 3], self.V_rms, self.R, self.X)


class Ground(HasFilter, Protocol):
    """What power loops stand on: a study, or what a gain table keeps of one."""

    @property
    def grid_source(self) -> GridSource: ...

    @property
    def scr_basis(self) -> str: ...

    @property
    def power_lags(self) -> Lags: ...


class _AtRest(NamedTuple):
    """Grids and operating points of points, arrays (N,), and which share of each static limit they use."""

    R_g: Array
    L_g: Array
    R: Array
    X: Array
    V_rms: Array
    uses: dict[str, Array]

    @property
    def most_used(self) -> Array:
        """The largest of the shares; NaN without an operating point."""
        return np.max(list(self.uses.values()), axis=0)


@dataclass(frozen=True)
class System:
    """A study's power loops under a schedule. A point is (1/SCR, atan(X/R) in rad, P, Q, relative error of R_g, of
    L_g), the SCR on the study's basis."""

    study: Ground
    schedule: MeasuredSchedule
    region: Region | None = None
    """With a region that has ``error_Z``, a table's estimates are those within its axes: the scheduler draws all others
    to them. A point with an estimate beyond the axes is drawn there, and left out where that is not in the error
    set."""
    limits: StaticLimits | None = None
    """Static limits within which operating points count; None: those of the study."""
    transient: bool = True
    """Whether the transient impedance is a part of the loops. Certified steps leave it out."""
    apart: bool = False
    """Whether the loops are those of equal units against each other: with the gains, the powers and the voltage that
    they have on the grid, on their own path alone (:eq:`differential-mode`)."""
    placed: bool = False
    """Whether the proof is one of a place of the grid."""

    @cached_property
    def static(self) -> StaticLimits:
        """The static limits within which operating points count."""
        if self.limits is not None or not isinstance(self.study, Study):
            return self.limits or StaticLimits()
        return static_limits(self.study)

    @property
    def lags(self) -> Lags:
        """The transient impedance; the power filters are no part of the loops here."""
        return self.study.power_lags._replace(tau_P=0.0, tau_Q=0.0) if self.transient else Lags()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return (*STATES, *YIELDING) if self.lags.yields else STATES

    @property
    def scale(self) -> Array:
        """What the states are divided by: rad, 4 rad/s, rated voltage; rated current."""
        c = self.study.converter
        current = rated_current_rms(c.S_rated, c.V_rated_rms)
        return np.array([1.0, OMEGA_SCALE, c.V_rated_rms, current, current])[: len(self.states)]

    def beyond_converter(self, P: Any, Q: Any, V_sq: Any, unit: Any) -> list[Any]:
        """By how much the squares of current and bridge voltage are above their limits, for numbers or symbols.

        P, Q and V² are per unit over any common scale; ``unit`` is the square of V² over this scale, divided by V².
        """
        sides = converter_side(P, Q, V_sq, *converter_side_of(self.study, self.study.grid_source.omega_g))
        limits = self.static.current, self.static.bridge_voltage
        return [side - unit * limit**2 for side, limit in zip(sides, limits, strict=True) if limit is not None]

    def cells(self, points: Array, partial: bool = False) -> Cells:
        """The cells of those of the points (N, 6) that lie within the static limits (:eq:`static-limits`).

        Raises InfeasibleStudyError where one of them has no gains; ``partial`` leaves those out instead.
        """
        at = self._operating_points(points)
        inside = at.most_used <= 1.0
        points, R_g, L_g, R, X, V_rms = (value[inside] for value in (points, *at[:5]))
        if self.region is not None and self.region.error_Z and isinstance(self.schedule, TableSchedule):
            points, kept = self._drawn(points, R_g, L_g)
            points, R_g, L_g, R, X, V_rms = (value[kept] for value in (points, R_g, L_g, R, X, V_rms))
        _, _, P, Q, e_R, e_L = points.T
        gains = self.schedule.gains_measured(R_g * (1.0 + e_R), L_g * (1.0 + e_L), P, Q, V_rms)
        bare = np.isnan(np.broadcast_to(np.asarray(gains.K_ip, dtype=float), P.shape))
        if bare.any():
            if partial:
                return self.cells(points[~bare])
            k = int(np.argmax(bare))
            raise InfeasibleStudyError(
                f"no gains for an estimate of R_g = {R_g[k] * (1.0 + e_R[k]):.4g} Ω, "
                f"L_g = {1e3 * L_g[k] * (1.0 + e_L[k]):.4g} mH, which the region holds: the design point does not "
                'exist on this grid. Shrink the region, lower P_design, Q_design, or set operating_point = "reference".'
            )
        if self.apart:
            f = self.study.filter
            R, X = np.full_like(R, f.R_2), np.full_like(X, self.study.grid_source.omega_g * f.L_2)
        return Cells(points, R, X, V_rms, gains)

    def within_limits(self, points: Array) -> NDArray[np.bool_]:
        """Which of the points (N, 6) lie within the static limits (:eq:`static-limits`)."""
        return self._operating_points(points).most_used <= 1.0

    def _operating_points(self, points: Array) -> _AtRest:
        study = self.study
        c, source, f = study.converter, study.grid_source, study.filter
        weakness, angle, P, Q, _, _ = points.T
        Z_g = SCR_BASES[study.scr_basis].magnitude(weakness * c.Z_base, np.sin(angle))
        R_g, L_g = Z_g * np.cos(angle), Z_g * np.sin(angle) / c.omega_n
        R, X = R_g + f.R_2, source.omega_g * (L_g + f.L_2)
        with np.errstate(invalid="ignore"):
            V_rms, _ = operating_point(P, Q, source.V_g_rms, R, X)
            uses = uses_of(self.static, study, R, X, source.omega_g, P, Q, V_rms)
        return _AtRest(R_g, L_g, R, X, V_rms, uses)

    def emptiness(self, points: Array) -> str | None:
        """Why none of the points (N, 6) lies within the static limits: what the nearest of them would need. None where
        one does."""
        found = self._operating_points(points)
        if not np.isfinite(found.most_used).any():
            return "no grid of the region carries its powers"
        k = int(np.nanargmin(found.most_used))
        if found.most_used[k] <= 1.0:
            return None
        name, use = max(found.uses.items(), key=lambda item: item[1][k])
        at = points[k]
        return (
            f"at SCR {1.0 / at[0]:.4g}, X/R {np.tan(at[1]):.4g}, P {at[2] / 1e3:.4g} kW, Q {at[3] / 1e3:.4g} kvar, "
            f"where least is asked, {100.0 * use[k]:.3g} % of the limit of {name} is used"
        )

    def _drawn(self, points: Array, R_g: Array, L_g: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Points with their estimates drawn into the table, and which of them are still in the error set."""
        schedule: Any = self.schedule
        region: Any = self.region
        R_hat, L_hat = R_g * (1.0 + points[:, 4]), L_g * (1.0 + points[:, 5])
        inside = schedule.place(R_hat, L_hat)
        beyond = (inside.clipped_scr != 0) | (inside.clipped_x_over_r != 0)
        axes = (schedule.scr[0], schedule.scr[-1]), (schedule.r_over_x[0], schedule.r_over_x[-1])
        R_in, L_in, _ = schedule.drawn_to(R_hat, L_hat, *axes)
        points = points.copy()
        points[beyond, 4], points[beyond, 5] = (R_in / R_g - 1.0)[beyond], (L_in / L_g - 1.0)[beyond]
        return points, np.asarray(~beyond | region.holds(points[:, 1], points[:, 4], points[:, 5]))

    def matrices(self, points: Array, partial: bool = False) -> tuple[Array, Array]:
        """Points (N, 6) that lie within the static limits, and their state matrices over ``scale``, (M, n, n).

        Raises the error of :meth:`cells`.
        """
        cells = self.cells(points, partial)
        A, B, C, D = cells.jacobian
        none, change = References(0.0, 0.0, 0.0, 0.0), []
        powers: list[tuple[Any, Any]] = [(A, C), (B, D)]
        if self.lags.yields:
            powers, change = _yielding(self.lags, cells)
        # The law is linear: its answers to one unit of each state are the columns of the matrix.
        columns: list[Any] = [
            power_loops_about_rest(0.0, 0.0, *powers[0], none, cells.gains),
            power_loops_about_rest(1.0, 0.0, 0.0, 0.0, none, cells.gains),
            power_loops_about_rest(0.0, 1.0, *powers[1], none, cells.gains),
            *(power_loops_about_rest(0.0, 0.0, *power, none, cells.gains) for power in powers[2:]),
        ]
        if change:
            columns = [(*column, *rates) for column, rates in zip(columns, change, strict=True)]
        n = len(columns)
        found = np.empty((len(cells.points), n, n))
        for i in range(n):
            for j in range(n):
                found[:, i, j] = columns[j][i]
        return cells.points, found * (self.scale[None, None, :] / self.scale[None, :, None])


def _yielding(lags: Lags, cells: Cells) -> tuple[list[tuple[Any, Any]], list[tuple[Any, Any]]]:
    """Powers of one unit of δ, V, i_f_d and i_f_q, and the rates of i_f of these and of ω_r after δ, SI."""
    _, _, P, Q, _, _ = cells.points.T
    V = cells.V_rms
    R, X, over = cells.R + lags.R_t, cells.X + lags.X_t, base_impedance(1.0, V)
    found = yielding_columns(P, Q, *admittance(V, R, X, R * R + X * X), lags.R_t / over, lags.X_t / over)
    # One volt is 1/V, one ampere 3V watts.
    current = 1.0 / rated_current_rms(1.0, V)
    units = 1.0, 1.0 / V, current, current
    powers = [(p * unit, q * unit) for (p, q), unit in zip(found.powers, units, strict=True)]
    rates = [
        (lags.omega_t * d * unit / current, lags.omega_t * q * unit / current)
        for (d, q), unit in zip(found.change, units, strict=True)
    ]
    return powers, [rates[0], (0.0, 0.0), *rates[1:]]


def nodes(region: Region, count: int) -> Array:
    """(N, 6) points: SCR and X/R log-spaced, P and Q at their limits and middle, errors at −, 0, +."""
    low, high = region.limits
    axes = [np.geomspace(*region.scr, count), np.geomspace(*region.x_over_r, count)]
    axes += [np.linspace(low[k], high[k], 3) for k in range(2, 6)]
    mesh = np.meshgrid(*(np.unique(axis) for axis in axes), indexing="ij")
    return point_of(np.stack([axis.ravel() for axis in mesh], axis=1), region)


_LINES, _BISECTIONS = 17, 20
"""Values of a power at which a line is looked at, and bisections between two of them."""


def points_on_limits(system: System, region: Region, count: int) -> Array:
    """(N, 6) points on the static limits: SCR and X/R log-spaced, one power at its limits and middle, the other as far
    out as the static limits let it go, errors at −, 0, +. The worst is often there, where a lattice has no point."""
    low, high = region.limits
    grids = [np.geomspace(*region.scr, count), np.geomspace(*region.x_over_r, count)]
    ends = []
    for along, other in ((2, 3), (3, 2)):
        mesh = np.meshgrid(*grids, np.unique(np.linspace(low[other], high[other], 3)), indexing="ij")
        columns = np.zeros((mesh[0].size, 6))
        columns[:, 0], columns[:, 1], columns[:, other] = (axis.ravel() for axis in mesh)

        def within(value: Any, columns: Array = columns, along: int = along) -> NDArray[np.bool_]:
            columns[:, along] = value
            return system.within_limits(point_of(columns))

        values = np.linspace(low[along], high[along], _LINES)
        inside = np.array([within(value) for value in values])
        for outward in (-1, 1):
            last = np.argmax(inside, axis=0) if outward < 0 else _LINES - 1 - np.argmax(inside[::-1], axis=0)
            kept, lost = values[last], values[np.clip(last + outward, 0, _LINES - 1)]
            for _ in range(_BISECTIONS):
                middle = 0.5 * (kept + lost)
                held = within(middle)
                kept, lost = np.where(held, middle, kept), np.where(held, lost, middle)
            columns[:, along] = kept
            ends.append(columns[inside.any(axis=0)])
    errors = np.array([(one, other) for one in (low[4], 0.0, high[4]) for other in (low[5], 0.0, high[5])])
    columns = np.repeat(np.unique(np.concatenate(ends), axis=0), len(errors), axis=0)
    columns[:, 4:] = np.tile(errors, (len(columns) // len(errors), 1))
    return point_of(columns, region)


def random_points(region: Region, count: int, rng: np.random.Generator) -> Array:
    """(N, 6) points, log-uniform in SCR and X/R, uniform in the rest."""
    low, high = region.limits
    low[:2], high[:2] = np.log([[region.scr[0], region.x_over_r[0]], [region.scr[1], region.x_over_r[1]]])
    points = rng.uniform(low, high, (count, 6))
    points[:, :2] = np.exp(points[:, :2])
    return point_of(points, region)


def point_of(columns: Array, region: Region | None = None) -> Array:
    """Points (N, 6) from SCR, X/R, P, Q and both errors as columns.

    With a region that has ``error_Z`` the errors are shares of the error set, times its largest error; else they are
    the relative errors themselves.
    """
    points = columns.copy()
    points[:, 0], points[:, 1] = 1.0 / columns[:, 0], np.arctan(columns[:, 1])
    if region is not None and region.error_Z:
        for k, scale in zip((4, 5), region.error_scales(points[:, 1]), strict=True):
            points[:, k] *= scale
    return points


def with_shares(points: Array, region: Region) -> Array:
    """A copy of points with their errors as :func:`point_of` takes them."""
    points = points.copy()
    if region.error_Z:
        for k, scale in zip((4, 5), region.error_scales(points[:, 1]), strict=True):
            points[:, k] /= scale
    return points
