"""What stands between the power loops and the static power flow: lags of the powers, and a voltage that yields.

Slow means that the inner loops are ideal and the grid's current follows its voltage at once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.inner_loops import InnerLoopGains, transient_impedance
from vsgdesign.equations.power_flow import power_flow


class Lags(NamedTuple):
    """Time constants of the power filters in s, and the transient impedance R_t + jX_t in Ω with its corner in
    rad/s."""

    tau_P: Any = 0.0
    tau_Q: Any = 0.0
    R_t: Any = 0.0
    X_t: Any = 0.0
    omega_t: Any = 0.0

    @property
    def yields(self) -> bool:
        """Whether the voltage yields to changes of the current."""
        return bool(self.R_t != 0.0 or self.X_t != 0.0)


class Yielding(NamedTuple):
    """The plant behind a transient impedance: powers in W and var, the voltage that the impedance leaves and the rates
    of the current behind its low-pass, in V and A/s, d and q in the converter's frame, rms."""

    P: Any
    Q: Any
    v_d: Any
    v_q: Any
    di_f_d: Any
    di_f_q: Any


def current_of_power(P: Any, Q: Any, v_d: Any, v_q: Any) -> tuple[Any, Any]:
    """The current in A rms that carries P and Q at a voltage in V rms. Returns (i_d, i_q)."""
    scale = PHASES * (v_d * v_d + v_q * v_q)
    return (P * v_d + Q * v_q) / scale, (P * v_q - Q * v_d) / scale


def yielding_plant(
    delta: Any,
    V_rms: Any,
    v_d: Any,
    v_q: Any,
    i_f_d: Any,
    i_f_q: Any,
    V_g_rms: Any,
    R: Any,
    X: Any,
    lags: Lags,
) -> Yielding:
    """The power loops' plant with a transient impedance (:eq:`yielding-plant`).

    ``v_d`` and ``v_q`` are the capacitor's voltage in V rms, ``i_f_d`` and ``i_f_q`` the current behind the low-pass in
    A rms, both in the frame of δ. It holds where the voltage is the one that is returned.
    """
    P, Q = power_flow(delta + np.arctan2(v_q, v_d), np.sqrt(v_d * v_d + v_q * v_q), V_g_rms, R, X)
    i_d, i_q = current_of_power(P, Q, v_d, v_q)
    gains = InnerLoopGains(0.0, 0.0, 0.0, 0.0, R_t=lags.R_t, X_t=lags.X_t)
    # The low-pass of a sample of one second with the share ω_t is that of the rate.
    drop_d, drop_q, next_d, next_q = transient_impedance(i_d, i_q, i_f_d, i_f_q, gains, lags.omega_t)
    return Yielding(P, Q, V_rms - drop_d, 0.0 - drop_q, next_d - i_f_d, next_q - i_f_q)


class YieldingColumns(NamedTuple):
    """What one unit of δ (rad), of V (relative) and of the current behind the low-pass (d, then q; as a power 3V i_f)
    does, one column for each: ΔP and ΔQ, and the current less the one behind the low-pass (d, q), as a power."""

    P_delta: Any
    Q_delta: Any
    P_V: Any
    Q_V: Any
    P_d: Any
    Q_d: Any
    P_q: Any
    Q_q: Any
    d_delta: Any
    q_delta: Any
    d_V: Any
    q_V: Any
    d_d: Any
    q_d: Any
    d_q: Any
    q_q: Any

    @property
    def powers(self) -> tuple[tuple[Any, Any], ...]:
        """(ΔP, ΔQ) of each column."""
        return (self.P_delta, self.Q_delta), (self.P_V, self.Q_V), (self.P_d, self.Q_d), (self.P_q, self.Q_q)

    @property
    def change(self) -> tuple[tuple[Any, Any], ...]:
        """The change of the current (d, q) of each column."""
        return (self.d_delta, self.q_delta), (self.d_V, self.q_V), (self.d_d, self.q_d), (self.d_q, self.q_q)


def power_of_change(P: Any, Q: Any, r: Any, x: Any, d: Any, q: Any) -> tuple[Any, Any]:
    """Powers of a change d, q of the current: h − s̄ (r − jx) h̄ with h = d + jq. Returns (change_P, change_Q)."""
    own_re, own_im = P * r - Q * x, 0.0 - (P * x + Q * r)
    return d - (own_re * d + own_im * q), 0.0 - (q - (own_im * d - own_re * q))


def yielding_columns(P: Any, Q: Any, b: Any, g: Any, r: Any, x: Any) -> YieldingColumns:
    """The derivatives of :func:`yielding_plant` at rest in closed form (:eq:`yielding-columns`).

    ``b`` and ``g`` are those of :func:`~vsgdesign.equations.power_flow.admittance` for the path and the transient
    impedance in series, ``r`` and ``x`` are R_t and X_t over 3V². All four columns are affine in b and g.
    """
    # k = 1 − (r + jx)(g − jb), what is left of the current's own voltage; j s̄ = Q + jP turns with the frame.
    k_re, k_im = 1.0 - (r * g + x * b), r * b - x * g
    d_delta, q_delta = b - (k_re * Q - k_im * P), g - (k_re * P + k_im * Q)
    # What the voltage and the current behind the low-pass do at once comes to what the change of the current does.
    P_delta, Q_delta = power_of_change(P, Q, r, x, d_delta, q_delta)
    P_V, Q_V = power_of_change(P, Q, r, x, g, 0.0 - b)
    P_d, Q_d = power_of_change(P, Q, r, x, 0.0 - k_re, 0.0 - k_im)
    P_q, Q_q = power_of_change(P, Q, r, x, k_im, 0.0 - k_re)
    return YieldingColumns(
        P_delta=P_delta,
        Q_delta=Q_delta,
        P_V=P + P_V,
        Q_V=Q + Q_V,
        P_d=1.0 + P_d,
        Q_d=Q_d,
        P_q=P_q,
        Q_q=Q_q - 1.0,
        d_delta=d_delta,
        q_delta=q_delta,
        d_V=g,
        q_V=0.0 - b,
        d_d=0.0 - k_re,
        q_d=0.0 - k_im,
        d_q=k_im,
        q_q=0.0 - k_re,
    )
