"""The projection limiter: its equations against the geometry that they stand for, and its linear model."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.simulation.studies import GAINS, lc_study, lcl_study
from tests.simulation.test_clearing import faulted, run_of
from tests.simulation.test_limiters import with_limiter
from vsgdesign.equations.controller import ControllerSettings
from vsgdesign.equations.limiters import PROJECTION, GridEstimate, IntegratorSteps, LimiterView
from vsgdesign.equations.limiters.projection import ProjectionMemory, grid_voltage_gate
from vsgdesign.equations.power_loops import References
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.simulation.survival import GridState, Subject, SurvivalCase, run_case
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.study.parameters.event import Event

STUDY = with_limiter(lc_study, "projection")
SETTINGS = STUDY.controller_settings()._replace(omega_C=0.0)
"""Without the capacitor's current the geometry below is exact."""
OWN = SETTINGS.limiter
REFS = References(2000.0, 0.0, STUDY.converter.omega_n, STUDY.converter.V_rated_rms)
GRID = GridEstimate(STUDY.grid.R_g, STUDY.grid.L_g)
Z = complex(GRID.R_g, REFS.omega_0 * GRID.L_g)
V_PK = math.sqrt(2.0) * REFS.V_n
NO_STEPS = IntegratorSteps(0.0, 0.0, 0.0)


def answers(
    v: complex,
    i_g: complex,
    want: complex = 0j,
    V: float = REFS.V_n,
    P: float = 2000.0,
    settings: ControllerSettings = SETTINGS,
) -> tuple[Any, Any, Any]:
    """One sample whose low-pass has come to rest: the answer, the steps of the integrators, and the next memory."""
    e = math.sqrt(2.0) * V - v
    view = LimiterView(
        v_d=v.real,
        v_q=v.imag,
        i_s_d=i_g.real,
        i_s_q=i_g.imag,
        i_g_d=i_g.real,
        i_g_q=i_g.imag,
        e_d=e.real,
        e_q=e.imag,
        i_want_d=want.real,
        i_want_q=want.imag,
        V=V,
        omega_i=REFS.omega_0,
        P=P,
        Q=0.0,
        K_pv=0.06,
    )
    i_w = i_g + e / (settings.limiter.Z_v * cmath.exp(1j * cmath.phase(Z)))
    memory = ProjectionMemory(i_w.real, i_w.imag, v.real, v.imag, REFS.omega_0)
    sample = PROJECTION.law.limit(memory, view, GRID, REFS, GAINS, settings)
    return sample, *PROJECTION.law.move(memory, sample, view, REFS.omega_0, NO_STEPS, settings)


@pytest.mark.parametrize(("depth", "degrees"), [(0.9, -140.0), (0.9, 90.0), (1.0, -90.0), (1.0, 60.0), (1.0, 150.0)])
def test_it_is_pulled_towards_the_nearest_voltage_that_the_grid_admits(depth: float, degrees: float) -> None:
    """The disc of voltages about v_g with radius |Z| I: its point nearest to the reference, found by search.

    The distance is flat at its least value, so the search finds the angle to about 1e-5 of it.
    """
    v_g = depth * V_PK * cmath.exp(1j * math.radians(degrees))
    disc = v_g + abs(Z) * OWN.i_soft_pk * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 2_000_001))
    nearest = complex(disc[np.argmin(np.abs(disc - V_PK))])
    assert abs(V_PK - v_g) > abs(Z) * OWN.i_soft_pk  # the reference itself lies outside
    sample, steps, memory = answers(nearest, (nearest - v_g) / Z)
    assert sample.limited == 1.0
    assert steps.theta == pytest.approx(OWN.share * cmath.phase(nearest), rel=1e-4)
    followed = math.copysign(min(abs(steps.theta), OWN.largest_pull), steps.theta)
    assert steps.omega_i == pytest.approx(OWN.g * followed, rel=1e-12)
    higher = max(abs(nearest) / math.sqrt(2.0), REFS.V_n) - REFS.V_n
    assert pytest.approx(OWN.share * higher, rel=1e-4, abs=1e-9) == steps.V
    assert abs(complex(memory.i_w_d, memory.i_w_q)) > OWN.i_soft_pk


def test_below_its_limits_it_adds_exact_zeros() -> None:
    just = 0.999999 * OWN.i_soft_pk
    sample, steps, _ = answers(complex(V_PK), just * cmath.exp(0.3j), 0.99 * SETTINGS.i_max_pk * 1j, P=-4000.0)
    assert (sample.P, sample.limited, sample.e_d, sample.e_q) == (-4000.0, 0.0, 0.0, 0.0)
    assert (sample.i_ref_d, sample.i_ref_q) == (0.0, 0.99 * SETTINGS.i_max_pk)
    assert steps == NO_STEPS


