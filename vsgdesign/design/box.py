"""The scenarios of one cell: every combination of power, estimate error, grid frequency and voltage to survive."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.error_bounds import truth_behind
from vsgdesign.equations.grid import error_half_widths
from vsgdesign.equations.power_flow import POWER_MARGIN, operating_point
from vsgdesign.frames import rated_current_rms, rms_to_peak
from vsgdesign.parameters.specification import Specification
from vsgdesign.parameters.study import Grid, Place, Study

Array = NDArray[np.float64]

Reach = tuple[float, float, float, float]
Signs = tuple[float, float]
"""1 where the estimate of R, of X is too large by the half-width of the error set, −1 where it is too small."""

_BISECTIONS = 24
_ROUNDING = 1e-9
"""A grid that is this little outside the table, relatively, is on its edge."""

_BRIDGE_SHARE = 0.995
"""Of the bridge's voltage limit: the rest is for the sampled bridge, which makes its fundamental in steps."""

NOMINAL = 0
"""The scenario without error, at the design point or as much of it as the limits allow, comes first."""


@dataclass(frozen=True)
class Scenarios:
    """S scenarios, arrays of shape (S,) (or one, as symbols). R, X: the true path from the control point to the
    source at the true frequency; R_hat, X_hat: what the schedule takes for it; P, Q, V_rms, delta: where it runs."""

    R: Any
    X: Any
    R_hat: Any
    X_hat: Any
    V_g_rms: Any
    omega_g: Any
    P: Any
    Q: Any
    V_rms: Any
    delta: Any

    def __len__(self) -> int:
        return len(self.R)

    def take(self, index: NDArray[np.intp]) -> Scenarios:
        """Some of the scenarios, in the given order."""
        return Scenarios(*(getattr(self, f.name)[index] for f in fields(self)))


def joined(parts: Sequence[Scenarios]) -> Scenarios:
    """All scenarios of several sets, in order."""
    return Scenarios(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Scenarios)))


def scenarios_of_truth(study: Study, spec: Specification, scr: float, x_over_r: float, P: float, Q: float) -> Scenarios:
    """All scenarios of a true grid, wherever its estimate lies; none where not even zero power is within the limits.

    P and Q (the design point) come first without error, at nominal frequency and voltage; then all combinations
    of the box's limits, with its middle where powers of both signs are asked for. Limits (:func:`within_limits`)
    cut the box: a power beyond them is drawn in towards zero until it lies on them, so what is asked of a grid
    changes smoothly with it.
    """
    grid = Place(scr, x_over_r, spec.scr_basis).grid(study.converter)
    return _scenarios(study, spec, _around_truth(study, grid, spec), P, Q)


def scenarios_of_estimate(
    study: Study, spec: Specification, scr: float, x_over_r: float, P: float, Q: float
) -> Scenarios:
    """All scenarios in which a schedule looks up this grid: the true ones that may lie behind the estimate.

    Beyond the table's edge nothing is promised: errors that would put the truth there are drawn in until it lies on
    the edge. A node on the edge has the estimates beyond it too that are looked up there.
    """
    return _scenarios(study, spec, _behind_node(study, spec, scr, x_over_r), P, Q)


def scenarios_around_estimate(
    study: Study, spec: Specification, scr: float, x_over_r: float, reach: Reach, P: float, Q: float
) -> Scenarios:
    """The same, then those of lookups up to half way to the neighbouring nodes, where this node has most say.

    ``reach``: the least and largest SCR and X/R of those lookups. The worst grids need not be nodes: where two static
    limits meet, what is asked of a grid has a sharp maximum.
    """
    own = _behind_node(study, spec, scr, x_over_r)
    more = [
        pair
        for s in _steps(reach[0], scr, reach[1])
        for x in _steps(reach[2], x_over_r, reach[3])
        for pair in _behind_lookup(study, spec, s, x)
    ]
    return _scenarios(study, spec, list(dict.fromkeys([*own, *more])), P, Q)


