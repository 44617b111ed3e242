"""The power loops on boxes and arcs, by hand: which points count, the gains that an estimate leads to, and f.

Powers are in units of V²/\\|Z_g\\| and V is its logarithm: p = P\\|Z_g\\|/V², q alike.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.certificate.recheck.inner import Arcs, Cells, Inner
from vsgdesign.certificate.recheck.polynomials import Polynomial, Space
from vsgdesign.certificate.region import AtDesignPoint, Region
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains, Structure
from vsgdesign.study.parameters.study import Study

Array = Any

BOX = Space(6, 3)
"""Of the six coordinates of a box."""
PAIR = Space(7, 2)
"""Of these and the frequency on an arc."""
OMEGA = 6
"""The place of the frequency."""

SINGLE = 1e-6
"""Relative, by which a scheduler's limits may be off the nodes of its table: it has them in single precision."""

_LEAST_SHARE, _MARGIN = 0.2, 1.3
"""Of what the gains are made of (:eq:`well-posed`, :eq:`drawn-in`)."""


@dataclass(frozen=True)
class Ball:
    """All gains of an estimate as L Δ R about those of the middle (:eq:`moving-ball`): L (rows, rows), R (2, 2), the
    first of the rows, and both errors of the middle."""

    left: Array
    right: Array
    first: int
    middle: float


@dataclass(frozen=True, kw_only=True)
class Loops:
    """A study's power loops, and where they are looked at."""

    study: Study
    inner: Inner
    region: Region
    schedule: Any
    table: GainTable | None
    current: float | None
    """Limits at rest in pu of the rated current, and of the rated voltage."""
    bridge_voltage: float | None
    alpha: float
    divisor: float
    ball: Ball | None = None
    """Of gains that change; None: they are held."""

    @property
    def structure(self) -> Structure:
        """That of the power loops."""
        schedule = self.schedule.schedule if isinstance(self.schedule, AtDesignPoint) else self.schedule
        return STRUCTURES[schedule.structure]

    @property
    def kept_droops(self) -> bool:
        """Whether the droops are the same for all gains; else the products of gain and droop."""
        return bool(self.structure.P_droop)

    @property
    def estimate_by_reactance(self) -> bool:
        """Whether the first coordinate of an estimate is its reactance."""
        if self.table is not None:
            return self.table.base.scr_basis == "reactance"
        return self.inner.by_reactance


@dataclass(frozen=True)
class Boxes:
    """N boxes, each of a cell: what is at rest in them. ``estimate``: R̂ and X̂ in \\|Z_g\\|, with the table's place if
    there is one."""

    p: Polynomial
    q: Polynomial
    size: Polynomial
    path: tuple[Polynomial, Polynomial]
    """R and X from the control point to the source at the grid's frequency, in \\|Z_g\\|."""
    drop: Polynomial
    """(V_g/V)²."""
    estimate: tuple[Polynomial, Polynomial]
    fixed: tuple[Polynomial, Polynomial]
    """The inductor on the grid's side, in \\|Z_g\\| at the rated frequency."""
    parameters: tuple[Any, ...]
    """Normalised parameters of the schedule."""
    conditions: tuple[Polynomial, ...]
    """Each is at most zero at every point that counts."""


def boxes_of(loops: Loops, cells: Cells, index: Array, low: Array, high: Array, estimates: Array) -> Boxes:
    """Of boxes between limits (N, 6), each of the cell at its ``index``; ``estimates`` (N, 4) as in a proof's file."""
    inner = loops.inner
    size, along, across, inverse = (
        getattr(cells, name).take(index).into(BOX, (0, 1)) for name in ("size", "along", "across", "inverse")
    )
    one, other, p, q = (BOX.variable(low[:, k], high[:, k], k) for k in range(2, 6))
    fixed = inverse * inner.R_2, inverse * (inner.omega_n * inner.L_2)
    path = along + fixed[0], (across + fixed[1]) * (inner.omega / inner.omega_n)
    angle = 0.5 * (low[:, 1] + high[:, 1])
    estimate = tuple(
        _estimated(loops, value, at, c)
        for value, at, c in ((along, np.cos(angle), one), (across, np.sin(angle), other))
    )
    conditions: list[Polynomial] = []
    if loops.table is None:
        schedule = loops.schedule.schedule if isinstance(loops.schedule, AtDesignPoint) else loops.schedule
        parameters = tuple(schedule.normalised(0.0, 0.0))
    else:
        first, slope, conditions = _placed(loops, size, estimate, estimates)
        first, slope = _drawn(first, estimates[:, :2]), _drawn(slope, estimates[:, 2:])
        if np.isinf(estimates).any():
            estimate = _chosen(np.isinf(estimates).any(axis=1), _of_place(loops, first, slope, inverse), estimate)
        parameters = _parameters(loops.table, first.reciprocal(), slope, estimates)
    a, b = (x.take(index).into(BOX, (0, 1)) for x in cells.rest[2])
    source = a + b * inverse * _y(p, q)
    drop = _real(source * source.conjugate())
    found = Boxes(p, q, size, path, drop, (estimate[0], estimate[1]), fixed, parameters, ())
    conditions += _beyond_limits(loops, found, inverse, loops.region)
    return replace(found, conditions=tuple(conditions))


