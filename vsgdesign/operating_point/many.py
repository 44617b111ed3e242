"""The exact steady states of many sampled converters at once, with fixed gains or with gains that follow them.

At a fixed point of the sampled map, plant state and bridge voltage follow linearly from the voltage at the control
point. Between the control point and the source lies then one complex impedance, which is that of the grid but for the
sampling, and the steady state is an operating point on it (:eq:`sampled-path`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.equations.limiters import GridEstimate, IntegratorSteps, LimiterView
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.frames import instantaneous_power, peak_to_rms, rms_to_peak
from vsgdesign.operating_point.droop import points_with_droop
from vsgdesign.operating_point.plant import TwoAxisCircuit, plant_step
from vsgdesign.operating_point.plants import PlantSteps, plant_steps
from vsgdesign.parameters.study import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
GainsOfMany = Callable[[Array, Array, Array], PowerLoopGains]
"""Function of P (W), Q (var) and V (phase rms, V) at the control points, (N,) each, that returns gains of arrays (N,),
with NaN where there are none."""

NO_POINT, BRIDGE_VOLTAGE, CURRENT, LIMITER_ACTS, NOT_CONVERGED, NO_GAINS, LIMITER_PULLS = range(1, 8)
FAULTS = (
    "",
    "no operating point",
    "the steady state needs more bridge voltage than there is",
    "the steady state needs more current than the limit",
    "the current limiter acts in the steady state",
    "the gains follow the measured powers and do not come to rest",
    "no gains",
    "the current limiter pulls the power loops away from the steady state",
)
"""What the codes of :attr:`ManyStates.fault` mean; 0: there is a steady state."""

_ROUNDS = 100
_PLAIN_ROUNDS = 8
"""Rounds before the secant is taken: most lanes need fewer."""
_STARTS = np.array([(1.0, 1.0, 1.0), (1.0, 1.0, 0.85), (1.0, 1.0, 0.7), (0.0, 0.0, 1.0), (1.0, 1.0, 1.25)])
"""Measured P, Q and V with which the first gains are made, as shares of the references and the rated voltage, until
there is a steady state for them."""
_MOST_LOSSES = 10
"""Rounds without a point, as when a step goes too far, after which there is none."""
_LONGEST = 30.0
"""Most of the last step that a secant may add or take back."""
_TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class ManyStates:
    """Steady states of N converters. Lanes whose fault is ``NO_POINT``, ``NOT_CONVERGED`` or ``NO_GAINS`` are NaN."""

    plant: Array
    """(6, N): i_s, v_c, i_g, each as α, β; A and V peak. More rows with a circuit that has more states."""
    controller: ControllerState
    """Every field (N,), those of the limiter's memory too."""
    pending: Array
    """(2, N): bridge voltage that waits out the delay, α and β, V peak."""
    P: Array
    Q: Array
    """(N,): powers at the control point, W and var."""
    V: Array
    """(N,): voltage at the control point, phase rms V."""
    delta: Array
    """(N,): its angle to the source, rad."""
    i_s_pk: Array
    v_b_pk: Array
    """(N,): converter current (A peak) and bridge voltage (V peak)."""
    fault: NDArray[np.int64]
    """(N,): 0, or what is wrong (:data:`FAULTS`)."""

    def __len__(self) -> int:
        return len(self.fault)


class Lanes(NamedTuple):
    """What many steady states are asked for: the first arguments of :func:`many_steady_states`, (N,) each."""

    R_g: Array
    L_g: Array
    V_g_rms: Array
    omega_g: Array
    P_ref: Array
    Q_ref: Array


class _Paths(NamedTuple):
    """What lies between bridge and source in a sampled steady state, for N lanes, with the source at angle zero."""

    known: NDArray[np.bool_]
    """Lanes whose numbers are those of a grid with a voltage; the others hold the numbers of the study's own grid."""
    omega_g: Array
    per_bridge: Complex
    """(N, n): plant state per bridge voltage."""
    from_source: Complex
    """(N, n): plant state without bridge voltage."""
    node_per_bridge: Complex
    node_from_source: Complex
    """(N,): the same for the voltage at the control point."""
    V_rms: Array
    angle: Array
    """Source behind the impedance: phase rms V, and its angle to the grid's source, rad."""
    R: Array
    X: Array
    """Impedance between control point and source as the samples see it, Ω."""


