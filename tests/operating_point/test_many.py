"""Steady states of many converters at once: they stay put over one period, and each lane stands for itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.gain_tables import table
from tests.simulation.studies import GAINS, lc_study, lcl_study
from vsgdesign.equations.controller import ControllerState, controller_step
from vsgdesign.equations.controller_data import Measurement, flat_state
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.limiters import LIMITERS, GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import InfeasibleStudyError, LimitHitError
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order, slowest_decay
from vsgdesign.linear.operating_point.many import (
    BRIDGE_VOLTAGE,
    CURRENT,
    LIMITER_ACTS,
    LIMITER_PULLS,
    NO_GAINS,
    NO_POINT,
    NOT_CONVERGED,
    Lanes,
    ManyStates,
    many_steady_states,
)
from vsgdesign.linear.operating_point.many_rests import many_rests_with_measured_gains, rest_with_measured_gains
from vsgdesign.linear.operating_point.plant import plant_steps
from vsgdesign.linear.operating_point.sampled import steady_state
from vsgdesign.linear.stability.loci import modes
from vsgdesign.runtime.guards import settings_of
from vsgdesign.runtime.of_study import ControllerGains
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.runtime.table import table_schedule
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import Grid, GridSource

Array = NDArray[np.float64]
STUDIES = {"LC": lc_study("1 s"), "LCL with delay": lcl_study("1 s")}
PHASE = -0.5 * np.pi


def draw(study: Study, count: int, seed: int) -> Lanes:
    """R_g, L_g, V_g, ω_g, P_ref and Q_ref: weak and strong, resistive and inductive grids, some beyond all limits."""
    rng, c = np.random.default_rng(seed), study.converter
    Z, x_over_r = c.Z_base / 10.0 ** rng.uniform(0.0, 1.3, count), 10.0 ** rng.uniform(-1.0, 1.2, count)
    R_g = Z / np.hypot(1.0, x_over_r)
    L_g = R_g * x_over_r / c.omega_n
    V_g, omega_g = c.V_rated_rms * rng.uniform(0.8, 1.15, count), c.omega_n * rng.uniform(0.99, 1.01, count)
    P_ref, Q_ref = c.S_rated * rng.uniform(-1.2, 1.2, count), c.S_rated * rng.uniform(-0.6, 0.6, count)
    nominal = np.full(count, c.omega_n), np.full(count, c.V_rated_rms)
    return Lanes(R_g, L_g, V_g, omega_g, P_ref, Q_ref, *nominal)


def after_one_period(
    study: Study, states: ManyStates, lanes: Lanes, gains: PowerLoopGains
) -> tuple[Array, ControllerState, Array]:
    """Plant, controller and waiting voltage of every lane one period later, by the equations of the simulation."""
    R_g, L_g, V_g, omega_g = lanes[:4]
    c, x = study.converter, states.plant
    i_s, v_c, i_g = (x[k] + 1j * x[k + 1] for k in (0, 2, 4))
    v = v_c + study.filter.R_c * (i_s - i_g)
    measured = Measurement(v.real, v.imag, i_s.real, i_s.imag, i_g.real, i_g.imag)
    after, out = controller_step(
        states.controller,
        measured,
        GridEstimate(R_g, L_g),
        lanes.refs,
        gains,
        study.inner_gains,
        study.controller_settings(),
        study.limiter.law,
    )
    new = out.v_b_alpha + 1j * out.v_b_beta
    applied = states.pending[0] + 1j * states.pending[1] if c.delay_samples else new
    steps = plant_steps(study, R_g, L_g, c.T_s, omega_g)
    source = rms_to_peak(V_g) * np.exp(1j * PHASE)
    following = np.einsum("nij,jn->in", steps.transition, np.array([i_s, v_c, i_g]))
    following = following + steps.bridge.T * applied + steps.source[:, 0].T * source
    return following, after, new


@pytest.mark.parametrize("limiter", LIMITERS)
@pytest.mark.parametrize("name", STUDIES)
def test_nothing_but_the_angle_moves_in_one_period(name: str, limiter: str) -> None:
    """Every state of every lane, with and without droops and damping through the angle."""
    study = replace(STUDIES[name], current_limiter=limiter)
    c, lanes = study.converter, draw(study, 300, seed=7)
    damped = GAINS._replace(D_p=GAINS.D_p / 10.0, k_P=1e-5, k_Q=2e-5)
    for gains in (GAINS._replace(D_p=0.0, D_q=0.0), damped, damped._replace(D_q=500.0 * GAINS.D_q, K_pq=0.01)):
        states = many_steady_states(study, lanes, gains, PHASE)
        good = states.fault == 0
        assert good.sum() > 200
        x, after, new = after_one_period(study, states, lanes, gains)
        turned = np.exp(1j * lanes.omega_g * c.T_s)
        before = states.plant[0::2] + 1j * states.plant[1::2]
        waiting = states.pending[0] + 1j * states.pending[1]
        V_pk = float(rms_to_peak(c.V_rated_rms))
        # Rounding of 1e-16 through grids of 1/50 per unit: measured 3e-14.
        for i, scale in enumerate((c.I_rated_pk, V_pk, c.I_rated_pk)):
            np.testing.assert_allclose(x[i][good], (turned * before[i])[good], rtol=0.0, atol=1e-12 * scale)
        np.testing.assert_allclose(new[good], (waiting * turned**c.delay_samples)[good], rtol=0.0, atol=1e-12 * V_pk)
        expected = states.controller._replace(
            theta=states.controller.theta + lanes.omega_g * c.T_s, u_alpha=new.real, u_beta=new.imag
        )
        scales: dict[str, float] = dict.fromkeys(ControllerState._fields, V_pk)
        scales |= {"theta": 1.0, "omega_i": c.omega_n}
        scales |= dict.fromkeys(("P_f", "Q_f", "ripple_P", "ripple_Q", "mean_P", "mean_Q"), c.S_rated)
        for field in ControllerState._fields[:-1]:
            moved = getattr(after, field) - getattr(expected, field)
            largest = np.max(np.abs(np.broadcast_to(moved, good.shape)[good]))
            assert largest < 1e-11 * scales[field], field
        for now, then in zip(after.limiter, states.controller.limiter, strict=True):
            np.testing.assert_allclose(now[good], then[good], rtol=1e-11, atol=1e-11 * V_pk)


@pytest.mark.parametrize("name", STUDIES)
def test_each_lane_stands_for_itself_and_says_what_is_wrong(name: str) -> None:
    """Alone, a lane has the same state or an error with the words of its fault; every kind of them occurs."""
    words = {
        NO_POINT: "no operating point|no steady state with the Q–V droop",
        BRIDGE_VOLTAGE: "bridge makes at most",
        CURRENT: "but the limit is .* A",
        LIMITER_ACTS: "already acts",
        LIMITER_PULLS: "pulls the power loops away",
    }
    study = replace(STUDIES[name], current_limiter="projection")
    c, gains = study.converter, GAINS._replace(D_p=GAINS.D_p / 10.0, D_q=20.0 * GAINS.D_q)
    study = replace(study, converter=replace(c, current_limit_pu=1.1, V_dc=1.7 * c.V_rated_rms / (c.v_max_pk / c.V_dc)))
    lanes = draw(study, 150, seed=8)
    states = many_steady_states(study, lanes, gains, PHASE)
    assert {0, *words} == set(states.fault.tolist())
    for k, fault in enumerate(states.fault):
        R_g, L_g, V_g, omega_g, *refs = (float(value[k]) for value in lanes)
        asked = (study, Grid(R_g, L_g), GridSource(V_g, omega_g), References(*refs), gains, PHASE)
        if fault:
            with pytest.raises(InfeasibleStudyError, match=words[int(fault)]):
                steady_state(*asked)
            continue
        alone = steady_state(*asked)
        # The last bits of a sum depend on how many lanes are summed at once.
        np.testing.assert_allclose(alone.plant, states.plant[:, k], rtol=1e-13, atol=1e-11)
        np.testing.assert_allclose(alone.pending, states.pending[:, k], rtol=1e-13, atol=1e-11)
        of_lane = [value[k] for value in flat_state(states.controller)]
        np.testing.assert_allclose(flat_state(alone.controller), of_lane, rtol=1e-13, atol=1e-11)


def test_a_limiter_that_moves_the_voltage_at_rest_is_a_fault() -> None:
    """The grid lifts the voltage to 1.4 per unit, where "projection" pulls it down. This was once called a rest."""
    study = replace(STUDIES["LC"], current_limiter="projection")
    grid, source = Grid(0.0, 5e-3), GridSource(1.4 * study.converter.V_rated_rms, study.converter.omega_n)
    circular = replace(study, current_limiter="circular")
    assert steady_state(circular, grid, source, study.converter.references(), GAINS).controller.V > 150.0
    with pytest.raises(LimitHitError, match=r"15\d\.\d V at 50 Hz, from where the limiter") as caught:
        steady_state(study, grid, source, study.converter.references(), GAINS)
    assert caught.value.limit == "voltage limits"


def test_a_lane_without_sense_disturbs_no_other() -> None:
    study = STUDIES["LCL with delay"]
    lanes = draw(study, 8, seed=9)
    lanes = Lanes._make(value[:1].repeat(8) for value in lanes)
    alone = many_steady_states(study, Lanes._make(value[:1] for value in lanes), GAINS)
    assert alone.fault[0] == 0
    for k, bad in enumerate((np.nan, -1.0, 0.0, np.nan, np.inf, np.nan)):
        lanes[k][k] = bad
    gains = PowerLoopGains(*(np.full(8, value) for value in GAINS))
    gains.K_ip[6] = np.nan
    states = many_steady_states(study, lanes, gains)
    np.testing.assert_array_equal(states.fault, [NO_POINT] * 6 + [NO_GAINS, 0])
    np.testing.assert_allclose(states.plant[:, 7], alone.plant[:, 0], rtol=1e-14)
    assert np.isnan(states.plant[:, :6]).all()


def test_a_current_above_the_limit_is_told_of_a_state_that_is_known() -> None:
    study = STUDIES["LC"]
    limit_pu = 0.8
    lanes = draw(study, 50, seed=10)
    held = replace(study, converter=replace(study.converter, current_limit_pu=limit_pu))
    limited, free = (many_steady_states(one, lanes, GAINS) for one in (held, study))
    above = (free.fault == 0) & (free.i_s_pk > limit_pu * study.converter.I_rated_pk)
    assert above.sum() > 5
    np.testing.assert_array_equal(limited.fault[above], CURRENT)
    np.testing.assert_array_equal(limited.plant[:, above], free.plant[:, above])


def test_measured_gains_belong_to_their_steady_states() -> None:
    """A table whose droop follows the measured powers: gains at P, Q and V are the gains of the state, and alone each
    lane has the same."""
    study = STUDIES["LC"]
    gain_table = table("published", "inertia")
    law = ControllerGains(table_schedule(gain_table), None, True, settings_of(gain_table))
    lanes = draw(study, 40, seed=11)
    lanes = lanes._replace(P_ref=0.7 * lanes.P_ref, Q_ref=0.5 * lanes.Q_ref)
    states, gains = many_rests_with_measured_gains(
        study, lanes, lambda P, Q, V: law(lanes.R_g, lanes.L_g, P, Q, V), PHASE
    )
    good = states.fault == 0
    assert good.sum() > 20
    again = law(lanes.R_g, lanes.L_g, states.P, states.Q, states.V)
    assert np.ptp(gains.D_p[good]) > 0.01 * np.mean(gains.D_p[good])
    for found, expected in zip(gains, again, strict=True):
        np.testing.assert_allclose(found[good], expected[good], rtol=3e-10)
    given = many_steady_states(study, lanes, gains, PHASE)
    np.testing.assert_allclose(given.plant[:, good], states.plant[:, good], rtol=1e-12, atol=1e-10)
    for k in np.flatnonzero(good)[:10]:

        def gains_of(P: float, Q: float, V: float, k: int = int(k)) -> PowerLoopGains:
            return PowerLoopGains(*(float(value) for value in law(lanes.R_g[k], lanes.L_g[k], P, Q, V)))

        R_g, L_g, V_g, omega_g, *refs = (float(value[k]) for value in lanes)
        alone, own = rest_with_measured_gains(
            study, Grid(R_g, L_g), GridSource(V_g, omega_g), References(*refs), gains_of, PHASE
        )
        np.testing.assert_allclose(own, [value[k] for value in gains], rtol=1e-13)
        np.testing.assert_allclose(alone.plant, states.plant[:, k], rtol=1e-12, atol=1e-10)


def test_gains_that_overshoot_from_round_to_round_come_to_rest() -> None:
    """The droop follows the measured P and turns it back by 90 %: 100 plain rounds were once called no rest. So were
    first gains whose droop asks for more than the grid carries: of the 196 rests here, 156 were found then."""
    study = STUDIES["LC"]
    target = replace(study.target, follow_references=True)
    law = ControllerGains(closed_form_schedule(study, target), None, True, None)
    lanes = draw(study, 300, seed=3)
    lanes = lanes._replace(P_ref=0.7 * lanes.P_ref, Q_ref=0.5 * lanes.Q_ref)
    rounds = []

    def gains_of(P: Array, Q: Array, V: Array) -> PowerLoopGains:
        rounds.append(1)
        return law(lanes.R_g, lanes.L_g, P, Q, V)

    states, gains = many_rests_with_measured_gains(study, lanes, gains_of, PHASE)
    good = np.isin(states.fault, (0, CURRENT, LIMITER_ACTS, LIMITER_PULLS))
    assert good.sum() == 196
    assert not (states.fault == NOT_CONVERGED).any()
    assert len(rounds) < 90
    for found, own in zip(gains, law(lanes.R_g, lanes.L_g, states.P, states.Q, states.V), strict=True):
        np.testing.assert_allclose(found[good], own[good], rtol=1e-9)


def test_lanes_without_gains_and_gains_that_find_no_rest() -> None:
    study = STUDIES["LC"]
    lanes = Lanes._make(value[:1].repeat(3) for value in draw(study, 1, seed=9))
    restless = iter(range(1000))

    def gains_of(*_: Array) -> PowerLoopGains:
        gains = PowerLoopGains(*(np.full(3, value) for value in GAINS))
        gains.D_q[1] *= 1.0 + 0.1 * (next(restless) % 2)
        gains.K_iq[2] = np.nan
        return gains

    states, gains = many_rests_with_measured_gains(study, lanes, gains_of)
    np.testing.assert_array_equal(states.fault, [0, NOT_CONVERGED, NO_GAINS])
    np.testing.assert_array_equal([value[0] for value in gains], GAINS)


@pytest.mark.parametrize("name", STUDIES)
def test_the_slowest_mode_is_that_of_each_cell(name: str) -> None:
    """The least stable mode of the model of each cell, with NaN for lanes without a steady state."""
    study, gains = STUDIES[name], GAINS._replace(D_p=GAINS.D_p / 10.0)
    lanes = draw(study, 30, seed=12)
    states = many_steady_states(study, lanes, gains)
    decay = slowest_decay(study, states, lanes, gains)
    np.testing.assert_array_equal(np.isnan(decay), states.fault != 0)
    good = np.flatnonzero(states.fault == 0)
    assert 10 < len(good) < 30
    for k in good[:6]:
        R_g, L_g, V_g, omega_g, P_ref, Q_ref = (float(value[k]) for value in lanes[:6])
        model = linearise_full_order(study, [Cell(Grid(R_g, L_g), gains, P_ref, Q_ref, GridSource(V_g, omega_g))])
        slowest = modes(model.states, model.A[0], model.T_s)[0]
        # An eigenvalue z near 1 is known to some 1e-14, and its logarithm is divided by T_s.
        assert decay[k] == pytest.approx(-slowest.s.real, abs=1e-12 / study.converter.T_s)
    dead = lanes._replace(V_g_rms=0.0 * lanes.V_g_rms)
    assert np.isnan(slowest_decay(study, many_steady_states(study, dead, gains), dead, gains)).all()
