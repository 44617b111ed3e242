"""Circuits whose axes may differ: an interval written out for every state, or with a loop where there are many."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from vsgdesign.codegen.blocks import Part, Writer
from vsgdesign.codegen.expressions import Expression
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.simulation import circuit_sample
from vsgdesign.simulation.circuit_sample import PlantState

RISING, FALLING, PEAK = "rising", "falling", "peak"
"""Where an interval lies on the carrier: on one of its slopes, or around its peak."""

LARGEST_WRITTEN_OUT = 16
"""States of a circuit whose transition is written out, term by term."""


class Axes(NamedTuple):
    """A circuit whose axes may differ: how many states it has on both together, the degree of its edge polynomials (of
    a switched bridge), and whether α and β act on each other."""

    states: int
    degree: int = 0
    coupled: bool = True
    jumps: bool = False
    """Whether the states may jump where a circuit begins."""

    def on(self, row: int) -> tuple[int, ...]:
        """The axes (0: α) that act on a state."""
        return (0, 1) if self.coupled else (row % 2,)

    @property
    def large(self) -> bool:
        """Whether Φ x is computed by a loop. Written out, sixty states take seconds to compile; a loop has its sums in
        another order, so that small circuits keep their last bits."""
        return self.coupled and self.states > LARGEST_WRITTEN_OUT


def states_of(axes: Axes | None) -> tuple[str, ...]:
    """Names of the circuit's states: those that are measured, then the others."""
    more = 0 if axes is None else axes.states - len(PlantState._fields)
    return (*PlantState._fields, *(f"more_{k}" for k in range(more)))


def headed(block: Block, **heads: str) -> Block:
    """The block with results under their own names, or under those that are given for them."""

    def name(of: str) -> str:
        head, dot, rest = of.partition(".")
        head = head.removesuffix("_out")
        return f"{heads.get(head, head)}{dot}{rest}"

    return Block(block.inputs, block.lets, tuple((name(of), value) for of, value in block.outputs))


def two_axes(axes: Axes, slope: str, applied: Mapping[str, str], *, zero_sequence: bool, carried: bool) -> list[Part]:
    """From the bridge's voltage to the state at the end of the interval; ``applied``: where that voltage is, and that
    of the dc link. ``carried``: Φ x is given."""
    moved = functools.partial(_moved_by_both, axes, carried=carried)
    turned = Part(headed(flat_block(circuit_sample.turned_source)))
    if not slope:
        return [
            Part(
                moved(()),
                {"bridge.alpha": applied["applied.alpha"], "bridge.beta": applied["applied.beta"]},
            ),
            turned,
        ]
    switching, edges = switched_legs(slope, applied, zero_sequence=zero_sequence)
    return [*switching, Part(moved(tuple(edges))), turned]


def switched_legs(slope: str, applied: Mapping[str, str], *, zero_sequence: bool) -> tuple[list[Part], list[str]]:
    """What the legs of a switched bridge do in an interval on a slope of the carrier: the bridge's voltage just after
    its beginning is ``bridge.…``. Returns the names of the edges, too."""
    fixed = {"zero_sequence": zero_sequence, "rising": slope != FALLING}
    parts = [Part(headed(flat_block(circuit_sample.legs_after, fixed=fixed), first="bridge"), applied)]
    link = {"V_dc": applied.get("V_dc", "V_dc")}
    edges = []
    for rising in {RISING: (True,), FALLING: (False,), PEAK: (True, False)}[slope]:
        word = "falls" if rising else "rises"  # a leg falls where it meets the rising carrier
        heads = {f"edge_{leg}": f"{word}_{leg}" for leg in "abc"}
        block = headed(flat_block(circuit_sample.edges_on_slope, fixed={"rising": rising}), **heads)
        parts.append(Part(block, link))
        edges += list(heads.values())
    return parts, edges


def sums_of_powers(line: Writer, edges: Sequence[str], degree: int) -> list[list[Expression]]:
    """Σ of the steps of edges times their places to the power 0, 1, …, on both axes."""
    powers = [[line.input(f"{edge}.{name}") for edge in edges] for name in ("alpha", "beta")]
    found: list[list[Expression]] = []
    for k in range(degree + 1):
        found.append([line.sum_of(*steps) for steps in powers])
        if k < degree:
            places = [line.input(f"{edge}.place") for edge in edges]
            powers = [[line.does("*", *pair) for pair in zip(steps, places, strict=True)] for steps in powers]
    return found


def _moved_by_both(axes: Axes, edges: tuple[str, ...], *, carried: bool = False) -> Block:
    """x ← Φ x + Γ v, the responses to edges, and what the source adds (:eq:`two-axes`), written out for every state.

    ``row`` holds Φ (p), Γ (b) and the responses to the source's cosine and sine with V_g in them (s); ``edge`` the
    coefficients of the edge polynomials, from the constant one on. ``carried``: Φ x is given.
    """
    line, states = Writer(), states_of(axes)
    x = [line.input(f"x.{state}") for state in states]
    bridge = [line.input("bridge.alpha"), line.input("bridge.beta")]
    source = [line.input("source.cosine"), line.input("source.sine")]

    def product(name: str, value: Expression) -> Expression:
        return line.does("*", line.input(name), value)

    def polynomial(row: int, axis: int, place: Expression) -> Expression:
        total: Expression = line.input(f"edge.c{axes.degree}_{row}_{axis}")
        for k in range(axes.degree - 1, -1, -1):
            total = line.does("+", line.does("*", total, place), line.input(f"edge.c{k}_{row}_{axis}"))
        return total

    # Σ over the edges first: the sums of their powers are the same for every state
    weights = sums_of_powers(line, edges, axes.degree) if edges and axes.large else []
    for row, state in enumerate(states):
        acting = axes.on(row)
        terms = [product(f"row.b_{row}_{axis}", bridge[axis]) for axis in acting]
        if carried:
            terms.append(line.input(f"carried.{state}"))
        else:
            terms += [product(f"row.p_{row}_{k}", x[k]) for k in range(len(x)) if k % 2 in acting]
        for k, sums in enumerate(weights):
            terms += [product(f"edge.c{k}_{row}_{axis}", sums[axis]) for axis in acting]
        for edge in () if weights else edges:
            place = line.input(f"{edge}.place")
            steps = [
                line.does("*", line.input(f"{edge}.{('alpha', 'beta')[axis]}"), polynomial(row, axis, place))
                for axis in acting
            ]
            terms.append(line.sum_of(*steps))
        terms.append(line.sum_of(*(product(f"row.s_{row}_{axis}", source[axis]) for axis in range(2))))
        line.output(f"moved.{state}", line.sum_of(*terms))
    return line.block()