def _estimated(loops: Loops, value: Polynomial, at: Array, c: Polynomial) -> Polynomial:
    """R̂ or X̂ in \\|Z_g\\|: off by c times the larger of both errors, over the largest of all (:eq:`error-set`)."""
    e, e_Z = loops.region.error, loops.region.error_Z
    if not e_Z:
        return value * (c + 1.0)
    own, most = e * at >= e_Z, max(e, e_Z)
    return value * (c * np.where(own, e / most, 0.0) + 1.0) + c * np.where(own, 0.0, e_Z / most)


def _placed(loops: Loops, size: Polynomial, estimate: Any, limits: Array) -> tuple[Polynomial, Polynomial, list[Any]]:
    """First coordinate and R̂/X̂ of an estimate, and what says that they lie between limits (N, 4)."""
    R, X = estimate
    counted = X if loops.estimate_by_reactance else (R * R + X * X).sqrt()
    first = counted * size * (1.0 / loops.inner.Z_base)
    asked = np.isfinite(limits)
    edge = np.where(asked, limits, 0.0)
    conditions = []
    for k, sign in ((0, -1.0), (1, 1.0)):
        conditions.append(_where(asked[:, k], (first - edge[:, k]) * sign))
        conditions.append(_where(asked[:, 2 + k], (R - X * edge[:, 2 + k]) * sign))
    return first, R / X, conditions


def _drawn(x: Polynomial, limits: Array) -> Polynomial:
    """The edge (N, 2) where the other limit is infinite: that is where an estimate is drawn to."""
    edge = np.where(np.isinf(limits[:, 0]), limits[:, 1], limits[:, 0])
    inside = np.isfinite(limits).all(axis=1)
    return x * inside.astype(float) + np.where(inside, 0.0, edge)


def _of_place(loops: Loops, first: Polynomial, slope: Polynomial, inverse: Polynomial) -> Any:
    """R̂ and X̂ in \\|Z_g\\| from the first coordinate and R̂/X̂."""
    X = first * inverse * loops.inner.Z_base
    if not loops.estimate_by_reactance:
        X = X / (slope * slope + 1.0).sqrt()
    return X * slope, X


def _chosen(first: Array, ones: Any, others: Any) -> Any:
    """Per column, the one or the other."""
    weight = first.astype(float)
    found = []
    for one, other in zip(ones, others, strict=True):
        radius = np.where(first, one.radius, other.radius)
        found.append(Polynomial(one.space, one.c * weight + other.c * (1.0 - weight), radius))
    return tuple(found)


def _y(p: Polynomial, q: Polynomial) -> Polynomial:
    """i_g\\|Z_g\\|/V."""
    return (p + q * -1j) * (1.0 / PHASES)


def _real(x: Polynomial) -> Polynomial:
    return Polynomial(x.space, x.c.real, x.radius)


def _beyond_limits(loops: Loops, at: Boxes, inverse: Polynomial, region: Region) -> Iterator[Polynomial]:
    """The static limits (:eq:`static-limits`), and those of P and Q."""
    study, c = loops.study, loops.study.converter
    V_g = study.grid_source.V_g_rms
    p, q, drop, (r, x) = at.p, at.q, at.drop, at.path
    yield (r * r + x * x) * (p * p + q * q) * (_MARGIN / PHASES) ** 2 - 1.0
    least, most = c.V_limits_rms
    yield drop - (V_g / least) ** 2
    yield (V_g / most) ** 2 - drop
    for power, (low, high) in ((p, region.P), (q, region.Q)):
        yield power * V_g**2 - at.size * drop * high
        yield at.size * drop * low - power * V_g**2
    # Currents over V: those of the capacitor and of the grid; then the voltage before the inductor.
    f, w = study.filter, study.grid_source.omega_g
    shunt = 1j * w * f.C / (1.0 + 1j * w * f.C * f.R_c)
    current = _y(p, q) * inverse + shunt
    before = current * (f.R_1 + 1j * w * f.L_1) + 1.0
    rated = c.S_rated / (PHASES * c.V_rated_rms)
    for value, limit, unit in ((current, loops.current, rated), (before, loops.bridge_voltage, c.V_rated_rms)):
        if limit is not None:
            yield _real(value * value.conjugate()) * V_g**2 - drop * (limit * unit) ** 2


