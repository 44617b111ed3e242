"""The map of a controller's large-signal statement over SCR and X/R, as data and as a document."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.certificate.box_check import UNDECIDED, Look, cover
from vsgdesign.certificate.boxes import Boxes, basis_of, drop_sq, encloses, relative_errors, whole_region
from vsgdesign.certificate.region import Region, System, region_faults
from vsgdesign.certificate.swing.check import (
    SwingLoops,
    edge_holds,
    gains_hold,
    limited_holds,
    looks,
    rest_holds,
    with_angle,
)
from vsgdesign.certificate.swing.conditions import SwingLaw, gains_tests, limited_tests, rest_tests
from vsgdesign.equations.frames import PHASES, rms_to_peak
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.limiters.projection import PROJECTION, ProjectionConstants
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import ANGLE_DAMPED
from vsgdesign.errors import Fault, InfeasibleStudyError, StudyError
from vsgdesign.runtime.of_study import schedule_of
from vsgdesign.study.parameters.study import ControllerSpec, Study


@dataclass(frozen=True)
class SwingStart:
    """From where the swing starts: |δ| up to ``angle`` (rad) and a frequency within ± ``speed`` (rad/s) of the grid's.
    ``angle_error`` is the largest error of the impedance angle, rad.

    The default angle is 172°: on the weakest grids the pull vanishes at 180°. The default speed is 1 Hz.
    """

    angle: float = math.radians(172.0)
    speed: float = 2.0 * math.pi
    angle_error: float = 0.0


RETURNS = "proved"
FAILS = "counterexample"
OPEN = "not proved"
EMPTY = "no operating point"


@dataclass(frozen=True)
class SwingPoint:
    """A point at which one of the conditions does not hold: ``condition`` says which. ``delta`` is the angle there in
    rad: of the unstable rest, or the one at which the function rises; None where no angle belongs to it."""

    condition: str
    scr: float
    x_over_r: float
    P: float
    Q: float
    delta: float | None = None


@dataclass(frozen=True)
class SwingPart:
    """One part of the map. ``grade`` is ``proved`` (of every operating point in the part), ``counterexample`` (``at``
    one point a condition does not hold), ``not proved`` (neither was found with the given number of boxes) or ``no
    operating point`` (none lies within the static limits and 0.9 of the current limit).
    ``undecided`` names the first condition that is not proved."""

    scr: tuple[float, float]
    x_over_r: tuple[float, float]
    grade: str
    boxes: int
    undecided: str = ""
    at: SwingPoint | None = None


@dataclass(frozen=True, kw_only=True)
class SwingStatement:
    """From which grids the limited swing returns to its rest (docs/theory/large-signal.md, which states what this
    assumes: V held, gains held, a quasi-static network, an ideal current loop). It holds from every ``start``."""

    controller: str
    region: Region
    law: SwingLaw
    start: SwingStart
    parts: tuple[SwingPart, ...]

    def count(self, grade: str) -> int:
        """How many parts have a grade."""
        return sum(part.grade == grade for part in self.parts)

    @property
    def proved(self) -> bool:
        """Whether every part that has an operating point is proved."""
        return self.count(RETURNS) == len(self.parts) - self.count(EMPTY) > 0

    def as_document(self) -> dict[str, Any]:
        """JSON's types, the same for the same inputs."""
        return plain(
            {
                "proved": self.proved,
                "controller": self.controller,
                "region": self.region.as_document(),
                "law": asdict(self.law),
                "start": asdict(self.start),
                "parts": [asdict(part) for part in self.parts],
            }
        )


Array = NDArray[np.float64]

_TRIED = 64, 2048
"""Fewest and most places in undecided boxes that are looked at after a round of cuts; else one for every four boxes."""

_PART = 1.6, 2.0
"""Ratio of the ends of a part of the map: of its SCR, of its X/R."""

_EDGE = 10_000
"""Boxes for each edge. It has one coordinate less; where it holds at all, some hundred boxes are enough."""

_CONFIRMED = 32
"""Of those at which a condition fails, how many the equations look at."""


