"""The voltage source behind the grid's impedance, and what its voltage contains."""

from __future__ import annotations

from dataclasses import dataclass


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
