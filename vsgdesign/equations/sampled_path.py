"""The circuit at one frequency, as a host computes it that has neither arrays nor complex numbers.

What a source of the frequency ω adds over a sampling interval (:eq:`source-response`), the path between the control
point and the source as the samples see it (:eq:`sampled-path`), and a step towards the rest on this path. Everything
else of a circuit does not depend on the frequency.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.frames import instantaneous_power, peak_to_rms, rms_to_peak
from vsgdesign.equations.grid import FilterGrid, pcc_voltage
from vsgdesign.equations.power_flow import admittance, jacobian_from_admittance, power_flow


class Phasor(NamedTuple):
    """A complex number."""

    re: Any
    im: Any


class PlantPhasors(NamedTuple):
    """One for each state of an axis: A, V and A."""

    i_s: Phasor
    v_c: Phasor
    i_g: Phasor


class Transition(NamedTuple):
    """Φ over an interval, row by row."""

    p11: Any
    p12: Any
    p13: Any
    p21: Any
    p22: Any
    p23: Any
    p31: Any
    p32: Any
    p33: Any


class SampledPath(NamedTuple):
    """The impedance between the control point and a source as the samples see it, Ω, and this source: V phase rms, and
    its angle to the grid's source, rad."""

    R: Any
    X: Any
    V_rms: Any
    angle: Any


def product(a: Phasor, b: Phasor) -> Phasor:
    """a·b."""
    return Phasor(a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re)


def quotient(a: Phasor, b: Phasor) -> Phasor:
    """a/b of b ≠ 0."""
    size = b.re * b.re + b.im * b.im
    return Phasor((a.re * b.re + a.im * b.im) / size, (a.im * b.re - a.re * b.im) / size)


def scaled_sum(a: Any, one: Phasor, b: Any, other: Phasor) -> Phasor:
    """a·one + b·other with real numbers a and b."""
    return Phasor(a * one.re + b * other.re, a * one.im + b * other.im)


def resolved(circuit: FilterGrid, omega: Any, y: PlantPhasors) -> PlantPhasors:
    """(jω − A)⁻¹ y of a circuit: the states of a particular solution. It is a ladder, so no matrix is inverted."""
    L = circuit.L_2 + circuit.L_g
    z_1 = Phasor(circuit.R_1, omega * circuit.L_1)
    z_2 = Phasor(circuit.R_2 + circuit.R_g, omega * L)
    shunt = omega * circuit.C
    both = Phasor(z_1.re + z_2.re, z_1.im + z_2.im)
    of_both = product(z_1, z_2)
    # The voltage of the node is a·v_c less R_c C y_2, and a is 1 + jωC R_c.
    a = Phasor(1.0, circuit.R_c * shunt)
    whole = product(a, both)
    whole = Phasor(whole.re - shunt * of_both.im, whole.im + shunt * of_both.re)
    pushed = product(y.v_c, scaled_sum(1.0, of_both, circuit.R_c, both))
    driven = scaled_sum(circuit.L_1, product(y.i_s, z_2), -L, product(y.i_g, z_1))
    v_c = quotient(scaled_sum(1.0, driven, circuit.C, pushed), whole)
    node = scaled_sum(1.0, product(a, v_c), -circuit.R_c * circuit.C, y.v_c)
    i_s = quotient(scaled_sum(circuit.L_1, y.i_s, -1.0, node), z_1)
    i_g = quotient(scaled_sum(L, y.i_g, 1.0, node), z_2)
    return PlantPhasors(i_s, v_c, i_g)


def propagated(of: Transition, x: PlantPhasors) -> PlantPhasors:
    """Φ x."""
    return PlantPhasors(
        i_s=Phasor(
            of.p11 * x.i_s.re + of.p12 * x.v_c.re + of.p13 * x.i_g.re,
            of.p11 * x.i_s.im + of.p12 * x.v_c.im + of.p13 * x.i_g.im,
        ),
        v_c=Phasor(
            of.p21 * x.i_s.re + of.p22 * x.v_c.re + of.p23 * x.i_g.re,
            of.p21 * x.i_s.im + of.p22 * x.v_c.im + of.p23 * x.i_g.im,
        ),
        i_g=Phasor(
            of.p31 * x.i_s.re + of.p32 * x.v_c.re + of.p33 * x.i_g.re,
            of.p31 * x.i_s.im + of.p32 * x.v_c.im + of.p33 * x.i_g.im,
        ),
    )


def each_product(x: PlantPhasors, by: Phasor) -> PlantPhasors:
    """Every state times the same number."""
    return PlantPhasors(product(x.i_s, by), product(x.v_c, by), product(x.i_g, by))


def each_sum(a: Any, x: PlantPhasors, b: Any, y: PlantPhasors) -> PlantPhasors:
    """a·x + b·y with real numbers a and b."""
    return PlantPhasors(scaled_sum(a, x.i_s, b, y.i_s), scaled_sum(a, x.v_c, b, y.v_c), scaled_sum(a, x.i_g, b, y.i_g))


