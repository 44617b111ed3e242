"""A photovoltaic array directly on the link, by the single-diode equation."""

from __future__ import annotations

import math
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
)

_FLAT, _CLOSE = -1e-9, 1e-10
"""The least slope with which a step is made, and by how much the power of a rest may be wrong, as shares of the power
over the voltage and of the power."""


class ArrayConstants(NamedTuple):
    """The single diode of a whole array (:eq:`dc-diode`)."""

    I_L: Any
    """Photocurrent, A."""
    I_0: Any
    """Saturation current, A."""
    over_a: Any
    """1/(n N_s V_t), 1/V."""
    R_s: Any
    over_R_sh: Any
    p_most: Any
    """Largest power that it can give for long, W."""
    decay: Decay


class ArrayNotes(NamedTuple):
    """Voltage of the diode at a sample, V, and its change over that of the link."""

    u: Any
    per_volt: Any


class ArrayMemory(NamedTuple):
    """What is kept of an array."""

    u: Any
    """Voltage of the diode, V: where the search for the next one begins."""


def diode_current(u: Any, c: ArrayConstants) -> Any:
    """Current of the array at a voltage of its diode, A (:eq:`dc-diode`)."""
    return c.I_L - c.I_0 * (np.exp(u * c.over_a) - 1.0) - u * c.over_R_sh


def diode_voltage(u: Any, v: Any, c: ArrayConstants) -> Any:
    """One step of Newton's method towards the diode's voltage at a voltage of the array, V."""
    knee = c.I_0 * np.exp(u * c.over_a)
    current = c.I_L - knee + c.I_0 - u * c.over_R_sh
    return u - (u - c.R_s * current - v) / (1.0 + c.R_s * (knee * c.over_a + c.over_R_sh))


def array_flow(memory: ArrayMemory, v: Any, p: Any, c: ArrayConstants) -> DcFlow:
    """The current of an array near a voltage: its curve up to the second order (:eq:`dc-diode-slope`)."""
    u = diode_voltage(diode_voltage(diode_voltage(memory.u, v, c), v, c), v, c)
    bend = c.I_0 * c.over_a * np.exp(u * c.over_a)
    fall = bend + c.over_R_sh
    per_volt = 1.0 / (1.0 + c.R_s * fall)
    return DcFlow(
        current=diode_current(u, c),
        slope=-fall * per_volt,
        second=-0.5 * bend * c.over_a * per_volt * per_volt * per_volt,
        p_begin=0.0,
        p_middle=0.0,
        p_end=0.0,
        tilt=0.0,
        decay=c.decay,
        notes=ArrayNotes(u, per_volt),
    )


def array_remembers(
    memory: ArrayMemory, flow: DcFlow, v_0: Any, v_1: Any, mean: Any, p: Any, c: ArrayConstants
) -> ArrayMemory:
    """Where the search for the diode's voltage begins."""
    return ArrayMemory(u=flow.notes.u + flow.notes.per_volt * (v_1 - v_0))


def array_can_give(memory: ArrayMemory, hold: Any, c: ArrayConstants) -> SourceLimits:
    """What an array can give: most of its maximum, and it takes nothing."""
    return SourceLimits(low=0.0, high=c.p_most)


def array_left(memory: ArrayMemory, v: Any, p: Any, c: ArrayConstants) -> SourceLeft:
    """What an array could still give and take: it takes nothing, and left of its maximum it gives less the lower the
    voltage is."""
    flow = array_flow(memory, v, p, c)
    return SourceLeft(give=np.where(flow.current + v * flow.slope > 0.0, 0.0, np.inf), take=0.0 * v)


def array_constants(ratings: DcRatings, values: Mapping[str, Any]) -> ArrayConstants:
    """From the module and the weather (:eq:`dc-irradiance`)."""
    G, T = values["irradiance"] / 1000.0, values["temperature"] + 273.15
    series, strings = values["modules"], values["strings"]
    T_ref, k = 298.15, 8.617333e-5
    gap_ref = 1.121
    gap = gap_ref * (1.0 - 0.0002677 * (T - T_ref))
    I_0 = values["I_0"] * (T / T_ref) ** 3 * math.exp(gap_ref / (k * T_ref) - gap / (k * T))
    found = ArrayConstants(
        I_L=strings * G * (values["I_L"] + values["alpha_sc"] * (T - T_ref)),
        I_0=strings * I_0,
        over_a=T_ref / (T * values["a"] * series),
        R_s=values["R_s"] * series / strings,
        over_R_sh=G * strings / (values["R_sh"] * series),
        p_most=0.0,
        decay=ratings.decay(0.0),
    )
    v, current = array_curve(found)
    powers = (v * current)[(v >= ratings.V_low) & (v <= ratings.V_high)]
    return found._replace(p_most=ROOM * float(powers.max(initial=0.0)))


def array_curve(c: ArrayConstants, points: int = 2001) -> tuple[np.ndarray, np.ndarray]:
    """The curve of an array from a short circuit to the open one: voltages (points,), V, and currents (points,), A."""
    top = math.log1p(max(c.I_L, 0.0) / c.I_0) / c.over_a
    u = np.linspace(0.0, top, points)
    current = diode_current(u, c)
    v = u - c.R_s * current
    return v[(v >= 0.0) & (current >= 0.0)], current[(v >= 0.0) & (current >= 0.0)]


