"""The [sensors] section: what lies between the circuit and the numbers that the controller works with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from vsgdesign.study.parameters.fields import SEEDS, Field, drawn, fields_of, numbers, values, whole, word
from vsgdesign.study.parameters.ranges import Range, drawn_values, stream
from vsgdesign.study.parameters.reader import TableReader

CHANNELS = ("v_a", "v_b", "v_c", "i_s_a", "i_s_b", "i_s_c", "i_g_a", "i_g_b", "i_g_c")
"""One sensor each: the voltage of the capacitor node, the current of the bridge, the current into the grid."""

_LEVEL = "of the level"


class _Quantities:
    """Fields of this section."""

    noise: Range = drawn("1", 0.0, 0.2, shown=_LEVEL, logarithmic=True)
    """Rms value of white noise in every sample. A range is drawn uniformly in its logarithm."""
    gain_error: Range = drawn("1", 0.0, 0.2, shown=_LEVEL)
    """Class: the gain of each sensor is drawn within ± this of 1."""
    offset_error: Range = drawn("1", 0.0, 0.2, shown=_LEVEL)
    """Class: the offset of each sensor is drawn within ± this."""
    skew: Range = drawn("rad", -math.radians(18.0), math.radians(18.0), shown=_LEVEL)
    """By how much the currents are sampled later than the voltages, as an angle at f_n; at most one sampling period."""
    range_pu: Range = drawn("1", 1.0, 100.0, shown="3 with `bits`, else none")
    """Where every sensor saturates, pu of the rated peak."""


_IDEAL: dict[str, Range] = dict.fromkeys([one.name for one in fields_of(_Quantities)], (0.0, 0.0))
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


class _LevelAndSeed:
    """Fields of this section."""

    level: str = word(tuple(LEVELS), default="ideal")
    """Values of all fields below."""
    seed: int = whole(0, SEEDS, default=1)
    """Seed of the draw and of the noise. The same seed gives the same bytes."""


class _Converters:
    """Fields of this section."""

    bits: int = whole(0, 32, shown=_LEVEL)
    """Bits of the analogue-to-digital converters, over −`range_pu` to +`range_pu`; 0: no quantisation."""


class _Errors:
    """Fields of this section."""

    gain_errors: tuple[float, ...] = numbers("1", -0.2, 0.2, default=(), shown="drawn", increasing=False)
    """The gain errors themselves, nine values: v_a, v_b, v_c, i_s,a, i_s,b, i_s,c, i_g,a, i_g,b, i_g,c."""
    offset_errors: tuple[float, ...] = numbers("1", -0.2, 0.2, default=(), shown="drawn", increasing=False)
    """The offsets themselves, in the same order."""


SENSORS = tuple(one for of in (_LevelAndSeed, _Quantities, _Converters, _Errors) for one in fields_of(of))
"""The fields of [sensors]."""


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
    given = LEVELS[level] | dict(ranges)
    drawn_now = drawn_values(fields_of(_Quantities), given, seed)
    bits = _BITS[level] if bits is None else bits
    if bits > 0 and drawn_now["range_pu"] == 0.0:
        drawn_now["range_pu"] = _USUAL_RANGE_PU
    classes = {name: drawn_now.pop(name) for name in ("gain_error", "offset_error")}
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
        ranges=tuple(given.items()),
        **drawn_now,
    )


def _within(limit: float, seed: int, name: str) -> tuple[float, ...]:
    """One error for every channel, of a class that allows ± the limit."""
    return tuple(stream(seed, name, "errors").uniform(-limit, limit, len(CHANNELS)).tolist())


def read_sensors(table: TableReader | None) -> SensorSpec | None:
    """The section; None where a study has none."""
    if table is None:
        return None
    of_all = values(_LevelAndSeed, table)
    level = of_all["level"]
    ranges = values(_Quantities, table, defaults=LEVELS[level])
    bits = values(_Converters, table, defaults={"bits": _BITS[level]})["bits"]
    errors = {one.name: _errors(table, one) for one in fields_of(_Errors)}
    table.finish()
    return None if table.faults else draw_sensors(ranges, of_all["seed"], level, bits=bits, **errors)


def _errors(table: TableReader, errors: Field) -> tuple[float, ...] | None:
    """The errors of all sensors one by one, where the section gives them."""
    field, name = errors.name, errors.name.removesuffix("s")
    given = values((errors,), table)[field]
    if not table.has(field):
        return None
    if len(given) not in (0, len(CHANNELS)):
        order = ", ".join(CHANNELS)
        table.fault(field, table.table[field], f"must have {len(CHANNELS)} values", f"In this order: {order}.")
    if table.has(name):
        table.fault(name, table.table[name], f"{field} gives the errors themselves", "Give one of them.")
    return given