def source_response(transition: Transition, circuit: FilterGrid, h: Any, omega: Any) -> Any:
    """What s^m·e^{jωs}, m = 0, 1, 2, adds to the states over an interval h in s (:eq:`source-response`), and the turn
    e^{jωh}. Returns (of_constant, of_slope, of_square, turn)."""
    none = Phasor(0.0, 0.0)
    p_0 = resolved(circuit, omega, PlantPhasors(none, none, Phasor(-1.0 / (circuit.L_2 + circuit.L_g), 0.0)))
    q = resolved(circuit, omega, p_0)
    r = resolved(circuit, omega, q)
    turn = Phasor(np.cos(omega * h), np.sin(omega * h))
    of_constant = each_sum(1.0, each_product(p_0, turn), -1.0, propagated(transition, p_0))
    of_slope = each_sum(1.0, each_product(each_sum(h, p_0, -1.0, q), turn), 1.0, propagated(transition, q))
    at_end = each_sum(1.0, each_sum(h * h, p_0, -2.0 * h, q), 2.0, r)
    of_square = each_sum(1.0, each_product(at_end, turn), -2.0, propagated(transition, r))
    return of_constant, of_slope, of_square, turn


def rotating(of: Transition, turn: Phasor, y: PlantPhasors) -> PlantPhasors:
    """(turn − Φ)⁻¹ y: the states that one interval turns, if it adds y to them."""
    a = Phasor(turn.re - of.p11, turn.im)
    e = Phasor(turn.re - of.p22, turn.im)
    i = Phasor(turn.re - of.p33, turn.im)
    # The off-diagonal numbers are −p12 and so on; in products of two of them the signs cancel.
    e_i = product(e, i)
    a_i = product(a, i)
    a_e = product(a, e)
    c_11 = Phasor(e_i.re - of.p23 * of.p32, e_i.im)
    c_22 = Phasor(a_i.re - of.p13 * of.p31, a_i.im)
    c_33 = Phasor(a_e.re - of.p12 * of.p21, a_e.im)
    c_12 = Phasor(of.p21 * i.re + of.p23 * of.p31, of.p21 * i.im)
    c_13 = Phasor(of.p21 * of.p32 + of.p31 * e.re, of.p31 * e.im)
    c_21 = Phasor(of.p12 * i.re + of.p13 * of.p32, of.p12 * i.im)
    c_23 = Phasor(of.p32 * a.re + of.p12 * of.p31, of.p32 * a.im)
    c_31 = Phasor(of.p12 * of.p23 + of.p13 * e.re, of.p13 * e.im)
    c_32 = Phasor(of.p23 * a.re + of.p13 * of.p21, of.p23 * a.im)
    whole = product(a, c_11)
    whole = Phasor(
        whole.re - of.p12 * c_12.re - of.p13 * c_13.re,
        whole.im - of.p12 * c_12.im - of.p13 * c_13.im,
    )
    i_s = scaled_sum(1.0, product(c_11, y.i_s), 1.0, product(c_21, y.v_c))
    v_c = scaled_sum(1.0, product(c_12, y.i_s), 1.0, product(c_22, y.v_c))
    i_g = scaled_sum(1.0, product(c_13, y.i_s), 1.0, product(c_23, y.v_c))
    return PlantPhasors(
        i_s=quotient(scaled_sum(1.0, i_s, 1.0, product(c_31, y.i_g)), whole),
        v_c=quotient(scaled_sum(1.0, v_c, 1.0, product(c_32, y.i_g)), whole),
        i_g=quotient(scaled_sum(1.0, i_g, 1.0, product(c_33, y.i_g)), whole),
    )


def node_phasor(x: PlantPhasors, R_c: Any) -> Phasor:
    """The voltage at the control point."""
    return Phasor(x.v_c.re + R_c * (x.i_s.re - x.i_g.re), x.v_c.im + R_c * (x.i_s.im - x.i_g.im))


def sampled_path(
    transition: Transition,
    b_1: Any,
    b_2: Any,
    b_3: Any,
    of_constant: PlantPhasors,
    turn: Phasor,
    R_c: Any,
    V_g_rms: Any,
) -> SampledPath:
    """The path of :eq:`sampled-path` from the numbers of an interval: Φ, Γ (b), what the source adds and its turn."""
    bridge = PlantPhasors(Phasor(b_1, 0.0), Phasor(b_2, 0.0), Phasor(b_3, 0.0))
    per_bridge = rotating(transition, turn, bridge)
    from_source = rotating(transition, turn, of_constant)
    Z = quotient(node_phasor(per_bridge, R_c), per_bridge.i_g)
    behind = scaled_sum(1.0, node_phasor(from_source, R_c), -1.0, product(Z, from_source.i_g))
    V = rms_to_peak(V_g_rms) * np.sqrt(behind.re * behind.re + behind.im * behind.im)
    return SampledPath(R=Z.re, X=Z.im, V_rms=peak_to_rms(V), angle=np.arctan2(behind.im, behind.re))


