"""What guards the exported controller: a sample that is no measurement is left out and cannot spoil the integrators.

A simulation does not need it and runs ``controller_step`` alone. ``runtime.guarded_step`` puts both together.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vsgdesign.equations.controller_data import (
    ControllerOutput,
    ControllerSettings,
    ControllerState,
    Measurement,
)
from vsgdesign.equations.frames import rotate
from vsgdesign.equations.inner_loops import limit_length
from vsgdesign.equations.integration import TURN, advanced
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops

V_PLAUSIBLE = 5.0
"""Largest component of a measured voltage over the voltage limit of the bridge."""

I_PLAUSIBLE = 20.0
"""Largest component of a measured current over the current limit."""

TIMES_NOMINAL = 10.0
"""Largest frequency and voltage of the power loops over their nominal values."""

LARGEST_STATE = 1e12
"""Largest sum of the magnitudes of all state variables, in their SI units."""


def plausible(measured: Measurement, settings: ControllerSettings) -> Any:
    """1 if six numbers can be a measurement, 0 if one of them is NaN, infinite or far beyond every limit."""
    v = np.maximum(np.abs(measured.v_alpha), np.abs(measured.v_beta))
    i_s = np.maximum(np.abs(measured.i_s_alpha), np.abs(measured.i_s_beta))
    i_g = np.maximum(np.abs(measured.i_g_alpha), np.abs(measured.i_g_beta))
    return (
        1.0
        * (v <= V_PLAUSIBLE * settings.v_max_pk)
        * (i_s <= I_PLAUSIBLE * settings.i_max_pk)
        * (i_g <= I_PLAUSIBLE * settings.i_max_pk)
    )


def sound(state: ControllerState, omega: Any, refs: References, settings: ControllerSettings) -> Any:
    """1 if the frequency and the integrators of a state are where a converter can be, 0 if one is NaN or far beyond.

    A step that would leave this range is not taken, so that gains or references that make no sense leave nothing
    behind in the integrators.
    """
    xi_v = np.maximum(np.abs(state.xi_vd), np.abs(state.xi_vq))
    xi_i = np.maximum(np.abs(state.xi_id), np.abs(state.xi_iq))
    return (
        1.0
        * (np.abs(omega) <= TIMES_NOMINAL * refs.omega_0)
        * (np.abs(state.omega_i) <= TIMES_NOMINAL * refs.omega_0)
        * (np.abs(state.V) <= TIMES_NOMINAL * refs.V_n)
        * (xi_v <= I_PLAUSIBLE * settings.i_max_pk)
        * (xi_i <= V_PLAUSIBLE * settings.v_max_pk)
    )


def skipped_step(state: ControllerState, refs: References, gains: PowerLoopGains, settings: ControllerSettings) -> Any:
    """A sample without a measurement (:eq:`skipped-step`): the next state, and the output of this one.

    The frame and the bridge voltage go on turning at the frequency that the filtered powers ask for. All other state
    variables keep their values.
    """
    omega, _, _ = power_loops(state.omega_i, state.V, state.P_f, state.Q_f, refs, gains)
    # At most half a turn in a sample: gains that make no sense may ask for any frequency.
    fastest = 0.5 * TURN / settings.T_s
    omega = np.minimum(np.maximum(omega, -fastest), fastest)
    turn = settings.T_s * omega
    u_alpha, u_beta = limit_length(state.u_alpha, state.u_beta, settings.v_max_pk)
    u_alpha, u_beta = rotate(u_alpha, u_beta, np.cos(turn), np.sin(turn))
    following = state._replace(theta=advanced(state.theta, turn), u_alpha=u_alpha, u_beta=u_beta)
    output = ControllerOutput(v_b_alpha=u_alpha, v_b_beta=u_beta, omega=omega, P=state.P_f, Q=state.Q_f, limited=0.0)
    return following, output