def array_holds(p: Any, charge: Any, bleed: Any, c: ArrayConstants) -> tuple[Any, Any]:
    """An array at rest, right of its maximum (:eq:`dc-array-rest`). Returns (v, possible): the link's voltage, V, and
    whether the array gives the power, 1 or 0.

    Newton's method comes from the open circuit: the power is a concave function of the diode's voltage there, so that
    every step ends right of the rest, or left of the maximum where there is none.
    """
    top = np.log(1.0 + c.I_L / c.I_0) / c.over_a
    ten = _nearer_5(_nearer_5(top, p, bleed, c), p, bleed, c)
    u = _nearer_5(_nearer_5(ten, p, bleed, c), p, bleed, c)
    missing, fall = _power_missing(u, p, bleed, c)
    v = u - c.R_s * diode_current(u, c)
    return v, 1.0 * (p >= 0.0) * (fall < 0.0) * (np.abs(missing) <= _CLOSE * c.I_L * v)


def _power_missing(u: Any, p: Any, bleed: Any, c: ArrayConstants) -> tuple[Any, Any]:
    """The power of the array less bleeder and bridge at a voltage of its diode. Returns (missing, fall): the power, W,
    and its derivative, W/V."""
    current = diode_current(u, c)
    slope = -(c.I_0 * c.over_a * np.exp(u * c.over_a) + c.over_R_sh)
    v = u - c.R_s * current
    per_u = 1.0 - c.R_s * slope
    return v * current - bleed * v * v - p, per_u * (current - 2.0 * bleed * v) + v * slope


def _nearer(u: Any, p: Any, bleed: Any, c: ArrayConstants) -> Any:
    """One step of Newton's method towards the diode's voltage at a rest, V."""
    missing, fall = _power_missing(u, p, bleed, c)
    return u - missing / np.minimum(fall, _FLAT * c.I_L)


def _nearer_5(u: Any, p: Any, bleed: Any, c: ArrayConstants) -> Any:
    """Five of them."""
    two = _nearer(_nearer(u, p, bleed, c), p, bleed, c)
    return _nearer(_nearer(_nearer(two, p, bleed, c), p, bleed, c), p, bleed, c)


def array_rest(p: float, ratings: DcRatings, c: ArrayConstants, values: Mapping[str, Any]) -> tuple[float, ArrayMemory]:
    """The link's voltage at a power (:func:`array_holds`)."""
    with np.errstate(over="ignore", invalid="ignore"):
        found, possible = array_holds(p, 0.0, 1.0 / ratings.R_bleed, c)
    if not possible:
        v, current = array_curve(c)
        most = float(np.max(v * current - v * v / ratings.R_bleed, initial=0.0))
        raise ValueError(f"the array gives 0 to {most:.4g} W at this irradiance, and {p:.4g} W are asked for")
    u = v = float(found)
    for _ in range(60):
        u = float(diode_voltage(u, v, c))
    return v, ArrayMemory(u=u)


def _check(ratings: DcRatings, values: Mapping[str, Any]) -> Mapping[str, str]:
    v, _ = array_curve(array_constants(ratings, values))
    most = float(v.max(initial=0.0))
    if most >= ratings.V_needed:
        return {}
    least = f"{ratings.V_needed:.5g} V for the rated voltage: take more of them in series, or a stage in between"
    return {"modules": f"make at most {most:.5g} V, and the bridge needs {least}"}


PHOTOVOLTAIC = DcSource(
    "photovoltaic",
    DcSourceLaw(array_flow, array_remembers, array_can_give),
    array_constants,
    array_rest,
    array_holds,
    (
        DcParameter("modules", "1", 1.0, 1e4, "modules in series"),
        DcParameter("strings", "1", 1.0, 1e6, "strings in parallel"),
        DcParameter("irradiance", "W/m^2", 1.0, 2000.0, "irradiance", default=1000.0),
        DcParameter("temperature", "degC", -60.0, 120.0, "temperature of the cells", default=25.0),
        DcParameter("I_L", "A", 0.01, 100.0, "photocurrent of a module at 1,000 W/m² and 25 °C", default=5.114),
        DcParameter("I_0", "A", 1e-16, 1e-3, "saturation current of a module at 25 °C", default=8.196e-10),
        DcParameter("a", "V", 0.01, 100.0, "ideality factor n N_s V_t of a module at 25 °C", default=2.6373),
        DcParameter("R_s", "ohm", 0.0, 100.0, "series resistance of a module", default=1.065),
        DcParameter("R_sh", "ohm", 1.0, 1e6, "shunt resistance of a module at 1,000 W/m²", default=381.68),
        DcParameter("alpha_sc", "A/K", -0.1, 0.1, "change of the photocurrent with the temperature", default=0.004539),
    ),
    check=_check,
    lost=("strings",),
    left=array_left,
)
"""An array without a dc–dc stage. The default module is the CS5P-220M of the database of the CEC."""