def test_the_error_is_turned_by_the_angle_of_the_grid_while_the_hard_limit_acts() -> None:
    v, want = 0.4 * V_PK * cmath.exp(0.2j), 3.0 * SETTINGS.i_max_pk * cmath.exp(-0.5j)
    sample, _, _ = answers(v, 0j, want)
    expected = (V_PK - v) * abs(Z) / Z
    assert complex(sample.e_d, sample.e_q) == pytest.approx(expected, rel=1e-12)
    assert complex(sample.i_ref_d, sample.i_ref_q) == pytest.approx(want / 3.0, rel=1e-12)


@pytest.mark.parametrize("P", [-6000.0, 0.0, 1999.0, 2001.0, 6000.0])
@pytest.mark.parametrize("degrees", [-60.0, 60.0])
def test_power_may_not_drive_the_angle_away(P: float, degrees: float) -> None:
    """The grid's angle is that of the pull: ahead, power may only accelerate; behind, only slow down."""
    v_g = V_PK * cmath.exp(1j * math.radians(degrees))
    v = v_g + (V_PK - v_g) / abs(V_PK - v_g) * abs(Z) * OWN.i_soft_pk
    sample, steps, _ = answers(v, (v - v_g) / Z, P=P)
    assert math.copysign(1.0, steps.theta) == math.copysign(1.0, degrees)
    assert pytest.approx(min(P, 2000.0) if degrees > 0.0 else max(P, 2000.0)) == sample.P


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_frequency_is_pulled_within_its_range_only(side: float) -> None:
    """At the end of the range no further, back into it as everywhere."""
    end = OWN.omega_high if side > 0.0 else OWN.omega_low
    for degrees, pulled in ((side * 90.0, False), (-side * 90.0, True)):
        v_g = V_PK * cmath.exp(1j * math.radians(degrees))
        v = v_g + (V_PK - v_g) / abs(V_PK - v_g) * abs(Z) * OWN.i_soft_pk
        sample, inside, memory = answers(v, (v - v_g) / Z)
        view = LimiterView(**dict.fromkeys(LimiterView._fields, 0.0) | {"V": REFS.V_n})
        steps, _ = PROJECTION.law.move(memory, sample, view, end, NO_STEPS, SETTINGS)
        assert steps.theta == inside.theta != 0.0
        assert steps.omega_i == (inside.omega_i if pulled else 0.0)


@pytest.mark.parametrize("error", [1.0, 1.2 * cmath.exp(0.17j), 0.8 * cmath.exp(-0.17j), 0.5, 0.1, 0.0])
def test_without_a_grid_voltage_the_power_loops_rest(error: complex) -> None:
    """At v_g = 0, whatever the error of the estimate, and in a short circuit behind a part of the grid's impedance or
    at the PCC itself: no pull, and the powers at which P and Q rows rest."""
    current = OWN.i_soft_pk * cmath.exp(0.4j)
    sample, steps, _ = answers(error * Z * current, current, P=-3000.0, V=0.95 * REFS.V_n)
    assert sample.limited == 1.0
    assert (steps.theta, steps.omega_i) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert pytest.approx(REFS.P_ref) == sample.P
    assert pytest.approx(GAINS.D_q * 0.05 * REFS.V_n) == sample.Q


def test_the_gate_opens_with_the_grid_voltage() -> None:
    """Half open where |v_g|² is 1.5 times the doubtful square."""
    current = OWN.i_soft_pk * cmath.exp(0.4j)
    doubtful = math.hypot(OWN.v_gate_pk, OWN.doubt * abs(Z) * abs(current))
    v = math.sqrt(1.5) * doubtful * 1j + Z * current
    wide = SETTINGS._replace(limiter=OWN._replace(v_gate_pk=1e-3, doubt=0.0))
    half, whole = answers(v, current)[1].theta, answers(v, current, settings=wide)[1].theta
    assert whole != 0.0
    assert half == pytest.approx(0.5 * whole, rel=1e-9)


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_the_gate_is_the_least_voltage_behind_any_part_of_the_grid(build: Callable[..., Study]) -> None:
    """The least of the voltages v − (Z_2 + a Z_g) i by search over a from 0 to 1, with and without an L_2."""
    study = with_limiter(build, "projection")
    c, omega, rng = study.controller_settings().limiter, study.converter.omega_n, np.random.default_rng(1)
    Z_2, Z_g = complex(c.R_2, omega * c.L_2), complex(study.grid.R_g, omega * study.grid.L_g)
    places, gates = np.linspace(0.0, 1.0, 100_001), []
    for _ in range(200):
        i = 1.2 * study.converter.I_rated_pk * cmath.exp(2j * math.pi * rng.random())
        v = (Z_2 + rng.uniform(-0.3, 1.3) * Z_g) * i + complex(*rng.normal(0.0, 1.5 * c.v_gate_pk, 2))
        behind = abs(v - (Z_2 + Z_g) * i) ** 2 / (c.v_gate_pk**2 + (c.doubt * abs(Z_2 + Z_g) * abs(i)) ** 2)
        least = np.abs(v - (Z_2 + places * Z_g) * i).min() / c.v_gate_pk
        v_Z, v_Zg = (Z_2 + Z_g) * i, Z_g * i
        drops = v_Z.real, v_Z.imag, v_Zg.real, v_Zg.imag
        gates.append(grid_voltage_gate(v.real, v.imag, *drops, c.v_gate_pk, c.doubt))
        assert gates[-1] == pytest.approx(min(max(behind - 1.0, 0.0), 0.5 * least**2, 1.0), abs=1e-8)
    assert min(gates) == 0.0
    assert max(gates) == 1.0
    assert sum(0.02 < gate < 0.98 for gate in gates) > 50


