"""The [background] section: what a real grid's voltage does besides the events of a study.

Every quantity is a number or a range [low, high]. The numbers of a range are drawn here, with the study's seed, so that
a :class:`BackgroundSpec` holds numbers alone and can be repeated by them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from vsgdesign.study.parameters.fields import SEEDS, drawn, fields_of, inserted, picked, values, whole, word
from vsgdesign.study.parameters.grid import SourceComponent
from vsgdesign.study.parameters.ranges import Range, drawn_values, stream
from vsgdesign.study.parameters.reader import TableReader

HARMONICS = (5, 7, 11, 13)
"""The harmonics of a three-phase grid that have names here."""

_PI = math.pi
_LEVEL = "of the level"


def _drawn(unit: str, low: float, high: float) -> Any:
    return drawn(unit, low, high, shown=_LEVEL)


class _Quantities:
    """Fields of this section."""

    phase: Range = _drawn("rad", -_PI, _PI)
    """Added to the phase of the source. Without it, phase A is a sine that begins at zero at t = 0."""
    frequency_offset: Range = _drawn("Hz", -5.0, 5.0)
    """Added to every frequency of the source, `f_g` of `[grid]` and of events."""
    voltage_factor: Range = _drawn("1", 0.5, 1.5)
    """Multiplies every voltage `V_g_pu` of the source."""
    frequency_wander: Range = _drawn("Hz", 0.0, 1.0)
    """What the frequency would gather in 1 s as a free random walk, rms."""
    frequency_deviation: Range = _drawn("Hz", 0.0, 2.0)
    """Rms value of this wander in the long run; required with `frequency_wander`."""
    voltage_wander: Range = _drawn("1", 0.0, 0.1)
    """The same of the magnitude, relative."""
    voltage_deviation: Range = _drawn("1", 0.0, 0.1)
    """Rms value of this wander in the long run; required with `voltage_wander`."""
    phasor_walk: Range = _drawn("1", 0.0, 0.1)
    """What the phasor gathers as a random walk in one nominal cycle, rms, in phase and magnitude together."""
    phase_noise: Range = _drawn("rad", 0.0, 0.1)
    """Rms value of the mean over a nominal cycle of a phase noise that is white up to some hundred hertz."""
    voltage_noise: Range = _drawn("1", 0.0, 0.1)
    """The same of the magnitude, relative."""
    voltage_steps_per_minute: Range = _drawn("1", 0.0, 600.0)
    """Mean number of steps of the magnitude, at random instants, up or down."""
    phase_jumps_per_minute: Range = _drawn("1", 0.0, 600.0)
    """Mean number of jumps of the phase, at random instants, forwards or backwards."""
    negative_sequence: Range = _drawn("1", 0.0, 0.3)
    """Amplitude over the rated voltage. The seed draws the phase of this and of every harmonic."""
    harmonic_5: Range = _drawn("1", 0.0, 0.3)
    """Amplitude of the fifth harmonic over the rated voltage. It turns backwards, order −5."""
    harmonic_7: Range = _drawn("1", 0.0, 0.3)
    """The seventh, order 7."""
    harmonic_11: Range = _drawn("1", 0.0, 0.3)
    """The eleventh, order −11."""
    harmonic_13: Range = _drawn("1", 0.0, 0.3)
    """The thirteenth, order 13."""
    modulation: Range = _drawn("1", 0.0, 0.3)
    """Amplitude modulation of the fundamental, as the power control of another converter causes it."""
    modulation_frequency: Range = _drawn("Hz", 0.01, 500.0)
    """Frequency of this modulation; required with `modulation`."""
    interharmonic: Range = _drawn("1", 0.0, 0.3)
    """A line in the source's voltage with a frequency of its own, over the rated voltage."""
    interharmonic_frequency: Range = _drawn("Hz", -2500.0, 2500.0)
    """Frequency of this line; negative: it turns backwards; required with `interharmonic`."""


class _Sizes:
    """Each step takes its own size out of these, so they stay ranges."""

    voltage_step: Range = _drawn("1", 0.0, 0.3)
    """Their sizes, relative: each draws its own from the range."""
    phase_jump: Range = _drawn("rad", 0.0, _PI)
    """Their sizes: each draws its own from the range."""