def many_steady_states(  # noqa: PLR0913 - what a steady state depends on
    study: Study,
    R_g: ArrayLike,
    L_g: ArrayLike,
    V_g_rms: ArrayLike,
    omega_g: ArrayLike,
    P_ref: ArrayLike,
    Q_ref: ArrayLike,
    gains: PowerLoopGains,
    phase: float = 0.0,
    *,
    free_of_limits: bool = False,
    circuit: TwoAxisCircuit | None = None,
) -> ManyStates:
    """The steady states that one control period only turns by ω_g·T_s, with the source's phasor at ``phase`` (rad).

    Arguments in SI and the fields of ``gains`` are numbers or (N,), and broadcast. Averaged bridge. A lane without a
    steady state has its reason in ``fault`` and disturbs no other. With ``free_of_limits``, current above the limit is
    no fault: the caller judges it. The limit of the bridge voltage always counts. ``circuit``, with equal axes, stands
    for the filter with all that is connected to it, for one lane only.
    """
    lanes, gains = lanes_of((R_g, L_g, V_g_rms, omega_g, P_ref, Q_ref), gains)
    paths = _paths(study, lanes, circuit)
    V, delta = _points(study, paths, lanes, gains)
    return _states(study, paths, lanes, gains, V, delta, phase, free_of_limits)


def many_rests_with_measured_gains(  # noqa: PLR0913 - the same
    study: Study,
    R_g: ArrayLike,
    L_g: ArrayLike,
    V_g_rms: ArrayLike,
    omega_g: ArrayLike,
    P_ref: ArrayLike,
    Q_ref: ArrayLike,
    gains_of: GainsOfMany,
    phase: float = 0.0,
    *,
    free_of_limits: bool = False,
    circuit: TwoAxisCircuit | None = None,
) -> tuple[ManyStates, PowerLoopGains]:
    """The steady states with the gains that belong to their own P, Q and V, and these gains.

    Gains and steady states are computed in turn until they agree to 1e-10, with secant steps after some rounds. Where
    the droops do not depend on the measured values, the first state is the final one. The other arguments are those of
    :func:`many_steady_states`.
    """
    lanes, _ = lanes_of((R_g, L_g, V_g_rms, omega_g, P_ref, Q_ref), PowerLoopGains(0.0, 0.0, 0.0, 0.0))
    c, paths, count = study.converter, _paths(study, lanes, circuit), len(lanes.R_g)
    scale = np.array([[c.S_rated], [c.S_rated], [c.V_rated_rms]])
    first = np.array([lanes.P_ref, lanes.Q_ref, np.full(count, c.V_rated_rms)])
    measured, losses, step = first.copy(), np.zeros(count, dtype=int), np.ones(count)
    at_last, change_last = (np.full(first.shape, np.nan) for _ in range(2))  # the last ones with a point
    V, delta, fault = np.full(count, np.nan), np.full(count, np.nan), np.zeros(count, dtype=int)
    point_of = np.full((2, count), np.nan)  # P at rest and D_q of the point V, delta

    def gains_now() -> Array:
        return np.array([np.full(count, value, dtype=float) for value in gains_of(*measured)])

    gains, active = gains_now(), np.arange(count)
    for k in range(_ROUNDS):
        missing = ~np.isfinite(gains[:, active]).all(axis=0)
        fault[active[missing]] = NO_GAINS
        active = active[~missing]
        if not active.size:
            break
        some, laws = Lanes._make(value[active] for value in lanes), PowerLoopGains(*gains[:, active])
        P = _power(study, some, laws)
        asked = np.array([P, laws.D_q])
        if not np.array_equal(asked, point_of[:, active]):  # a point depends on nothing else of the gains
            V[active], delta[active] = _points(study, _Paths._make(value[active] for value in paths), some, laws)
            point_of[:, active] = asked
        reached = np.array([P, some.Q_ref + laws.D_q * (c.V_rated_rms - V[active]), V[active]])
        there = np.isfinite(V[active])
        lost, active, reached = active[~there], active[there], reached[:, there]
        # No point with these gains: a shorter step from the last ones that had one, or another start.
        losses[lost] += 1
        begun = np.isfinite(at_last[0, lost])
        hopeless = losses[lost] >= np.where(begun, _MOST_LOSSES, len(_STARTS))
        fault[lost[hopeless]] = NO_POINT
        lost, begun = lost[~hopeless], begun[~hopeless]
        step[lost[begun]] *= 0.5
        shorter = at_last[:, lost] + step[lost] * change_last[:, lost]
        measured[:, lost] = np.where(begun, shorter, first[:, lost] * _STARTS[losses[lost] % len(_STARTS)].T)

        at, change = measured[:, active], reached - measured[:, active]
        measured[:, active] = at + step[active] * change
        if k >= _PLAIN_ROUNDS:
            measured[:, active] = _secant(at, change, at_last[:, active], change_last[:, active], scale)
        at_last[:, active], change_last[:, active] = at, change
        following, before = gains_now(), gains[:, active]
        near = np.abs(following[:, active] - before) <= _TOLERANCE * (np.abs(before) + np.abs(following[:, active]))
        still = (np.abs(change) <= 0.1 * _TOLERANCE * scale).all(axis=0)
        settled = np.where((k < _PLAIN_ROUNDS) & (step[active] == 1.0), near.all(axis=0), still)
        active = np.concatenate([active[~settled], lost])
        gains[:, active] = following[:, active]
    fault[active] = NOT_CONVERGED
    V[fault > 0] = np.nan
    found = PowerLoopGains(*gains)
    return _states(study, paths, lanes, found, V, delta, phase, free_of_limits, fault), found


