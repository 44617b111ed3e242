"""The power loops as they run on the controller, one sample at a time. The EMT compiles the same function.

``guarded_step`` is the whole controller with its guards, as the exported C runs it.
"""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.equations.controller import (
    LARGEST_STATE,
    TIMES_NOMINAL,
    controller_step,
    plausible,
    power_stage,
    skipped_step,
    sound,
)
from vsgdesign.equations.controller_data import (
    ControllerOutput,
    ControllerSettings,
    ControllerState,
    Measurement,
    flat_state,
)
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.integration import advanced, within_a_turn
from vsgdesign.equations.limiters import GridEstimate, Limiter, LimiterView
from vsgdesign.equations.power_loops import (
    NO_NOTCH,
    NotchConstants,
    PowerLoopGains,
    References,
    frequency_at_rest,
    gain_transfer,
    notch,
)
from vsgdesign.errors import ArtifactError


def state_at_set_points(refs: References, gains: PowerLoopGains) -> ControllerState:
    """The state with which a converter begins: at rest at its set points, with the integrators of its inner loops at
    zero."""
    return ControllerState(
        theta=0.0,
        omega_i=frequency_at_rest(refs, gains),
        V=refs.V_n,
        P_f=refs.P_ref,
        Q_f=refs.Q_ref,
        xi_vd=0.0,
        xi_vq=0.0,
        xi_id=0.0,
        xi_iq=0.0,
        mean_P=refs.P_ref,
        mean_Q=refs.Q_ref,
    )


