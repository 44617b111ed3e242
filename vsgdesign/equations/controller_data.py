"""What the sampled controller takes, remembers and gives, as data."""

from __future__ import annotations

from typing import Any, NamedTuple


class Nothing(NamedTuple):
    """Holds no numbers: the memory, the constants or the notes of a limiter that needs none."""


class ControllerState(NamedTuple):
    """Everything that the controller remembers from one sample to the next."""

    theta: Any
    """Angle of the converter's d axis against the stationary α axis, rad."""
    omega_i: Any
    """Frequency integrator of the P loop, rad/s."""
    V: Any
    """Voltage integrator of the Q loop, V phase rms."""
    P_f: Any
    """Filtered active power, W."""
    Q_f: Any
    """Filtered reactive power, var."""
    xi_vd: Any
    xi_vq: Any
    """Voltage-loop integrators, A peak."""
    xi_id: Any
    xi_iq: Any
    """Current-loop integrators, V peak."""
    i_f_d: Any = 0.0
    i_f_q: Any = 0.0
    """Grid current behind the low-pass of the transient impedance, A peak."""
    u_alpha: Any = 0.0
    u_beta: Any = 0.0
    """Bridge voltage of the last sample; with a delay of one sample it acts from this sample on, V peak."""
    ripple_P: Any = 0.0
    """Ripple of P at twice the grid's frequency, as the notch predicts it for this sample, W."""
    ripple_Q: Any = 0.0
    """Ripple of Q at twice the grid's frequency, as the notch predicts it for this sample, var."""
    mean_P: Any = 0.0
    """What the notch holds for the rest of P, W."""
    mean_Q: Any = 0.0
    """What the notch holds for the rest of Q, var."""
    limiter: Any = Nothing()
    """What the current limiter remembers: a NamedTuple of its own."""


def flat_state(state: ControllerState) -> Any:
    """Every number of a state: first the controller's fields in their order, then those of its limiter."""
    return state[:-1] + state.limiter[:]


class Measurement(NamedTuple):
    """Sampled αβ components (peak): capacitor-node voltage, converter current, grid current."""

    v_alpha: Any
    v_beta: Any
    """Voltage at the capacitor, V peak."""
    i_s_alpha: Any
    i_s_beta: Any
    """Current of the converter, A peak."""
    i_g_alpha: Any
    i_g_beta: Any
    """Current into the grid, A peak."""


class ControllerSettings(NamedTuple):
    """Constants of the controller, in SI units. They do not change while it runs."""

    T_s: Any
    """Sampling period, s."""
    smoothing_P: Any
    smoothing_Q: Any
    """1 − exp(−T_s/τ) of the power filters; 1 means no filter."""
    omega_C: Any
    """Cross-coupling ω₀C of the voltage loop, S."""
    omega_L: Any
    """Cross-coupling ω₀L_1 of the current loop, Ω."""
    i_max_pk: Any
    """Current limit, A peak."""
    v_max_pk: Any
    """Limit of the bridge voltage, V peak."""
    advance_cos: Any
    advance_sin: Any
    """cos and sin of the angle ω₀(d + ½)T_s by which the output leads; d is the delay in samples."""
    smoothing_t: Any = 0.0
    """1 − exp(−ω_t T_s) of the transient impedance's low-pass."""
    half_cos: Any = 1.0
    half_sin: Any = 0.0
    """cos and sin of ω₀T_s/2, by which the frame turns in half a period."""
    T_over_L: Any = 0.0
    """T_s/L_1 of the current prediction, s/H."""
    notch_gain: Any = 0.0
    notch_step: Any = 0.0
    notch_back: Any = 0.0
    """Constants of the notch in front of the power filters; zeros: there is none."""
    limiter: Any = Nothing()
    """The current limiter's own constants: a NamedTuple."""


def flat_settings(settings: ControllerSettings) -> Any:
    """Every constant: first the controller's fields in their order, then those of its limiter."""
    return settings[:-1] + settings.limiter[:]


class ControllerOutput(NamedTuple):
    """Bridge voltage in αβ (V peak), the frequency used (rad/s), unfiltered P (W) and Q (var), and whether the
    current limiter acted (1 or 0)."""

    v_b_alpha: Any
    v_b_beta: Any
    """Bridge voltage, V peak."""
    omega: Any
    """Frequency used, rad/s."""
    P: Any
    """Unfiltered active power, W."""
    Q: Any
    """Unfiltered reactive power, var."""
    limited: Any = 0.0
    """1 if the current limiter acted, else 0."""
