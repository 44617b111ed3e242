"""The scenarios of one cell: every combination of power, estimate error, grid frequency and voltage to survive."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.error_bounds import truth_behind
from vsgdesign.design.table_edge import table_edge
from vsgdesign.equations.grid import SCR_BASES, error_half_widths
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.linear.operating_point.equilibrium import static_limit_uses
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.specification import Specification
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

Reach = tuple[float, float, float, float]
Signs = tuple[float, float]
"""1 where the estimate of R, of X is too large by the half-width of the error set, −1 where it is too small."""

_BISECTIONS = 24
_ROUNDING = 1e-9
"""A grid that is this little outside the table, relatively, is on its edge."""

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
    return scenarios_of_truths(study, spec, [(scr, x_over_r)], P, Q)[0]


def scenarios_of_truths(
    study: Study, spec: Specification, grids: Sequence[tuple[float, float]], P: float, Q: float
) -> list[Scenarios]:
    """:func:`scenarios_of_truth` of many grids (SCR, X/R) at once, in a small part of the time."""
    truths = [Place(float(scr), float(x_over_r), spec.scr_basis).grid(study.converter) for scr, x_over_r in grids]
    return _scenarios(study, spec, [_around_truth(study, truth, spec) for truth in truths], P, Q)


def scenarios_of_estimate(
    study: Study, spec: Specification, scr: float, x_over_r: float, P: float, Q: float
) -> Scenarios:
    """All scenarios in which a schedule looks up this grid: the true ones that may lie behind the estimate.

    Beyond the table's edge nothing is promised: errors that would put the truth there are drawn in until it lies on
    the edge. A node on the edge has the estimates beyond it too that are looked up there.
    """
    return _scenarios(study, spec, [_behind_node(study, spec, scr, x_over_r)], P, Q)[0]


def scenarios_around_estimate(
    study: Study, spec: Specification, scr: float, x_over_r: float, reach: Reach, P: float, Q: float
) -> Scenarios:
    """The same, then those of lookups up to half way to the neighbouring nodes, where this node has most say.

    ``reach``: the least and largest SCR and X/R of those lookups. The worst grids need not be nodes: where two static
    limits meet, what is asked of a grid has a sharp maximum.
    """
    own = _behind_node(study, spec, scr, x_over_r)
    places = list(itertools.product(_steps(reach[0], scr, reach[1]), _steps(reach[2], x_over_r, reach[3])))
    return _scenarios(study, spec, [list(dict.fromkeys([*own, *_behind_lookups(study, spec, places)]))], P, Q)[0]


def scenarios_on_edge(study: Study, spec: Specification, scr: float, x_over_r: float, P: float, Q: float) -> Scenarios:
    """Scenarios of the other corners of the set of true grids that may be looked up here (:eq:`edge-truths`).

    They are on the table's edge, and only places within an error of it have any. The first is the design point.
    """
    omega_n = study.converter.omega_n
    place = Place(scr, x_over_r, spec.scr_basis).grid(study.converter)
    signs = _signs_of(spec)
    points = []
    if any(spec.box.errors):
        drawn = np.array([(g.R_g, omega_n * g.L_g) for g in _drawn_in(study, spec, [place] * len(signs), signs)]).T
        at = np.array([place.R_g]), np.array([omega_n * place.L_g])
        points = table_edge(study, spec).truths_seen_at(*at, *drawn[:, None])[0]
    pairs = [(place, place), *((Grid(R, X / omega_n), place) for R, X in points)]
    found = _scenarios(study, spec, [pairs], P, Q)[0]
    return found if points else found.take(np.arange(0))


def _behind_node(study: Study, spec: Specification, scr: float, x_over_r: float) -> list[tuple[Grid, Grid]]:
    grid = Place(scr, x_over_r, spec.scr_basis).grid(study.converter)
    return list(dict.fromkeys([(grid, grid), *_behind_lookups(study, spec, [(scr, x_over_r)])]))


def _behind_lookups(
    study: Study, spec: Specification, places: Sequence[tuple[float, float]]
) -> list[tuple[Grid, Grid]]:
    """(truth, estimate) of places in the table (SCR, X/R), one after another: for every sign of the errors with the
    truth within the table, then estimates beyond its edge that are looked up there."""
    grids = [Place(*place, spec.scr_basis).grid(study.converter) for place in places]
    signs = _signs_of(spec)
    truths = iter(_drawn_in(study, spec, *zip(*itertools.product(grids, signs), strict=True)))
    pairs = []
    for place, grid in zip(places, grids, strict=True):
        pairs += [(next(truths), grid) for _ in signs]
        pairs += _beyond_edge(study, spec, *place)
    return pairs


def _beyond_edge(study: Study, spec: Specification, scr: float, x_over_r: float) -> list[tuple[Grid, Grid]]:
    """(truth, estimate) of estimates beyond the table's edge that are looked up at this place."""
    c, basis = study.converter, spec.scr_basis
    place = Place(scr, x_over_r, basis).grid(c)
    pairs = []
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
    if spec.box.error_Z:
        omega_n = study.converter.omega_n
        crossings = table_edge(study, spec).seen_beside_corners(grid.R_g, omega_n * grid.L_g)
        estimates += [_within_table(study, spec, Grid(R, X / omega_n)) for R, X in crossings]
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


