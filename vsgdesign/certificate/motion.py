"""How fast a Lyapunov function that depends on the grid changes while the grid moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.lyapunov import Family
from vsgdesign.certificate.region import (
    Region,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """How P depends on the grid within a region (:eq:`certificate-coordinates`)."""

    region: Region
    moving: bool
    """Whether P depends on the grid. With False there is one P for all grids."""

    @property
    def _middle(self) -> Array:
        low, high = self._limits
        return 0.5 * (low + high)

    @property
    def _radius(self) -> Array:
        low, high = self._limits
        return np.maximum(0.5 * (high - low), 1e-9)

    @property
    def _limits(self) -> tuple[Array, Array]:
        (scr_low, scr_high), (ratio_low, ratio_high) = self.region.scr, self.region.x_over_r
        return np.array([1.0 / scr_high, 1.0 / ratio_high]), np.array([1.0 / scr_low, 1.0 / ratio_low])

    def weights(self, weakness: Any, r_over_x: Any) -> tuple[list[Any], list[list[Any]]]:
        """1, ρ_1, ρ_2 from 1/SCR and R/X of points or boxes, and 0, dρ_1/dt, dρ_2/dt for the four ways of moving."""
        if not self.moving:
            return [1.0], [[0.0]]
        raw = [weakness, r_over_x]
        rho = [(raw[k] - self._middle[k]) * (1.0 / self._radius[k]) for k in range(2)]
        speed = [raw[k] * (self.region.rate / self._radius[k]) for k in range(2)]
        ways = [[0.0, speed[0] * one, speed[1] * other] for one in (-1.0, 1.0) for other in (-1.0, 1.0)]
        return [1.0, *rho], ways

    def family(self, points: Array) -> Family:
        """The same for many points, for the solver."""
        here, ways = self.weights(points[:, 0], 1.0 / np.tan(points[:, 1]))
        count = len(points)

        def column(values: list[Any]) -> Array:
            return np.stack([np.broadcast_to(np.asarray(v, dtype=float), (count,)) for v in values], axis=-1)

        corners = np.array([[1.0, a, b] for a in (-1.0, 1.0) for b in (-1.0, 1.0)]) if self.moving else np.ones((1, 1))
        return Family(column(here), np.stack([column(way) for way in ways], axis=1), corners)
