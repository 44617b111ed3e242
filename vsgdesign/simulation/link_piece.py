"""An interval in which the voltage of the dc link moves that of the bridge, in the body of a loop (:eq:`dc-edges`), and
the slope of the grid current over it.

The circuit has made its step with the voltage that the link has at the beginning. Here filter and link are moved
together, and what the link's change does to every state is added from the circuit's responses to edges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.blocks import Traced, Writer, chosen, expression
from vsgdesign.codegen.flat import Block
from vsgdesign.equations.dc_link import DcSettings
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.model.dc_link import Edge, Interval, SourceLaw, link_over, sum_of
from vsgdesign.linear.operating_point.plant import state_matrices
from vsgdesign.simulation.axes import Axes
from vsgdesign.simulation.circuits import Circuits
from vsgdesign.simulation.run_kind import LARGEST_DEGREE, Kind
from vsgdesign.simulation.timeline import Segments
from vsgdesign.study.parameters.study import Study

RAN = ("v", "voltage", "squares", "taken", "elapsed")
"""What is handed from one piece of an interval to the next: the voltage of the link, the integrals of v and v², the
energy that the bridge took, and how much of the interval is over."""

NODES_OF_SAMPLE, NODES_OF_PIECE = 4, 3
"""Nodes of Gauss over an interval without edges, and between two edges, which are nearer."""

_OF_LINK = ("over_C", "R_1", "over_L_1", "over_C_f", "R_c")


def axes_of(kind: Kind) -> Axes:
    """The axes of a kind, also where they are alike."""
    return kind.axes or Axes(6, LARGEST_DEGREE, coupled=False)


def names_of_circuit(kind: Kind) -> list[str]:
    """The numbers of a circuit: its interval, s; what the slope of the grid current over it is per state and per source
    at the beginning and at the end, A, and how the source bends it; with networks whether this current is too fast to
    be moved with the filter, the slope of this slope without the filter's part, and what the first six states become
    where the circuit begins."""
    axes = axes_of(kind)
    return [name for name, kept in zip(_every_name(axes), kept_of_slopes(axes), strict=True) if kept]


def _every_name(axes: Axes) -> list[str]:
    """The same of circuits whose axes act on each other and whose states may jump."""
    states = range(axes.states)
    found = ["slope.h", "slope.fast", "slope.arc", *(f"slope.x_{axis}_{k}" for axis in range(2) for k in states)]
    ends = [f"{when}_{axis}_{j}" for when in ("begin", "end") for axis in range(2) for j in range(2)]
    found += [f"slope.{end}" for end in ends]
    found += [f"slope.bend_{axis}_{k}" for axis in range(2) for k in states] + [f"slope.bend_{end}" for end in ends]
    return found + [f"slope.on_{row}_{k}" for row in range(6) for k in states]


def kept_of_slopes(axes: Axes) -> NDArray[np.bool_]:
    """Which of these a circuit has."""
    on = np.array([[k % 2 in axes.on(row) for k in range(axes.states)] for row in range(6)])
    bends = np.concatenate([on[:2].ravel(), np.ones(8, dtype=bool)]) & axes.jumps
    return np.concatenate(
        [[True, axes.jumps, not axes.jumps], on[:2].ravel(), np.ones(8, dtype=bool), bends, (on & axes.jumps).ravel()]
    )


def voltage_of_piece() -> Block:
    """The bridge's voltage at the beginning of a piece: that of the sample, with the voltage that the link has now."""
    line = Writer()
    share = line.does("/", line.input("running.v"), line.input("dc.v"))
    for axis in ("alpha", "beta"):
        line.output(f"piece.{axis}", line.does("*", line.input(f"acting.{axis}"), share))
    return line.block()


class _GridSlope:
    """The slope of the grid current of one axis over a piece."""

    def __init__(
        self,
        number_of: Callable[[str], Traced],
        own: Sequence[int],
        axis: int,
        begin: Sequence[Traced],
        end: Sequence[Traced],
        source: Sequence[Traced],
    ) -> None:
        """``begin``, ``end``: all states, as they are before the circuit begins and at the end."""
        self._number, self._own, self._axis = number_of, own, axis
        self._ends = (("begin", begin), ("end", end))
        self._source = source

    def _of(self, head: str, states: Sequence[Any], which: Sequence[int]) -> Any:
        return sum_of([self._number(f"slope.{head}_{self._axis}_{k}") * states[k] for k in which])

    def _filter(self) -> dict[int, Any]:
        return {k: self._number(f"slope.x_{self._axis}_{k}") for k in self._own if k < 6}

    def alone(self) -> tuple[dict[int, Any], list[Any]]:
        """What the filter's states do, and the rest, which is the source's alone, as a parabola: it bends with −ω²."""
        first, last = (self._of(when, self._source, (0, 1)) for when, _ in self._ends)
        arc = self._number("slope.arc") * (first + last)
        return self._filter(), [first, last - first - arc, arc]

    def bent(self, start: Sequence[Any]) -> tuple[dict[int, Any], list[Any]]:
        """The same with a network: the rest is a cubic. Where the grid current is too fast, it is a cubic itself.
        ``start``: what the first six states become where the circuit begins."""
        near, rest, bends, whole = self._filter(), [], [], []
        for (when, states), six in zip(self._ends, (start, self._ends[1][1]), strict=True):
            whole.append(self._of("x", states, self._own) + self._of(when, self._source, (0, 1)))
            rest.append(whole[-1] - sum_of([one * six[k] for k, one in near.items()]))
            bends.append(self._of("bend", states, self._own) + self._of(f"bend_{when}", self._source, (0, 1)))
        fast, g = self._number("slope.fast"), 4 + self._axis
        current = _cubic(0.0, self._ends[1][1][g] - start[g], *whole)
        straight = [current[1], 2.0 * current[2], 3.0 * current[3], 0.0]
        left = [one + fast * (other - one) for one, other in zip(_cubic(*rest, *bends), straight, strict=True)]
        return {k: one * (1.0 - fast) for k, one in near.items()}, left


