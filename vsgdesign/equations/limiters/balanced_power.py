"""Balanced power: the limiter `projection`, with a sequence controller that takes the ripple out of the power.

A grid-forming converter holds a balanced voltage. In an unbalanced fault its power then ripples at twice the grid's
frequency (:eq:`power-ripple`), and so does the voltage of a small dc capacitor (:eq:`link-ripple`). This controller
adds a negative sequence to the voltage reference, of the size and angle with which the power of the bridge does not
ripple. docs/theory/balanced-power.md derives the law.
"""

from __future__ import annotations

import cmath
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import ControllerSettings
from vsgdesign.equations.frames import SPACE_VECTOR_POWER, instantaneous_power, rotate
from vsgdesign.equations.inner_loops import limit_length
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
from vsgdesign.equations.limiters.projection import (
    PROJECTION,
    ProjectionMemory,
    projection_at_rest,
    projection_constants,
    projection_limit,
    projection_move,
)
from vsgdesign.equations.power_loops import PowerLoopGains, References, notch, notch_constants

CERTAIN_SHARE = 0.5
"""Share of the estimated grid impedance that the controller counts with: a fault may have cut off any part of it."""

RIPPLE_DAMPING = 0.5
"""Damping ratio of the notch that separates the ripple of the power from its mean."""

GIVES_WAY = 0.2
"""Share of the negative sequence that a sample takes away while the bridge is at its limit."""

FORGETTING_S = 1.0
"""Time constant with which the negative sequence fades where the power does not ripple, s."""


class BalancedMemory(NamedTuple):
    """What the limiter remembers: the memory of `projection`, and that of the sequence controller."""

    i_w_d: Any
    i_w_q: Any
    """Test current behind its low-pass, A peak."""
    v_d: Any
    v_q: Any
    """Positive sequence of the capacitor-node voltage behind the same low-pass, V peak."""
    omega: Any
    """Frequency of the last sample, rad/s."""
    beyond: Any
    """Time beyond the largest power at the soft limit, as a share of BEYOND_S."""
    ripple: Any
    """Ripple of the bridge's power at twice the grid's frequency, as the notch predicts it for this sample, W."""
    mean: Any
    """What the notch holds for the rest of this power, W."""
    i_s_sq: Any
    """Square of the converter current of the last sample, A²."""
    nu_d: Any
    nu_q: Any
    """Negative sequence that is added to the voltage reference, V peak."""


class BalancedSample(NamedTuple):
    """What ``balanced_limit`` answers: the fields of :class:`LimitedSample`, and what ``balanced_move`` needs."""

    i_ref_d: Any
    i_ref_q: Any
    """Converter current that the current loop gets, A peak."""
    e_d: Any
    e_q: Any
    """Error that the integrators of the voltage loop take up, V peak."""
    P: Any
    Q: Any
    """Powers that go on to the power loops, W and var."""
    limited: Any
    """1 where the limiter acts in this sample, else 0."""
    found: LimitedSample
    """The answer of `projection`."""
    grid: GridEstimate


class BalancedConstants(NamedTuple):
    """Constants of the limiter: those of `projection`, and those of the sequence controller."""

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
    ripple_gain: Any
    ripple_step: Any
    ripple_back: Any
    """Constants of the notch that finds the ripple."""
    per_reactance: Any
    """1.5/(2 ω₀ T_s), 1: over a reactance and a change of the squared current, the power of the inductor."""
    untouched: Any
    """Ripple below which the controller does nothing, W."""
    least: Any
    """Ripple that counts as zero, W."""
    of_grid_d: Any
    of_grid_q: Any
    """Step of the negative sequence over a ripple and the impedance of the grid, A/W."""
    own_d: Any
    own_q: Any
    """Step of the negative sequence over a ripple, for the impedance of the voltage loop itself, V/W."""
    turn_d: Any
    turn_q: Any
    """What one sample makes of the negative sequence, 1: it turns by −2 ω_n T_s and fades."""
    omega_n: Any
    """Nominal frequency, rad/s."""
    nu_max_pk: Any
    """Largest negative sequence of the reference, V peak."""


def bridge_power(view: LimiterView, to_inductor: Any) -> Any:
    """Power of the bridge in W (:eq:`bridge-power`): that at the capacitor, and what the inductor takes up."""
    p, _ = instantaneous_power(view.v_d, view.v_q, view.i_s_d, view.i_s_q)
    return p + to_inductor


