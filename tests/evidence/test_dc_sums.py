"""The sum by hand beside what is told of a full dc source: against closed forms and a differential equation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

from evidence import _dc_sums as by_hand
from evidence.dc_side import on_battery
from tests.simulation.test_lanes import study_named
from vsgdesign.equations.limiter_interface import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.many import Lanes, many_steady_states
from vsgdesign.simulation.timeline import Segments


def test_a_jump_of_the_phase_moves_the_energy_of_its_closed_form() -> None:
    """∫(P − P_ref) dt = −D_p φ, for both signs and three grids."""
    study, _ = study_named("survival", "angle_damped")
    study = on_battery(study, 0.6)
    study = replace(study, converter=replace(study.converter, current_limit_pu=None))
    c, refs = study.converter, study.converter.references()
    S, D_p = c.S_rated, c.S_rated / (0.02 * c.omega_n)
    gains = PowerLoopGains(*(np.full(6, value) for value in (3e-3 * 5000.0 / S, D_p, 2e-3, 50.0, 0.0, 0.0, 4e-4, 0.0)))
    R_g, L_g = (np.tile([0.02, 0.05, 0.1], 2) * c.V_rated_rms**2 * 3.0 / S / k for k in (1.0, 0.1 * c.omega_n))
    refs = refs._replace(P_ref=np.full(6, 0.4 * S), Q_ref=np.zeros(6))
    lanes = Lanes(R_g, L_g, c.V_rated_rms, c.omega_n, *refs)
    start = many_steady_states(study, lanes, gains)
    jump, loops, zero = np.repeat([0.1, -0.1], 3), by_hand.PhasorLoops(study), np.zeros(6)
    links = by_hand.links_at_rest(study, start)
    assert links is not None
    i_g = (start.plant[4] + 1j * start.plant[5]) * np.exp(-1j * start.controller.theta)
    x = by_hand.Swing(start.controller._replace(theta=start.delta - jump), np.full(6, c.omega_n), 0.0, links, i_g)
    grid = Segments(zero, R_g, L_g, np.full(6, c.V_rated_rms), zero, np.full(6, c.omega_n), zero, zero, zero)
    moved = np.zeros(6)
    for _ in range(2500):
        x = loops.step(x, grid, refs, gains, GridEstimate(R_g, L_g))
        moved += by_hand.STEP_S * (x.state.P_f - refs.P_ref)
    np.testing.assert_allclose(x.state.P_f, refs.P_ref, atol=1e-3 * S)
    np.testing.assert_allclose(moved, -D_p * jump, rtol=0.01)


def test_a_limited_current_is_the_share_of_what_its_loop_asks_for() -> None:
    """i = min(1, I/|w|) w with w = w_0 + A i, with feedback that would make an iteration diverge."""
    rng = np.random.default_rng(5)
    drawn_pairs = rng.normal(size=(2, 200, 2)).view(np.complex128)[..., 0]
    asked, fed_back = 8.0 * drawn_pairs[0], 3.0 * drawn_pairs[1] - 4.0
    i = by_hand.limited_current(asked, fed_back, 1.0)
    w = asked + fed_back * i
    over = np.abs(w) > 1.0 + 1e-9
    assert 20 < over.sum() < 180
    np.testing.assert_allclose(i, np.where(over, w / np.abs(w), w), atol=1e-12)


def test_the_current_of_the_grid_moves_as_its_differential_equation_says() -> None:
    """L di/dt = v − v_g − (R + jωL) i with constant voltages, by DOP853."""
    study = on_battery(study_named("survival", "angle_damped")[0], 1.0)
    f, omega, zero = study.filter, study.converter.omega_n, np.zeros(1)
    R_g, L_g, v, v_g, before = (
        np.array([0.3]),
        np.array([2e-3]),
        150.0 + 20j,
        np.array([90.0 - 60j]),
        np.array([9 - 4j]),
    )
    grid = Segments(zero, R_g, L_g, zero, zero, np.full(1, omega), zero, zero, zero)
    circuit = by_hand.PhasorLoops(study)._circuit(grid, v_g, before)
    i_s = (v - circuit.v_g) / circuit.Z + 1j * circuit.omega_C * v
    R, L = 0.3 + f.R_2, 2e-3 + f.L_2
    found = solve_ivp(
        lambda _, i: (v - v_g - (R + 1j * omega * L) * i) / L, (0.0, by_hand.STEP_S), before, "DOP853", rtol=1e-11
    )
    made, i_g = circuit.at(i_s)
    np.testing.assert_allclose(i_g, found.y[:, -1], rtol=1e-9)
    np.testing.assert_allclose(made, v, rtol=1e-12)
