"""The exact steady state of the sampled converter, in which a run can start without a transient."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.limiters import LimiterView
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import InfeasibleStudyError, LimitHitError, NoOperatingPointError
from vsgdesign.linear.operating_point.dc_rest import bridge_power
from vsgdesign.linear.operating_point.equilibrium import solve_with_droop
from vsgdesign.linear.operating_point.many import (
    BRIDGE_VOLTAGE,
    CURRENT,
    DC_SOURCE,
    FAULTS,
    LIMITER_ACTS,
    LIMITER_PULLS,
    NO_POINT,
    Lanes,
    ManyStates,
    many_steady_states,
)
from vsgdesign.linear.operating_point.plant import TwoAxisCircuit
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.study import Study


@dataclass(frozen=True)
class SampledState:
    """Plant state (i_s, v_c, i_g and further states of the circuit, each as α, β), controller state, and the bridge
    voltage (2) that the delay holds back. SI, peak."""

    plant: NDArray[np.float64]
    controller: ControllerState
    pending: NDArray[np.float64]


def steady_state(
    study: Study,
    grid: Grid,
    source: GridSource,
    refs: References,
    gains: PowerLoopGains,
    phase: float = 0.0,
    circuit: TwoAxisCircuit | None = None,
) -> SampledState:
    """The state that one control period only rotates by ω_g·T_s (:eq:`sampled-steady-state`).

    ``phase`` (rad) is that of the source's phasor. The bridge is averaged. ``circuit``, with equal axes, takes the
    place of the filter and of all that is connected to it, for example a load. Raises InfeasibleStudyError with the
    reason if there is no steady state, or if a limit is exceeded.
    """
    states = many_steady_states(study, Lanes.at(grid, source, refs), gains, phase, circuit=circuit)
    if states.fault[0]:
        raise fault_of_rest(study, grid, source, refs, gains, states, loaded=circuit is not None)
    return state_of_lane(states, 0)


def state_of_lane(states: ManyStates, lane: int) -> SampledState:
    """The state of one of many converters."""

    def of(values: Any) -> float:
        return float(values[lane])

    at = states.controller
    memory = type(at.limiter)(*map(of, at.limiter))
    controller = ControllerState(*map(of, at[:-1]), limiter=memory)
    return SampledState(states.plant[:, lane].copy(), controller, states.pending[:, lane].copy())


def cold_start(study: Study, phase: float = 0.0) -> SampledState:
    """The cold start: no current, an empty capacitor, and the controller at nominal voltage in phase with the grid."""
    c = study.converter
    asleep = dict.fromkeys(ControllerState._fields, 0.0)
    view = LimiterView(**dict.fromkeys(LimiterView._fields, 0.0) | {"V": c.V_rated_rms, "omega_i": c.omega_n})
    state = ControllerState(**asleep)._replace(
        theta=phase, omega_i=c.omega_n, V=c.V_rated_rms, limiter=_remembered(study, view, c.omega_n)
    )
    return SampledState(plant=np.zeros(6), controller=state, pending=np.zeros(2))


def _remembered(study: Study, view: LimiterView, omega: float) -> Any:
    """What the study's limiter remembers at rest, as a NamedTuple of floats."""
    memory = study.limiter.at_rest(view, omega, study.controller_settings())
    return type(memory)(*(float(value) for value in memory))