def swing_law(study: Study, spec: ControllerSpec) -> SwingLaw:
    """The limiter's parameters of a controller. Raises InfeasibleStudyError if its limiter is not the projection."""
    own = study.with_limit_of(spec)
    settings, c = own.controller_settings(), own.converter
    limiter = settings.limiter
    if not isinstance(limiter, ProjectionConstants) or c.current_limit_pu is None:
        raise InfeasibleStudyError(
            f"controller {spec.name}: the large-signal statement is about a current limit by the limiter "
            f'"{PROJECTION.name}", and this one has "{own.current_limiter}" with current_limit_pu = '
            f"{c.current_limit_pu or 'none'}."
        )
    return SwingLaw(
        i_soft=limiter.i_soft_pk / c.I_rated_pk,
        i_max=c.current_limit_pu,
        Z_v=limiter.Z_v / c.Z_base,
        tau=-settings.T_s / math.log1p(-limiter.share),
        g=limiter.g,
        largest_pull=limiter.largest_pull / settings.T_s,
        v_gate=limiter.v_gate_pk / rms_to_peak(c.V_rated_rms),
        doubt=limiter.doubt,
    )


def swing_statement(
    study: Study,
    spec: ControllerSpec,
    region: Region,
    *,
    ready: Ready = NOTHING,
    law: SwingLaw | None = None,
    parts: tuple[int, int] | None = None,
    start: SwingStart | None = None,
    budget: int = 1_500_000,
    progress: Callable[[str, float], None] | None = None,
) -> SwingStatement:
    """Proves, part by part of a map over SCR and X/R, that the limited swing returns to its rest, or shows where a
    condition fails.

    ``law`` is that of the controller's limiter unless given. ``parts`` is the number of parts along SCR and X/R; None
    makes their ends differ by a factor of about 1.6 and 2. Each part has its share of ``budget`` boxes.
    Raises StudyError for a wrong region, and InfeasibleStudyError for a controller without this limiter or whose gains
    cannot be enclosed.
    """
    start = start or SwingStart()
    if parts is None:
        parts = _count(region.scr, _PART[0]), _count(region.x_over_r, _PART[1])
    faults = region_faults(region)
    if not 0.0 < start.angle < math.pi:
        faults.append(Fault("angle", f"{start.angle:g}", "must lie between 0 and π rad"))
    if not 0.0 <= start.speed < math.inf:
        faults.append(Fault("speed", f"{start.speed:g}", "must be zero or more, in rad/s"))
    if not 0.0 <= start.angle_error < 0.5:
        faults.append(Fault("angle_error", f"{start.angle_error:g}", "must be from 0 to 0.5 rad"))
    if min(parts) < 1:
        faults.append(Fault("parts", f"{parts[0]}, {parts[1]}", "must be two numbers of at least 1"))
    if faults:
        raise StudyError(study.name, faults)
    law = swing_law(study, spec) if law is None else law
    system = System(study.with_limit_of(spec), schedule_of(study, spec, ready))
    if not encloses(system):
        raise InfeasibleStudyError(f"controller {spec.name}: its gains cannot be enclosed on boxes.")
    along = _edges(region.scr, parts[0]), _edges(region.x_over_r, parts[1])
    share = budget // (len(along[0]) * len(along[1]))
    found: list[SwingPart] = []
    for scr in along[0]:
        for x_over_r in along[1]:
            here = replace(region, scr=scr, x_over_r=x_over_r)
            found.append(_part(system, here, law, start, share))
            if progress is not None:
                progress("large-signal statement", len(found) / (len(along[0]) * len(along[1])))
    return SwingStatement(
        controller=spec.name,
        region=region,
        law=law,
        start=start,
        parts=tuple(found),
    )


def large_signal(
    study: Study,
    spec: ControllerSpec,
    region: Region,
    *,
    ready: Ready = NOTHING,
    budget: int = 1_500_000,
    progress: Callable[[str, float], None] | None = None,
) -> SwingStatement | None:
    """The statement of an angle-damped controller that limits its current by the projection; None for any other."""
    own = study.with_limit_of(spec)
    schedule: Any = schedule_of(study, spec, ready)
    if own.current_limiter != PROJECTION.name or own.converter.current_limit_pu is None or budget == 0:
        return None
    if schedule.structure != ANGLE_DAMPED.name:
        return None
    return swing_statement(study, spec, region, ready=ready, budget=budget, progress=progress)


def _count(limits: tuple[float, float], ratio: float) -> int:
    """How many parts a range has. A range that is wrong is named with the other faults."""
    low, high = limits
    return max(round(math.log(high / low) / math.log(ratio)), 1) if 0.0 < low <= high < math.inf else 1


def _edges(limits: tuple[float, float], count: int) -> list[tuple[float, float]]:
    low, high = limits
    if low == high:
        return [limits]
    inner = np.geomspace(low, high, count + 1)[1:-1]
    return list(pairwise([low, *map(float, inner), high]))


