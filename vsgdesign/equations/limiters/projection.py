"""Projection: the power loops follow the voltage that the grid admits at the largest current.

While the current is limited, the capacitor voltage cannot follow its reference. Power loops that do not know this wind
up until the converter slips. This limiter computes the voltage nearest to the reference that the allowed current can
hold, and it pulls θ, ω_i and V towards it. docs/theory/limiters.md derives the law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import ControllerSettings
from vsgdesign.equations.frames import instantaneous_power, peak_to_rms, rms_to_peak
from vsgdesign.equations.inner_loops import limit_length
from vsgdesign.equations.integration import low_pass_share
from vsgdesign.equations.limiter_interface import (
    GridEstimate,
    IntegratorSteps,
    LimitedSample,
    Limiter,
    LimiterLaw,
    LimiterParameter,
    LimiterRatings,
    LimiterView,
    Rule,
    always,
)
from vsgdesign.equations.power_loops import PowerLoopGains, References

BEYOND_S = 0.1
"""For how long the angle may stay beyond the largest power at the soft limit, s."""

CERTAIN = 0.5
"""Opening of the gate from which on the grid has a voltage that the way back may go to."""

CARRIED = 1.3
"""Share of the largest power up to which a rest is taken to exist, because the estimate of the grid may be wrong."""

LOW_VOLTAGE = 3.0
"""Voltage of the grid below which the power loops rest where no angle carries the power, of the gate's voltage."""

WAY_BACK_S = 0.05
"""Time constant with which the angle then goes back to that of the grid's voltage, s."""


class ProjectionMemory(NamedTuple):
    """What the limiter remembers."""

    i_w_d: Any
    i_w_q: Any
    """Test current behind its low-pass, A peak."""
    v_d: Any
    v_q: Any
    """Capacitor-node voltage behind the same low-pass, V peak."""
    omega: Any
    """Frequency of the last sample, rad/s."""
    beyond: Any
    """Time beyond the largest power at the soft limit, as a share of BEYOND_S; at 1 the angle is on its way back."""


class ProjectionConstants(NamedTuple):
    """Constants of the limiter."""

    i_soft_pk: Any
    """Length at which the test current is projected, A peak."""
    Z_v: Any
    """Length of the impedance that turns a voltage error into a current, Ω."""
    smoothing_i: Any
    """1 − exp(−T_s/τ) of the test current's low-pass; 1 means no filter."""
    share: Any
    """1 − exp(−T_s/τ) of the pull: the share of its way that θ and V go in one sample."""
    g: Any
    """How ω_i follows the pull of θ, 1/s."""
    largest_pull: Any
    """Largest pull of θ in one sample that ω_i follows, rad."""
    omega_low: Any
    omega_high: Any
    """Frequencies beyond which ω_i is not pulled, rad/s."""
    v_gate_pk: Any
    """Grid voltage that counts as none, V peak."""
    doubt: Any
    """Error of the estimated impedance that the gate allows for, as a share of its length."""
    V_low: Any
    V_high: Any
    """Limits of the voltage that the Q loop may ask for, V rms."""
    R_2: Any
    L_2: Any
    """Grid side of the filter, Ω and H."""
    beyond_step: Any
    """T_s over BEYOND_S."""
    back_share: Any
    """1 − exp(−T_s/WAY_BACK_S): the share of the way back that θ goes in one sample."""


class ProjectionNotes(NamedTuple):
    """What one sample hands to ``projection_move``: the next memory, all but the frequency, and the pulls."""

    i_w_d: Any
    i_w_q: Any
    """A peak."""
    v_d: Any
    v_q: Any
    """V peak."""
    theta: Any
    """rad"""
    V: Any
    """V rms"""
    beyond: Any
    """1"""


