"""A proof over a region: a quadratic Lyapunov function for every grid, operating point and estimate error.

One function for all where the grid may jump, one that depends on the grid where its speed is bounded. Found at points,
by a cutting plane; verified at fresh points, by eigenvalues; proved between the points, on boxes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import CertificateCell
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.certificate.boxes import encloses
from vsgdesign.certificate.lyapunov import Family, Fit, Motion, best_fit, residual
from vsgdesign.certificate.proof import Outcome, prove, worst_points
from vsgdesign.certificate.region import (
    AtDesignPoint,
    MeasuredSchedule,
    Region,
    System,
    nodes,
    points_on_limits,
    random_points,
    region_faults,
)
from vsgdesign.certificate.results import (
    GAP_FREE,
    GRIDDED,
    Certificate,
    Counterexample,
    Gap,
    NoFunctionError,
    growing_mode,
)
from vsgdesign.errors import Fault, InfeasibleStudyError, StudyError
from vsgdesign.runtime.of_study import follows_measured, schedule_of
from vsgdesign.study.parameters.dc_link import without_voltage_droop
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_TOLERANCE = 0.005
"""Tolerance of the search for the decay, relative to the largest decay that any cell allows."""

_ROOM = 0.985
"""Share of the fitted decay that is claimed. The remainder allows a proof on boxes of finite size."""

_SHARES = (0.9, 0.8, 0.65, 0.5)
"""Shares of the decay at the points that are tried one after another in the proof between the points."""

_BUDGET = 1_500_000
"""Number of boxes after which the proof is given up and called gridded: 70 microseconds of a core each."""

_ATTEMPTS = 12
"""Number of functions that are tried on boxes."""

_HARDENINGS = 6
"""Number of searches for points at which a function does not hold, before it is tried on boxes."""

_LAST_SEARCHES = 4
"""Number of such searches that follow where the boxes leave gaps, so that the claim rests on points alone."""

_FAR = 1.0
"""Where the inequality holds with half of this share of the decay to spare, no worse place nearby is looked for: a
search moved the worst by up to a third of the decay in the proofs of a plant, and it took half of their time."""

_AT_LIMITS = 8
"""Grids along each axis at which points on the static limits are looked at."""

_NEAR, _FOLLOWED = 6, 120
"""Rounds of such a search that are left out among undecided boxes: its steps begin with a fortieth of the region. And
how many points it follows there, after every round of cuts."""


def certify(
    study: Study,
    spec: ControllerSpec,
    region: Region,
    *,
    ready: Ready = NOTHING,
    schedule: MeasuredSchedule | None = None,
    decay: float | None = None,
    apart: bool = False,
    placed: bool = False,
    shares: Sequence[float] = _SHARES,
    nodes_per_axis: int = 15,
    fresh: int = 20_000,
    seed: int = 0,
    budget: int = _BUDGET,
    progress: Callable[[str, float], None] | None = None,
) -> Certificate | Counterexample:
    """The largest decay that one Lyapunov function proves over the region, or a counterexample; or the proof of a
    ``decay`` (1/s) that is asked for, in less time.

    ``ready`` has the controller's gain table, where it takes its gains from one; ``schedule``: other gains to prove
    than the controller's. ``apart``: what is proved are the loops of equal units against each other in this region
    (:eq:`plant-certificate`). ``placed``: it is the proof of one place of the grid. ``shares``: of the decay at the
    points, which are tried one after another between them. An infinite ``region.rate`` asks for one function for all
    (:eq:`certificate`), a finite one for P(ρ) (:eq:`affine-lyapunov`). Points outside the static limits
    (:eq:`static-limits`) are not part of the region. A counterexample is returned where a cell is unstable by itself.
    Raises StudyError where the region or the decay is wrong, InfeasibleStudyError where the region is empty, where the
    controller is not scheduled or its table is not there, or where every cell that was looked at is stable but no
    function of the kind exists.
    """
    without_voltage_droop(study, "a certificate")
    system, motion = prepared(study, spec, region, ready, schedule, decay)
    system = replace(system, apart=apart, placed=placed)
    rng = np.random.default_rng(seed)
    at_limits = points_on_limits(system, region, _AT_LIMITS)
    points = np.concatenate([nodes(region, nodes_per_axis), random_points(region, fresh, rng), at_limits])
    if (why := system.emptiness(points)) is not None:
        raise InfeasibleStudyError(
            f"the region has no cell within the static limits: {why}. Widen the region, or ask for less power."
        )
    if (unstable := _unstable(system, motion, spec.name, points, seed)) is not None:
        return unstable
    verify, A_fresh = system.matrices(random_points(region, fresh, rng))
    boxes = budget if encloses(system) else 0
    attempt = proofs = 0
    while True:
        points, A = system.matrices(points)
        found = _fitted(system, motion, spec.name, points, A)
        if isinstance(found, Counterexample):
            return found
        # Where it holds worst is looked for, and joins in.
        if attempt < _HARDENINGS:
            attempt += 1
            P, goal = found.P, decay or shares[0] * found.decay
            worst, worth = worst_points(
                system, region, lambda at, A, P=P, goal=goal: residual(A, motion.family(at), P, goal), points, A, rng
            )
            if worth[0] >= 0.0:
                points = np.concatenate([points, worst[worth >= 0.0]])
                continue
        # Verified where nothing was fitted: new points, and a decay that gives way until it holds there.
        every, matrices = np.concatenate([points, verify]), np.concatenate([A, A_fresh])
        sampled, largest = _verified(matrices, motion.family(every), found, spec.name, decay)
        if not boxes:
            outcome = None
            break
        decays = [share * sampled for share in shares] if decay is None else [decay]
        outcome = proved_between(system, motion, found.P, decays, region, boxes, progress, seed + proofs)
        boxes -= outcome.seen
        proofs += 1
        if len(outcome.broken) == 0:
            break
        # The boxes found points at which the function does not hold: it is fitted to those, too, and if no boxes are
        # left what is claimed holds at them at least.
        points = np.concatenate([points, outcome.broken])
        boxes = 0 if proofs == _ATTEMPTS else max(boxes, 0)
    if progress is not None:
        progress("certificate", 1.0)
    complete = outcome is not None and len(outcome.left) == 0
    claimed = outcome.decay if outcome is not None and complete else sampled if decay is None else decay
    if not complete:
        every, claim = (every, matrices), (claimed, sampled)
        claimed, sampled, largest = _attacked(system, motion, found, spec.name, every, claim, decay, rng)
    elif claimed != sampled:
        largest = float(residual(matrices, motion.family(every), found.P, claimed).max())
    gap = Gap() if complete else _gap(outcome, largest)
    return Certificate(
        controller=spec.name,
        region=region,
        limits=system.static,
        decay=claimed,
        sampled=sampled,
        P=found.P,
        scale=system.scale,
        states=system.states,
        proof=GAP_FREE if complete else GRIDDED,
        gap=gap,
        checked=len(A),
        fresh=len(A_fresh),
        boxes=outcome.proved if outcome else 0,
        vertices=len(found.active),
        largest=largest,
    )


def _attacked(
    system: System,
    motion: Motion,
    fit: Fit,
    name: str,
    every: tuple[Array, Array],
    claim: tuple[float, float],
    asked: float | None,
    rng: np.random.Generator,
) -> tuple[float, float, float]:
    """What is left of a claim that rests on points (their matrices beside them) after a search for worse ones, what
    holds at all of them, and the largest eigenvalue there."""
    points, A = every
    claimed, sampled = claim
    for _ in range(_LAST_SEARCHES):

        def shortfall(at: Array, A: Array, goal: float = claimed) -> Array:
            return residual(A, motion.family(at), fit.P, goal)

        worst, worth = worst_points(system, motion.region, shortfall, points, A, rng)
        if worth[0] < 0.0:
            break
        worst, A_worst = system.matrices(worst[worth >= 0.0])
        points, A = np.concatenate([points, worst]), np.concatenate([A, A_worst])
        claimed = sampled = _verified(A, motion.family(points), fit, name, asked)[0]
    return claimed, sampled, float(residual(A, motion.family(points), fit.P, claimed).max())


def _verified(A: Array, family: Family, found: Fit, name: str, asked: float | None) -> tuple[float, float]:
    """A decay that holds at all cells, at most _ROOM of the fitted one, and the largest eigenvalue there.

    Raises InfeasibleStudyError where none holds, or less than the decay that is ``asked`` for."""
    decay = _ROOM * found.decay
    largest = float(residual(A, family, found.P, decay).max())
    while largest >= 0.0 and decay > 1e-3:
        decay *= 0.98
        largest = float(residual(A, family, found.P, decay).max())
    if largest >= 0.0:
        raise InfeasibleStudyError(
            f"controller {name}: the decay at the sampled points does not hold between them. Shrink the region."
        )
    if asked is not None and asked > decay:
        raise InfeasibleStudyError(
            f"controller {name}: decay = {asked:g} 1/s does not hold; at most {decay:.3g} 1/s does. Ask for less, or "
            "shrink the region, the error or the rate."
        )
    return decay, largest


def largest_rate(
    study: Study,
    spec: ControllerSpec,
    region: Region,
    decay: float,
    *,
    schedule: MeasuredSchedule | None = None,
    highest: float = 1e3,
    **options: Any,
) -> Certificate | Counterexample:
    """The certificate of the largest rate (to 5 %) at which a decay still holds, up to ``highest`` (1/s).

    Options are those of :func:`certify`. Raises InfeasibleStudyError where the decay does not hold even at rest.
    """
    low, high = 1e-3, highest
    quick = {**options, "budget": 0}

    def holds(rate: float) -> bool:
        try:
            found = certify(study, spec, replace(region, rate=rate), schedule=schedule, **quick)
        except InfeasibleStudyError:
            return False
        return isinstance(found, Certificate) and found.decay >= decay

    if not holds(low):
        raise InfeasibleStudyError(
            f"controller {spec.name}: decay = {decay:g} 1/s does not hold even on a constant grid. Ask for less."
        )
    while high / low > 1.05:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if holds(middle) else (low, middle)
    return certify(study, spec, replace(region, rate=low), schedule=schedule, **options)


def prepared(
    study: Study,
    spec: ControllerSpec,
    region: Region,
    ready: Ready,
    schedule: MeasuredSchedule | None,
    decay: float | None,
) -> tuple[System, Motion]:
    faults = region_faults(region)
    if decay is not None and not 0.0 < decay < np.inf:
        faults.append(Fault("decay", f"{decay:g}", "must be more than zero, in 1/s"))
    if faults:
        raise StudyError(study.name, faults)
    if schedule is None:
        if spec.gains is not None or spec.kind != "scheduled":
            raise InfeasibleStudyError(f"controller {spec.name}: a certificate is made for a scheduled controller.")
        schedule = schedule_of(study, spec, ready)
        if not follows_measured(spec):
            schedule = AtDesignPoint(schedule)
    return System(study.with_limit_of(spec), schedule, region), Motion(region, bool(np.isfinite(region.rate)))


def _fitted(system: System, motion: Motion, name: str, points: Array, A: Array) -> Fit | Counterexample:
    if len(A) == 0:
        raise InfeasibleStudyError("no estimate of the region lies within the axes of the table: widen it.")
    slowest = _slowest(system, motion, name, points, A)
    if isinstance(slowest, Counterexample):
        return slowest
    limit, where = slowest
    best, _ = best_fit(A, motion.family(points), limit, _TOLERANCE)
    if best is None:
        kind = "function of this rate" if motion.moving else "common quadratic function"
        raise NoFunctionError(
            f"controller {name}: every cell that was looked at is stable (slowest {limit:.3g} 1/s), but no {kind} "
            "exists. Shrink the region, the error or the rate.",
            CertificateCell(**where, decay=limit),
        )
    return best


def _slowest(
    system: System, motion: Motion, name: str, points: Array, A: Array
) -> tuple[float, dict[str, float]] | Counterexample:
    """The least decay of all cells and its place, or the cell that is unstable by itself."""
    least = np.linalg.eigvals(A).real.max(axis=1)
    worst = int(np.argmax(least))
    limit = -float(least[worst])
    weakness, angle, P, Q, e_R, e_L = (float(v) for v in points[worst])
    scr, ratio = 1.0 / weakness, float(np.tan(angle))
    if limit <= 0.0:
        value, trajectory = growing_mode(A[worst], system.scale)
        return Counterexample(
            controller=name,
            region=motion.region,
            limits=system.static,
            scr=scr,
            x_over_r=ratio,
            P=P,
            Q=Q,
            error_R=e_R,
            error_L=e_L,
            eigenvalue=value,
            trajectory=trajectory,
        )
    return limit, {"scr": scr, "x_over_r": ratio, "P": P, "Q": Q, "error_R": e_R, "error_L": e_L}


def _unstable(system: System, motion: Motion, name: str, points: Array, seed: int) -> Counterexample | None:
    """The cell that grows fastest, of some points and of where a search from the slowest of them leads; None where none
    grows.

    It is a counterexample, also where other points have no gains at all. A function is looked for where there is none:
    that takes much longer than this search, but in a place of the grid. Raises the error of :meth:`System.cells`.
    """
    with_gains = system.matrices(points, partial=True)
    if len(with_gains[0]) == 0:
        return None
    found = _slowest(system, motion, name, *with_gains)
    unstable = found if isinstance(found, Counterexample) else None
    if system.placed:
        return unstable
    rng = np.random.default_rng(seed)
    try:
        points, A = system.matrices(points)
        worst, _ = worst_points(
            system, motion.region, lambda _, A: np.linalg.eigvals(A).real.max(axis=1), points, A, rng
        )
    except InfeasibleStudyError:
        if unstable is None:
            raise
        return unstable
    found = _slowest(system, motion, name, *system.matrices(worst))
    return found if isinstance(found, Counterexample) else None


def proved_between(
    system: System,
    motion: Motion,
    P: Array,
    decays: Sequence[float],
    region: Region,
    budget: int,
    progress: Callable[[str, float], None] | None,
    seed: int,
) -> Outcome:
    """The proof on boxes. Among places in undecided boxes the worst are moved to worse ones nearby, unless all hold
    with room: where the function does not hold, that is seen long before a cut hits the point."""
    rng = np.random.default_rng(seed)

    def failing(points: Array, at: float) -> Array:
        points, A = system.matrices(points)
        worth = residual(A, motion.family(points), P, at)
        if len(points) and -_FAR * at <= worth.max() < 0.0:
            points, worth = worst_points(
                system,
                region,
                lambda near, A: residual(A, motion.family(near), P, at),
                points,
                A,
                rng,
                _NEAR,
                _FOLLOWED,
            )
        return points[worth >= 0.0]

    return prove(system, region, motion.weights, failing, P, decays, budget, progress, seed)


def _gap(outcome: Outcome | None, largest: float) -> Gap:
    if outcome is None:
        return Gap(1.0, (1.0,) * 6, -0.5 * largest)
    low, high = outcome.whole.low.min(axis=0), outcome.whole.high.max(axis=0)
    width = np.where(high > low, high - low, 1.0)
    size = (outcome.left.high - outcome.left.low) / width
    volume = np.where(high > low, size, 1.0).prod(axis=1)
    k = int(np.argmax(volume))
    return Gap(float(volume.sum()), tuple(float(v) for v in size[k]), -0.5 * largest)
