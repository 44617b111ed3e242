"""Steps after which no limit acts: level sets of a function for all gains at a place (:eq:`moving-level`)."""

from __future__ import annotations

import time
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.full_order.statement import half_of
from vsgdesign.certificate.lyapunov import Family, Level, fit, move_factor
from vsgdesign.certificate.moving.places import MovingLoops, estimates, loops_at, middle_error, with_estimates
from vsgdesign.certificate.region import Region, System
from vsgdesign.certificate.step_terms import STEPS, acting_limits
from vsgdesign.equations.frames import SQRT_2
from vsgdesign.equations.limiters.projection import LOW_VOLTAGE, current_at_reference
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.full_order import pack, watched_at
from vsgdesign.linear.operating_point.many import Lanes, ManyStates, many_steady_states
from vsgdesign.study.parameters.study import Study

_FIRST = 0
"""Of the matrices of a place: that of the middle of its estimates, in whose modes the numbers are of one size."""

_TOGETHER = 10
"""Matrices that the semidefinite program begins with."""


def modal(A: Array) -> Array:
    """The function (n, n) that is the sum of the squares of all modes of A (:eq:`moving-modal`)."""
    _, vectors = np.linalg.eig(A)
    inverse = np.linalg.inv(vectors)
    P = (inverse.conj().T @ inverse).real
    return 0.5 * (P + P.T)


def shortfall(A: Array, P: Array, rho: float) -> float:
    """The largest eigenvalue of AᵀPA − ρ²P over matrices (M, n, n), relative to ρ²P: below zero where P falls."""
    turn = np.linalg.cholesky(P).T
    turned = turn @ A @ np.linalg.inv(turn)
    return float(np.linalg.eigvalsh(np.swapaxes(turned, 1, 2) @ turned).max()) / rho**2 - 1.0


def common_function(A: Array, rho: float, level: Level | None = None) -> Array | None:
    """P (n, n) with AᵀPA ≺ ρ²P for all of A (M, n, n), or None where none is found (:eq:`moving-function`).

    The sum of the squares of the first one's modes is tried, then a semidefinite program: with the bilinear transform
    the inequality is that of :func:`~vsgdesign.certificate.lyapunov.fit`, with the same P. ``level``: the smallest one
    of this kind is looked for.
    """
    try:
        P = modal(A[_FIRST])
        if level is None and shortfall(A, P, rho) < 0.0:
            return P
        turn = np.linalg.cholesky(P).T
    except np.linalg.LinAlgError:
        return None
    back = np.linalg.inv(turn)
    turned = turn @ A @ back / rho
    eye = np.eye(A.shape[1])
    sides = (np.swapaxes(turned + side * eye, 1, 2) for side in (1.0, -1.0))
    rates: Array = np.asarray(np.linalg.solve(*sides).swapaxes(1, 2), dtype=np.float64)
    count = len(A)
    family = Family(np.ones((count, 1)), np.zeros((count, 1, 1)), np.ones((1, 1)))
    own = None if level is None else (back.T @ level[0] @ back, turn @ level[1] @ turn.T)
    if own is not None:  # numbers of one size
        size = max(float(np.linalg.norm(floor, 2)) for floor in own[0])
        own = own[0] / size, own[1] / np.trace(own[1])
    # The solver at times stops before its end: the matrices that it begins with then decide.
    for start in (tuple(range(min(count, _TOGETHER))), ()):
        found, _ = fit(rates, family, 0.0, start, own)
        if found is not None and shortfall(A, P := turn.T @ found.P[0] @ turn, rho) < 0.0:
            return P
    return None


def dwell_time(one: Array, other: Array, decay: float) -> float:
    """How long grids have to last on average when two of them take turns, s (:eq:`moving-dwell`). A function may be
    multiplied by any number, and both ways together do not see it."""
    both = move_factor([one, other * float(np.exp(_offset(one, other)))])
    return float(np.log(both)) / (2.0 * decay)


def _offset(one: Array, other: Array) -> float:
    """Half of the difference of the logarithms of the largest factors, there and back."""
    half, back = (np.linalg.inv(np.linalg.cholesky(P)) for P in (one, other))
    there = np.linalg.eigvalsh(half @ other @ half.T)[-1]
    return 0.5 * float(np.log(np.linalg.eigvalsh(back @ one @ back.T)[-1] / there))


Array = NDArray[np.float64]

_STEPS = 9
"""Estimates along each error for which the function is made."""

_SMALL = 1e-4
"""Of the rating, of V_g and of ω_g: a step whose answer is still linear."""

_LIMITERS = ("circular", "projection")
"""Those of which is known what they look at."""

_ANGLES = 3
"""Of the estimates' impedance, for which the test current of a projection is looked at."""


@dataclass(frozen=True)
class LevelSet:
    """At a place: P (n, n) of ``states`` in SI, which falls with ``decay`` (1/s) under all gains, and the largest step
    of each kind, of :data:`~vsgdesign.certificate.step_terms.STEPS`, for which xᵀPx ≤ 1 holds no point at a limit."""

    place: Array
    states: tuple[str, ...]
    P: Array
    decay: float
    sizes: Array