def _secant(at: Array, change: Array, at_last: Array, change_last: Array, scale: Array) -> Array:
    """Where the change of the measured values vanishes if it goes on as between two rounds; (3, N) all."""
    difference = (change - change_last) / scale
    along = np.sum(change / scale * difference, axis=0) / np.maximum(np.sum(difference * difference, axis=0), 1e-300)
    along = np.clip(along, -_LONGEST, _LONGEST)
    found = at + change - along * (at + change - at_last - change_last)
    return np.where(np.isfinite(found), found, at + change)


def lanes_of(values: Sequence[ArrayLike], gains: PowerLoopGains) -> tuple[Lanes, PowerLoopGains]:
    """Numbers and arrays in the order of :class:`Lanes`, and gains, as arrays of one length."""
    given = [np.asarray(value, dtype=float) for value in (*values, *gains)]
    count = max(value.size for value in given)
    arrays = [np.full(count, value) for value in given]
    return Lanes(*arrays[: len(values)]), PowerLoopGains(*arrays[len(values) :])


def _paths(study: Study, lanes: Lanes, circuit: TwoAxisCircuit | None) -> _Paths:
    """x(k+1) = Φ x + Γ v_b + u v_g and x(k+1) = e^{jω_g T} x: x is affine in v_b, and so is v at the control point."""
    R_g, L_g, V_g_rms, omega_g = lanes[:4]
    known = np.isfinite(R_g) & np.isfinite(L_g) & np.isfinite(V_g_rms) & np.isfinite(omega_g)
    known &= (V_g_rms > 0.0) & (omega_g > 0.0) & (R_g >= 0.0) & (L_g >= 0.0) & (L_g + study.filter.L_2 > 0.0)
    R_g, L_g = np.where(known, R_g, study.grid.R_g), np.where(known, L_g, study.grid.L_g)
    V_g_rms = np.where(known, V_g_rms, study.converter.V_rated_rms)
    omega_g = np.where(known, omega_g, study.converter.omega_n)
    T_s = study.converter.T_s
    if circuit is None:
        steps = plant_steps(study, R_g, L_g, T_s, omega_g)
    else:
        steps = _on_one_axis(circuit, T_s, float(omega_g[0]))
    turn, unit = np.exp(1j * omega_g * T_s), np.eye(steps.bridge.shape[1])
    inverse: Complex = np.asarray(np.linalg.inv(turn[:, None, None] * unit - steps.transition), dtype=complex)
    per_bridge = (inverse @ steps.bridge[..., None])[..., 0]
    from_source = (inverse @ steps.source[:, 0, :, None])[..., 0] * rms_to_peak(V_g_rms)[:, None]
    node_per_bridge, node_from_source = (
        capacitor_node_voltage(x[:, 0], x[:, 1], x[:, 2], study.circuit()) for x in (per_bridge, from_source)
    )
    # i_g = (v - v_source)/Z, with the two numbers that make it so for every v.
    Z = node_per_bridge / per_bridge[:, 2]
    if circuit is not None:  # a load and a grid may be capacitive together: no operating point is known for that
        known &= Z.imag > 0.0
    v_source = node_from_source - Z * from_source[:, 2]
    return _Paths(
        known=known,
        omega_g=omega_g,
        per_bridge=per_bridge,
        from_source=from_source,
        node_per_bridge=node_per_bridge,
        node_from_source=node_from_source,
        V_rms=peak_to_rms(np.abs(v_source)),
        angle=np.angle(v_source),
        R=Z.real,
        X=Z.imag,
    )


