"""The circuit of a plant: the filters of all units, what lies between them, and the sources (:eq:`plant-circuit`).

It is made of the list of elements by the same elimination as the circuit of one converter with a load
(:mod:`vsgdesign.linear.operating_point.network`). Both axes are alike, so there is one real matrix for α and β.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.network import Equations, UndeterminedError, reduced
from vsgdesign.linear.operating_point.plant import edge_polynomials, less_one
from vsgdesign.study.parameters.converter import Filter
from vsgdesign.study.parameters.grid import Grid, Load
from vsgdesign.study.parameters.power_plant import (
    GRID,
    NEUTRAL,
    Element,
    Inverter,
    PowerPlant,
    Source,
    Unit,
    load_elements,
)
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

OF_UNIT = ("i_s", "v_c", "i_g")
"""The states that every converter has, and that its sensors measure."""

_LOAD, _FAULT = "load", "fault"


class Topology(NamedTuple):
    """What is connected between two events."""

    grid: Grid
    opened: frozenset[str]
    """Names of units, sources and elements whose breakers are open."""
    load: Load | None = None
    """At the PCC, beside the loads of the plant."""
    faults: tuple[tuple[str, float], ...] = ()
    """Nodes with a fault, and its resistance in Ω."""

    @property
    def connected(self) -> Topology:
        """What is connected, whatever the grid's impedance: where it changes, currents and voltages may jump."""
        return self._replace(grid=Grid(0.0, 0.0))


class Wiring(NamedTuple):
    """A plant with the filters of its converters: what circuits are made of."""

    plant: PowerPlant
    filters: tuple[Filter, ...]


@dataclass(frozen=True, eq=False)
class UnitsCircuit:
    """dq/dt = A q + B v_b + E v_g, of one axis, and y = X q + X_g v_g.

    y are ``names``: i_s, v_c and i_g of each converter, ``UNIT.i_s`` and so on, and the other currents of inductances
    and voltages of capacitances. v_b has one entry a converter and v_g one a source, of which the first is the grid.
    """

    names: tuple[str, ...]
    A: Array
    B: Array
    E: Array
    X: Array
    X_g: Array
    onto: Array
    """What q is made of: fluxes and charges of y stay as they are as far as the circuit lets them."""
    terminals: tuple[Array, Array]
    """The voltage at the terminals of each converter, behind L_2, per y and per v_g."""

    def step(self, h: float, omega: float) -> tuple[Array, Array, Complex]:
        """Φ, Γ and ρ of q over an interval h (s): what held bridges add, and sources e^{jωs} (:eq:`exact-step`)."""
        return _step(self, h, omega)

    def moved(self, h: float, omega: float) -> tuple[Array, Array, Complex]:
        """The same of y."""
        phi, gamma, rho = self.step(h, omega)
        at_end = self.X_g * np.exp(1j * omega * h)
        return self.X @ phi @ self.onto, self.X @ gamma, self.X @ rho + at_end

    def edges(self, h: float, units: int) -> Array:
        """What a unit step of the bridge voltage of each of the first ``units`` converters adds to y by the end of an
        interval, (units, degree + 1, y): polynomials in x = 2τ/h − 1, where τ is the time that is left. NaN where the
        circuit is too stiff for one (:eq:`edge-polynomial`)."""
        return _edges(self, h, units)

    def charge(self, h: float, omega: float, converters: Sequence[int]) -> tuple[Array, Array, Complex]:
        """The integrals of i_s of some converters over an interval, per y, per held bridge and per source e^{jωs}."""
        m, n, bridges = len(converters), len(self.A), self.B.shape[1]
        M = _rates(self, omega)
        grown = np.zeros((m + len(M),) * 2)
        grown[m:, m:] = M
        at = [len(OF_UNIT) * k for k in converters]
        grown[:m, m : m + n], grown[:m, m + n + bridges :: 2] = self.X[at], self.X_g[at]
        rows = less_one(grown * h)[:m, m:]
        source = rows[:, n + bridges :]
        return rows[:, :n] @ self.onto, rows[:, n : n + bridges], source[:, 0::2] - 1j * source[:, 1::2]


