"""A battery directly on the link: an open-circuit voltage that follows the charge, behind a resistance."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.dc_source_interface import (
    ROOM,
    DcFlow,
    DcParameter,
    DcRatings,
    DcSource,
    DcSourceLaw,
    Decay,
    SourceLeft,
    SourceLimits,
    chosen_decay,
)

POINTS = 6
"""Points of the open-circuit voltage over the charge, evenly spaced from empty to full."""


_NEVER = 1e3
"""Times V_dc: no voltage of a link."""


class OpenVoltage(NamedTuple):
    """Open-circuit voltage over the state of charge, V: a straight line from the first point on, and by how much the
    slope changes at each of the points between the ends."""

    v_0: Any
    slope: Any
    bend_1: Any
    bend_2: Any
    bend_3: Any
    bend_4: Any


class BatteryConstants(NamedTuple):
    """Constants of a battery."""

    open: OpenVoltage
    over_R: Any
    """1/R_i, S."""
    i_max: Any
    i_min: Any
    """Limits of the current: when it gives, and (negative) when it takes, A."""
    coulombs: Any
    """Capacity, As."""
    V_low: Any
    V_high: Any
    """Limits of the link's voltage, V."""
    per_ampere: Any
    """Change of the state of charge in one interval per ampere that it gives."""
    held: Decay
    """While the voltage decides."""
    free: Decay
    """While a limit of the current decides."""


class BatteryNotes(NamedTuple):
    """Its current in an interval: current − conductance·v."""

    current: Any
    conductance: Any


class BatteryMemory(NamedTuple):
    """What it remembers."""

    charge: Any
    """State of charge, 0 to 1."""


def open_voltage(charge: Any, c: OpenVoltage) -> Any:
    """Open-circuit voltage, V, at a state of charge (:eq:`dc-battery`)."""
    return (
        c.v_0
        + c.slope * charge
        + c.bend_1 * np.maximum(charge - 0.2, 0.0)
        + c.bend_2 * np.maximum(charge - 0.4, 0.0)
        + c.bend_3 * np.maximum(charge - 0.6, 0.0)
        + c.bend_4 * np.maximum(charge - 0.8, 0.0)
    )


def battery_flow(memory: BatteryMemory, v: Any, p: Any, c: BatteryConstants) -> DcFlow:
    """The current of a battery (:eq:`dc-battery`): that of its resistance, or that of a limit. An empty battery does
    not give, and a full one does not take. Its open-circuit voltage follows the charge on a straight line."""
    ahead = memory.charge + 0.5 * c.per_ampere * (open_voltage(memory.charge, c.open) - v) * c.over_R
    v_open = open_voltage(ahead, c.open)
    wanted = (v_open - v) * c.over_R
    most = np.where(memory.charge > 0.0, c.i_max, 0.0)
    least = np.where(memory.charge < 1.0, c.i_min, 0.0)
    current = np.minimum(np.maximum(wanted, least), most)
    limited = 1.0 * (current < wanted) + 1.0 * (current > wanted)
    constant = np.where(limited > 0.5, current, v_open * c.over_R)
    return DcFlow(
        current=constant,
        slope=0.0,
        second=0.0,
        p_begin=0.0,
        p_middle=0.0,
        p_end=0.0,
        tilt=np.where(limited > 0.5, 0.0, 2.0 * (v_open - open_voltage(memory.charge, c.open)) * c.over_R),
        decay=chosen_decay(limited, c.free, c.held),
        notes=BatteryNotes(constant, np.where(limited > 0.5, 0.0, c.over_R)),
    )


def battery_remembers(
    memory: BatteryMemory, flow: DcFlow, v_0: Any, v_1: Any, mean: Any, p: Any, c: BatteryConstants
) -> BatteryMemory:
    """The charge falls with the current that it gives."""
    given = flow.notes.current - flow.notes.conductance * mean
    return BatteryMemory(charge=memory.charge + c.per_ampere * given)


def battery_can_give(memory: BatteryMemory, hold: Any, c: BatteryConstants) -> SourceLimits:
    """What a battery can give (:eq:`dc-battery-limits`): its limits of current, as far as the charge lasts and the
    voltage of the link stays within its limits."""
    v_open = open_voltage(memory.charge, c.open)
    lasts = np.maximum(memory.charge, 0.0) * c.coulombs / hold
    within = np.maximum(np.minimum(ROOM * (v_open - c.V_low), 0.5 * ROOM * v_open) * c.over_R, 0.0)
    most = np.minimum(np.minimum(c.i_max, lasts), within)
    room = np.maximum(1.0 - memory.charge, 0.0) * c.coulombs / hold
    above = np.maximum(ROOM * (c.V_high - v_open) * c.over_R, 0.0)
    least = np.maximum(np.maximum(c.i_min, -room), -above)
    return SourceLimits(low=least * (v_open - least / c.over_R), high=most * (v_open - most / c.over_R))


def battery_left(memory: BatteryMemory, v: Any, p: Any, c: BatteryConstants) -> SourceLeft:
    """What a battery could still give and take: its charge and the room beside it, at the present open-circuit
    voltage; nothing where a limit of its current holds it back."""
    v_open = open_voltage(memory.charge, c.open)
    wanted, whole = (v_open - v) * c.over_R, c.coulombs * v_open
    return SourceLeft(
        give=np.where(wanted >= c.i_max, 0.0, np.maximum(memory.charge, 0.0) * whole),
        take=np.where(wanted <= c.i_min, 0.0, np.maximum(1.0 - memory.charge, 0.0) * whole),
    )


