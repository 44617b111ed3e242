"""The best fixed gains of a structure over a whole box of grids, which a gain schedule has to beat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.box import Scenarios, joined, scenarios_of_truths
from vsgdesign.design.evaluation import Evaluation, Figures, LawOfStudy, evaluate_fixed, law_of, worst
from vsgdesign.design.search import variables
from vsgdesign.equations.placing import LEAST_BANDWIDTH
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains, effective_inertia
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.study.parameters.specification import UNBOUNDED_H, Specification
from vsgdesign.study.parameters.study import ClosedFormTarget, Study

Array = NDArray[np.float64]

POPULATION = 32
GENERATIONS = 40
ROUNDS = 3
_HARD = 24
"""Scenarios of the first round; the worst of every round's winner join."""
_JOINING = 8

_OVER = {"K_pq": "K_ip", "K_qp": "K_iq", "k_Q": "k_P"}
"""Gains that are searched for as a share of another, of either sign: W against var, no unit."""
_SHARE = 4.0
_DECADES = 1.5
"""How far beyond the closed forms of all grids the logarithm of a gain is searched."""

_PACES = (0.3, 0.6, 1.0, 1.6, 3.0)
"""Bandwidths of the closed forms that the search begins with, over the settling time's inverse."""

_START_Q = 0.01
"""The paper's D_q = D/100, where q is free."""

_CAP = 5.0
_UNSTABLE = 10.0
_MEAN = 0.1
"""Weight of the mean violation: it says where to go while the worst scenario is hopeless."""


@dataclass(frozen=True)
class FixedTuning:
    """One set of gains for all grids. ``figures`` are the worst over the scenarios of the grids. ``violation`` is the
    largest relative violation of a requirement: 0 if all are kept, and 10 or more if a loop is unstable somewhere."""

    structure: str
    gains: PowerLoopGains
    figures: Figures
    violation: float
    scenarios: int
    designs: int
    """Number of sets of gains that were evaluated."""


