"""The circuits that a run meets: one for every grid and network of its timeline, as the numbers that the loop takes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.grid import FilterGrid
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import CircuitError, InfeasibleStudyError
from vsgdesign.linear.operating_point.network import (
    NetworkCircuit,
    NetworkStates,
    network_circuit,
    states_of_networks,
)
from vsgdesign.linear.operating_point.plant import PlantStep, PlantSteps, TwoAxisCircuit, plant_step, two_axes
from vsgdesign.linear.operating_point.sampled import SampledState, cold_start, steady_state
from vsgdesign.simulation.axes import Axes
from vsgdesign.simulation.run_kind import LARGEST_DEGREE
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.grid import PLAIN, Grid, GridSource, Network
from vsgdesign.study.parameters.network_fields import Base, Said, network_words
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

STIFFEST = 1e6
"""How many times the fastest mode of a network may die out within a sampling period. There the step is good to 1e-8 of
rated (measured with 60 digits), and a fault across a capacitor of 20 μF at 20 kHz has 2 μΩ."""

CircuitOfGrid = Callable[[Grid], FilterGrid | TwoAxisCircuit]
"""The circuit between bridge and source on a grid."""


class Connection(NamedTuple):
    """What the filter is connected to."""

    grid: Grid
    network: Network = PLAIN


CircuitOfConnection = Callable[[Connection], FilterGrid | TwoAxisCircuit]


class Circuits:
    """The circuits of runs; ``switched``: whether their responses to the edges of a bridge are needed."""

    def __init__(
        self,
        study: Study,
        timelines: Sequence[Timeline],
        circuit: CircuitOfGrid | None = None,
        *,
        switched: bool,
        states: NetworkStates | None = None,
        possible: Sequence[Connection] = (),
    ) -> None:
        """``study``: one of the runs, whose filter they share. ``states``: of the networks of these runs and of others;
        None: of these. ``possible``: what the runs may be connected to besides. Raises InfeasibleStudyError where the
        circuits of a run do not fit together (:func:`circuits_of`)."""
        self.more = states_of_timelines(timelines) if states is None else states
        self.of = circuits_of(study, timelines, circuit, self.more)
        """The circuit of a connection."""
        """The states of the networks; None where there is nothing but grids."""
        self._switched, self._steps = switched, functools.lru_cache(maxsize=256)(self._step)
        self._met = list(dict.fromkeys([*(one for timeline in timelines for one in connections(timeline)), *possible]))
        self._places = {one: at for at, one in enumerate(self._met)}
        T_s, self._omega = study.converter.T_s, study.converter.omega_n
        degree = max(len(self._steps(one, T_s, self._omega).edge) - 1 for one in self._met) if switched else 0
        alike = all(isinstance(self.of(one), FilterGrid) for one in self._met)
        self.axes: Axes | None = None
        if not alike or degree > LARGEST_DEGREE:
            if alike:
                given = self.of
                self.of = lambda one: two_axes(given(one))
                self._steps.cache_clear()
            full = [two_axes(self.of(one)) for one in self._met]
            jumps = any(one.onto is not None for one in full)
            self.axes = Axes(len(full[0].A), degree, any(_coupled(one) for one in full), jumps)

    @property
    def states(self) -> int:
        """How many real states the circuits have on both axes together."""
        return 6 if self.axes is None else self.axes.states

    def place(self, timeline: Timeline, t_s: float) -> int:
        """Which of the circuits a run has from an instant on."""
        return self._places[connection_at(timeline, t_s)]

    def meet(self, timeline: Timeline) -> None:
        """A run has another timeline now, with circuits that fit to those of before."""
        for one in connections(timeline):
            if one not in self._places:
                self._places[one] = len(self._met)
                self._met.append(one)

    def current_into_fault(self, connection: Connection) -> Array:
        """(2, states): the current into a fault per state (:eq:`fault-current`)."""
        rows: Array = self.of(connection).fault_per_state  # type: ignore[union-attr]
        return rows

    def steps(self, place: NDArray[np.int64], h: Array, omega: Array) -> PlantSteps:
        """The steps of n circuits, by their places, over intervals h (s) with sources of omega (rad/s), (n,) each."""
        found = [
            self._steps(self._met[one], *of)
            for one, *of in zip(place.tolist(), h.tolist(), omega.tolist(), strict=True)
        ]
        terms = max(len(one.edge) for one in found)
        edge = np.zeros((len(found), terms, *found[0].edge.shape[1:]))
        for k, one in enumerate(found):
            edge[k, : len(one.edge)] = one.edge
        transition, bridge, source = (
            np.stack([getattr(one, name) for one in found]) for name in ("transition", "bridge", "source")
        )
        return PlantSteps(h, transition, bridge, edge, source)

    def at_pcc(self, place: NDArray[np.int64]) -> tuple[Array, Array]:
        """The voltage at the PCC per state, (n, 2, states), and per voltage of the source, (n, 2, 2), of n circuits
        with networks (:eq:`network-pcc`)."""
        found = [self.of(self._met[one]) for one in place.tolist()]
        per_state, per_source = (
            np.stack([getattr(one, name) for one in found]) for name in ("pcc_per_state", "pcc_per_source")
        )
        return per_state, per_source

    def at_grid(self, place: NDArray[np.int64]) -> tuple[Array, Array, Array, Array]:
        """Of n circuits: A (n, states, states) and E (n, states, 2), how much the bridge drives the grid current at
        once, A/(Vs), and what the first six states become where they begin, (n, 6, states)."""
        found = [two_axes(self.of(self._met[one])) for one in place.tolist()]
        onto = [np.eye(len(one.A)) if one.onto is None else one.onto for one in found]
        return (
            np.stack([one.A for one in found]),
            np.stack([one.E for one in found]),
            np.array([np.abs(one.B[4:6]).max() for one in found]),
            np.stack([one[:6] for one in onto]),
        )

    def moved(self, connection: Connection, h: float, x: Array) -> Array:
        """The circuit's states after an interval h (s) with a short-circuited bridge and source."""
        transition = self._steps(connection, h, self._omega).transition
        if len(transition) == len(x):
            return transition @ x
        return np.stack([transition @ x[axis::2] for axis in range(2)], axis=1).ravel()

    def _step(self, connection: Connection, h: float, omega: float) -> PlantStep:
        step = plant_step(self.of(connection), h, omega, edges=self._switched)
        if not np.isfinite(step.edge).all():
            raise CircuitError(
                "the circuit is too stiff to switch: its fastest mode (R/L or R_c/L) dies out many times within a "
                "sampling period. Sample faster, lower R_c, raise x_over_r, make a fault bolted or a load larger, "
                'or use bridge = "averaged".'
            )
        return step


