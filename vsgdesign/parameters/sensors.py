"""Reads the [sensors] section: what lies between the circuit and the numbers that the controller works with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from vsgdesign.parameters.ranges import Drawn, Range, drawn_values, read_range, stream
from vsgdesign.parameters.reader import TableReader

CHANNELS = ("v_a", "v_b", "v_c", "i_s_a", "i_s_b", "i_s_c", "i_g_a", "i_g_b", "i_g_c")
"""One sensor each: the voltage of the capacitor node, the current of the bridge, the current into the grid."""

_QUANTITIES = (
    Drawn("noise", "1", 0.0, 0.2, logarithmic=True),
    Drawn("gain_error", "1", 0.0, 0.2),
    Drawn("offset_error", "1", 0.0, 0.2),
    Drawn("skew", "rad", -math.radians(18.0), math.radians(18.0)),
    Drawn("range_pu", "1", 1.0, 100.0),
)

_IDEAL: dict[str, Range] = dict.fromkeys([one.name for one in _QUANTITIES], (0.0, 0.0))
_USUAL_RANGE_PU = 3.0
"""Where a sensor with bits says nothing about its range."""

LEVELS: dict[str, dict[str, Range]] = {
    "ideal": _IDEAL,
    "typical": _IDEAL
    | {
        "noise": (0.001, 0.001),
        "gain_error": (0.005, 0.005),
        "offset_error": (0.003, 0.003),
        "skew": (math.radians(0.03), math.radians(0.03)),
    },
    "dirty": _IDEAL | {"noise": (0.001, 0.005), "gain_error": (0.005, 0.005), "offset_error": (0.005, 0.005)},
}
_BITS = {"ideal": 0, "typical": 12, "dirty": 12}


@dataclass(frozen=True, kw_only=True)
class SensorSpec:
    """Sensors in numbers. Relative values are of the rated peak of what a sensor measures."""

    level: str
    seed: int
    noise: float
    """Rms value of white noise in each sample."""
    bits: int
    """Of the converter from analogue to digital over −range to +range; 0: no quantisation."""
    range_pu: float
    """Where every sensor saturates, pu of the rated peak; 0: nowhere."""
    skew: float
    """By how much the currents are sampled later than the voltages, as an angle at the nominal frequency, rad."""
    gain_errors: tuple[float, ...]
    """Of each of :data:`CHANNELS`."""
    offset_errors: tuple[float, ...]
    ranges: tuple[tuple[str, Range], ...]
    """What the numbers were drawn from."""

    def redrawn(self, seed: int) -> SensorSpec:
        """Another draw out of the same ranges and classes."""
        return draw_sensors(dict(self.ranges), seed, self.level, bits=self.bits)

    @property
    def act(self) -> bool:
        """Whether they change anything."""
        ideal = self.noise == self.skew == self.range_pu == 0.0 and self.bits == 0
        return not ideal or any(self.gain_errors) or any(self.offset_errors)

    def document(self) -> dict[str, Any]:
        """The numbers, as a [sensors] section that repeats these; angles in rad."""
        return {
            "level": self.level,
            "seed": self.seed,
            "noise": self.noise,
            "bits": self.bits,
            **({"range_pu": self.range_pu} if self.range_pu > 0.0 else {}),
            "skew": self.skew,
            "gain_errors": list(self.gain_errors),
            "offset_errors": list(self.offset_errors),
        }


def draw_sensors(
    ranges: Mapping[str, Range],
    seed: int,
    level: str = "ideal",
    *,
    bits: int | None = None,
    gain_errors: tuple[float, ...] | None = None,
    offset_errors: tuple[float, ...] | None = None,
) -> SensorSpec:
    """Sensors out of ranges by name; what is not named is as in the level. Errors that are given are not drawn."""
    whole = LEVELS[level] | dict(ranges)
    values = drawn_values(_QUANTITIES, whole, seed)
    bits = _BITS[level] if bits is None else bits
    if bits > 0 and values["range_pu"] == 0.0:
        values["range_pu"] = _USUAL_RANGE_PU
    classes = {name: values.pop(name) for name in ("gain_error", "offset_error")}
    if gain_errors is None:
        gain_errors = _within(classes["gain_error"], seed, "gain_error")
    if offset_errors is None:
        offset_errors = _within(classes["offset_error"], seed, "offset_error")
    return SensorSpec(
        level=level,
        seed=seed,
        bits=bits,
        gain_errors=gain_errors,
        offset_errors=offset_errors,
        ranges=tuple(whole.items()),
        **values,
    )


def _within(limit: float, seed: int, name: str) -> tuple[float, ...]:
    """One error for every channel, of a class that allows ± the limit."""
    return tuple(stream(seed, name, "errors").uniform(-limit, limit, len(CHANNELS)).tolist())


def read_sensors(table: TableReader | None) -> SensorSpec | None:
    """The section; None where a study has none."""
    if table is None:
        return None
    level = table.choice("level", tuple(LEVELS), default="ideal")
    seed = table.integer("seed", 0, 2**31 - 1, default=1)
    ranges = {one.name: read_range(table, one, LEVELS[level][one.name]) for one in _QUANTITIES}
    bits = table.integer("bits", 0, 32, default=_BITS[level])
    gain_errors, offset_errors = _errors(table, "gain_error"), _errors(table, "offset_error")
    table.finish()
    if table.faults:
        return None
    return draw_sensors(ranges, seed, level, bits=bits, gain_errors=gain_errors, offset_errors=offset_errors)


def _errors(table: TableReader, name: str) -> tuple[float, ...] | None:
    """The errors of all sensors one by one, where the section gives them."""
    field = f"{name}s"
    values = table.quantities(field, "1", -0.2, 0.2, (), increasing=False)
    if not table.has(field):
        return None
    if len(values) not in (0, len(CHANNELS)):
        order = ", ".join(CHANNELS)
        table.fault(field, table.table[field], f"must have {len(CHANNELS)} values", f"In this order: {order}.")
    if table.has(name):
        table.fault(name, table.table[name], f"{field} gives the errors themselves", "Give one of them.")
    return values
