"""Search for the points at which a Lyapunov function holds worst: random search around the worst known points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.region import Region, System, point_of, with_shares

Array = NDArray[np.float64]

_KEPT, _TRIES, _ROUNDS = 300, 20, 14


def worst_points(
    system: System,
    region: Region,
    shortfall: Callable[[Array, Array], Array],
    points: Array,
    A: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """The points (_KEPT, 6) of largest ``shortfall`` near the worst of ``points`` (N, 6), the worst first, and it.

    ``shortfall``: points and their state matrices to a number each. Steps in ln SCR, ln X/R, P, Q and the errors get
    smaller from round to round; what leaves the region ends on its limit, and what leaves the static limits is
    dropped.
    """
    worth = shortfall(points, A)
    best = np.argsort(-worth)[:_KEPT]
    points, worth = points[best], worth[best]
    low, high = region.limits
    low[:2], high[:2] = np.log([[region.scr[0], region.x_over_r[0]], [region.scr[1], region.x_over_r[1]]])
    for turn in range(_ROUNDS):
        columns = with_shares(np.repeat(points, _TRIES, axis=0), region)
        columns[:, 0], columns[:, 1] = -np.log(columns[:, 0]), np.log(np.tan(columns[:, 1]))
        # Some coordinates at a time: the worst is often on a limit of the others.
        moved = rng.random(columns.shape) < 0.5
        columns = columns + moved * rng.normal(size=columns.shape) * 0.2 * 0.7**turn * (high - low)
        columns = np.clip(columns, low, high)
        columns[:, :2] = np.exp(columns[:, :2])
        tried, A = system.matrices(point_of(columns, region))
        points, worth = np.concatenate([points, tried]), np.concatenate([worth, shortfall(tried, A)])
        best = np.argsort(-worth)[:_KEPT]
        points, worth = points[best], worth[best]
    return points, worth
