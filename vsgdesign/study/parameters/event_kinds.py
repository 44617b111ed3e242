"""The kinds of quantities that an event may change: how documents write them, and what they are called."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from vsgdesign.equations.power_loops import References
from vsgdesign.equations.registry import Registry
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import F_N, MOST_REFERENCE, V_MAX, V_MIN, Field, Limit

if TYPE_CHECKING:
    from vsgdesign.study.parameters.event import Event

MOST_DF_HZ = 12.0
"""Largest distance from the nominal frequency in a suite, Hz."""
MOST_POWER_PU = 2.0
"""Largest set point of a power in a suite, pu."""
DC_QUANTITIES = ("dc_power", "dc_charge", "irradiance")
"""Quantities of :class:`vsgdesign.study.parameters.event.Event` that belong to the source of the dc link."""


@dataclass(frozen=True, kw_only=True)
class OfSuite:
    """How a suite of grid-code tests writes a quantity, so that it serves every converter."""

    name: str
    """Its field in an event of a suite."""
    unit: str
    limits: tuple[float, float]
    of_study: Callable[[float, Converter], float]
    """The value in a study's [[events]] for a suite's value and a converter."""
    words: str
    """What a test is called by it in a list of values, such as ``V_g {} pu``; ``{:+}`` stands for a value with a
    sign."""
    sentence: str
    """The same in the description of a suite, such as ``voltage {} pu``."""
    signed: bool = False
    """Whether the sentence shows the sign."""
    short: Callable[[Any], str]
    """A suite's value in words, such as ``V_g 0.5 pu``."""
    read: Callable[[float], float] = float
    """What is kept of a value that was read."""


@dataclass(frozen=True, kw_only=True)
class StepOfKind:
    """A step of a quantity by a size, up or down: how a verification draws it, and how the explorer shows it."""

    name: str
    """The table of [verification], and the explorer's name of the kind."""
    title: str
    """Heading of its cases, such as ``Steps of V_ref``."""
    noun: str
    """What its cases are called, such as ``steps of V_ref``."""
    label: str
    """What one is called, such as ``step of V_ref``."""
    unit: str
    """Of the size, as it is shown: ``pu`` or ``Hz``."""
    start: Callable[[Converter], float]
    """The value before the step, SI."""
    one: Callable[[Converter], float]
    """What a size of 1 is in SI."""
    size: tuple[float, float]
    """The range that a verification draws from unless the study gives another, and the explorer's first size."""
    most: float
    """Largest size."""
    new: bool = False
    """Whether the size is the new value itself, and not a change up or down."""

    def value(self, size: Any, converter: Converter) -> Any:
        """The value after a step by a size, SI."""
        return (0.0 if self.new else self.start(converter)) + size * self.one(converter)