def droop_step(
    V_rms: Any, delta: Any, P: Any, Q_0: Any, D_q: Any, V_g_rms: Any, R: Any, X: Any
) -> tuple[Any, Any, Any]:
    """One Newton step towards V∠δ that delivers P and Q = Q_0 − D_q V (:eq:`droop-quartic`).

    Returns (next_V, next_delta, error): V, rad, and by how much P and Q were wrong before it, as a share of the powers
    in the equation. It is NaN where there is no step.
    """
    P_is, Q_is = power_flow(delta, V_rms, V_g_rms, R, X)
    b, g = admittance(V_rms, R, X, R * R + X * X)
    A, B, C, D = jacobian_from_admittance(P_is, Q_is, V_rms, b, g)
    D = D + D_q
    e_P, e_Q = P - P_is, Q_0 - D_q * V_rms - Q_is
    determinant = A * D - B * C
    next_delta = delta + (D * e_P - B * e_Q) / determinant
    next_V = V_rms + (A * e_Q - C * e_P) / determinant
    return next_V, next_delta, np.maximum(np.abs(e_P), np.abs(e_Q)) / (np.hypot(b, g) + np.abs(Q_0))


class Rest(NamedTuple):
    """A steady state: P (W), Q (var), V (phase rms, V) and the angle to the source (rad) at the control point, the
    lengths of the converter's current (A peak) and of the bridge's voltage (V peak), and the powers at the PCC."""

    P: Any
    Q: Any
    V_rms: Any
    delta: Any
    i_s_pk: Any
    v_b_pk: Any
    P_pcc: Any
    Q_pcc: Any


def sampled_rest(
    transition: Transition,
    b_1: Any,
    b_2: Any,
    b_3: Any,
    of_constant: PlantPhasors,
    turn: Phasor,
    circuit: FilterGrid,
    V_g_rms: Any,
    V_rms: Any,
    delta: Any,
) -> Rest:
    """The steady state with V∠δ at the control point: every state of the circuit is affine in this voltage."""
    x, v, v_b = _states_at_rest(transition, b_1, b_2, b_3, of_constant, turn, circuit, V_g_rms, V_rms, delta)
    P, Q = instantaneous_power(v.re, v.im, x.i_g.re, x.i_g.im)
    at_pcc = Phasor(
        pcc_voltage(x.i_s.re, x.v_c.re, x.i_g.re, rms_to_peak(V_g_rms), circuit),
        pcc_voltage(x.i_s.im, x.v_c.im, x.i_g.im, 0.0, circuit),
    )
    P_pcc, Q_pcc = instantaneous_power(at_pcc.re, at_pcc.im, x.i_g.re, x.i_g.im)
    i_s_pk, v_b_pk = np.hypot(x.i_s.re, x.i_s.im), np.hypot(v_b.re, v_b.im)
    return Rest(P, Q, V_rms, delta, i_s_pk, v_b_pk, P_pcc, Q_pcc)


def bridge_power_at_rest(
    transition: Transition,
    b_1: Any,
    b_2: Any,
    b_3: Any,
    of_constant: PlantPhasors,
    turn: Phasor,
    circuit: FilterGrid,
    V_g_rms: Any,
    V_rms: Any,
    delta: Any,
    R_1: Any,
) -> Any:
    """The mean power that the bridge takes at the rest of :func:`sampled_rest`, W: that of the control point and of the
    losses before it."""
    x, v, _ = _states_at_rest(transition, b_1, b_2, b_3, of_constant, turn, circuit, V_g_rms, V_rms, delta)
    given, _ = instantaneous_power(v.re, v.im, x.i_s.re, x.i_s.im)
    lost, _ = instantaneous_power(x.i_s.re, x.i_s.im, x.i_s.re, x.i_s.im)
    return given + R_1 * lost


def _states_at_rest(
    transition: Transition,
    b_1: Any,
    b_2: Any,
    b_3: Any,
    of_constant: PlantPhasors,
    turn: Phasor,
    circuit: FilterGrid,
    V_g_rms: Any,
    V_rms: Any,
    delta: Any,
) -> tuple[PlantPhasors, Phasor, Phasor]:
    """The circuit's states, the voltage at the control point and that of the bridge."""
    bridge = PlantPhasors(Phasor(b_1, 0.0), Phasor(b_2, 0.0), Phasor(b_3, 0.0))
    per_bridge = rotating(transition, turn, bridge)
    from_source = each_sum(rms_to_peak(V_g_rms), rotating(transition, turn, of_constant), 0.0, per_bridge)
    v_pk = rms_to_peak(V_rms)
    v = Phasor(v_pk * np.cos(delta), v_pk * np.sin(delta))
    driven = scaled_sum(1.0, v, -1.0, node_phasor(from_source, circuit.R_c))
    v_b = quotient(driven, node_phasor(per_bridge, circuit.R_c))
    return each_sum(1.0, each_product(per_bridge, v_b), 1.0, from_source), v, v_b
