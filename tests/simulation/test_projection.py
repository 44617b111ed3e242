"""The projection limiter: its equations against the geometry that they stand for, and its linear model."""

from __future__ import annotations

import cmath
import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.simulation.studies import GAINS, lc_study, lcl_study
from tests.simulation.test_clearing import faulted, run_of
from tests.simulation.test_limiters import with_limiter
from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement, controller_step
from vsgdesign.equations.limiters import (
    CIRCULAR,
    PROJECTION,
    GridEstimate,
    IntegratorSteps,
    LimiterLaw,
    LimiterView,
)
from vsgdesign.equations.limiters.projection import ProjectionMemory, grid_voltage_gate
from vsgdesign.equations.power_loops import References
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.simulation.survival import GridKnowledge, GridState, Subject, SurvivalCase, run_case
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
    beyond: float = 0.0,
    full: float = 0.0,
    grid: GridEstimate = GRID,
    refs: References = REFS,
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
        full=full,
    )
    Z = complex(grid.R_g, refs.omega_0 * grid.L_g)
    i_w = i_g + e / (settings.limiter.Z_v * cmath.exp(1j * cmath.phase(Z)))
    memory = ProjectionMemory(i_w.real, i_w.imag, v.real, v.imag, REFS.omega_0, beyond)
    sample = PROJECTION.law.limit(memory, view, grid, refs, GAINS, settings)
    return sample, *PROJECTION.law.move(memory, sample, view, refs.omega_0, NO_STEPS, settings)


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
    want = 0.99 * SETTINGS.i_max_pk * 1j
    sample, steps, memory = answers(complex(V_PK), just * cmath.exp(0.3j), want, P=-4000.0, full=1.0)
    assert (sample.P, sample.limited, sample.e_d, sample.e_q) == (-4000.0, 0.0, 0.0, 0.0)
    assert (sample.i_ref_d, sample.i_ref_q) == (0.0, 0.99 * SETTINGS.i_max_pk)
    assert steps == NO_STEPS
    assert memory.beyond == 0.0


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


def angles_of(v_g: complex, V: float, Z: complex) -> tuple[Any, Any]:
    """Angles of v to v_g over a turn, and the power that V carries at each of them, W; complex arithmetic alone."""
    delta = np.linspace(-math.pi, math.pi, 20_001)
    v = V * np.exp(1j * delta)
    return delta, 1.5 * (v * np.conj((v - abs(v_g)) / Z)).real


def gate_of(v: complex, drop: complex) -> Any:
    """The gate without an L_2."""
    return grid_voltage_gate(v.real, v.imag, drop.real, drop.imag, drop.real, drop.imag, OWN.v_gate_pk, OWN.doubt)


@pytest.mark.parametrize("grid", [GRID, GridEstimate(4.0, 4e-3)])
@pytest.mark.parametrize("beyond", [0.0, 0.4, 0.9999])
def test_the_time_beyond_the_largest_power_counts_at_the_soft_limit_alone(grid: GridEstimate, beyond: float) -> None:
    """dP/dδ < 0, from the curve P(δ) of the circuit. Where no limit acts or the gate is less than half open, the time
    counts back, and where P rises with δ it begins anew."""
    Z, counted = complex(grid.R_g, REFS.omega_0 * grid.L_g), []
    delta, P = angles_of(V_PK, V_PK, Z)
    for place in range(500, 20_000, 700):
        v_g = V_PK * cmath.exp(-1j * delta[place])
        i_g = (V_PK - v_g) / Z
        _, _, memory = answers(complex(V_PK), i_g, P=float(P[place]), beyond=beyond, grid=grid)
        limited, open_gate = abs(i_g) > OWN.i_soft_pk, gate_of(complex(V_PK), Z * i_g) >= 0.5
        sign = 1.0 if limited and open_gate else -1.0
        falls = P[place + 1] < P[place - 1]
        expected = min(max(beyond + sign * SETTINGS.T_s / 0.1, 0.0), 1.0) if falls else 0.0
        assert memory.beyond == pytest.approx(expected, rel=1e-12, abs=1e-15)
        counted.append((falls, limited, open_gate))
    assert min(Counter(counted).values()) > 1
    assert {(True, True, True), (True, True, False), (False, True, True)} <= set(counted)


