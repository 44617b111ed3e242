"""A step of P in EMT beside the same step with ideal inner loops: V∠δ at once behind the impedance, quasi-static.

The ideal side is integrated by SciPy from the power loops' law and the power flow, without any linearisation.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from vsgdesign.design.inner.grids import study_of
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops
from vsgdesign.metrics.step_response import ResponseMetrics, step_response
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.simulation.steps import references_at, simulate_step
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.study import Study

DURATION = 2.5


def powers(V: float, delta: float, V_g: float, R: float, X: float) -> tuple[float, float]:
    """Three-phase P and Q that V∠δ (phase rms) sends into R + jX before V_g."""
    v = V * np.exp(1j * delta)
    s = 3.0 * v * np.conj((v - V_g) / (R + 1j * X))
    return s.real, s.imag


def ideal_step(study: Study, grid: Grid, gains: PowerLoopGains, P: float, size: float) -> ResponseMetrics:
    """Figures of P after a step of P_ref by ``size`` W from (P, 0)."""
    R, X = study.path_to_grid(grid)
    c, V_g, omega_g = study.converter, study.grid_source.V_g_rms, study.grid_source.omega_g
    P_ref, Q_ref = references_at(study, grid, gains, P, 0.0)
    V, delta = (float(value) for value in operating_point(P, 0.0, V_g, R, X))
    refs = References(P_ref + size, Q_ref, c.omega_n, c.V_rated_rms)

    def rates(_t: float, x: np.ndarray) -> list[float]:
        delta, omega_i, V, P_f, Q_f = x
        P_now, Q_now = powers(V, delta, V_g, R, X)
        omega, domega, dV = power_loops(omega_i, V, P_f, Q_f, refs, gains)
        return [omega - omega_g, domega, dV, (P_now - P_f) / study.tau_P, (Q_now - Q_f) / study.tau_Q]

    omega_i = omega_g + gains.k_P * P + gains.k_Q * gains.D_q * V
    t = np.linspace(0.0, DURATION, 2501)
    run = solve_ivp(rates, (0.0, DURATION), [delta, omega_i, V, P, 0.0], "LSODA", t, rtol=1e-9, atol=1e-9)
    response = np.array([powers(V, delta, V_g, R, X)[0] for delta, _, V, _, _ in run.y.T]) - P
    return step_response(t, response, 0.0, size)


def emt_beside_ideal(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    point: tuple[float, float],
    P_pu: float,
    size_pu: float = 0.05,
) -> tuple[float, float]:
    """By how much EMT settles later (s) and overshoots more (%) than ideal inner loops."""
    study = study_of(converter, filter_, gains, omega_t)
    grid = Place(*point, "impedance").grid(converter)
    P, size = P_pu * converter.S_rated, size_pu * converter.S_rated
    found = closed_form_schedule(study, study.target, P, 0.0).gains(grid.R_g, grid.L_g)
    ideal = ideal_step(study, grid, found, P, size)
    t_s, response = simulate_step(study, grid, found, P, 0.0, "P", size, DURATION)
    real = step_response(t_s, response, 0.0, size)
    assert real.settling_time_s is not None
    assert ideal.settling_time_s is not None
    assert real.overshoot_pct is not None
    assert ideal.overshoot_pct is not None
    return real.settling_time_s - ideal.settling_time_s, real.overshoot_pct - ideal.overshoot_pct