def wiring_of(study: Study) -> Wiring:
    """The plant of a study. Raises ValueError where it has none."""
    if study.plant is None:
        raise ValueError("the study has no plant")
    own = (one.filter if isinstance(one, Inverter) else (one.case or study).filter for one in study.plant.converters)
    return Wiring(study.plant, tuple(own))


def sources_of(plant: PowerPlant, grid: Grid) -> tuple[Source, ...]:
    """All sources, the grid first."""
    return (Source(GRID, plant.pcc, 1.0, 0.0, grid.R_g, grid.L_g), *plant.sources)


def elements_of(plant: PowerPlant, topology: Topology) -> tuple[Element, ...]:
    """Those of the plant with the load and the faults of a topology."""
    found = list(plant.elements)
    if topology.load is not None:
        found += load_elements(_LOAD, plant.pcc, topology.load)
    found += [Element(f"{_FAULT}.{node}", _FAULT, node, NEUTRAL, R) for node, R in topology.faults]
    return tuple(found)


def names_of_states(plant: PowerPlant, topologies: Sequence[Topology]) -> tuple[str, ...]:
    """Of everything that all these topologies remember, the converters first."""
    found = [f"{one.name}.{name}" for one in plant.converters for name in OF_UNIT]
    for topology in topologies:
        found += [f"i.{one.name}" for one in sources_of(plant, topology.grid) if one.L > 0.0]
        for one in elements_of(plant, topology):
            found += [f"i.{one.name}"] if one.L > 0.0 else []
            found += [f"v.{one.name}"] if one.C is not None else []
    return tuple(dict.fromkeys(found))


@functools.lru_cache(maxsize=256)
def circuit_of_units(wiring: Wiring, topology: Topology, names: tuple[str, ...]) -> UnitsCircuit:
    """The circuit of a plant in a topology, with the states of all topologies of a run.

    Raises InfeasibleStudyError where the elements do not determine a current, with their names.
    """
    builder = _Builder(wiring, topology)
    try:
        found = reduced(builder.equations())
    except UndeterminedError as error:
        which = ", ".join(dict.fromkeys(builder.names[k].partition(".")[2] for k in error.variables))
        raise InfeasibleStudyError(
            f"network: {which} lie side by side without any resistance or inductance, and nothing says how they share "
            "the current. Give one of them R or L."
        ) from error
    B, E = found.inputs
    places = [builder.place.get(name, -1) for name in names]
    there = np.array([at >= 0 for at in places])
    rows = np.array([max(at, 0) for at in places])
    X = np.where(there[:, None], found.x[rows], 0.0)
    X_g = np.where(there[:, None], found.of_inputs[1][rows], 0.0)
    onto = np.where(there[None, :], found.onto[:, rows], 0.0)
    A_y = X @ found.A @ onto
    E_y = X @ E
    per_state, per_source = [], []
    for k, filter_ in enumerate(wiring.filters):
        i_s, v_c, i_g = (np.eye(1, len(names), 3 * k + j)[0] for j in range(3))
        own = v_c + filter_.R_c * (i_s - i_g) - filter_.R_2 * i_g
        per_state.append(own @ X @ onto - filter_.L_2 * i_g @ A_y)
        per_source.append(own @ X_g - filter_.L_2 * i_g @ E_y)
    return UnitsCircuit(names, found.A, B, E, X, X_g, onto, (np.array(per_state), np.array(per_source)))


def _rates(circuit: UnitsCircuit, omega: float) -> Array:
    """Held bridges behind q, then an oscillator for each source: α sees its first state, and β lies a quarter turn
    behind."""
    n, bridges, sources = len(circuit.A), circuit.B.shape[1], circuit.E.shape[1]
    M = np.zeros((n + bridges + 2 * sources,) * 2)
    M[:n, :n], M[:n, n : n + bridges] = circuit.A, circuit.B
    for k in range(sources):
        c = n + bridges + 2 * k
        M[:n, c], M[c, c + 1], M[c + 1, c] = circuit.E[:, k], -omega, omega
    return M


