"""A source behind a dc–dc stage: a battery, a fuel cell or an array whose stage holds the link's voltage."""

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

UNLIMITED_J = 1e18
"""An energy that no run uses up."""


class StageConstants(NamedTuple):
    """Constants of a stage."""

    V: Any
    """Voltage that it holds, V."""
    k_p: Any
    """Power per volt, W/V."""
    forward: Any
    """Share of the bridge's power that it feeds forward."""
    p_max: Any
    p_min: Any
    """Limits of its power, W: what it gives, and (negative) takes."""
    held_high: Any
    held_low: Any
    """The same at rest within the limits of the link's voltage, W."""
    ramp: Any
    """Largest change of its target in one interval, W."""
    half: Any
    whole: Any
    """What is left of a difference to its target after half an interval and after one."""
    T_s: Any
    late: Any
    """Energy of an interval over a difference to the target, s."""
    energy: Any
    """Usable energy, J."""
    decay: Decay


class StageNotes(NamedTuple):
    """The target of an interval, W."""

    target: Any


class StageMemory(NamedTuple):
    """What it remembers."""

    p: Any
    """Power that it gives, W."""
    target: Any
    """Power that it was asked for, W."""
    stored: Any
    """Usable energy that it has, J."""


def stage_flow(memory: StageMemory, v: Any, p: Any, c: StageConstants) -> DcFlow:
    """The power of a stage in an interval (:eq:`dc-stage`): it follows its target with a lag. The target is set at the
    sample, from the link's voltage and from the power that the bridge took in the interval before."""
    most = np.where(memory.stored > 0.0, c.p_max, 0.0)
    least = np.where(memory.stored < c.energy, c.p_min, 0.0)
    asked = np.minimum(np.maximum(c.k_p * (c.V - v) + c.forward * p, least), most)
    target = memory.target + np.minimum(np.maximum(asked - memory.target, -c.ramp), c.ramp)
    away = memory.p - target
    return DcFlow(
        current=0.0,
        slope=0.0,
        second=0.0,
        p_begin=memory.p,
        p_middle=target + c.half * away,
        p_end=target + c.whole * away,
        tilt=0.0,
        decay=c.decay,
        notes=StageNotes(target),
    )


def stage_remembers(
    memory: StageMemory, flow: DcFlow, v_0: Any, v_1: Any, mean: Any, p: Any, c: StageConstants
) -> StageMemory:
    """Its power at the end, its target, and the energy that is left."""
    target = flow.notes.target
    given = c.T_s * target + c.late * (memory.p - target)
    return StageMemory(p=flow.p_end, target=target, stored=memory.stored - given)


def stage_can_give(memory: StageMemory, hold: Any, c: StageConstants) -> SourceLimits:
    """What a stage can give (:eq:`dc-stage-limits`): its limits of power, as far as the energy lasts and the voltage of
    the link stays within its limits."""
    return SourceLimits(
        low=np.maximum(c.held_low, -np.maximum(c.energy - memory.stored, 0.0) / hold),
        high=np.minimum(c.held_high, np.maximum(memory.stored, 0.0) / hold),
    )


def stage_left(memory: StageMemory, v: Any, p: Any, c: StageConstants) -> SourceLeft:
    """What a stage could still give and take: its energy and the room beside it; nothing where a limit of its power or
    its ramp holds it back. That it follows its target with a lag is no limit."""
    asked = c.k_p * (c.V - v) + c.forward * p
    away = asked - memory.target
    held = (asked >= c.p_max) | (away >= c.ramp), (asked <= c.p_min) | (away <= -c.ramp)
    return SourceLeft(
        give=np.where(held[0], 0.0, np.maximum(memory.stored, 0.0)),
        take=np.where(held[1], 0.0, np.maximum(c.energy - memory.stored, 0.0)),
    )


