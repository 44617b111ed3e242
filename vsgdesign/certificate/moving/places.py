"""The sampled full-order loop at places, with all gains that an estimate within its error leads to: its matrices in a
state that no change of gains moves, the part of it that the gains act on, and weights that make these gains one ball
about their middle (:eq:`moving-ball`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.full_order.points import AtRest, rests_at
from vsgdesign.certificate.region import Region, System
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops_about_rest
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.full_order import sample_matrices
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

MOVED = ("delta", "omega_r", "V")
"""The states into which the gains feed the powers; ω_r is in the place of ω_i (:eq:`moving-state`)."""

_NONE = References(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MovingLoops:
    """N points (N, 6): the names of n states, A (N, n, n) of one sample in SI, and the rests. NaN without a rest."""

    points: Array
    states: tuple[str, ...]
    A: Array
    at: AtRest

    @property
    def moved(self) -> list[int]:
        """The places of ``MOVED`` among the states."""
        return [self.states.index(name) for name in MOVED]


def loops_at(study: Study, system: System, points: Array) -> MovingLoops:
    """The loops at points (N, 6) with the gains of their estimates, in the state of :eq:`moving-state`.

    What a limiter remembers is not part of the loop at rest and is left out.
    """
    at, states, lanes = rests_at(study, system, points)
    names, A = sample_matrices(study, states, lanes, at.gains)
    kept = [k for k, name in enumerate(names) if not name.startswith("limiter_")]
    others = [k for k in range(len(names)) if k not in kept]
    if np.nan_to_num(A[:, kept][:, :, others]).any():
        raise InfeasibleStudyError(f'the limiter "{study.current_limiter}" changes what small signals do at rest.')
    names, A = tuple(names[k] for k in kept), A[:, kept][:, :, kept]
    k = names.index("omega_i")
    free = (1.0 - at.gains.k_P * at.gains.D_p)[:, None]
    A[:, :, k] *= free
    A[:, k, :] /= free
    return MovingLoops(points, (*names[:k], MOVED[1], *names[k + 1 :]), A, at)


def moved_by_unit(gains: PowerLoopGains) -> list[Any]:
    """(ω − ω_r, dω_r/dt, dV/dt), each by one unit of P + D_p Δω_r and by one of Q + D_q V: six numbers, arrays or
    symbols, row by row."""
    columns = [power_loops_about_rest(0.0, 0.0, P, Q, _NONE, gains) for P, Q in ((1.0, 0.0), (0.0, 1.0))]
    return [one for row in zip(*columns, strict=True) for one in row]


def feeds(gains: PowerLoopGains) -> Array:
    """−(ω − ω_r, dω_r/dt, dV/dt) of one unit of P + D_p Δω_r and of Q + D_q V, (…, 3, 2) in SI (:eq:`moving-feeds`)."""
    found = -np.stack(np.broadcast_arrays(*moved_by_unit(gains)), axis=-1)
    return found.reshape(*found.shape[:-1], 3, 2)


def powers_of(loops: MovingLoops, T_s: float) -> Array:
    """The rows (N, 2, n) of P + D_p Δω_r and Q + D_q V, both behind their filters, from what the loops do with them."""
    _, k, m = loops.moved
    eye = np.eye(len(loops.states))
    own = feeds(loops.at.gains)[:, 1:, :]
    found: Any = np.linalg.solve(own, (eye[[k, m]] - loops.A[:, [k, m], :]) / T_s)
    return found


DROOPS, PRODUCTS = "droops", "products"


def kind_of(system: System) -> str | None:
    """What stays the same at a change of gains: the droops, or the products of gain and droop; None: neither, and what
    is fed back is not one pair of quantities for all gains."""
    schedule: Any = system.schedule
    inner = getattr(schedule, "schedule", schedule)
    structure = STRUCTURES[inner.structure]
    if structure.P_droop and structure.Q_droop:
        return DROOPS
    return PRODUCTS if not structure.P_droop and not structure.Q_droop else None


def estimates(region: Region, angle: float, steps: int) -> Array:
    """Errors (steps², 2) of R_g and L_g on a lattice over the error set on a grid of this angle."""
    shares = np.linspace(-1.0, 1.0, steps) * region.largest_error
    scales = region.error_scales(np.array([angle])) if region.error_Z else (np.ones(1), np.ones(1))
    every = [shares * float(scale[0]) for scale in scales]
    return np.stack([one.ravel() for one in np.meshgrid(*every, indexing="ij")], axis=1)


def with_estimates(places: Array, errors: Array) -> Array:
    """Points (N·M, 6): each of N places (4,) with each of M errors."""
    return np.hstack([np.repeat(places, len(errors), axis=0), np.tile(errors, (len(places), 1))])


_STEPS = 5
"""Estimates along each error at a point."""

_POINTS = 6
"""Of those whose least decay is known, that the weights are made for."""

_FREQUENCIES = 48

_TRIES, _STEP = 400, 0.4
"""Values that the search for weights looks at, and how far apart it begins."""


@dataclass(frozen=True)
class Ball:
    """ΔG = L Δ R with \\|Δ\\| ≤ β, in units of V²/\\|Z_g\\| and of ln V. ``left`` (rows, rows), ``right`` (2, 2); the
    rows are those of :func:`feeds` from ``first`` on."""

    left: Array
    right: Array
    first: int

    @property
    def rounding(self) -> float:
        """How much larger a bound of Δ has to be, for what products with the inverses of L and R are off by: each is
        known to a few roundings of the product of the sizes, which is at most so many times Δ."""
        both = [np.abs(np.linalg.inv(matrix)) @ np.abs(matrix) for matrix in (self.left, self.right)]
        return 1.0 + 1e-13 * float(np.prod([np.linalg.norm(one) for one in both]))

    @property
    def columns(self) -> Array:
        """L with all three rows."""
        return np.vstack([np.zeros((self.first, len(self.left))), self.left])


def middle_error(region: Region) -> float:
    """Both errors of the estimate whose gains are the middle: those follow 1/(1 + e)."""
    return -(region.largest_error**2)


def ball_of(study: Study, system: System, region: Region, places: Array, alpha: float) -> Ball:
    """Weights with which the largest gain of :eq:`moving-small-gain` over some places (N, 4) is small on the circle of
    ``alpha`` in 1/s."""
    from scipy.optimize import minimize

    places = places[np.linspace(0, len(places) - 1, min(_POINTS, len(places))).astype(int)]
    sample = [_sampled(study, system, region, place, alpha) for place in places]
    off = np.stack([one[0] for one in sample])
    answer = np.stack([one[1] for one in sample])
    first = 0 if kind_of(system) == DROOPS else 1
    off, answer = off[:, :, first:, :], answer[:, :, :, first:]
    count = off.shape[2]
    rows, columns = np.tril_indices(count), np.tril_indices(2)
    size = np.abs(off).max(axis=(0, 1, 3)) + 1e-300

    def weights(x: Array) -> tuple[Array, Array]:
        left, right = np.zeros((count, count)), np.zeros((2, 2))
        left[rows], right[columns] = x[: len(rows[0])], x[len(rows[0]) :]
        for matrix in (left, right):
            np.fill_diagonal(matrix, np.exp(np.clip(np.diag(matrix), -20.0, 20.0)))
        return size[:, None] * left, right

    def gain(x: Array) -> float:
        left, right = weights(x)
        with np.errstate(all="ignore"):
            reach = np.linalg.norm(np.linalg.solve(left, off) @ np.linalg.inv(right), 2, axis=(2, 3)).max(axis=1)
            answers = np.linalg.norm(right @ answer @ left, axis=(2, 3)).max(axis=1)
            return float(np.nan_to_num((reach * answers).max(), nan=np.inf, posinf=np.inf))

    begin = np.zeros(len(rows[0]) + len(columns[0]))
    simplex = begin + np.vstack([np.zeros(len(begin)), _STEP * np.eye(len(begin))])
    options = {"maxfev": _TRIES, "xatol": 0.02, "fatol": 0.003, "initial_simplex": simplex}
    found: Any = minimize(gain, begin, method="Nelder-Mead", options=options)
    return Ball(*weights(found.x), first)


def _sampled(study: Study, system: System, region: Region, place: Array, alpha: float) -> tuple[Array, Any]:
    """What the estimates of a place add to the feeds of the middle, (M, 3, 2), and the answers of the powers to what is
    fed, (frequencies, 2, 3), in the units of :class:`Ball`."""
    errors = np.vstack([np.full((1, 2), middle_error(region)), estimates(region, float(place[1]), _STEPS)])
    loops = loops_at(study, system, with_estimates(place[None], errors))
    G, unit, V = feeds(loops.at.gains), unit_of(study, loops)[:, None, None], loops.at.V_rms[0]
    own = np.array([1.0, 1.0, 1.0 / V])[:, None]
    off = (G[1:] - G[0]) * unit[1:] * own
    T_s, n = study.converter.T_s, len(loops.states)
    frequencies = np.concatenate([[0.0], np.geomspace(0.1, np.pi / T_s, _FREQUENCIES - 1)])
    z = np.exp((-alpha + 1j * frequencies) * T_s)
    fed = np.zeros((n, 3))
    fed[loops.moved, range(3)] = T_s * np.array([1.0, 1.0, V])
    powers = powers_of(loops, T_s)[0] / unit[0, 0]
    answers = powers @ np.linalg.solve(z[:, None, None] * np.eye(n) - loops.A[0], fed[None].astype(complex))
    return off, answers


def unit_of(study: Study, loops: MovingLoops) -> Array:
    """V²/\\|Z_g\\| of each point, W."""
    return loops.at.V_rms**2 / np.hypot(loops.at.R_g, study.converter.omega_n * loops.at.L_g)