def link_over_piece(kind: Kind, arrived: str, edges: Sequence[str], number: int) -> Block:
    """The circuit's states at the end of a piece, and the link there. ``arrived``: what the states are called that they
    have without a change of the link; ``edges``: names of the edges of a switched bridge; ``number``: of the piece."""
    line, axes, cut = Writer(), axes_of(kind), bool(kind.cut)
    dc = kind.dc
    if dc is None:
        raise ValueError("the dc link is ideal.")

    def number_of(name: str) -> Traced:
        return Traced(line, line.input(name))

    def linear(head: str, row: int, values: Sequence[Any], own: Sequence[int]) -> Any:
        return sum_of([number_of(f"slope.{head}_{row}_{k}") * values[k] for k in own])

    own = [[k for k in range(axes.states) if k % 2 in axes.on(row)] for row in range(6)]
    x = [number_of(f"x.{name}") for name in kind.states]
    begin = [linear("on", row, x, own[row]) for row in range(6)] if axes.jumps else x[:6]
    after = [number_of(f"{arrived}.{name}") for name in kind.states]
    source = [number_of("source.cosine"), number_of("source.sine")]
    if kind.ramped:
        source = [one * number_of("ramp.V_pk") for one in source]
    near, rest = [], []
    for k in range(2):
        slopes = _GridSlope(number_of, own[k], k, x, after, source)
        of_filter, left = slopes.alone() if not axes.jumps else slopes.bent(begin)
        near.append(of_filter)
        rest.append(left)
    v, over_v = number_of("running.v"), 1.0 / number_of("running.v")
    head = "bridge" if edges else "piece"
    h, elapsed = number_of("slope.h"), number_of("running.elapsed") if number else 0.0
    share = h / number_of("link.T_s") if cut else 1.0
    of = Interval(
        h=h,
        elapsed=elapsed,
        share=share,
        x=begin,
        near=near,
        rest=rest,
        switching=[] if dc.held else [number_of(f"{head}.{axis}") * over_v for axis in ("alpha", "beta")],
        held=[number_of(f"acting.{axis}") for axis in ("alpha", "beta")] if dc.held else None,
        edges=[one for k in range(0, len(edges), 3) for one in _in_order(line, edges[k : k + 3], over_v)],
    )
    held = {name: number_of(f"held.{name}") for name in SourceLaw._fields[1:]}
    settings = DcSettings(
        **dict.fromkeys(DcSettings._fields, 0.0) | {name: number_of(f"link.{name}") for name in _OF_LINK}
    )
    degree = 0 if dc.held else axes.degree
    nodes = NODES_OF_PIECE if edges else NODES_OF_SAMPLE
    law = SourceLaw(number_of("dc.v"), **{k: v if k not in dc.absent else 0.0 for k, v in held.items()})
    found = link_over(v, of, law, settings, order=dc.order, nodes=nodes, degree=degree)
    for row, name in enumerate(kind.states):
        terms = [after[row]]
        for axis in axes.on(row):
            terms += [number_of(_edge(kind, k + 1, row, axis)) * found.moments[axis][k] for k in range(degree)]
        line.output(f"coupled.{name}", expression(sum_of(terms)))
    ran = {"v": found.v, "elapsed": elapsed + share}
    for name in ("voltage", "squares", "taken"):
        before = number_of(f"running.{name}") if number else None
        ran[name] = getattr(found, name) if before is None else before + getattr(found, name)
    for name in RAN:
        line.output(f"ran.{name}", expression(ran[name]))
    return line.block()


def _cubic(begin: Any, end: Any, slope_begin: Any, slope_end: Any) -> list[Any]:
    """Coefficients of the cubic with these values and slopes at 0 and 1."""
    step, both = end - begin, slope_begin + slope_end
    return [begin, slope_begin, 3.0 * step - slope_begin - both, both - 2.0 * step]