def _behind_node(study: Study, spec: Specification, scr: float, x_over_r: float) -> list[tuple[Grid, Grid]]:
    grid = Place(scr, x_over_r, spec.scr_basis).grid(study.converter)
    return list(dict.fromkeys([(grid, grid), *_behind_lookup(study, spec, scr, x_over_r)]))


def _behind(study: Study, spec: Specification, estimate: Grid) -> list[tuple[Grid, Grid]]:
    """(truth, estimate) for every sign of the errors, the truth within the table."""
    return [(_drawn_in(study, spec, estimate, signs), estimate) for signs in _signs_of(spec)]


def _behind_lookup(study: Study, spec: Specification, scr: float, x_over_r: float) -> list[tuple[Grid, Grid]]:
    """(truth, estimate) of a place in the table: also estimates beyond its edge that are looked up here."""
    c, basis = study.converter, spec.scr_basis
    place = Place(scr, x_over_r, basis).grid(c)
    pairs = _behind(study, spec, place)
    for signs in _signs_of(spec):
        truths = []
        if scr in (spec.scr[0], spec.scr[-1]):
            truths += [(scr, turned) for turned in _turned(study, spec, scr, x_over_r, signs)]
            truths.append((scr, x_over_r))
        if x_over_r in (spec.x_over_r[0], spec.x_over_r[-1]):
            # The widths of an angle are in proportion to the impedance.
            there = _estimate(study, spec, place, signs).scr(c, basis)
            truths.append((scr * scr / there, x_over_r))
        for s, x in truths:
            truth = Place(s, x, basis).grid(c)
            if not _is_within(study, spec, truth):
                continue
            estimate = _estimate(study, spec, truth, signs)
            found = _within_table(study, spec, estimate)
            if np.allclose([found.R_g, found.L_g], [place.R_g, place.L_g], rtol=1e-9):
                pairs.append((truth, _seen(study, spec, estimate)))
    return pairs