@dataclass(frozen=True, kw_only=True)
class EventKind:
    """A quantity that an event may change. :meth:`EventKinds.register` makes it known to every reader and writer."""

    name: str
    """Its field in a study's [[events]]."""
    quantity: str
    """The field of :class:`vsgdesign.study.parameters.event.Event` that it sets: a set point (P_ref, Q_ref, omega_0,
    V_n), or of the source V_g_rms, omega_g or phase_jump."""
    unit: str
    low: Limit
    high: Limit
    """Least and largest value in a study, in ``unit``."""
    meaning: str
    """What it is, as docs/study-file.md says it."""
    one: Callable[[Converter], float] = lambda _: 1.0
    """What 1 ``unit`` of a study's field is in SI."""
    words: Callable[[float, Converter], str]
    """A value in SI in words, such as ``V_g 0.5 pu``."""
    of_suite: OfSuite
    ramps: bool = False
    """Whether ``over`` makes a ramp of it."""
    nothing: float | None = None
    """The value that changes nothing, which is that of a field that is left out."""
    step: StepOfKind | None = None
    """Its step, where a verification may draw it and the explorer shows it. A verification never does, unless a study
    gives it a weight. None: it has none, or another part of the project has it."""
    answers: str = ""
    """The gain without which a controller does not answer, a name of
    :class:`vsgdesign.equations.power_loops.PowerLoopGains`; empty: every controller answers."""
    needs: str = ""
    """What such a controller lacks, in words, such as ``Q–V droop``."""

    @property
    def field(self) -> Field:
        """The field of a study's [[events]]."""
        unchanged = "unchanged" if self.nothing is None else ""
        return Field(
            kind="number",
            name=self.name,
            attribute=self.quantity,
            unit=self.unit,
            low=self.low,
            high=self.high,
            default=self.nothing,
            shown=unchanged,
            explained=self.meaning,
        )

    @property
    def of_controller(self) -> bool:
        """Whether it is a set point of the controller."""
        return self.quantity in References._fields

    @property
    def of_dc(self) -> bool:
        """Whether it belongs to the source of the dc link."""
        return self.quantity in DC_QUANTITIES

    def value(self, event: Event) -> float | None:
        """The new value in an event; None: it does not change."""
        value = getattr(event, self.quantity)
        return None if value == self.nothing else value

    def on(self, value: Any, converter: Converter) -> float:
        """A value per unit in SI."""
        return self.one(converter) * self.of_suite.of_study(value, converter)

    def written(self, event: Event, converter: Converter) -> float:
        """The value of an event as a study's field."""
        value: Any = self.value(event)
        return self.of_suite.of_study(value, converter) if event.per_unit else value / self.one(converter)


class EventKinds(Registry[EventKind]):
    """Kinds of events by the names of their fields in a study. Other processes do not know one that is registered: give
    a verification of it one worker."""

    what = "kind of event"

    @property
    def steps(self) -> dict[str, tuple[EventKind, StepOfKind]]:
        """The kinds that have a step, by its name."""
        return {kind.step.name: (kind, kind.step) for kind in self.values() if kind.step is not None}

    @property
    def explored(self) -> dict[str, tuple[EventKind, StepOfKind]]:
        """Those among them that the explorer has, whose dc link is ideal."""
        return {name: pair for name, pair in self.steps.items() if not pair[0].of_dc}


def _f_n(converter: Converter) -> float:
    return converter.omega_n / (2.0 * math.pi)


_VOLTAGE = EventKind(
    name="V_g_pu",
    quantity="V_g_rms",
    unit="1",
    low=0.0,
    high=2.0,
    meaning="source voltage, pu of rated",
    one=lambda c: c.V_rated_rms,
    words=lambda V, c: f"V_g {V / c.V_rated_rms:.3g} pu",
    of_suite=OfSuite(
        name="V_g_pu",
        unit="1",
        limits=(0.0, 2.0),
        of_study=lambda V_pu, _: V_pu,
        words="V_g {} pu",
        sentence="voltage {} pu",
        short=lambda V_pu: f"V_g {V_pu:.3g} pu",
    ),
    ramps=True,
)
_FREQUENCY = EventKind(
    name="f_g",
    quantity="omega_g",
    unit="Hz",
    low=0.8 * F_N,
    high=1.2 * F_N,
    meaning="source frequency",
    one=lambda _: 2.0 * math.pi,
    words=lambda omega, _: f"f_g {omega / (2.0 * math.pi):.4g} Hz",
    of_suite=OfSuite(
        name="df",
        unit="Hz",
        limits=(-MOST_DF_HZ, MOST_DF_HZ),
        of_study=lambda df, c: _f_n(c) + df,
        words="{:+}",
        sentence="frequency to {} off nominal",
        signed=True,
        short=lambda df: f"{df:+.3g} Hz",
    ),
    ramps=True,
)
_PHASE = EventKind(
    name="phase_jump",
    quantity="phase_jump",
    unit="rad",
    low=-math.pi,
    high=math.pi,
    meaning="jump of the source's phase, positive: ahead. A component of order n jumps by n times as much: the whole "
    "waveform moves",
    nothing=0.0,
    words=lambda jump, _: f"phase {math.degrees(jump):+.3g}°",
    of_suite=OfSuite(
        name="phase_jump",
        unit="rad",
        limits=(-math.pi, math.pi),
        of_study=lambda jump, _: jump,
        words="{:+}",
        sentence="phase {}",
        signed=True,
        short=lambda jump: f"phase {math.degrees(jump):+.3g}°",
        read=lambda jump: math.radians(float(f"{math.degrees(jump):.12g}")),  # "30 deg" is 30° again
    ),
)


