"""The grid's impedance at the PCC, in Ω and H or as a converter sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.parameters.converter import Converter


@dataclass(frozen=True)
class Grid:
    """Grid impedance at the PCC: R_g in Ω, L_g in H."""

    R_g: float
    L_g: float

    def scr(self, converter: Converter, basis: str) -> float:
        """Short-circuit ratio on a basis of :data:`vsgdesign.equations.grid.SCR_BASES`."""
        return float(SCR_BASES[basis].scr(self.R_g, self.L_g, converter.Z_base, converter.omega_n))

    def x_over_r(self, omega: float) -> float:
        """X/R at an angular frequency; infinite without resistance."""
        return omega * self.L_g / self.R_g if self.R_g > 0.0 else np.inf

    def place(self, converter: Converter, basis: str) -> Place:
        """The grid as a converter sees it; the inverse of :meth:`Place.grid`."""
        return Place(self.scr(converter, basis), self.x_over_r(converter.omega_n), basis)


@dataclass(frozen=True)
class Place:
    """A grid as a converter sees it: short-circuit ratio, X/R, and the basis of the ratio."""

    scr: float
    x_over_r: float
    """X/R of the grid impedance. It is infinite without resistance."""
    basis: str
    """A name of :data:`vsgdesign.equations.grid.SCR_BASES`. Raises UnknownNameError for another."""

    def __post_init__(self) -> None:
        SCR_BASES[self.basis]

    def grid(self, converter: Converter) -> Grid:
        """R_g and L_g on a converter's base (:eq:`scr`)."""
        if np.isinf(self.x_over_r):
            return Grid(0.0, converter.Z_base / self.scr / converter.omega_n)
        R_g, L_g = SCR_BASES[self.basis].grid(self.scr, self.x_over_r, converter.Z_base, converter.omega_n)
        return Grid(float(R_g), float(L_g))
