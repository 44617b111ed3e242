"""CMA-ES from several starts on a coarse lattice; then the worst unseen grids join, until a fine lattice agrees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.inner.grids import GridBox, GridPoint, corners, lattice, sampling_ratio
from vsgdesign.design.inner.promises import Bench, Promises, bench_of, evaluate, scores, worst_score
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.execution.executors import Progress
from vsgdesign.study.parameters.converter import Converter, Filter

Array = NDArray[np.float64]


class Limit(Protocol):
    """One more promise of a search."""

    def scores(self, gains: InnerLoopGains, omega_t: Array, of: Array, /) -> Array:
        """What it leaves of the scores ``of`` (M,) of gains (arrays (M,), SI) with ω_t (M,), rad/s."""
        ...

    def joined(self, gains: InnerLoopGains, omega_t: float, /) -> Limit:
        """The same with what is worst with these gains, from now on."""
        ...


NAMES = ("k_c", "k_v", "r_v", "r_c", "R_t", "omega_t", "K_ff", "X_t", "kappa")
"""k_c = K_pc T_s/L_1, k_v = K_pv Z_b, r_v = K_iv/K_pv and r_c = K_ic/K_pc over ω_n, R_t and X_t over Z_b, ω_t over ω_n,
K_ff and κ. See :eq:`inner-variables`."""

LOGARITHMIC = 6
"""The first six are searched in the logarithm."""

_BOUNDS = {
    "k_c": (0.1, 1.5),  # below, the current limit would act through the voltage loop; above, the loop is deadbeat
    "k_v": (0.05, 8.0),
    "r_v": (0.01, 10.0),
    "r_c": (2e-4, 16.0),
    "R_t": (1e-3, 1.0),
    "omega_t": (0.1, 4.0),
    "K_ff": (-1.0, 1.2),
    "X_t": (-0.4, 0.6),
    "kappa": (0.0, 2.0),
}

SLOW = 5.0
"""Sampling frequency over the highest resonance, below which a second closed form is worth a start."""


@dataclass(frozen=True)
class Variables:
    """The search's box (n numbers) and how a point in it becomes gains in SI. Without delay κ is 0 and left out."""

    names: tuple[str, ...]
    low: Array
    high: Array
    K_pc: float
    """V/A that k_c = 1 stands for."""
    Z_base: float
    omega_n: float

    def decode(self, x: Array) -> tuple[InnerLoopGains, Array]:
        """Gains (arrays (M,), SI) and ω_t (M,) in rad/s of points (M, n), all within 0 and 1."""
        y = self.low + np.asarray(x, dtype=float) * (self.high - self.low)
        value = {name: y[:, k] for k, name in enumerate(self.names)}
        for name in NAMES[:LOGARITHMIC]:
            value[name] = np.exp(value[name])
        K_pc, K_pv = self.K_pc * value["k_c"], value["k_v"] / self.Z_base
        gains = InnerLoopGains(
            K_pv=K_pv,
            K_iv=K_pv * value["r_v"] * self.omega_n,
            K_pc=K_pc,
            K_ic=K_pc * value["r_c"] * self.omega_n,
            K_ff=value["K_ff"],
            R_t=value["R_t"] * self.Z_base,
            X_t=value["X_t"] * self.Z_base,
            kappa=value.get("kappa", np.zeros(len(y))),
        )
        return gains, value["omega_t"] * self.omega_n

    def encode(self, gains: InnerLoopGains, omega_t: float) -> Array:
        """The point (n,) of one gain set, moved into the box."""
        value = {
            "k_c": gains.K_pc / self.K_pc,
            "k_v": gains.K_pv * self.Z_base,
            "r_v": gains.K_iv / gains.K_pv / self.omega_n,
            "r_c": gains.K_ic / gains.K_pc / self.omega_n,
            "R_t": gains.R_t / self.Z_base,
            "omega_t": omega_t / self.omega_n,
            "K_ff": gains.K_ff,
            "X_t": gains.X_t / self.Z_base,
            "kappa": gains.kappa,
        }
        tiny = np.finfo(float).tiny
        y = [np.log(max(value[n], tiny)) if n in NAMES[:LOGARITHMIC] else value[n] for n in self.names]
        return np.clip((np.array(y, dtype=float) - self.low) / (self.high - self.low), 0.0, 1.0)


