"""The trace of a run, and what a measure of it is: a figure with name, unit, meaning and parameters, or why it is not
known."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.suite import SuiteTest
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.metrics.step_response import settling_time
from vsgdesign.metrics.survival import BLOCKED, DIVERGED, LATCHED, NOT_AT_REST, SLIPPED, Survival
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Signals of one run, equally spaced arrays (n,). Time zero is the beginning of the test."""

    t_s: Array
    P_pu: Array
    """At the capacitor, as the controller measures it, over the rating; unfiltered."""
    Q_pu: Array
    f_hz: Array
    """Frequency of the converter's frame, Hz."""
    V_pu: Array
    """The converter's voltage reference, phase rms over the nominal one."""
    delta_rad: Array
    """Angle of the converter's frame against the grid source, rad, unwrapped."""
    i_s_pu: Array
    """Length of the converter current's vector over the rated peak."""
    i_phase_pu: Array
    """Largest magnitude of the three phases of i_s over the rated peak."""
    v_alpha_pu: Array
    v_beta_pu: Array
    """Capacitor node, over the rated phase peak."""
    i_g_alpha_pu: Array
    i_g_beta_pu: Array
    """Current into the PCC, over the rated peak."""
    P_dc_pu: Array
    """Power that the dc link gives to the bridge, over the rating, mean over each row's interval."""
    v_dc_pu: Array
    """Voltage of the dc link over the nominal one; 1 where the link is ideal."""
    limited: Array
    """Share of the samples since the row before in which the limiter acted."""


Complex = NDArray[np.complexfloating[Any, Any]]
T = TypeVar("T")


class Measured(NamedTuple):
    """A figure, or why there is none."""

    value: float | None
    """In the measure's unit. None: it is not known."""
    why: str = ""
    """Why it is not known; of a figure that is known, what is to be said of it."""
    plus_minus: float = 0.0
    """How far the figure may be from the truth, in its unit, as far as the measurement knows: of a time the interval of
    the trace, of a fit the distance from another fit."""


def not_known(why: str) -> Measured:
    """There is no figure, with the reason in words."""
    return Measured(None, why)


@dataclass(frozen=True, kw_only=True)
class Ratings:
    """What a measure must know of the converter."""

    S_rated: float
    """VA."""
    V_rated_rms: float
    """Phase rms, V."""
    f_n_hz: float
    i_limit_pu: float | None
    """Limit of the converter's current over the rated peak; None without one."""
    X_2_pu: float = 0.0
    """Reactance of the filter between the capacitor and the PCC, pu."""
    R_2_pu: float = 0.0
    """Resistance there, pu."""
    lag_P_s: float = 0.0
    """Delay of the filters of the measured active power, s."""

    @classmethod
    def of(cls, study: Study, spec: ControllerSpec) -> Ratings:
        """The ratings of a study's converter with one of its controllers, which may have a current limit of its own."""
        c = study.with_limit_of(spec).converter
        return cls(
            S_rated=c.S_rated,
            V_rated_rms=c.V_rated_rms,
            f_n_hz=c.omega_n / (2.0 * math.pi),
            i_limit_pu=c.current_limit_pu,
            X_2_pu=c.omega_n * study.filter.L_2 / c.Z_base,
            R_2_pu=study.filter.R_2 / c.Z_base,
            lag_P_s=study.power_lags[0],
        )


