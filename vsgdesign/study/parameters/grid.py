"""The grid: its impedance at the PCC, in Ω and H or as a converter sees it, the voltage source behind it with what its
voltage contains, what a controller knows of the grid, and what stands there besides: a local load, a short circuit and
the breaker.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.equations.grid import SAG_TYPES, SCR_BASES, sag_sequences
from vsgdesign.errors import InfeasibleStudyError
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


THREE_PHASE = "three_phase"
PHASE_TO_PHASE = "phase_to_phase"
FAULT_KINDS = (THREE_PHASE, PHASE_TO_PHASE)
PHASE_PAIRS = ("ab", "bc", "ca")


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A short circuit to the neutral of the three-wire system, or between two phases."""

    kind: str = THREE_PHASE
    """A name of :data:`FAULT_KINDS`."""
    at: float = 0.0
    """Where it is, as a share of the grid's impedance: 0 at the PCC, towards 1 at the source (below 1)."""
    R: float = 0.0
    """Ω: of each phase to the common point of a three-phase fault, or between the two phases. Zero is bolted."""
    phases: str = "bc"
    """A name of :data:`PHASE_PAIRS`, of a fault between two phases."""


@dataclass(frozen=True, kw_only=True)
class Load:
    """A balanced load at the PCC: a parallel and a series branch per phase, in SI. None: there is no such element.

    The parallel elements lie side by side from the phase to the neutral point. The series branch is a resistance with
    an inductance and a capacitance in series, as far as they are given.
    """

    R_parallel: float | None = None
    L_parallel: float | None = None
    C_parallel: float | None = None
    R_series: float | None = None
    L_series: float | None = None
    C_series: float | None = None

    def admittance(self, omega: float) -> complex:
        """Admittance of a phase in S at an angular frequency in rad/s."""
        Y = 0.0 + 0.0j
        if self.R_parallel is not None:
            Y += 1.0 / self.R_parallel
        if self.L_parallel is not None:
            Y += 1.0 / (1j * omega * self.L_parallel)
        if self.C_parallel is not None:
            Y += 1j * omega * self.C_parallel
        if (self.R_series, self.L_series, self.C_series) != (None, None, None):
            Y += 1.0 / self.series_impedance(omega)
        return Y

    def series_impedance(self, omega: float) -> complex:
        """Impedance of the series branch in Ω at an angular frequency in rad/s; zero without one."""
        Z = complex(self.R_series or 0.0)
        if self.L_series is not None:
            Z += 1j * omega * self.L_series
        if self.C_series is not None:
            Z += 1.0 / (1j * omega * self.C_series)
        return Z

    def times(self, factor: float) -> Load:
        """A load of so many times the impedance."""

        def of(value: float | None, share: float) -> float | None:
            return None if value is None else value * share

        return Load(
            R_parallel=of(self.R_parallel, factor),
            L_parallel=of(self.L_parallel, factor),
            C_parallel=of(self.C_parallel, 1.0 / factor),
            R_series=of(self.R_series, factor),
            L_series=of(self.L_series, factor),
            C_series=of(self.C_series, 1.0 / factor),
        )

    def in_si(self, Z_base: float, omega_n: float) -> Load:
        """A load whose elements are reactances in pu (R, ωL, 1/(ωC)) in SI. ``Z_base`` in Ω, ``omega_n`` in rad/s."""

        def times(value: float | None, unit: float) -> float | None:
            return None if value is None else value * unit

        def capacitance(X_pu: float | None) -> float | None:
            return None if X_pu is None else 1.0 / (omega_n * Z_base) / X_pu

        return Load(
            R_parallel=times(self.R_parallel, Z_base),
            L_parallel=times(self.L_parallel, Z_base / omega_n),
            C_parallel=capacitance(self.C_parallel),
            R_series=times(self.R_series, Z_base),
            L_series=times(self.L_series, Z_base / omega_n),
            C_series=capacitance(self.C_series),
        )


@dataclass(frozen=True, kw_only=True)
class Network:
    """What is connected at the PCC besides the grid's impedance. Equal values are equal networks."""

    load: Load | None = None
    fault: Fault | None = None
    connected: bool = True
    """Whether the breaker between the PCC (with its load and faults at the PCC) and the grid's impedance is closed."""

    @property
    def plain(self) -> bool:
        """Whether nothing but the grid's impedance is there."""
        return self.load is None and self.fault is None and self.connected


PLAIN = Network()


@section
class SynchroCheck:
    """How near the voltages on both sides of an open breaker have to be before it closes (:eq:`synchro-check`)."""

    angle: float = number("rad", math.radians(0.1), 0.5 * math.pi, default=math.radians(10.0))
    """Largest difference of the angles."""
    V_pu: float = number("1", 0.001, 1.0, default=0.1)
    """Largest difference of the amplitudes, pu of rated."""
    omega: float = number("Hz", 0.001, 10.0, default=0.3, name="df", scale=2.0 * math.pi)
    """Largest difference of the frequencies."""
    around: float = number("rad", -math.pi, math.pi, default=0.0)
    """By how much the converter's side leads in the middle of the range of angles; not zero: out of phase on
    purpose."""


def only_a_grid(network: Network, what: str) -> None:
    """Raises InfeasibleStudyError for ``what``, which knows nothing but a grid, where there is more at the start."""
    if not network.plain:
        raise InfeasibleStudyError(
            f"{what} has nothing but a grid: leave [network] out of the study. vsgdesign run simulates it with its "
            "events."
        )
