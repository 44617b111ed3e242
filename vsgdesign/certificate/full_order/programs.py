"""The power loops around the inner loops as programs for boxes: what is at rest, the gains, and det M on an arc.

A box is one of true grids and of the errors of their estimates. Nothing of the schedule, its structure or the law of
the power loops is written a second time: the equations run on symbols, as in :mod:`vsgdesign.certificate.enclosure`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.boxes import basis_of, first_extra
from vsgdesign.certificate.enclosure import (
    PIECES,
    Estimate,
    Loops,
    distinct_choices,
    signs_of,
    voltage_conditions,
)
from vsgdesign.certificate.full_order.inner import FUNCTIONS
from vsgdesign.certificate.region import AtDesignPoint, Region, System
from vsgdesign.certificate.tracing import Program, Symbol, Tracer, program_of
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import jacobian_from_powers, operating_point_discriminant
from vsgdesign.equations.power_loops import References, power_loops
from vsgdesign.equations.sampled_path import Phasor, product, scaled_sum
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.runtime.table import TableSchedule

Array = NDArray[np.float64]

COORDINATES = 6
"""Of a box: first coordinate and angle of the true grid; the two errors of the estimate; p and q."""

DIMENSIONS = 7
"""Of a form: the coordinates, and the frequency on an arc."""

AT_REST = 4
"""Real numbers of a cell beside the coordinates: of V_g/V as first + second·i_g\\|Z\\|/V."""

INPUTS = COORDINATES + AT_REST + 1
"""Of the programs of gains: the last one is any number between −1 and 1, by which a table's column may be off."""

WITHIN, DRAWN = 8, 10
"""Parameters of a piece of a table: what says that an estimate lies in it, and where it is drawn to; see
:class:`_Place`. By how much each column may be off follows."""


@dataclass(frozen=True)
class FullOrderPrograms:
    """``situation``: coordinates and the rest's numbers to what tells the pieces of the schedule apart, and the
    ``conditions``. ``gains``: for each piece, the same to what the power loops are made of. ``arcs``: for
    each piece, p, q, s, 1/(s + divisor)³, the functions of an arc and the numbers of ``gains`` to Re f and Im f."""

    situation: Program
    conditions: Array
    signs: NDArray[np.int64]
    gains: tuple[Program, ...]
    arcs: tuple[Program, ...]
    numbers: tuple[tuple[float | None, ...], ...]
    """For each piece, which of what the power loops are made of are numbers; None: an output of ``gains``."""


class Chart:
    """The symbols of a box and what follows from them."""

    def __init__(self, system: System, region: Region, tracer: Tracer, drawn: bool) -> None:
        first, angle, *errors, self.p, self.q = tracer.symbols()[:COORDINATES]
        rest = tracer.symbols()[COORDINATES : COORDINATES + AT_REST]
        self.along, self.across = np.cos(angle), np.sin(angle)
        self.size = SCR_BASES[system.study.scr_basis].magnitude(first, self.across)
        self.conditions: list[tuple[Any, float, float]] = []
        direction = _estimate(region, tracer, (self.along, self.across), errors)
        if isinstance(system.schedule, TableSchedule):
            place = _Place.of(system, self.size, direction)
            self.conditions += place.within(tracer)
            if drawn:
                place = place.drawn(tracer)
            self.here = Estimate.about(system, self.size, place.direction, place.first, place.slope)
        else:
            self.here = Estimate.about(system, self.size, direction)
        y = Phasor(self.p * (1.0 / PHASES), self.q * (-1.0 / PHASES))
        V_g = scaled_sum(1.0, Phasor(rest[0], rest[1]), 1.0, product(Phasor(rest[2], rest[3]), y))
        drop = V_g.re * V_g.re + V_g.im * V_g.im
        # From the control point to the source, in |Z_g|.
        fixed, share = self.here.fixed, self.here.share
        path = self.along + fixed[0], (self.across + fixed[1]) * share
        self.inverse_V, more = voltage_conditions(system, region, self.p, self.q, path, self.here.base, drop)
        self.conditions += more


