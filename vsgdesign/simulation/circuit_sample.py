"""The circuit over one sampling interval as plain functions: bridge, edges, source, and what ideal sensors measure.

They are of the restricted language, so that the loop is made of this text. The circuit's matrices stand in rows, one
value a run. Both axes are alike here; :mod:`vsgdesign.simulation.bodies` writes circuits whose axes differ.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import Measurement
from vsgdesign.equations.frames import clarke, clarke_inverse, rotate

BEYOND = 5.0
"""A modulation index that no carrier meets."""


class PlantState(NamedTuple):
    """States of the circuit, each as (α, β), peak: currents in A, voltage in V."""

    i_s_alpha: Any
    i_s_beta: Any
    v_c_alpha: Any
    v_c_beta: Any
    i_g_alpha: Any
    i_g_beta: Any


class BridgeVoltage(NamedTuple):
    """A bridge voltage, V peak."""

    alpha: Any
    beta: Any


class SourcePhasor(NamedTuple):
    """Direction of the source's phasor at a sample."""

    cosine: Any
    sine: Any


class PlantRow(NamedTuple):
    """The circuit over one interval (:eq:`exact-step`): transition Φ (p), bridge Γ (b), and what the source adds for
    the phasor at its beginning, as a complex number for each state (re, im) with V_g in it; then the turn of the
    source."""

    p11: Any
    p12: Any
    p13: Any
    p21: Any
    p22: Any
    p23: Any
    p31: Any
    p32: Any
    p33: Any
    b1: Any
    b2: Any
    b3: Any
    re1: Any
    re2: Any
    re3: Any
    im1: Any
    im2: Any
    im3: Any
    turn_cos: Any
    turn_sin: Any


class CarrierPart(NamedTuple):
    """Where a sample lies on the carrier, whose period is 0 to 1 with its valley at zero: beginning and end of the
    interval, and the carrier's level at the beginning."""

    begin: Any
    end: Any
    level: Any


class Coefficients(NamedTuple):
    """A polynomial of degree 14, c0 + c1 x + …"""

    c0: Any
    c1: Any
    c2: Any
    c3: Any
    c4: Any
    c5: Any
    c6: Any
    c7: Any
    c8: Any
    c9: Any
    c10: Any
    c11: Any
    c12: Any
    c13: Any
    c14: Any


class EdgeRow(NamedTuple):
    """What a unit step of the bridge voltage adds to each state by the end of the interval, as a polynomial in
    x = 2τ/h − 1, where τ is the time that is left."""

    i_s: Coefficients
    v_c: Coefficients
    i_g: Coefficients


class Switching(NamedTuple):
    """The edge of one leg in an interval: its place in what is left of it, −1 to 1, and the step of the bridge voltage,
    V peak, zero where there is no edge."""

    place: Any
    alpha: Any
    beta: Any


def moved_by_bridge(x: PlantState, v_alpha: Any, v_beta: Any, row: PlantRow) -> PlantState:
    """Both axes over one interval with a constant bridge voltage, without the source."""
    return PlantState(
        i_s_alpha=row.p11 * x.i_s_alpha + row.p12 * x.v_c_alpha + row.p13 * x.i_g_alpha + row.b1 * v_alpha,
        i_s_beta=row.p11 * x.i_s_beta + row.p12 * x.v_c_beta + row.p13 * x.i_g_beta + row.b1 * v_beta,
        v_c_alpha=row.p21 * x.i_s_alpha + row.p22 * x.v_c_alpha + row.p23 * x.i_g_alpha + row.b2 * v_alpha,
        v_c_beta=row.p21 * x.i_s_beta + row.p22 * x.v_c_beta + row.p23 * x.i_g_beta + row.b2 * v_beta,
        i_g_alpha=row.p31 * x.i_s_alpha + row.p32 * x.v_c_alpha + row.p33 * x.i_g_alpha + row.b3 * v_alpha,
        i_g_beta=row.p31 * x.i_s_beta + row.p32 * x.v_c_beta + row.p33 * x.i_g_beta + row.b3 * v_beta,
    )


def moved_by_source(x: PlantState, source: SourcePhasor, row: PlantRow) -> PlantState:
    """What the source adds over the interval."""
    c = source.cosine
    s = source.sine
    return PlantState(
        i_s_alpha=x.i_s_alpha + row.re1 * c - row.im1 * s,
        i_s_beta=x.i_s_beta + row.re1 * s + row.im1 * c,
        v_c_alpha=x.v_c_alpha + row.re2 * c - row.im2 * s,
        v_c_beta=x.v_c_beta + row.re2 * s + row.im2 * c,
        i_g_alpha=x.i_g_alpha + row.re3 * c - row.im3 * s,
        i_g_beta=x.i_g_beta + row.re3 * s + row.im3 * c,
    )


