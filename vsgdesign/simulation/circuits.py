"""The circuits that a run meets: one for every grid of its timeline, as the arrays that the compiled loop takes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vsgdesign.equations.filters import FilterGrid
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.operating_point.plant import TwoAxisCircuit, plant_step, two_axes
from vsgdesign.parameters.study import Grid, Study
from vsgdesign.simulation.kernel import PlantPieces
from vsgdesign.simulation.timeline import Timeline

CircuitOfGrid = Callable[[Grid], FilterGrid | TwoAxisCircuit]
"""The circuit between bridge and source on a grid."""


def circuits_of(study: Study, timeline: Timeline, circuit: CircuitOfGrid | None) -> CircuitOfGrid:
    """The circuit on every grid of a run: the study's own, or another one, all with the same states.

    Raises InfeasibleStudyError where their states differ in number, and where a run cannot start in a steady state
    because the first circuit is not the study's own with equal axes.
    """
    if circuit is None:
        return study.circuit
    found = {grid: circuit(grid) for _, grid in timeline.grids}
    if all(isinstance(one, FilterGrid) for one in found.values()):
        return found.__getitem__
    full = {grid: two_axes(one) for grid, one in found.items()}
    sizes = sorted({len(one.A) for one in full.values()})
    if len(sizes) > 1:
        raise InfeasibleStudyError(
            f"circuit: it has {' and '.join(map(str, sizes))} states on different grids. "
            "Give it the same states on all grids."
        )
    first = timeline.grid_at(0.0)
    given, own = full[first], two_axes(study.circuit(first))
    if study.simulation.start != "cold" and not _equal(given, own):
        raise InfeasibleStudyError(
            "the start: only the study's own circuit with equal axes has a steady state to start in. Let the circuit "
            'change at an event, or use start = "cold".'
        )
    return full.__getitem__


def states_of(circuit: FilterGrid | TwoAxisCircuit) -> int:
    """How many real states a circuit has on both axes together."""
    return len(circuit.A) if isinstance(circuit, TwoAxisCircuit) else 6


def stacked_plants(circuit: CircuitOfGrid, edges: bool, pieces: tuple[tuple[Grid, float, float], ...]) -> PlantPieces:
    """Some pieces of an interval, each a grid, a length (s) and a source frequency (rad/s), without their sources.

    ``edges``: whether the bridge switches within them.
    """
    steps = [plant_step(circuit(grid), h, omega, edges=edges) for grid, h, omega in pieces]
    degree = max(step.edge.shape[0] for step in steps)
    polynomials = np.zeros((len(steps), degree, *steps[0].edge.shape[1:]))
    for k, step in enumerate(steps):
        polynomials[k, : step.edge.shape[0]] = step.edge
    return PlantPieces(
        lengths=np.array([h for _, h, _ in pieces]),
        transitions=np.array([step.transition for step in steps]),
        bridges=np.array([step.bridge for step in steps]),
        edges=polynomials,
        responses=np.array([step.source for step in steps]),
        sources=np.empty((len(steps), 6)),
        background=np.empty((0, states_of(circuit(pieces[0][0])) + 2)),
    )


def _equal(one: TwoAxisCircuit, other: TwoAxisCircuit) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("A", "B", "E"))