def _turned(study: Study, spec: Specification, scr: float, x_over_r: float, signs: Signs) -> list[float]:
    """The X/R of the true grid of this SCR whose estimate has ``x_over_r``; none where the table has no such grid."""
    box, omega_n = spec.box, study.converter.omega_n
    if not box.error_Z:
        return [x_over_r / ((1.0 + signs[1] * box.error_X) / (1.0 + signs[0] * box.error_R))]

    def angle(true: float) -> float:
        grid = Place(scr, true, spec.scr_basis).grid(study.converter)
        estimate = _estimate(study, spec, grid, signs)
        return float(np.arctan2(omega_n * estimate.L_g, estimate.R_g))

    low, high, wanted = np.log(spec.x_over_r[0]), np.log(spec.x_over_r[-1]), float(np.arctan(x_over_r))
    if not angle(float(np.exp(low))) <= wanted <= angle(float(np.exp(high))):
        return []
    for _ in range(2 * _BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if angle(float(np.exp(middle))) < wanted else (low, middle)
    return [float(np.exp(0.5 * (low + high)))]


def _steps(low: float, middle: float, high: float) -> list[float]:
    """The middle, both limits and what lies half way, evenly in the logarithm."""
    return sorted({low, float(np.sqrt(low * middle)), middle, float(np.sqrt(middle * high)), high})


def _around_truth(study: Study, grid: Grid, spec: Specification) -> list[tuple[Grid, Grid]]:
    """(truth, estimate): without error first."""
    estimates = [_seen(study, spec, _estimate(study, spec, grid, signs)) for signs in _signs_of(spec)]
    return list(dict.fromkeys([(grid, grid), *((grid, estimate) for estimate in estimates)]))


def _signs_of(spec: Specification) -> list[Signs]:
    """Signs of the errors of R and of X: every corner of the error set."""
    error_R, error_X, error_Z = spec.box.errors
    return list(itertools.product(_signs(max(error_R, error_Z)), _signs(max(error_X, error_Z))))


def _estimate(study: Study, spec: Specification, truth: Grid, signs: Signs) -> Grid:
    """The estimate of a true grid at one corner of its error set (:eq:`error-set`)."""
    error_R, error_X, error_Z = spec.box.errors
    if error_Z:
        R, X = truth.R_g, study.converter.omega_n * truth.L_g
        widths = error_half_widths(R, X, error_R, error_X, error_Z)
        error_R, error_X = (float(width / value) for width, value in zip(widths, (R, X), strict=True))
    return Grid(truth.R_g * (1.0 + signs[0] * error_R), truth.L_g * (1.0 + signs[1] * error_X))


def _seen(study: Study, spec: Specification, estimate: Grid) -> Grid:
    """The grid that the gains are made of. With ``error_Z`` this is the estimate clipped to the table, as in the
    scheduler: beyond it, R̂ may be negative. Without, the Jacobian has the estimate as it is, as it always had."""
    return _within_table(study, spec, estimate) if spec.box.error_Z else estimate


def _drawn_in(study: Study, spec: Specification, estimate: Grid, signs: Signs) -> Grid:
    """The truth behind an estimate with these errors, or with as much of both as leaves it within the table."""
    omega_n = study.converter.omega_n

    def truth(share: float) -> Grid:
        errors = tuple(share * error for error in spec.box.errors)
        if not spec.box.error_Z:
            return Grid(estimate.R_g / (1.0 + signs[0] * errors[0]), estimate.L_g / (1.0 + signs[1] * errors[1]))
        R, X = truth_behind(estimate.R_g, omega_n * estimate.L_g, *signs, *errors)
        return Grid(float(R), float(X / omega_n))

    if _is_within(study, spec, truth(1.0)):
        return truth(1.0)
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _is_within(study, spec, truth(middle)) else (low, middle)
    return truth(low)


def _is_within(study: Study, spec: Specification, grid: Grid) -> bool:
    """Whether a grid is within the table."""
    place = grid.place(study.converter, spec.scr_basis)
    return all(
        axis[0] * (1.0 - _ROUNDING) <= value <= axis[-1] * (1.0 + _ROUNDING)
        for axis, value in ((spec.scr, place.scr), (spec.x_over_r, place.x_over_r))
    )


def _within_table(study: Study, spec: Specification, grid: Grid) -> Grid:
    """Where a schedule looks a grid up."""
    place = grid.place(study.converter, spec.scr_basis)
    scr = min(max(place.scr, spec.scr[0]), spec.scr[-1])
    ratio = min(max(place.x_over_r, spec.x_over_r[0]), spec.x_over_r[-1])
    return Place(scr, ratio, spec.scr_basis).grid(study.converter)


def _scenarios(study: Study, spec: Specification, grids: Sequence[tuple[Grid, Grid]], P: float, Q: float) -> Scenarios:
    """Every (truth, estimate) with every power, frequency and voltage; the design point with the first first."""
    box, f, omega_n = spec.box, study.filter, study.converter.omega_n
    powers = [(p, q) for p in _with_middle(box.P) for q in _with_middle(box.Q)]
    rows = [(0, P, Q, study.grid_source.omega_g, study.grid_source.V_g_rms)]
    with_error = range(1 if len(grids) > 1 else 0, len(grids))
    rows += [(k, *pq, w, v) for k, pq, w, v in itertools.product(with_error, powers, box.omega_g, box.V_g_rms)]
    which, powers_P, powers_Q, omega_g, V_g = np.array(rows).T
    truth, estimate = (
        np.array([(pair[side].R_g, pair[side].L_g) for pair in grids])[which.astype(int)].T for side in (0, 1)
    )
    R, X = f.R_2 + truth[0], omega_g * (f.L_2 + truth[1])
    R_hat, X_hat = f.R_2 + estimate[0], omega_n * (f.L_2 + estimate[1])

    def scaled(share: Array) -> Scenarios:
        p, q = share * powers_P, share * powers_Q
        with np.errstate(invalid="ignore"):
            V_rms, delta = operating_point(p, q, V_g, R, X)
        return Scenarios(R, X, R_hat, X_hat, V_g, omega_g, p, q, V_rms, delta)

    low, high = np.zeros(len(rows)), np.ones(len(rows))
    whole = within_limits(study, scaled(high))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        inside = within_limits(study, scaled(middle))
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    found = scaled(np.where(whole, 1.0, low))
    return found.take(np.flatnonzero(within_limits(study, found)))


def measured_at_limits(study: Study, spec: Specification, scr: float, x_over_r: float) -> Scenarios:
    """What a schedule may measure on a grid without an error, whether the grid carries it or not: P, Q and V at the
    limits and in the middle of the table's validity, (27,). Good for gains alone: nothing rests there."""
    grid = Place(scr, x_over_r, spec.scr_basis).grid(study.converter)
    R, X = study.path_to_grid(grid, study.converter.omega_n)
    axes = [np.linspace(min(pair), max(pair), 3) for pair in (spec.box.P, spec.box.Q, study.converter.V_limits_rms)]
    P, Q, V_rms = (values.ravel() for values in np.meshgrid(*axes, indexing="ij"))
    same = np.ones_like(P)
    return Scenarios(
        R=R * same,
        X=X * same,
        R_hat=R * same,
        X_hat=X * same,
        V_g_rms=V_rms,
        omega_g=study.converter.omega_n * same,
        P=P,
        Q=Q,
        V_rms=V_rms,
        delta=0.0 * same,
    )


def within_limits(study: Study, s: Scenarios) -> NDArray[np.bool_]:
    """(S,), which scenarios the converter and the grid can carry with room to spare.

    There is an operating point, V is within the converter's limits, 3V²/|Z| is at least POWER_MARGIN·|S|, the
    current is within the converter's limit, and the bridge can make the voltage behind its filter.
    """
    return np.logical_and.reduce([use <= 1.0 for use in limit_uses(study, s).values()])


def limit_uses(study: Study, s: Scenarios) -> dict[str, Array]:
    """How much of each static limit the scenarios use, (S,) each: 1 on the limit, NaN without an operating point."""
    c, f = study.converter, study.filter
    low, high = c.V_limits_rms
    apparent = np.hypot(s.P, s.Q)
    V_pu = s.V_rms / c.V_rated_rms
    carried = c.S_rated * V_pu * V_pu * c.Z_base / np.hypot(s.R, s.X)
    limit_pu = np.inf if c.current_limit_pu is None else c.current_limit_pu
    with np.errstate(invalid="ignore"):
        current = rated_current_rms(s.P - 1j * s.Q, s.V_rms)
        shunt = 1j * s.omega_g * f.C / (1.0 + 1j * s.omega_g * f.C * f.R_c)
        bridge = s.V_rms + (f.R_1 + 1j * s.omega_g * f.L_1) * (current + shunt * s.V_rms)
        return {
            "power transfer": POWER_MARGIN * apparent / carried,
            "least voltage": low / s.V_rms,
            "largest voltage": s.V_rms / high,
            "current": apparent / (limit_pu * c.S_rated * V_pu),
            "bridge voltage": rms_to_peak(np.abs(bridge)) / (_BRIDGE_SHARE * c.v_max_pk),
        }


def _signs(error: float) -> tuple[float, ...]:
    return (-1.0, 1.0) if error > 0.0 else (0.0,)


def _with_middle(limits: tuple[float, ...]) -> tuple[float, ...]:
    """The limits, and zero where it lies strictly between them."""
    return tuple(sorted({*limits, 0.0})) if limits[0] < 0.0 < limits[-1] else limits