def test_a_wrong_estimate_turns_no_full_turn_in_a_sag_to_zero() -> None:
    """Estimated is the grid of the safe place of a gain table, and the true one has SCR 5 and X/R 5. A way back to the
    voltage that this makes up turned the angle by 8.9 rad in 0.4 s."""
    system = load_study("studies/survival/laboratory.toml")
    (spec,) = [one for one in system.controllers if one.name == "angle_damped"]
    case = SurvivalCase(
        group="sag",
        start=GridState(scr=5.0, x_over_r=5.0, P_pu=0.9, Q_pu=0.0),
        changes=(Event.of_pu(0.0, V_g_pu=0.0), Event.of_pu(0.4, V_g_pu=1.0)),
        cleared_s=0.4,
        knowledge=GridKnowledge(silent_s=0.2, magnitude=2.38, angle_deg=-26.7),
    )
    verdict = run_case(Subject(study=system, spec=spec, limit_pu=1.2), case).verdict
    assert verdict.status == "survived", verdict.reason
    assert verdict.swing_rad is not None
    assert verdict.swing_rad < 4.5


@pytest.mark.parametrize("degrees", [-130.0, -60.0, -25.0, -5.0, 20.0, 100.0, 150.0])
@pytest.mark.parametrize("scr", [1.0, 3.0])
def test_the_way_back_goes_to_the_angle_of_the_grid_and_ends_half_way(degrees: float, scr: float) -> None:
    """On a resistive grid: P and Q rows rest, θ goes its share of the way to δ = 0, and the end is half-way between the
    largest import and δ = 0."""
    Z, delta = 12.0 / scr * cmath.exp(0.6j), math.radians(degrees)
    grid = GridEstimate(Z.real, Z.imag / REFS.omega_0)
    v_g = V_PK * cmath.exp(-1j * delta)
    i_g = (V_PK - v_g) / Z
    sample, steps, memory = answers(complex(V_PK), i_g, P=-9000.0, beyond=1.0, grid=grid)
    inside = -0.5 * 0.6 < delta < math.pi - 1.5 * 0.6
    assert memory.beyond == (0.0 if inside else 1.0)
    if not inside:
        _, without, _ = answers(complex(V_PK), i_g, P=-9000.0, grid=grid)
        assert (sample.P, sample.Q, sample.limited) == pytest.approx((REFS.P_ref, REFS.Q_ref, 1.0))
        share = gate_of(complex(V_PK), Z * i_g) * -math.expm1(-SETTINGS.T_s / 0.05)
        assert steps.theta - without.theta == pytest.approx(-share * delta, rel=1e-9)


@pytest.mark.parametrize("V_g", [0.05, 0.25, 0.44, 0.55, 0.65, 0.9])
def test_the_power_loops_rest_where_no_angle_carries_the_power(V_g: float) -> None:
    """P over all angles of the circuit, below the soft limit. Altogether up to 0.45 pu of grid voltage, from there to
    0.64 pu in part, and above as far as the gate is closed, which it is not."""
    Z, v, held = 12.0 * cmath.exp(0.4j), 0.75 * V_PK, []
    grid = GridEstimate(Z.real, Z.imag / REFS.omega_0)
    v_g = V_g * V_PK
    i_g = (v - v_g) / Z
    _, P = angles_of(complex(v_g), v, Z)
    for P_rest in np.linspace(P.min() - 0.2 * np.ptp(P), P.max() + 0.2 * np.ptp(P), 21):
        refs = REFS._replace(P_ref=float(P_rest))
        sample, steps, _ = answers(complex(v), i_g, V=v / math.sqrt(2.0), P=100.0, grid=grid, refs=refs)
        gate = gate_of(v, Z * i_g)
        held.append(not P.min() <= P_rest <= P.max())
        rests = max(1.0 - gate, min(max(2.0 - (V_g / 0.45) ** 2, 0.0), 1.0))
        assert pytest.approx(100.0 + rests * (P_rest - 100.0) * held[-1]) == sample.P
        assert sample.limited == (held[-1] and rests > 0.0)
        assert steps == NO_STEPS
        assert (rests == 1.0) == (V_g < 0.45)
        assert (rests == 0.0) == (V_g > 0.64)
    assert 4 < sum(held) < 17


def test_nothing_is_given_back_at_the_limit_of_the_bridge() -> None:
    """The hard limit alone clips crests, and the integrators take up the whole error. With the bridge at its limit they
    take up what the back-calculation leaves, and V goes down to the voltage that there is."""
    v, want = 0.96 * V_PK * cmath.exp(0.02j), 1.3 * SETTINGS.i_max_pk * cmath.exp(0.4j)
    crests, up, _ = answers(v, 0j, want)
    short, down, _ = answers(v, 0j, want, full=1.0)
    e = V_PK - v
    removed = want - complex(short.i_ref_d, short.i_ref_q)
    assert complex(crests.e_d, crests.e_q) == pytest.approx(e + removed / 0.06)
    assert complex(short.e_d, short.e_q) == pytest.approx(e)
    assert up.V == 0.0
    assert pytest.approx(-0.04 * REFS.V_n * OWN.share) == down.V
    # Above its reference V is left alone, and so is all where the soft limit acts.
    assert answers(1.02 * V_PK + 0j, 0j, want, full=1.0)[1].V == 0.0
    deep = 0.4 * v
    assert answers(deep, 0j, want, full=1.0)[:2] == answers(deep, 0j, want)[:2]