def variables(converter: Converter, filter_: Filter) -> Variables:
    """The search's variables for a converter and its filter (:eq:`inner-variables`)."""
    names = NAMES if converter.delay_samples else NAMES[:-1]
    limits = np.array([np.log(_BOUNDS[n]) if n in NAMES[:LOGARITHMIC] else _BOUNDS[n] for n in names])
    K_pc = filter_.L_1 / converter.T_s
    return Variables(names, limits[:, 0], limits[:, 1], K_pc, converter.Z_base, converter.omega_n)


def closed_form_starts(
    converter: Converter, filter_: Filter, sampling_ratio: float
) -> list[tuple[InnerLoopGains, float]]:
    """Gains in SI with ω_t in rad/s that the search begins with (:eq:`inner-start`).

    With a delay and a low ``sampling_ratio`` (sampling frequency over the highest resonance) there are two.
    """
    Z, omega_n, fastest = converter.Z_base, converter.omega_n, filter_.L_1 / converter.T_s

    def made(K_pc: float, K_pv: float, K_iv: float, K_ic: float, K_ff: float, Z_t: complex, omega: float, kappa: float):
        gains = InnerLoopGains(K_pv, K_iv, K_pc, K_ic, K_ff, Z_t.real * Z, Z_t.imag * Z, kappa)
        return gains, omega * omega_n

    if converter.delay_samples == 0:
        K_pc = 0.61 * fastest
        return [made(K_pc, 1.75 / K_pc, 1.9 * omega_n / Z, 75.0 * K_pc, 0.69, 0.07 + 0.23j, 1.0, 0.0)]
    K_pc = 0.50 * fastest
    starts = [made(K_pc, 0.97 / K_pc, 2.3 * omega_n / Z, 29.0 * K_pc, 0.61, 0.12 + 0.11j, 0.64, 1.5)]
    if sampling_ratio < SLOW:
        K_pc = 0.11 * fastest
        starts.append(made(K_pc, 6.0 / Z, 0.9 * omega_n / Z, 1.9 * omega_n * K_pc, 0.4, 0.9 - 0.13j, 3.0, 1.95))
    return starts


POPULATION = 20
"""Gain sets a generation: the rule 4 + 3 ln n says 10 or 11; twice that finds the better of several valleys."""
WIDTH = 0.12
"""First standard deviation, in the box's width."""
SOBOL = 512
"""Points that each start that is no closed form is the best of."""
COARSE = (4, 3)
"""SCR × X/R of the search's first grids. The stiff end is where it is decided, and that is a corner."""
FINE = (13, 13)
POINTS_SEARCH = 120
"""Frequencies a sign while searching."""

_HEAT = 60
"""Generations of every start; the two best go on."""
_GENERATIONS = 150
"""Generations of those two, the heat included."""
_JOINED = 40
"""Generations from the best, once grids have joined."""
_JOINED_WIDTH = 0.04
_ROUNDS = 4
AGREE = 0.03
"""How far t on the fine lattice may lie below the search's own."""


@dataclass(frozen=True)
class Effort:
    """How much a search does. Fewer generations are enough to compare alternatives."""

    heat: int = _HEAT
    generations: int = _GENERATIONS
    joined: int = _JOINED
    rounds: int = _ROUNDS


@dataclass(frozen=True)
class Found:
    """The best gain set of a search."""

    gains: InnerLoopGains
    omega_t: float
    t: float
    """On the fine lattice."""
    search_t: float
    """On the grids of the search."""
    start_t: float
    """Of the closed-form start (the better, where there are two), on the fine lattice."""
    promises: Promises
    """On the fine lattice, (1, grids)."""
    evaluations: int
    """Gain sets that the search looked at."""
    grids: tuple[GridPoint, ...]
    """Grids of the search at its end."""


