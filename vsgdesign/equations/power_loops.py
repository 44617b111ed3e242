"""Power loops: from measured P, Q to the converter's frequency and voltage."""

from __future__ import annotations

from typing import Any, NamedTuple


class PowerLoopGains(NamedTuple):
    """The four gains of the published structure.

    K_ip: rad/(s²·W); D_p: W·s/rad; K_iq: V/(s·var); D_q: var/V (rms).
    """

    K_ip: Any
    D_p: Any
    K_iq: Any
    D_q: Any


class References(NamedTuple):
    """Set points: P_ref (W), Q_ref (var), omega_0 (rad/s), V_n (phase rms, V)."""

    P_ref: Any
    Q_ref: Any
    omega_0: Any
    V_n: Any


def published_power_loops(omega_i: Any, V_rms: Any, P: Any, Q: Any, refs: References, gains: PowerLoopGains) -> Any:
    """ω (rad/s), dω_i/dt and dV/dt of the published loops (:eq:`published-loops`).

    dω/dt = K_ip (P_ref − P + D_p (ω_0 − ω)), dV/dt = K_iq (Q_ref − Q + D_q (V_n − V)), V in rms: the
    authors' released model integrates the peak amplitude while its gains come from the rms Jacobian.
    """
    domega_dt = gains.K_ip * (refs.P_ref - P + gains.D_p * (refs.omega_0 - omega_i))
    dV_dt = gains.K_iq * (refs.Q_ref - Q + gains.D_q * (refs.V_n - V_rms))
    return omega_i, domega_dt, dV_dt