def _drawn_in(study: Study, spec: Specification, estimates: Sequence[Grid], signs: Sequence[Signs]) -> list[Grid]:
    """The truth behind each estimate with the errors of its signs, or with as much of them as leaves it within the
    table."""
    c, basis = study.converter, SCR_BASES[spec.scr_basis]
    R_hat, L_hat = np.array([(grid.R_g, grid.L_g) for grid in estimates]).T
    sign_R, sign_X = np.array(signs).T

    def truths(share: Array) -> tuple[Array, Array]:
        errors = [share * error for error in spec.box.errors]
        if not spec.box.error_Z:
            return R_hat / (1.0 + sign_R * errors[0]), L_hat / (1.0 + sign_X * errors[1])
        R, X = truth_behind(R_hat, c.omega_n * L_hat, sign_R, sign_X, *errors)
        return R, X / c.omega_n

    def within(share: Array) -> NDArray[np.bool_]:
        R, L = truths(share)
        with np.errstate(divide="ignore"):
            return _in_table(spec, basis.scr(R, L, c.Z_base, c.omega_n), c.omega_n * L / R)

    low, high = np.zeros(len(R_hat)), np.ones(len(R_hat))
    whole = within(high)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        inside = within(middle)
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return [Grid(float(R), float(L)) for R, L in zip(*truths(np.where(whole, 1.0, low)), strict=True)]


def _in_table(spec: Specification, scr: Any, x_over_r: Any) -> Any:
    """Whether places are within the table, to rounding."""
    axes = ((spec.scr, scr), (spec.x_over_r, x_over_r))
    parts = [(axis[0] * (1.0 - _ROUNDING) <= at) & (at <= axis[-1] * (1.0 + _ROUNDING)) for axis, at in axes]
    return parts[0] & parts[1]


def _is_within(study: Study, spec: Specification, grid: Grid) -> bool:
    """Whether a grid is within the table."""
    place = grid.place(study.converter, spec.scr_basis)
    return bool(_in_table(spec, place.scr, place.x_over_r))


def _within_table(study: Study, spec: Specification, grid: Grid) -> Grid:
    """Where a schedule looks a grid up."""
    place = grid.place(study.converter, spec.scr_basis)
    scr = min(max(place.scr, spec.scr[0]), spec.scr[-1])
    ratio = min(max(place.x_over_r, spec.x_over_r[0]), spec.x_over_r[-1])
    return Place(scr, ratio, spec.scr_basis).grid(study.converter)


def _scenarios(
    study: Study, spec: Specification, sets: Sequence[Sequence[tuple[Grid, Grid]]], P: float, Q: float
) -> list[Scenarios]:
    """Of each set: every (truth, estimate) with every power, frequency and voltage; the design point with the first
    first. All sets are cut by the limits together: the arithmetic of each scenario is its own."""
    f, omega_n = study.filter, study.converter.omega_n
    sizes = [len(pairs) for pairs in sets]
    rows = {size: _combinations(study, spec, size, P, Q) for size in set(sizes)}
    which, powers_P, powers_Q, omega_g, V_g = np.concatenate([rows[size] for size in sizes]).T
    counts = [len(rows[size]) for size in sizes]
    place = which.astype(int) + np.repeat(np.cumsum([0, *sizes[:-1]]), counts)
    truth, estimate = (
        np.array([(pair[side].R_g, pair[side].L_g) for pairs in sets for pair in pairs])[place].T for side in (0, 1)
    )
    R, X = f.R_2 + truth[0], omega_g * (f.L_2 + truth[1])
    R_hat, X_hat = f.R_2 + estimate[0], omega_n * (f.L_2 + estimate[1])
    nowhere = np.full_like(R, np.nan)
    wanted = Scenarios(R, X, R_hat, X_hat, V_g, omega_g, powers_P, powers_Q, nowhere, nowhere)
    share = np.ones(len(R))
    cut = np.flatnonzero(~within_limits(study, _with_share(wanted, share)))
    share[cut] = _largest_share(study, wanted.take(cut))
    found = _with_share(wanted, share)
    inside = within_limits(study, found)
    ends = np.cumsum(counts)
    return [
        found.take(start + np.flatnonzero(inside[start:end]))
        for start, end in zip(ends - np.array(counts), ends, strict=True)
    ]


def _combinations(study: Study, spec: Specification, pairs: int, P: float, Q: float) -> Array:
    """Rows of the pair's number, P, Q, ω_g and V_g: the design point, then every combination of a set of so many
    pairs, the one without error alone only where there is no other."""
    box = spec.box
    powers = [(p, q) for p in _with_middle(box.P) for q in _with_middle(box.Q)]
    with_error = range(1 if pairs > 1 else 0, pairs)
    every = [(k, *pq, w, v) for k, pq, w, v in itertools.product(with_error, powers, box.omega_g, box.V_g_rms)]
    return np.array([(0, P, Q, study.grid_source.omega_g, study.grid_source.V_g_rms), *every])


def _with_share(s: Scenarios, share: Array) -> Scenarios:
    """Scenarios with a share of their powers, where they run then."""
    P, Q = share * s.P, share * s.Q
    with np.errstate(invalid="ignore"):
        V_rms, delta = operating_point(P, Q, s.V_g_rms, s.R, s.X)
    return replace(s, P=P, Q=Q, V_rms=V_rms, delta=delta)


def _largest_share(study: Study, s: Scenarios) -> Array:
    """The largest share of each scenario's powers that is within the limits; zero where none is."""
    low, high = np.zeros(len(s)), np.ones(len(s))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        inside = within_limits(study, _with_share(s, middle))
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return low


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
    return static_limit_uses(study, s.R, s.X, s.omega_g, s.P, s.Q, s.V_rms)


def _signs(error: float) -> tuple[float, ...]:
    return (-1.0, 1.0) if error > 0.0 else (0.0,)


def _with_middle(limits: tuple[float, ...]) -> tuple[float, ...]:
    """The limits, and zero where it lies strictly between them."""
    return tuple(sorted({*limits, 0.0})) if limits[0] < 0.0 < limits[-1] else limits
