"""Whether a test applies to a converter and its controller, and what no converter of a current and voltage can do."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from vsgdesign.campaigns.compliance.case import Subject
from vsgdesign.campaigns.compliance.measures import MEASURES
from vsgdesign.campaigns.compliance.suite import SuiteTest
from vsgdesign.metrics.survival import NOT_AT_REST
from vsgdesign.simulation.survival.verdicts import ISLAND_F
from vsgdesign.study.parameters.dc_link import not_of
from vsgdesign.study.parameters.grid import Network, Place
from vsgdesign.study.parameters.study import Study


def _of_frequency(f_hz: float) -> Callable[[Subject], str | None]:
    def missing(subject: Subject) -> str | None:
        nominal = subject.study.converter.omega_n / (2.0 * math.pi)
        if abs(nominal - f_hz) < 0.5:
            return None
        return f"the test is for a grid of {f_hz:g} Hz, and the converter is made for {nominal:.4g} Hz"

    return missing


def _limit(subject: Subject) -> str | None:
    return "the controller has no current limit" if math.isinf(subject.limit_pu) else None


def _schedule(subject: Subject) -> str | None:
    return (
        "the controller has fixed gains, and no schedule that could be late" if subject.spec.kind == "fixed" else None
    )


def _storage(_subject: Subject) -> str | None:
    """The dc link is ideal: it gives and takes what the test asks, and the energy is a measure of the row."""
    return None


NEEDS: Mapping[str, Callable[[Subject], str | None]] = MappingProxyType(
    {
        "50 Hz": _of_frequency(50.0),
        "60 Hz": _of_frequency(60.0),
        "current limit": _limit,
        "schedule": _schedule,
        "storage": _storage,
    }
)
"""What a test may need. Each function says why the need is not met, or None."""


def not_applicable(subject: Subject, test: SuiteTest) -> str | None:
    """Why a test does not apply to a controller; None if it does.

    Raises ValueError for a need that is not in NEEDS.
    """
    unknown = [name for name in test.needs if name not in NEEDS]
    if unknown:
        raise ValueError(f"needs = {', '.join(unknown)}: there are {', '.join(NEEDS)}.")
    missing = [why for name in test.needs if (why := NEEDS[name](subject)) is not None]
    changed = dict.fromkeys(name for event in test.events for name in event.of_dc)
    missing += [why for name in changed if (why := not_of(subject.study.dc, name)) is not None]
    return "; ".join(missing) or None


BACK = "P_back_s"
"""The measure that asks for the power of before: no converter has it again where the grid no longer carries it."""

AT_REST = ("survived", *(name for name, one in MEASURES.items() if NOT_AT_REST in one.void))
"""Measures that ask for a rest: there is none on an island whose load is too large."""


class _State(NamedTuple):
    """What a test asks for before its first event, or after its last one."""

    place: Place
    V_g_pu: float
    df_hz: float
    P_pu: float
    network: Network
    distorted: bool


def impossible(study: Study, test: SuiteTest) -> str | None:
    """Why no converter of this current can do what a test asks for; None if one could.

    It must be at rest before the test. After it, a converter may hold at its limit on a grid that does not carry P_ref,
    and survive; so the power after the test counts only where the power of before is asked for (BACK). An island whose
    load is too large leaves no converter a voltage, where a rest is asked for (AT_REST).

    ``study`` has the current limit of the controller. The power that a grid carries is bounded by the current alone and
    by the voltage alone, both with the best angle and any reactive power (:eq:`largest-power`). The current into the
    grid may be larger than that of the converter by the current of the filter capacitor. Only a test at nominal
    frequency is said to be impossible for its power, since at any other frequency a droop may ask for less.
    """
    limit_pu = study.converter.current_limit_pu
    if limit_pu is None:
        return None
    before, after = _states(test)
    why = _too_much(study, before, before.P_pu, limit_pu)
    if why is not None:
        return f"Before the test P_ref = {before.P_pu:.4g} pu is asked for, and {why}"
    judged = [one for one in test.criteria if not one.informational]
    if not after.network.connected and any(one.measure in AT_REST for one in judged):
        why = _overloaded_island(study, after, limit_pu)
    elif before.network.plain and before.df_hz == 0.0:
        for one in judged:
            band = MEASURES[BACK].given(one.given)["band_pu"] if one.measure == BACK else math.inf
            if why is None and abs(before.P_pu) > band:
                needed = math.copysign(abs(before.P_pu) - band, before.P_pu)
                why = _too_much(study, after, needed, limit_pu)
                why = why and f"P is to be back at {needed:.4g} pu or more, and {why}"
    return why and f"After the test {why}"


def largest_power(V_g: float, R: float, X: float, current: float, V_max: float) -> tuple[float, str]:
    """The largest active power that a converter can send into a grid, per unit, and its arithmetic in words.

    R + jX leads from the converter's voltage to the source V_g. The current is at most ``current`` and the voltage at
    most V_max. P = V_g·Re(i) + R|i|² is convex in i, so its maximum over both discs lies on their edges
    (:eq:`largest-power`).
    """
    Z = math.hypot(R, X)
    at_unity = math.hypot(V_g + R * current, X * current)
    if at_unity <= V_max:
        P = V_g * current + R * current**2
        return P, f"V_g·I + R·I² = {V_g:.4g}·{current:.4g} + {R:.4g}·{current:.4g}² = {P:.4g} pu"
    by_voltage = V_max * V_max * R / Z**2 + V_max * V_g / Z
    # The angle of the largest power at V_max: the current there is (V_max·e^{jδ} − V_g)/Z.
    delta = math.pi - math.atan2(X, R)
    if abs(complex(V_max * math.cos(delta) - V_g, V_max * math.sin(delta))) / Z <= current:
        words = (
            f"V²·R/Z² + V·V_g/Z = {V_max:.4g}²·{R:.4g}/{Z:.4g}² + {V_max:.4g}·{V_g:.4g}/{Z:.4g} = {by_voltage:.4g} pu"
        )
        return by_voltage, words
    # Both are at their limits: |V_g + Z·i| = V_max and |i| = current.
    share = (V_max**2 - V_g**2 - (Z * current) ** 2) / (2.0 * V_g * Z * current) if V_g > 0.0 else 1.0
    theta, turn = math.atan2(X, R), math.acos(min(max(share, -1.0), 1.0))
    cosine = max(math.cos(theta - turn), math.cos(theta + turn))
    P = V_g * current * cosine + R * current**2
    words = f"V_g·I·cos φ + R·I² = {V_g:.4g}·{current:.4g}·{cosine:.4g} + {R:.4g}·{current:.4g}² = {P:.4g} pu"
    return P, words


def _states(test: SuiteTest) -> tuple[_State, _State]:
    before = _State(
        place=test.place,
        V_g_pu=test.V_g_pu,
        df_hz=test.df_hz,
        P_pu=test.P_pu,
        network=Network(load=test.load),
        distorted=False,
    )
    after = before
    for event in test.events:
        after = after._replace(
            place=event.place or after.place,
            V_g_pu=after.V_g_pu if event.V_g_rms is None else event.V_g_rms,
            df_hz=after.df_hz if event.df_hz is None else event.df_hz,
            P_pu=after.P_pu if event.P_ref is None else event.P_ref,
            network=event.switched.on(after.network),
            distorted=event.sag is not None or (after.distorted and event.V_g_rms is None),
        )
    return before, after


def _too_much(study: Study, state: _State, P_pu: float, limit_pu: float) -> str | None:
    """A power against what the grid carries with this current."""
    if not state.network.plain or state.distorted or state.df_hz != 0.0:
        return None
    c, f = study.converter, study.filter
    grid = state.place.grid(c)
    R, X = ((part / c.Z_base) for part in study.path_to_grid(grid, c.omega_n))
    B = c.omega_n * f.C * c.Z_base
    current = limit_pu + B * c.V_max_pu
    if P_pu > 0.0:
        most, words = largest_power(state.V_g_pu, R, X, current, c.V_max_pu)
    else:
        most, words = _largest_taken(state.V_g_pu, R, current)
    if abs(P_pu) <= most:
        return None
    place = f"SCR {state.place.scr:.4g}, X/R {state.place.x_over_r:.4g} and V_g = {state.V_g_pu:.4g} pu"
    of_both = f"{limit_pu:.4g} pu of the converter and {B * c.V_max_pu:.3g} pu of the filter capacitor"
    return (
        f"at {place} no converter with I = {current:.4g} pu ({of_both}) and at most {c.V_max_pu:.4g} pu voltage "
        f"carries more than {words}."
    )


def _largest_taken(V_g: float, R: float, current: float) -> tuple[float, str]:
    """The largest active power that a converter can take from a grid, per unit, and its arithmetic in words."""
    i = min(current, V_g / (2.0 * R)) if R > 0.0 else current
    P = V_g * i - R * i**2
    return P, f"V_g·I − R·I² = {V_g:.4g}·{i:.4g} − {R:.4g}·{i:.4g}² = {P:.4g} pu"


_EXACT = 1.02
"""A current is too large from this share of the limit on, because no limiter is exact."""


def _overloaded_island(study: Study, state: _State, limit_pu: float) -> str | None:
    """The least current of an island's load against that of the converter: with the least voltage and at the frequency,
    among those that the judge allows, that need the least (:eq:`island-current`)."""
    load = state.network.load
    if load is None or state.network.fault is not None:
        return None
    c, f = study.converter, study.filter
    of_load = load.in_si(c.Z_base, c.omega_n)

    def admittances(share: float) -> tuple[complex, complex]:
        """Of the load behind the second inductor and of the capacitor, pu, at a share of the nominal frequency."""
        s = 1j * share * c.omega_n
        Y = of_load.admittance(share * c.omega_n)
        return Y / (1.0 + (f.R_2 + s * f.L_2) * Y) * c.Z_base, s * f.C / (1.0 + s * f.C * f.R_c) * c.Z_base

    def current(share: float) -> float:
        return abs(sum(admittances(share))) * c.V_min_pu

    best = _least_at(current, 1.0 - ISLAND_F, 1.0 + ISLAND_F, enough=_EXACT * limit_pu)
    needed, f_n_hz = current(best), c.omega_n / (2.0 * math.pi)
    if needed <= _EXACT * limit_pu:
        return None
    Y, of_capacitor = (
        f"({one.real:.4g} {'−' if one.imag < 0.0 else '+'} j{abs(one.imag):.4g})" for one in admittances(best)
    )
    return (
        f"the island's load takes {needed:.4g} pu of current or more: {c.V_min_pu:.4g}·|{Y} + {of_capacitor}| at the "
        f"least voltage that the study allows and at {best * f_n_hz:.4g} Hz, where it is least from "
        f"{(1.0 - ISLAND_F) * f_n_hz:.4g} to {(1.0 + ISLAND_F) * f_n_hz:.4g} Hz. The first admittance is that of the "
        f"load behind the filter's second inductor, the other one that of the filter's capacitor. The converter gives "
        f"{limit_pu:.4g} pu."
    )


def _least_at(function: Callable[[float], float], low: float, high: float, enough: float) -> float:
    """Where a function is least between two numbers, or where it is at most ``enough``."""
    at = np.linspace(low, high, 121).tolist()
    values = [function(one) for one in at]
    k = int(np.argmin(values))
    if values[k] <= enough:
        return at[k]
    from scipy.optimize import minimize_scalar

    bounds = at[max(k - 1, 0)], at[min(k + 1, len(at) - 1)]
    inside = float(minimize_scalar(function, bounds=bounds, method="bounded", options={"xatol": 1e-9}).x)
    return min((inside, at[k]), key=function)
