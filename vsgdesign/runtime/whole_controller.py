"""One sample of the whole controller as it runs on a target, where any number may come out of a sensor."""

from __future__ import annotations

import math

from vsgdesign.equations.controller import controller_step
from vsgdesign.equations.controller_data import (
    ControllerOutput,
    ControllerSettings,
    ControllerState,
    Measurement,
    flat_state,
)
from vsgdesign.equations.guarded_controller import LARGEST_STATE, TIMES_NOMINAL, plausible, skipped_step, sound
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import GridEstimate, Limiter, LimiterView
from vsgdesign.equations.power_loops import PowerLoopGains, References, frequency_at_rest, gain_transfer


def sound_transfer(omega_i: float, refs: References, old: PowerLoopGains, new: PowerLoopGains) -> float:
    """:func:`gain_transfer`; where its result is not :func:`sound`, ω_i begins anew at :func:`frequency_at_rest`."""
    kept = float(gain_transfer(omega_i, refs, old, new))
    return kept if abs(kept) <= TIMES_NOMINAL * refs.omega_0 else float(frequency_at_rest(refs, new))


def guarded_step(
    state: ControllerState,
    measured: Measurement,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    limiter: Limiter,
) -> tuple[ControllerState, ControllerOutput, bool]:
    """:func:`controller_step`, or :func:`skipped_step` where the sample cannot be used: the next state, the output of
    this sample, and whether it was used.

    A sample cannot be used if it is not :func:`plausible`, or if the next state would not be :func:`sound` and finite.
    In the second case integrators, filters and limiter begin anew at rest, so that they cannot stay where every step
    is refused.
    """
    if plausible(measured, settings) > 0.5:
        following, output = controller_step(
            state, measured, grid, refs, power_gains, inner_gains, settings, limiter.law
        )
        finite = math.fsum(map(abs, flat_state(following))) <= LARGEST_STATE
        if finite and sound(following, output.omega, refs, settings) > 0.5:
            return following, output, True
    following, output = skipped_step(state, refs, power_gains, settings)
    omega_i = float(frequency_at_rest(refs, power_gains))
    if plausible(measured, settings) > 0.5 and abs(omega_i) <= TIMES_NOMINAL * refs.omega_0:
        nothing = dict.fromkeys(("xi_vd", "xi_vq", "xi_id", "xi_iq", "ripple_P", "ripple_Q"), 0.0)
        powers = {"P_f": refs.P_ref, "Q_f": refs.Q_ref, "mean_P": refs.P_ref, "mean_Q": refs.Q_ref}
        view = LimiterView(**dict.fromkeys(LimiterView._fields, 0.0) | {"V": refs.V_n, "omega_i": omega_i})
        memory = limiter.at_rest(view, refs.omega_0, settings)
        following = following._replace(omega_i=omega_i, V=refs.V_n, limiter=memory, **nothing, **powers)
    return following, output, False