def _part(system: System, region: Region, law: SwingLaw, start: SwingStart, budget: int) -> SwingPart:
    """The conditions one after another, the cheap ones first."""
    exact, angle, error = replace(region, error=0.0, error_Z=0.0), start.angle, start.angle_error
    estimates, grids = whole_region(system, region), whole_region(system, exact)
    stages = [
        ("gains", gains_tests(system, region, law), gains_hold, estimates),
        ("rest", rest_tests(system, exact, law), rest_holds, with_angle(grids, 0.0, 0.0, error)),
    ]
    sides = [with_angle(grids, *side, error) for side in ((-angle, -angle), (angle, angle))]
    limited = limited_tests(system, exact, law)
    stages += [("edge", limited, edge_holds(law, angle, start.speed), side) for side in sides]
    sides = [with_angle(grids, *side, error) for side in ((-angle, 0.0), (0.0, angle))]
    stages += [("falling", limited, limited_holds(law), side) for side in sides]
    seen, some = 0, False
    for name, tests, holds, boxes in stages:
        look = looks(system, tests, boxes, holds)
        broken: list[SwingPoint] = []

        def stop(left: Boxes, name: str = name, look: Look = look, broken: list[SwingPoint] = broken) -> bool:
            point = _broken(system, law, name, look, left)
            broken.extend([] if point is None else [point])
            return point is not None

        outcome = cover(look, boxes, min(budget - seen, _EDGE if name == "edge" else budget), stop)
        seen += outcome.seen
        if broken:
            return SwingPart(region.scr, region.x_over_r, FAILS, seen, name, broken[0])
        if len(outcome.left):
            return SwingPart(region.scr, region.x_over_r, OPEN, seen, name)
        some |= name == "rest" and outcome.proved > 0
    return SwingPart(region.scr, region.x_over_r, RETURNS if some else EMPTY, seen)


def _broken(system: System, law: SwingLaw, name: str, look: Look, left: Boxes) -> SwingPoint | None:
    """A point in boxes that are left at which a condition fails, by the equations themselves."""
    if name == "edge":
        return None
    rng = np.random.default_rng(len(left))
    count = int(np.clip(len(left) // 4, *_TRIED))
    index = rng.choice(len(left), count)
    share = rng.uniform(0.0, 1.0, (count, left.low.shape[1]))
    share[::2] = np.round(share[::2])  # corners
    places = left.low[index] + share * (left.high - left.low)[index]
    chosen = Boxes(places, places, left.piece[index], left.errors)
    state, _ = look(chosen)
    if name == "gains":  # the last coordinates are those of the errors
        places = np.column_stack([places[:, :4], *relative_errors(chosen, places)])
    for place in places[state == UNDECIDED][:_CONFIRMED]:
        loops, point = loops_at(system, law, place, name == "gains")
        delta: float | None = None
        if name == "gains":
            g = loops.gains
            fails = g.K_ip <= 0.0 or g.k_P < 0.0 or loops.kept <= 0.0
        elif name == "rest":
            delta = loops.unstable_rest()
            fails = loops.limited(delta).phi == 0.0
        else:
            delta = float(place[4])
            fails = max(loops.slope(delta, s) for s in np.linspace(-20.0, 20.0, 41)) > 1e-6
        if fails:
            return replace(point, condition=name, delta=delta)
    return None


def loops_at(system: System, law: SwingLaw, place: Array, wrong: bool) -> tuple[SwingLoops, SwingPoint]:
    """The swing at one point of the boxes; ``wrong``: the last two coordinates are errors of R̂ and L̂."""
    c, f, source = system.study.converter, system.study.filter, system.study.grid_source
    first, angle, p, q = place[:4]
    size = basis_of(system).magnitude(first, np.sin(angle)) * c.Z_base
    R_hat, X_hat = size * np.cos(angle), size * np.sin(angle)
    R_g, X_g = (R_hat / (1.0 + place[4]), X_hat / (1.0 + place[5])) if wrong else (R_hat, X_hat)
    R, X = R_g + f.R_2, source.omega_g * (X_g / c.omega_n + f.L_2)
    V = source.V_g_rms / math.sqrt(drop_sq(R / size, X / size, p, q))
    P, Q = float(p * V * V / size), float(q * V * V / size)
    gains = system.schedule.gains_measured(R_hat, X_hat / c.omega_n, P, Q, V)
    gains = PowerLoopGains(*(float(value) for value in gains))
    I_rated = c.S_rated / (PHASES * c.V_rated_rms)
    error = 0.0 if wrong else float(place[5])
    loops = SwingLoops(R, X, V, source.V_g_rms, P, Q, gains, law, I_rated, c.Z_base, error)
    scr = c.Z_base / float(SCR_BASES[system.study.scr_basis].counted(R_g, X_g))
    return loops, SwingPoint("", scr, float(X_g / R_g), P, Q)