@dataclass(frozen=True, kw_only=True)
class MeasureInput:
    """Everything that a measure may look at: one test, its trace and its verdict, and the converter with its gains."""

    test: SuiteTest
    trace: Trace
    ratings: Ratings
    survival: Survival | None = None
    """The judge's verdict; None if the run was not judged."""
    gains: PowerLoopGains | None = None
    """In force before the first event, in SI; None if they are not known."""
    nfp: Callable[[Array], Complex | str] | None = None
    """ΔP over Δω of the grid, per unit, at angular frequencies (rad/s), from a linear model at the test's first grid
    and operating point, or why there is none (:func:`vsgdesign.campaigns.compliance.run.nfp_of`). None: no model is
    given."""
    shared: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)
    """What several measures need, computed once (:meth:`once`)."""

    def once(self, function: Callable[[MeasureInput], T]) -> T:
        """``function(self)``, computed the first time and remembered by the function's name."""
        if function.__name__ not in self.shared:
            self.shared[function.__name__] = function(self)
        return self.shared[function.__name__]

    @cached_property
    def events_s(self) -> tuple[float, ...]:
        """The instants of all events, s; one at 0 if the test has none."""
        return tuple(event.t_s for event in self.test.events) or (0.0,)

    @property
    def first_s(self) -> float:
        """The first event, s."""
        return self.events_s[0]

    @property
    def cleared_s(self) -> float:
        """When the last event, with its ramp, is over, s."""
        return self.test.cleared_s

    @property
    def step_s(self) -> float:
        """Interval of the trace's rows, s."""
        t = self.trace.t_s
        return float(t[-1] - t[0]) / (len(t) - 1)

    @property
    def rows_per_cycle(self) -> int:
        """Rows in a nominal cycle, rounded to a whole number of at least one."""
        return max(round(1.0 / (self.ratings.f_n_hz * self.step_s)), 1)

    def end(self, values: Array) -> float:
        """Where ``values`` end: their mean over whole cycles, up to a tenth of what follows the last event."""
        cycle = self.rows_per_cycle
        after = len(values) - self.first_row(self.cleared_s)
        return float(np.mean(values[-max(after // 10 // cycle, 1) * cycle :]))

    def first_row(self, t_s: float) -> int:
        """The first row at ``t_s`` or after it. Times are rounded, so a row may lie a little before."""
        return int(np.searchsorted(self.trace.t_s, t_s - 1e-3 * self.step_s))

    def rows(self, begin_s: float, end_s: float = math.inf) -> slice:
        """The rows with begin_s <= t < end_s."""
        return slice(self.first_row(begin_s), self.first_row(end_s) if math.isfinite(end_s) else len(self.trace.t_s))

    def rest_before(self, values: Array, t_s: float) -> float:
        """Mean of ``values`` over the cycle before ``t_s``; the row at ``t_s`` if the trace begins there."""
        stop = self.first_row(t_s)
        if stop == 0:
            return float(values[0])
        return float(np.mean(values[max(self.first_row(t_s - 1.0 / self.ratings.f_n_hz), 0) : stop]))

    def event_with(self, has: Callable[[Event], bool]) -> tuple[Event, float] | None:
        """The first event of a kind, and when the next event comes (infinity after the last). None: there is none."""
        for event, after in zip(self.test.events, [*self.test.events[1:], None], strict=True):
            if has(event):
                return event, math.inf if after is None else after.t_s
        return None

    def grid_hz(self, t_s: float) -> float:
        """Frequency of the grid just before ``t_s``, Hz, at rest: nominal with the last deviation before."""
        changes = [event.df_hz for event in self.test.events if event.df_hz is not None and event.t_s < t_s - 1e-9]
        return self.ratings.f_n_hz + (changes[-1] if changes else self.test.df_hz)

    def settled(self, since_s: Array, error: Array, band: float, what: str) -> Measured:
        """The time from which ``error`` stays within ``band`` up to the end of the trace, for some cycles at least."""
        found = settling_time(since_s, error, band)
        if found is None:
            return not_known(f"P is {float(error[-1]):.3g} pu away from {what}, at the end of the trace")
        cycles = (float(since_s[-1]) - found) * self.ratings.f_n_hz
        if cycles < IN_BAND_CYCLES:
            return not_known(
                f"P is within {band:g} pu of {what} for the last {cycles:.2g} cycles alone; {IN_BAND_CYCLES} are needed"
            )
        return Measured(found, plus_minus=self.step_s)

    def limiter_acts(self, rows: slice) -> bool:
        """Whether the current limiter acts in any of the rows."""
        return bool(np.any(self.trace.limited[rows] > 0.0))


LOST = (SLIPPED, LATCHED, DIVERGED, BLOCKED)
"""Verdicts of the judge after which nothing is known of how the converter swings about a rest."""

NO_FINAL_VALUE = (*LOST, NOT_AT_REST)
"""Verdicts after which the end of a trace is no final value."""


IN_BAND_CYCLES = 5
"""For so many cycles at the end of a trace a signal must have been in its band to have settled there."""


class Parameter(NamedTuple):
    """A number on which a measure or an envelope depends."""

    name: str
    default: float
    unit: str
    least: float = -math.inf
    most: float = math.inf

    def problem(self, value: float) -> str | None:
        """Why it cannot have this value, in words; None if it can."""
        if not math.isfinite(value):
            return "must be a finite number"
        if not self.least <= value <= self.most:
            unit = f" {self.unit}" if self.unit else ""
            return f"must be from {self.least:g}{unit} to {self.most:g}{unit}"
        return None


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One entry of the registry."""

    name: str
    label: str
    """What it is called in tables and on axes."""
    unit: str
    """Empty for a ratio and for yes (1) or no (0)."""
    text: str
    """One sentence: what is measured."""
    parameters: tuple[Parameter, ...]
    function: Callable[..., Measured]
    """(run, **parameters), each parameter with its default."""
    values: tuple[float, float]
    """Between which its values lie, both included: a limit that all of them keep, or none, asks for nothing."""
    of_trace: bool = True
    """Whether it is measured in the trace, so that there is none if the trace ends at the first event."""
    void: tuple[str, ...] = ()
    """Verdicts of the judge after which there is no figure."""
    yes_or_no: bool = False
    """Whether its values are 1 for yes and 0 for no."""

    def of(self, run: MeasureInput, given: tuple[tuple[str, float], ...] | Mapping[str, float] = ()) -> Measured:
        """The figure with the given parameters, or why there is none. A run that is too short to hold a figure, or
        that holds a value that is no number, has none.

        Raises ValueError, with all faults, if a parameter is not one of this measure's or is outside of its limits.
        """
        chosen = dict(given)
        faults = self.faults(chosen)
        if faults:
            raise ValueError(" ".join(faults))
        if self.of_trace and (len(run.trace.t_s) < 2 or run.first_row(run.first_s) + 2 > len(run.trace.t_s)):
            return not_known("the trace ends before the first event")
        if run.survival is not None and run.survival.status in self.void:
            return not_known(run.survival.reason or run.survival.status)
        found = self.function(run, **chosen)
        if found.value is not None and not math.isfinite(found.value):
            return not_known("the run diverged, so this figure is no number")
        return found

    def given(self, given: tuple[tuple[str, float], ...] = ()) -> dict[str, float]:
        """Its parameters with the given ones among them."""
        return {parameter.name: parameter.default for parameter in self.parameters} | dict(given)

    def limit_problem(self, *, at_least: float | None = None, at_most: float | None = None) -> str | None:
        """Why a limit means nothing for this measure, in words; None if it means something."""
        low, high = self.values
        if at_most is not None and self.yes_or_no:
            return "would ask that it is not so"
        unit = f" {self.unit}" if self.unit else ""
        if at_least is not None and not low < at_least <= high:
            return f"must be above {low:g}{unit} and at most {high:g}{unit}"
        if at_most is not None and not low <= at_most < high:
            return f"must be at least {low:g}{unit} and below {high:g}{unit}"
        return None

    def faults(self, given: Mapping[str, float]) -> list[str]:
        """What is wrong with given parameters, in words; empty if nothing is."""
        known = {parameter.name: parameter for parameter in self.parameters}
        faults = []
        for name, value in given.items():
            problem = known[name].problem(value) if name in known else None
            if name not in known:
                there = ", ".join(sorted(known)) or "none"
                faults.append(f"{self.name}: there is no parameter {name!r}. Its parameters: {there}.")
            elif problem is not None:
                faults.append(f"{self.name}: {name} = {value:g} {problem}.")
        return faults


_LIMITS = {"s": ("s", 1e-4, 60.0), "hz": ("Hz", 0.01, 50.0), "pu": ("pu", 1e-4, 0.2), "share": ("", 1e-3, 1.0)}
"""Unit, smallest and largest value of a parameter, by the end of its name. What is in pu is a band around a rest."""

_VALUES = {
    "": (-1.0, 1.0),
    "s": (0.0, 600.0),
    "ms": (0.0, 1e4),
    "Hz": (0.0, 1e3),
    "Hz/s": (0.0, 1e3),
    "dB": (-200.0, 200.0),
    "pu": (0.0, 10.0),
    "pu·s": (0.0, 1e3),
}
"""Between which the values of a measure lie, by its unit."""


def _parameter(name: str, default: float) -> Parameter:
    """A parameter with the limits of its unit, within which its default always is."""
    unit, least, most = _LIMITS[name.rpartition("_")[2]]
    return Parameter(name, default, unit, min(least, default), most if default <= most else 10.0)


def measure(
    label: str,
    unit: str,
    text: str,
    *,
    of_trace: bool = True,
    values: tuple[float, float] | None = None,
    void: tuple[str, ...] = (),
    yes_or_no: bool = False,
) -> Callable[[Callable[..., Measured]], Measure]:
    """Makes a registry entry of a function; its name and the defaults of its parameters are those of the function."""

    def made(function: Callable[..., Measured]) -> Measure:
        parameters = list(inspect.signature(function).parameters.values())[1:]
        return Measure(
            name=function.__name__,
            label=label,
            unit=unit,
            text=text,
            parameters=tuple(_parameter(p.name, p.default) for p in parameters),
            function=function,
            of_trace=of_trace,
            values=_VALUES[unit] if values is None else values,
            void=void,
            yes_or_no=yes_or_no,
        )

    return made