def _where(asked: Array, value: Polynomial) -> Polynomial:
    """Zero where nothing is asked."""
    return value * asked.astype(float)


_BEYOND = 1e-4
"""Of the spread of a column, as which an edge that is off a node by SINGLE counts: it is cut between nodes that are 1 %
apart or more."""


def _parameters(table: GainTable, scr: Polynomial, r_over_x: Polynomial, estimates: Array) -> tuple[Any, ...]:
    """Interpolated between four nodes in SCR and R/X (:eq:`bilinear`), each box within one cell of the table."""
    x, y = table.scr, 1.0 / table.x_over_r[::-1]
    limits = np.where(np.isinf(estimates), estimates[:, [1, 0, 3, 2]], estimates)
    at_x, at_y = 2.0 / (limits[:, 0] + limits[:, 1]), 0.5 * (limits[:, 2] + limits[:, 3])
    i = np.clip(np.searchsorted(x, at_x) - 1, 0, len(x) - 2)
    j = np.clip(np.searchsorted(y, at_y) - 1, 0, len(y) - 2)
    u, v = (scr - x[i]) * (1.0 / (x[i + 1] - x[i])), (r_over_x - y[j]) * (1.0 / (y[j + 1] - y[j]))
    uv = u * v
    found = []
    for values in table.parameters.values():
        own = values[:, ::-1]
        if np.ptp(own) == 0.0:
            found.append(float(own.flat[0]))
            continue
        a, b, c, d = own[i, j], own[i + 1, j], own[i, j + 1], own[i + 1, j + 1]
        value = u * (b - a) + v * (c - a) + uv * (d - b - c + a) + a
        found.append(value.widened(_BEYOND * np.ptp(own)))
    return tuple(found)


def jacobians(loops: Loops, at: Boxes) -> Iterator[tuple[Array, tuple[Polynomial, ...]]]:
    """The Jacobians that gains may be made of, A, B, C and D, each with the boxes in which it may occur, (N,)."""
    r, x = (one + two for one, two in zip(at.estimate, at.fixed, strict=True))
    length = r * r + x * x
    if isinstance(loops.schedule, AtDesignPoint):
        yield np.ones(len(at.drop.radius), dtype=np.bool_), _at_design_point(loops, at, r, x, length)
        return
    over = length.reciprocal() * PHASES
    wanted = length * (at.p * at.p + at.q * at.q) * (_MARGIN / PHASES) ** 2
    least, most = wanted.limits()
    root = wanted.sqrt()
    for drawn, sign in itertools.product((False, True), (0, 1, -1)):
        good = most > 1.0 if drawn else least < 1.0
        share = over * root if drawn else over
        b, g = share * x, share * r
        limit = b * (1.0 - _LEAST_SHARE)
        above, below = (limits for limits in ((at.q - limit).limits(), (-at.q - limit).limits()))
        if sign == 0:
            good = good & (above[0] <= 0.0) & (below[0] <= 0.0)
        else:
            good = good & ((above if sign > 0 else below)[1] > 0.0)
        if good.any():
            q = at.q if sign == 0 else limit * float(sign)
            yield good, (b - q, at.p + g, at.p - g, b + q)


def _at_design_point(loops: Loops, at: Boxes, r: Polynomial, x: Polynomial, length: Polynomial) -> Any:
    """At the design point on the estimated grid, in the same unit of power as everything."""
    s = loops.schedule.schedule
    V_g = loops.study.grid_source.V_g_rms
    unit = at.size * at.drop * (1.0 / V_g**2)  # |Z_g|/V²
    p, q = unit * s.P, unit * s.Q
    source = at.drop * (s.V_g_rms / V_g) ** 2
    half = (r * p + x * q) * (1.0 / PHASES) + source * 0.5
    V_sq = half + (half * half - length * (p * p + q * q) * (1.0 / PHASES**2)).sqrt()
    scale = V_sq * length.reciprocal() * PHASES
    b, g = scale * x, scale * r
    # The voltage of the design point is not that of the rest, whose logarithm counts.
    over = V_sq.sqrt().reciprocal()
    return b - q, (p + g) * over, p - g, (b + q) * over


