"""The promises of given inner gains on a lattice of grids: what a map shows and what a design reports."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.inner.grids import GridBox, axis, lattice
from vsgdesign.design.inner.promises import PROMISES, Promises, Targets, bench_of, evaluate, scores, worst_score
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.execution.threads import one_thread
from vsgdesign.parameters.converter import Converter, Filter

Array = NDArray[np.float64]

LATTICE = (13, 13)
"""SCR × X/R of a final figure."""


@dataclass(frozen=True)
class PromiseReached:
    """The worst of one promise over the grids, and where it is."""

    name: str
    """One of ``damping``, ``decay`` (1/s), ``disk``, ``sensors``, ``noise``, ``tolerance``."""
    value: float
    """NaN for a margin where some grid is unstable: an unstable loop has none."""
    target: float
    score: float
    """Value over target (target over value for noise); 1 and more: kept."""
    scr: float
    x_over_r: float

    @property
    def kept(self) -> bool:
        """Whether it is kept on every grid."""
        return self.score >= 1.0


@dataclass(frozen=True)
class InnerScore:
    """The promises of one gain set over SCR × X/R."""

    scr: tuple[float, ...]
    x_over_r: tuple[float, ...]
    basis: str
    maps: Promises
    """Each promise, (SCR, X/R), in its own unit (decay in 1/s)."""
    targets: Targets
    t_map: Array
    """Worst score of each grid, (SCR, X/R); negative where a mode grows."""
    stable: NDArray[np.bool_]
    """(SCR, X/R), of the nominal filter."""
    t: float
    """Worst of ``t_map``."""
    promises: tuple[PromiseReached, ...]

    @property
    def limiting(self) -> PromiseReached:
        """The promise that t is the score of."""
        return limiting(self.promises)


def limiting(promises: tuple[PromiseReached, ...]) -> PromiseReached:
    """The promise that t is the score of: the least; where a mode grows, of damping and tolerance alone."""
    damped = [promise for promise in promises if promise.name in ("damping", "tolerance")]
    unstable = min(promise.score for promise in damped) <= 0.0
    return min(damped if unstable else promises, key=lambda promise: promise.score)


def score_inner_loops(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox,
    *,
    settling_time: float = 1.0,
    scr: int = LATTICE[0],
    x_over_r: int = LATTICE[1],
) -> InnerScore:
    """Every promise of given inner gains (SI, ω_t in rad/s) on ``scr`` × ``x_over_r`` grids (:eq:`inner-score`).

    ``settling_time`` (s) is the power loops': the slowest decay is held against it. Raises StudyError with every fault
    of the gains.
    """
    check_gains(converter, gains, omega_t, settling_time)
    points = lattice(box, scr, x_over_r)
    with one_thread():
        bench = bench_of(converter, filter_, box.basis, points, points, settling_time=settling_time)
        arrays = InnerLoopGains(*(np.array([float(value)]) for value in gains))
        return score_of(box, evaluate(bench, arrays, np.array([omega_t])), bench.targets, scr, x_over_r)


def score_of(box: GridBox, promises: Promises, targets: Targets, scr: int, x_over_r: int) -> InnerScore:
    """The score of one gain set's promises (1, grids) on the lattice of ``scr`` × ``x_over_r`` grids."""
    axes = axis(box.scr, scr), axis(box.x_over_r, x_over_r)
    shape = (len(axes[0]), len(axes[1]))
    each = scores(promises, targets)
    reached = []
    points = lattice(box, scr, x_over_r)
    for name in PROMISES:
        score, value = getattr(each, name)[0], getattr(promises, name)[0]
        known = not np.any(np.isnan(score))
        k = int(np.argmin(score)) if known else 0
        place = points[k] if known else (math.nan, math.nan)
        reached.append(
            PromiseReached(
                name, float(value[k]), float(getattr(targets, name)), float(score[k]) if known else math.nan, *place
            )
        )
    by_grid = Promises(*(value.T for value in promises))  # each grid as a gain set of one grid
    t_map = worst_score(by_grid, targets).reshape(shape)
    return InnerScore(
        *axes,
        box.basis,
        Promises(*(value[0].reshape(shape) for value in promises)),
        targets,
        t_map,
        promises.decay[0].reshape(shape) > 0.0,
        float(worst_score(promises, targets)[0]),
        tuple(reached),
    )


def check_gains(converter: Converter, gains: InnerLoopGains, omega_t: float, settling_time: float) -> None:
    """Raises StudyError with every fault of given gains, ω_t and settling time."""
    faults = []
    for name, value in (*gains._asdict().items(), ("omega_t", omega_t), ("settling_time", settling_time)):
        if not math.isfinite(value):
            faults.append(Fault(name, str(value), "is not a number"))
        elif name in ("K_pv", "K_pc", "settling_time") and value <= 0.0:
            faults.append(Fault(name, str(value), "must be larger than 0"))
        elif name in ("K_iv", "K_ic", "omega_t") and value < 0.0:
            faults.append(Fault(name, str(value), "must not be negative"))
    if gains.kappa != 0.0 and converter.delay_samples == 0:
        faults.append(Fault("kappa", str(gains.kappa), "there is no delay to predict over", "Set it to 0."))
    if faults:
        raise StudyError("inner gains", faults)