_CLEAN: dict[str, Range] = dict.fromkeys([one.name for one in fields_of(_Quantities)], (0.0, 0.0)) | {
    "voltage_factor": (1.0, 1.0),
    "modulation_frequency": (25.0, 25.0),
    "interharmonic_frequency": (75.0, 75.0),
    "voltage_step": (0.003, 0.01),
    "phase_jump": (0.035, 0.035),
}

LEVELS: dict[str, dict[str, Range]] = {
    "clean": _CLEAN,
    "measured": _CLEAN
    | {
        "phase": (-_PI, _PI),
        "frequency_offset": (-0.05, 0.05),
        "voltage_factor": (0.95, 1.05),
        "frequency_wander": (0.0021, 0.0021),
        "frequency_deviation": (0.02, 0.02),
        "voltage_wander": (0.002, 0.002),
        "voltage_deviation": (0.00076, 0.00076),
        "phase_noise": (1e-4, 2e-4),
        "voltage_noise": (1e-4, 2e-4),
        "voltage_steps_per_minute": (1.4, 1.4),
        "negative_sequence": (0.005, 0.01),
        "harmonic_5": (0.01, 0.03),
        "harmonic_7": (0.01, 0.03),
    },
    "dirty": _CLEAN
    | {
        "phase": (-_PI, _PI),
        "frequency_offset": (-0.5, 0.5),
        "voltage_factor": (0.9, 1.1),
        "frequency_wander": (0.01 * math.sqrt(0.4), 0.01 * math.sqrt(0.4)),  # forgotten within 5 s
        "frequency_deviation": (0.01, 0.01),
        "phasor_walk": (3e-4, 3e-4),
        "negative_sequence": (0.01, 0.02),
        "harmonic_5": (0.0, 0.03),
        "harmonic_7": (0.0, 0.03),
        "harmonic_11": (0.0, 0.015),
        "harmonic_13": (0.0, 0.015),
    },
}
"""The packaged backgrounds: a pure sine, what public records of mains voltage show, and a grid that is worse."""


class _LevelAndSeed:
    """Fields of this section."""

    level: str = word(tuple(LEVELS), default="clean")
    """Values of all fields below."""
    seed: int = whole(0, SEEDS, default=1)
    """Seed of the draw and of the course of time. The same seed gives the same bytes."""


BACKGROUND = (
    *fields_of(_LevelAndSeed),
    *inserted(
        inserted(fields_of(_Quantities), "voltage_steps_per_minute", *picked(_Sizes, "voltage_step")),
        "phase_jumps_per_minute",
        *picked(_Sizes, "phase_jump"),
    ),
)
"""The fields of [background]."""


@dataclass(frozen=True, kw_only=True)
class BackgroundSpec:
    """A background in numbers, SI. :mod:`vsgdesign.simulation.wander` makes the course of time."""

    level: str
    seed: int
    phase: float
    """Added to the phase of the source, rad."""
    frequency_offset: float
    """Added to every frequency of the source, Hz."""
    voltage_factor: float
    """Multiplies every voltage V_g of the source."""
    frequency_wander: float
    """What the frequency gathers in 1 s, rms, Hz (:eq:`wander`)."""
    frequency_deviation: float
    """Its rms value in the long run, Hz."""
    voltage_wander: float
    voltage_deviation: float
    """The same of the magnitude, relative."""
    phasor_walk: float
    """What the phasor gathers in one nominal cycle, rms, relative."""
    phase_noise: float
    """Rms value of the phase noise's mean over a nominal cycle, rad."""
    voltage_noise: float
    """The same of the magnitude, relative."""
    voltage_steps_per_minute: float
    voltage_step: Range
    """Range of their sizes, relative."""
    phase_jumps_per_minute: float
    phase_jump: Range
    """Range of their sizes, rad."""
    components: tuple[SourceComponent, ...]
    """Negative sequence and harmonics, over the rated voltage; their phases follow the wandering source."""
    modulation: float
    """Amplitude modulation of the fundamental, relative."""
    modulation_frequency: float
    modulation_phase: float
    interharmonic: float
    """A line of the source's voltage at a frequency of its own, over the rated voltage."""
    interharmonic_frequency: float
    """Hz; negative: it turns backwards."""
    interharmonic_phase: float
    ranges: tuple[tuple[str, Range], ...]
    """What the numbers were drawn from."""

    def redrawn(self, seed: int) -> BackgroundSpec:
        """Another draw out of the same ranges."""
        return draw_background(dict(self.ranges), seed, self.level)

    @property
    def wanders(self) -> bool:
        """Whether the fundamental ever differs from what the events say."""
        moving = ("frequency_wander", "voltage_wander", "phasor_walk", "phase_noise", "voltage_noise")
        rates = ("voltage_steps_per_minute", "phase_jumps_per_minute", "modulation")
        return any(getattr(self, name) > 0.0 for name in moving + rates)

    @property
    def distorts(self) -> bool:
        """Whether powers ripple at rest: the voltage is not the fundamental that the events say."""
        return self.wanders or bool(self.components) or self.interharmonic > 0.0

    @property
    def restless(self) -> bool:
        """Whether no power comes to rest in it, not even in the mean over a cycle: the fundamental moves, or there is a
        line with a frequency of its own."""
        return self.wanders or self.interharmonic > 0.0

    def document(self) -> dict[str, Any]:
        """The numbers in SI, as a [background] section that repeats this one; and phases that follow from the seed."""
        found: dict[str, Any] = {"level": self.level, "seed": self.seed}
        amplitudes = {
            name: 0.0 for name, _ in self.ranges if name == "negative_sequence" or name.startswith("harmonic")
        }
        amplitudes |= {_name_of(one.order): one.amplitude_pu for one in self.components}
        for name, _ in self.ranges:
            value = amplitudes[name] if name in amplitudes else getattr(self, name)
            found[name] = list(value) if isinstance(value, tuple) else value
        return found


