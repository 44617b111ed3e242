"""Connecting to a live grid: the grid's voltage behind the open breaker, and the controller's state that makes it.

While the breaker is open, :func:`watch_grid` follows the fundamental of the grid's voltage and its frequency, and
:func:`synchronised` sets the power loops to them before every sample. The voltage loop then makes the grid's voltage at
the capacitor, so that no current flows when the breaker closes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import ControllerState, Measurement
from vsgdesign.equations.frames import peak_to_rms, rms_to_peak, rotate
from vsgdesign.equations.power_loops import PowerLoopGains, References

WATCH_BANDWIDTH = 30.0
"""Natural frequency of the loop that follows the grid's voltage, rad/s: it settles within 0.2 s, and passes a tenth of
a negative sequence."""

WATCH_RANGE = 0.1
"""Largest deviation of the grid's frequency that is followed, over the nominal frequency."""

WATCH_LEAST = 0.1
"""Voltage over nominal below which the frequency is not followed at full gain: there is no grid to follow."""

IN_STEP = 0.03
"""Largest difference between both voltages with which the breaker may close, over the nominal voltage."""

IN_STEP_V_LOW = 0.8
IN_STEP_V_HIGH = 1.2
"""Grid voltages to which the breaker may close, over the nominal voltage."""


class GridWatch(NamedTuple):
    """The fundamental of the grid's voltage. Zero and the nominal frequency at first."""

    v_alpha: Any
    v_beta: Any
    """V peak."""
    omega: Any
    """Frequency, rad/s."""


def watch_grid(watch: GridWatch, v_alpha: Any, v_beta: Any, refs: References, T_s: Any) -> GridWatch:
    """One sample of the grid's voltage in V peak (:eq:`grid-watch`)."""
    turn = T_s * watch.omega
    ahead_alpha, ahead_beta = rotate(watch.v_alpha, watch.v_beta, np.cos(turn), np.sin(turn))
    e_alpha = v_alpha - ahead_alpha
    e_beta = v_beta - ahead_beta
    least = WATCH_LEAST * rms_to_peak(refs.V_n)
    length_sq = np.maximum(ahead_alpha * ahead_alpha + ahead_beta * ahead_beta, least * least)
    slip = (ahead_alpha * e_beta - ahead_beta * e_alpha) / length_sq
    omega = watch.omega + WATCH_BANDWIDTH * WATCH_BANDWIDTH * T_s * slip
    share = 2.0 * WATCH_BANDWIDTH * T_s
    lowest = (1.0 - WATCH_RANGE) * refs.omega_0
    highest = (1.0 + WATCH_RANGE) * refs.omega_0
    return GridWatch(
        v_alpha=ahead_alpha + share * e_alpha,
        v_beta=ahead_beta + share * e_beta,
        omega=np.minimum(np.maximum(omega, lowest), highest),
    )


def synchronised(state: ControllerState, watch: GridWatch, gains: PowerLoopGains) -> ControllerState:
    """The controller's state with the angle, the voltage and the frequency of the grid, without power
    (:eq:`synchronised`). The inner loops and the limiter keep theirs."""
    V = peak_to_rms(np.hypot(watch.v_alpha, watch.v_beta))
    return state._replace(
        theta=np.arctan2(watch.v_beta, watch.v_alpha),
        omega_i=watch.omega + gains.k_Q * gains.D_q * V,
        V=V,
        P_f=0.0,
        Q_f=0.0,
        ripple_P=0.0,
        ripple_Q=0.0,
        mean_P=0.0,
        mean_Q=0.0,
    )


def in_step(measured: Measurement, watch: GridWatch, refs: References) -> Any:
    """1 if the breaker may close: the converter's voltage is the grid's, which is near the nominal one; else 0."""
    nominal = rms_to_peak(refs.V_n)
    apart = np.hypot(measured.v_alpha - watch.v_alpha, measured.v_beta - watch.v_beta)
    grid = np.hypot(watch.v_alpha, watch.v_beta)
    return 1.0 * (apart <= IN_STEP * nominal) * (grid >= IN_STEP_V_LOW * nominal) * (grid <= IN_STEP_V_HIGH * nominal)
