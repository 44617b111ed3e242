"""One cell of a table: seeds, batched global search, IPOPT with cuts; then what it keeps, and at what price."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.box import NOMINAL, Scenarios
from vsgdesign.design.evaluation import Evaluation, LawOfStudy, evaluate
from vsgdesign.design.nlp import KINDS, MARGIN_AIM, SLOTS, RobustProgram, robust_program
from vsgdesign.design.variables import Variables, variables
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.parameters.specification import Specification

Array = NDArray[np.float64]

SAMPLES = 96
"""Designs that the global search looks at."""

_STARTS = 2
_WEAK_PULL = 0.03
"""How much nearness to the centre counts where a promise is not kept otherwise."""
_ROUNDS = 4
_SEARCHED = 17
"""Scenarios that the global search looks at: the hardest for the centre."""

_SEARCHED_IN_COMMON = 6
_PACES = np.geomspace(0.8, 5.0, 8)
_ZETAS = (0.7, 0.8, 0.9, 1.0, 1.15, 1.3)
_RATIOS = (0.7, 0.85, 1.0, 1.2, 1.4, 1.7)
"""Common designs: k_1T²/15.8, d_1/(2√k_1), k_2/√k_1."""
_CAP = 3.0

_GUARD_STEP, _GUARD_OVERSHOOT, _GUARD_MARGIN = 0.98, 0.8, 1.02
"""A design at a node keeps so much of the limits in hand, for what lies between nodes."""


@dataclass(frozen=True)
class Figures:
    """The worst of a design over a cell's scenarios; fractions, s, and 1/s."""

    overshoot_P: float
    settling_P: float
    overshoot_Q: float
    settling_Q: float
    cross_peak: float
    """Largest of the other power, per unit step."""
    disk_margin: float
    damping_ratio: float
    abscissa: float

    @property
    def overshoot(self) -> float:
        """Of either power after a step of its own reference."""
        return max(self.overshoot_P, self.overshoot_Q)

    @property
    def settling_time(self) -> float:
        """Of either power after a step of its own reference."""
        return max(self.settling_P, self.settling_Q)


@dataclass(frozen=True)
class CellDesign:
    """What the optimizer found for one grid. ``shortfalls``: promises not kept, with what would have to be allowed."""

    normalised: NormalisedGains
    figures: Figures
    inertia: float
    """H in s at the design point."""
    active: str
    """The promise that costs most; empty where none does."""
    price: float
    """Percent of inertia that 1 % more of it costs (of damping and bandwidth, for aim ``inertia``)."""
    shortfalls: dict[str, float]
    scenarios: int
    iterations: int

    @property
    def met(self) -> bool:
        """Whether every promise is kept."""
        return not self.shortfalls


