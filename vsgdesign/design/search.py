"""The variables of the optimiser: the free normalised parameters of a structure and law, with scales and bounds; and
where a cell's descent begins: samples around a centre, generations of them, and one measure for all designs."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.box import NOMINAL, Scenarios
from vsgdesign.design.evaluation import Evaluation, LawOfStudy, evaluate, shortfalls, worst
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains, effective_inertia
from vsgdesign.study.parameters.specification import UNBOUNDED_H, Specification

Array = NDArray[np.float64]

_FIELDS = NormalisedGains._fields
_POLES = {"k_1_or_H": (1.0, 2e3), "d_1_or_zeta": (1.0, 100.0), "k_2": (0.5, 100.0)}
"""Least and largest value, dimensionless: times the settling time, or times its square for k_1."""
_ZETA = (0.3, 4.0)
_PULL_LOG, _PULL_SHARE = 1.5, 10.0
"""Weights of the distance from the centre. Where the figures hardly depend on the variables, neighbouring cells then
choose similar ones and can be interpolated. Partial decoupling is chosen only where it has a large effect."""


@dataclass(frozen=True)
class Variables:
    """Free parameters ``names`` of NormalisedGains; the rest is ``fixed``. In the optimizer they are y: logarithms
    of dimensionless values (``logarithmic``), or shares as they are."""

    names: tuple[str, ...]
    logarithmic: NDArray[np.bool_]
    low: Array
    high: Array
    scale: Array
    """SI value of a dimensionless 1."""
    fixed: dict[str, float]

    @property
    def pull(self) -> Array:
        """Weight of each variable's squared distance from the centre."""
        return np.where(self.logarithmic, _PULL_LOG, _PULL_SHARE)

    def normalised(self, y: Any) -> NormalisedGains:
        """Normalised gains from y: rows of designs (M, k) → arrays (M,), one design (k,) → numbers."""
        y = np.asarray(y, dtype=float)
        free = {
            name: self.scale[k] * (np.exp(y[..., k]) if self.logarithmic[k] else y[..., k])
            for k, name in enumerate(self.names)
        }
        shape = y.shape[:-1]
        return NormalisedGains(**{f: free[f] if f in free else np.full(shape, self.fixed[f]) for f in _FIELDS})

    def expression(self, y: Any, exp: Any) -> NormalisedGains:
        """Normalised gains from a CasADi column y (k,); ``exp`` is the exponential of CasADi."""
        free = {name: self.scale[k] * (exp(y[k]) if self.logarithmic[k] else y[k]) for k, name in enumerate(self.names)}
        return NormalisedGains(**{f: free.get(f, self.fixed.get(f)) for f in _FIELDS})

    def of(self, normalised: NormalisedGains) -> Array:
        """y (k,) of one design, moved into the bounds."""
        values = np.array([getattr(normalised, name) for name in self.names], dtype=float) / self.scale
        y = np.where(self.logarithmic, np.log(np.maximum(values, 1e-300)), values)
        return np.clip(y, self.low, self.high)

    def slower(self, normalised: NormalisedGains, share: float) -> Array:
        """Upper bounds of y (k,) that leave ``share`` of a design's d_1 and k_2, and the square of this share of its
        k_1."""
        y = self.of(normalised)
        powers = {"k_1_or_H": 2.0, "d_1_or_zeta": 1.0, "k_2": 1.0}
        cut = np.array([powers.get(name, 0.0) for name in self.names])
        return np.maximum(np.where(cut > 0.0, y + cut * np.log(share), self.high), self.low)