def beyond_dead_zone(ripple: Any, untouched: Any, least: Any) -> Any:
    """The ripple without a dead zone around zero, W (:eq:`ripple-dead-zone`); it is an exact zero within. ``least`` is
    a ripple that counts as zero."""
    size = np.sqrt(np.maximum(ripple * ripple, least * least))
    return ripple * (np.maximum(size - untouched, 0.0) / size)


def of_projection(memory: BalancedMemory) -> ProjectionMemory:
    """The part of the memory that is that of `projection`. Returns (memory)."""
    return ProjectionMemory(
        i_w_d=memory.i_w_d,
        i_w_q=memory.i_w_q,
        v_d=memory.v_d,
        v_q=memory.v_q,
        omega=memory.omega,
        beyond=memory.beyond,
    )


def balanced_limit(
    memory: BalancedMemory,
    view: LimiterView,
    grid: GridEstimate,
    refs: References,
    gains: PowerLoopGains,
    settings: ControllerSettings,
) -> BalancedSample:
    """The limits of `projection` around a reference with a negative sequence (:eq:`balanced-reference`)."""
    # Without a negative sequence every term is that of `projection` to the bit. `projection` sees the voltage without
    # it: it is no error of the voltage, and no overload.
    seen = view._replace(
        v_d=view.v_d - memory.nu_d,
        v_q=view.v_q - memory.nu_q,
        e_d=view.e_d + memory.nu_d,
        e_q=view.e_q + memory.nu_q,
        i_want_d=view.i_want_d + view.K_pv * memory.nu_d,
        i_want_q=view.i_want_q + view.K_pv * memory.nu_q,
    )
    found = projection_limit(of_projection(memory), seen, grid, refs, gains, settings)
    return BalancedSample(
        i_ref_d=found.i_ref_d,
        i_ref_q=found.i_ref_q,
        # The integrators also take up i_ref − i_want, which contains the negative sequence.
        e_d=found.e_d - memory.nu_d,
        e_q=found.e_q - memory.nu_q,
        P=found.P,
        Q=found.Q,
        limited=found.limited,
        found=found,
        grid=grid,
    )


def balanced_move(
    memory: BalancedMemory,
    sample: BalancedSample,
    view: LimiterView,
    omega: Any,
    steps: IntegratorSteps,
    settings: ControllerSettings,
) -> Any:
    """The steps of `projection` (:eq:`pulls`), and the negative sequence of the next sample (:eq:`balanced-power`)."""
    c = settings.limiter
    taken, after = projection_move(of_projection(memory), sample.found, view, omega, steps, settings)
    i_s_sq = view.i_s_d * view.i_s_d + view.i_s_q * view.i_s_q
    power = bridge_power(view, c.per_reactance * settings.omega_L * (i_s_sq - memory.i_s_sq))
    _, ripple, mean = notch(power, memory.ripple, memory.mean, c.ripple_gain, c.ripple_step, c.ripple_back)
    # While a limit acts, clipped currents ripple as well: the negative sequence then stays, and where the bridge has no
    # voltage for it, it gives way.
    answered = (1.0 - sample.found.limited) * beyond_dead_zone(ripple, c.untouched, c.least)
    turned_d, turned_q = rotate(memory.nu_d, memory.nu_q, c.turn_d, c.turn_q)
    # The constants turn it against the nominal frequency, and the frame turns with another one.
    late = 2.0 * settings.T_s * (omega - c.omega_n)
    # The reactance of the negative sequence is −X in the frame of the converter.
    R = c.R_2 + CERTAIN_SHARE * sample.grid.R_g
    X = c.omega_n * (c.L_2 + CERTAIN_SHARE * sample.grid.L_g)
    step_d, step_q = rotate(R, -X, c.of_grid_d, c.of_grid_q)
    nu_d = turned_d + late * turned_q - (step_d + c.own_d) * answered
    nu_q = turned_q - late * turned_d - (step_q + c.own_q) * answered
    kept = 1.0 - GIVES_WAY * view.full
    nu_d, nu_q = limit_length(kept * nu_d, kept * nu_q, c.nu_max_pk)
    return taken, BalancedMemory(
        i_w_d=after.i_w_d,
        i_w_q=after.i_w_q,
        v_d=after.v_d,
        v_q=after.v_q,
        omega=after.omega,
        beyond=after.beyond,
        ripple=ripple,
        mean=mean,
        i_s_sq=i_s_sq,
        nu_d=nu_d,
        nu_q=nu_q,
    )