@functools.lru_cache(maxsize=512)
def _step(circuit: UnitsCircuit, h: float, omega: float) -> tuple[Array, Array, Complex]:
    n, bridges = len(circuit.A), circuit.B.shape[1]
    grown = less_one(_rates(circuit, omega) * h)[:n]
    source = grown[:, n + bridges :]
    found = np.eye(n) + grown[:, :n], grown[:, n : n + bridges], source[:, 0::2] - 1j * source[:, 1::2]
    for one in found:
        one.setflags(write=False)
    return found


@functools.lru_cache(maxsize=512)
def _edges(circuit: UnitsCircuit, h: float, units: int) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        found = circuit.X @ edge_polynomials(circuit.A[None], circuit.B[None, :, :units], h)[0]
    found = found.transpose(2, 0, 1)
    found.setflags(write=False)
    return found


class _Builder:
    """Writes the equations of all branches and nodes."""

    def __init__(self, wiring: Wiring, topology: Topology) -> None:
        self.plant, self.topology, self.filters = *wiring[:1], topology, wiring.filters
        self.sources = sources_of(self.plant, topology.grid)
        self.elements = elements_of(self.plant, topology)
        self.mass: dict[str, float] = {}
        for unit, f in zip(self.plant.converters, self.filters, strict=True):
            own = zip(OF_UNIT, (f.L_1, f.C, f.L_2 + unit.L), strict=True)
            self.mass |= {f"{unit.name}.{name}": mass for name, mass in own}
        for one in (*self.sources, *self.elements):
            self.mass[f"i.{one.name}"] = one.L
        for one in self.elements:
            if one.C is not None:
                self.mass[f"v.{one.name}"] = one.C
        self.names = tuple(self.mass)
        self.place = {name: k for k, name in enumerate(self.names)}

    def x(self, name: str) -> Array:
        """The row that picks a variable."""
        return np.eye(1, len(self.names), self.place[name])[0]

    def equations(self) -> Equations:
        """Of all branches and nodes."""
        size = len(self.names)
        J, G = np.zeros((size, size)), []
        losses: list[tuple[Array, float]] = []
        into = {node: np.zeros(size) for node in self.plant.nodes}

        def stores(v: Array, i: Array) -> None:
            J[:] += np.outer(v, i) - np.outer(i, v)

        for unit, f in zip(self.plant.converters, self.filters, strict=True):
            i_s, v_c, i_g = (self.x(f"{unit.name}.{name}") for name in OF_UNIT)
            stores(v_c, i_s - i_g)
            losses += [(i_s, f.R_1), (i_s - i_g, f.R_c), (i_g, f.R_2 + unit.R)]
            into[unit.node] = into[unit.node] + i_g
            G += [i_g] if unit.name in self.topology.opened else []
        for one in self.sources:
            i = self.x(f"i.{one.name}")
            losses.append((i, one.R))
            into[one.node] = into[one.node] - i
            G += [i] if one.name in self.topology.opened else []
        for one in self.elements:
            i = self.x(f"i.{one.name}")
            losses.append((i, one.R))
            if one.C is not None:
                stores(self.x(f"v.{one.name}"), i)
            for node, sign in ((one.start, -1.0), (one.end, 1.0)):
                if node != NEUTRAL:
                    into[node] = into[node] + sign * i
            G += [i] if one.group in self.topology.opened else []
        losses = [(row, R) for row, R in losses if R > 0.0]
        M = np.array(list(self.mass.values()))
        of_unit = np.array(
            [name.startswith(tuple(f"{unit.name}." for unit in self.plant.converters)) for name in self.names]
        )
        return Equations(
            M=M,
            J=J,
            through=np.array([row for row, _ in losses]).reshape(-1, size),
            R=np.array([R for _, R in losses]),
            G=np.array([*into.values(), *G]),
            inputs=(
                np.array([self.x(f"{unit.name}.i_s") for unit in self.plant.converters]).T,
                -np.array([self.x(f"i.{one.name}") for one in self.sources]).T,
            ),
            # The states of units stay states where there is a choice: then equal units have equal equations.
            order=np.lexsort((np.arange(size), of_unit, M > 0.0)),
        )