def current_at_reference(view: LimiterView, R: Any, X: Any, Z_v: Any, omega_C: Any) -> tuple[Any, Any]:
    """Converter current with which the voltage would reach its reference (:eq:`test-current`).

    R and X are the cosine and sine of the impedance angle. Returns (i_d, i_q) in A peak.
    """
    e_d = rms_to_peak(view.V) - view.v_d
    e_q = -view.v_q
    i_d = view.i_g_d - omega_C * view.v_q + (R * e_d + X * e_q) / Z_v
    i_q = view.i_g_q + omega_C * view.v_d + (R * e_q - X * e_d) / Z_v
    return i_d, i_q


def grid_voltage_gate(
    v_d: Any, v_q: Any, v_Z_d: Any, v_Z_q: Any, v_Zg_d: Any, v_Zg_q: Any, v_gate_pk: Any, doubt: Any
) -> Any:
    """How sure it is that there is a grid voltage to follow, from 0 to 1 (:eq:`gate`). All voltages are in V peak.

    v is that of the capacitor node, v_Z the drop from there to the source, and v_Zg the part of it that is behind the
    PCC. ``doubt`` is a share of the impedance.
    """
    gate_sq = v_gate_pk * v_gate_pk
    b_d, b_q = v_d - v_Z_d, v_q - v_Z_q
    behind = (b_d * b_d + b_q * b_q) / (gate_sq + doubt * doubt * (v_Z_d * v_Z_d + v_Z_q * v_Z_q))
    # A short circuit may have cut off a part x of the grid's impedance. The voltage there is b plus x times the drop;
    # here it is least.
    drop_sq = np.maximum(v_Zg_d * v_Zg_d + v_Zg_q * v_Zg_q, 1e-18)
    x = np.minimum(np.maximum(-(b_d * v_Zg_d + b_q * v_Zg_q) / drop_sq, 0.0), 1.0)
    b_d, b_q = b_d + x * v_Zg_d, b_q + x * v_Zg_q
    least = (b_d * b_d + b_q * b_q) / gate_sq
    # The first term closes altogether, the second only nearly: a grid that is whole looks like a short circuit for a
    # moment when its phase jumps by half a turn.
    return np.minimum(np.maximum(np.minimum(behind - 1.0, 0.5 * least), 0.0), 1.0)


def way_back(beyond: Any, soft: Any, across: Any, along: Any, turn_d: Any, turn_q: Any, step: Any) -> Any:
    """How long the angle has been beyond the largest power at the soft limit; 1: it is on its way back
    (:eq:`way-back`).

    along and across are those of :func:`no_angle_carries`, turn the cosine and sine of the impedance angle. ``beyond``
    is the answer of the last sample, ``soft`` whether the soft limit acts while the grid has a voltage, and ``step``
    what one sample adds.
    """
    slope = across * turn_d + along * turn_q
    # A converter that is held at the soft limit touches it in most samples and not in all: the time counts back then.
    counted = 1.0 * (slope < 0.0) * np.minimum(np.maximum(beyond + step * (2.0 * soft - 1.0), 0.0), 1.0)
    # It ends half-way between the largest power and the angle of the grid: sin(δ + α) > sin(α/2).
    half_way = 0.5 * (1.0 - turn_d) * (across * across + along * along)
    arrived = 1.0 * (slope > 0.0) * (slope * slope > half_way)
    return np.maximum(counted, 1.0 * (beyond >= 1.0) * (1.0 - arrived))


def no_angle_carries(P: Any, v_d: Any, v_q: Any, along: Any, across: Any, Z: Any, turn_d: Any) -> Any:
    """1 where the voltage v does not carry the power P at any angle to the grid's, else 0 (:eq:`no-angle`).

    along + j across is v times the conjugate of the grid's voltage, counted as a three-phase power times one ohm, Z the
    length of the impedance and turn_d the cosine of its angle.
    """
    own, _ = instantaneous_power(v_d, v_q, v_d, v_q)
    missing = P * Z - own * turn_d
    return 1.0 * (missing * missing > along * along + across * across)