class _Run:
    """One CMA-ES run: points in the unit box, the best so far, and how long it is."""

    def __init__(self, start: Array, width: float, seed: int) -> None:
        from cmaes import CMA

        inside = np.clip(start, 1e-3, 1.0 - 1e-3)
        box = np.tile([0.0, 1.0], (len(start), 1))
        self._cma = CMA(inside, width, bounds=box, seed=seed, population_size=POPULATION)
        self.best, self.t = np.array(start), -np.inf
        self.evaluations = 0

    def advance(self, t_of: Callable[[Array], Array], generations: int, tell: Callable[[], None]) -> None:
        """So many generations; fewer where it has converged."""
        for _ in range(generations):
            if self._cma.should_stop():
                return
            tell()
            points = np.array([self._cma.ask() for _ in range(POPULATION)])
            t = t_of(points)
            self.evaluations += len(points)
            self._cma.tell([(x, -float(value)) for x, value in zip(points, t, strict=True)])
            best = int(np.argmax(t))
            if t[best] > self.t:
                self.best, self.t = points[best], float(t[best])


def search(
    converter: Converter,
    filter_: Filter,
    box: GridBox,
    *,
    settling_time: float,
    seed: int,
    effort: Effort,
    tell: Progress,
    more_starts: Sequence[tuple[InnerLoopGains, float]] = (),
    apart: Limit | None = None,
) -> Found:
    """The gains with the largest t (:eq:`inner-score`). Equal arguments give equal digits; one thread. ``apart``: what
    one more promise leaves of t."""
    space = variables(converter, filter_)
    coarse = lattice(box, *COARSE)
    every = lattice(box, *FINE)

    def made(grids: Sequence[GridPoint], off: Sequence[GridPoint], **more: int) -> Bench:
        return bench_of(converter, filter_, box.basis, grids, off, settling_time=settling_time, **more)

    fine = made(every, every)
    grids, off = list(coarse), list(corners(box))
    t_of = _score_on(space, made(grids, off, points=POINTS_SEARCH), apart)
    closed_forms = closed_form_starts(converter, filter_, sampling_ratio(converter, filter_, box))
    starts = [space.encode(*start) for start in (*closed_forms, *more_starts)]
    starts += _best_of_sobol(space, t_of, seed)
    total = effort.heat * len(starts) + 2 * (effort.generations - effort.heat) + effort.rounds * effort.joined
    done = 0

    def progress() -> None:
        nonlocal done
        tell("inner loops", min(done / total, 1.0))
        done += 1

    runs = [_Run(start, WIDTH, _seed(seed, k)) for k, start in enumerate(starts)]
    for run in runs:
        run.advance(t_of, effort.heat, progress)
    ranked = sorted(runs, key=lambda run: -run.t)
    for run in ranked[:2]:
        run.advance(t_of, effort.generations - effort.heat, progress)
    winner = max(ranked[:2], key=lambda run: run.t)
    evaluations = 2 * SOBOL + sum(run.evaluations for run in runs)
    x, search_t = winner.best, winner.t
    promises, t = _on(fine, space, x, wider := _joined(apart, space, x))
    for k in range(effort.rounds):
        if search_t > 0.0 and t >= (1.0 - AGREE) * search_t:
            break
        _join(promises, fine, grids, off)
        apart = wider
        t_of = _score_on(space, made(grids, off, points=POINTS_SEARCH), apart)
        run = _Run(x, _JOINED_WIDTH, _seed(seed, len(runs) + k))
        run.best, run.t = x, float(t_of(x[None])[0])
        run.advance(t_of, effort.joined, progress)
        evaluations += run.evaluations + 1
        x, search_t = run.best, run.t
        promises, t = _on(fine, space, x, wider := _joined(apart, space, x))
    tell("inner loops", 1.0)
    gains, omega_t = space.decode(x[None])
    start_t = max(float(worst_score(evaluate(fine, *_as_arrays(*start)), fine.targets)[0]) for start in closed_forms)
    return Found(
        InnerLoopGains(*(float(value[0]) for value in gains)),
        float(omega_t[0]),
        t,
        search_t,
        start_t,
        promises,
        evaluations,
        tuple(grids),
    )