def _estimate(region: Region, tracer: Tracer, truth: tuple[Symbol, Symbol], errors: Sequence[Symbol]) -> Any:
    """R̂ and X̂ in \\|Z_g\\|, by the coordinates of their errors (:eq:`error-set`): R(1 + a c) + b c\\|Z_g\\|."""
    if not region.error_Z:
        return tuple(value * (1.0 + c) for value, c in zip(truth, errors, strict=True))
    found = []
    for k, (value, c) in enumerate(zip(truth, errors, strict=True)):
        found.append(value + tracer.blend((2 * k, 2 * k + 1), (value * c, c)))
    return tuple(found)


@dataclass(frozen=True)
class _Place:
    """An estimate in \\|Z_g\\| and its place in a table; ``more``: the first of the parameters that its piece has
    beside those of the errors and the columns."""

    direction: tuple[Symbol, Symbol]
    size: Symbol
    counted: Symbol
    first: Symbol
    slope: Symbol
    more: int

    @classmethod
    def of(cls, system: System, size: Symbol, direction: tuple[Symbol, Symbol]) -> _Place:
        counted = basis_of(system).counted(*direction)
        return cls(direction, size, counted, counted * size, direction[0] / direction[1], first_extra(system))

    def within(self, tracer: Tracer) -> list[tuple[Any, float, float]]:
        """What says that it lies in the piece: limits of the first coordinate, and of R̂/X̂."""
        one = tracer.constant(1.0)
        every = [tracer.blend((self.more + k, self.more + k + 1), (self.first, one)) for k in (0, 2)]
        every += [tracer.blend((self.more + k, self.more + k + 1), self.direction) for k in (4, 6)]
        return [(value, -np.inf, 0.0) for value in every]

    def drawn(self, tracer: Tracer) -> _Place:
        """As the scheduler draws it in: at an edge of the SCR with its R̂/X̂, at one of R/X with its SCR."""
        one = tracer.constant(1.0)
        keeps, edge, keeps_slope, edge_slope, *rest = range(self.more + WITHIN, self.more + WITHIN + DRAWN)
        inside, moved, *units = rest
        to_edge, inverse = self.first.reciprocal(), self.size.reciprocal()
        direction = [
            tracer.blend((inside, moved, *unit), (own, own * to_edge, self.counted, inverse))
            for own, unit in zip(self.direction, (units[:2], units[2:]), strict=True)
        ]
        first = tracer.blend((keeps, edge), (self.first, one))
        slope = tracer.blend((keeps_slope, edge_slope), (self.slope, one))
        return _Place((direction[0], direction[1]), self.size, self.counted, first, slope, self.more)


def full_order_programs(system: System, region: Region, drawn: bool, ratio: bool) -> FullOrderPrograms:
    """The programs of a study's loops in a region; ``drawn``: whether estimates are drawn to a table's edges;
    ``ratio``: whether the filters of P and Q differ."""
    tracer = Tracer(COORDINATES + AT_REST)
    chart = Chart(system, region, tracer, drawn)
    pieces = PIECES if not isinstance(system.schedule, AtDesignPoint) else (PIECES[0],)
    choices: list[list[Symbol]] = []
    if len(pieces) > 1:
        choices = [chart.here.scheduled(chart.p, chart.q, first)[1] for first in pieces]
    asked = distinct_choices(choices) if choices else []
    situation = program_of(tracer, [*asked, *(value for value, _, _ in chart.conditions)])
    between = np.array([[low, high] for _, low, high in chart.conditions])
    signs = signs_of(choices, asked) if choices else np.zeros((1, 0), dtype=np.int64)
    gains, arcs, numbers = [], [], []
    for piece in pieces:
        parts, program = _gains(system, region, drawn, piece)
        gains.append(program)
        arcs.append(_arc(parts, ratio))
        numbers.append(tuple(parts))
    return FullOrderPrograms(situation, between, signs, tuple(gains), tuple(arcs), tuple(numbers))


def _gains(system: System, region: Region, drawn: bool, piece: Sequence[bool]) -> tuple[list[float | None], Program]:
    """What the power loops are made of, as a program: of each the number where it is one, None where it is a form."""
    tracer = Tracer(INPUTS)
    loops = loops_on(system, Chart(system, region, tracer, drawn), tracer, piece)
    return values_program(tracer, loops, values_of(loops))


