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
    delta: Any, V_rms: Any, v: tuple[Any, Any], i_f: tuple[Any, Any], path: tuple[Any, Any, Any], lags: Lags
) -> Yielding:
    """The power loops' plant with a transient impedance (:eq:`yielding-plant`).

    ``v`` is the capacitor's voltage in V rms and ``i_f`` the current behind the low-pass in A rms, both in the frame of
    δ; ``path``: V_g (V rms), R and X (Ω). It holds where ``v`` is the voltage that is returned.
    """
    v_d, v_q = v
    P, Q = power_flow(delta + np.arctan2(v_q, v_d), np.sqrt(v_d * v_d + v_q * v_q), *path)
    i_d, i_q = current_of_power(P, Q, v_d, v_q)
    gains = InnerLoopGains(0.0, 0.0, 0.0, 0.0, R_t=lags.R_t, X_t=lags.X_t)
    # The low-pass of a sample of one second with the share ω_t is that of the rate.
    drop_d, drop_q, next_d, next_q = transient_impedance(i_d, i_q, *i_f, gains, lags.omega_t)
    return Yielding(P, Q, V_rms - drop_d, -drop_q, next_d - i_f[0], next_q - i_f[1])


class YieldingColumns(NamedTuple):
    """What one unit of δ (rad), of V (relative) and of the current behind the low-pass (d, then q; as a power 3V i_f)
    does: ``powers`` has (ΔP, ΔQ), ``change`` the current less that current (d, q), as a power."""

    powers: tuple[tuple[Any, Any], ...]
    change: tuple[tuple[Any, Any], ...]


def yielding_columns(P: Any, Q: Any, b: Any, g: Any, r: Any, x: Any) -> YieldingColumns:
    """The derivatives of :func:`yielding_plant` at rest in closed form (:eq:`yielding-columns`).

    ``b`` and ``g`` are those of :func:`~vsgdesign.equations.power_flow.admittance` for the path and the transient
    impedance in series, ``r`` and ``x`` are R_t and X_t over 3V². All four columns are affine in b and g.
    """
    # k = 1 − (r + jx)(g − jb), what is left of the current's own voltage; j s̄ = Q + jP turns with the frame.
    k_re, k_im = 1.0 - (r * g + x * b), r * b - x * g
    turn_re, turn_im = k_re * Q - k_im * P, k_re * P + k_im * Q
    change = (b - turn_re, g - turn_im), (g, 0.0 - b), (0.0 - k_re, 0.0 - k_im), (k_im, 0.0 - k_re)
    # ΔP − jΔQ = what the voltage and the current behind the low-pass do + h − s̄ (r − jx) h̄.
    own_re, own_im = P * r - Q * x, 0.0 - (P * x + Q * r)
    at_once = (0.0, 0.0), (P, 0.0 - Q), (1.0, 0.0), (0.0, 1.0)
    powers = []
    for (first_re, first_im), (h_re, h_im) in zip(at_once, change, strict=True):
        in_phase = first_re + h_re - (own_re * h_re + own_im * h_im)
        across = first_im + h_im - (own_im * h_re - own_re * h_im)
        powers.append((in_phase, 0.0 - across))
    return YieldingColumns(tuple(powers), change)
