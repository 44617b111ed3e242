"""Switched bridges in a plant: what the legs of every unit do between two instants, each on a carrier of its own
(:eq:`plant-edges`).

The response of the circuit to an edge is a polynomial in the time that is left. Of the edges of a unit it takes sums of
powers alone, which the matrix of the loop multiplies like everything else that moves the circuit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from vsgdesign.codegen.blocks import Part, Writer, joined, with_outputs
from vsgdesign.codegen.flat import Block
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.flow_of_units import Clock
from vsgdesign.simulation.axes import FALLING, PEAK, RISING, sums_of_powers, switched_legs
from vsgdesign.simulation.circuit_sample import BridgeVoltage, CarrierPart, Switching, edges_on_slope, legs_after
from vsgdesign.simulation.loop import carrier_part
from vsgdesign.simulation.units.timeline import PlantTimeline

AXES = ("alpha", "beta")


class OnCarrier(NamedTuple):
    """Where a gap between two instants lies on the carrier of a unit."""

    part: CarrierPart
    slope: str


def gaps_of_plant(timeline: PlantTimeline, clock: Clock) -> tuple[tuple[OnCarrier, ...], ...]:
    """Where the gap after each instant lies on the carrier of each unit, over the time after which all repeat, whole
    periods of the clock. The first sample of a unit lies in a valley of its carrier.

    Raises InfeasibleStudyError where a dc link is not ideal, or the carriers do not repeat within some instants.
    """
    plant, units = timeline.plant, timeline.units
    for unit, study in zip(plant.units, units, strict=True):
        if study.dc is not None:
            raise InfeasibleStudyError(
                f"unit {unit.name}: a dc link that moves has an averaged bridge in a plant. Leave [dc] out, or take "
                'bridge = "averaged".'
            )
    carriers = [1.0 / study.converter.f_sw for study in units]
    begins = [unit.offset - min(one.offset for one in plant.converters) for unit in plant.units]
    found = []
    for turn in range(_periods(clock, carriers)):
        for one in clock.instants:
            t_s, places = turn * clock.period + one.t_s, zip(carriers, begins, strict=True)
            found.append(tuple(_on_carrier((t_s - begin) / T, one.gap / T) for T, begin in places))
    return tuple(found)


_MOST_INSTANTS = 512
_SAME = 2e-6
"""Share of a carrier's period by which an instant may lie beside the sample of a unit: more than what a clock takes for
one instant."""


def _periods(clock: Clock, carriers: Sequence[float]) -> int:
    """After how many periods of the clock all carriers repeat."""
    for count in range(1, _MOST_INSTANTS // len(clock.instants) + 1):
        turns = [count * clock.period / T for T in carriers]
        if all(abs(one - round(one)) < 1e-9 for one in turns):
            return count
    raise InfeasibleStudyError(
        f"network: the carriers of its units do not repeat within {_MOST_INSTANTS} instants at which they sample. Give "
        'switching frequencies in the ratio of small whole numbers, or bridge = "averaged".'
    )


def _on_carrier(begin: float, length: float) -> OnCarrier:
    """``begin``: in periods of the carrier. A gap ends at the valley at the latest: there the unit samples."""
    begin -= math.floor(begin + _SAME)
    places = [round(one, 12) for one in (begin, begin + length)]  # the end of one gap is the beginning of the next
    first, last = (max(0.0, min(1.0, one)) for one in places)
    slope = RISING if last <= 0.5 else FALLING if first >= 0.5 else PEAK
    return OnCarrier(CarrierPart(*(float(one) for one in carrier_part(first, last))), slope)


def legs(slope: str, degree: int, *, zero_sequence: bool) -> Block:
    """From the voltage ``acts`` that a unit has asked for, and the ``part`` of the carrier, to its bridge over a gap:
    the voltage ``first`` just after its beginning, and the sums of powers of its edges, ``power.POWER.AXIS``."""
    applied = {f"applied.{axis}": f"acts.{axis}" for axis in AXES} | {"V_dc": "V_dc"}
    parts, edges = switched_legs(slope, applied, zero_sequence=zero_sequence)
    line = Writer()
    for axis in AXES:
        line.output(f"first.{axis}", line.input(f"bridge.{axis}"))
    for power, sums in enumerate(sums_of_powers(line, edges, degree)):
        for axis, total in zip(AXES, sums, strict=True):
            line.output(f"power.{power}.{axis}", total)
    block = line.block()
    return with_outputs(joined(*parts, Part(block)), tuple(name for name, _ in block.outputs))


def edges_of(acts: complex, V_dc: float, gap: OnCarrier, *, zero_sequence: bool) -> list[tuple[float, complex]]:
    """The same in plain Python: of each edge the share of the gap that is over, and the step, V peak."""
    applied = BridgeVoltage(acts.real, acts.imag)
    _, m_a, m_b, m_c = legs_after(applied, V_dc, gap.part, zero_sequence, gap.slope != FALLING)
    found: list[tuple[float, complex]] = []
    for rising in {RISING: (True,), FALLING: (False,), PEAK: (True, False)}[gap.slope]:
        edges: tuple[Switching, ...] = edges_on_slope(m_a, m_b, m_c, V_dc, gap.part, rising)
        steps = ((0.5 - 0.5 * float(one.place), complex(one.alpha, one.beta)) for one in edges)
        found += [(share, step) for share, step in steps if step != 0.0]
    return found