def best_fixed(
    study: Study,
    target: ClosedFormTarget,
    grids: Sequence[tuple[float, float]],
    *,
    seed: int = 0,
    population: int = POPULATION,
    generations: int = GENERATIONS,
    progress: Progress | None = None,
) -> FixedTuning:
    """The fixed gains of a structure with the least violation at the worst of all grids (SCR, X/R) and powers.

    Grids and powers are those of the specification. The search is a differential evolution over the structure's own
    gains in SI, begun with the closed forms of every grid. Droops that the structure leaves free are those of the
    target. The search evaluates the hardest scenarios only, and after each round the worst ones of its winner join
    them. Fixed gains do not depend on an estimate, so that its error does not matter. Equal calls with an equal
    ``seed`` give equal digits. Raises InfeasibleStudyError without a specification with the aim ``settling``, or where
    no grid has an operating point.
    """
    from scipy.optimize import differential_evolution

    spec = study.specification
    if spec is None or not spec.settles:
        raise InfeasibleStudyError(
            'a fixed tuning is sought under a [specification] with aim = "settling"; this study has none. Add one.'
        )
    tell = progress or silent
    law = law_of(study, target, spec.aim)
    s = exact_scenarios(study, spec, grids, target.P, target.Q)
    if len(s) == 0:
        raise InfeasibleStudyError(
            "specification: no grid has an operating point within the converter's limits. "
            "Ask for less power (P, Q), or stronger grids (scr)."
        )
    seeds = _encoded(law, _closed_forms(law, spec, s))
    low, high = _bounds(law, spec, s, seeds)
    decode = _decoder(law)

    def inertia(y: Array) -> Array:
        return np.asarray(effective_inertia(decode(y), law.S_rated, law.omega_n), dtype=float)

    def costs(y: Array, few: Scenarios) -> Array:
        return _costs(spec, evaluate_fixed(decode(y), few, spec.settling_time, law.lags), inertia(y))

    few = s.take(_spread(len(s), _HARD))
    seeds = np.clip(seeds, low, high)
    begin = costs(seeds, few)
    ranked = np.argsort(begin, kind="stable")[:population]
    rng = np.random.default_rng(seed)
    start = seeds[ranked[np.arange(population) % len(ranked)]]
    start = np.clip(
        start
        + np.where(np.arange(population)[:, None] < len(ranked) // 2, 0.0, 0.3) * rng.standard_normal(start.shape),
        low,
        high,
    )
    starts: Any = start
    designs, active = len(seeds), _spread(len(s), _HARD)
    winners = [seeds[ranked[0]]]
    for k in range(ROUNDS):
        tell(f"best fixed tuning, {law.structure}", k / ROUNDS)
        few = s.take(active)
        found = differential_evolution(
            lambda x, few=few: costs(x.T, few),
            list(zip(low, high, strict=True)),
            init=starts,
            maxiter=generations,
            rng=np.random.default_rng(rng.integers(2**63)),
            polish=False,
            updating="deferred",
            vectorized=True,
            tol=0.0,
        )
        designs += int(found.nfev) * population  # a vectorised search counts the calls, each of a whole population
        starts = np.clip(found.population, low, high)
        winners.append(starts[0])
        best_now = evaluate_fixed(decode(starts[:1]), s, spec.settling_time, law.lags)
        violation = violations(spec, best_now, inertia(starts[:1]))[0]
        active = np.array(list(dict.fromkeys([*active, *np.argsort(-violation, kind="stable")[:_JOINING].tolist()])))
    tell(f"best fixed tuning, {law.structure}", 1.0)
    y = np.array(winners)
    whole = evaluate_fixed(decode(y), s, spec.settling_time, law.lags)
    H = inertia(y)
    best = int(np.argmin(_costs(spec, whole, H)))
    gains = PowerLoopGains(*(float(value[0]) for value in decode(y[best : best + 1])))
    return FixedTuning(
        law.structure,
        gains,
        worst(whole, best),
        max(float(violations(spec, whole, H)[best].max()), 0.0),
        len(s),
        designs,
    )


def exact_scenarios(
    study: Study, spec: Specification, grids: Sequence[tuple[float, float]], P: float, Q: float
) -> Scenarios:
    """The scenarios of all grids (SCR, X/R), joined, without error of the estimate."""
    exact = replace(spec, box=spec.box.exact())
    return joined(scenarios_of_truths(study, exact, grids, P, Q))


def violations(spec: Specification, e: Evaluation, inertia: Array) -> Array:
    """The largest relative violation of a requirement, (M, S) for M designs in S scenarios; at most 0 if all are kept.

    ``inertia`` (M,) is H of each design in s, which H_min and H_max limit. Fixed gains have the same H on every grid
    (:eq:`effective-inertia`). An H that is not positive counts as the largest violation. The result is at most 5 where
    the loops are stable, and 10 or more where they are not.
    """
    overshoot = np.maximum(e["overshoot_P"], e["overshoot_Q"]) / spec.overshoot - 1.0
    settling = np.maximum(e["settling_P"], e["settling_Q"]) / spec.settling_time - 1.0
    margin = 1.0 - e["disk_margin"] / max(spec.disk_margin, 1e-9)
    damping = 1.0 - e.damping_ratio / max(spec.damping_ratio, 1e-9)
    H = np.reshape(inertia, (-1, 1))
    bounded = spec.H_min > 0.0 or spec.H_max < UNBOUNDED_H
    light = 1.0 - H / spec.H_min if spec.H_min > 0.0 else np.full(H.shape, -1.0)
    of_inertia = np.where(H > 0.0, np.maximum(light, H / spec.H_max - 1.0), _CAP) if bounded else -1.0
    stable = np.minimum(np.maximum.reduce([overshoot, settling, margin, damping, of_inertia + 0.0 * damping]), _CAP)
    growth = np.clip(e.abscissa * spec.settling_time, 0.0, 50.0)
    return np.where(e.abscissa < 0.0, stable, _UNSTABLE + growth)


def _costs(spec: Specification, e: Evaluation, inertia: Array) -> Array:
    found = violations(spec, e, inertia)
    return found.max(axis=1) + _MEAN * np.maximum(found, 0.0).mean(axis=1)


def _closed_forms(law: LawOfStudy, spec: Specification, s: Scenarios) -> PowerLoopGains:
    """Gains of the closed form for every scenario's own Jacobian at every pace, arrays (paces·S,)."""
    structure, (k_1, d_1, k_2) = STRUCTURES[law.structure], LEAST_BANDWIDTH
    share, q = structure.start_share, _START_Q if any(free.name == "q" for free in structure.free) else 0.0
    parts = []
    for pace in _PACES:
        T = spec.settling_time / pace
        normalised = NormalisedGains(k_1 / T**2, d_1 / T, k_2 / T, q, share, share)
        parts.append([np.broadcast_to(value, s.P.shape) for value in law.gains(normalised, s)])
    return PowerLoopGains(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _encoded(law: LawOfStudy, gains: PowerLoopGains) -> Array:
    """Rows of search variables: logarithms of gains, shares of those that may be negative."""
    columns = []
    for name in STRUCTURES[law.structure].tuned:
        value = getattr(gains, name)
        over = _OVER.get(name)
        columns.append(np.log(np.maximum(value, 1e-30)) if over is None else value / getattr(gains, over))
    return np.stack(columns, axis=1)


def _bounds(law: LawOfStudy, spec: Specification, s: Scenarios, seeds: Array) -> tuple[Array, Array]:
    """Limits of the search. A rate that a table may not exceed is not exceeded on any grid here either: the model's
    inner loops are ideal, and a search without that limit lives on them."""
    v = variables(law.structure, spec)
    most = dict(zip(v.names, np.exp(v.high) * v.scale, strict=True))
    unit = law.gains(NormalisedGains(1.0, 2.0, 1.0, 0.0, 0.0, 0.0), s)
    rates = {
        "K_ip": most["k_1_or_H"] * unit.K_ip,
        "K_iq": most["k_2"] * unit.K_iq,
        "k_P": most["d_1_or_zeta"] * unit.K_ip,
    }
    beyond = _DECADES * np.log(10.0)
    low, high = seeds.min(axis=0) - beyond, seeds.max(axis=0) + beyond
    for k, name in enumerate(STRUCTURES[law.structure].tuned):
        if name in _OVER:
            low[k], high[k] = -_SHARE, _SHARE
        elif name in rates:
            high[k] = np.log(rates[name][rates[name] > 0.0].min())
    return low, high


def _decoder(law: LawOfStudy) -> Callable[[Array], PowerLoopGains]:
    """Search variables (M, k) → gains, arrays (M,)."""
    names = STRUCTURES[law.structure].tuned

    def decode(y: Array) -> PowerLoopGains:
        values: dict[str, Any] = dict.fromkeys(PowerLoopGains._fields, np.zeros(len(y)))
        values |= {"D_p": np.full(len(y), law.D_p), "D_q": np.full(len(y), law.D_q)}
        for k, name in enumerate(names):  # a share comes after what it is a share of
            over = _OVER.get(name)
            values[name] = np.exp(y[:, k]) if over is None else y[:, k] * values[over]
        return PowerLoopGains(**values)

    return decode


def _spread(count: int, wanted: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count - 1, min(wanted, count)).round().astype(int))
