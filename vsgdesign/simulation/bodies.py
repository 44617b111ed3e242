"""The body of a run's loop: one sample as a straight line, put together of the parts that the run has."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

from vsgdesign.codegen.blocks import Part, Writer, joined, with_outputs
from vsgdesign.codegen.expressions import Expression
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.equations.controller import ControllerSettings, ControllerState
from vsgdesign.equations.limiters import LimiterLaw
from vsgdesign.simulation import sample
from vsgdesign.simulation.lanes.sample import Coefficients, PlantState, measured_by

RISING, FALLING, PEAK = "rising", "falling", "peak"
"""Where an interval lies on the carrier: on one of its slopes, or around its peak."""

LARGEST_DEGREE = len(Coefficients._fields) - 1
"""Of an edge polynomial of a circuit whose axes are alike. A stiffer one goes the way of two axes."""


class Axes(NamedTuple):
    """A circuit whose axes may differ: how many states it has on both together, the degree of its edge polynomials (of
    a switched bridge), and whether α and β act on each other."""

    states: int
    degree: int = 0
    coupled: bool = True

    def on(self, row: int) -> tuple[int, ...]:
        """The axes (0: α) that act on a state."""
        return (0, 1) if self.coupled else (row % 2,)


class Bridge(NamedTuple):
    """The bridge of a run: where its samples lie on the carrier (none: averaged), and its modulation."""

    slopes: tuple[str, ...] = ()
    zero_sequence: bool = False
    delayed: bool = False


class Run(NamedTuple):
    """What a body depends on."""

    law: LimiterLaw
    memory: Any
    """The kinds of the limiter's memory and of its constants: NamedTuples."""
    constants: Any
    bridge: Bridge
    axes: Axes | None = None
    """None: both axes are alike."""
    sensors: bool = False
    field: bool = False
    """Whether a field estimator listens."""
    added: bool = False
    """Whether the source has more than its fundamental."""


@functools.cache
def control(run: Run) -> Block:
    """From the circuit's state to the voltage that acts over the interval: sensors, probe, controller, delay."""
    kinds = {ControllerState: {"limiter": run.memory}, ControllerSettings: {"limiter": run.constants}}
    own = _called(flat_block(sample.controlled, fixed={"limiter": run.law}, kinds=kinds))
    true = _called(flat_block(measured_by), measurement="true" if run.sensors else "measured")
    parts = [Part(true)]
    if run.sensors:
        parts.append(Part(_called(flat_block(sample.sensed))))
    if run.field:
        commanded = {"state.theta": "commanded_theta", "state.V": "commanded_V"}
        before = {"theta": "state.theta", "V_rms": "state.V"}
        heard = {"theta": "commanded_theta", "acted": "said.limited"}
        after = {"theta": "following.theta", "V_rms": "following.V"}
        parts += [
            Part(_called(flat_block(sample.probing)), before),
            Part(own, commanded),
            Part(_called(flat_block(sample.hearing)), heard),
            Part(_called(flat_block(sample.without_probe)), after),
        ]
    else:
        parts += [Part(own), Part(_called(flat_block(sample.kept_angle)), {"theta": "following.theta"})]
    parts.append(Part(_called(flat_block(sample.source_voltage_with if run.added else sample.source_voltage))))
    return joined(*parts)


@functools.cache
def plant(run: Run, slope: str = "") -> Block:
    """From the voltage that acts to the circuit's state at the end of the interval, on a slope of the carrier."""
    bridge = run.bridge
    waits = "pending." if bridge.delayed else "said.v_b_"
    applied = {f"applied.{axis}": f"{waits}{axis}" for axis in ("alpha", "beta")}
    if run.axes is not None:
        parts = _two_axes(run.axes, bridge, slope, applied)
    elif not slope:
        parts = [Part(_called(flat_block(sample.averaged_plant)), applied)]
    elif slope == PEAK:
        fixed = {"zero_sequence": bridge.zero_sequence}
        parts = [Part(_called(flat_block(sample.peak_plant, fixed=fixed)), applied)]
    else:
        fixed = {"zero_sequence": bridge.zero_sequence, "rising": slope == RISING}
        parts = [Part(_called(flat_block(sample.switched_plant, fixed=fixed)), applied)]
    if run.added:
        parts.append(Part(_with_added(states_of(run.axes))))
    return joined(*parts)