@dataclass(frozen=True)
class StepsAtPlaces:
    """The least and the median size of each kind of step, in the units of ``STEPS``, over the level sets of some
    places: no limit acts after one step of such a size there, whatever gains its estimates lead to."""

    places: int
    least: tuple[float, ...]
    median: tuple[float, ...]
    without: int
    """Places that have no level set: no function was found, or a limit leaves no room at rest."""


def steps_at(
    study: Study, system: System, region: Region, places: Array, count: int, until: float
) -> StepsAtPlaces | str:
    """The level sets of ``count`` of some places (N, 4), evenly apart, until a time; or why there are none."""
    sizes, without = [], 0
    chosen = places[np.unique(np.linspace(0, len(places) - 1, count).round().astype(int))] if len(places) else places
    for place in chosen:
        if time.time() > until:
            break
        try:
            found = level_set(study, system, region, place)
        except InfeasibleStudyError as error:
            return str(error)
        if found is None:
            without += 1
        else:
            sizes.append(found.sizes)
    if not sizes:
        return "no level set was found in the time that was given" if time.time() > until else "no level set was found"
    every = np.array(sizes)
    least, median = tuple(every.min(axis=0).tolist()), tuple(np.median(every, axis=0).tolist())
    return StepsAtPlaces(len(sizes), least, median, without)


def level_set(study: Study, system: System, region: Region, place: Array) -> LevelSet | None:
    """The level set at a place (4,), or None where no function is found, or where a limit leaves no room at rest.

    Raises InfeasibleStudyError where it is not known what the study's limiter looks at.
    """
    if study.current_limiter not in _LIMITERS:
        raise InfeasibleStudyError(
            f'current_limiter = "{study.current_limiter}": what it looks at is not known to the full-order level sets. '
            f"They are made for: {', '.join(_LIMITERS)}."
        )
    errors = np.vstack([np.full((1, 2), middle_error(region)), estimates(region, float(place[1]), _STEPS)])
    loops = loops_at(study, system, with_estimates(place[None], errors))
    if not np.isfinite(loops.A).all():
        return None
    T_s = study.converter.T_s
    decay = half_of(float(-np.log(np.abs(np.linalg.eigvals(loops.A)).max()) / T_s))
    rho = float(np.exp(-decay * T_s))
    floors, moved = _floors(study, loops), _moved(study, loops)
    P = common_function(loops.A, rho) if decay > 0.0 and floors is not None else None
    if P is None or floors is None:
        return None
    best = _within(P, floors)
    for _ in range(_TURNS):
        # What the steps cost now says how much each counts: their product is to be large.
        weights: Any = sum(np.outer(b, b) / (b @ best @ b) for b in moved)
        P = common_function(loops.A, rho, (floors, weights))
        if P is None or shortfall(loops.A, P, rho) >= 0.0:
            break
        best = min(best, _within(P, floors), key=lambda one: float(np.prod([b @ one @ b for b in moved])))
    sizes = np.array([(b @ best @ b) ** -0.5 for b in moved])
    return LevelSet(place, loops.states, best, decay, sizes)


_TURNS = 1


def _within(P: Array, floors: Array) -> Array:
    """A multiple of P whose set xᵀPx ≤ 1 lies within all limits."""
    half = np.linalg.inv(np.linalg.cholesky(P))
    return P * max(float(np.linalg.eigvalsh(half @ floor @ half.T)[-1]) for floor in floors)


def _floors(study: Study, loops: MovingLoops) -> Array | None:
    """CᵀC/m² of each limit: how far a quantity is from it at rest, m, and its derivative C. None where one is at its
    limit at rest."""
    names, values, C = watched_at(study, *_rest(study, loops))
    limits = acting_limits(study)
    settings = study.controller_settings()
    V_rated = study.converter.V_rated_rms
    values, C = values[0], _in_moving_state(loops, C[0], names)
    rooms = [
        (C[:2], (settings.i_max_pk if limits.current_pu is not None else np.inf) - np.hypot(*values[:2])),
        (C[2:4], settings.v_max_pk - np.hypot(*values[2:4])),
        (C[4:5], V_rated * (np.inf if limits.V_high_pu is None else limits.V_high_pu) - values[4]),
        (C[4:5], values[4] - V_rated * (-np.inf if limits.V_low_pu is None else limits.V_low_pu)),
    ]
    if study.current_limiter == "projection":
        rooms += _of_projection(study, loops, values, C)
    if min(room for _, room in rooms) <= 0.0:
        return None
    return np.stack([rows.T @ rows / room**2 for rows, room in rooms if np.isfinite(room)])


