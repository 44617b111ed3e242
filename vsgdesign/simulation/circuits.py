"""The circuits that a run meets: one for every grid of its timeline, as the numbers that the loop takes."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.filters import FilterGrid
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.operating_point.plant import PlantStep, TwoAxisCircuit, plant_step, two_axes
from vsgdesign.parameters.study import Grid, Study
from vsgdesign.simulation.bodies import LARGEST_DEGREE, Axes
from vsgdesign.simulation.timeline import Timeline

Array = NDArray[np.float64]

CircuitOfGrid = Callable[[Grid], FilterGrid | TwoAxisCircuit]
"""The circuit between bridge and source on a grid."""


class Circuits:
    """The circuits of a run; ``switched``: whether its bridge switches."""

    def __init__(self, study: Study, timeline: Timeline, circuit: CircuitOfGrid | None, *, switched: bool) -> None:
        self.of = circuits_of(study, timeline, circuit)
        self.switched = switched
        self._omega = study.converter.omega_n
        self._steps = functools.lru_cache(maxsize=64)(self._step)
        self.numbers = functools.lru_cache(maxsize=64)(self._numbers)
        """The same mapping again where it is asked for the same."""
        grids = {grid for _, grid in timeline.grids}
        degree = (
            max(len(self._steps(grid, study.converter.T_s, self._omega).edge) - 1 for grid in grids) if switched else 0
        )
        alike = all(isinstance(self.of(grid), FilterGrid) for grid in grids)
        self.axes: Axes | None = None
        if not alike or degree > LARGEST_DEGREE:
            if alike:
                given = self.of
                self.of = lambda grid: two_axes(given(grid))
                self._steps.cache_clear()
            self.axes = Axes(states_of(self.of(timeline.grid_at(0.0))), degree)

    @property
    def states(self) -> int:
        """How many real states the circuits have on both axes together."""
        return 6 if self.axes is None else self.axes.states

    def _numbers(self, grid: Grid, h: float, V_g_pk: float, omega: float | None) -> dict[str, Array]:
        """The rows of the circuit over an interval h (s), with a source of V_g_pk (V) and omega (rad/s); without omega
        the loop adds no source."""
        step = self._steps(grid, h, self._omega if omega is None else omega)
        V = 0.0 if omega is None else V_g_pk
        turn = (1.0, 0.0) if omega is None else (math.cos(omega * h), math.sin(omega * h))
        source = step.source[0] * V
        if self.axes is None:
            row = [step.transition.ravel(), step.bridge, source.real, source.imag, turn]
        else:
            row = [step.transition.ravel(), step.bridge.ravel(), source.ravel(), turn]
        found = {"row": np.concatenate(row), "V_g": np.array([V])}
        if self.switched:
            found["edge"] = self._edge(step)
        return found

    def _edge(self, step: PlantStep) -> Array:
        degree = LARGEST_DEGREE if self.axes is None else self.axes.degree
        padded = np.zeros((degree + 1, *step.edge.shape[1:]))
        padded[: len(step.edge)] = step.edge
        return np.ascontiguousarray(padded.T).ravel() if self.axes is None else padded.ravel()

    def _step(self, grid: Grid, h: float, omega: float) -> PlantStep:
        step = plant_step(self.of(grid), h, omega, edges=self.switched)
        if not np.isfinite(step.edge).all():
            raise InfeasibleStudyError(
                "the circuit is too stiff to switch: its fastest mode (R/L or R_c/L) dies out many times within a "
                'sampling period. Sample faster, lower R_c, raise x_over_r, or use bridge = "averaged".'
            )
        return step


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


def _equal(one: TwoAxisCircuit, other: TwoAxisCircuit) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("A", "B", "E"))