class Phasors(NamedTuple):
    """What the converters see at an angular frequency: v = Z i + V of the nodes of N of them, phase rms."""

    Z: Complex
    """(N, N), Ω: with all sources short-circuited."""
    V: Complex
    """(N, S): per source."""


def phasors_of(plant: PowerPlant, topology: Topology, omega: float) -> Phasors:
    """The network between the converters as they see it. Raises InfeasibleStudyError where it has no answer, as an
    island without a load."""
    sources, elements = sources_of(plant, topology.grid), elements_of(plant, topology)
    nodes = {node: k for k, node in enumerate(plant.nodes)}
    branches: list[tuple[str, str, complex, int, bool]] = []
    for k, one in enumerate(sources):
        branches.append((one.node, NEUTRAL, one.R + 1j * omega * one.L, k, one.name in topology.opened))
    for one in elements:
        Z = one.R + 1j * omega * one.L + (0.0 if one.C is None else 1.0 / (1j * omega * one.C))
        branches.append((one.start, one.end, Z, -1, one.group in topology.opened))
    n, count = len(nodes), len(plant.converters)
    M = np.zeros((n + len(branches),) * 2, dtype=complex)
    right = np.zeros((n + len(branches), count + len(sources)), dtype=complex)
    for b, (start, end, Z, source, opened) in enumerate(branches, n):
        for node, sign in ((start, 1.0), (end, -1.0)):
            if node != NEUTRAL:
                M[nodes[node], b] += sign
                M[b, nodes[node]] += 0.0 if opened else sign
        M[b, b] = 1.0 if opened else -Z
        if source >= 0 and not opened:
            right[b, count + source] = 1.0
    for k, one in enumerate(plant.converters):
        right[nodes[one.node], k] = 1.0
    scale = np.abs(M).max(axis=1)
    if np.linalg.cond(M / scale[:, None]) > 1e14:
        raise InfeasibleStudyError(
            "network: a part of it has neither a source nor a load, so nothing says its voltage. Close a breaker, or "
            "connect a load."
        )
    found: Complex = np.asarray(np.linalg.solve(M, right), dtype=complex)[[nodes[one.node] for one in plant.converters]]
    return Phasors(found[:, :count], found[:, count:])


def grid_of_unit(study: Study, unit: Unit, topology: Topology) -> Grid:
    """The grid that a unit sees at its node where all units on line move in proportion to their ratings: Σ Z S_j/S
    (:eq:`plant-grid`). Of N equal units this is N Z_g. Inverters keep their currents. Raises InfeasibleStudyError where
    it is not inductive."""
    plant = study.plant
    if plant is None:
        return study.grid
    omega = study.converter.omega_n
    Z = phasors_of(plant, topology, omega).Z[: len(plant.units), : len(plant.units)]
    at = [one.name for one in plant.units].index(unit.name)
    ratings = np.array([(one.case or study).converter.S_rated for one in plant.units])
    on_line = np.array([one.name not in topology.opened or one.name == unit.name for one in plant.units])
    seen = complex(np.sum(Z[at] * ratings * on_line) / ratings[at])
    if not (seen.imag >= 0.0 and seen.real >= 0.0 and seen.imag + omega * unit.L > 0.0):
        raise InfeasibleStudyError(
            f"unit {unit.name}: the network that it sees has R = {seen.real:.4g} Ω and X = {seen.imag:.4g} Ω at "
            "nominal frequency, which is no R–L grid. Give its controller gains or a design_grid."
        )
    return Grid(seen.real, seen.imag / omega)
