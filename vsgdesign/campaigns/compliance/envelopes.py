"""Envelopes: two curves over time between which a signal of a test must stay.

The tunnel about the response of a source with inertia follows the procedure of RTE's tool DyCoV for its test IGFM1
(docs/theory/envelopes.md), written anew.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.measuring import MeasureInput, Parameter, Trace
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.metrics.step_response import cycle_mean

Array = NDArray[np.float64]

SLOW_S = 0.3
"""Time constant with which the tunnel opens, s."""
CLOSED_S = 0.02
"""For so long after the event the tunnel is closed, s."""


@dataclass(frozen=True, kw_only=True)
class Machine:
    """What a plant declares: inertia and damping behind a reactance, per unit of its rating."""

    H_s: float
    """Inertia constant, s."""
    D_pu: float
    """Damping: power over a difference of frequency, both per unit."""
    X_pu: float
    """Reactance from the source in the plant to the source of the grid."""
    omega_n: float
    """rad/s."""

    @property
    def damping_ratio(self) -> float:
        """ε of :eq:`swing`; at most 1 where the response swings."""
        return 0.5 * self.D_pu * math.sqrt(self.X_pu / (2.0 * self.H_s * self.omega_n))


def power_after_jump(t_s: Array, jump_rad: float, machine: Machine) -> Array:
    """Change of power at times (n,) after a jump of ``jump_rad`` between the sources, pu (:eq:`swing-response`).

    It is P_peak = jump/X at the jump and decays. Before the jump it is zero.
    """
    m = machine
    omega = math.sqrt(m.omega_n / (2.0 * m.H_s * m.X_pu))
    sigma = m.damping_ratio * omega
    t = np.maximum(t_s, 0.0)
    # σ ± √(σ² − ω²) are the decay rates, or a pair of complex ones: one expression serves both.
    rate = np.sqrt(complex(sigma**2 - omega**2))
    if abs(rate) < 1e-9 * omega:
        shape = (1.0 + sigma * t) * np.exp(-sigma * t)
    else:
        fast, slow = sigma + rate, sigma - rate
        shape = ((fast * np.exp(-slow * t) - slow * np.exp(-fast * t)) / (fast - slow)).real
    return np.where(t_s >= 0.0, jump_rad / m.X_pu * shape, 0.0)


@dataclass(frozen=True, kw_only=True)
class Margins:
    """How far a response may be from that of the declared machine."""

    variation: float = 0.1
    """Share by which H and D are varied together, both ways."""
    above: float = 0.5
    below: float = 0.5
    """Shares of the response by which it may be larger and smaller."""
    tunnel_share: float = 0.05
    """Of P_peak; the tunnel is at least ``tunnel_pu`` wide, to either side."""
    tunnel_pu: float = 0.02
    delay_s: float = 0.01
    """For so long the smaller response need not begin."""


def change_curves(t_s: Array, jump_rad: float, machine: Machine, margins: Margins) -> tuple[Array, Array]:
    """Least and largest change of power at times (n,) after a jump of ``jump_rad`` > 0, pu (:eq:`swing-curves`)."""
    nominal = power_after_jump(t_s, jump_rad, machine)
    peak = jump_rad / machine.X_pu
    curves = [nominal]
    for factor in (1.0 - margins.variation, 1.0 + margins.variation):
        varied = replace(machine, H_s=factor * machine.H_s, D_pu=factor * machine.D_pu)
        curves.append(power_after_jump(t_s, jump_rad, varied))
    late = t_s - margins.delay_s
    if machine.damping_ratio > 1.0:
        curves.append((1.0 + margins.above) * nominal)
        curves.append((1.0 - margins.below) * power_after_jump(late, jump_rad, machine))
    else:
        decay = np.exp(-machine.D_pu / (4.0 * machine.H_s) * np.maximum(late, 0.0)) * peak
        curves.append((1.0 + margins.above) * decay)
        curves.append(np.where(late >= 0.0, (1.0 - margins.below) * decay, 0.0))
    tunnel = tunnel_width(peak, margins) * np.maximum(1.0 - np.exp((CLOSED_S - t_s) / SLOW_S), 0.0)
    return np.min(curves, axis=0) - tunnel, np.max(curves, axis=0) + tunnel


def tunnel_width(peak_pu: float, margins: Margins) -> float:
    """Half of the tunnel's width at the end, pu (:eq:`swing-tunnel`)."""
    return max(margins.tunnel_pu, margins.tunnel_share * peak_pu)


def power_curves(
    t_s: Array, jump_rad: float, P_pu: float, P_max_pu: float, machine: Machine, margins: Margins
) -> tuple[Array, Array]:
    """Least and largest power at times (n,) after the grid's phase has jumped by ``jump_rad``, pu.

    A positive jump takes power away. The curve that asks for power stops at 1 pu less the tunnel, and the one that
    allows it at ``P_max_pu`` (:eq:`swing-limits`).
    """
    sign = math.copysign(1.0, jump_rad)
    least, largest = (P_pu - sign * change for change in change_curves(t_s, abs(jump_rad), machine, margins))
    asked = 1.0 - tunnel_width(abs(jump_rad) / machine.X_pu, margins)
    bounds = (asked, P_max_pu) if P_pu * sign < 0.0 else (P_max_pu, asked)
    one, other = (np.clip(curve, -most, most) for curve, most in zip((least, largest), bounds, strict=True))
    return np.minimum(one, other), np.maximum(one, other)


ROUNDING_PU = 1e-9
"""Largest excess that is rounding."""