def loops_on(system: System, chart: Chart, tracer: Tracer, piece: Sequence[bool]) -> Loops:
    """The power loops with the gains of a chart's estimate, on a piece of the schedule."""
    here, inverse_V, schedule = chart.here, chart.inverse_V, system.schedule
    plain = system
    if isinstance(schedule, AtDesignPoint):
        plain = replace(system, schedule=schedule.schedule)
        J = _at_design_point(plain, here, inverse_V)
        normalised = schedule.schedule.normalised(0.0, 0.0)
    else:
        J, _ = here.scheduled(chart.p, chart.q, piece)
        of_table = isinstance(schedule, TableSchedule)
        normalised = _of_columns(system, tracer, here) if of_table else here.normalised(tracer)
    return Loops.of(plain, normalised, J, inverse_V, here.base)


def _of_columns(system: System, tracer: Tracer, here: Estimate) -> NormalisedGains:
    """A table's columns over all estimates of a box: their forms, and what they may be off by (:mod:`.columns`)."""
    unknown, first = tracer.symbols()[-1], first_extra(system) + WITHIN + DRAWN
    return NormalisedGains(
        *(
            value + tracer.blend((first + k,), (unknown,)) if isinstance(value, Symbol) else value
            for k, value in enumerate(here.normalised(tracer))
        )
    )


def values_of(loops: Loops) -> list[Any]:
    """What :eq:`full-order-loops` is made of, in the order in which :class:`LoopsOnArc` takes it."""
    algebra, gains = loops.algebra, loops.gains
    A, B, C, D = loops.J
    none = References(0.0, 0.0, 0.0, 0.0)
    values: list[Any] = []
    # Per unit of δ and of ln V: ω less that of the integrator, then both rates where ω is held
    # (:eq:`full-order-loops`).
    for V, P, Q in ((0.0, A, C), (1.0, B, D)):
        omega, _, _ = power_loops(0.0, V, P, Q, none, gains)
        still, rate, slope = power_loops(-omega, V, P, Q, none, gains)
        if algebra.value(still).terms:
            raise ValueError("the law's frequency is not the integrator and a part of the powers")
        values += [-omega, -rate, -slope]
    # The droop acts on the whole frequency, which is sδ; with what the angle path damps, most of it cancels.
    _, rate, slope = power_loops(1.0, 0.0, 0.0, 0.0, none, gains)
    values[0] = values[0] - rate
    values.append(-slope)
    return [*values, gains.k_P, gains.k_Q, gains.K_ip, gains.K_pq, gains.K_qp, gains.K_iq, A, B, C, D]


def values_program(tracer: Tracer, loops: Loops, values: Sequence[Any]) -> tuple[list[float | None], Program]:
    """Values of the loops' algebra as a program: of each the number where it is one, None where it is an output."""
    algebra = loops.algebra
    outputs: list[Any] = []
    parts: list[float | None] = []
    for value in values:
        terms = algebra.value(value).terms
        if not terms or set(terms) == {()}:
            parts.append(terms.get((), 0.0))
            continue
        parts.append(None)
        outputs.append(algebra.symbol(algebra.value(value)).whole())
    return parts, program_of(tracer, outputs)


def _at_design_point(system: System, here: Estimate, inverse_V: Symbol) -> tuple[Any, Any, Any, Any]:
    """The Jacobian of the design point on the estimated grid, in units of the true one: V is 1, and \\|Z_g\\|."""
    s: Any = system.schedule
    c = system.study.converter
    powers = here.base * (inverse_V * inverse_V) * (1.0 / c.S_rated)
    P, Q = powers * s.P, powers * s.Q
    V_g = inverse_V * (s.V_g_rms / c.V_rated_rms)
    r, x = here.direction[0] + here.fixed[0], here.direction[1] + here.fixed[1]
    b_0, discriminant = operating_point_discriminant(P, Q, V_g, r, x)
    V = ((b_0 + discriminant.sqrt()) * 0.5).sqrt()
    return jacobian_from_powers(P, Q, V, r, x)


