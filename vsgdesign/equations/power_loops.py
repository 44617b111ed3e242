"""Power loops: from measured P and Q to the converter's frequency and voltage, by one law for every structure."""

from __future__ import annotations

from typing import Any, NamedTuple


class PowerLoopGains(NamedTuple):
    """Gains of the power-loop law (:eq:`power-loop-law`). The published structure uses the first four.

    The off-diagonal integral gains K_pq and K_qp cancel the coupling of the grid. k_P and k_Q damp through the angle;
    they change neither the droop nor the inertia.
    """

    K_ip: Any
    """rad/(s²·W)"""
    D_p: Any
    """W·s/rad"""
    K_iq: Any
    """V/(s·var)"""
    D_q: Any
    """var/V (rms)"""
    K_pq: Any = 0.0
    """rad/(s²·var)"""
    K_qp: Any = 0.0
    """V/(s·W)"""
    k_P: Any = 0.0
    """rad/(s·W)"""
    k_Q: Any = 0.0
    """rad/(s·var)"""

    def named(self) -> dict[str, float]:
        """Gains by name, without those of the last four that are zero: the published structure has four."""
        return {
            name: value for name, value in self._asdict().items() if name not in self._field_defaults or value != 0.0
        }


class References(NamedTuple):
    """Set points of the power loops. They may be changed between two samples."""

    P_ref: Any
    """W"""
    Q_ref: Any
    """var"""
    omega_0: Any
    """rad/s"""
    V_n: Any
    """V, phase rms"""


def power_loops(
    omega_i: Any, V_rms: Any, P: Any, Q: Any, refs: References, gains: PowerLoopGains
) -> tuple[Any, Any, Any]:
    """The law of every structure (:eq:`power-loop-law`). Returns (omega, domega_dt, dV_dt) in rad/s, rad/s² and V/s.

    ω = ω_i − k_P P − k_Q (Q + D_q V). With the errors e_P = P_ref − P + D_p (ω_0 − ω) and
    e_Q = Q_ref − Q + D_q (V_n − V), dω_i/dt = K_ip e_P + K_pq e_Q and dV/dt = K_qp e_P + K_iq e_Q. In the steady state
    both errors are zero, so the droops are exactly D_p and D_q whatever the other gains are.

    If the last four gains are zero, this is the published law with V in rms. The authors' released model differs: it
    integrates the peak amplitude although its gains come from the Jacobian in rms.
    """
    omega = omega_i - gains.k_P * P - gains.k_Q * (Q + gains.D_q * V_rms)
    e_P = refs.P_ref - P + gains.D_p * (refs.omega_0 - omega)
    e_Q = refs.Q_ref - Q + gains.D_q * (refs.V_n - V_rms)
    return omega, gains.K_ip * e_P + gains.K_pq * e_Q, gains.K_qp * e_P + gains.K_iq * e_Q


def bumpless(omega_i: Any, V_rms: Any, P: Any, Q: Any, old: PowerLoopGains, new: PowerLoopGains) -> Any:
    """The ω_i in rad/s with which ω does not jump when the gains change (:eq:`bumpless`)."""
    before = old.k_P * P + old.k_Q * (Q + old.D_q * V_rms)
    after = new.k_P * P + new.k_Q * (Q + new.D_q * V_rms)
    return omega_i + after - before


def frequency_at_rest(refs: References, gains: PowerLoopGains) -> Any:
    """ω_i in rad/s that makes ω = ω_0 where P, Q and V are at their set points (:eq:`power-loop-law`)."""
    return refs.omega_0 + (gains.k_P * refs.P_ref + gains.k_Q * (refs.Q_ref + gains.D_q * refs.V_n))