@pytest.mark.parametrize("share", [0.9999, 0.99996, 1.0])
def test_a_limiter_is_told_that_the_bridge_is_at_its_limit(share: float) -> None:
    """By the voltage of the last sample, whatever its direction, up to the rounding of the limit itself."""
    seen = []

    def look(memory: Any, view: LimiterView, *given: Any) -> Any:
        seen.append(view.full)
        return CIRCULAR.law.limit(memory, view, *given)

    law = LimiterLaw(look, CIRCULAR.law.move)
    settings = with_limiter(lc_study, "circular").controller_settings()
    for angle in np.linspace(0.0, 6.0, 7):
        u = share * settings.v_max_pk * cmath.exp(1j * angle)
        state = ControllerState(0.0, REFS.omega_0, REFS.V_n, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        state = state._replace(u_alpha=u.real, u_beta=u.imag)
        measured = Measurement(V_PK, 0.0, 0.0, 0.0, 0.0, 0.0)
        controller_step(state, measured, GRID, REFS, GAINS, STUDY.inner_gains, settings, law)
    assert seen == [1.0 if share > 0.9999 else 0.0] * 7


def sag(V_g_pu: float, degrees: float) -> list[dict[str, float]]:
    return [{"V_g_pu": V_g_pu, "phase_deg": -degrees}, {"V_g_pu": 1.0, "phase_deg": degrees}]


def ramp(df_hz: float, over_s: float) -> list[dict[str, float]]:
    return [{"df_hz": df_hz, "over_s": over_s}, {"df_hz": 0.0, "over_s": over_s}]


@pytest.mark.parametrize(
    ("study", "start", "changes", "cleared_s"),
    [
        # The angle rests beyond the largest import, at the soft limit.
        pytest.param("study", (1.264, 0.4, -0.16, -3.0), sag(0.7, 30.0), 0.5, id="beyond after a sag"),
        pytest.param("study", (1.25, 0.32, -0.1, -0.64), ramp(0.5, 0.34), 0.7, id="beyond after a ramp"),
        # The grid is a resistor while its voltage is away: P is above its reference at every angle.
        pytest.param("study", (1.232, 0.313, -0.192, -2.841), sag(0.015, 30.0), 0.3, id="no angle"),
        # The voltage of the bridge is at its limit, and the voltage loop winds up.
        pytest.param("utility", (1.6, 0.4, 0.3, 5.0), ramp(-1.0, 0.5), 1.0, id="full bridge"),
    ],
)
def test_a_weak_resistive_grid_does_not_keep_it(
    study: str, start: tuple[float, ...], changes: list[dict[str, float]], cleared_s: float
) -> None:
    """Each has a rest within the limits, and was lost for good. Powers are references; the last change begins at
    ``cleared_s``."""
    system = load_study(f"studies/survival/{study}.toml")
    (spec,) = [one for one in system.controllers if one.name == "angle_damped"]
    first, last = (Event.of_pu(at_s, **change) for at_s, change in zip((0.0, cleared_s), changes, strict=True))
    case = SurvivalCase(
        group="weak",
        start=GridState(**dict(zip(("scr", "x_over_r", "P_pu", "Q_pu"), start, strict=True))),
        changes=(first, last),
        cleared_s=cleared_s + last.over,
        knowledge=GridKnowledge(silent_s=0.2),
    )
    verdict = run_case(Subject(study=system, spec=spec, limit_pu=1.2), case).verdict
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
    assert model.states[count:] == tuple(
        f"limiter_{name}" for name in ("i_w_d", "i_w_q", "v_d", "v_q", "omega", "beyond")
    )
    np.testing.assert_array_equal(model.A[0][:count, :count], circular.A[0])
    np.testing.assert_array_equal(model.A[0][:count, count:], 0.0)  # its memory acts on nothing
    kept = 1.0 - with_limiter(build, "projection").controller_settings().limiter.smoothing_i
    np.testing.assert_allclose(np.diag(model.A[0][count:, count:]), [kept, kept, kept, kept, 0.0, 0.0], rtol=1e-12)
    after = np.array(model.map.step(model.z[0], model.p[0])[0])[:, 0]
    np.testing.assert_allclose(after, model.z[0], rtol=1e-9, atol=1e-9)
