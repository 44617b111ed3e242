"""The sizes of steps on boxes: that no limit acts is proved at every point of a region, not only at cells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.box_check import COORDINATES, FOLLOWED, survey
from vsgdesign.certificate.boxes import UNIT, Boxes, first_extra, parameters_of, whole_region
from vsgdesign.certificate.enclosure import PIECES, Estimate, Loops
from vsgdesign.certificate.error_bounds import EXTRA, error_bounds, error_segments
from vsgdesign.certificate.proof import CHUNK, arrays, to_cut
from vsgdesign.certificate.region import Cells, Region, System
from vsgdesign.certificate.step_terms import (
    STEPS,
    ActingLimits,
    Cell,
    LevelShape,
    rest_current_pu,
    step_sizes,
    step_terms,
)
from vsgdesign.certificate.taylor_kernel import SEEN, rows
from vsgdesign.certificate.tracing import Program, Symbol, Tracer, program_of
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import POWER_MARGIN, operating_point_discriminant
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.execution.signals import interrupts_deferred
from vsgdesign.runtime.table import TableSchedule

Array = NDArray[np.float64]

_SHARES = (0.95, 0.9, 0.8, 0.65)
"""Shares of the least sizes at points that are tried one after another."""

_PLACES = 4000
"""Places in undecided boxes at which the sizes are computed after every round of cuts."""

_ROUNDING = 1e-12
"""Of the size of the terms of a sum: more than the sum of two enclosed quantities is off by."""


@dataclass(frozen=True)
class StepProof:
    """Sizes (5,) of steps that are proved on ``boxes`` boxes; ``whole``: on all of the region. ``sampled`` (5,): the
    least sizes at all points that were looked at, ``current_pu`` the largest current at rest there."""

    sizes: Array
    sampled: Array
    current_pu: float
    boxes: int
    whole: bool


@dataclass(frozen=True)
class _Programs:
    """For each piece of the schedule, the terms and what a point of the region lies between."""

    programs: tuple[Program, ...]
    conditions: tuple[Array, ...]
    margins: _Margins


@dataclass(frozen=True)
class _Level:
    """Boxes of true grids, powers and errors, and on which pieces of the schedule each may hold a point."""

    boxes: Boxes
    alive: NDArray[np.bool_]
    """(N, pieces)."""

    def halves(self, index: NDArray[np.bool_], dimension: NDArray[np.intp]) -> _Level:
        return _Level(self.boxes.take(index).halves(dimension[index]), np.tile(self.alive[index], (2, 1)))


def prove_steps(
    system: System,
    region: Region,
    shape: LevelShape,
    limits: ActingLimits,
    sampled: Array,
    current_pu: float,
    budget: int,
    seed: int = 0,
) -> StepProof:
    """Proves :eq:`step-conditions` at every point of a region, for steps a little smaller than the least size of each
    kind that any point allows.

    ``sampled`` (5,): the least sizes that are known; places in undecided boxes show where less is allowed.
    ``current_pu``: the largest resting current that is known. Boxes are cut in half where the bound is too coarse; when
    a part of ``budget`` is used, what is left is tried with smaller sizes.
    """
    rng = np.random.default_rng(seed)
    boxes, cells, kinds = _true_boxes(system, region, whole_region(system, region))
    level, seen = _Level(boxes, np.ones((len(boxes), len(PIECES)), dtype=np.bool_)), 0
    ready = _programs(system, region, shape, limits, max(current_pu, 1e-3))
    share = _SHARES[0]
    for turn, share in enumerate(_SHARES):
        part = budget * (turn + 1) / len(_SHARES)
        while len(level.boxes) and seen + len(level.boxes) <= part:
            undecided, dimension = _looked_at(system, ready, level, cells, kinds, (share * sampled) ** 2)
            seen += len(level.boxes)
            level = level.halves(undecided, dimension)
            found = _cells_in(system, level.boxes, kinds, rng)
            sampled = np.minimum(sampled, step_sizes(system, found, shape, limits).min(axis=1, initial=np.inf))
            current_pu = max(current_pu, float(rest_current_pu(system, found).max(initial=0.0)))
            if not sampled.all():  # a limit acts at rest
                return StepProof(0.0 * sampled, 0.0 * sampled, current_pu, seen, False)
        if len(level.boxes) == 0:
            break
    return StepProof(share * sampled, sampled, current_pu, seen, len(level.boxes) == 0)


def _cells_in(system: System, boxes: Boxes, kinds: Array, rng: np.random.Generator) -> Cells:
    """The cells at some places in boxes."""
    count = _PLACES if len(boxes) else 0
    index = rng.integers(max(len(boxes), 1), size=count)
    share = rng.uniform(0.0, 1.0, (count, COORDINATES))
    share[::2] = np.round(share[::2])
    points = boxes.low[index] + share * (boxes.high[index] - boxes.low[index])
    for k, side in ((0, np.cos(points[:, 1])), (1, np.sin(points[:, 1]))) if len(kinds) else ():
        a, b = kinds[2 * k : 2 * k + 2, boxes.piece[index]]
        points[:, 4 + k] *= a + b / side
    points[:, 0] = SCR_BASES[system.study.scr_basis].counted(
        points[:, 0] * np.cos(points[:, 1]), points[:, 0] * np.sin(points[:, 1])
    )
    points[:, 2:4] *= system.study.converter.S_rated
    return system.cells(points, partial=True)


def _true_boxes(system: System, region: Region, cells: Boxes) -> tuple[Boxes, Boxes, Array]:
    """The region by |Z_g| (pu), the grid's angle, P and Q in V²/|Z_g|, and both errors: once for each cell of a table.

    Boxes of true grids, not of estimates as elsewhere: the errors then act through the gains alone. Also returns the
    cells by the pieces of these boxes; and, with ``error_Z``, what the coordinates of the errors stand for, (4, pieces)
    of :func:`~vsgdesign.certificate.error_bounds.error_segments`, else (0, pieces).
    """
    e, c = region.largest_error, system.study.converter
    sines = np.sin(np.arctan(region.x_over_r))
    size = np.array([1.0 / region.scr[1], 1.0 / region.scr[0]])
    if not SCR_BASES[system.study.scr_basis].counts_resistance:
        size = size / sines[::-1]
    rows_ = [size, np.arctan(region.x_over_r), np.divide(region.P, c.S_rated), np.divide(region.Q, c.S_rated)]
    low, high = np.array([*rows_, [-e, e], [-e, e]]).T
    count = len(cells)
    if not region.error_Z:
        return Boxes(np.tile(low, (count, 1)), np.tile(high, (count, 1)), np.arange(count)), cells, np.zeros((0, count))
    if not isinstance(system.schedule, TableSchedule):  # pieces of angles alone, which say nothing here
        cells, count = cells.take([0]), 1
    from_, to, rows_ = error_segments(region)
    cells = cells.take(np.repeat(np.arange(count), len(from_)))
    low, high = np.tile(low, (len(cells), 1)), np.tile(high, (len(cells), 1))
    low[:, 1], high[:, 1] = np.tile(from_, count), np.tile(to, count)
    pieces = np.arange(len(cells))
    bounds = error_bounds(region, cells.low[:, 1], cells.high[:, 1])
    return Boxes(low, high, pieces), replace(cells, piece=pieces, errors=bounds), np.tile(rows_, count)


def _parameters(system: System, boxes: Boxes, cells: Boxes, kinds: Array) -> Array:
    """The parameters of a box's cell of the table, then the limits of that cell: first coordinate and R̂/X̂; then what
    the coordinates of the errors stand for."""
    own = parameters_of(system, boxes, cells)
    limits = [cells.low[:, 0], cells.high[:, 0], 1.0 / np.tan(cells.high[:, 1]), 1.0 / np.tan(cells.low[:, 1])]
    return np.concatenate([own, np.array(limits)[:, boxes.piece], kinds[:, boxes.piece]])


def _programs(system: System, region: Region, shape: LevelShape, limits: ActingLimits, typical_pu: float) -> _Programs:
    c = system.study.converter
    shunt = c.omega_n * system.study.filter.C * c.Z_base
    table = isinstance(system.schedule, TableSchedule)
    own = first_extra(system) + (EXTRA if region.error_Z else 0)
    programs, between = [], []
    for piece in PIECES:
        tracer = Tracer(COORDINATES)
        size, angle, P, Q, e_R, e_L = tracer.symbols()
        true_r, true_x = np.cos(angle), np.sin(angle)
        if region.error_Z:
            estimate = tuple(
                value * (1.0 + tracer.blend((own + 4 + 2 * k,), (c_k,))) + tracer.blend((own + 5 + 2 * k,), (c_k,))
                for k, (value, c_k) in enumerate(((true_r, e_R), (true_x, e_L)))
            )
            here = Estimate.about(system, size, (estimate[0], estimate[1]))
        else:
            here = Estimate.about(system, size, (true_r * (1.0 + e_R), true_x * (1.0 + e_L)))
        path = (true_r + here.fixed[0], (true_x + here.fixed[1]) * here.share)
        V, inverse_V, conditions = _at_rest(system, P, Q, size, *path)
        if not SCR_BASES[system.study.scr_basis].counts_resistance:
            conditions.append((size * true_x, 1.0 / region.scr[1], 1.0 / region.scr[0]))
        if table:
            one = tracer.constant(1.0)
            low_x, high_x, low_y, high_y = (tracer.blend((own + k,), (one,)) for k in range(4))
            conditions += [(value, -np.inf, 0.0) for value in (low_x - here.first, here.first - high_x)]
            conditions += [(value, -np.inf, 0.0) for value in (low_y - here.slope, here.slope - high_y)]
        rated = here.base * (inverse_V * inverse_V)
        J_hat, choices = here.scheduled(rated * P, rated * Q, piece)
        conditions += [(choice, -np.inf, 0.0) for choice in choices]
        loops = Loops.of(system, here.normalised(tracer), J_hat, inverse_V, here.base)
        gains = PowerLoopGains(*(loops.algebra.symbol(loops.algebra.value(gain)) for gain in loops.gains))
        limit = 1.0 if limits.current_pu is None else limits.current_pu
        terms = step_terms(Cell(P, Q, V, inverse_V, size, *path, gains), shunt, shape, limit, typical_pu)
        square = [V, V] if limits.V_low_pu is None else [limits.V_high_pu - V, V - limits.V_low_pu]
        outputs: list[Any] = [V, *(room * room for room in square), *terms.weights]
        if limits.current_pu is not None:
            outputs += [terms.current_margin * terms.current_margin]
            outputs += [weight * terms.reach_sq for weight in terms.weights]
        programs.append(program_of(tracer, [*outputs, *(value for value, _, _ in conditions)]))
        between.append(np.array([[least, most] for _, least, most in conditions]))
    margins = _Margins(limits, shape, (c.V_min_pu, c.V_max_pu), shunt)
    return _Programs(tuple(programs), tuple(between), margins)


def _at_rest(
    system: System, P: Symbol, Q: Symbol, size: Symbol, r: Any, x: Any
) -> tuple[Symbol, Symbol, list[tuple[Any, float, float]]]:
    """V and 1/V per unit of the operating point of P and Q (pu), and the static limits as quantities with limits."""
    c = system.study.converter
    V_g = system.study.grid_source.V_g_rms / c.V_rated_rms
    # Per unit powers of the source's voltage, in units of the impedance.
    own = size * (PHASES / V_g**2)
    b_0, discriminant = operating_point_discriminant(own * P, own * Q, 1.0, r, x)
    # The discriminant is (V²(1 − y²))² with y = |Z||S|/3V², which is at most 1/1.3 within the static limits.
    least = ((c.V_min_pu / V_g) ** 2 * (1.0 - POWER_MARGIN**-2)) ** 2
    V_sq = 0.5 * (b_0 + discriminant.sqrt(least))  # in units of V_g²
    V = V_sq.sqrt((c.V_min_pu / V_g) ** 2) * V_g
    reach = (r * r + x * x) * (P * P + Q * Q) * (size * size)
    conditions: list[tuple[Any, float, float]] = [
        (discriminant, least, np.inf),
        (V_sq, (c.V_min_pu / V_g) ** 2, (c.V_max_pu / V_g) ** 2),
        (reach * POWER_MARGIN**2 - V_sq * V_sq * V_g**4, -np.inf, 0.0),
    ]
    V_sq = V_sq * V_g**2
    conditions += [(one, -np.inf, 0.0) for one in system.beyond_converter(P, Q, V_sq, V_sq)]
    return V, V.reciprocal(), conditions


def _looked_at(
    system: System, ready: _Programs, level: _Level, cells: Boxes, kinds: Array, squares: Array
) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """For each box whether the conditions are undecided, and the coordinate to cut. A piece of the schedule on which
    they are decided is not ``alive`` any more."""
    low, high = level.boxes.low, level.boxes.high
    score = np.zeros((len(low), FOLLOWED + 1))
    parameters = _parameters(system, level.boxes, cells, kinds)
    signs = np.zeros((0, 0), dtype=np.int64)
    for case, (program, conditions) in enumerate(zip(ready.programs, ready.conditions, strict=True)):
        some = np.flatnonzero(level.alive[:, case])
        for part in np.array_split(some, len(some) // CHUNK + 1) if len(some) else ():
            carried = len(program.outputs) - len(conditions)
            forms = np.zeros((len(part), carried, rows(FOLLOWED + 1)))
            empty, applies = np.zeros(len(part), dtype=np.bool_), np.zeros((0, len(part)), dtype=np.bool_)
            own = np.ascontiguousarray(parameters[:, part])
            with interrupts_deferred():
                survey(low[part], high[part], own, arrays(program), conditions, signs, empty, applies, forms)
            above, pull = _open(forms, low[part], high[part], ready.margins, squares)
            above &= ~empty
            level.alive[part, case] = above
            score[part[above]] = np.maximum(score[part[above]], pull[above])
    return np.asarray(level.alive.any(axis=1)), to_cut(low, high, score)


def _open(forms: Array, low: Array, high: Array, margins: _Margins, squares: Array) -> tuple[NDArray[np.bool_], Array]:
    """Whether a condition may be violated on each box, and what each dimension leaves unknown of the worst one.

    Every condition has two ways to hold: by the difference of its sides as one form, which follows what they have in
    common, or by bounds of the sides with V between the static limits, which boxes across these limits need.
    """
    V, terms = _Forms(forms[:, :1]), forms[:, 3:]
    count, acting, at = len(STEPS), margins.acting, np.arange(len(forms))
    V_floor, V_top = V.low(), V.high()
    V_low, V_high = np.maximum(V_floor, margins.V_limits[0]), np.minimum(V_top, margins.V_limits[1])
    checks: list[tuple[Array, Array, Array]] = []
    if acting.V_low_pu is not None and acting.V_high_pu is not None:
        room = (acting.V_high_pu - V_high, V_low - acting.V_low_pu)
        checks += [(margins.shape.V_reach * terms[:, :count], forms[:, 1 + k], room[k]) for k in range(2)]
    if acting.current_pu is not None:
        room = low[:, :1] * margins.current_room(low, high, V_low, V_high)
        checks.append((terms[:, count + 1 :], terms[:, count], room))
    open_, pull, worst = np.zeros(len(forms), dtype=np.bool_), np.zeros((len(forms), _D)), np.zeros(len(forms))
    for sizes, square, room in checks:
        side, other = _Forms(squares[None, :, None] * sizes), _Forms(square[:, None])
        scale = np.abs(side.form[..., 0]) + np.abs(other.form[..., 0]) + 1e-300
        difference = side.less(other)
        shortfall = np.minimum(difference.high(scale), side.high() - room**2)
        # The square says nothing where its root may be negative.
        shortfall = np.where(room > 0.0, shortfall, np.maximum(shortfall, 0.0))
        share = np.where(np.isfinite(shortfall), shortfall / scale, np.inf)
        k = np.argmax(share, axis=1)
        most = share[at, k]
        open_ |= ~(most < 0.0)
        taken = ~(most < 0.0) & (most >= worst)
        chosen = _Forms(difference.form[at[taken], k[taken]], difference.rest[at[taken], k[taken]])
        pull[taken], worst[taken] = chosen.spread() / scale[at[taken], k[taken]][:, None], most[taken]
    # A box that is not within the static limits may be empty: then it is cut where V is least known.
    beyond = (V_floor[:, 0] < margins.V_limits[0]) | (V_top[:, 0] > margins.V_limits[1])
    widths = (high - low) / UNIT
    widths = np.column_stack([widths[:, :FOLLOWED], widths[:, FOLLOWED:].max(axis=1)])
    shares = _shares(pull, widths)
    return open_, shares + np.where(beyond[:, None], _shares(V.spread()[:, 0], widths), 0.0)


def _shares(pull: Array, instead: Array) -> Array:
    """Each row over its sum; where that is not finite, the row of ``instead``."""
    known = np.isfinite(pull).all(axis=1, keepdims=True) & (pull.sum(axis=1, keepdims=True) > 0.0)
    pull = np.where(known, pull, instead)
    return pull / np.maximum(pull.sum(axis=1, keepdims=True), 1e-300)


@dataclass(frozen=True)
class _Margins:
    """What the conditions are compared with."""

    acting: ActingLimits
    shape: LevelShape
    V_limits: tuple[float, float]
    """Static limits, pu."""
    shunt: float
    """ωC, pu."""

    def current_room(self, low: Array, high: Array, V_low: Array, V_high: Array) -> Array:
        """The limit less the largest resting current of boxes, (N, 1): |i|² is convex in P, in Q and in V."""
        largest = np.zeros_like(V_low)
        for P in (low[:, 2:3], high[:, 2:3]):
            for Q in (low[:, 3:4], high[:, 3:4]):
                for V in (V_low, np.maximum(V_high, V_low)):
                    largest = np.maximum(largest, np.hypot(P / V, Q / V - self.shunt * V))
        return (self.acting.current_pu or 0.0) - largest * (1.0 + _ROUNDING)


_D = FOLLOWED + 1
_LAST = 1 + _D + _D * (_D + 1) // 2
_ROWS, _COLUMNS = np.triu_indices(_D)
_SQUARES = 1 + _D + np.flatnonzero(_ROWS == _COLUMNS)
_TO_DIMENSIONS = np.concatenate(
    [SEEN * np.eye(_D), 0.5 * ((_ROWS[:, None] == np.arange(_D)) + 1.0 * (_COLUMNS[:, None] == np.arange(_D)))]
)
"""How much each linear and square term counts for each dimension, (terms, 5)."""


class _Forms:
    """Taylor forms (..., rows(5)) as :func:`~vsgdesign.certificate.box_check.survey` leaves them, with bounds."""

    def __init__(self, form: Array, rest: Array | None = None) -> None:
        self.form = form[..., :_LAST]
        self.rest = form[..., _LAST : _LAST + _D] if rest is None else rest

    def less(self, other: _Forms) -> _Forms:
        """This less another; the rests are bounds, and add."""
        return _Forms(self.form - other.form, self.rest + other.rest)

    @property
    def _around(self) -> Array:
        # With what all sums here can be off by.
        return np.abs(self.form[..., 1:]).sum(axis=-1) + self.rest.sum(axis=-1)

    def high(self, scale: Any = 0.0) -> Array:
        """Upper bounds. ``scale``: size of what the forms were computed from, for its rounding."""
        # Of a square, one sign only: t² lies between 0 and 1.
        unsaid = np.maximum(-self.form[..., _SQUARES], 0.0).sum(axis=-1)
        return (
            self.form[..., 0] + self._around * (1.0 + _ROUNDING) - unsaid + _ROUNDING * (scale + abs(self.form[..., 0]))
        )

    def low(self) -> Array:
        """Lower bounds."""
        unsaid = np.maximum(self.form[..., _SQUARES], 0.0).sum(axis=-1)
        return self.form[..., 0] - self._around * (1.0 + _ROUNDING) + unsaid - _ROUNDING * abs(self.form[..., 0])

    def spread(self) -> Array:
        """What each dimension leaves unknown, (..., 5)."""
        with np.errstate(invalid="ignore"):  # an unbounded form
            return np.abs(self.form[..., 1:]) @ _TO_DIMENSIONS + self.rest
