"""What designed inner loops promise on every grid, and one figure for how well a gain set keeps it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.inner.frozen import FIGURES, Plants, frequencies, joined, law_matrix, margins, modes, plants
from vsgdesign.design.inner.grids import GridBox, GridPoint, axis, circuits, lattice, study_of
from vsgdesign.equations.controller import ControllerSettings
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.execution.executors import one_thread
from vsgdesign.metrics.met import score_met
from vsgdesign.metrics.modes import least_damping
from vsgdesign.study.parameters.converter import Converter, Filter

Array = NDArray[np.float64]

PROMISES = ("damping", "decay", "disk", "sensors", "noise", "tolerance")

DAMPING = 0.3
"""Least damping ratio of every mode: the project's own gate, overshoot 37 % of a step into that mode alone."""
DECAY = 0.08
"""Slowest decay over ω_n for power loops of a second: 25 1/s at 50 Hz, six times the 4/T_settle of the power loops, so
that both do not meet in one mode."""
DISK = 0.8
"""Disk margin at the bridge: each axis may be off by 7.4 dB or by 44°."""
SENSOR_ERROR = 0.15
"""All-sensor margin: three sensors of a few per cent each, and as much again for what the filter's model leaves out."""
NOISE = 4.0
"""Noise gain: one per cent rms on every sensor makes at most four per cent rms of the base voltage at the bridge."""
TOLERANCE = 0.15
"""Least damping ratio with L_1 and C each off by 20 %: half of what is asked of the nominal filter."""
OFF = 0.2
"""How far off: the usual tolerance of filter capacitors, and what an inductor loses towards its peak current."""

POINTS = 240
"""Frequencies a sign of a final figure."""


class Promises(NamedTuple):
    """Of M gain sets on G grids, (M, G) each. Margins of an unstable loop are NaN."""

    damping: Array
    """Least damping ratio over all modes."""
    decay: Array
    """Slowest decay, 1/s: negative where a mode grows."""
    disk: Array
    """Disk margin of the loop that is broken at the bridge."""
    sensors: Array
    """All-sensor margin: relative error that v, i_s and i_g may have at once, each its own."""
    noise: Array
    """rms of the law's output over base voltage per rms noise of each sensor over its base."""
    tolerance: Array
    """Least damping ratio with L_1 and C off by ±20 % in all four corners."""


class Targets(NamedTuple):
    """At which value each promise is kept. ``noise`` is kept at or below its target, all others at or above."""

    damping: float
    decay: float
    disk: float
    sensors: float
    noise: float
    tolerance: float


def targets(converter: Converter, settling_time: float) -> Targets:
    """The promises' targets for power loops that settle within ``settling_time`` s."""
    return Targets(DAMPING, DECAY * converter.omega_n / settling_time, DISK, SENSOR_ERROR, NOISE, TOLERANCE)


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Everything that a gain set is judged on, made once: circuits, frequencies, targets.

    ``nominal`` holds the circuits of the G grids; in ``both`` four follow for each of the H grids that tolerances are
    judged on.
    """

    settings: ControllerSettings
    targets: Targets
    nominal: Plants
    both: Plants
    """The nominal circuits, then those that are off."""
    omega: Array
    scales: Array
    grids: tuple[GridPoint, ...]
    off_grids: tuple[GridPoint, ...]


def bench_of(
    converter: Converter,
    filter_: Filter,
    basis: str,
    grids: Sequence[GridPoint],
    off_grids: Sequence[GridPoint],
    *,
    settling_time: float = 1.0,
    points: int = POINTS,
) -> Bench:
    """The bench of ``grids`` (all promises but tolerance) and ``off_grids`` (tolerance), each SCR and X/R."""
    settings = controller_settings(converter, filter_)
    delay, omega = converter.delay_samples, converter.omega_n
    nominal = plants(circuits(converter, filter_, grids, basis), settings, delay, omega)
    corner_sets = [
        plants(circuits(converter, filter_, off_grids, basis, L_1=1.0 + a, C=1.0 + b), settings, delay, omega)
        for a in (-OFF, OFF)
        for b in (-OFF, OFF)
    ]
    off = joined(corner_sets)
    order = np.arange(len(off.A)).reshape(4, -1).T.ravel()
    off = replace(off, A=off.A[order], b=off.b[order], sensors=off.sensors[order])
    both = joined([nominal, off])
    scales = np.array([1.0, 1.0 / converter.Z_base, 1.0 / converter.Z_base])
    return Bench(
        settings=settings,
        targets=targets(converter, settling_time),
        nominal=nominal,
        both=both,
        omega=frequencies(settings.T_s, points),
        scales=scales,
        grids=tuple(grids),
        off_grids=tuple(off_grids),
    )


def controller_settings(converter: Converter, filter_: Filter) -> ControllerSettings:
    """The sampled controller's constants; those of its gains (ω_t) and its limits have no say here."""
    return study_of(converter, filter_, InnerLoopGains(1.0, 1.0, 1.0, 1.0), converter.omega_n).controller_settings()


def evaluate(bench: Bench, gains: InnerLoopGains, omega_t: Array) -> Promises:
    """The promises of M gain sets (arrays (M,), SI; ω_t in rad/s) on every grid of the bench.

    ``tolerance`` is (M, H), each grid's worst corner.
    """
    law = law_matrix(gains, omega_t, bench.settings)
    M, G = len(law), len(bench.grids)
    every = modes(law, bench.both)
    nominal, off = every[:, :G], every[:, G:]
    growth = nominal.real.max(axis=-1)
    figures = np.full((M, G, len(FIGURES)), np.nan)
    stable = np.flatnonzero(growth.max(axis=1) < 0.0) if G else np.empty(0, dtype=int)
    if len(stable):
        figures[stable] = margins(law[stable], bench.nominal, nominal[stable], bench.omega, bench.scales)
    tolerance = least_damping(off).reshape(M, len(bench.off_grids), 4).min(axis=-1)
    return Promises(least_damping(nominal), -growth, figures[..., 0], figures[..., 1], figures[..., 2], tolerance)


def scores(promises: Promises, targets: Targets) -> Promises:
    """Every promise over its target, the same shapes: 1 and more is kept (:eq:`inner-score`)."""
    over = [value / target for value, target in zip(promises, targets, strict=True)]
    return Promises(*over)._replace(noise=targets.noise / promises.noise)


def worst_score(promises: Promises, targets: Targets) -> Array:
    """t (M,): the worst score over promises and grids (:eq:`inner-score`).

    Where a mode grows, on a nominal circuit or on one that is off, the scores of damping and tolerance alone, of which
    one is negative then: a search has a slope out of instability, and none of the two hides the other.
    """
    each = scores(promises, targets)
    damped = np.minimum(each.damping.min(axis=1), each.tolerance.min(axis=1))
    kept = np.min([score.min(axis=1) for score in each], axis=0)
    return np.where(damped > 0.0, kept, damped)


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
        return score_met(self.score)


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
