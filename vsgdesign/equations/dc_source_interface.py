"""What feeds the dc link: the interface of all sources.

A source is two functions of scalars. ``flow`` says at a sample which current the source gives into the link until the
next one, as a law of the link's voltage; ``remember`` says what the source remembers after that. Which branch of its
characteristic holds (a limit of current, of power, of charge) is decided at the samples, as the controls of real
sources do it. Both follow the rules of every equation (CONTRIBUTING.md, "Add an equation").
"""

from __future__ import annotations

import math
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import Nothing


class Decay(NamedTuple):
    """Numbers with which dv/dt = −λv + N is moved over one interval (:eq:`dc-step`)."""

    rate: Any
    """λ, 1/s."""
    half: Any
    """exp(−λT/2)."""
    whole: Any
    """exp(−λT)."""
    half_time: Any
    """What a constant N adds in half an interval, s."""
    first: Any
    middle: Any
    last: Any
    """Weights of N at the beginning, in the middle (of each of the two values) and at the end, s."""


class DcFlow(NamedTuple):
    """The current that a source gives into the link from one sample to the next, A:
    i(v) = current + p/v + (slope + second·d)·d − g·v, where d = v − v₀ is the change since the sample (:eq:`dc-flow`).
    The conductance g is in ``decay``."""

    current: Any
    slope: Any
    """A/V."""
    second: Any
    """A/V²."""
    p_begin: Any
    p_middle: Any
    p_end: Any
    """A power p, W, at the beginning, in the middle and at the end of the interval."""
    tilt: Any
    """By how much the current is larger at the end of the interval than at its beginning, on a straight line about
    ``current``, A."""
    decay: Decay
    """Of the conductance together with the bleeder."""
    notes: Any = Nothing()
    """What ``remember`` has to know of this interval: a NamedTuple of the source's own."""


class DcRatings(NamedTuple):
    """From which a source computes its constants, in SI units."""

    T_s: float
    V_dc: float
    """Nominal voltage of the link."""
    C: float
    """Capacitance of the link, F."""
    R_bleed: float
    """Resistor across it, Ω; infinite without one."""
    S_rated: float
    V_low: float = 0.0
    V_high: float = math.inf
    """Voltages of the link beyond which the bridge blocks, V."""
    V_needed: float = 0.0
    """What the bridge needs for the rated voltage, V."""

    def decay(self, conductance: float) -> Decay:
        """The numbers of an interval in which a conductance (S) lies across the link beside the bleeder."""
        return decay_of((conductance + 1.0 / self.R_bleed) / self.C, self.T_s)


class SourceLimits(NamedTuple):
    """What a source can give now, W at the link; what it takes is negative."""

    low: Any
    high: Any


class SourceLeft(NamedTuple):
    """What a source could still do at an instant, J: zero where a limit of its current or its power holds it back, and
    infinite where nothing does."""

    give: Any
    take: Any


class DcSourceLaw(NamedTuple):
    """The functions of a source.

    ``flow(memory, v, p, constants)`` gives the :class:`DcFlow` of the interval that begins with the link's voltage v,
    V; p is the power that the bridge took in the interval before, W.

    ``remember(memory, flow, v_0, v_1, mean, p, constants)`` gives the memory of the next sample. The voltages are those
    at the beginning and at the end of the interval, and the mean over it; p is the mean power that the bridge took.

    ``can_give(memory, hold, constants)`` gives the :class:`SourceLimits` at rest, within the limits of the link's
    voltage, so that the charge lasts for ``hold`` (s).
    """

    flow: Callable[..., Any]
    remember: Callable[..., Any]
    can_give: Callable[..., Any]


@dataclass(frozen=True)
class DcParameter:
    """A number of a source that a study may set: its name there, its SI unit ("1" for a ratio), the limits between
    which it makes sense, and what it is. ``default``: its number, or how it follows from the ratings and the parameters
    before it; None: a study has to give it."""

    name: str
    unit: str
    low: float
    high: float
    meaning: str
    default: float | Callable[[DcRatings, Mapping[str, Any]], Any] | None = None
    shown: str = ""
    """The default in words, where it is no number."""