def _edge(kind: Kind, k: int, row: int, axis: int) -> str:
    """The name of a coefficient of an edge polynomial."""
    return f"edge.{('i_s', 'v_c', 'i_g')[row // 2]}.c{k}" if kind.axes is None else f"edge.c{k}_{row}_{axis}"


def _in_order(line: Writer, names: Sequence[str], over_v: Traced) -> list[Edge]:
    """Three edges on one slope of the carrier as changes of the switching vector, the earliest first. One that is not
    there changes nothing, wherever it is."""
    found = []
    for name in names:
        left, alpha, beta = (Traced(line, line.input(f"{name}.{part}")) for part in ("place", "alpha", "beta"))
        found.append(Edge(0.5 - 0.5 * left, alpha * over_v, beta * over_v))
    for k in (0, 1, 0):
        one, other = found[k], found[k + 1]
        later = one.place > other.place
        found[k] = Edge(*(chosen(later, b, a) for a, b in zip(one, other, strict=True)))
        found[k + 1] = Edge(*(chosen(later, a, b) for a, b in zip(one, other, strict=True)))
    return found


Array = NDArray[np.float64]


class GridSlopes(NamedTuple):
    """What the slope of the grid current over an interval is, A, in n runs, and what becomes of the first states where
    it begins (:mod:`vsgdesign.simulation.link_piece`)."""

    h: Array
    """s (n,)."""
    fast: Array
    """(n,): 1 where it is too fast to be moved with the filter, else 0."""
    per_state: Array
    """(n, 2, S)."""
    per_source: Array
    """(n, 2, 2): for the components of the source, V peak."""
    begin: Array
    end: Array
    """Angles of the source at the beginning and at the end over its phasor at the sample, rad (n,)."""
    bend_per_state: Array
    bend_per_source: Array
    """(n, 2, S) and (n, 2, 2): the slope of this slope, without what the filter adds to it."""
    onto: Array
    """(n, 6, S)."""

    def rows(self, V_g: Array) -> Array:
        """Values of :func:`vsgdesign.simulation.link_piece.names_of_circuit` for a source of so many volts, of circuits
        whose axes act on each other and whose states may jump, (n, 19 + 10 S)."""
        n, at, bends = len(self.h), [], []
        for angle in (self.begin, self.end):
            c, s = V_g * np.cos(angle), V_g * np.sin(angle)
            turn = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=1)
            at.append((self.per_source @ turn).reshape(n, 4))
            bends.append((self.bend_per_source @ turn).reshape(n, 4))
        arc = -0.25 * (self.end - self.begin) ** 2
        bent = [self.bend_per_state.reshape(n, -1), *bends]
        return np.column_stack(
            [self.h, self.fast, arc, self.per_state.reshape(n, -1), *at, *bent, self.onto.reshape(n, -1)]
        )


def grid_slopes(
    study: Study, circuits: Circuits | None, source: Segments, h: Array, angle: Array, most_turns: float
) -> GridSlopes:
    """Those of n runs over intervals h (s) on these segments, whose sources are at these angles (rad) over their
    phasors at the sample. ``most_turns``: by how much filter and grid current may move in a sampling period, rad.
    Raises InfeasibleStudyError where they move by far more on a grid alone."""
    count = len(source.omega)
    if circuits is None:
        A, _, e = state_matrices(study.circuit()._replace(R_g=source.R_g, L_g=source.L_g))
        A, e = (np.kron(one, np.eye(2)) for one in (A, e[..., None]))
        driven, onto = np.zeros(count), np.tile(np.eye(6), (count, 1, 1))
    else:
        A, e, driven, onto = circuits.at_grid(source.place)
    turns = np.abs(np.linalg.eigvals(A[:, :6, :6])).max(axis=1) * study.converter.T_s
    fast = 1.0 * ((turns > most_turns) | (driven != 0.0))
    if (circuits is None or circuits.axes is None) and turns.max() > 2.0 * most_turns:
        raise InfeasibleStudyError(
            f"the filter on this grid moves by {turns.max():.3g} rad in a sampling period. With a dc link that "
            f"moves the voltage of the bridge at most {2.0 * most_turns:.3g} rad can be computed. Sample "
            "faster, or take a weaker grid."
        )
    length, begin = (np.broadcast_to(one, count).astype(np.float64) for one in (h, angle))
    over = length[:, None, None]
    per_state, per_source = A[:, 4:6] * over, e[:, 4:6] * over
    others = per_state[:, :, 6:] * over
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])  # the slope of the source's voltage is a quarter turn ahead
    bend_per_source = others @ e[:, 6:] + (source.omega * length)[:, None, None] * (per_source @ quarter)
    return GridSlopes(
        h=length,
        fast=fast,
        per_state=per_state,
        per_source=per_source,
        begin=begin,
        end=begin + source.omega * length,
        bend_per_state=others @ A[:, 6:],
        bend_per_source=bend_per_source,
        onto=onto,
    )