SHORT = 25
"""Generations of a short search: a third of a second."""
_POINTS_SHORT = 60


def short_search(
    converter: Converter, filter_: Filter, box: GridBox, start: tuple[InnerLoopGains, float], *, settling_time: float
) -> tuple[InnerLoopGains, float, float]:
    """Gains (SI) with ω_t (rad/s) and t from one run of few generations on the coarse lattice, with fewer frequencies.

    It begins with the best of ``start`` and the closed forms. Equal arguments give equal digits; one thread. Where its
    t is 1 or more, currents after phase jumps are within 3 % of those with the gains of :func:`search` (20 other
    filters of four converters); where nothing keeps all promises, they are up to 19 % away.
    """
    space = variables(converter, filter_)
    grids, off = lattice(box, *COARSE), corners(box)
    t_of = _score_on(
        space, bench_of(converter, filter_, box.basis, grids, off, settling_time=settling_time, points=_POINTS_SHORT)
    )
    starts = (start, *closed_form_starts(converter, filter_, sampling_ratio(converter, filter_, box)))
    points = np.array([space.encode(*one) for one in starts])
    t = t_of(points)
    run = _Run(points[np.argmax(t)], WIDTH, _seed(0, 0))
    run.t = float(t.max())
    run.advance(t_of, SHORT, lambda: None)
    gains, omega_t = space.decode(run.best[None])
    return InnerLoopGains(*(float(value[0]) for value in gains)), float(omega_t[0]), run.t


def _score_on(space: Variables, bench: Bench, apart: Limit | None = None) -> Callable[[Array], Array]:
    def t_of(x: Array) -> Array:
        gains, omega_t = space.decode(x)
        t = worst_score(evaluate(bench, gains, omega_t), bench.targets)
        return t if apart is None else apart.scores(gains, omega_t, t)

    return t_of


def _joined(apart: Limit | None, space: Variables, x: Array) -> Limit | None:
    gains, omega_t = space.decode(x[None])
    return apart and apart.joined(InnerLoopGains(*(float(value[0]) for value in gains)), float(omega_t[0]))


def _on(bench: Bench, space: Variables, x: Array, apart: Limit | None) -> tuple[Promises, float]:
    gains, omega_t = space.decode(x[None])
    promises = evaluate(bench, gains, omega_t)
    t = worst_score(promises, bench.targets)
    return promises, float((t if apart is None else apart.scores(gains, omega_t, t))[0])


def _as_arrays(gains: InnerLoopGains, omega_t: float) -> tuple[InnerLoopGains, Array]:
    return InnerLoopGains(*(np.array([float(value)]) for value in gains)), np.array([omega_t])


def _best_of_sobol(space: Variables, t_of: Callable[[Array], Array], seed: int) -> list[Array]:
    """The best of each half of a scrambled Sobol sequence."""
    from scipy.stats import qmc

    points = qmc.Sobol(len(space.names), rng=np.random.default_rng(seed)).random(2 * SOBOL)
    halves = points.reshape(2, SOBOL // 64, 64, len(space.names))
    return [half.reshape(SOBOL, -1)[np.argmax([t_of(part) for part in half])] for half in halves]


def _join(promises: Promises, fine: Bench, grids: list[GridPoint], off: list[GridPoint]) -> None:
    """The worst grid of every promise joins; damping first, which is what there is of an unstable set."""
    each = scores(promises, fine.targets)
    for name, score in each._asdict().items():
        if np.all(np.isnan(score)):
            continue
        point = fine.grids[int(np.nanargmin(score[0]))]
        joining = off if name == "tolerance" else grids
        if point not in joining:
            joining.append(point)


def _seed(seed: int, run: int) -> int:
    return int(np.random.SeedSequence([seed, run]).generate_state(1)[0])
