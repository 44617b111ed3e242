"""The exact steady state of the sampled converter, in which a run can start without a transient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.limiters import GridEstimate, LimiterView
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops
from vsgdesign.errors import InfeasibleStudyError, LimitHitError, NoOperatingPointError
from vsgdesign.frames import instantaneous_power, rms_to_peak
from vsgdesign.operating_point.equilibrium import OperatingPoint, solve_with_droop
from vsgdesign.operating_point.plant import PlantStep, plant_step
from vsgdesign.parameters.study import Grid, GridSource, Study


@dataclass(frozen=True)
class SampledState:
    """Plant state (i_s, v_c, i_g, each as α, β), controller state, and the voltage waiting out the delay (2)."""

    plant: NDArray[np.float64]
    controller: ControllerState
    pending: NDArray[np.float64]


def steady_state(
    study: Study, grid: Grid, source: GridSource, P_ref: float, Q_ref: float, gains: PowerLoopGains, phase: float = 0.0
) -> SampledState:
    """The state that one control period only turns by ω_g·T_s, with the source's phasor at ``phase`` (rad).

    At a fixed point of the sampled map every integrator's input is zero, so the capacitor sits at V∠δ, the
    currents follow from it linearly, and three equations are left for V, δ and ω. Averaged bridge. Raises
    InfeasibleStudyError with the reason where there is none or a limit is hit.
    """
    settings = study.controller_settings()
    delay = study.converter.delay_samples
    V_n, omega_n = study.converter.V_rated_rms, study.converter.omega_n
    refs = References(P_ref, Q_ref, omega_n, V_n)
    omega_g, T_s = source.omega_g, settings.T_s
    plant = plant_step(study.circuit(grid), T_s, omega_g, edges=False)
    v_g = rms_to_peak(source.V_g_rms) * np.exp(1j * phase)

    guess = _guess(study, grid, source, refs, gains)
    phasors = _phasors(study, plant, omega_g, v_g)

    def residual(unknown: NDArray[np.float64]) -> list[float]:
        V, delta, omega_i = unknown[0] * V_n, unknown[1], unknown[2] * omega_n
        x, _ = phasors(rms_to_peak(V) * np.exp(1j * (delta + phase)))
        v = x[1] + study.filter.R_c * (x[0] - x[2])
        P, Q = instantaneous_power(v.real, v.imag, x[2].real, x[2].imag)
        omega, domega_dt, dV_dt = power_loops(omega_i, V, P, Q, refs, gains)
        return [
            (omega - omega_g) / omega_n,
            domega_dt / gains.K_ip / study.converter.S_rated,
            dV_dt / gains.K_iq / study.converter.S_rated,
        ]

    omega_i = omega_g + gains.k_P * guess.P + gains.k_Q * (guess.Q + gains.D_q * guess.V_rms)
    solved = root(residual, [guess.V_rms / V_n, guess.delta, omega_i / omega_n], tol=1e-14)
    error = float(np.max(np.abs(residual(solved.x))))
    if not error < 1e-9:
        raise InfeasibleStudyError(f"no steady state (residual {error:.2g} pu): {solved.message}")
    V, delta, omega_i = solved.x[0] * V_n, float(solved.x[1]), solved.x[2] * omega_n
    theta = delta + phase
    x, v_b = phasors(rms_to_peak(V) * np.exp(1j * theta))
    _check_limits(study, x, v_b)

    turn = np.exp(-1j * theta)
    v = (x[1] + study.filter.R_c * (x[0] - x[2])) * turn
    i_s, i_g = x[0] * turn, x[2] * turn
    # The voltage on the bridge now was computed `delay` samples ago, in the frame of that time.
    lead = settings.advance_cos + 1j * settings.advance_sin
    v_b_dq = v_b * turn * np.exp(1j * delay * omega_g * T_s) / lead
    u = v_b * turn / (settings.half_cos + 1j * settings.half_sin)
    i_ref = i_s + study.inner_gains.kappa * settings.T_over_L * (u - v - 1j * settings.omega_L * i_s)
    xi_v = i_ref - study.inner_gains.K_ff * i_g - 1j * settings.omega_C * v
    xi_i = v_b_dq - v - 1j * settings.omega_L * i_s
    P, Q = instantaneous_power(v.real, v.imag, i_g.real, i_g.imag)
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
        K_pv=study.inner_gains.K_pv,
    )
    state = ControllerState(
        theta=float(theta),
        omega_i=float(omega_i),
        V=float(V),
        P_f=float(P),
        Q_f=float(Q),
        xi_vd=float(xi_v.real),
        xi_vq=float(xi_v.imag),
        xi_id=float(xi_i.real),
        xi_iq=float(xi_i.imag),
        i_f_d=float(i_g.real),
        i_f_q=float(i_g.imag),
        u_alpha=float(v_b.real),
        u_beta=float(v_b.imag),
        mean_P=float(P),
        mean_Q=float(Q),
        limiter=_remembered(study, view, omega_g),
    )
    _check_limiter(study, grid, state, view, refs, gains)
    return SampledState(plant=_interleave(x), controller=state, pending=np.array([v_b.real, v_b.imag]))


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


def _guess(study: Study, grid: Grid, source: GridSource, refs: References, gains: PowerLoopGains) -> OperatingPoint:
    """The continuous-time operating point with both droops: what the sampled one is a hair away from."""
    R, X = study.path_to_grid(grid, source.omega_g)
    P = refs.P_ref + gains.D_p * (refs.omega_0 - source.omega_g)
    try:
        return solve_with_droop(P, refs.Q_ref, gains.D_q, refs.V_n, source.V_g_rms, R, X)
    except NoOperatingPointError as error:
        text = str(error)
        if refs.P_ref != P:
            text += (
                f" P is P_ref = {refs.P_ref / 1e3:.4g} kW and {(P - refs.P_ref) / 1e3:+.4g} kW of the P–f droop at "
                f"{source.omega_g / (2.0 * np.pi):.4g} Hz (D_p = {gains.D_p:.4g} W·s/rad)."
            )
        raise InfeasibleStudyError(text) from error


def _phasors(
    study: Study, plant: PlantStep, omega_g: float, v_g: complex
) -> Callable[[complex], tuple[NDArray[np.complex128], complex]]:
    """Plant state and bridge voltage at a sample, as a function of the capacitor node's voltage there.

    x(k+1) = Φ x + Γ v_b + u v_g and x(k+1) = e^{jω_g T} x: x is affine in v_b.
    """
    turn = np.exp(1j * omega_g * plant.h)
    inverse = np.linalg.inv(turn * np.eye(3) - plant.transition)
    per_bridge = inverse @ plant.bridge
    from_grid = inverse @ plant.source[0] * v_g
    node = np.array([study.filter.R_c, 1.0, -study.filter.R_c])
    node_from_grid, node_per_bridge = node @ from_grid, node @ per_bridge

    def at(v_node: complex) -> tuple[NDArray[np.complex128], complex]:
        v_b = (v_node - node_from_grid) / node_per_bridge
        return per_bridge * v_b + from_grid, complex(v_b)

    return at


def _check_limits(study: Study, x: NDArray[np.complex128], v_b: complex) -> None:
    settings = study.controller_settings()
    if abs(v_b) > settings.v_max_pk:
        raise LimitHitError(
            f"the steady state needs a bridge voltage of {abs(v_b):.4g} V peak, but the bridge makes at most "
            f"{settings.v_max_pk:.4g} V. Raise V_dc, or ask for less P and Q.",
            limit="bridge voltage",
        )
    if abs(x[0]) > settings.i_max_pk:
        raise LimitHitError(
            f"the steady state needs {abs(x[0]):.4g} A peak, but the limit is {settings.i_max_pk:.4g} A. "
            "Raise current_limit_pu, or ask for less P and Q.",
            limit="current",
        )


def _check_limiter(
    study: Study, grid: Grid, state: ControllerState, view: LimiterView, refs: References, gains: PowerLoopGains
) -> None:
    """A limiter may act below the limit itself. The state is then no steady state of the controller."""
    estimate = GridEstimate(R_g=grid.R_g, L_g=grid.L_g)
    sample = study.limiter.law.limit(state.limiter, view, estimate, refs, gains, study.controller_settings())
    if sample.limited > 0.0:
        raise LimitHitError(
            f"the steady state needs {np.hypot(view.i_s_d, view.i_s_q):.4g} A peak, where the limiter "
            f'"{study.current_limiter}" already acts. Raise current_limit_pu, or ask for less P and Q.',
            limit="current",
        )


def _interleave(x: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.array([part for entry in x for part in (entry.real, entry.imag)])
