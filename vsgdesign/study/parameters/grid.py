"""The grid: its impedance at the PCC, in Ω and H or as a converter sees it, the voltage source behind it with what its
voltage contains, and what a controller knows of the grid.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.equations.grid import SAG_TYPES, SCR_BASES, sag_sequences
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import L_BASE, Z_BASE, Scope, number, picked, section, values, word
from vsgdesign.study.parameters.reader import TableReader


@dataclass(frozen=True)
class SourceComponent:
    """A negative sequence or a harmonic of the grid source's voltage (:eq:`source-components`)."""

    order: float
    """Multiple of the fundamental's frequency in the space vector. A negative order turns backwards: −1 is the
    fundamental's negative sequence, −5 the usual fifth harmonic."""
    amplitude_pu: float
    """Over the rated voltage."""
    phase: float
    """Angle of the space vector where the fundamental's is zero, rad."""


@dataclass(frozen=True)
class GridSource:
    """The ideal voltage source behind the grid impedance."""

    V_g_rms: float
    omega_g: float
    components: tuple[SourceComponent, ...] = ()
    """What its voltage contains besides the positive sequence of the fundamental."""


@section
class Sag:
    """A voltage sag (dip) by its type, A to G, with the voltage that remains (:eq:`sag-types`)."""

    kind: str = word(tuple(SAG_TYPES), name="type")
    """Type after Bollen, with phase a as the phase of symmetry. `A` is balanced; `E` and `G` are the same without a
    zero sequence."""
    V_pu: float = number("1", 0.0, 1.0)
    """Characteristic voltage, a share of the voltage before."""
    angle: float = number("rad", -0.5 * math.pi, 0.5 * math.pi, default=0.0)
    """Phase-angle jump of the characteristic voltage."""


NEGATIVE_SEQUENCE = -1.0
"""Order of the component that is the fundamental's negative sequence."""


def sagged(source: GridSource, sag: Sag | None, V_rated_rms: float) -> tuple[float, float, tuple[SourceComponent, ...]]:
    """A source during a sag: its V_g_rms, the angle by which its positive sequence is turned, and its components.

    The components that are there without the sag keep their voltage and their angle. The negative sequence of the sag
    is added to theirs, so that the order −1 stands in the result once.
    """
    if sag is None:
        return source.V_g_rms, 0.0, source.components
    positive, negative = sag_sequences(sag.kind, cmath.rect(sag.V_pu, sag.angle))
    turned = cmath.phase(positive)
    # The space vector of a negative sequence is the conjugate of its phasor, turning backwards. The angle of a
    # component is counted from n times that of the fundamental, which the sag has turned.
    phasor = negative.conjugate() * (source.V_g_rms / V_rated_rms)
    kept = []
    for component in source.components:
        if component.order == NEGATIVE_SEQUENCE:
            phasor += cmath.rect(component.amplitude_pu, component.phase)
        else:
            phase = component.phase - component.order * turned
            kept.append(SourceComponent(component.order, component.amplitude_pu, phase))
    if phasor != 0.0:
        kept.insert(0, SourceComponent(NEGATIVE_SEQUENCE, abs(phasor), cmath.phase(phasor) + turned))
    return abs(positive) * source.V_g_rms, turned, tuple(kept)


SCR_LIMITS, X_OVER_R_LIMITS = (0.05, 1e4), (1e-3, 1e4)
"""Limits of SCR and X/R in a study."""

_NEEDED, _OR_ELSE = "required, or `R_g`, `L_g`", "required, or `scr`, `x_over_r`"


class Impedance:
    """The fields that every grid of a study has."""

    scr: float = number("1", *SCR_LIMITS, shown=_NEEDED)
    """Short-circuit ratio at the PCC on S_rated."""
    x_over_r: float = number("1", *X_OVER_R_LIMITS, shown=_NEEDED)
    """X_g/R_g at nominal frequency."""
    R_g: float = number("ohm", 0.0, 20.0 * Z_BASE, shown=_OR_ELSE)
    """Resistance."""
    L_g: float = number("H", 1e-4 * L_BASE, 20.0 * L_BASE, shown=_OR_ELSE)
    """Inductance."""


def basis_field(**more: str) -> Any:
    """The field that says on what basis SCR is taken. ``more``: see
    :class:`vsgdesign.study.parameters.fields.Field`."""
    return word(lambda: tuple(SCR_BASES), **more)


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


def read_grid(table: TableReader, scope: Scope, converter: Converter, basis: str, previous: Grid | None) -> Grid:
    """A grid from scr and x_over_r, or from R_g and L_g.

    With ``previous`` (an event) a missing one of scr and x_over_r keeps its value.
    """
    place = picked(Impedance, "scr", "x_over_r")
    if previous is not None and not (table.has("R_g") or table.has("L_g")):
        # To twelve digits: what is kept is then the number that was given, and equal grids are equal.
        kept = previous.place(converter, basis)
        kept_values = {"scr": float(f"{kept.scr:.12g}"), "x_over_r": float(f"{kept.x_over_r:.12g}")}
        return Place(**values(place, table, scope, kept_values), basis=basis).grid(converter)
    if table.one_of(("scr", "x_over_r"), ("R_g", "L_g")) == ("R_g", "L_g"):
        return Grid(**values(picked(Impedance, "R_g", "L_g"), table, scope))
    if not (table.has("scr") or table.has("x_over_r")):
        return Grid(math.nan, math.nan)
    return Place(**values(place, table, scope), basis=basis).grid(converter)


@dataclass(frozen=True)
class GridEstimate:
    """What a scheduled controller without an estimator of its own knows of the grid."""

    error_R: float = number("1", -1.0, 10.0, default=0.0)
    """The controller takes R_g for R_g (1 + `error_R`)."""
    error_X: float = number("1", -0.99, 10.0, default=0.0)
    """The same of L_g."""
    silent_s: float = number("s", 0.0, 36000.0, default=0.0, name="silent")
    """After each change of the grid or its source it is told nothing for this long."""

    def of(self, grid: Grid) -> Grid:
        """The estimate of a grid."""
        return Grid(grid.R_g * (1.0 + self.error_R), grid.L_g * (1.0 + self.error_X))