def rest_exists(P: Any, v_ref: Any, v_g_d: Any, v_g_q: Any, Z: Any, turn_d: Any) -> Any:
    """1 where some angle carries the power P with the voltage at its reference v_ref, else 0 (:eq:`way-back`).

    v_g is the grid's voltage, V peak, Z the length of the impedance and turn_d the cosine of its angle. The estimate
    may be wrong, so that three tenths more than the largest power count as carried.
    """
    own, _ = instantaneous_power(v_ref, 0.0, v_ref, 0.0)
    across_sq, _ = instantaneous_power(v_g_d, v_g_q, v_g_d, v_g_q)
    missing = P * Z - own * turn_d
    return 1.0 * (missing * missing <= CARRIED * CARRIED * own * across_sq)


def low_voltage(v_d: Any, v_q: Any, V_pk: Any) -> Any:
    """How low a voltage is: 1 up to V_pk, 0 from √2 V_pk on, between them by its square (:eq:`no-angle`). V peak."""
    return np.minimum(np.maximum(2.0 - (v_d * v_d + v_q * v_q) / (V_pk * V_pk), 0.0), 1.0)


def within_bridge(i_d: Any, i_q: Any, v_g_d: Any, v_g_q: Any, R: Any, X: Any, u_max: Any, acts: Any) -> tuple[Any, Any]:
    """The current without the part for which the bridge has no voltage (:eq:`bridge-current`). Returns (i_d, i_q).

    ``R`` and ``X`` lie between the bridge and the grid's voltage v_g, Ω; ``u_max`` is the largest voltage of the
    bridge, V peak. ``acts``: 1 where a limit acts while the bridge is at its own, else 0: the current is the given one.
    """
    u_d = v_g_d + R * i_d - X * i_q
    u_q = v_g_q + R * i_q + X * i_d
    u = np.sqrt(np.maximum(u_d * u_d + u_q * u_q, u_max * u_max))
    share = acts * (u - u_max) / (u * np.maximum(R * R + X * X, 1e-18))
    return i_d - share * (R * u_d + X * u_q), i_q - share * (R * u_q - X * u_d)


