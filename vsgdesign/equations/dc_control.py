"""What the controller does about its dc link: it asks for no more power than the source can give now."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import ControllerState
from vsgdesign.equations.dc_source_interface import SourceLimits
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


def clamp_cut(omega: Any, refs: References, gains: PowerLoopGains, limits: SourceLimits, own: Any) -> Any:
    """By how much P_ref has to change so that reference and P–f droop together stay within what the source can give, W
    (:eq:`dc-clamp`). It is an exact zero where they do."""
    wanted = refs.P_ref + gains.D_p * (refs.omega_0 - omega)
    most = limits.high - own
    return np.minimum(most - wanted, 0.0) + np.maximum(np.minimum(limits.low, most) - wanted, 0.0)


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
    omega, _, _ = power_loops(state.omega_i, state.V, state.P_f, state.Q_f, refs, gains)
    slow = clamp.omega + settings.smoothing * (omega - clamp.omega)
    cut = clamp_cut(slow, refs, gains, limits, settings.own)
    size = np.abs(cut)
    return refs.P_ref + cut, ClampState(
        omega=slow,
        cut=cut,
        most=np.maximum(clamp.most, size),
        missing=clamp.missing + settings.T_s * size,
        acted=clamp.acted + settings.T_s * (size > 0.0),
    )


__all__ = ["ClampSettings", "ClampState", "SourceLimits", "clamp_cut", "clamped"]
