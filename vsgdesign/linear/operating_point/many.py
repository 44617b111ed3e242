"""The exact steady states of many sampled converters at once, with the gains that are given.

In a steady state of the sampled map, plant state and bridge voltage follow linearly from the voltage at the control
point. One complex impedance then lies between the control point and the source. It differs from that of the grid only
by the sampling, and the steady state is an operating point on it (:eq:`sampled-path`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.dc_control import clamp_cut, droop_of_link
from vsgdesign.equations.dc_source_interface import SourceLimits
from vsgdesign.equations.frames import instantaneous_power, linear_modulation_limit, peak_to_rms, rms_to_peak
from vsgdesign.equations.grid import capacitor_node_voltage, pcc_voltage
from vsgdesign.equations.limiters import GridEstimate, IntegratorSteps, LimiterView
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.linear.operating_point.dc_rest import bridge_power, links_at_rest, power_of_plant
from vsgdesign.linear.operating_point.equilibrium import points_with_droop
from vsgdesign.linear.operating_point.network import NetworkCircuit
from vsgdesign.linear.operating_point.plant import PlantSteps, TwoAxisCircuit, plant_step, plant_steps
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
NO_POINT, BRIDGE_VOLTAGE, CURRENT, LIMITER_ACTS, NOT_CONVERGED, NO_GAINS, LIMITER_PULLS = range(1, 8)
DC_SOURCE, DC_ENERGY = range(8, 10)
DC_FAULTS = (DC_SOURCE, DC_ENERGY)
FAULTS = (
    "",
    "no operating point",
    "the steady state needs more bridge voltage than there is",
    "the steady state needs more current than the limit",
    "the current limiter acts in the steady state",
    "the gains follow the measured powers and do not come to rest",
    "no gains",
    "the current limiter pulls the power loops away from the steady state",
    "the source of the dc link does not give the power of the steady state",
    "the events move more energy than the source of the dc link and its capacitor can take or give",
)
"""The meaning of the codes of :attr:`ManyStates.fault`. The code 0 means that there is a steady state."""


def said_of(fault: int) -> str:
    """What is told beforehand of a fault of the dc side."""
    return f"not possible, because {FAULTS[fault]}"


@dataclass(frozen=True, eq=False)
class ManyStates:
    """Steady states of N converters. Lanes whose fault is ``NO_POINT``, ``NOT_CONVERGED`` or ``NO_GAINS`` are NaN."""

    plant: Array
    """(6, N): i_s, v_c, i_g, each as α, β; A and V peak. More rows with a circuit that has more states."""
    controller: ControllerState
    """The controller's state. Every field is (N,), including the memory of the limiter."""
    pending: Array
    """(2, N): bridge voltage that the delay holds back, α and β, V peak."""
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
    """Grid, source and set points of N converters, in SI: numbers or (N,), which broadcast. The last two may be None:
    they are then nominal."""

    R_g: Any
    L_g: Any
    V_g_rms: Any
    omega_g: Any
    P_ref: Any
    Q_ref: Any
    omega_0: Any = None
    V_n: Any = None

    @classmethod
    def at(cls, grid: Grid, source: GridSource, refs: References) -> Lanes:
        """One converter."""
        return cls(grid.R_g, grid.L_g, source.V_g_rms, source.omega_g, *refs)

    @property
    def refs(self) -> References:
        """The set points."""
        return References(*self[4:])


class Paths(NamedTuple):
    """The path between bridge and source in a sampled steady state, for N lanes, with the source at angle zero."""

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