def projection_limit(
    memory: ProjectionMemory,
    view: LimiterView,
    grid: GridEstimate,
    refs: References,
    gains: PowerLoopGains,
    settings: ControllerSettings,
) -> LimitedSample:
    """Both limits of one sample: the projection of the voltage reference and the circular limit of the current
    (:eq:`projection`, :eq:`turned-error`, :eq:`gate`, :eq:`one-sided-power`, :eq:`way-back`, :eq:`no-angle`,
    :eq:`full-bridge`, :eq:`bridge-current`)."""
    c = settings.limiter
    R = grid.R_g + c.R_2
    X = refs.omega_0 * (grid.L_g + c.L_2)
    Z = np.sqrt(np.maximum(R * R + X * X, 1e-18))
    turn_d = R / Z
    turn_q = X / Z
    now_d, now_q = current_at_reference(view, turn_d, turn_q, c.Z_v, settings.omega_C)
    i_w_d = memory.i_w_d + c.smoothing_i * (now_d - memory.i_w_d)
    i_w_q = memory.i_w_q + c.smoothing_i * (now_q - memory.i_w_q)
    v_d = memory.v_d + c.smoothing_i * (view.v_d - memory.v_d)
    v_q = memory.v_q + c.smoothing_i * (view.v_q - memory.v_q)
    # Below the soft limit every term that follows is an exact zero, so that the limiter changes no bit.
    length_sq = i_w_d * i_w_d + i_w_q * i_w_q
    soft = 1.0 * (length_sq > c.i_soft_pk * c.i_soft_pk)
    excess = soft * (c.i_soft_pk / np.sqrt(np.maximum(length_sq, c.i_soft_pk * c.i_soft_pk)) - 1.0)
    cut_d = excess * i_w_d
    cut_q = excess * i_w_q
    v_ref = rms_to_peak(view.V)
    u_d = v_ref + c.Z_v * (turn_d * cut_d - turn_q * cut_q)
    u_q = c.Z_v * (turn_d * cut_q + turn_q * cut_d)
    angle = np.arctan2(u_q, u_d)
    # Where the grid may have no voltage, there is no angle to follow and no power that means anything: the gate closes,
    # and the power loops rest.
    i_d, i_q, X_g = view.i_g_d, view.i_g_q, refs.omega_0 * grid.L_g
    v_Z_d, v_Z_q = R * i_d - X * i_q, R * i_q + X * i_d
    v_Zg_d, v_Zg_q = grid.R_g * i_d - X_g * i_q, grid.R_g * i_q + X_g * i_d
    gate = grid_voltage_gate(v_d, v_q, v_Z_d, v_Z_q, v_Zg_d, v_Zg_q, c.v_gate_pk, c.doubt)
    V_admitted = peak_to_rms(np.sqrt(np.maximum(u_d * u_d + u_q * u_q, 1e-12 * v_ref * v_ref)))
    V_wanted = np.maximum(V_admitted, np.minimum(view.V, refs.V_n))
    # P may not drive θ away from the admitted voltage.
    missing = refs.P_ref + gains.D_p * (refs.omega_0 - memory.omega) - view.P
    away = 1.0 * (u_q * missing < 0.0)
    # v times the conjugate of the grid's voltage has the angle δ. Beyond the largest power that the grid carries or
    # gives, the power loops push the angle the wrong way, and where no angle carries the power, they push for ever.
    along, across = instantaneous_power(v_d, v_q, v_d - v_Z_d, v_q - v_Z_q)
    # With a power that no angle carries, even with the voltage at its reference, there is no rest to go back to.
    carried = rest_exists(view.P + missing, v_ref, v_d - v_Z_d, v_q - v_Z_q, Z, turn_d)
    # The time counts only where the grid has a voltage for certain: in a deep sag, a wrong estimate makes one up that
    # turns with the converter, and the way to its angle never ends.
    counts = soft * (gate >= CERTAIN)
    beyond = carried * way_back(memory.beyond, counts, across, along, turn_d, turn_q, c.beyond_step)
    returning = 1.0 * (beyond >= 1.0)
    no_angle = no_angle_carries(view.P + missing, v_d, v_q, along, across, Z, turn_d)
    low = low_voltage(v_d - v_Z_d, v_q - v_Z_q, LOW_VOLTAGE * c.v_gate_pk)
    held = np.maximum(np.maximum(soft * (1.0 - gate), no_angle * np.maximum(1.0 - gate, low)), returning)
    share_P = np.maximum(away, held)
    missing_Q = refs.Q_ref + gains.D_q * (refs.V_n - view.V) - view.Q

    i_ref_d, i_ref_q = limit_length(view.i_want_d, view.i_want_q, settings.i_max_pk)
    want_sq = view.i_want_d * view.i_want_d + view.i_want_q * view.i_want_q
    hard = 1.0 * (want_sq > settings.i_max_pk * settings.i_max_pk)
    i_ref_d, i_ref_q = within_bridge(
        i_ref_d,
        i_ref_q,
        v_d - v_Z_d,
        v_q - v_Z_q,
        R,
        X + settings.omega_L,
        settings.v_max_pk,
        np.maximum(soft, hard) * view.full,
    )
    i_ref_d, i_ref_q = limit_length(i_ref_d, i_ref_q, settings.i_max_pk)
    # While both limits act, the integrators take up the turned error. The hard limit alone clips the crests of a
    # distorted current: what it removed is given back, because the anti-windup would rectify it. Where the bridge is at
    # its own limit, the voltage cannot be reached: nothing is given back, and V goes down to the voltage that there is.
    added_d = soft * (turn_d * view.e_d + turn_q * view.e_q - view.e_d)
    added_q = soft * (turn_d * view.e_q - turn_q * view.e_d - view.e_q)
    short = hard * (1.0 - soft) * view.full
    given_back = (1.0 - soft) * (1.0 - short)
    back_d = given_back * (view.i_want_d - i_ref_d) / view.K_pv
    back_q = given_back * (view.i_want_q - i_ref_q) / view.K_pv
    V_made = peak_to_rms(np.sqrt(np.maximum(v_d * v_d + v_q * v_q, 1e-12 * v_ref * v_ref)))
    return LimitedSample(
        i_ref_d=i_ref_d,
        i_ref_q=i_ref_q,
        e_d=view.e_d + hard * (added_d + back_d),
        e_q=view.e_q + hard * (added_q + back_q),
        P=view.P + share_P * missing,
        Q=view.Q + held * missing_Q,
        limited=np.maximum(np.maximum(soft, hard), 1.0 * (held > 0.0)),
        notes=ProjectionNotes(
            i_w_d=i_w_d,
            i_w_q=i_w_q,
            v_d=v_d,
            v_q=v_q,
            theta=c.share * gate * angle - returning * c.back_share * gate * np.arctan2(across, along),
            V=c.share * (soft * (V_wanted - view.V) + short * np.minimum(V_made - view.V, 0.0)),
            beyond=beyond,
        ),
    )


