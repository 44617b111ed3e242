"""Steady windows from phasors alone: what an estimator sees without ripple, harmonics and transients."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_flow import operating_point

Array = NDArray[np.float64]


def phasor_windows(
    R_g: Any, L_g: Any, P: Any, Q: Any, V_g_rms: Any, omega: float, t_s: Array, grid_phase: Any = 0.0
) -> tuple[Array, Array]:
    """Phase A of v_pcc (V) and i_pcc (A, into the grid) at the times t_s (K,), each (N, K).

    R_g (Ω), L_g (H), P (W), Q (var) at the PCC, V_g_rms (V) and the grid's phase at t = 0 (rad) broadcast to (N,);
    the grid source is a sine. NaN where the grid cannot carry the power (:eq:`operating-point`).
    """
    R, X, P, Q, V_g, phase = np.broadcast_arrays(R_g, omega * np.asarray(L_g), P, Q, V_g_rms, grid_phase)
    with np.errstate(invalid="ignore"):
        V, delta = operating_point(P, Q, V_g, R, X)
    v = V * np.exp(1j * delta)
    i = (v - V_g) / (R + 1j * X)
    turning = np.exp(1j * (omega * t_s[None, :] + phase[:, None]))
    return tuple(np.asarray(rms_to_peak(np.imag(x[:, None] * turning))) for x in (v, i))  # type: ignore[return-value]
