"""The voltage source behind the grid's impedance, and what its voltage contains."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from vsgdesign.equations.source import SAG_TYPES, sag_sequences
from vsgdesign.study.parameters.fields import number, section, word


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