def _name_of(order: float) -> str:
    return "negative_sequence" if order == -1.0 else f"harmonic_{abs(order):g}"


def _order_of(name: str) -> float:
    """A balanced harmonic 5, 11 of a grid turns backwards, 7, 13 forwards."""
    if name == "negative_sequence":
        return -1.0
    order = int(name.removeprefix("harmonic_"))
    return float(order if order % 3 == 1 else -order)


def draw_background(ranges: Mapping[str, Range], seed: int, level: str = "clean") -> BackgroundSpec:
    """A background out of ranges by name, in SI; what is not named is as in the level."""
    given = LEVELS[level] | dict(ranges)
    numbers = drawn_values(fields_of(_Quantities), given, seed)
    components = []
    for name in ("negative_sequence", *(f"harmonic_{order}" for order in HARMONICS)):
        amplitude = numbers.pop(name)
        if amplitude > 0.0:
            components.append(SourceComponent(_order_of(name), amplitude, _angle(seed, name)))
    return BackgroundSpec(
        level=level,
        seed=seed,
        components=tuple(components),
        voltage_step=given["voltage_step"],
        phase_jump=given["phase_jump"],
        modulation_phase=_angle(seed, "modulation"),
        interharmonic_phase=_angle(seed, "interharmonic"),
        ranges=tuple(given.items()),
        **numbers,
    )


def _angle(seed: int, name: str) -> float:
    return float(stream(seed, name, "angle").uniform(-_PI, _PI))


def read_background(table: TableReader | None) -> BackgroundSpec | None:
    """The section; None where a study has none."""
    if table is None:
        return None
    of_all = values(_LevelAndSeed, table)
    level, seed = of_all["level"], of_all["seed"]
    ranges = values((*fields_of(_Quantities), *fields_of(_Sizes)), table, defaults=LEVELS[level])
    for what in ("frequency", "voltage"):
        moves, rest = ranges[f"{what}_wander"], ranges[f"{what}_deviation"]
        if moves[1] > 0.0 and rest[0] <= 0.0:
            table.fault(
                f"{what}_deviation",
                table.table.get(f"{what}_deviation"),
                f"the {what} wanders ({what}_wander), but its rms value in the long run is zero",
                f"Give {what}_deviation, which pulls it back.",
            )
    for line in ("modulation", "interharmonic"):
        field = f"{line}_frequency"
        if ranges[line][1] > 0.0 and not table.has(field):
            table.fault(field, None, "missing", f"Say at which frequency {line} is.")
    low, high = ranges["interharmonic_frequency"]
    if low < 0.0 < high or low == high == 0.0:
        table.fault("interharmonic_frequency", table.table.get("interharmonic_frequency"), "a dc voltage lies in it")
    table.finish()
    return None if table.faults else draw_background(ranges, seed, level)