def stage_constants(ratings: DcRatings, values: Mapping[str, Any]) -> StageConstants:
    """From the parameters of a study. The current limit at the low-voltage side is a limit of the power."""
    T, tau = ratings.T_s, values["tau"]
    most, droop = values["p_max"], values["k_p"] / max(1.0 - values["feed_forward"], 1e-12)
    below, above = (ROOM * droop * abs(limit - ratings.V_dc) for limit in (ratings.V_low, ratings.V_high))
    return StageConstants(
        V=ratings.V_dc,
        k_p=values["k_p"],
        forward=values["feed_forward"],
        p_max=most,
        p_min=-values["p_charge_max"],
        held_high=min(most, below),
        held_low=max(-values["p_charge_max"], -above),
        ramp=values["ramp"] * T,
        half=math.exp(-0.5 * T / tau),
        whole=math.exp(-T / tau),
        T_s=T,
        late=-tau * math.expm1(-T / tau),
        energy=values["energy"],
        decay=ratings.decay(0.0),
    )


def stage_holds(p: Any, charge: Any, bleed: Any, c: StageConstants) -> tuple[Any, Any]:
    """A stage at rest (:eq:`dc-stage-rest`). Returns (v, possible): the link's voltage, V, and whether the limits of
    the stage allow it, 1 or 0."""
    # k (V − v) + f p = p + g v²
    whole = c.k_p * c.V + c.forward * p - p
    v = 2.0 * whole / (c.k_p + np.sqrt(np.maximum(c.k_p * c.k_p + 4.0 * bleed * whole, 0.0)))
    needed = p + bleed * v * v
    low = np.where(charge < 1.0, c.p_min, 0.0)
    high = np.where(charge > 0.0, c.p_max, 0.0)
    rounding = 1e-12 * (c.p_max - c.p_min)
    return v, 1.0 * (v > 0.0) * (needed >= low - rounding) * (needed <= high + rounding)


def stage_rest(p: float, ratings: DcRatings, c: StageConstants, values: Mapping[str, Any]) -> tuple[float, StageMemory]:
    """The link's voltage at a power (:func:`stage_holds`)."""
    g, charge = 1.0 / ratings.R_bleed, values["charge"]
    found, possible = stage_holds(p, charge, g, c)
    v = float(found)
    needed = p + g * v * v
    if not possible:
        low, high = c.p_min if charge < 1.0 else 0.0, c.p_max if charge > 0.0 else 0.0
        raise ValueError(f"the stage would give {needed:.4g} W, and its limits are {low:.4g} to {high:.4g} W")
    return v, StageMemory(p=needed, target=needed, stored=values["charge"] * values["energy"])


def _slowest(ratings: DcRatings, known: Mapping[str, Any]) -> float:
    """A loop four times slower than the stage and the sampling."""
    return ratings.C * ratings.V_dc / (4.0 * (known["tau"] + 1.5 * ratings.T_s))


CONVERTER = DcSource(
    "converter",
    DcSourceLaw(stage_flow, stage_remembers, stage_can_give),
    stage_constants,
    stage_rest,
    stage_holds,
    (
        DcParameter("p_max", "W", 1.0, 1e10, "largest power that it gives"),
        DcParameter("p_charge_max", "W", 0.0, 1e10, "largest power that it takes", default=0.0),
        DcParameter("tau", "s", 1e-5, 1.0, "time constant of its power", default=0.005),
        DcParameter("ramp", "W/s", 1.0, 1e14, "largest rate of its power", default=1e14, shown="no limit"),
        DcParameter("feed_forward", "1", 0.0, 1.0, "share of the bridge's power that is fed forward", default=1.0),
        DcParameter(
            "k_p",
            "W/V",
            1e-6,
            1e9,
            "power per volt of the loop that holds `V_dc`",
            default=_slowest,
            shown="a quarter of what its lag allows, C V_dc/(4 (tau + 1.5 T_s))",
        ),
        DcParameter("energy", "J", 1e-3, UNLIMITED_J, "usable energy", default=UNLIMITED_J, shown="no limit"),
        DcParameter("charge", "1", 0.0, 1.0, "share of the usable energy at the start", default=0.5),
    ),
    lost=("p_max", "p_charge_max"),
    moving=("p",),
    recharged=lambda charge, c: {"stored": charge * c.energy},
    left=stage_left,
)
"""A stage that holds the voltage of the link."""