@pytest.mark.parametrize("R_pu", [0.0, 0.003])
@pytest.mark.parametrize("scr", [2.0, 5.0])
def test_a_bolted_fault_at_the_pcc_does_not_turn_the_angle(scr: float, R_pu: float) -> None:
    """120 ms without any voltage. Its own current is all that an LC converter sees there: it turned by up to 16 rad."""
    run = run_of(faulted(f'{{ kind = "three_phase", at = 0, R_pu = {R_pu} }}', scr=scr))
    delta = np.unwrap(run.column("theta") - run.timeline.source_phase(run.t_s))
    fault = (run.t_s > 0.1) & (run.t_s < 0.22)
    assert np.ptp(run.column("limited_samples")[fault]) > 0.9 * fault.sum()
    assert np.abs(delta[fault] - delta[run.t_s <= 0.1][-1]).max() < 0.3


@pytest.mark.parametrize("degrees", [165.0, 175.0, 180.0, -170.0])
def test_a_jump_by_half_a_turn_does_not_hold_it_at_a_closed_gate(degrees: float) -> None:
    """At SCR 1.2 and 1.2 pu, the voltage is nearly zero after such a jump, as in a fault at the PCC: the disc of what
    the grid admits reaches to zero. The pull is weak there, but it does not end."""
    study = load_study("studies/survival/study.toml")
    subject = Subject(study=study, spec=study.controllers[2], limit_pu=1.2)
    case = SurvivalCase(
        group="phase",
        start=GridState(scr=1.2, x_over_r=10.0, P_pu=0.4, Q_pu=0.0),
        changes=(Event.of_pu(0.0, phase_deg=degrees),),
        cleared_s=0.0,
    )
    verdict = run_case(subject, case).verdict
    assert verdict.status == "survived", verdict.reason


@pytest.mark.parametrize(("V", "step", "end"), [(0.71, -50.0, 0.70), (1.29, 50.0, 1.30), (1.0, 5.0, 1.0 + 5.0 / 110.0)])
def test_V_stays_between_its_limits(V: float, step: float, end: float) -> None:
    V_rms = V * REFS.V_n
    sample, _, memory = answers(complex(math.sqrt(2.0) * V_rms), 0j, V=V_rms)
    view = LimiterView(**dict.fromkeys(LimiterView._fields, 0.0) | {"V": V_rms})
    steps, _ = PROJECTION.law.move(memory, sample, view, REFS.omega_0, IntegratorSteps(0.0, 0.0, step), SETTINGS)
    assert V_rms + steps.V == pytest.approx(end * REFS.V_n, rel=1e-12)


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_the_linear_model_has_the_modes_of_the_circular_limit_and_its_own_memory(build: Callable[..., Study]) -> None:
    cell = Cell(build("10 ms").grid, GAINS, 2000.0, 500.0)
    circular = linearise_full_order(with_limiter(build, "circular"), [cell])
    model = linearise_full_order(with_limiter(build, "projection"), [cell])
    count = len(circular.states)
    assert model.states[count:] == tuple(f"limiter_{name}" for name in ("i_w_d", "i_w_q", "v_d", "v_q", "omega"))
    np.testing.assert_array_equal(model.A[0][:count, :count], circular.A[0])
    np.testing.assert_array_equal(model.A[0][:count, count:], 0.0)  # its memory acts on nothing
    kept = 1.0 - with_limiter(build, "projection").controller_settings().limiter.smoothing_i
    np.testing.assert_allclose(np.diag(model.A[0][count:, count:]), [kept, kept, kept, kept, 0.0], rtol=1e-12)
    after = np.array(model.map.step(model.z[0], model.p[0])[0])[:, 0]
    np.testing.assert_allclose(after, model.z[0], rtol=1e-9, atol=1e-9)