def _of_projection(study: Study, loops: MovingLoops, values: Array, C: Array) -> list[tuple[Array, float]]:
    """Derivatives (2, n) and rooms of what a projection looks at beside the limits of the others
    (:eq:`moving-projection`): the test current; and voltage and grid current as far as its gate stays open and its
    voltage of the grid is not low. Behind its low-pass neither is ever larger than it was in a sample."""
    settings, circuit = study.controller_settings(), study.circuit()
    c: Any = settings.limiter
    first, R_hat, X_hat = loops.at, *(loops.points[:, k] + 1.0 for k in (4, 5))
    R_g, X_g = first.R_g * R_hat, first.L_g * X_hat * study.converter.omega_n
    Z_g = R_g + 1j * X_g
    Z = Z_g + circuit.R_2 + 1j * study.converter.omega_n * circuit.L_2
    # Each is linear: its value at rest and its derivatives in one array.
    V, v_d, v_q, i_d, i_q = np.hstack([values[4:, None], C[4:]])
    view: Any = SimpleNamespace(V=V, v_d=v_d, v_q=v_q, i_g_d=i_d, i_g_q=i_q)
    rooms = []
    for angle in np.linspace(np.angle(Z).min(), np.angle(Z).max(), _ANGLES):
        i_w = np.array(current_at_reference(view, np.cos(angle), np.sin(angle), c.Z_v, settings.omega_C))
        rooms.append((i_w[:, 1:], float(c.i_soft_pk - np.hypot(*i_w[:, 0]))))
    v, i_g = v_d[0] + 1j * v_q[0], i_d[0] + 1j * i_q[0]
    behind = v - Z * i_g
    size = np.abs(behind)
    share = np.clip(-(behind * (Z_g * i_g).conj()).real / np.maximum(np.abs(Z_g * i_g) ** 2, 1e-18), 0.0, 1.0)
    least = np.abs(behind + share * Z_g * i_g)
    # Voltages of which both terms of the gate are one, and its doubt in them; v may move by so much, and Z i_g as well.
    gate, doubt = SQRT_2 * c.v_gate_pk, SQRT_2 * c.doubt
    each = [
        0.5 * (size - LOW_VOLTAGE * gate),
        0.5 * (least - gate),
        (size - gate - doubt * np.abs(Z * i_g)) / (2.0 + doubt),
    ]
    room = float(np.min(each))
    return [*rooms, (C[5:7], room), (C[7:9], room / float(np.abs(Z).max()))]


def _moved(study: Study, loops: MovingLoops) -> list[Array]:
    """The state right after one unit of each step, less the rest after it (n,)."""
    states, lanes, gains = _rest(study, loops)
    rest = _packed(loops, states)
    c, source = study.converter, study.grid_source
    found = []
    for kind, unit in zip(STEPS, (c.S_rated, c.S_rated, 1.0, source.V_g_rms, 1.0), strict=True):
        if kind == "phase":
            found.append(turned(loops, rest))
            continue
        by = _SMALL * (source.omega_g if kind == "omega_g" else unit)
        name = {"V_g": "V_g_rms"}.get(kind, kind)
        before = many_steady_states(study, lanes._replace(**{name: getattr(lanes, name) - by}), gains)
        found.append((_packed(loops, before) - rest) * (unit / by))
    return found


def turned(loops: MovingLoops, rest: Array) -> Array:
    """What a turn of the source by −1 rad adds to a state: the converter stays, and its components and δ turn on."""
    found = np.zeros(len(rest))
    for k, name in enumerate(loops.states):
        if name.startswith(("i_s", "v_c", "i_g", "pending")):
            other = loops.states.index(name[:-1] + ("q" if name.endswith("d") else "d"))
            found[k] = -rest[other] if name.endswith("d") else rest[other]
    found[loops.states.index("delta")] = 1.0
    return found


def _rest(study: Study, loops: MovingLoops) -> tuple[ManyStates, Lanes, PowerLoopGains]:
    """The rest of the first of the loops' points, its lane and its gains."""
    at, source = loops.at, study.grid_source
    gains = PowerLoopGains(*(np.asarray(value)[:1] for value in at.gains))
    own = np.full(1, source.omega_g)
    V_g, place = np.full(1, source.V_g_rms), loops.points
    lanes = Lanes(at.R_g[:1], at.L_g[:1], V_g, own, place[:1, 2], place[:1, 3], own, at.V_rms[:1])
    return many_steady_states(study, lanes, gains), lanes, gains


def _packed(loops: MovingLoops, states: ManyStates) -> Array:
    """A rest as the state of the loops (n,): the integrator by the ω_r that it leads to, but for a constant."""
    names = tuple("omega_i" if name == "omega_r" else name for name in loops.states)
    found = pack(names, states)[0]
    k = names.index("omega_i")
    found[k] /= 1.0 - float(loops.at.gains.k_P[0] * loops.at.gains.D_p[0])
    return found


def _in_moving_state(loops: MovingLoops, C: Array, names: tuple[str, ...]) -> Array:
    """Rows over the model's states as rows over those of the loops."""
    kept = [names.index("omega_i" if name == "omega_r" else name) for name in loops.states]
    found = C[:, kept]
    found[:, loops.states.index("omega_r")] *= 1.0 - float(loops.at.gains.k_P[0] * loops.at.gains.D_p[0])
    return found
