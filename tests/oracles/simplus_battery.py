"""A battery plant's unit of Simplus Grid Tool on an infinite bus, integrated from its published equations.

Class ``Battery`` and ``BESS_Plant_10Bus.json`` of https://github.com/Future-Power-Networks/Simplus-Grid-Tool: droop,
voltage and current loops, LCL filter, capacitor, and a boost converter whose current follows a PI loop of the link's
voltage. Per unit with time in s; power that goes out counts as positive.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

OMEGA = 2.0 * math.pi * 50.0
L_F, R_F, C_F, L_C, R_C, X_OV = 0.05 / OMEGA, 0.01, 0.02 / OMEGA, 0.3 / OMEGA, 0.06, 0.01
DROOP, OMEGA_P, OMEGA_V, OMEGA_I = 0.05 * OMEGA, 2.0 * math.pi * 5.0, 2.0 * math.pi * 250.0, 2.0 * math.pi * 1000.0
L_DC, C_DC, V_OPEN, R_BATTERY, V_DC = 0.000125, 0.224, 0.625, 0.0625, 1.0
OMEGA_DC, OMEGA_BATTERY = 2.0 * math.pi * 50.0, 2.0 * math.pi * 500.0
K_P_DC, K_I_DC = OMEGA_DC * C_DC, OMEGA_DC**2 * C_DC / 4.0


class Response(NamedTuple):
    """What follows a step of the power reference at t = 0."""

    t_s: Array
    v_dc: Array
    p: Array
    share: float
    """Current into the link over that of the battery, at rest."""


def step_of_power(P: float, size: float, t_s: Array) -> Response:
    """The unit at rest with a power at its terminal, and after a step of its reference."""
    i_o = complex(P)
    v_o = 1.0 + i_o * (R_C + 1j * OMEGA * L_C)
    i_l = i_o + v_o * 1j * OMEGA * C_F
    e, p_0 = v_o + i_l * (R_F + 1j * OMEGA * L_F), (v_o * i_o.conjugate()).real
    reference = v_o + 1j * X_OV * i_o
    i_battery = (V_OPEN - math.sqrt(V_OPEN**2 - 4.0 * R_BATTERY * p_0)) / (2.0 * R_BATTERY)

    def slopes(_t: float, y: Array) -> Array:
        i, xi_i, v, xi_v, out = y[:10:2] + 1j * y[1:10:2]
        omega, theta, battery, link, wanted, duty = y[10:]
        error_v = reference - v - 1j * X_OV * out
        error_i = OMEGA_V * C_F * error_v + xi_v - i
        bridge, p = OMEGA_I * L_F * error_i + xi_i, (v * out.conjugate()).real
        of_vectors = [
            (bridge - v - R_F * i) / L_F - 1j * omega * i,
            OMEGA_I**2 * L_F / 4.0 * error_i,
            (i - out) / C_F - 1j * omega * v,
            OMEGA_V**2 * C_F / 4.0 * 50.0 * error_v,
            (v - np.exp(-1j * theta) - R_C * out) / L_C - 1j * omega * out,
        ]
        of_battery = (V_OPEN - R_BATTERY * battery - (1.0 - duty) * link) / L_DC
        of_link = ((1.0 - duty) * battery - p / link) / C_DC
        of_wanted = -K_P_DC * of_link + K_I_DC * (V_DC - link)
        of_duty = OMEGA_BATTERY * L_DC * (of_wanted - of_battery) + OMEGA_BATTERY**2 * L_DC / 4.0 * (wanted - battery)
        of_droop = (OMEGA + DROOP * (p_0 + size - p) - omega) * OMEGA_P
        vectors = np.array(of_vectors)
        rates = [of_droop, omega - OMEGA, of_battery, of_link, of_wanted, of_duty]
        return np.concatenate([np.column_stack([np.real(vectors), np.imag(vectors)]).ravel(), rates])

    rest = np.array([i_l, e, v_o, i_l, i_o])
    y_0 = [
        *np.column_stack([np.real(rest), np.imag(rest)]).ravel(),
        OMEGA,
        0.0,
        i_battery,
        V_DC,
        i_battery,
        1.0 - p_0 / i_battery,
    ]
    found = solve_ivp(slopes, (0.0, t_s[-1]), y_0, "LSODA", t_s, rtol=1e-9, atol=1e-11).y
    v, out = found[4] + 1j * found[5], found[8] + 1j * found[9]
    return Response(t_s, found[13], (v * out.conjugate()).real, p_0 / i_battery)