def _on_one_axis(circuit: TwoAxisCircuit, h: float, omega: float) -> PlantSteps:
    """The step of a circuit with equal axes as that of one lane."""
    step = plant_step(circuit, h, omega, edges=False)
    source = step.source[:, 0::2, 0] + 1j * step.source[:, 1::2, 0]  # what 1 adds on α, and on β
    return PlantSteps(
        np.array([h]), step.transition[None, 0::2, 0::2], step.bridge[None, 0::2, 0], np.empty((1, 0, 0)), source[None]
    )


def _points(study: Study, paths: _Paths, lanes: Lanes, gains: PowerLoopGains) -> tuple[Array, Array]:
    """V and δ of steady states: both errors of the power loops are zero, and the frequency is the source's."""
    P, V_n = _power(study, lanes, gains), study.converter.V_rated_rms
    V, delta = points_with_droop(P, lanes.Q_ref, gains.D_q, V_n, paths.V_rms, paths.R, paths.X)
    return np.where(paths.known & np.isfinite(gains).all(axis=0), V, np.nan), delta + paths.angle


def _power(study: Study, lanes: Lanes, gains: PowerLoopGains) -> Array:
    """P of a steady state under its P–f droop, W."""
    return lanes.P_ref + gains.D_p * (study.converter.omega_n - lanes.omega_g)


def _states(
    study: Study,
    paths: _Paths,
    lanes: Lanes,
    gains: PowerLoopGains,
    V: Array,
    delta: Array,
    phase: float,
    free_of_limits: bool,
    fault: NDArray[np.int64] | None = None,
) -> ManyStates:
    """Everything that follows from V and δ. NaN in V marks lanes without a steady state."""
    with np.errstate(invalid="ignore"):
        return _states_of(study, paths, lanes, gains, V, delta, phase, free_of_limits, fault)