def variables(structure: str, spec: Specification) -> Variables:
    """The free parameters of a structure under a specification."""
    T = spec.settling_time
    entries: list[tuple[str, bool, float, float, float]] = []
    fixed = dict.fromkeys(_FIELDS, 0.0)
    if spec.settles:
        entries.append(("k_1_or_H", True, *_POLES["k_1_or_H"], 1.0 / T**2))
        high = min(_POLES["d_1_or_zeta"][1], spec.bandwidth_max * T)
        entries.append(("d_1_or_zeta", True, _POLES["d_1_or_zeta"][0], high, 1.0 / T))
    else:
        fixed["k_1_or_H"] = float(spec.H or 0.0)
        entries.append(("d_1_or_zeta", True, *_ZETA, 1.0))
    entries.append(("k_2", True, _POLES["k_2"][0], min(_POLES["k_2"][1], spec.bandwidth_max * T), 1.0 / T))
    entries += [(free.name, free.logarithmic, free.low, free.high, 1.0) for free in STRUCTURES[structure].free]
    names, logarithmic, low, high, scale = zip(*entries, strict=True)
    mask = np.array(logarithmic)
    least, most = (np.where(mask, np.log(np.where(mask, x, 1.0)), x) for x in (np.array(low), np.array(high)))
    return Variables(names, mask, least, most, np.array(scale), {f: v for f, v in fixed.items() if f not in names})


MARGIN_AIM = 1.15
"""More margin than this multiple of the least disk margin is not traded against inertia."""

GUARD_MARGIN = 1.03
"""Multiple of the required disk margin that a design has at a node, because filters and delay reduce it by 1 to 2 %."""

MARGIN_RESERVE = 0.015
"""Largest reduction of this factor where a requirement would be violated otherwise."""

WEIGHT_BROKEN, WEIGHT_MARGIN = 300.0, 30.0
"""Weights w_s of what is violated and w_α of missing margin; inertia, in natural logarithms, has the weight 1."""

WEIGHT_DAMPING = 0.2
"""Weight of the logarithms of damping and bandwidth with ``aim = "inertia"``: no more of both than needed."""


def cell_objective(price: Any, broken: Any, reserve: Any, short: Any, away: Any) -> Any:
    """The objective from its five terms (:eq:`cell-objective`), numbers or CasADi expressions.

    ``price``: −ln H, or WEIGHT_DAMPING times the logarithms of damping and bandwidth. ``broken``: the sum of what the
    requirements are violated by, relative. ``reserve``: the used reserve, weighted. ``short``: the missing margin.
    ``away``: the weighted squared distance to the centre.
    """
    return price + WEIGHT_BROKEN * broken + reserve + WEIGHT_MARGIN * short + away


SAMPLES = 96
"""Designs that the global search looks at."""

_PACES, _SHARES = (1.0, 1.3, 1.7, 2.2, 2.8), (0.7, 0.4, 0.2)
"""Some of the samples: faster, with less of Q's decoupling. Where a wrong estimate meets a grid near its limit, a full
inverse of the Jacobian is what costs the margin, and taking out one of its halves is what gives it back."""

_SEARCHED = 17
"""Scenarios that the global search looks at: the hardest for the centre."""

_HARD = 60
"""Scenarios of the surroundings that a cell takes on: the hardest for the centre."""

_POPULATION, _GENERATIONS, _ELITE = 32, 20, 4
_STEP, _CROSSING = 0.6, 0.9
"""Differential evolution: towards one of the best, plus a difference; share of the variables that change."""

_GUARD_STEP, _GUARD_OVERSHOOT = 0.98, 0.8
"""A design at a node keeps so much of the limits in hand, for what lies between nodes."""

_STEP_BROKEN, _STEP_UNSTABLE, _WEIGHT_RESERVE = 1e3, 1e4, 50.0
"""What any violation and any instability cost by themselves: a design with one is never preferred to one without."""