class LoopsOnArc:
    """The symbols of an arc with the power loops on it: M of :eq:`full-order-loops`, and FG, what δ and ln V do to the
    filtered powers. ``more``: the parts beyond those of :func:`values_of`."""

    def __init__(self, parts: Sequence[float | None], ratio: bool, given: int = 0) -> None:
        own = sum(part is None for part in parts)
        self.tracer = Tracer(2 + 4 + 2 * FUNCTIONS + (2 if ratio else 0) + own + given)
        symbols = iter(self.tracer.symbols())
        p, q = next(symbols), next(symbols)
        self.s, self.divided = (Phasor(next(symbols), next(symbols)) for _ in range(2))
        functions = [Phasor(next(symbols), next(symbols)) for _ in range(FUNCTIONS)]
        of_Q = Phasor(next(symbols), next(symbols)) if ratio else None
        values = [next(symbols) if part is None else part for part in parts]
        self.given = list(symbols)
        kap_d, iota_d, nu_d, kap_V, iota_V, nu_V, self.slope, *rest = values
        k_P, k_Q, K_ip, K_pq, K_qp, K_iq, A, B, C, D, *self.more = rest
        y = Phasor(p * (1.0 / PHASES), q * (-1.0 / PHASES))
        self.FG = _powers(functions, y, of_Q)
        d_P, d_Q, V_P, V_Q = (
            Phasor(power.re - own, power.im) for power, own in zip(self.FG, (A, C, B, D), strict=True)
        )

        def acts(first: Any, second: Any, P: Phasor, Q: Phasor) -> Phasor:
            return plus(times(first, P), times(second, Q))

        s = self.s
        self.m_11 = plus(
            plus(product(s, s), product(s, plus(Phasor(kap_d, 0.0), acts(k_P, k_Q, d_P, d_Q)))),
            plus(Phasor(iota_d, 0.0), acts(K_ip, K_pq, d_P, d_Q)),
        )
        self.m_12 = plus(
            product(s, plus(Phasor(kap_V, 0.0), acts(k_P, k_Q, V_P, V_Q))),
            plus(Phasor(iota_V, 0.0), acts(K_ip, K_pq, V_P, V_Q)),
        )
        self.m_21 = plus(times(self.slope, s), plus(Phasor(nu_d, 0.0), acts(K_qp, K_iq, d_P, d_Q)))
        self.m_22 = plus(s, plus(Phasor(nu_V, 0.0), acts(K_qp, K_iq, V_P, V_Q)))

    def determinant(self) -> Phasor:
        """det M."""
        return minus(product(self.m_11, self.m_22), product(self.m_12, self.m_21))


def plus(a: Phasor, b: Phasor) -> Phasor:
    """a + b."""
    return scaled_sum(1.0, a, 1.0, b)


def minus(a: Phasor, b: Phasor) -> Phasor:
    """a − b."""
    return scaled_sum(1.0, a, -1.0, b)


def times(real: Any, a: Phasor) -> Phasor:
    """A real multiple."""
    return Phasor(real * a.re, real * a.im)


def _powers(functions: Sequence[Phasor], y: Phasor, of_Q: Phasor | None) -> list[Phasor]:
    """P and Q of δ, then P and Q of ln V (:eq:`full-order-powers`)."""
    y_c = Phasor(y.re, -y.im)
    a_1, a_2, b_1, b_2, c, e = functions[:6]
    o_1, o_2, n_1, n_2, g, h = functions[6:]
    # (v ī_g + v̄' ...): the signal's own voltage with the current at rest, and the conjugate signal's current.
    S_d = plus(product(plus(a_1, product(a_2, y)), y_c), plus(n_1, product(n_2, y_c)))
    T_d = plus(product(plus(o_1, product(o_2, y_c)), y), plus(b_1, product(b_2, y)))
    S_V, T_V = plus(product(c, y_c), h), plus(product(g, y), e)
    found: list[Phasor] = []
    for S, T in ((S_d, T_d), (S_V, T_V)):
        apart = minus(S, T)
        Q = Phasor(apart.im, -apart.re)
        found += [plus(S, T), Q if of_Q is None else product(Q, of_Q)]
    return found


def _arc(parts: Sequence[float | None], ratio: bool) -> Program:
    """Re f and Im f, f = det M/(s + divisor)³ (:eq:`full-order-determinant`)."""
    loops = LoopsOnArc(parts, ratio)
    f = product(loops.determinant(), loops.divided)
    return program_of(loops.tracer, [f.re, f.im])
