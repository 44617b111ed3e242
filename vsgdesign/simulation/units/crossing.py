"""Runs of plants with switched bridges: their kind, and the gaps in which events fall, moved from edge to edge."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.linear.operating_point.circuit_of_units import Wiring, circuit_of_units
from vsgdesign.linear.operating_point.clock_of_units import Clock
from vsgdesign.simulation.units.body import AXES, PlantKind
from vsgdesign.simulation.units.carriers import edges_of, gaps_of_plant
from vsgdesign.simulation.units.program import PlantProgram, edge_responses
from vsgdesign.simulation.units.timeline import PlantTimeline
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


def switched(
    kind: PlantKind, plants: Sequence[tuple[PlantTimeline, Wiring]], clock: Clock, degree: int = 0
) -> PlantKind:
    """The kind of runs with switched bridges of the units: plants of one clock, whose carriers are alike. ``degree``:
    of the responses to edges, at least. Raises InfeasibleStudyError where a dc link moves, the carriers do not repeat,
    or a circuit is too stiff."""
    gaps = gaps_of_plant(plants[0][0], clock)
    sampling = kind.sampling * (len(gaps) // len(kind.sampling))
    most = max(degree, *(_degree(timeline, wiring, clock) for timeline, wiring in plants))
    return kind._replace(sampling=sampling, turns=1 if kind.turns == 1 else len(sampling), gaps=gaps, degree=most)


def _degree(timeline: PlantTimeline, wiring: Wiring, clock: Clock) -> int:
    """The largest degree of a response to an edge in the circuits of a run."""
    units, lengths = len(timeline.units), {one.gap for one in clock.instants}
    topologies = {one.topology for one in timeline.segments}
    circuits = [circuit_of_units(wiring, one, timeline.names) for one in topologies]
    return max(edge_responses(one, h, units).shape[1] - 1 for one in circuits for h in lengths)


def cross(
    at: Callable[[str], Array], kind: PlantKind, program: PlantProgram, units: Sequence[Study], sample: int
) -> None:
    """Moves the circuit over the gap before a sample of the loop. ``at``: the numbers of a record or of one number by
    its name, as an array that moves with the run."""

    def both(before: str, behind: str) -> complex:
        return complex(*(at(f"{before}{axis}{behind}")[0] for axis in AXES))

    begin, end = program.time(sample - 1), program.time(sample)
    y = np.array([both("", f".{name}") for name in kind.states])
    v = np.array([both("", f".held.{k}") for k in range(kind.converters)])
    edges: list[tuple[float, int, complex]] = []
    for k, (gap, study) in enumerate(zip(kind.gaps[(sample - 1) % len(kind.gaps)], units, strict=True)):
        c = study.converter
        own = edges_of(both(f"u{k}.acts.", ""), c.V_dc, gap, zero_sequence=c.zero_sequence)
        edges += [(begin + share * (end - begin), k, step) for share, step in own]
    for first, last, segment in program.cut[sample]:
        marks = sorted({first, last, *(t_s for t_s, _, _ in edges if first < t_s < last)})
        for one, other in itertools.pairwise(marks):
            now = v.copy()
            for t_s, k, step in edges:
                now[k] += step if t_s <= one else 0.0
            y = program.moved(y, now, segment, one, other)
    for name, value in zip(kind.states, y.tolist(), strict=True):
        at(f"alpha.{name}")[:], at(f"beta.{name}")[:] = value.real, value.imag
