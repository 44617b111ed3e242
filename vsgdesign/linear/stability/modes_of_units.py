"""Modes of a whole plant, the units that take part in them, and the split for equal units (:eq:`plant-split`).

Of N equal units at one node that sample together, every mode of the plant is a mode of one unit on x_t + N Z_g
(*common*: all units move alike), or one of one unit on x_t alone (*differential*: units against each other), which is
N − 1 fold. A map has the differential mode of one unit with the gains that it has in the plant (:eq:`plant-pair`,
:eq:`differential-mode`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import source_behind
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.flow_of_units import Situation
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.operating_point.rest_of_units import PlantMap, UnitsAtRest, rest_of_units
from vsgdesign.linear.stability.loci import Mode, modes
from vsgdesign.linear.stability.maps import MarginMap
from vsgdesign.linear.stability.verdict import describe_cell
from vsgdesign.metrics.modes import participation_factors, to_continuous
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.power_plant import Element, PowerPlant
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

NETWORK = "network"
"""What takes part in a mode and belongs to no unit."""


@dataclass(frozen=True)
class PlantMode:
    """A mode of a plant, and the share that each unit, each inverter and the network have in it."""

    s: complex
    damping: float
    units: tuple[tuple[str, float], ...]
    """The largest first."""


@dataclass(frozen=True)
class SplitModes:
    """The modes of N equal units by the two models of one unit."""

    common: tuple[Mode, ...]
    differential: tuple[Mode, ...]
    """Each of them N − 1 times."""


def modes_of_units(rest: UnitsAtRest, most: int | None = None) -> tuple[PlantMode, ...]:
    """The modes of a plant, the least stable first."""
    names = [name for name, kept in zip(rest.model.names, rest.model.kept, strict=True) if kept]
    units = [one.name for one in rest.model.plant.converters]
    owner = [name.partition(".")[0] if name.partition(".")[0] in units else NETWORK for name in names]
    values, shares = participation_factors(rest.A)
    s = to_continuous(values, rest.model.clock.period)
    found = []
    for k in np.argsort(-s.real, kind="stable").tolist()[:most]:
        of_unit = {unit: float(shares[np.array(owner) == unit, k].sum()) for unit in (*units, NETWORK)}
        ranked = sorted(of_unit.items(), key=lambda one: -one[1])
        size = abs(s[k])
        damping = float(-s[k].real / size) if 0.0 < size < np.inf else 1.0
        found.append(PlantMode(complex(s[k]), damping, tuple(one for one in ranked if one[1] > 1e-3)))
    return tuple(found)


def split_modes(rest: UnitsAtRest, most: int | None = None) -> SplitModes | None:
    """The modes of a plant of equal units, by the two models of one unit; None where its units are not equal."""
    if not splits(rest.model.situation):
        return None
    try:
        matrices = split_matrices(rest)
    except InfeasibleStudyError:  # without any impedance between two units there is no differential mode
        return None
    T = rest.model.clock.period
    common, differential = (modes(names, A, T, most=most) for names, A in matrices)
    return SplitModes(common, differential)


def splits(situation: Situation) -> bool:
    """Whether the units of a plant are equal, and there are at least two."""
    plant, units = situation.study.plant, situation.units
    if plant is None or len(units) < 2 or not plant.equal or situation.inverters:
        return False
    # Gains that follow what each unit measures differ by rounding.
    same = all(np.allclose(one.gains, units[0].gains, rtol=1e-9, atol=0.0) for one in units)
    return same and all(one.refs == units[0].refs for one in units)


def split_matrices(rest: UnitsAtRest) -> tuple[tuple[tuple[str, ...], Array], tuple[tuple[str, ...], Array]]:
    """Names and matrix of the common and of the differential model of one unit, at the rest of the plant.

    Raises InfeasibleStudyError where nothing lies between the units.
    """
    situation, plant = rest.model.situation, rest.model.plant
    count, first = len(plant.units), plant.units[0]
    grid = situation.topology.grid
    # All units together draw N times the current through the network: so does one through N times its impedance.
    alone = replace(plant, units=(first,), elements=tuple(_times(one, count) for one in plant.elements))
    alone = replace(alone, sources=tuple(replace(one, R=count * one.R, L=count * one.L) for one in plant.sources))
    load = situation.topology.load
    topology = situation.topology._replace(
        grid=Grid(count * grid.R_g, count * grid.L_g),
        load=None if load is None else load.times(count),
        faults=tuple((node, count * R) for node, R in situation.topology.faults),
    )
    common = situation._replace(
        study=replace(situation.study, plant=alone), topology=topology, units=situation.units[:1]
    )
    shared = rest_of_units(common)
    stiff = PowerPlant(nodes=(first.node,), elements=(), sources=(), units=(first,), pcc=first.node)
    apart = PlantMap(
        situation._replace(
            study=replace(situation.study, plant=stiff),
            topology=topology._replace(grid=Grid(0.0, 0.0), opened=frozenset(), load=None, faults=()),
            units=situation.units[:1],
            sources=situation.sources[:1],
        )
    )
    z, own, there = np.zeros(len(apart.kept)), apart.slices[0], rest.model.slices[0]
    y = apart.network.onto @ rest.model.states(rest.z)[:3]
    z[: 2 * len(y)] = np.stack([y.real, y.imag], axis=1).ravel()
    for part, from_ in zip(own, there, strict=True):
        z[part] = rest.z[from_]
    apart.of_links.update(rest.model.of_links)
    J = apart(z)[1]
    return _kept(shared.model, shared.A), _kept(apart, J[np.ix_(apart.kept, apart.kept)])


def _kept(model: PlantMap, A: Array) -> tuple[tuple[str, ...], Array]:
    return tuple(name for name, kept in zip(model.names, model.kept, strict=True) if kept), A


def _times(one: Element, count: int) -> Element:
    return replace(one, R=count * one.R, L=count * one.L, C=None if one.C is None else one.C / count)


Complex = NDArray[np.complex128]


def asked_apart(study: Study) -> float:
    """The decay of the units against each other that the specification asks for, 1/s; 0: none, as of a converter that
    stands alone."""
    return 0.0 if study.specification is None else study.specification.differential_decay


def differential_modes(
    study: Study, gains: PowerLoopGains, P: Array, Q: Array, V_rms: Array, omega_g: float | Array
) -> Complex:
    """The least stable differential mode (N,) of units that give P and Q at V each, by the full-order model of one unit
    on its R_2 and L_2 alone; NaN where there is no steady state. Gains are arrays (N,) or scalars."""
    c, f = study.converter, study.filter
    each = [np.broadcast_to(np.asarray(one, dtype=float), P.shape) for one in (omega_g, *gains)]
    omega, own = each[0], PowerLoopGains(*each[1:])
    V_node, _ = source_behind(P, Q, V_rms, f.R_2, omega * f.L_2)
    P_ref, Q_ref = P - own.D_p * (c.omega_n - omega), Q - own.D_q * (c.V_rated_rms - V_rms)
    cells = [
        Cell(
            Grid(0.0, 0.0),
            PowerLoopGains(*(float(value[k]) for value in own)),
            float(P_ref[k]),
            float(Q_ref[k]),
            GridSource(float(V_node[k]), float(omega[k])),
        )
        for k in range(len(P))
    ]
    model = linearise_full_order(study, cells)
    found = np.full(len(P), np.nan + 0j)
    if len(model.index):
        s = to_continuous(np.linalg.eigvals(model.A), model.T_s)
        slowest = s[np.arange(len(s)), np.argmax(s.real, axis=1)]
        found[model.index] = slowest.real + 1j * np.abs(slowest.imag)
    return found


@dataclass(frozen=True, kw_only=True)
class DifferentialWorst:
    """The least stable differential mode over the cells of a map that count."""

    controller: str
    cells: int
    s: complex
    """NaN where no cell counts, or one has no steady state."""
    where: str
    asked: float
    """Decay that the specification asks for, 1/s; 0 without one."""
    missing: int
    """Cells that do not have this decay."""

    @property
    def decay(self) -> float:
        """In 1/s; negative where the mode grows."""
        return -self.s.real


def worst_differential(study: Study, controller: str, field: MarginMap) -> DifferentialWorst:
    """The differential mode in every cell of a map that counts, with the gains of the cell."""
    flat = field.analysed[field.counted]
    cells = field.cells.take(flat)
    asked = asked_apart(study)
    if len(flat) == 0:
        nowhere = complex(np.nan, np.nan)
        return DifferentialWorst(controller=controller, cells=0, s=nowhere, where="", asked=asked, missing=0)
    s = differential_modes(study, cells.gains, cells.P, cells.Q, cells.V_rms, study.grid_source.omega_g)
    real = np.where(np.isnan(s.real), np.inf, s.real)
    k = int(np.argmax(real))
    return DifferentialWorst(
        controller=controller,
        cells=len(flat),
        s=complex(s[k]),
        where=describe_cell(field, int(flat[k])),
        asked=asked,
        missing=int(np.sum(~(-real >= asked))),
    )