def _states_of(
    study: Study,
    paths: _Paths,
    lanes: Lanes,
    gains: PowerLoopGains,
    V: Array,
    delta: Array,
    phase: float,
    free_of_limits: bool,
    fault: NDArray[np.int64] | None,
) -> ManyStates:
    settings, inner, c = study.controller_settings(), study.inner_gains, study.converter
    refs = References(lanes.P_ref, lanes.Q_ref, c.omega_n, c.V_rated_rms)
    theta = delta + phase
    turn = np.exp(-1j * theta)
    # Everything in the converter's own frame, whose d axis is the voltage at the control point.
    v = rms_to_peak(V) + 0j
    to_source = np.exp(-1j * delta)
    v_b = (v - paths.node_from_source * to_source) / paths.node_per_bridge
    x = paths.per_bridge.T * v_b + paths.from_source.T * to_source
    i_s, i_g = x[0], x[2]
    # The voltage on the bridge now was computed `delay` samples ago, in the frame of that time.
    lead = settings.advance_cos + 1j * settings.advance_sin
    v_b_dq = v_b * np.exp(1j * c.delay_samples * paths.omega_g * settings.T_s) / lead
    u = v_b / (settings.half_cos + 1j * settings.half_sin)
    i_ref = i_s + inner.kappa * settings.T_over_L * (u - v - 1j * settings.omega_L * i_s)
    xi_v = i_ref - inner.K_ff * i_g - 1j * settings.omega_C * v
    xi_i = v_b_dq - v - 1j * settings.omega_L * i_s
    P, Q = instantaneous_power(v.real, v.imag, i_g.real, i_g.imag)
    omega_i = paths.omega_g + gains.k_P * P + gains.k_Q * (Q + gains.D_q * V)
    view = LimiterView(
        v_d=v.real,
        v_q=v.imag,
        i_s_d=i_s.real,
        i_s_q=i_s.imag,
        i_g_d=i_g.real,
        i_g_q=i_g.imag,
        e_d=0.0,
        e_q=0.0,
        i_want_d=i_ref.real,
        i_want_q=i_ref.imag,
        V=V,
        omega_i=omega_i,
        P=P,
        Q=Q,
        K_pv=inner.K_pv,
    )
    memory = study.limiter.at_rest(view, paths.omega_g, settings)
    memory = type(memory)(*(np.full(V.shape, value, dtype=float) for value in memory))
    plant, applied = x / turn, v_b / turn
    state = ControllerState(
        theta=theta,
        omega_i=omega_i,
        V=V,
        P_f=P,
        Q_f=Q,
        xi_vd=xi_v.real,
        xi_vq=xi_v.imag,
        xi_id=xi_i.real,
        xi_iq=xi_i.imag,
        i_f_d=i_g.real,
        i_f_q=i_g.imag,
        u_alpha=applied.real,
        u_beta=applied.imag,
        ripple_P=np.zeros_like(P),
        ripple_Q=np.zeros_like(P),
        mean_P=P,
        mean_Q=Q,
        limiter=memory,
    )
    found = np.zeros(V.shape, dtype=int) if fault is None else fault
    lost = ~np.isfinite(V) | ~np.isfinite(P)
    _mark(found, lost & ~np.isfinite(gains).all(axis=0), NO_GAINS)
    _mark(found, lost, NO_POINT)
    _mark(found, np.abs(v_b) > settings.v_max_pk, BRIDGE_VOLTAGE)
    if not free_of_limits:
        _mark(found, np.abs(i_s) > settings.i_max_pk, CURRENT)
        law, estimate = study.limiter.law, GridEstimate(R_g=lanes.R_g, L_g=lanes.L_g)
        sample = law.limit(memory, view, estimate, refs, gains, settings)
        _mark(found, np.asarray(sample.limited) > 0.0, LIMITER_ACTS)
        # One that limits the voltage or the frequency of the power loops moves an integrator that should rest.
        moved, _ = law.move(memory, sample, view, paths.omega_g, IntegratorSteps(0.0, 0.0, 0.0), settings)
        for step in moved:
            _mark(found, np.asarray(step) != 0.0, LIMITER_PULLS)
    return ManyStates(
        plant=np.stack([part for row in plant for part in (row.real, row.imag)]),
        controller=state,
        pending=np.stack([applied.real, applied.imag]),
        P=P,
        Q=Q,
        V=V,
        delta=delta,
        i_s_pk=np.abs(i_s),
        v_b_pk=np.abs(v_b),
        fault=found,
    )


def _mark(fault: NDArray[np.int64], where: NDArray[np.bool_], code: int) -> None:
    """The first fault that is found is the one that is told."""
    fault[where & (fault == 0)] = code