def projection_move(
    memory: ProjectionMemory,
    sample: LimitedSample,
    view: LimiterView,
    omega: Any,
    steps: IntegratorSteps,
    settings: ControllerSettings,
) -> Any:
    """Adds the pulls to the steps of the power loops and keeps V within its limits (:eq:`pulls`)."""
    c = settings.limiter
    pull = sample.notes.theta
    followed = c.g * np.minimum(np.maximum(pull, -c.largest_pull), c.largest_pull)
    # The pull ends at the limits of the frequency: in an island, the voltage that it follows is the converter's own.
    slower = np.minimum(c.omega_low - omega, 0.0)
    faster = np.maximum(c.omega_high - omega, 0.0)
    followed = np.minimum(np.maximum(followed, slower), faster)
    V_step = np.minimum(np.maximum(steps.V + sample.notes.V, c.V_low - view.V), c.V_high - view.V)
    taken = IntegratorSteps(theta=steps.theta + pull, omega_i=steps.omega_i + followed, V=V_step)
    return taken, ProjectionMemory(
        i_w_d=sample.notes.i_w_d,
        i_w_q=sample.notes.i_w_q,
        v_d=sample.notes.v_d,
        v_q=sample.notes.v_q,
        omega=omega,
        beyond=sample.notes.beyond,
    )


def projection_at_rest(view: LimiterView, omega: Any, settings: ControllerSettings) -> ProjectionMemory:
    """The memory of a steady state, in which the voltage is at its reference. Returns (memory)."""
    i_w_d = view.i_g_d - settings.omega_C * view.v_q
    i_w_q = view.i_g_q + settings.omega_C * view.v_d
    return ProjectionMemory(i_w_d=i_w_d, i_w_q=i_w_q, v_d=view.v_d, v_q=view.v_q, omega=omega, beyond=0.0)


def projection_constants(ratings: LimiterRatings, values: Mapping[str, float]) -> ProjectionConstants:
    """The constants of a converter from its ratings and the limiter's parameters."""
    T_s, g, V_rated = ratings.T_s, values["frequency_pull"], peak_to_rms(ratings.V_rated_pk)
    return ProjectionConstants(
        i_soft_pk=values["soft_limit_pu"] * ratings.I_rated_pk,
        Z_v=values["virtual_impedance_pu"] * ratings.Z_base,
        smoothing_i=low_pass_share(values["filter_time"], T_s),
        share=low_pass_share(values["pull_time"], T_s),
        g=g,
        largest_pull=2.0 * math.pi * values["largest_rocof"] * T_s / g if g > 0.0 else 0.0,
        omega_low=ratings.omega_0 - 2.0 * math.pi * values["frequency_range"],
        omega_high=ratings.omega_0 + 2.0 * math.pi * values["frequency_range"],
        v_gate_pk=values["gate_voltage_pu"] * ratings.V_rated_pk,
        doubt=values["impedance_doubt"],
        V_low=values["V_low_pu"] * V_rated,
        V_high=values["V_high_pu"] * V_rated,
        R_2=ratings.R_2,
        L_2=ratings.L_2,
        beyond_step=T_s / BEYOND_S,
        back_share=low_pass_share(WAY_BACK_S, T_s),
    )