class PowerController:
    """Power filters and power loops of any structure (:eq:`controller-step`, :eq:`power-loop-law`).

    T_s is in s. ``smoothing_P`` and ``smoothing_Q`` are 1 − exp(−T_s/τ) of the power filters, or 1 without a filter.
    ``before`` is a notch before these filters (:eq:`notch`). The controller starts with ω_0 and V_n of the references,
    with P and Q at their set points and with θ = 0.
    """

    def __init__(
        self,
        gains: PowerLoopGains,
        refs: References,
        T_s: float,
        smoothing_P: float = 1.0,
        smoothing_Q: float = 1.0,
        before: NotchConstants = NO_NOTCH,
    ) -> None:
        if not (T_s > 0.0 and 0.0 < smoothing_P <= 1.0 and 0.0 < smoothing_Q <= 1.0):
            raise ArtifactError(
                f"T_s = {T_s:g} s, smoothing_P = {smoothing_P:g}, smoothing_Q = {smoothing_Q:g}: the period must be "
                "positive, the smoothing above 0 and at most 1."
            )
        self.gains, self.refs = gains, refs
        # The power loops use nothing else of the settings and of the state, since the inner loops are not part of them.
        unused = dict.fromkeys(("omega_C", "omega_L", "i_max_pk", "v_max_pk", "advance_cos", "advance_sin"), 0.0)
        self._settings = ControllerSettings(
            T_s=T_s,
            smoothing_P=smoothing_P,
            smoothing_Q=smoothing_Q,
            notch_gain=before.gain,
            notch_step=before.step,
            notch_back=before.back,
            **unused,
        )
        self._state = state_at_set_points(refs, gains)

    def step(self, P: float, Q: float) -> tuple[float, float, float]:
        """Takes one sample of P (W) and Q (var) and returns ω (rad/s), V (V rms) and θ (rad) of this sample.

        The integrators then advance by T_s, as in the simulation. If P or Q is no number, the filters of both keep
        their values in this sample.
        """
        s = self._state
        c = self._settings
        if abs(P) + abs(Q) <= LARGEST_STATE:
            P, ripple_P, mean_P = notch(P, s.ripple_P, s.mean_P, c.notch_gain, c.notch_step, c.notch_back)
            Q, ripple_Q, mean_Q = notch(Q, s.ripple_Q, s.mean_Q, c.notch_gain, c.notch_step, c.notch_back)
            s = s._replace(ripple_P=ripple_P, ripple_Q=ripple_Q, mean_P=mean_P, mean_Q=mean_Q)
        else:
            P, Q = s.P_f, s.Q_f
        omega, P_f, Q_f, steps = power_stage(s, P, Q, self.refs, self.gains, c)
        self._state = s._replace(
            theta=within_a_turn(advanced(s.theta, steps.theta)),
            omega_i=advanced(s.omega_i, steps.omega_i),
            V=advanced(s.V, steps.V),
            P_f=P_f,
            Q_f=Q_f,
        )
        return omega, s.V, s.theta

    def retune(self, gains: PowerLoopGains) -> None:
        """Changes the gains from the next sample on. What is at rest stays at rest (:eq:`gain-transfer`).

        Set new references (``refs``) after it, not before.
        """
        omega_i = sound_transfer(self._state.omega_i, self.refs, self.gains, gains)
        self._state, self.gains = self._state._replace(omega_i=omega_i), gains

    def state(self) -> dict[str, Any]:
        """The state θ, ω_i, V, P_f, Q_f, that of the notch and the gains, in JSON's types."""
        named = {name: float(getattr(self._state, name)) for name in _STATES}
        return named | {"gains": [float(value) for value in self.gains]}

    def restore(self, document: dict[str, Any]) -> None:
        """Continues from a document of :meth:`state` with the same bits.

        A document from before there was a notch leaves it at rest. Raises ArtifactError if it is no such state.
        """
        try:
            at_rest = {"ripple_P": 0.0, "ripple_Q": 0.0, "mean_P": document["P_f"], "mean_Q": document["Q_f"]}
            values = {name: float((at_rest | document)[name]) for name in _STATES}
            gains = PowerLoopGains(*(float(value) for value in document["gains"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ArtifactError(f"state of the power controller: {error}; start afresh.") from error
        self._state, self.gains = self._state._replace(**values), gains


_STATES = ("theta", "omega_i", "V", "P_f", "Q_f", "ripple_P", "ripple_Q", "mean_P", "mean_Q")


def sound_transfer(omega_i: float, refs: References, old: PowerLoopGains, new: PowerLoopGains) -> float:
    """:func:`gain_transfer`; where its result is not :func:`sound`, ω_i begins anew at :func:`frequency_at_rest`."""
    kept = float(gain_transfer(omega_i, refs, old, new))
    return kept if abs(kept) <= TIMES_NOMINAL * refs.omega_0 else float(frequency_at_rest(refs, new))


def guarded_step(
    state: ControllerState,
    measured: Measurement,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    limiter: Limiter,
) -> tuple[ControllerState, ControllerOutput, bool]:
    """:func:`controller_step`, or :func:`skipped_step` where the sample cannot be used: the next state, the output of
    this sample, and whether it was used.

    A sample cannot be used if it is not :func:`plausible`, or if the next state would not be :func:`sound` and finite.
    In the second case integrators, filters and limiter begin anew at rest, so that they cannot stay where every step
    is refused.
    """
    if plausible(measured, settings) > 0.5:
        following, output = controller_step(
            state, measured, grid, refs, power_gains, inner_gains, settings, limiter.law
        )
        finite = math.fsum(map(abs, flat_state(following))) <= LARGEST_STATE
        if finite and sound(following, output.omega, refs, settings) > 0.5:
            return following, output, True
    following, output = skipped_step(state, refs, power_gains, settings)
    omega_i = float(frequency_at_rest(refs, power_gains))
    if plausible(measured, settings) > 0.5 and abs(omega_i) <= TIMES_NOMINAL * refs.omega_0:
        nothing = dict.fromkeys(("xi_vd", "xi_vq", "xi_id", "xi_iq", "ripple_P", "ripple_Q"), 0.0)
        powers = {"P_f": refs.P_ref, "Q_f": refs.Q_ref, "mean_P": refs.P_ref, "mean_Q": refs.Q_ref}
        view = LimiterView(**dict.fromkeys(LimiterView._fields, 0.0) | {"V": refs.V_n, "omega_i": omega_i})
        memory = limiter.at_rest(view, refs.omega_0, settings)
        following = following._replace(omega_i=omega_i, V=refs.V_n, limiter=memory, **nothing, **powers)
    return following, output, False