@dataclass(frozen=True, kw_only=True)
class Ground:
    """What designs of one cell are measured on. ``log_stiffness``: ln(A ω_0/(2 S)) of the nominal scenario, so that
    H is that over k_1 (:eq:`effective-inertia`); ``pull``: how much being near ``centre`` counts."""

    law: LawOfStudy
    spec: Specification
    variables: Variables
    scenarios: Scenarios
    log_stiffness: float
    centre: Array
    pull: float = 1.0

    def evaluate(self, y: Array, s: Scenarios | None = None) -> Evaluation:
        """Figures of designs, rows y, in all scenarios or in those given."""
        s = self.scenarios if s is None else s
        return evaluate(self.law, self.variables.normalised(y), s, self.spec.settling_time)

    def inertia(self, normalised: NormalisedGains) -> Any:
        """H in s at the design point, of one design or of arrays of them: what a frequency ramp meets, from the gains
        (:eq:`effective-inertia`). The droop's part in the angle-damped V row makes it differ from A ω_0/(2 S k_1)."""
        if self.law.law == "inertia":
            return normalised.k_1_or_H
        gains = self.law.gains(normalised, self.scenarios.take(np.array([NOMINAL])))
        found = effective_inertia(gains, self.law.S_rated, self.law.omega_n)
        return np.reshape(found, np.shape(normalised.k_1_or_H))

    def bounded_stiffness(self, y: Array) -> float:
        """ln(H k_1) of one design: with it the program, which knows H as that over k_1, bounds what H really is."""
        spec = self.spec
        if not spec.settles or not self.bounds_inertia:
            return self.log_stiffness
        normalised = self.variables.normalised(y)
        product = float(self.inertia(normalised) * normalised.k_1_or_H)
        return float(np.log(product)) if product > 0.0 else self.log_stiffness

    @property
    def bounds_inertia(self) -> bool:
        """Whether the specification asks for a least or a largest H."""
        return self.spec.H_min > 0.0 or self.spec.H_max < UNBOUNDED_H

    def is_met(self, y: Array) -> bool:
        """Whether one design keeps every promise."""
        inertia = float(self.inertia(self.variables.normalised(y)))
        return not shortfalls(self.spec, worst(self.evaluate(y[None])), inertia)

    def distance(self, y: Array) -> float:
        """What being away from the centre costs, without its weight."""
        return float(np.sum(self.variables.pull * (y - self.centre) ** 2))

    def scores(self, y: Array, e: Evaluation) -> Array:
        """The program's objective with exact figures: broken promises first, then margin, then inertia."""
        spec, v = self.spec, self.variables
        limit = MARGIN_AIM * spec.disk_margin
        scores = np.empty(len(y))
        exact = None
        if spec.settles and self.bounds_inertia:
            exact = np.log(np.maximum(self.inertia(v.normalised(y)), 1e-9))
        for k in range(len(y)):
            f = worst(e, k)
            broken = max((GUARD_MARGIN - MARGIN_RESERVE) * spec.disk_margin - f.disk_margin, 0.0)
            broken += max(spec.damping_ratio - f.damping_ratio, 0.0)
            if spec.differential_decay > 0.0:
                broken += max(1.0 - f.differential_decay / spec.differential_decay, 0.0)
            reserve = max(GUARD_MARGIN * spec.disk_margin - f.disk_margin, 0.0)
            if spec.settles:
                settling, overshoot = (
                    min(f.settling_time / spec.settling_time, 10.0),
                    min(f.overshoot / spec.overshoot, 1e3),
                )
                broken += max(overshoot - 1.0, 0.0) + max(settling - 1.0, 0.0)
                reserve += max(overshoot - _GUARD_OVERSHOOT, 0.0) + max(settling - _GUARD_STEP, 0.0)
                log_H = self.log_stiffness - y[k, 0] - float(np.log(v.scale[0]))
                if exact is not None:
                    low, high = float(np.log(max(spec.H_min, 1e-9))), float(np.log(spec.H_max))
                    broken += max(low - exact[k], exact[k] - high, 0.0)
                price = -log_H
            else:
                price = WEIGHT_DAMPING * float(y[k, :2].sum())
            short, away = max(limit - f.disk_margin, 0.0), self.pull * self.distance(y[k])
            scores[k] = cell_objective(price, broken, _WEIGHT_RESERVE * min(reserve, 1e3), short, away)
            scores[k] += (_STEP_BROKEN if broken > 0.0 else 0.0) + (0.0 if f.abscissa < 0.0 else _STEP_UNSTABLE)
        return scores


