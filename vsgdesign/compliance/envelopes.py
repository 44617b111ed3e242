"""Envelopes: two curves over time between which a signal of a test must stay."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.compliance.measuring import MeasureInput, Parameter
from vsgdesign.compliance.trace import Trace

Array = NDArray[np.float64]


class Bounds(NamedTuple):
    """An envelope on the instants of a trace: arrays (n,), in the unit of the signal."""

    signal: str
    """Name of the field of :class:`Trace` that it bounds."""
    t_s: Array
    low: Array
    """-inf where nothing is asked."""
    high: Array
    """inf where nothing is asked."""

    def excess(self, trace: Trace) -> float:
        """By how much the signal leaves the envelope at most; 0 inside, NaN if the signal holds NaN."""
        values = np.asarray(getattr(trace, self.signal))
        beyond = np.maximum(np.maximum(self.low - values, values - self.high), 0.0)
        return float(np.max(beyond)) if beyond.size else 0.0


@dataclass(frozen=True, kw_only=True)
class Envelope:
    """One entry of the registry."""

    name: str
    label: str
    text: str
    """One sentence: what stays between what."""
    parameters: tuple[Parameter, ...]
    function: Callable[..., Bounds]
    """(run, **parameters), each parameter with its default."""

    def of(self, run: MeasureInput, given: tuple[tuple[str, float], ...] | Mapping[str, float] = ()) -> Bounds:
        """The two curves on the instants of the run's trace. Raises ValueError for an unknown parameter."""
        chosen = dict(given)
        known = [parameter.name for parameter in self.parameters]
        unknown = [name for name in chosen if name not in known]
        if unknown:
            there = ", ".join(known) or "none"
            raise ValueError(f"{self.name}: there is no parameter {', '.join(unknown)}. Its parameters: {there}.")
        return self.function(run, **chosen)


_UNITS = {"s": "s", "hz": "Hz", "pu": "pu"}
"""Unit of a parameter, by the end of its name."""


def envelope(label: str, text: str) -> Callable[[Callable[..., Bounds]], Envelope]:
    """Makes a registry entry of a function; its name and the defaults of its parameters are those of the function."""

    def made(function: Callable[..., Bounds]) -> Envelope:
        parameters = list(inspect.signature(function).parameters.values())[1:]
        return Envelope(
            name=function.__name__,
            label=label,
            text=text,
            parameters=tuple(Parameter(p.name, p.default, _UNITS[p.name.rpartition("_")[2]]) for p in parameters),
            function=function,
        )

    return made


@envelope("power is back", "The active power is back at its value before the first event, and stays there.")
def power_back(run: MeasureInput, within_s: float = 3.0, band_pu: float = 0.05) -> Bounds:
    """P within ``band_pu`` of its mean before the first event, from ``within_s`` after the last change on."""
    t, before = run.trace.t_s, run.rest_before(run.trace.P_pu, run.first_s)
    asked = t >= run.cleared_s + within_s
    return Bounds("P_pu", t, np.where(asked, before - band_pu, -np.inf), np.where(asked, before + band_pu, np.inf))


@envelope(
    "power in a band", "The active power stays between two values from one instant after the last event to another."
)
def power_band(
    run: MeasureInput, low_pu: float = 0.0, high_pu: float = 1.0, from_s: float = 0.0, to_s: float = 600.0
) -> Bounds:
    """P between ``low_pu`` and ``high_pu``; both instants are counted from the end of the last change."""
    since = run.trace.t_s - run.cleared_s
    asked = (since >= from_s) & (since <= to_s)
    return Bounds("P_pu", run.trace.t_s, np.where(asked, low_pu, -np.inf), np.where(asked, high_pu, np.inf))


ENVELOPES: Mapping[str, Envelope] = MappingProxyType({found.name: found for found in (power_back, power_band)})
"""By name."""