def _power(signal: str, unit: str) -> EventKind:
    name = f"{signal}_ref"
    return EventKind(
        name=name,
        quantity=name,
        unit=unit,
        low=-1.0 * MOST_REFERENCE,
        high=MOST_REFERENCE,
        meaning="set point",
        words=lambda power, _: f"{name} {power / 1e3:.4g} k{unit}",
        of_suite=OfSuite(
            name=f"{signal}_pu",
            unit="1",
            limits=(-MOST_POWER_PU, MOST_POWER_PU),
            of_study=lambda power_pu, c: power_pu * c.S_rated,
            words=f"{signal} to {{}} pu",
            sentence=f"{name} to {{}} pu",
            short=lambda power_pu: f"{name} {power_pu:.3g} pu",
        ),
    )


_VOLTAGE_SET_POINT = EventKind(
    name="V_ref_pu",
    quantity="V_n",
    unit="1",
    low=V_MIN,
    high=V_MAX,
    meaning="set point of the voltage in the Q–V droop, pu of rated. A controller without this droop does not answer",
    one=lambda c: c.V_rated_rms,
    words=lambda V, c: f"V_ref {V / c.V_rated_rms:.4g} pu",
    of_suite=OfSuite(
        name="V_ref_pu",
        unit="1",
        limits=(0.5, 1.5),
        of_study=lambda V_pu, _: V_pu,
        words="V_ref to {} pu",
        sentence="V_ref to {} pu",
        short=lambda V_pu: f"V_ref {V_pu:.4g} pu",
    ),
    step=StepOfKind(
        name="voltage_set_point",
        title="Steps of V_ref",
        noun="steps of V_ref",
        label="step of V_ref",
        unit="pu",
        start=lambda c: c.V_rated_rms,
        one=lambda c: c.V_rated_rms,
        size=(0.01, 0.05),
        most=0.25,
    ),
    answers="D_q",
    needs="Q–V droop",
)


def _of_dc(
    name: str, unit: str, high: float, meaning: str, called: str, size: tuple[float, float], start: float = 1.0
) -> EventKind:
    """A quantity of the source of the dc link."""
    shown = "" if unit == "1" else f" {unit}"
    return EventKind(
        name=name,
        quantity=name,
        unit=unit,
        low=0.0 if unit == "1" else 1.0,
        high=high,
        meaning=f"{meaning} ([dc side](theory/dc-side.md#events))",
        words=lambda value, _: f"{called} {value:.3g}{shown}",
        of_suite=OfSuite(
            name=name,
            unit=unit,
            limits=(0.0 if unit == "1" else 1.0, high),
            of_study=lambda value, _: value,
            words=f"{called} to {{}}",
            sentence=f"{called} to {{}}",
            short=lambda value: f"{called} {value:.3g}{shown}",
        ),
        step=StepOfKind(
            name=name,
            title=f"New values of {name}",
            noun=f"new values of {name}",
            label=f"new value of {name}",
            unit=unit,
            start=lambda _: start,
            one=lambda _: 1.0,
            size=size,
            most=high,
            new=True,
        ),
    )


_OF_DC = (
    _of_dc("dc_power", "1", 1.0, "share of the source of the dc link that is left", "dc source", (0.5, 0.5)),
    _of_dc("dc_charge", "1", 1.0, "state of charge of this source", "dc charge", (0.0, 0.2)),
    _of_dc("irradiance", "W/m^2", 2000.0, "irradiance on its array", "irradiance", (200.0, 1000.0), 1000.0),
)
EVENT_KINDS = EventKinds(
    (_VOLTAGE, _FREQUENCY, _PHASE, _power("P", "W"), _power("Q", "var"), _VOLTAGE_SET_POINT, *_OF_DC)
)
"""The quantities that an event may change, in the order in which an event is described."""
