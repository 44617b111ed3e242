"""The set of disturbances: a systematic part that never changes, and random ones from a seed.

All values are per unit, so one set serves every converter. Cases without an operating point are part of it: a run
leaves them out and says why.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from vsgdesign.simulation.survival.cases import FOR_EVER, GridKnowledge, GridState, SurvivalCase
from vsgdesign.study.parameters.dc_link import DcLink, not_of
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.network_fields import OPEN

WEAK, STRONG = (1.2, 1.5, 2.0, 5.0), 20.0
"""Short-circuit ratios between which the grid jumps."""

X_OVER_R = (0.3, 1.0, 3.0, 10.0, 20.0)
STALE_S = (0.02, 0.2, 1.0)
PLACES = (
    (2.0, 3.0, 0.5),
    (2.0, 10.0, 0.7),
    (5.0, 0.5, 0.4),
    (5.0, 1.0, -0.5),
    (5.0, 3.0, 0.7),
    (20.0, 3.0, -0.7),
    (20.0, 10.0, 0.9),
)
"""SCR, X/R and P_ref (pu) of composed disturbances."""

LOADS = ((3.0, 0.5), (10.0, 0.9), (1.0, -0.5))
"""X/R and P_ref (pu) of plain disturbances, each at several SCR."""

_SWITCHED = ((1.5, 10.0, 20.0, 0.3), (1.5, 0.3, 20.0, 10.0), (2.0, 3.0, 20.0, 0.3), (2.0, 0.3, 20.0, 3.0))
_SWITCHED += ((2.0, 10.0, 20.0, 1.0), (2.0, 1.0, 20.0, 20.0), (1.2, 20.0, 20.0, 3.0), (5.0, 10.0, 20.0, 0.3))
_ALIKE = ((5.0, 0.3, 5.0, 20.0), (5.0, 20.0, 5.0, 0.3))
X_OVER_R_JUMPS = (*_SWITCHED, *((scr, x, to, r) for to, r, scr, x in _SWITCHED), *_ALIKE)
"""SCR and X/R before and after: both ways, and of X/R alone."""

_LOSS_SCR, _LOSS_X_OVER_R, _LOSS_P = (1.2, 1.5, 2.0, 5.0, 20.0), (1.0, 3.0, 10.0), (-0.7, 0.3, 0.9)

ERRORS = tuple((m, a) for m, a in itertools.product((0.8, 1.0, 1.2), (-10.0, 0.0, 10.0)) if (m, a) != (1.0, 0.0))
"""Errors of the estimate: |Z| over the true one, and degrees."""


def fixed_set() -> tuple[SurvivalCase, ...]:
    """The systematic part, always the same."""
    parts = (_jumps, _joint_jumps, _phase_jumps, _sags, _composed_sags, _swells, _frequencies, _references, _errors)
    return tuple(case for part in parts for case in part())


def dc_set(link: DcLink | None) -> tuple[SurvivalCase, ...]:
    """What may become of the source of a dc link: half of it is lost, a jump of the phase follows, it is empty, and
    clouds come and go. None of an ideal link."""
    losses: dict[str, tuple[Event, ...]] = {
        "dc_power": (Event.of_pu(0.0, dc_power=0.5), Event.of_pu(0.2, phase_deg=-15.0)),
        "dc_charge": (Event.of_pu(0.0, dc_charge=0.0),),
        "irradiance": (Event.of_pu(0.0, irradiance=400.0), Event.of_pu(1.0, irradiance=1000.0)),
    }
    known = [changes for quantity, changes in losses.items() if not_of(link, quantity) is None]
    found = []
    for (scr, x, P), share, changes in itertools.product(PLACES, (1.0, 0.4, -0.4), known):
        found.append(_case("dc source", _start(scr, x, round(share * P, 3)), *changes))
    return tuple(found)


def random_set(seed: int, count: int) -> tuple[SurvivalCase, ...]:
    """``count`` random cases: random grids, powers, sizes, instants, delays and errors of the estimate."""
    rng = np.random.default_rng(seed)
    return tuple(_DRAWN[int(rng.integers(len(_DRAWN)))](rng) for _ in range(count))


def plant_set(cases: Iterable[SurvivalCase], units: int) -> Iterator[SurvivalCase]:
    """Cases of one converter for a plant of so many equal units; then the loss of one of them at rest, and with the
    clearing of a sag. Short-circuit ratios are those of a unit with all units on line."""
    yield from cases
    if units == 1:
        return
    lost = [Event.of_pu(0.0, element=f"unit{k}", breaker=OPEN) for k in (1, units)]
    for k, (scr, x, P, silent_s) in enumerate(itertools.product(_LOSS_SCR, _LOSS_X_OVER_R, _LOSS_P, STALE_S)):
        yield _case("loss of a unit", _start(scr, x, P), lost[k % 2], silent_s=silent_s)
    for k, ((scr, x, P), V) in enumerate(itertools.product(PLACES, (0.0, 0.05, 0.2, 0.5))):
        begun, back = _sag(V, 0.15)
        gone = replace(lost[k % 2], t_s=back.t_s)
        yield _case("sag with loss of a unit", _start(scr, x, P), begun, back, gone)


def _start(scr: float, x_over_r: float, P_pu: float, Q_pu: float = 0.0) -> GridState:
    return GridState(scr=scr, x_over_r=x_over_r, P_pu=P_pu, Q_pu=Q_pu)


def _case(
    group: str, start: GridState, *changes: Event, silent_s: float = 0.2, error: tuple[float, float] = (1.0, 0.0)
) -> SurvivalCase:
    return SurvivalCase(
        group=group,
        start=start,
        changes=changes,
        cleared_s=max(change.end_s for change in changes),
        knowledge=GridKnowledge(silent_s=silent_s, magnitude=error[0], angle_deg=error[1]),
    )


def _to(scr: float, x_over_r: float, t_s: float = 0.0, phase_deg: float = 0.0) -> Event:
    return Event.of_pu(t_s, scr=scr, x_over_r=x_over_r, phase_deg=phase_deg)


def _jumps() -> Iterator[SurvivalCase]:
    """SCR alone, both ways; Q_ref takes turns."""
    powers = ((-0.9, 0.0), (-0.5, 0.3), (0.5, -0.3), (0.9, 0.0), (0.5, 0.3))
    for scr, x, (P, Q) in itertools.product(WEAK, X_OVER_R, powers):
        for silent_s in (*STALE_S, FOR_EVER):
            ever = math.isinf(silent_s)
            up, down = ("jump up for ever", "jump down for ever") if ever else ("jump up", "jump down")
            yield _case(up, _start(scr, x, P, Q), _to(STRONG, x), silent_s=silent_s)
            yield _case(down, _start(STRONG, x, P, Q), _to(scr, x), silent_s=silent_s)


def _joint_jumps() -> Iterator[SurvivalCase]:
    for (a, xa, b, xb), P in itertools.product(X_OVER_R_JUMPS, (-0.7, -0.4, 0.4, 0.7)):
        for silent_s in (*STALE_S, FOR_EVER):
            group = "jump of X/R for ever" if math.isinf(silent_s) else "jump of X/R"
            yield _case(group, _start(a, xa, P), _to(b, xb), silent_s=silent_s)


def _phase_jumps() -> Iterator[SurvivalCase]:
    sizes = (10, 30, 60, 90, 120, 150, 180)
    for scr, (x, P), size in itertools.product((1.5, 5.0, 20.0), (*LOADS, (20.0, 0.2)), sizes):
        group = "phase to 60°" if size <= 60 else "phase 90–180°"
        for sign in (-1.0, 1.0) if size < 180 else (1.0,):
            yield _case(group, _start(scr, x, P), Event.of_pu(0.0, phase_deg=sign * size))


def _sag(V_g_pu: float, length_s: float, phase_deg: float = 0.0, t_s: float = 0.0) -> tuple[Event, Event]:
    """A sag and its clearing. The jump of the phase goes back at the clearing."""
    return (
        Event.of_pu(t_s, V_g_pu=V_g_pu, phase_deg=phase_deg),
        Event.of_pu(t_s + length_s, V_g_pu=1.0, phase_deg=-phase_deg),
    )


def _sags() -> Iterator[SurvivalCase]:
    for V, length in itertools.product((0.7, 0.5, 0.2, 0.05, 0.0), (0.05, 0.15, 0.5, 1.0)):
        for scr, (x, P) in itertools.product((2.0, 5.0, 20.0), LOADS):
            yield _case("sag", _start(scr, x, P), *_sag(V, length))


def _composed_sags() -> Iterator[SurvivalCase]:
    for (scr, x, P), V in itertools.product(PLACES, (0.0, 0.05, 0.2, 0.5)):
        start = _start(scr, x, P)
        for phase in (-30.0, 30.0):
            yield _case("sag with phase", start, *_sag(V, 0.25, phase))
        # Protection opens a line: the grid is weaker afterwards, and its angle is another.
        begun, weaker = Event.of_pu(0.0, V_g_pu=V), {2.0: 1.5, 5.0: 2.0, 20.0: 5.0}[scr]
        for group, after, phase in (("sag with trip", weaker, -10.0), ("sag with jump up", STRONG, 15.0)):
            cleared = Event.of_pu(0.15, V_g_pu=1.0, scr=after, x_over_r=x, phase_deg=phase)
            yield _case(group, start, begun, cleared)
        three = [change for k in range(3) for change in _sag(V, 0.15, t_s=0.35 * k)]
        yield _case("repeated sags", start, *three)


def _swells() -> Iterator[SurvivalCase]:
    for (scr, x, P), V in itertools.product(PLACES, (1.1, 1.15, 1.2)):
        yield _case("swell", _start(scr, x, P), *_sag(V, 0.5))


def _frequencies() -> Iterator[SurvivalCase]:
    for scr, (x, P) in itertools.product((1.5, 5.0, 20.0), ((3.0, 0.5), (10.0, 0.2), (1.0, -0.5))):
        start = _start(scr, x, P)
        for df in (-0.5, 0.5):
            yield _case("frequency", start, Event.of_pu(0.0, df_hz=df))
        for rate, sign in itertools.product((1.0, 2.0, 4.0), (-1.0, 1.0)):
            away = Event.of_pu(0.0, df_hz=sign, over_s=1.0 / rate)
            back = Event.of_pu(1.0 / rate + 1.0, df_hz=0.0, over_s=1.0 / rate)
            yield _case("frequency", start, away, back)


def _references() -> Iterator[SurvivalCase]:
    for scr, x in itertools.product((1.5, 2.0, 5.0, 20.0), (1.0, 3.0, 10.0)):
        for sign in (-1.0, 1.0):
            over, back = Event.of_pu(0.0, P_pu=1.5 * sign), Event.of_pu(1.5, P_pu=0.5 * sign)
            yield _case("overload", _start(scr, x, 0.5 * sign), over, back)
            yield _case("reference", _start(scr, x, 0.1 * sign), Event.of_pu(0.0, P_pu=0.9 * sign))
            yield _case("reference", _start(scr, x, -0.4 * sign), Event.of_pu(0.0, P_pu=0.4 * sign, Q_pu=0.3 * sign))


def _errors() -> Iterator[SurvivalCase]:
    """A wrong estimate, at all times, with one of every kind of disturbance."""
    for (x, P), error in itertools.product(LOADS, ERRORS):
        for scr in (1.5, 2.0, 5.0):
            yield _case("wrong estimate", _start(scr, x, P), _to(STRONG, x), error=error)
            yield _case("wrong estimate", _start(STRONG, x, P), _to(scr, x), error=error)
        for scr, V in ((2.0, 0.05), (2.0, 0.2), (20.0, 0.05)):
            yield _case("wrong estimate", _start(scr, x, P), *_sag(V, 0.25), error=error)
        for phase in (-60.0, 60.0):
            yield _case("wrong estimate", _start(5.0, x, P), Event.of_pu(0.0, phase_deg=phase), error=error)


RANDOM = "random"
"""Group of every random case."""


def _drawn(rng: np.random.Generator, *changes: Event) -> SurvivalCase:
    """A random case of given changes: its start, its instant within a cycle, its delay and its error."""
    offset = _uniform(rng, 0.0, 0.02)
    moved = tuple(replace(change, t_s=round(change.t_s + offset, 6)) for change in changes)
    scr, x_over_r = _place(rng)
    start = GridState(
        scr=scr,
        x_over_r=x_over_r,
        P_pu=_uniform(rng, -0.9, 0.9),
        Q_pu=_uniform(rng, -0.3, 0.3),
        V_g_pu=_uniform(rng, 0.95, 1.05),
        df_hz=_uniform(rng, -0.2, 0.2),
    )
    # What begins beside nominal goes back there, not to nominal.
    moved = tuple(replace(one, V_g_rms=start.V_g_pu) if one.V_g_rms == 1.0 else one for one in moved)
    error = _uniform(rng, 0.8, 1.2), _uniform(rng, -10.0, 10.0)
    return _case(RANDOM, start, *moved, silent_s=_logarithmic(rng, 0.02, 1.0), error=error)


def _uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 4)


def _logarithmic(rng: np.random.Generator, low: float, high: float) -> float:
    return float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.4g}")


def _place(rng: np.random.Generator) -> tuple[float, float]:
    return _logarithmic(rng, 1.2, 20.0), _logarithmic(rng, 0.3, 20.0)


def _drawn_jump(rng: np.random.Generator) -> SurvivalCase:
    return _drawn(rng, _to(*_place(rng), phase_deg=_uniform(rng, -30.0, 30.0)))


def _drawn_phase(rng: np.random.Generator) -> SurvivalCase:
    return _drawn(rng, Event.of_pu(0.0, phase_deg=_uniform(rng, -180.0, 180.0)))


def _drawn_sag(rng: np.random.Generator) -> SurvivalCase:
    phase = _uniform(rng, -60.0, 60.0)
    return _drawn(rng, *_sag(_uniform(rng, 0.0, 0.8), _logarithmic(rng, 0.05, 1.0), phase))


def _drawn_trip(rng: np.random.Generator) -> SurvivalCase:
    scr, x_over_r = _place(rng)
    begun = Event.of_pu(0.0, V_g_pu=_uniform(rng, 0.0, 0.8))
    cleared = Event.of_pu(
        _logarithmic(rng, 0.05, 0.5), V_g_pu=1.0, scr=scr, x_over_r=x_over_r, phase_deg=_uniform(rng, -30.0, 30.0)
    )
    return _drawn(rng, begun, cleared)


def _drawn_pair(rng: np.random.Generator) -> SurvivalCase:
    """There and back, or on: two jumps close together."""
    return _drawn(rng, _to(*_place(rng)), _to(*_place(rng), t_s=_logarithmic(rng, 0.05, 0.5)))


def _drawn_repeated(rng: np.random.Generator) -> SurvivalCase:
    apart, count = _uniform(rng, 0.3, 0.6), int(rng.integers(2, 5))
    sags = [_sag(_uniform(rng, 0.0, 0.8), _uniform(rng, 0.05, 0.25), t_s=round(apart * k, 6)) for k in range(count)]
    return _drawn(rng, *(change for sag in sags for change in sag))


def _drawn_swell(rng: np.random.Generator) -> SurvivalCase:
    return _drawn(rng, *_sag(_uniform(rng, 1.06, 1.2), _logarithmic(rng, 0.05, 1.0)))


def _drawn_ramp(rng: np.random.Generator) -> SurvivalCase:
    df, over = _uniform(rng, -1.0, 1.0), _uniform(rng, 0.25, 1.0)
    away = Event.of_pu(0.0, df_hz=df, over_s=over)
    return _drawn(rng, away, Event.of_pu(round(over + _uniform(rng, 0.0, 1.0), 6), df_hz=0.0, over_s=over))


def _drawn_reference(rng: np.random.Generator) -> SurvivalCase:
    return _drawn(rng, Event.of_pu(0.0, P_pu=_uniform(rng, -0.9, 0.9), Q_pu=_uniform(rng, -0.3, 0.3)))


_DRAWN: tuple[Callable[[np.random.Generator], SurvivalCase], ...] = (
    _drawn_jump,
    _drawn_jump,
    _drawn_phase,
    _drawn_sag,
    _drawn_trip,
    _drawn_pair,
    _drawn_repeated,
    _drawn_swell,
    _drawn_ramp,
    _drawn_reference,
)
"""Jumps are drawn twice as often as the others."""
