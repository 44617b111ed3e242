"""What the controller does about its dc link: it asks for no more power than the source can give now, or turns with the
link's voltage."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import ControllerState
from vsgdesign.equations.dc_source_interface import SourceLimits
from vsgdesign.equations.integration import advanced
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops


class ClampSettings(NamedTuple):
    """Constants of the clamp."""

    T_s: Any
    own: Any
    """Most that filter and bleeder take of the source's power, W."""
    smoothing: Any
    """1 − exp(−T_s/τ) of the frequency by which the P–f droop is limited."""
    hold: Any
    """For how long the source could give or take its limit with the charge that it has, s."""


class ClampState(NamedTuple):
    """What the clamp remembers and what is counted of it."""

    omega: Any
    """Frequency behind its low-pass, rad/s."""
    cut: Any
    """By how much P_ref was changed in the sample before, W; zero where the source can give what is asked for."""
    most: Any
    """Largest change since the start, W."""
    missing: Any
    """Its integral, J, whatever its sign."""
    acted: Any
    """For how long it was not zero, s."""


class DroopSettings(NamedTuple):
    """Constants of the droop of the link's voltage."""

    per_volt: Any
    """Frequency over the voltage, rad/(s·V)."""


def droop_of_link(v: Any, V_dc: Any, per_volt: Any) -> Any:
    """By how much the frame turns faster than the power loops say, rad/s (:eq:`dc-droop`). ``v``: voltage of the link
    at the sample, V."""
    return per_volt * (v - V_dc)


def turned_with_link(theta: Any, omega: Any, v: Any, V_dc: Any, per_volt: Any, T_s: Any) -> tuple[Any, Any]:
    """Angle of the next sample (rad) and frequency (rad/s) of the power loops with the droop of the link's voltage
    (:eq:`dc-droop`). Returns (turned_theta, turned_omega)."""
    faster = droop_of_link(v, V_dc, per_volt)
    return advanced(theta, T_s * faster), omega + faster


def clamp_cut(omega: Any, refs: References, gains: PowerLoopGains, limits: SourceLimits, own: Any) -> Any:
    """By how much P_ref has to change so that reference and P–f droop together stay within what the source can give, W
    (:eq:`dc-clamp`). It is an exact zero where they do."""
    return cut_of(refs.P_ref + gains.D_p * (refs.omega_0 - omega), limits, own)


def cut_of(wanted: Any, limits: SourceLimits, own: Any) -> Any:
    """By how much a power that is asked for has to change to stay within what the source can give, W
    (:eq:`dc-clamp`)."""
    most = limits.high - own
    return np.minimum(most - wanted, 0.0) + np.maximum(np.minimum(limits.low, most) - wanted, 0.0)


def clamped_rest(wanted: Any, limits: SourceLimits, own: Any) -> Any:
    """The power at which a converter rests that is asked for ``wanted``, W, while its source can give this much."""
    return wanted + cut_of(wanted, limits, own)


class RestCurve(NamedTuple):
    """Q of a rest over its P, near the P of a rest: W, var, and what the P–V and Q–V droops and the grid make of it."""

    P: Any
    Q: Any
    slope: Any
    """var/W."""
    bend: Any
    """var/W²."""


def reactive_rest(P: Any, curve: RestCurve) -> Any:
    """Q (var) at which a converter rests whose power is limited to P, W (:eq:`dc-clamped-q`)."""
    d = P - curve.P
    return curve.Q + (curve.slope + curve.bend * d) * d


def clamp_of_sample(
    slow: Any,
    omega_i: Any,
    V_rms: Any,
    P: Any,
    Q: Any,
    refs: References,
    gains: PowerLoopGains,
    limits: SourceLimits,
    own: Any,
    smoothing: Any,
) -> tuple[Any, Any, Any]:
    """The clamp of one sample (:eq:`dc-clamp`) from the states of the power loops before it: ω_i (rad/s), V (V rms) and
    the filtered P (W) and Q (var). ``slow`` is the frequency behind its low-pass, rad/s.

    Returns (P_ref, slow_after, cut): the reference that the power loops follow, W, the frequency that is remembered,
    and by how much the reference was changed, W.
    """
    omega, _, _ = power_loops(omega_i, V_rms, P, Q, refs, gains)
    after = advanced(slow, smoothing * (omega - slow))
    cut = clamp_cut(after, refs, gains, limits, own)
    return refs.P_ref + cut, after, cut


def clamped(
    clamp: ClampState,
    state: ControllerState,
    refs: References,
    gains: PowerLoopGains,
    limits: SourceLimits,
    settings: ClampSettings,
) -> tuple[Any, ClampState]:
    """The clamp of one sample (:eq:`dc-clamp`), before the controller's own. Returns (P_ref, clamp_after): the
    reference that the power loops follow, and what is remembered.

    The power loops integrate the difference to this reference, so that nothing winds up. The droop is limited by its
    slow part: what it damps stays.
    """
    P_ref, slow, cut = clamp_of_sample(
        clamp.omega,
        state.omega_i,
        state.V,
        state.P_f,
        state.Q_f,
        refs,
        gains,
        limits,
        settings.own,
        settings.smoothing,
    )
    size = np.abs(cut)
    return P_ref, ClampState(
        omega=slow,
        cut=cut,
        most=np.maximum(clamp.most, size),
        missing=clamp.missing + settings.T_s * size,
        acted=clamp.acted + settings.T_s * (size > 0.0),
    )


__all__ = [
    "ClampSettings",
    "ClampState",
    "DroopSettings",
    "RestCurve",
    "SourceLimits",
    "clamp_cut",
    "clamp_of_sample",
    "clamped",
    "clamped_rest",
    "cut_of",
    "droop_of_link",
    "reactive_rest",
    "turned_with_link",
]