def connections(timeline: Timeline) -> list[Connection]:
    """What a run is connected to, in order of time."""
    instants = sorted({t_s for listed in (timeline.grids, timeline.networks) for t_s, _ in listed})
    return list(dict.fromkeys(connection_at(timeline, t_s) for t_s in instants))


def connection_at(timeline: Timeline, t_s: float) -> Connection:
    """What the filter is connected to from an instant on."""
    return Connection(timeline.grid_at(t_s), timeline.network_at(t_s))


def no_rest_with(network: Network) -> str | None:
    """Why there is no steady state with a network; None where there may be one."""
    if not network.connected:
        return "behind an open breaker there is no source in whose frequency a steady state could be"
    if network.fault is not None:
        return "a fault is there, which is no state to stay in"
    return None


def circuit_at_rest(study: Study, connection: Connection, states: NetworkStates | None = None) -> TwoAxisCircuit | None:
    """The circuit for a steady state with a load, with the states of a run or with its own; None without any network.

    Raises InfeasibleStudyError with a fault or an open breaker.
    """
    grid, network = connection
    obstacle = no_rest_with(network)
    if obstacle is not None:
        raise InfeasibleStudyError(f"no steady state: {obstacle}. Let it come at an event, or start cold.")
    if network.plain and states is None:
        return None
    return network_circuit(study.filter, grid, network, states or states_of_networks([network]))


def states_of_timelines(timelines: Sequence[Timeline]) -> NetworkStates | None:
    """The states of the timelines' networks. None where nothing but the grid is ever there."""
    networks = list(dict.fromkeys(network for timeline in timelines for _, network in timeline.networks))
    return None if all(network.plain for network in networks) else states_of_networks(networks)


