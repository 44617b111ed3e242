"""Kinds of converters that stand in a plant beside its units, by their names in a study.

A kind says how its controller samples, as a function of the restricted language, and which numbers a study gives it.
The loop, the power flow and the full-order model of a plant read this object and nothing else of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.grid_following import FollowingSettings, FollowingState, SetPoints, follow_sample
from vsgdesign.equations.integration import low_pass_share
from vsgdesign.equations.registry import Registry
from vsgdesign.study.parameters.converter import Filter
from vsgdesign.study.parameters.fields import number, word

FOLLOWING = "grid_following"


class InverterRatings(NamedTuple):
    """What a kind computes its constants from, SI."""

    S_rated: float
    V_rated_pk: float
    I_rated_pk: float
    omega_n: float
    T_s: float
    delay_samples: int
    v_max_pk: float
    """Largest voltage of its bridge, V peak."""
    filter: Filter


class Phasors(NamedTuple):
    """An inverter in a steady state at the instant of a sample, peak, in a frame at nominal phase."""

    v: complex
    """At its capacitor."""
    i_s: complex
    i_g: complex
    u: complex
    """Mean voltage of its bridge."""
    omega: float
    """Frequency of the frame, rad/s."""


class Droop(NamedTuple):
    """What an inverter gives at rest: P, and Q + D_q (V_n − V) with the phase voltage V at its capacitor, rms."""

    P: float
    Q: float
    D_q: float = 0.0
    V_n: float = 1.0


@dataclass(frozen=True, kw_only=True)
class InverterKind:
    """A kind of converter beside the units of a plant."""

    name: str
    sample: Callable[..., Any]
    """``sample(state, measured, asked, settings)`` returns (following, said): the state of the next sample and a
    :class:`vsgdesign.equations.grid_following.ConverterOutput`. ``measured`` is a Measurement, ``asked`` are SetPoints.
    It must not depend on where the α axis points: turned measurements and angles give turned results."""
    state: type
    """NamedTuple of what it remembers."""
    settings: type
    """NamedTuple of its constants."""
    angles: tuple[str, ...] = ("theta",)
    """Those of the state that are angles against the α axis, rad."""
    pairs: tuple[tuple[str, str], ...] = ()
    """Those of the state that are αβ components."""
    at_rest: Callable[[Phasors, Any], Any]
    """A state near that of a steady state, from the phasors and the constants; Newton's method finds the exact one."""
    flow: Callable[[SetPoints, float, Any], Droop] | None = None
    """What it gives at rest, from its set points, the frequency (rad/s) and its constants; None: its set points."""
    fields: Any = ()
    """The class with the fields that a study gives it."""
    build: Callable[[InverterRatings, Mapping[str, Any]], Any]
    """Its constants from its ratings and its fields by attribute."""

    def rest(self, asked: SetPoints, omega: float, settings: Any) -> Droop:
        """What it gives at rest at a frequency (rad/s)."""
        return Droop(*asked) if self.flow is None else self.flow(asked, omega, settings)


class InverterKinds(Registry[InverterKind]):
    """Kinds of inverters by their names, known to everything that reads or runs plants."""

    what = "kind of inverter"


POWER, CURRENT = "power", "current"


class FollowingFields:
    """The fields of an inverter that follows the voltage at its filter."""

    pll_bandwidth: float = number("Hz", 0.1, 1e3, default=30.0)
    """Natural frequency of the phase-locked loop."""
    pll_damping: float = number("1", 0.1, 5.0, default=0.707)
    """Damping ratio of the phase-locked loop."""
    current_bandwidth: float | None = number(
        "Hz", 1.0, 1e5, default=None, shown="500 Hz, at most 4 % of the sampling frequency"
    )
    """Bandwidth of the current loop."""
    feedforward_time: float = number("s", 0.0, 1.0, default=2e-4)
    """Time constant of the low-pass of the voltage that the current loop adds."""
    keeps: str = word((POWER, CURRENT), default=POWER)
    """What it keeps when the voltage changes: its powers, or the currents that give them at rated voltage."""
    voltage_filter: float = number("s", 0.0, 1.0, default=2e-3)
    """Time constant of the low-pass of the voltage by which the powers are divided."""
    current_limit_pu: float = number("1", 0.1, 10.0, default=1.2)
    """Limit of its current reference, pu of its rated peak."""


_LEAST_VOLTAGE = 0.1
"""Share of the nominal voltage below which an inverter's references no longer rise."""


def following_settings(ratings: InverterRatings, given: Mapping[str, Any]) -> FollowingSettings:
    """Constants of a converter that follows, from its fields by attribute."""
    f, T_s, omega = ratings.filter, ratings.T_s, ratings.omega_n
    asked = given["current_bandwidth"]
    bandwidth = 2.0 * math.pi * (min(500.0, 0.04 / T_s) if asked is None else asked)
    natural = 2.0 * math.pi * given["pll_bandwidth"]
    K_pc = bandwidth * f.L_1
    return FollowingSettings(
        T_s=T_s,
        omega_0=omega,
        V_nominal=ratings.V_rated_pk,
        V_least=_LEAST_VOLTAGE * ratings.V_rated_pk,
        K_pll=2.0 * given["pll_damping"] * natural,
        K_slip=natural * natural,
        K_pc=K_pc,
        K_ic=0.1 * bandwidth * K_pc,
        omega_L=omega * f.L_1,
        omega_C=omega * f.C,
        smoothing_v=low_pass_share(given["feedforward_time"], T_s),
        smoothing_V=low_pass_share(given["voltage_filter"], T_s),
        by_power=1.0 if given["keeps"] == POWER else 0.0,
        i_max_pk=given["current_limit_pu"] * ratings.I_rated_pk,
        v_max_pk=ratings.v_max_pk,
        lead=(ratings.delay_samples + 0.5) * T_s,
    )


def following_at_rest(at: Phasors, settings: FollowingSettings) -> FollowingState:
    """The state of a converter that follows, near a steady state."""
    back = np.exp(-1j * np.angle(at.v))
    xi = complex((at.u - at.v) * back - 1j * settings.omega_L * at.i_s * back)
    return FollowingState(
        theta=float(np.angle(at.v)),
        slip=at.omega - settings.omega_0,
        v_d=abs(at.v),
        v_q=0.0,
        V=abs(at.v),
        xi_d=xi.real,
        xi_q=xi.imag,
    )


GRID_FOLLOWING = InverterKind(
    name=FOLLOWING,
    sample=follow_sample,
    state=FollowingState,
    settings=FollowingSettings,
    at_rest=following_at_rest,
    fields=FollowingFields,
    build=following_settings,
)

INVERTER_KINDS = InverterKinds((GRID_FOLLOWING,))
"""Every kind that a study may name."""