def worst(e: Evaluation, design: int = 0) -> Figures:
    """The worst figures of one evaluated design."""
    at = {name: values[design] for name, values in e.figures.items()}
    steps = {name: float(at[name].max()) for name in ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q")}
    return Figures(
        **steps,
        cross_peak=float(np.maximum(at["cross_P"], at["cross_Q"]).max()),
        disk_margin=float(at["disk_margin"].min()),
        damping_ratio=float(e.damping_ratio[design].min()),
        abscissa=float(e.abscissa[design].max()),
    )


def shortfalls(spec: Specification, f: Figures, inertia: float) -> dict[str, float]:
    """Promises that figures do not keep, each with the value that would have to be allowed."""
    missed: dict[str, float] = {}
    if spec.settles and not f.overshoot <= spec.overshoot:
        missed["overshoot"] = f.overshoot
    if spec.settles and not f.settling_time <= spec.settling_time:
        missed["settling_time"] = f.settling_time
    if not f.disk_margin >= spec.disk_margin:
        missed["disk_margin"] = f.disk_margin
    if not f.damping_ratio >= spec.damping_ratio:
        missed["damping_ratio"] = f.damping_ratio
    if inertia < spec.H_min * (1.0 - 1e-9):
        missed["H_min"] = inertia
    if inertia > spec.H_max * (1.0 + 1e-9):
        missed["H_max"] = inertia
    return missed


def design_cell(
    law: LawOfStudy, spec: Specification, s: Scenarios, centre: Array, seed: int = 0, ceiling: Array | None = None
) -> CellDesign:
    """The robust design of one grid over its scenarios (at least one), near ``centre`` where the figures allow.

    ``ceiling``: upper bounds of y below those of the specification. Seeded: equal calls give equal digits.
    """
    program = robust_program(law, spec)
    high = program.variables.high if ceiling is None else np.minimum(program.variables.high, ceiling)
    centre = np.minimum(centre, high)
    log_stiffness = _log_stiffness(law, s)
    rng = np.random.default_rng(seed)
    y = np.minimum(_candidates(program.variables, centre, rng), high)
    few = _hardest(law, spec, program.variables, y[:1], s)
    scores = _scores(spec, program.variables, y, _evaluate(law, spec, program.variables, y, few), log_stiffness, centre)
    best = [y[k] for k in np.argsort(scores, kind="stable")[:_STARTS]]
    iterations, prices, candidates = 0, dict.fromkeys(KINDS, 0.0), [y[0], *best]
    found: list[tuple[Array, dict[str, float]]] = []
    for start, pull in ((best[0], 1.0), *((start, _WEAK_PULL) for start in best)):
        solved = _solve_with_cuts(program, law, spec, s, start, centre, log_stiffness, pull, high)
        iterations += sum(n for _, _, n in solved)
        found += [(point, price) for point, price, _ in solved]
        if solved and _is_met(law, spec, program.variables, solved[-1][0], s, log_stiffness):
            break  # another start is for what this one could not do
    candidates += [point for point, _ in found]
    stacked = np.array(candidates)
    e = _evaluate(law, spec, program.variables, stacked, s)
    chosen = int(np.argmin(_scores(spec, program.variables, stacked, e, log_stiffness, centre)))
    if chosen >= 1 + len(best):
        prices = found[chosen - 1 - len(best)][1]
    normalised = NormalisedGains(*(float(value) for value in program.variables.normalised(stacked[chosen])))
    inertia = _inertia(law, normalised, log_stiffness)
    figures = worst(e, chosen)
    missed = shortfalls(spec, figures, inertia)
    active = next(iter(missed), "") or max(prices, key=lambda kind: prices[kind])
    price = 100.0 * prices.get(active, 0.0)
    if not missed and price < 1e-3:
        active, price = "", 0.0
    return CellDesign(normalised, figures, inertia, active, price, missed, len(s), iterations)


def _solve_with_cuts(
    program: RobustProgram,
    law: LawOfStudy,
    spec: Specification,
    s: Scenarios,
    start: Array,
    centre: Array,
    log_stiffness: float,
    pull: float,
    high: Array,
) -> list[tuple[Array, dict[str, float], int]]:
    """Solutions of growing sets of scenarios: the worst of the last design join until they are all there."""
    y, active = start, []
    solutions: list[tuple[Array, dict[str, float], int]] = []
    for _ in range(_ROUNDS):
        hardest = _worst_scenarios(_evaluate(law, spec, program.variables, y[None], s))
        new = [k for k in hardest if k not in active]
        if not new:
            break
        active = (new + active)[:SLOTS]
        solution = program.solve(y, centre, s.take(np.array(active)), log_stiffness, pull, high)
        if solution is None:
            break
        y = solution.y
        solutions.append((y, solution.prices, solution.iterations))
    return solutions


def _is_met(law: LawOfStudy, spec: Specification, v: Variables, y: Array, s: Scenarios, log_stiffness: float) -> bool:
    inertia = _inertia(law, v.normalised(y), log_stiffness)
    return not shortfalls(spec, worst(_evaluate(law, spec, v, y[None], s)), inertia)


def _worst_scenarios(e: Evaluation, design: int = 0) -> list[int]:
    """The worst scenario of every figure, in order."""
    names = ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q")
    index = [int(np.argmax(e[name][design])) for name in names]
    index += [int(np.argmin(e["disk_margin"][design])), int(np.argmin(e.damping_ratio[design]))]
    return list(dict.fromkeys(index))


def _hardest(
    law: LawOfStudy, spec: Specification, v: Variables, y: Array, s: Scenarios, count: int = _SEARCHED
) -> Scenarios:
    """At most ``count`` scenarios: the worst of the seeds for every figure, and the nominal one."""
    if len(s) <= count:
        return s
    e = _evaluate(law, spec, v, y, s)
    orders = [np.argsort(-e[name].max(axis=0), kind="stable") for name in
              ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q")]  # fmt: skip
    orders += [np.argsort(e["disk_margin"].min(axis=0), kind="stable")]
    ranked = [NOMINAL, *np.stack(orders, axis=1).ravel().tolist()]
    return s.take(np.array(list(dict.fromkeys(ranked))[:count]))


def _evaluate(law: LawOfStudy, spec: Specification, v: Variables, y: Array, s: Scenarios) -> Evaluation:
    return evaluate(law, v.normalised(y), s, spec.settling_time)


def common_design(law: LawOfStudy, spec: Specification, boxes: Sequence[Scenarios]) -> Array:
    """y of the one normalised design that serves all cells best: where the search of every cell begins.

    Cells that differ from it only where it pays interpolate well. A cell that no design serves counts no more than
    one that is badly served, so it does not spoil the rest.
    """
    v = variables(law.structure, spec)
    T = spec.settling_time
    shares = 0.0 if law.structure == "published" else 1.0
    rows = []
    for pace, zeta, ratio in itertools.product(_PACES, _ZETAS, _RATIOS):
        root = np.sqrt(15.8 * pace)
        first = (15.8 * pace / T**2, 2.0 * zeta * root / T) if law.law == "poles" else (float(spec.H or 0.0), zeta)
        rows.append(v.of(NormalisedGains(*first, ratio * root / T, 0.02, shares, shares)))
    y = np.unique(np.array(rows), axis=0)
    total = np.zeros(len(y))
    for s in boxes:
        few = _hardest(law, spec, v, y[:: max(len(y) // 4, 1)], s, _SEARCHED_IN_COMMON)
        scores = _scores(spec, v, y, _evaluate(law, spec, v, y, few), _log_stiffness(law, s), y[0])
        total += np.minimum(scores - scores.min(), _CAP) if np.isfinite(scores).all() else 0.0
    return y[int(np.argmin(total))]


def _candidates(v: Variables, centre: Array, rng: np.random.Generator) -> Array:
    """The centre first, then samples around it."""
    samples = centre + 0.4 * rng.standard_normal((SAMPLES - 1, len(v.names)))
    share = ~v.logarithmic
    samples[:, share] = rng.choice([0.0, 0.5, 1.0, 1.0], samples[:, share].shape)
    return np.clip(np.vstack([centre, samples]), v.low, v.high)


def _scores(spec: Specification, v: Variables, y: Array, e: Evaluation, log_stiffness: float, centre: Array) -> Array:
    """The program's objective with exact figures: broken promises first, then margin, then inertia."""
    figures = [worst(e, k) for k in range(len(y))]
    limit = MARGIN_AIM * spec.disk_margin
    scores = np.empty(len(y))
    for k, f in enumerate(figures):
        broken = max(_GUARD_MARGIN * spec.disk_margin - f.disk_margin, 0.0)
        broken += max(spec.damping_ratio - f.damping_ratio, 0.0)
        rest = float(np.sum(v.pull * (y[k] - centre) ** 2))
        if spec.settles:
            settling = min(f.settling_time / spec.settling_time, 10.0)
            broken += max(min(f.overshoot / (_GUARD_OVERSHOOT * spec.overshoot), 1e3) - 1.0, 0.0)
            broken += max(settling / _GUARD_STEP - 1.0, 0.0)
            log_H = log_stiffness - y[k, 0] - float(np.log(v.scale[0]))
            low, high = float(np.log(max(spec.H_min, 1e-9))), float(np.log(spec.H_max))
            broken += max(low - log_H, log_H - high, 0.0)
            rest -= log_H
        else:
            rest += 0.2 * float(y[k, :2].sum())
        scores[k] = 300.0 * broken + 30.0 * max(limit - f.disk_margin, 0.0) + rest
        scores[k] += (5.0 if broken > 0.0 else 0.0) + (0.0 if f.abscissa < 0.0 else 1e4)
    return scores


def _log_stiffness(law: LawOfStudy, s: Scenarios) -> float:
    """ln(A ω_0/(2 S)) of the nominal scenario: H = that over k_1 (:eq:`effective-inertia`)."""
    A = jacobian_from_powers(s.P[NOMINAL], s.Q[NOMINAL], s.V_rms[NOMINAL], s.R[NOMINAL], s.X[NOMINAL])[0]
    return float(np.log(max(A, 1e-9) * law.omega_n / (2.0 * law.S_rated)))


def _inertia(law: LawOfStudy, normalised: NormalisedGains, log_stiffness: float) -> float:
    if law.law == "inertia":
        return float(normalised.k_1_or_H)
    return float(np.exp(log_stiffness) / normalised.k_1_or_H)
