"""Power loops: from measured P and Q to the converter's frequency and voltage, by one law for every structure.

A negative sequence of the grid's voltage makes P and Q ripple at twice the grid's frequency. The notch in front of the
power filters predicts this ripple by an oscillator of exactly this frequency and takes it away.
docs/theory/power-filters.md derives it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class NotchConstants(NamedTuple):
    """Constants of the notch. Zeros switch it off: then it changes no bit of what goes through."""

    gain: Any
    step: Any
    back: Any


NO_NOTCH = NotchConstants(0.0, 0.0, 0.0)


def notch(value: Any, ripple: Any, mean: Any, gain: Any, step: Any, back: Any) -> tuple[Any, Any, Any]:
    """Takes the predicted ripple from a measured power (:eq:`notch`).

    ``ripple`` and ``mean`` are what it remembers, in the unit of ``value``: the ripple that is predicted for this
    sample, and a mean that equals the value at rest. Returns (passed, ripple, mean): what goes on to the power filter,
    and what to remember.
    """
    passed = value - ripple
    error = passed - mean
    return passed, ripple - step * ripple + gain * error, mean + step * error + back * ripple


def notch_constants(omega: Any, damping: Any, T_s: Any) -> NotchConstants:
    """The notch at the angular frequency ``omega`` in rad/s, sampled every T_s in s (:eq:`notch-constants`).

    ``damping`` is the damping ratio of its poles: half its width over its frequency.
    """
    angle = omega * T_s
    half, sine = np.sin(0.5 * angle), np.sin(angle)
    gain = 2.0 * damping * sine / (1.0 + damping * sine)
    return NotchConstants(gain=gain, step=2.0 * half * half, back=sine * sine / gain)


def notch_delay(constants: NotchConstants, T_s: Any) -> Any:
    """How long the notch delays what changes slowly, s (:eq:`notch-delay`)."""
    return 0.5 * constants.gain / constants.step * T_s


MOST_FED_BACK = 0.95
"""Largest k_P D_p with which gains may be changed: the transfer divides by 1 − k_P D_p (:eq:`droop-fed-back`)."""


class PowerLoopGains(NamedTuple):
    """Gains of the power-loop law (:eq:`power-loop-law`). The published structure uses the first four.

    The off-diagonal integral gains K_pq and K_qp cancel the coupling of the grid. k_P and k_Q damp through the angle;
    they change neither the droop nor the inertia.
    """

    K_ip: Any
    """Integral gain of P in the frequency, rad/(s²·W)"""
    D_p: Any
    """P-f droop, W·s/rad"""
    K_iq: Any
    """Integral gain of Q in the voltage, V/(s·var)"""
    D_q: Any
    """Q-V droop, var/V (rms)"""
    K_pq: Any = 0.0
    """Integral gain of Q in the frequency, rad/(s²·var)"""
    K_qp: Any = 0.0
    """Integral gain of P in the voltage, V/(s·W)"""
    k_P: Any = 0.0
    """Gain of P in the angle, rad/(s·W)"""
    k_Q: Any = 0.0
    """Gain of Q in the angle, rad/(s·var)"""

    def named(self) -> dict[str, float]:
        """Gains by name, without those of the last four that are zero: the published structure has four."""
        return {
            name: value for name, value in self._asdict().items() if name not in self._field_defaults or value != 0.0
        }


class References(NamedTuple):
    """Set points of the power loops. They may be changed between two samples."""

    P_ref: Any
    """Active power, W"""
    Q_ref: Any
    """Reactive power, var"""
    omega_0: Any
    """Nominal frequency, rad/s"""
    V_n: Any
    """Voltage of the Q-V droop, V phase rms"""


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


def power_loops_about_rest(
    offset: Any, V_rms: Any, P: Any, Q: Any, refs: References, gains: PowerLoopGains
) -> tuple[Any, Any, Any]:
    """The law with the state Δ of :eq:`gain-transfer` in place of ω_i (:eq:`law-about-rest`). Returns (omega,
    doffset_dt, dV_dt) in rad/s, rad/s² and V/s.

    ``offset`` is Δ in rad/s: the frequency at which the integrator would rest, less ω_0. It is continuous when the
    gains change. The certificate follows this state.
    """
    free = 1.0 - gains.k_P * gains.D_p
    omega_i = frequency_at_rest(refs, gains) + free * offset
    omega, _, dV_dt = power_loops(omega_i, V_rms, P, Q, refs, gains)
    # K_ip e_P + K_pq e_Q over 1 − k_P D_p. The bracket is zero where k_P and k_Q are in the ratio of K_ip and K_pq.
    e_Q = refs.Q_ref - Q + gains.D_q * (refs.V_n - V_rms)
    across = gains.K_pq + (gains.K_pq * gains.k_P - gains.K_ip * gains.k_Q) * gains.D_p / free
    return omega, gains.K_ip * (refs.P_ref - P - gains.D_p * offset) + across * e_Q, dV_dt


def gain_transfer(omega_i: Any, refs: References, old: PowerLoopGains, new: PowerLoopGains) -> Any:
    """The ω_i in rad/s that keeps the frequency at which the integrator would rest when the gains change
    (:eq:`gain-transfer`).

    ``refs`` are the references with which ``old`` has been in force. No measurement enters, so that a surge leaves
    nothing behind, and equal gains leave ω_i as it is to the last bit. 1 − k_P D_p is taken as at least
    1 − MOST_FED_BACK, so that the result is finite for any gains.
    """
    offset = (omega_i - frequency_at_rest(refs, old)) / np.maximum(1.0 - old.k_P * old.D_p, 1.0 - MOST_FED_BACK)
    before = old.k_P * (refs.P_ref - old.D_p * offset) + old.k_Q * (refs.Q_ref + old.D_q * refs.V_n)
    after = new.k_P * (refs.P_ref - new.D_p * offset) + new.k_Q * (refs.Q_ref + new.D_q * refs.V_n)
    return omega_i + (after - before)


def frequency_at_rest(refs: References, gains: PowerLoopGains) -> Any:
    """ω_i in rad/s that makes ω = ω_0 where P, Q and V are at their set points (:eq:`rest-of-the-integrator`)."""
    return refs.omega_0 + (gains.k_P * refs.P_ref + gains.k_Q * (refs.Q_ref + gains.D_q * refs.V_n))