@functools.cache
def bodies(run: Run, outputs: tuple[str, ...]) -> tuple[Block, ...]:
    """One body for every place on the carrier that a sample may have, or the one of an averaged bridge."""
    slopes = tuple(dict.fromkeys(run.bridge.slopes)) or ("",)
    return tuple(with_outputs(joined(Part(control(run)), Part(plant(run, slope))), outputs) for slope in slopes)


def states_of(axes: Axes | None) -> tuple[str, ...]:
    """Names of the circuit's states: those that are measured, then the others."""
    more = 0 if axes is None else axes.states - len(PlantState._fields)
    return (*PlantState._fields, *(f"more_{k}" for k in range(more)))


def _called(block: Block, **heads: str) -> Block:
    """The block with results under their own names, or under those that are given for them."""

    def name(of: str) -> str:
        head, dot, rest = of.partition(".")
        head = head.removesuffix("_out")
        return f"{heads.get(head, head)}{dot}{rest}"

    return Block(block.inputs, block.lets, tuple((name(of), value) for of, value in block.outputs))


def _with_added(states: tuple[str, ...]) -> Block:
    """What the source's other components add to the states over the interval."""
    line = Writer()
    for state in states:
        line.output(f"arrived.{state}", line.does("+", line.input(f"moved.{state}"), line.input(f"more.{state}")))
    return line.block()


# Circuits whose axes may differ.


def _two_axes(axes: Axes, bridge: Bridge, slope: str, applied: Mapping[str, str]) -> list[Part]:
    turned = Part(_called(flat_block(sample.turned_source)))
    if not slope:
        return [
            Part(
                _moved_by_both(axes, ()),
                {"bridge.alpha": applied["applied.alpha"], "bridge.beta": applied["applied.beta"]},
            ),
            turned,
        ]
    fixed = {"zero_sequence": bridge.zero_sequence, "rising": slope != FALLING}
    parts = [Part(_called(flat_block(sample.legs_after, fixed=fixed), first="bridge"), applied)]
    edges = []
    for rising in {RISING: (True,), FALLING: (False,), PEAK: (True, False)}[slope]:
        word = "falls" if rising else "rises"  # a leg falls where it meets the rising carrier
        heads = {f"edge_{leg}": f"{word}_{leg}" for leg in "abc"}
        parts.append(Part(_called(flat_block(sample.edges_on_slope, fixed={"rising": rising}), **heads)))
        edges += list(heads.values())
    return [*parts, Part(_moved_by_both(axes, tuple(edges))), turned]


def _moved_by_both(axes: Axes, edges: tuple[str, ...]) -> Block:
    """x ← Φ x + Γ v, the responses to edges, and what the source adds (:eq:`two-axes`), written out for every state.

    ``row`` holds Φ (p), Γ (b) and the responses to the source's cosine and sine with V_g in them (s); ``edge`` the
    coefficients of the edge polynomials, from the constant one on.
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

    for row, state in enumerate(states):
        acting = axes.on(row)
        terms = [product(f"row.b_{row}_{axis}", bridge[axis]) for axis in acting]
        terms += [product(f"row.p_{row}_{k}", x[k]) for k in range(len(x)) if k % 2 in acting]
        for edge in edges:
            place = line.input(f"{edge}.place")
            steps = [
                line.does("*", line.input(f"{edge}.{('alpha', 'beta')[axis]}"), polynomial(row, axis, place))
                for axis in acting
            ]
            terms.append(line.sum_of(*steps))
        terms.append(line.sum_of(*(product(f"row.s_{row}_{axis}", source[axis]) for axis in range(2))))
        line.output(f"moved.{state}", line.sum_of(*terms))
    return line.block()
