"""What a run does in every sample to find the instants that only it can tell.

The current of a fault passes through zero, a breaker may close, or the converter has set itself to the grid behind it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import ControllerState, Measurement
from vsgdesign.equations.frames import clarke_inverse
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.equations.synchronising import GridWatch, in_step, synchronised, watch_grid


class Phases(NamedTuple):
    """1 for a phase whose current into a fault is waited for, else 0."""

    a: Any
    b: Any
    c: Any


class Relay(NamedTuple):
    """A relay that waits for both sides of a breaker (:eq:`synchro-check`)."""

    on: Any
    """1 where the breaker may close, else 0."""
    fresh: Any
    """1 in the first sample in which the relay looks at the voltages, else 0."""
    omega_n: Any
    V_n: Any
    """The frequency (rad/s) and the voltage (phase rms, V) about which it looks for a grid."""
    cosine: Any
    sine: Any
    """Of the lead of the converter's side around which the breaker closes."""
    least: Any
    """Cosine of the largest difference of the angles."""
    V_pk: Any
    omega: Any
    """Largest differences of the amplitudes, V peak, and of the frequencies, rad/s."""


class Setting(NamedTuple):
    """A converter that sets itself to the grid behind its breaker (:eq:`synchronised`)."""

    on: Any
    """1 where it does so, else 0."""
    free: Any
    """0 where a fault keeps the breaker open, else 1."""
    needed: Any
    """After so many samples in step the breaker closes; infinite where it does not wait for that."""


def passes_zero(begin_alpha: Any, begin_beta: Any, end_alpha: Any, end_beta: Any, phases: Phases) -> Any:
    """1 where the current of a phase into a fault changes its sign between two samples, else 0."""
    begin_a, begin_b, begin_c = clarke_inverse(begin_alpha, begin_beta)
    end_a, end_b, end_c = clarke_inverse(end_alpha, end_beta)
    in_a = phases.a * (begin_a * end_a <= 0.0)
    in_b = phases.b * (begin_b * end_b <= 0.0)
    in_c = phases.c * (begin_c * end_c <= 0.0)
    return np.maximum(in_a, np.maximum(in_b, in_c))


def _relay_watch(before: GridWatch, relay: Relay, v_alpha: Any, v_beta: Any, T_s: Any) -> GridWatch:
    """What a relay follows on one side; at its first sample it begins with the voltage that it sees."""
    at_first = relay.fresh > 0.5
    begun = GridWatch(
        v_alpha=np.where(at_first, v_alpha, before.v_alpha),
        v_beta=np.where(at_first, v_beta, before.v_beta),
        omega=np.where(at_first, relay.omega_n, before.omega),
    )
    refs = References(P_ref=0.0, Q_ref=0.0, omega_0=relay.omega_n, V_n=relay.V_n)
    return watch_grid(begun, v_alpha, v_beta, refs, T_s)


def relay_sees(
    own: GridWatch,
    behind: GridWatch,
    relay: Relay,
    v_alpha: Any,
    v_beta: Any,
    v_g_alpha: Any,
    v_g_beta: Any,
    T_s: Any,
) -> Any:
    """A sample of the voltages on both sides of an open breaker: what the relay follows, and whether both are near each
    other (:eq:`synchro-check`). Returns (followed, followed_behind, near)."""
    seen = _relay_watch(own, relay, v_alpha, v_beta, T_s)
    other = _relay_watch(behind, relay, v_g_alpha, v_g_beta, T_s)
    along = seen.v_alpha * other.v_alpha + seen.v_beta * other.v_beta
    across = seen.v_beta * other.v_alpha - seen.v_alpha * other.v_beta
    turned = along * relay.cosine + across * relay.sine
    length, other_length = np.hypot(seen.v_alpha, seen.v_beta), np.hypot(other.v_alpha, other.v_beta)
    angle = 1.0 * (turned >= relay.least * np.hypot(along, across))
    size = 1.0 * (np.abs(length - other_length) <= relay.V_pk)
    speed = 1.0 * (np.abs(seen.omega - other.omega) <= relay.omega)
    return seen, other, relay.on * angle * size * speed


def set_to_grid(
    state: ControllerState,
    watch: GridWatch,
    ready: Any,
    setting: Setting,
    measured: Measurement,
    v_g_alpha: Any,
    v_g_beta: Any,
    refs: References,
    power_gains: PowerLoopGains,
    T_s: Any,
) -> Any:
    """The state that a converter sets before a sample while it sets itself to the grid behind its breaker, as the
    exported controller does it. Returns (chosen, watched_grid, in_step_for, done): the state, the grid's voltage, for
    how many samples the converter has been in step, and whether the breaker closes before the next sample."""
    acts = setting.on > 0.5
    seen = watch_grid(watch, v_g_alpha, v_g_beta, refs, T_s)
    count = setting.on * setting.free * in_step(measured, seen, refs) * (ready + 1.0)
    made = synchronised(state, seen, power_gains)
    chosen = state._replace(
        theta=np.where(acts, made.theta, state.theta),
        omega_i=np.where(acts, made.omega_i, state.omega_i),
        V=np.where(acts, made.V, state.V),
        P_f=np.where(acts, 0.0, state.P_f),
        Q_f=np.where(acts, 0.0, state.Q_f),
        ripple_P=np.where(acts, 0.0, state.ripple_P),
        ripple_Q=np.where(acts, 0.0, state.ripple_Q),
        mean_P=np.where(acts, 0.0, state.mean_P),
        mean_Q=np.where(acts, 0.0, state.mean_Q),
    )
    return chosen, seen, count, setting.on * (count >= setting.needed)