def circuits_of(
    study: Study, timelines: Sequence[Timeline], circuit: CircuitOfGrid | None, states: NetworkStates | None
) -> CircuitOfConnection:
    """The circuit on every grid and network of a run: the study's own, or another one, all with the same states, those
    of the networks (``states``) among them.

    Raises InfeasibleStudyError where their states differ in number, where a run cannot start in a steady state because
    the first circuit is not the study's own with equal axes, and where another circuit meets a network.
    """
    if states is not None:
        if circuit is not None:
            raise InfeasibleStudyError(
                "circuit: it says all that is between the bridge and the source, so it cannot meet a load, a fault or "
                "an open breaker of the study. Leave circuit out, or put them into the circuit."
            )
        filter_, converter = study.filter, study.converter

        @functools.cache
        def with_network(one: Connection) -> NetworkCircuit:
            found = network_circuit(filter_, *one, states)
            _check_stiffness(found, one.network, converter)
            return found

        for one in (one for line in timelines for one in connections(line)):
            with_network(one)
        return with_network
    if circuit is None:
        return lambda one: study.circuit(one.grid)
    found = {grid: circuit(grid) for timeline in timelines for _, grid in timeline.grids}
    if all(isinstance(one, FilterGrid) for one in found.values()):
        return lambda one: found[one.grid]
    full = {grid: two_axes(one) for grid, one in found.items()}
    sizes = sorted({len(one.A) for one in full.values()})
    if len(sizes) > 1:
        raise InfeasibleStudyError(
            f"circuit: it has {' and '.join(map(str, sizes))} states on different grids. "
            "Give it the same states on all grids."
        )
    starts = {timeline.grid_at(0.0) for timeline in timelines}
    equal = all(_equal(full[first], two_axes(study.circuit(first))) for first in starts)
    if study.simulation.start != "cold" and not equal:
        raise InfeasibleStudyError(
            "the start: only the study's own circuit with equal axes has a steady state to start in. Let the circuit "
            'change at an event, or use start = "cold".'
        )
    return lambda one: full[one.grid]


def states_of(circuit: FilterGrid | TwoAxisCircuit) -> int:
    """How many real states a circuit has on both axes together."""
    return len(circuit.A) if isinstance(circuit, TwoAxisCircuit) else 6


def _check_stiffness(circuit: TwoAxisCircuit, network: Network, converter: Converter) -> None:
    times = converter.T_s * float(np.abs(np.linalg.eigvals(circuit.A)).max())
    if times > STIFFEST:
        words = ", ".join(network_words(Said(network.load, network.fault, None), Base.of(converter)))
        raise CircuitError(
            f"{words}: the fastest mode dies out {times:,.0f} times within a sampling period. Above {STIFFEST:,.0f} "
            "times rounding would show. Give fault.R zero (bolted) or more ohms, or a load less ohms in parallel."
        )


def _coupled(circuit: TwoAxisCircuit) -> bool:
    """Whether α acts on β, or β on α."""
    matrices = [circuit.A, circuit.B, circuit.E, *(() if circuit.onto is None else (circuit.onto,))]
    return any(matrix[0::2, 1::2].any() or matrix[1::2, 0::2].any() for matrix in matrices)


def _equal(one: TwoAxisCircuit, other: TwoAxisCircuit) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("A", "B", "E"))


KnownStarts = dict[Hashable, SampledState]
"""States in which runs of one controller of one converter have begun, by all that these depend on besides."""


def start_of(
    study: Study, timeline: Timeline, circuits: Circuits, gains: PowerLoopGains, known: KnownStarts | None = None
) -> SampledState:
    """The state at t = 0, with all the states of the circuit. Nobody may write to it. ``known``: those that are known
    of this controller, which get this one.

    Raises InfeasibleStudyError where a steady start is asked for and there is no steady state.
    """
    known = {} if known is None else known
    source, refs, cold = timeline.source_at(0.0), timeline.references_at(0.0), study.simulation.start == "cold"
    asked = cold, connection_at(timeline, 0.0), source, refs, gains, circuits.more, circuits.states
    if asked not in known:
        state = cold_start(study, source.phase) if cold else rest_at_start(study, timeline, gains, circuits.more)
        plant = np.zeros(circuits.states)
        plant[: len(state.plant)] = state.plant
        known[asked] = replace(state, plant=plant)
    return known[asked]


def rest_at_start(
    study: Study, timeline: Timeline, gains: PowerLoopGains, more: NetworkStates | None = None
) -> SampledState:
    """The steady state at t = 0, with the states of a run (``more``) or with its own. Raises InfeasibleStudyError where
    there is none."""
    source = timeline.source_at(0.0)
    if not source.steady:
        raise InfeasibleStudyError("a steady-state start cannot begin inside a ramp: move the ramp after t = 0.")
    refs = timeline.references_at(0.0)
    first, at_start = connection_at(timeline, 0.0), GridSource(source.V_g_rms, source.omega)
    try:
        circuit = circuit_at_rest(study, first, more)
        return steady_state(study, first.grid, at_start, refs, gains, source.phase, circuit)
    except InfeasibleStudyError as error:
        error.args = (f"the start: {error}",)
        raise