def many_steady_states(
    study: Study,
    lanes: Lanes,
    gains: PowerLoopGains,
    phase: Array | float = 0.0,
    *,
    circuit: TwoAxisCircuit | Sequence[TwoAxisCircuit] | None = None,
    links: Sequence[DcLink] | None = None,
) -> ManyStates:
    """The states that one control period only rotates by ω_g·T_s, with the source's phasor at ``phase`` (rad).

    The fields of ``lanes`` and ``gains`` are numbers or (N,), and they broadcast. The bridge is averaged. A lane
    without a steady state has its reason in ``fault`` and does not affect the others. ``circuit``, with equal axes,
    takes the place of the filter and of all that is connected to it: one for a lane alone, or one for each lane, all
    with the same states. ``links``: the dc link of each lane; None: that of the study.
    """
    lanes, gains = lanes_of(study, lanes, gains)
    paths = paths_of(study, lanes, circuit)

    def solve(lanes: Lanes) -> tuple[ManyStates, None]:
        held = clamped_lanes(study, links, lanes, gains)
        V, delta = points_of(paths, held, gains)
        return states_at(study, paths, held, gains, V, delta, phase, links=links), None

    return with_voltage_droop(study, links, lanes, solve)[0]


def lanes_of(study: Study, lanes: Lanes, gains: PowerLoopGains) -> tuple[Lanes, PowerLoopGains]:
    """Lanes and gains as arrays of one length, with nominal values where a set point is not given."""
    nominal = study.converter.references()
    lanes = lanes._replace(
        omega_0=nominal.omega_0 if lanes.omega_0 is None else lanes.omega_0,
        V_n=nominal.V_n if lanes.V_n is None else lanes.V_n,
    )
    given = [np.asarray(value, dtype=float) for value in (*lanes, *gains)]
    count = max(value.size for value in given)
    arrays = [np.full(count, value) for value in given]
    return Lanes(*arrays[: len(lanes)]), PowerLoopGains(*arrays[len(lanes) :])


def clamped_lanes(study: Study, links: Sequence[DcLink] | None, lanes: Lanes, gains: PowerLoopGains) -> Lanes:
    """Lanes whose references and droops ask for no more than the sources can give (:eq:`dc-clamp`), where the
    controller clamps them. Lanes and gains are arrays (N,)."""
    if study.dc is None or not study.dc.clamps:
        return lanes
    of = study.converter, study.filter
    held = [study.dc] if links is None else links
    known = {id(link): link.can_give(*of) for link in held}
    limits = SourceLimits(*np.array([known[id(link)] for link in held], dtype=float).T)
    cut = clamp_cut(lanes.omega_g, lanes.refs, gains, limits, study.dc.clamp(*of).own)
    return lanes._replace(P_ref=lanes.P_ref + cut)


_More = TypeVar("_More")

_ROUNDS, _FIRST, _SAME = 60, 1e-6, 1e-12
"""Of the search for a rest with a droop of the link's voltage. The first step and the end are shares of ω_n."""