def balanced_at_rest(view: LimiterView, omega: Any, settings: ControllerSettings) -> BalancedMemory:
    """The memory of a balanced steady state: no ripple, and no negative sequence. Returns (memory)."""
    rest = projection_at_rest(view, omega, settings)
    i_s_sq = view.i_s_d * view.i_s_d + view.i_s_q * view.i_s_q
    return BalancedMemory(
        i_w_d=rest.i_w_d,
        i_w_q=rest.i_w_q,
        v_d=rest.v_d,
        v_q=rest.v_q,
        omega=rest.omega,
        beyond=rest.beyond,
        ripple=0.0,
        mean=bridge_power(view, 0.0),
        i_s_sq=i_s_sq,
        nu_d=0.0,
        nu_q=0.0,
    )


def balanced_constants(ratings: LimiterRatings, values: Mapping[str, float]) -> BalancedConstants:
    """The constants of a converter from its ratings, its inner loops and the limiter's parameters."""
    T_s, omega_n = ratings.T_s, ratings.omega_0
    found = notch_constants(2.0 * omega_n, RIPPLE_DAMPING, T_s)
    rate = T_s / (values["balance_time"] * 0.5 * SPACE_VECTOR_POWER * ratings.V_rated_pk)
    of_grid, own = negative_sequence_of_loop(ratings)
    turn = cmath.exp(-T_s / FORGETTING_S - 2j * omega_n * T_s)
    S = SPACE_VECTOR_POWER * ratings.V_rated_pk * ratings.I_rated_pk
    return BalancedConstants(
        *projection_constants(ratings, values),
        ripple_gain=found.gain,
        ripple_step=found.step,
        ripple_back=found.back,
        per_reactance=0.5 * SPACE_VECTOR_POWER / (omega_n * T_s),
        untouched=values["untouched_ripple_pu"] * S,
        least=1e-6 * S,
        of_grid_d=rate * of_grid.real,
        of_grid_q=rate * of_grid.imag,
        own_d=rate * own.real,
        own_q=rate * own.imag,
        turn_d=turn.real,
        turn_q=turn.imag,
        omega_n=omega_n,
        nu_max_pk=values["negative_sequence_pu"] * ratings.V_rated_pk,
    )


def negative_sequence_of_loop(ratings: LimiterRatings) -> tuple[complex, complex]:
    """What the voltage loop makes of a negative sequence in its reference (:eq:`negative-sequence-of-loop`).

    Returns the reference over the voltage, and the loop's own impedance in Ω, in the frame of the converter and with an
    ideal current loop.
    """
    inner = ratings.inner
    if inner is None:
        return 1.0 + 0.0j, 0.0j
    s = -2j * ratings.omega_0
    K = inner.K_pv + inner.K_iv / s
    transient = (inner.R_t + 1j * inner.X_t) * s / (s + ratings.omega_t)
    return 1.0 + s * ratings.C / K, transient + (1.0 - inner.K_ff) / K


BALANCED_POWER = Limiter(
    "balanced_power",
    LimiterLaw(balanced_limit, balanced_move),
    balanced_constants,
    balanced_at_rest,
    rests=True,
    parameters=(
        *PROJECTION.parameters,
        LimiterParameter(
            "balance_time",
            "s",
            low=Rule(lambda known: max(2e-3, 4.0 * known.ratings.T_s), "0.002 or four samples"),
            high=always(0.5),
            default=always(10e-3),
            meaning="time constant with which the ripple of the power goes away",
        ),
        LimiterParameter(
            "untouched_ripple_pu",
            "1",
            low=always(0.0),
            high=always(0.2),
            default=always(0.005),
            meaning="ripple of the power that is left as it is, pu of the rating",
        ),
        LimiterParameter(
            "negative_sequence_pu",
            "1",
            low=always(0.01),
            high=always(1.0),
            default=always(0.5),
            meaning="largest negative sequence of the voltage reference, pu",
        ),
    ),
)
"""`projection` for a converter whose dc side cannot bear the ripple of an unbalanced fault."""