PROJECTION = Limiter(
    "projection",
    LimiterLaw(projection_limit, projection_move),
    projection_constants,
    projection_at_rest,
    rests=True,
    parameters=(
        LimiterParameter(
            "soft_limit_pu",
            "1",
            low=Rule(lambda known: 0.7 * known.ratings.limit_pu, "0.7 I_max"),
            high=Rule(lambda known: known.ratings.limit_pu, "I_max"),
            default=Rule(lambda known: 1.15 / 1.2 * known.ratings.limit_pu, "1.15/1.2 of I_max"),
            meaning="current from which on the power loops are pulled, pu of the rated peak",
        ),
        LimiterParameter(
            "virtual_impedance_pu",
            "1",
            low=always(0.02),
            high=always(0.6),
            default=always(0.2),
            meaning="impedance that turns a voltage error into a current, pu",
        ),
        LimiterParameter(
            "filter_time",
            "s",
            low=always(0.0),
            high=always(0.02),
            default=always(3e-3),
            meaning="time constant of the test current's low-pass; 0 means no filter",
        ),
        LimiterParameter(
            "pull_time",
            "s",
            low=Rule(lambda known: max(5e-3, 2.0 * known.ratings.T_s), "0.005 or two samples"),
            high=always(0.2),
            default=always(20e-3),
            meaning="time constant with which θ and V follow",
        ),
        LimiterParameter(
            "frequency_pull",
            "1/s",
            low=always(0.0),
            high=Rule(lambda known: 0.25 / known.values["pull_time"], "1/(4 `pull_time`)"),
            default=Rule(lambda known: min(10.0, 0.25 / known.values["pull_time"]), "10, or that limit"),
            meaning="how the frequency integrator follows the pull of θ",
        ),
        LimiterParameter(
            "largest_rocof",
            "Hz/s",
            low=always(0.1),
            high=always(50.0),
            default=Rule(lambda _: 20.0 / (2.0 * math.pi), "20/(2π)"),
            meaning="largest rate at which the frequency integrator is pulled",
        ),
        LimiterParameter(
            "frequency_range",
            "Hz",
            low=always(0.1),
            high=Rule(lambda known: 0.2 * known.ratings.omega_0 / (2.0 * math.pi), "0.2 f_n"),
            default=Rule(lambda known: 0.05 * known.ratings.omega_0 / (2.0 * math.pi), "0.05 f_n"),
            meaning="deviation from the nominal frequency beyond which ω_i is not pulled",
        ),
        LimiterParameter(
            "gate_voltage_pu",
            "1",
            low=always(0.01),
            high=always(0.5),
            default=always(0.15),
            meaning="grid voltage that counts as none, pu",
        ),
        LimiterParameter(
            "impedance_doubt",
            "1",
            low=always(0.0),
            high=always(0.9),
            default=always(0.4),
            meaning="error of the grid impedance that the gate allows for, a share of its length",
        ),
        LimiterParameter(
            "V_low_pu",
            "1",
            low=always(0.0),
            high=Rule(lambda known: known.ratings.V_low_pu, "`V_min_pu`"),
            default=Rule(lambda known: max(known.ratings.V_low_pu - 0.15, 0.0), "`V_min_pu` − 0.15"),
            meaning="least voltage that the Q loop may ask for, pu",
        ),
        LimiterParameter(
            "V_high_pu",
            "1",
            low=Rule(lambda known: known.ratings.V_high_pu, "`V_max_pu`"),
            high=always(3.0),
            default=Rule(lambda known: known.ratings.V_high_pu + 0.05, "`V_max_pu` + 0.05"),
            meaning="largest voltage that the Q loop may ask for, pu",
        ),
    ),
)
"""The limiter that survives: the recommended choice for a grid-forming converter with a current limit."""