class Bounds(NamedTuple):
    """An envelope on the instants of a trace: arrays (n,), in the unit of the signal."""

    signal: str
    """Name of the field of :class:`Trace` that it bounds."""
    t_s: Array
    low: Array
    """-inf where nothing is asked."""
    high: Array
    """inf where nothing is asked."""
    rows_of_mean: int = 1
    """The signal is compared as its mean over so many rows of the trace, of which the last is at the instant."""
    why: str = ""
    """Why there is no envelope; empty if there is one. The curves are then infinite."""

    def excess(self, trace: Trace) -> float:
        """By how much the signal leaves the envelope at most; 0 inside, NaN if the signal holds NaN.

        The trace has all rows of the one for which the envelope was computed. What is less than ROUNDING_PU is inside.
        """
        values = cycle_mean(np.asarray(getattr(trace, self.signal)), self.rows_of_mean)
        beyond = np.maximum(np.maximum(self.low - values, values - self.high), 0.0)
        most = float(np.max(beyond)) if beyond.size else 0.0
        return 0.0 if most < ROUNDING_PU else most


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


_LIMITS = {
    "low_pu": ("pu", -10.0, 10.0),
    "high_pu": ("pu", -10.0, 10.0),
    "from_s": ("s", 0.0, 600.0),
    "to_s": ("s", 0.0, 600.0),
    "H_s": ("s", 1e-3, 1e3),
    "D_pu": ("pu", 0.0, 1e5),
    "X_eff_pu": ("pu", 0.0, 10.0),
    "P_max_pu": ("pu", 0.1, 10.0),
    "above_pu": ("pu", 0.0, 10.0),
    "below_pu": ("pu", 0.0, 1.0),
}
"""Unit, smallest and largest value of each parameter."""


def envelope(label: str, text: str) -> Callable[[Callable[..., Bounds]], Envelope]:
    """Makes a registry entry of a function; its name and the defaults of its parameters are those of the function."""

    def made(function: Callable[..., Bounds]) -> Envelope:
        parameters = list(inspect.signature(function).parameters.values())[1:]
        return Envelope(
            name=function.__name__,
            label=label,
            text=text,
            parameters=tuple(Parameter(p.name, p.default, *_LIMITS[p.name]) for p in parameters),
            function=function,
        )

    return made


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


HELD_S = 0.02
"""For so long after a phase jump the curves stay as they are at the jump: no plant acts at once."""


@envelope(
    "power after a phase jump",
    "The one-cycle mean of the active power stays between the curves that RTE's DyCoV draws about the response of a "
    "source with the declared inertia and damping behind the declared reactance.",
)
def swing_after_jump(
    run: MeasureInput,
    H_s: float = math.nan,
    D_pu: float = math.nan,
    X_eff_pu: float = math.nan,
    P_max_pu: float = math.nan,
    above_pu: float = 0.5,
    below_pu: float = 0.5,
) -> Bounds:
    """P after the first phase jump (:eq:`swing-limits`). What is not given follows from the converter: H and D from its
    gains (:eq:`declared-machine`), X_eff from its filter, P_max from its current limit."""
    t = run.trace.t_s
    free = np.full(len(t), np.inf)
    found = run.event_with(lambda event: event.phase_deg != 0.0)
    if found is None:
        return Bounds("P_pu", t, -free, free, why="the test has no phase jump")
    if run.gains is None and (math.isnan(H_s) or math.isnan(D_pu)):
        return Bounds("P_pu", t, -free, free, why="the gains are not known, and H and D are not declared")
    event, next_s = found
    omega_n = 2.0 * math.pi * run.ratings.f_n_hz
    X_eff = run.ratings.X_2_pu if math.isnan(X_eff_pu) else X_eff_pu
    X = X_eff + run.test.x_over_r / math.hypot(1.0, run.test.x_over_r) / run.test.scr
    H, D = H_s, D_pu
    if run.gains is not None:
        own = declared_machine(run.gains, run.ratings.S_rated, X, omega_n)
        H, D = (own.H_s if math.isnan(H) else H), (own.D_pu if math.isnan(D) else D)
    most = P_max_pu if not math.isnan(P_max_pu) else (run.ratings.i_limit_pu or math.inf)
    machine = Machine(H_s=H, D_pu=D, X_pu=X, omega_n=omega_n)
    # The signal is a mean over the cycle before, and the curves are held: both wait for the first cycle.
    since = np.maximum(t - event.t_s - HELD_S, 0.0)
    before = run.rest_before(run.trace.P_pu, event.t_s)
    margins = Margins(above=above_pu, below=below_pu)
    low, high = power_curves(since, math.radians(event.phase_deg), before, most, machine, margins)
    asked = (t >= event.t_s) & (t < next_s)
    return Bounds(
        "P_pu", t, np.where(asked, low, -np.inf), np.where(asked, high, np.inf), rows_of_mean=run.rows_per_cycle
    )


def declared_machine(gains: PowerLoopGains, S_rated: float, X_pu: float, omega_n: float) -> Machine:
    """The machine whose swing has the poles of the power loops behind ``X_pu`` (:eq:`declared-machine`).

    ``gains`` in SI, ``S_rated`` in VA. The coupling of P and Q is neglected.
    """
    H = omega_n / (2.0 * gains.K_ip * S_rated)
    droop = gains.D_p * omega_n / S_rated
    return Machine(H_s=H, D_pu=droop + 2.0 * H * gains.k_P * S_rated / X_pu, X_pu=X_pu, omega_n=omega_n)


ENVELOPES: Mapping[str, Envelope] = MappingProxyType({found.name: found for found in (power_band, swing_after_jump)})
"""By name."""