def carrier(p: Any) -> Any:
    """Symmetric triangle in [−1, 1] over its period p ∈ [0, 1], valley at zero; a number or an array."""
    return np.where(p < 0.5, 4.0 * p - 1.0, 3.0 - 4.0 * p)


def modulation(v_alpha: Any, v_beta: Any, V_dc: Any, zero_sequence: bool) -> Any:
    """Phase modulation indices in [−1, 1] of a bridge voltage (:eq:`modulation`). Returns (m_a, m_b, m_c)."""
    a, b, c = clarke_inverse(v_alpha, v_beta)
    shift = -0.5 * (np.maximum(np.maximum(a, b), c) + np.minimum(np.minimum(a, b), c)) if zero_sequence else 0.0
    scale = 2.0 / V_dc
    return (a + shift) * scale, (b + shift) * scale, (c + shift) * scale


def leg_after(m: Any, level: Any, half: Any, rising: bool) -> Any:
    """±V_dc/2 of a leg just after the interval has begun. On a tie the slope of the carrier decides."""
    if rising:
        return np.where(m > level, half, -half)
    return np.where(m >= level, half, -half)


def edge_of_leg(m: Any, part: CarrierPart, rising: bool) -> Any:
    """The only edge of a leg in an interval that lies on one slope of the carrier. Returns (place, sign): where it is
    in what is left of the interval, −1 to 1, and its direction, 0 where there is none."""
    if rising:
        p = (m + 1.0) / 4.0
        sign = -1.0
    else:
        p = (3.0 - m) / 4.0
        sign = 1.0
    inside = 1.0 * (part.begin < p) * (p <= part.end)
    left = (part.end - p) / (part.end - part.begin)
    # Where there is no edge, its polynomial is taken at a place where it is finite.
    place = np.minimum(np.maximum(2.0 * left - 1.0, -1.0), 1.0)
    return place, sign * inside


def polynomial(c: Coefficients, x: Any) -> Any:
    """The value of a polynomial (Horner)."""
    high = (((((c.c14 * x + c.c13) * x + c.c12) * x + c.c11) * x + c.c10) * x + c.c9) * x + c.c8
    low = (((((((high * x + c.c7) * x + c.c6) * x + c.c5) * x + c.c4) * x + c.c3) * x + c.c2) * x + c.c1) * x + c.c0
    return low


def moved_by_edges(
    x: PlantState, m_a: Any, m_b: Any, m_c: Any, V_dc: Any, part: CarrierPart, edge: EdgeRow, rising: bool
) -> PlantState:
    """What the edges of the three legs add by the end of the interval. Their responses superpose."""
    x_a, s_a = edge_of_leg(m_a, part, rising)
    x_b, s_b = edge_of_leg(m_b, part, rising)
    x_c, s_c = edge_of_leg(m_c, part, rising)
    a = s_a * V_dc
    b = s_b * V_dc
    c = s_c * V_dc
    i_s_alpha, i_s_beta = clarke(
        a * polynomial(edge.i_s, x_a), b * polynomial(edge.i_s, x_b), c * polynomial(edge.i_s, x_c)
    )
    v_c_alpha, v_c_beta = clarke(
        a * polynomial(edge.v_c, x_a), b * polynomial(edge.v_c, x_b), c * polynomial(edge.v_c, x_c)
    )
    i_g_alpha, i_g_beta = clarke(
        a * polynomial(edge.i_g, x_a), b * polynomial(edge.i_g, x_b), c * polynomial(edge.i_g, x_c)
    )
    return PlantState(
        i_s_alpha=x.i_s_alpha + i_s_alpha,
        i_s_beta=x.i_s_beta + i_s_beta,
        v_c_alpha=x.v_c_alpha + v_c_alpha,
        v_c_beta=x.v_c_beta + v_c_beta,
        i_g_alpha=x.i_g_alpha + i_g_alpha,
        i_g_beta=x.i_g_beta + i_g_beta,
    )


def switched_bridge(
    x: PlantState,
    v_alpha: Any,
    v_beta: Any,
    row: PlantRow,
    V_dc: Any,
    part: CarrierPart,
    edge: EdgeRow,
    zero_sequence: bool,
    rising: bool,
) -> PlantState:
    """Both axes over one interval on one slope of the carrier with a switched bridge, without the source."""
    m_a, m_b, m_c = modulation(v_alpha, v_beta, V_dc, zero_sequence)
    half = 0.5 * V_dc
    w_alpha, w_beta = clarke(
        leg_after(m_a, part.level, half, rising),
        leg_after(m_b, part.level, half, rising),
        leg_after(m_c, part.level, half, rising),
    )
    moved = moved_by_bridge(x, w_alpha, w_beta, row)
    return moved_by_edges(moved, m_a, m_b, m_c, V_dc, part, edge, rising)


