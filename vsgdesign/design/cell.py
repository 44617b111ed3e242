"""One cell of a table: seeds, batched global search, IPOPT with cuts; then what it keeps, and at what price."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.box import Scenarios, joined
from vsgdesign.design.evaluation import Evaluation, Figures, LawOfStudy, exact_worst, shortfalls
from vsgdesign.design.nlp import KINDS, SLOTS, RobustProgram, robust_program
from vsgdesign.design.search import Ground, candidates, evolved, hardest, log_stiffness, variables
from vsgdesign.equations.placing import LEAST_BANDWIDTH
from vsgdesign.equations.power_loops import MOST_FED_BACK
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.execution.executors import Each
from vsgdesign.study.parameters.specification import Specification

Array = NDArray[np.float64]

_FAR = 2.0
"""A design further from the centre, in units of the objective, is not taken without a descent from there."""

_WEAK_PULL = 0.03
"""How much nearness to the centre counts where a promise is not kept otherwise."""
_ROUNDS = 4

_SEARCHED_IN_COMMON = 6
_PACES = np.geomspace(0.8, 5.0, 8)
_ZETAS = (0.7, 0.8, 0.9, 1.0, 1.15, 1.3)
_RATIOS = (0.7, 0.85, 1.0, 1.2, 1.4, 1.7)
_START_Q = 0.02
"""Common designs: k_1T² over that of LEAST_BANDWIDTH, d_1/(2√k_1), k_2/√k_1, and q where it is free."""
_CAP = 3.0


@dataclass(frozen=True, kw_only=True)
class CellDesign:
    """The design of one grid. ``shortfalls`` are the requirements that it violates, with the values that it reaches."""

    normalised: NormalisedGains
    figures: Figures
    inertia: float
    """H in s at the design point."""
    active: str
    """The requirement that costs most; empty if none costs anything."""
    price: float
    """Inertia in per cent that 1 % of this requirement costs; with the aim ``inertia``, damping and bandwidth."""
    shortfalls: dict[str, float]
    scenarios: int
    iterations: int

    @property
    def met(self) -> bool:
        """Whether every requirement is kept."""
        return not self.shortfalls


TRANSFER = "transfer"
"""Active constraint of a design whose damping is limited by 1 − k_P D_p (:eq:`droop-fed-back`)."""

_FED_BACK_SHARE = 0.97
"""Share of the largest k_P D_p of a table that its nodes use: the rest is for what lies between them."""

_FED_BACK_ROOM = 1e-3
"""How far below the largest damping a limit aims, relatively: a search by secants would end above it for ever."""

_FED_BACK_ROUNDS = 12
_FIRST_STEPS, _MOST_STEPS = 2.0, 5.0
"""How far a limit of the damping goes, over the excess that it is to take away."""


def design_cell(
    law: LawOfStudy,
    spec: Specification,
    s: Scenarios,
    centre: Array,
    seed: int = 0,
    ceiling: Array | None = None,
    pull: float = 1.0,
    measured: Scenarios | None = None,
) -> CellDesign:
    """The robust design of one grid over its scenarios (at least one), near ``centre`` (k,) if the requirements allow
    it.

    It minimises :eq:`cell-objective`. ``ceiling`` (k,) are upper bounds of y below those of the specification. ``pull``
    multiplies the weight of the distance from the centre. Equal calls with an equal ``seed`` give equal digits. If
    k_P D_p would be too large for a change of gains (:eq:`droop-fed-back`), in a scenario or in one of ``measured``,
    the grid is designed again with less damping, and the active constraint is ``TRANSFER``.
    """
    found = _designed(law, spec, s, centre, seed, ceiling, pull)
    v = variables(law.structure, spec)
    damping = v.names.index("d_1_or_zeta")
    bound = v.high if ceiling is None else np.minimum(v.high, ceiling)
    before: tuple[float, float] | None = None
    for _ in range(_FED_BACK_ROUNDS):
        most = most_damping(law, found.normalised, s if measured is None else joined([s, measured]))
        if found.normalised.d_1_or_zeta <= most:
            break
        at = float(np.log(found.normalised.d_1_or_zeta))
        excess = at - float(np.log(most))
        # A design with less damping also takes less bandwidth, and then may have still less damping: two steps at once
        # first, then as many as the last two designs tell.
        steps = _FIRST_STEPS if before is None else (before[1] - at) / max(before[0] - excess, 1e-12)
        before = excess, at
        bound = bound.copy()
        lower = (
            at - float(np.clip(steps, 1.0, _MOST_STEPS)) * (excess + _FED_BACK_ROOM) - float(np.log(v.scale[damping]))
        )
        bound[damping] = max(lower, v.low[damping])
        found = _designed(law, spec, s, centre, seed, bound, pull, v.of(found.normalised))
        if found.met and v.of(found.normalised)[damping] > bound[damping] - 1e-3:
            found = replace(found, active=TRANSFER, price=0.0)
    return found


def most_damping(law: LawOfStudy, normalised: NormalisedGains, s: Scenarios) -> float:
    """The largest d_1 (or ζ) with which k_P D_p stays so small in all scenarios that gains may be changed.

    k_P is affine in it, so that two values are enough. The result is infinite if k_P does not increase with it.
    """
    d_1 = normalised.d_1_or_zeta
    less, own = (
        law.gains(NormalisedGains(*map(np.asarray, normalised._replace(d_1_or_zeta=d))), s) for d in (0.5 * d_1, d_1)
    )
    slope = (own.k_P * own.D_p - less.k_P * less.D_p) / (0.5 * d_1)
    room = _FED_BACK_SHARE * MOST_FED_BACK - (own.k_P * own.D_p - slope * d_1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.min(np.where(slope > 0.0, room / slope, np.inf)))


def _designed(
    law: LawOfStudy,
    spec: Specification,
    s: Scenarios,
    centre: Array,
    seed: int,
    ceiling: Array | None,
    pull: float,
    begin: Array | None = None,
) -> CellDesign:
    """:func:`design_cell` whatever k_P D_p is. ``begin`` (k,): a design for a higher ceiling, from which descents begin
    in place of a search."""
    program = robust_program(law, spec)
    high = program.variables.high if ceiling is None else np.minimum(program.variables.high, ceiling)
    centre = np.minimum(centre, high)
    ground = Ground(
        law=law,
        spec=spec,
        variables=program.variables,
        scenarios=s,
        log_stiffness=log_stiffness(law, s),
        centre=centre,
        pull=pull,
    )
    rng = np.random.default_rng(seed)
    samples, scores = candidates(ground, high, rng) if begin is None else (np.minimum([centre, begin], high), None)
    start = samples[1 if scores is None else int(np.argmin(scores))]
    iterations, tried = 0, [samples[0], start]
    prices: list[dict[str, float]] = [dict.fromkeys(KINDS, 0.0)] * 2
    descents = [(start, 1.0), (samples[0], 1.0), (start, _WEAK_PULL), (None, _WEAK_PULL)]
    for start, share in descents if scores is not None else descents[::2]:
        if start is None:
            weak = replace(ground, pull=_WEAK_PULL * pull)
            start = evolved(weak, samples, tried[-1], high, rng)
            tried.append(start)
            prices.append(dict.fromkeys(KINDS, 0.0))
        solved = _solve_with_cuts(program, ground, start, pull * share, high)
        iterations += sum(n for _, _, n in solved)
        tried += [point for point, _, _ in solved]
        prices += [price for _, price, _ in solved]
        # Another start is for what this one could not do, or did far from the centre.
        if solved and ground.is_met(solved[-1][0]) and (share < 1.0 or ground.distance(solved[-1][0]) <= _FAR):
            break
    stacked = np.array(tried)
    e = ground.evaluate(stacked)
    chosen = int(np.argmin(ground.scores(stacked, e)))
    normalised = NormalisedGains(*(float(value) for value in program.variables.normalised(stacked[chosen])))
    inertia = float(ground.inertia(normalised))
    gains = law.gains(NormalisedGains(*map(np.asarray, normalised)), s)
    figures = exact_worst(e, chosen, gains, s, law.lags)
    missed = shortfalls(spec, figures, inertia)
    active = next(iter(missed), "") or max(prices[chosen], key=lambda kind: prices[chosen][kind])
    price = 100.0 * prices[chosen].get(active, 0.0)
    if not missed and price < 1e-3:
        active, price = "", 0.0
    return CellDesign(
        normalised=normalised,
        figures=figures,
        inertia=inertia,
        active=active,
        price=price,
        shortfalls=missed,
        scenarios=len(s),
        iterations=iterations,
    )


def _solve_with_cuts(
    program: RobustProgram, ground: Ground, start: Array, pull: float, high: Array
) -> list[tuple[Array, dict[str, float], int]]:
    """Solutions of growing sets of scenarios: the worst of the last design join until they are all there."""
    y, active, solution = start, [], None
    solutions: list[tuple[Array, dict[str, float], int]] = []
    for _ in range(_ROUNDS):
        worst_ones = _worst_scenarios(ground.evaluate(y[None]))
        new = [k for k in worst_ones if k not in active]
        if not new:
            break
        active = (new + active)[:SLOTS]
        slots = ground.scenarios.take(np.array(active))
        solution = program.solve(y, ground.centre, slots, ground.bounded_stiffness(y), pull, high, solution)
        if solution is None:
            break
        y = solution.y
        solutions.append((y, solution.prices, solution.iterations))
    return solutions


def _worst_scenarios(e: Evaluation) -> list[int]:
    """The worst scenario of every figure of one design, in order."""
    names = ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q")
    index = [int(np.argmax(e[name][0])) for name in names]
    index += [int(np.argmin(e["disk_margin"][0])), int(np.argmin(e.damping_ratio[0]))]
    if e.differential is not None:
        index.append(int(np.argmax(e.differential[0])))
    return list(dict.fromkeys(index))


def common_design(law: LawOfStudy, spec: Specification, boxes: Sequence[Scenarios], each: Each = map) -> Array:
    """y (k,) of the one normalised design that is best for all cells together. The search of every cell begins there.

    Cells that differ from it only where it is useful interpolate well. The violation of a cell is limited, so that a
    cell for which no design is good does not decide. ``each`` applies a function to the cells.
    """
    v = variables(law.structure, spec)
    T = spec.settling_time
    share = STRUCTURES[law.structure].start_share
    rows = []
    for pace, zeta, ratio in itertools.product(_PACES, _ZETAS, _RATIOS):
        root = np.sqrt(LEAST_BANDWIDTH.k_1 * pace)
        poles = LEAST_BANDWIDTH.k_1 * pace / T**2, 2.0 * zeta * root / T
        first = poles if law.law == "poles" else (float(spec.H or 0.0), zeta)
        rows.append(v.of(NormalisedGains(*first, ratio * root / T, _START_Q, share, share)))
    y = np.unique(np.array(rows), axis=0)
    total = np.zeros(len(y))
    for lack in each(partial(_lacks, law, spec, y), boxes):
        total += lack
    return y[int(np.argmin(total))]


def _lacks(law: LawOfStudy, spec: Specification, y: Array, s: Scenarios) -> Array:
    """What each design lacks in one cell, against the best of them."""
    ground = Ground(
        law=law,
        spec=spec,
        variables=variables(law.structure, spec),
        scenarios=s,
        log_stiffness=log_stiffness(law, s),
        centre=y[0],
    )
    few = hardest(ground, y[:: max(len(y) // 4, 1)], _SEARCHED_IN_COMMON)
    scores = ground.scores(y, ground.evaluate(y, few))
    return np.minimum(scores - scores.min(), _CAP) if np.isfinite(scores).all() else np.zeros(len(y))
