"""Modes of a whole plant, the units that take part in them, and the split for equal units (:eq:`plant-split`).

Of N equal units at one node that sample together, every mode of the plant is a mode of one unit on x_t + N Z_g
(*common*: all units move alike), or one of one unit on x_t alone (*differential*: units against each other), which is
N − 1 fold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.flow_of_units import Situation
from vsgdesign.linear.operating_point.rest_of_units import PlantMap, UnitsAtRest, rest_of_units
from vsgdesign.linear.stability.loci import Mode, modes
from vsgdesign.metrics.modes import participation_factors, to_continuous
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.power_plant import Element, PowerPlant

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
