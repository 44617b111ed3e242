"""Weights that make all gains of an estimate one ball about the middle (:eq:`moving-ball`), found at points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.moving.places import (
    DROOPS,
    MovingLoops,
    estimates,
    feeds,
    kind_of,
    loops_at,
    powers_of,
    with_estimates,
)
from vsgdesign.certificate.region import Region, System
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

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
    rows are those of :func:`~vsgdesign.certificate.moving.places.feeds` from ``first`` on."""

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