def log_stiffness(law: LawOfStudy, s: Scenarios) -> float:
    """ln(A ω_0/(2 S)) of the nominal scenario (:eq:`effective-inertia`)."""
    A = jacobian_from_powers(s.P[NOMINAL], s.Q[NOMINAL], s.V_rms[NOMINAL], s.R[NOMINAL], s.X[NOMINAL])[0]
    return float(np.log(max(A, 1e-9) * law.omega_n / (2.0 * law.S_rated)))


def candidates(ground: Ground, high: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """(SAMPLES, k) designs, the centre first, and their scores in its hardest scenarios."""
    v, centre = ground.variables, ground.centre
    samples = centre + 0.4 * rng.standard_normal((SAMPLES - 1, len(v.names)))
    share = ~v.logarithmic
    samples[:, share] = rng.choice([0.0, 0.5, 1.0, 1.0], samples[:, share].shape)
    if "share_Q" in v.names and ground.spec.settles:
        for k, (pace, part) in enumerate(itertools.product(_PACES, _SHARES)):
            samples[k] = centre
            samples[k, :2] += np.log(pace) * np.array([2.0, 1.0])
            samples[k, v.names.index("share_Q")] = part
    y = np.clip(np.vstack([centre, samples]), v.low, high)
    few = hardest(ground, y[:1], _SEARCHED)
    return y, ground.scores(y, ground.evaluate(y, few))


def evolved(ground: Ground, y: Array, tried: Array, high: Array, rng: np.random.Generator) -> Array:
    """The best of _GENERATIONS from a first one y: for cells in which descents got stuck, the last at ``tried``."""
    v, s = ground.variables, ground.scenarios
    ranked = [_ranked(ground, one[None])[: _SEARCHED - 5] for one in (y[0], tried)]
    few = s.take(np.unique(np.concatenate(ranked)))
    scores = ground.scores(y, ground.evaluate(y, few))
    order = np.argsort(scores, kind="stable")[:_POPULATION]
    y, scores = y[order], scores[order]
    for _ in range(_GENERATIONS):
        elite = np.argsort(scores, kind="stable")[rng.integers(_ELITE, size=len(y))]
        one, other = rng.integers(len(y), size=(2, len(y)))
        new = y + _STEP * (y[elite] - y) + _STEP * (y[one] - y[other])
        new = np.clip(np.where(rng.random(new.shape) < _CROSSING, new, y), v.low, high)
        found = ground.scores(new, ground.evaluate(new, few))
        better = found < scores
        y, scores = np.where(better[:, None], new, y), np.where(better, found, scores)
    return y[int(np.argmin(scores))]


def hardest(ground: Ground, y: Array, count: int) -> Scenarios:
    """At most ``count`` scenarios: the worst of some designs for every figure, and the nominal one."""
    s = ground.scenarios
    return s if len(s) <= count else s.take(_ranked(ground, y)[:count])


def with_hard(law: LawOfStudy, spec: Specification, s: Scenarios, centre: Array, keep: int) -> Scenarios:
    """The first ``keep`` scenarios, and of the others those among the worst of a design for any figure."""
    ground = Ground(
        law=law, spec=spec, variables=variables(law.structure, spec), scenarios=s, log_stiffness=0.0, centre=centre
    )
    return s.take(np.array(list(dict.fromkeys([*range(keep), *_ranked(ground, centre[None])[:_HARD].tolist()]))))


def _ranked(ground: Ground, y: Array) -> NDArray[np.intp]:
    """Scenarios, the nominal one first, then the worst for every figure in turn."""
    e = ground.evaluate(y)
    orders = [
        np.argsort(-e[name].max(axis=0), kind="stable")
        for name in ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q")
    ]
    orders += [np.argsort(e["disk_margin"].min(axis=0), kind="stable")]
    if e.differential is not None:
        orders += [np.argsort(-e.differential.max(axis=0), kind="stable")]
    return np.array(list(dict.fromkeys([NOMINAL, *np.stack(orders, axis=1).ravel().tolist()])))