@dataclass(frozen=True)
class DcSource:
    """A way to feed the link, by its name in a study file."""

    name: str
    law: DcSourceLaw
    build: Callable[[DcRatings, Mapping[str, Any]], Any]
    """Its constants, a NamedTuple of floats, from the ratings and from a value for each of its parameters."""
    rest: Callable[[float, DcRatings, Any, Mapping[str, Any]], tuple[float, Any]]
    """Where it rests while the bridge takes a power, W: the link's voltage and its memory. Raises ValueError with the
    reason where it cannot give this power."""
    holds: Callable[..., Any]
    """Where it rests as an equation of scalars: ``holds(p, charge, bleed, constants)`` with the power of the bridge, W,
    its state of charge (0 to 1; one without a charge does not read it) and the conductance of the bleeder, S. Returns
    (v, possible): the link's voltage, V, and whether the source can give this, 1 or 0."""
    parameters: tuple[DcParameter, ...] = ()
    check: Callable[[DcRatings, Mapping[str, Any]], Mapping[str, str]] | None = None
    """Faults of several parameters together: {name: what is wrong}."""
    lost: tuple[str, ...] = ()
    """The parameters of which a share is left where a share of the source is lost."""
    moving: tuple[str, ...] = ()
    """Fields of the memory that move at once, and not as slowly as a charge."""
    recharged: Callable[[Any, Any], Mapping[str, Any]] | None = None
    """What the memory has at a state of charge, by its fields; the second argument are the constants. None: the source
    has no charge."""
    left: Callable[..., Any] | None = None
    """``left(memory, v, p, constants)`` gives the :class:`SourceLeft` at the link's voltage v, V, with the power p that
    the bridge took in the interval before, W. None: it is not known, so that a blocked bridge is never excused."""

    @property
    def records(self) -> tuple[Any, Any]:
        """The NamedTuple classes of its memory and of its constants."""
        memory = typing.get_args(typing.get_type_hints(self.rest)["return"])[1]
        return memory, typing.get_type_hints(self.build)["return"]

    def values(self, ratings: DcRatings, given: Mapping[str, Any]) -> dict[str, Any]:
        """Every parameter in SI: as given, else its default; NaN where it has to be given and is not."""
        found: dict[str, Any] = {}
        for one in self.parameters:
            value = given.get(one.name)
            if value is None and callable(one.default):
                value = one.default(ratings, found)
            found[one.name] = (math.nan if one.default is None else one.default) if value is None else value
        return found


ROOM = 0.98
"""Share of the way from the voltage without power to a limit of the link that a clamped source may use."""


def decay_of(rate: float, T: float) -> Decay:
    """The numbers of an interval T (s) with a rate λ (1/s): exponential differencing of fourth order
    (:eq:`dc-step`)."""
    z = -rate * T
    one, two, three = (_phi(order, z) for order in (1, 2, 3))
    return Decay(
        rate=rate,
        half=math.exp(0.5 * z),
        whole=math.exp(z),
        half_time=0.5 * T * _phi(1, 0.5 * z),
        first=T * (one - 3.0 * two + 4.0 * three),
        middle=T * 2.0 * (two - 2.0 * three),
        last=T * (4.0 * three - two),
    )


def _phi(order: int, z: float) -> float:
    """φ of an order at z: Σ zⁿ/(n + order)!"""
    if abs(z) < 1.0:
        return math.fsum(z**n / math.factorial(n + order) for n in range(20))
    below = math.exp(z) if order == 1 else _phi(order - 1, z)
    return (below - 1.0 / math.factorial(order - 1)) / z


def chosen_decay(first: Any, one: Decay, other: Decay) -> Decay:
    """``one`` where ``first`` is 1, else ``other``."""
    return Decay(
        rate=np.where(first > 0.5, one.rate, other.rate),
        half=np.where(first > 0.5, one.half, other.half),
        whole=np.where(first > 0.5, one.whole, other.whole),
        half_time=np.where(first > 0.5, one.half_time, other.half_time),
        first=np.where(first > 0.5, one.first, other.first),
        middle=np.where(first > 0.5, one.middle, other.middle),
        last=np.where(first > 0.5, one.last, other.last),
    )


__all__ = [
    "DcFlow",
    "DcParameter",
    "DcRatings",
    "DcSource",
    "DcSourceLaw",
    "Decay",
    "Nothing",
    "SourceLeft",
    "SourceLimits",
    "chosen_decay",
    "decay_of",
]