def made_of(loops: Loops, at: Boxes, J: tuple[Polynomial, ...]) -> dict[str, Any]:
    """What the power loops are made of, as polynomials of PAIR: the gains that the structure makes of a Jacobian in
    units of V²/\\|Z_g\\| over rad and ln V, and their products with that (:eq:`full-order-loops`)."""
    s = loops.schedule.schedule if isinstance(loops.schedule, AtDesignPoint) else loops.schedule
    structure = STRUCTURES[s.structure]
    D_p, D_q = structure.droops(s.D_p, s.D_q)
    V_g = loops.study.grid_source.V_g_rms
    unit = at.size * at.drop * (1.0 / V_g**2)
    V_unit = at.size * at.drop.sqrt() * (1.0 / V_g)
    parameters = NormalisedGains(*at.parameters)
    A, B, C, D = J
    g = structure.gains(A, B, C, D, parameters, unit * D_p, V_unit * D_q, unit * s.S_rated, s.omega, s.law == "inertia")
    D = D + g.D_q
    found = {
        "kappa_delta": A * g.k_P + C * g.k_Q + g.K_ip * g.D_p,
        "kappa_V": B * g.k_P + D * g.k_Q,
        "iota_delta": A * g.K_ip + C * g.K_pq,
        "iota_V": B * g.K_ip + D * g.K_pq,
        "nu_delta": A * g.K_qp + C * g.K_iq,
        "nu_V": B * g.K_qp + D * g.K_iq,
        "slope": g.K_qp * g.D_p,
        **{name: getattr(g, name) for name in ("k_P", "k_Q", "K_ip", "K_pq", "K_qp", "K_iq", "D_p", "D_q")},
        **dict(zip("ABCD", J, strict=True)),
    }
    return {name: x.into(PAIR, _COORDINATES) if isinstance(x, Polynomial) else x for name, x in found.items()}


_COORDINATES = tuple(range(6))


def f_of(loops: Loops, arcs: Arcs, arc: Array, at: Boxes, made: dict[str, Any], box: Array) -> Polynomial:
    """det M/(s + divisor)³ on pairs of an arc and a box, by their numbers (n,) (:eq:`full-order-determinant`)."""
    return loop_of(loops, arcs, arc, at, made, box)[0]


def loop_of(loops: Loops, arcs: Arcs, arc: Array, at: Boxes, made: dict[str, Any], box: Array) -> tuple[Any, ...]:
    """f, the entries of M, what δ and ln V do to the filtered P and Q, s, and 1/(s + divisor)³, as :func:`f_of`."""
    places = (0, 1, OMEGA)
    s = arcs.s.take(arc).into(PAIR, places)
    p, q = (x.take(box).into(PAIR, _COORDINATES) for x in (at.p, at.q))
    y, y_c = _y(p, q), _y(p, -q)
    plus, minus = ([x.take(arc).into(PAIR, places) for x in one] for one in arcs.answers)
    F_P, F_Q = (x.take(arc).into(PAIR, places) * (0.5 * PHASES) for x in arcs.filters)
    k = {name: v.take(box) if isinstance(v, Polynomial) else v for name, v in made.items()}

    def powers(v: Polynomial, i: Polynomial, v_other: Polynomial, i_other: Polynomial) -> tuple[Any, Any]:
        up, down = v * y_c + i_other, v_other * y + i
        return F_P * (up + down), F_Q * ((up - down) * -1j)

    v_1, v_y, v_V, i_1, i_y, i_V = plus
    o_1, o_y, o_V, n_1, n_y, n_V = minus
    P_d, Q_d = powers(v_1 + v_y * y, i_1 + i_y * y, o_1 + o_y * y_c, n_1 + n_y * y_c)
    P_V, Q_V = powers(v_V, i_V, o_V, n_V)
    answers = (P_d, Q_d), (P_V, Q_V)
    P_d, P_V, Q_d, Q_V = P_d - k["A"], P_V - k["B"], Q_d - k["C"], Q_V - k["D"]
    by_P, by_Q = s * k["k_P"] + k["K_ip"], s * k["k_Q"] + k["K_pq"]
    m_11 = s * (s + k["kappa_delta"]) + k["iota_delta"] + by_P * P_d + by_Q * Q_d
    m_12 = s * k["kappa_V"] + k["iota_V"] + by_P * P_V + by_Q * Q_V
    m_21 = s * k["slope"] + k["nu_delta"] + P_d * k["K_qp"] + Q_d * k["K_iq"]
    m_22 = s + k["nu_V"] + P_V * k["K_qp"] + Q_V * k["K_iq"]
    over = (s + loops.divisor).reciprocal()
    over = over * over * over
    return (m_11 * m_22 - m_12 * m_21) * over, (m_11, m_12, m_21, m_22), answers, s, over