def with_voltage_droop(
    study: Study, links: Sequence[DcLink] | None, lanes: Lanes, solve: Callable[[Lanes], tuple[ManyStates, _More]]
) -> tuple[ManyStates, _More]:
    """What ``solve`` finds, where the frequency follows the link's voltage (:eq:`dc-droop-rest`): the power loops of
    each lane rest at ω_g less what the link adds, and the link rests at the power that they then have.

    ``lanes`` are arrays (N,). To the P–f droop, a frequency that the link adds is a higher ω_0. Lanes whose power and
    voltage do not agree within some rounds count as not converged.
    """
    states, more = solve(lanes)
    if study.dc is None or not study.dc.droops:
        return states, more
    c, held, count = study.converter, links or [study.dc] * len(states), len(states)
    per_volt = np.array([one.droop(c).per_volt for one in held])
    first, same = _FIRST * c.omega_n, _SAME * c.omega_n
    faster, away = np.zeros(count), np.zeros(count)
    good, good_away = np.zeros(count), np.full(count, np.nan)  # the last place with a rest
    for _ in range(_ROUNDS):
        none = np.isin(states.fault, (NO_POINT, NOT_CONVERGED, NO_GAINS))
        v = links_at_rest(study, held, np.where(none, np.nan, power_of_plant(study, states.plant)))
        away = np.asarray(droop_of_link(v, c.V_dc, per_volt)) - faster
        lost, begun = np.isnan(away), np.isfinite(good_away)
        if np.all(np.where(lost, ~begun, np.abs(away) <= same)):
            break
        # More frequency asks for more power and leaves the link less voltage, so that the slope is −1 or steeper. The
        # first step measures it. Where there is no rest, the step was too long.
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = -away / np.minimum((away - good_away) / (faster - good), -1.0)
        step = np.where(np.isfinite(newton), newton, np.clip(away, -first, first))
        back = np.where(begun, 0.5 * (faster + good), faster)
        following = np.where(lost, back, faster + step)
        good, good_away = np.where(lost, good, faster), np.where(lost, good_away, away)
        faster = following
        states, more = solve(lanes._replace(omega_0=lanes.omega_0 + faster))
    away = np.where(np.isnan(away), np.where(np.isfinite(good_away), np.inf, 0.0), away)
    _mark(states.fault, np.abs(away) > 1e3 * _SAME * c.omega_n, NOT_CONVERGED)
    s = states.controller
    memory = s.limiter
    if "omega" in memory._fields:
        memory = memory._replace(omega=memory.omega - faster)
    return replace(states, controller=s._replace(omega_i=s.omega_i - faster, limiter=memory)), more