def measured_by(x: PlantState, R_c: Any) -> Measurement:
    """What ideal sensors say of a circuit."""
    return Measurement(
        v_alpha=x.v_c_alpha + R_c * (x.i_s_alpha - x.i_g_alpha),
        v_beta=x.v_c_beta + R_c * (x.i_s_beta - x.i_g_beta),
        i_s_alpha=x.i_s_alpha,
        i_s_beta=x.i_s_beta,
        i_g_alpha=x.i_g_alpha,
        i_g_beta=x.i_g_beta,
    )


def averaged_plant(x: PlantState, applied: BridgeVoltage, source: SourcePhasor, row: PlantRow) -> Any:
    """The circuit over an interval with an averaged bridge, and the source's phasor at its end. Returns (moved,
    turned)."""
    moved = moved_by_source(moved_by_bridge(x, applied.alpha, applied.beta, row), source, row)
    return moved, turned_source(source, row)


def switched_plant(
    x: PlantState,
    applied: BridgeVoltage,
    source: SourcePhasor,
    row: PlantRow,
    V_dc: Any,
    part: CarrierPart,
    edge: EdgeRow,
    zero_sequence: bool,
    rising: bool,
) -> Any:
    """The same with a switched bridge, over an interval on one slope of the carrier. Returns (moved, turned)."""
    bridged = switched_bridge(x, applied.alpha, applied.beta, row, V_dc, part, edge, zero_sequence, rising)
    return moved_by_source(bridged, source, row), turned_source(source, row)


def peak_plant(
    x: PlantState,
    applied: BridgeVoltage,
    source: SourcePhasor,
    row: PlantRow,
    V_dc: Any,
    part: CarrierPart,
    edge: EdgeRow,
    zero_sequence: bool,
) -> Any:
    """The same over an interval in which the carrier has its peak: a leg may fall before it and rise behind it. Returns
    (moved, turned)."""
    m_a, m_b, m_c = modulation(applied.alpha, applied.beta, V_dc, zero_sequence)
    half = 0.5 * V_dc
    w_alpha, w_beta = clarke(
        leg_after(m_a, part.level, half, True),
        leg_after(m_b, part.level, half, True),
        leg_after(m_c, part.level, half, True),
    )
    bridged = moved_by_bridge(x, w_alpha, w_beta, row)
    met_a = met(m_a)
    met_b = met(m_b)
    met_c = met(m_c)
    fallen = moved_by_edges(bridged, met_a, met_b, met_c, V_dc, part, edge, True)
    risen = moved_by_edges(fallen, met_a, met_b, met_c, V_dc, part, edge, False)
    return moved_by_source(risen, source, row), turned_source(source, row)


def met(m: Any) -> Any:
    """The modulation index where the carrier meets it below its peak, else one that it never meets."""
    return np.where(m < 1.0, m, BEYOND)


def turned_source(source: SourcePhasor, row: PlantRow) -> SourcePhasor:
    """The source's phasor at the end of the interval. Returns (turned)."""
    cosine, sine = rotate(source.cosine, source.sine, row.turn_cos, row.turn_sin)
    return SourcePhasor(cosine, sine)


def legs_after(applied: BridgeVoltage, V_dc: Any, part: CarrierPart, zero_sequence: bool, rising: bool) -> Any:
    """The switched bridge just after an interval has begun. Returns (first, m_a, m_b, m_c): its voltage, V peak, and
    the modulation indices."""
    m_a, m_b, m_c = modulation(applied.alpha, applied.beta, V_dc, zero_sequence)
    half = 0.5 * V_dc
    alpha, beta = clarke(
        leg_after(m_a, part.level, half, rising),
        leg_after(m_b, part.level, half, rising),
        leg_after(m_c, part.level, half, rising),
    )
    return BridgeVoltage(alpha, beta), m_a, m_b, m_c


def edges_on_slope(m_a: Any, m_b: Any, m_c: Any, V_dc: Any, part: CarrierPart, rising: bool) -> Any:
    """The edges of the three legs on one slope of the carrier. Returns (edge_a, edge_b, edge_c)."""
    x_a, s_a = edge_of_leg(met(m_a), part, rising)
    x_b, s_b = edge_of_leg(met(m_b), part, rising)
    x_c, s_c = edge_of_leg(met(m_c), part, rising)
    a_alpha, a_beta = clarke(s_a * V_dc, 0.0, 0.0)
    b_alpha, b_beta = clarke(0.0, s_b * V_dc, 0.0)
    c_alpha, c_beta = clarke(0.0, 0.0, s_c * V_dc)
    return Switching(x_a, a_alpha, a_beta), Switching(x_b, b_alpha, b_beta), Switching(x_c, c_alpha, c_beta)