def fault_of_rest(
    study: Study,
    grid: Grid,
    source: GridSource,
    refs: References,
    gains: PowerLoopGains,
    states: ManyStates,
    lane: int = 0,
    *,
    loaded: bool = False,
) -> InfeasibleStudyError:
    """The error for the fault of a lane. It says by how much a limit is exceeded and what to change.

    ``loaded``: whether more than the grid is connected.
    """
    fault = int(states.fault[lane])
    v_b, i_s, V = (float(values[lane]) for values in (states.v_b_pk, states.i_s_pk, states.V))
    c = study.converter
    if fault == NO_POINT and loaded:
        return InfeasibleStudyError(
            f"no operating point: the load and the grid (R_g = {grid.R_g:.4g} Ω, L_g = {grid.L_g * 1e3:.4g} mH, "
            f"{source.V_g_rms:.4g} V rms) together do not take P_ref = {refs.P_ref / 1e3:.4g} kW and "
            f"Q_ref = {refs.Q_ref / 1e3:.4g} kvar, or are capacitive together. Ask for less, or take a smaller load."
        )
    if fault == NO_POINT:
        return _no_point(study, grid, source, refs, gains)
    most, advice = c.v_max_pk, "Raise V_dc"
    if fault in (BRIDGE_VOLTAGE, DC_SOURCE) and study.dc is not None:
        at = states.controller
        current = complex(*(float(row[lane]) for row in states.plant[:2])) * np.exp(-1j * float(at.theta[lane]))
        p = float(bridge_power(study, rms_to_peak(V) + 0j, current))
        try:
            v = float(study.dc.at_rest(p, c, study.filter).v)
        except InfeasibleStudyError as error:
            return LimitHitError(str(error), limit="dc source")
        most, advice = c.v_max_pk * v / c.V_dc, f"The dc link rests at {v:.4g} V. Give a source with more voltage"
    if fault == BRIDGE_VOLTAGE:
        return LimitHitError(
            f"the steady state needs a bridge voltage of {v_b:.4g} V peak, but the bridge makes at most {most:.4g} V. "
            f"{advice}, or ask for less P and Q.",
            limit="bridge voltage",
        )
    if fault == CURRENT:
        return LimitHitError(
            f"the steady state needs {i_s:.4g} A peak, but the limit is {study.controller_settings().i_max_pk:.4g} A. "
            "Raise current_limit_pu, or ask for less P and Q.",
            limit="current",
        )
    if fault == LIMITER_ACTS:
        return LimitHitError(
            f"the steady state needs {i_s:.4g} A peak, where the limiter "
            f'"{study.current_limiter}" already acts. Raise current_limit_pu, or ask for less P and Q.',
            limit="current",
        )
    if fault == LIMITER_PULLS:
        return LimitHitError(
            f"the steady state needs {V:.4g} V at {source.omega_g / (2.0 * np.pi):.4g} Hz, from where the limiter "
            f'"{study.current_limiter}" pulls the power loops away. Widen the limits of its voltage and frequency, or '
            "ask for other P and Q.",
            limit="voltage limits",
        )
    return InfeasibleStudyError(f"no steady state: {FAULTS[fault]}.")


def _no_point(
    study: Study, grid: Grid, source: GridSource, refs: References, gains: PowerLoopGains
) -> InfeasibleStudyError:
    """Why there is no operating point, and what to change. Found without the sampling, which changes no digit of it."""
    R, X = study.path_to_grid(grid, source.omega_g)
    P_ref, Q_ref = refs.P_ref, refs.Q_ref
    P = P_ref + gains.D_p * (refs.omega_0 - source.omega_g)
    try:
        solve_with_droop(P, Q_ref, gains.D_q, refs.V_n, source.V_g_rms, R, X)
    except NoOperatingPointError as error:
        text = str(error)
        if P_ref != P:
            text += (
                f" P is P_ref = {P_ref / 1e3:.4g} kW and {(P - P_ref) / 1e3:+.4g} kW of the P–f droop at "
                f"{source.omega_g / (2.0 * np.pi):.4g} Hz (D_p = {gains.D_p:.4g} W·s/rad)."
            )
        return InfeasibleStudyError(text)
    return InfeasibleStudyError(
        f"no operating point: P = {P / 1e3:.4g} kW and Q_ref = {Q_ref / 1e3:.4g} kvar are at the limit of the grid "
        f"(R = {R:.4g} Ω, X = {X:.4g} Ω, {source.V_g_rms:.4g} V rms). Ask for less."
    )