def battery_constants(ratings: DcRatings, values: Mapping[str, Any]) -> BatteryConstants:
    """From the parameters of a study."""
    points = values["open_circuit"]
    slopes = [(b - a) * (POINTS - 1) for a, b in itertools.pairwise(points)]
    bends = [after - before for before, after in itertools.pairwise(slopes)]
    return BatteryConstants(
        open=OpenVoltage(points[0], slopes[0], *bends),
        over_R=1.0 / values["R_i"],
        i_max=values["i_max"],
        i_min=-values["i_charge_max"],
        coulombs=3600.0 * values["capacity_Ah"],
        V_low=ratings.V_low,
        V_high=min(ratings.V_high, _NEVER * ratings.V_dc),
        per_ampere=-ratings.T_s / (3600.0 * values["capacity_Ah"]),
        held=ratings.decay(1.0 / values["R_i"]),
        free=ratings.decay(0.0),
    )


def battery_holds(p: Any, charge: Any, bleed: Any, c: BatteryConstants) -> tuple[Any, Any]:
    """A battery at rest (:eq:`dc-battery-rest`). Returns (v, possible): the link's voltage, V, the upper one of two,
    and whether the limits of the current allow it, 1 or 0."""
    e = open_voltage(charge, c.open)
    # v (e − v)/R = p + g v²
    a, b = c.over_R + bleed, e * c.over_R
    root = b * b - 4.0 * a * p
    v = (b + np.sqrt(np.maximum(root, 0.0))) / (2.0 * a)
    current = (e - v) * c.over_R
    low = np.where(charge < 1.0, c.i_min, 0.0)
    high = np.where(charge > 0.0, c.i_max, 0.0)
    rounding = 1e-12 * v * c.over_R
    within = 1.0 * (root >= 0.0) * (current >= low - rounding) * (current <= high + rounding)
    return v, within


def battery_rest(
    p: float, ratings: DcRatings, c: BatteryConstants, values: Mapping[str, Any]
) -> tuple[float, BatteryMemory]:
    """The link's voltage at a power (:func:`battery_holds`)."""
    charge, g = values["charge"], 1.0 / ratings.R_bleed
    v, possible = battery_holds(p, charge, g, c)
    if possible:
        return float(v), BatteryMemory(charge=charge)
    e = float(open_voltage(charge, c.open))
    a, b = c.over_R + g, e * c.over_R
    if b * b - 4.0 * a * p < 0.0:
        raise ValueError(f"a battery of {e:.5g} V and {1e3 / c.over_R:.4g} mΩ gives at most {b * b / (4.0 * a):.4g} W")
    low = c.i_min if charge < 1.0 else 0.0
    high = c.i_max if charge > 0.0 else 0.0
    raise ValueError(
        f"a battery at {100.0 * charge:.3g} % of its charge would give {(e - v) * c.over_R:.4g} A, and its limits are "
        f"{low:.4g} to {high:.4g} A"
    )


def _check(ratings: DcRatings, values: Mapping[str, Any]) -> Mapping[str, str]:
    points = values["open_circuit"]
    if len(points) != POINTS:
        return {"open_circuit": f"must have {POINTS} voltages: at 0, 20, 40, 60, 80 and 100 % of the charge"}
    if any(after < before for before, after in itertools.pairwise(points)):
        return {"open_circuit": "must not fall with the charge"}
    if max(points) < ratings.V_needed:
        least = f"{ratings.V_needed:.5g} V for the rated voltage: take more cells in series, or a stage in between"
        return {"open_circuit": f"is at most {max(points):.5g} V, and the bridge needs {least}"}
    return {}


_PARAMETERS = (
    DcParameter(
        "open_circuit",
        "V",
        1.0,
        1e6,
        "open-circuit voltage at 0, 20, 40, 60, 80 and 100 % of the charge",
        shown="`V_dc`, from 94 to 106 %",
        default=lambda ratings, _: tuple(ratings.V_dc * (0.94 + 0.024 * k) for k in range(POINTS)),
    ),
    DcParameter("R_i", "ohm", 1e-6, 1e4, "inner resistance"),
    DcParameter("i_max", "A", 1e-3, 1e6, "largest current that it gives"),
    DcParameter(
        "i_charge_max",
        "A",
        0.0,
        1e6,
        "largest current that it takes",
        shown="`i_max`",
        default=lambda _, known: known["i_max"],
    ),
    DcParameter("capacity_Ah", "1", 1e-4, 1e6, "capacity, Ah"),
    DcParameter("charge", "1", 0.0, 1.0, "state of charge at the start", default=0.6),
)

BATTERY = DcSource(
    "battery",
    DcSourceLaw(battery_flow, battery_remembers, battery_can_give),
    battery_constants,
    battery_rest,
    battery_holds,
    _PARAMETERS,
    _check,
    lost=("i_max", "i_charge_max"),
    recharged=lambda charge, _: {"charge": charge},
    left=battery_left,
)
"""A battery without a dc–dc stage."""