def paths_of(study: Study, lanes: Lanes, circuit: TwoAxisCircuit | Sequence[TwoAxisCircuit] | None) -> Paths:
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
        steps = _on_one_axis([circuit] if isinstance(circuit, TwoAxisCircuit) else circuit, T_s, omega_g)
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
    return Paths(
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


def _on_one_axis(circuits: Sequence[TwoAxisCircuit], h: float, omega: Array) -> PlantSteps:
    """The steps of circuits with equal axes as those of lanes."""
    steps = [plant_step(circuit, h, float(one), edges=False) for circuit, one in zip(circuits, omega, strict=True)]
    transition = np.stack([step.transition[0::2, 0::2] for step in steps])
    bridge = np.stack([step.bridge[0::2, 0] for step in steps])
    # What 1 adds on α, and on β.
    source = np.stack([step.source[:, 0::2, 0] + 1j * step.source[:, 1::2, 0] for step in steps])
    return PlantSteps(np.full(len(steps), h), transition, bridge, np.empty((len(steps), 0, 0)), source)


def points_of(paths: Paths, lanes: Lanes, gains: PowerLoopGains) -> tuple[Array, Array]:
    """V and δ of steady states: both errors of the power loops are zero, and the frequency is the source's."""
    P = power_of(lanes, gains)
    V, delta = points_with_droop(P, lanes.Q_ref, gains.D_q, lanes.V_n, paths.V_rms, paths.R, paths.X)
    return np.where(paths.known & np.isfinite(gains).all(axis=0), V, np.nan), delta + paths.angle


def power_of(lanes: Lanes, gains: PowerLoopGains) -> Array:
    """P of a steady state under its P–f droop, W."""
    return lanes.P_ref + gains.D_p * (lanes.omega_0 - lanes.omega_g)


def powers_at_pcc(
    study: Study,
    states: ManyStates,
    lanes: Lanes,
    phase: Array | float = 0.0,
    circuits: Sequence[NetworkCircuit] | None = None,
) -> tuple[Array, Array]:
    """P (W) and Q (var) at the PCC in steady states on these grids and sources, whose phase is ``phase`` (rad).
    ``circuits``: of each lane, where more than a grid is connected."""
    x, v_g = states.plant, rms_to_peak(lanes.V_g_rms)
    if circuits is not None:
        per_state, per_source = (
            np.stack([getattr(one, name) for one in circuits]) for name in ("pcc_per_state", "pcc_per_source")
        )
        at_source = np.stack([v_g * np.cos(phase), v_g * np.sin(phase)])
        v = np.einsum("nij,jn->in", per_state, x) + np.einsum("nij,jn->in", per_source, at_source)
        return instantaneous_power(v[0], v[1], x[4], x[5])
    circuit = study.circuit()._replace(R_g=lanes.R_g, L_g=lanes.L_g)
    alpha = pcc_voltage(x[0], x[2], x[4], v_g * np.cos(phase), circuit)
    beta = pcc_voltage(x[1], x[3], x[5], v_g * np.sin(phase), circuit)
    return instantaneous_power(alpha, beta, x[4], x[5])


def states_at(
    study: Study,
    paths: Paths,
    lanes: Lanes,
    gains: PowerLoopGains,
    V: Array,
    delta: Array,
    phase: Array | float,
    fault: NDArray[np.int64] | None = None,
    links: Sequence[DcLink] | None = None,
) -> ManyStates:
    """The steady states with the given V and δ. V is NaN in lanes without a steady state."""
    with np.errstate(invalid="ignore"):
        return _states_of(study, paths, lanes, gains, V, delta, phase, fault, links)


def _states_of(
    study: Study,
    paths: Paths,
    lanes: Lanes,
    gains: PowerLoopGains,
    V: Array,
    delta: Array,
    phase: Array | float,
    fault: NDArray[np.int64] | None,
    links: Sequence[DcLink] | None,
) -> ManyStates:
    settings, inner, c = study.controller_settings(), study.inner_gains, study.converter
    theta = delta + phase
    turn = np.exp(-1j * theta)
    # Everything in the converter's own frame, whose d axis is the voltage at the control point.
    v = rms_to_peak(V) + 0j
    to_source = np.exp(-1j * delta)
    v_b = (v - paths.node_from_source * to_source) / paths.node_per_bridge
    x = paths.per_bridge.T * v_b + paths.from_source.T * to_source
    i_s, i_g = x[0], x[2]
    v_dc, asked = None, v_b
    if study.dc is not None:
        held = links or [study.dc] * len(V)
        v_dc = links_at_rest(study, held, np.where(_lost(fault, V), np.nan, bridge_power(study, v, i_s)))
        if not study.dc.compensates:  # the controller asks for what the nominal voltage of the link would make of it
            asked = v_b * np.where(np.isfinite(v_dc), c.V_dc / v_dc, 1.0)
    # The voltage on the bridge now was computed `delay` samples ago, in the frame of that time.
    lead = settings.advance_cos + 1j * settings.advance_sin
    v_b_dq = asked * np.exp(1j * c.delay_samples * paths.omega_g * settings.T_s) / lead
    u = asked / (settings.half_cos + 1j * settings.half_sin)
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
        full=0.0,
    )
    memory = study.limiter.at_rest(view, paths.omega_g, settings)
    memory = type(memory)(*(np.full(V.shape, value, dtype=float) for value in memory))
    plant, applied = x / turn, asked / turn
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
    v_max: Any = settings.v_max_pk
    if v_dc is not None:
        _mark(found, np.isnan(v_dc), DC_SOURCE)
        v_max = linear_modulation_limit(v_dc, c.zero_sequence)
    _mark(found, np.abs(v_b) > v_max, BRIDGE_VOLTAGE)
    _mark(found, np.abs(i_s) > settings.i_max_pk, CURRENT)
    law, estimate = study.limiter.law, GridEstimate(R_g=lanes.R_g, L_g=lanes.L_g)
    sample = law.limit(memory, view, estimate, lanes.refs, gains, settings)
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


def _lost(fault: NDArray[np.int64] | None, V: Array) -> NDArray[np.bool_]:
    """Lanes that have no steady state."""
    return ~np.isfinite(V) if fault is None else ~np.isfinite(V) | (fault > 0)


def _mark(fault: NDArray[np.int64], where: NDArray[np.bool_], code: int) -> None:
    """The first fault that is found is the one that is told."""
    fault[where & (fault == 0)] = code
