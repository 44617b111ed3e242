"""The large-signal statement: its energy against the limiter's own law, its proof against samples, and its limits."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from tests.design.test_certificate_proof import systems
from vsgdesign.certificate import Region
from vsgdesign.certificate.box_check import bounds, cover
from vsgdesign.certificate.boxes import Boxes, parameters_of, whole_region
from vsgdesign.certificate.region import System, random_points
from vsgdesign.certificate.swing import SwingLaw, SwingStart, large_signal, swing_law, swing_statement
from vsgdesign.certificate.swing.check import SwingLoops, gains_hold, looks, with_angle
from vsgdesign.certificate.swing.conditions import gains_tests, limited_tests
from vsgdesign.certificate.swing.statement import loops_at
from vsgdesign.equations.frames import PHASES, peak_to_rms, rms_to_peak
from vsgdesign.equations.limiter_interface import GridEstimate, IntegratorSteps, LimiterView
from vsgdesign.equations.limiters.projection import PROJECTION, WAY_BACK_S, ProjectionMemory, grid_voltage_gate
from vsgdesign.equations.power_loops import References, frequency_at_rest, power_loops
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.report.gain_table.words import swing_text
from vsgdesign.runtime.of_study import schedule_of
from vsgdesign.study.parameters import ControllerSpec, Study, load_study

STUDY = load_study("studies/survival/study.toml")
SPEC = next(spec for spec in STUDY.controllers if spec.name == "angle_damped")
LAW = swing_law(STUDY, SPEC)
S = STUDY.converter.S_rated
REGION = Region((3.0, 6.0), (3.0, 6.0), (-0.9 * S, 0.9 * S), (-0.4 * S, 0.4 * S))


def system(study: Study = STUDY, spec: ControllerSpec = SPEC) -> System:
    return System(study, schedule_of(study, spec))


def random_loops(region: Region, count: int, seed: int, law: SwingLaw = LAW, error: float = 0.0) -> list[SwingLoops]:
    """Operating points of the region within the static limits and with at most 0.9 of the limit."""
    rng, here, found = np.random.default_rng(seed), system(), []
    boxes = with_angle(whole_region(here, region), 0.0, 0.0, error)
    c = STUDY.converter
    while len(found) < count:
        k = rng.integers(len(boxes))
        place = boxes.low[k] + rng.random(6) * (boxes.high[k] - boxes.low[k])
        try:
            loops, point = loops_at(here, law, place, False)
        except ValueError:
            continue
        power = math.hypot(loops.P, loops.Q)
        low, high = c.V_limits_rms
        strongest = PHASES * loops.V**2 / math.hypot(loops.R, loops.X)
        fine = low <= loops.V <= high and strongest >= 1.3 * power
        fine &= region.P[0] <= point.P <= region.P[1] and region.Q[0] <= point.Q <= region.Q[1]
        if fine and power / (PHASES * loops.V) <= 0.9 * law.i_max * loops.I_rated_rms:
            found.append(loops)
    return found


def held_voltage(loops: SwingLoops, delta: float) -> tuple[complex, complex]:
    """v and i_g (rms, in the frame of the grid) while the current is held at its limit in the direction of e/Ẑ."""
    Z, u = complex(loops.R, loops.X), cmath.rect(loops.V, delta)
    gap, limit = u - loops.V_g, loops.law.i_max * loops.I_rated_rms
    if abs(gap / Z) <= limit:
        return u, gap / Z
    turned = abs(Z) * limit * cmath.exp(-1j * loops.angle_error)
    length: Any = brentq(lambda e: abs(e + turned) - abs(gap), 0.0, 10.0 * abs(gap), xtol=1e-13)
    e = length * gap / (length + turned) / abs(gap / (length + turned))
    return u - e, (u - e - loops.V_g) / Z


def limiter_settings(T_s: float) -> Any:
    """The settings of the study's controller at another sampling time, without low-pass and without capacitor."""
    study = replace(
        STUDY,
        converter=replace(STUDY.converter, f_sw=1.0 / T_s, samples_per_carrier=1),
        limiter_given=(("filter_time", 0.0),),
    )
    return study.with_limit_of(SPEC).controller_settings()._replace(omega_C=0.0)


class Controller:
    """The project's own limiter and power loops in a quasi-static network, sample by sample, with V held."""

    def __init__(self, loops: SwingLoops, delta: float, speed: float, T_s: float = 1e-4) -> None:
        self.loops, self.T_s, self.delta = loops, T_s, delta
        self.settings = limiter_settings(T_s)
        omega_0 = STUDY.converter.omega_n
        # V_n = V: then Q_ref is the reactive power at rest.
        self.refs = References(loops.P, loops.Q, omega_0, loops.V)
        self.omega_i = frequency_at_rest(self.refs, loops.gains) + loops.kept * speed
        self.omega = omega_0 + speed
        self.beyond = self.longest = 0.0
        angle = cmath.phase(complex(loops.R, loops.X)) + loops.angle_error
        Z = cmath.rect(math.hypot(loops.R, loops.X), angle)
        f = STUDY.filter
        self.grid = GridEstimate(Z.real - f.R_2, Z.imag / omega_0 - f.L_2)

    @property
    def speed(self) -> float:
        return (self.omega_i - frequency_at_rest(self.refs, self.loops.gains)) / self.loops.kept

    def step(self) -> None:
        v, i = (rms_to_peak(x * cmath.exp(-1j * self.delta)) for x in held_voltage(self.loops, self.delta))
        power = PHASES * peak_to_rms(v) * peak_to_rms(i.conjugate())
        e = rms_to_peak(self.loops.V) - v
        view = LimiterView(
            v_d=v.real,
            v_q=v.imag,
            i_s_d=i.real,
            i_s_q=i.imag,
            i_g_d=i.real,
            i_g_q=i.imag,
            e_d=e.real,
            e_q=e.imag,
            i_want_d=0.0,
            i_want_q=0.0,
            V=self.loops.V,
            omega_i=self.omega_i,
            P=power.real,
            Q=power.imag,
            K_pv=0.1,
            full=0.0,
        )
        memory = ProjectionMemory(0.0, 0.0, v.real, v.imag, self.omega, self.beyond)
        sample = PROJECTION.law.limit(memory, view, self.grid, self.refs, self.loops.gains, self.settings)
        self.omega, rate, _ = power_loops(self.omega_i, self.loops.V, sample.P, sample.Q, self.refs, self.loops.gains)
        wanted = IntegratorSteps(self.T_s * (self.omega - self.refs.omega_0), self.T_s * rate, 0.0)
        taken, remembered = PROJECTION.law.move(memory, sample, view, self.omega, wanted, self.settings)
        self.beyond = float(remembered.beyond)
        self.longest = max(self.longest, self.beyond)
        self.delta += taken.theta
        self.omega_i += taken.omega_i


def potential(loops: SwingLoops, deltas: NDArray[np.float64]) -> NDArray[np.float64]:
    """U of :eq:`swing-function` at rising angles, in rad²/s², zero at the first: by the trapezoidal rule."""
    force = []
    for delta in deltas:
        at = loops.limited(float(delta))
        force.append(loops.law.g * loops.pull(at.phi) + loops.gains.K_ip * loops.errors(at, 0.0)[1])
    steps = 0.5 * (np.array(force[1:]) + np.array(force[:-1])) * np.diff(deltas)
    return np.concatenate([[0.0], np.cumsum(steps)])


def energy_along(
    loops: SwingLoops, delta: float, speed: float, duration: float
) -> tuple[NDArray[np.float64], Controller]:
    """W every millisecond of a run of the project's own law, and the controller at its end."""
    run = Controller(loops, delta, speed)
    states = []
    for k in range(round(duration / run.T_s)):
        if k % 10 == 0:
            states.append((run.delta, run.speed))
        run.step()
    deltas, speeds = np.array(states).T
    mesh = np.linspace(-math.pi, math.pi, 4001)
    return 0.5 * loops.kept * speeds**2 + np.interp(deltas, mesh, potential(loops, mesh)), run


@pytest.mark.parametrize("seed", range(3))
def test_the_energy_falls_while_the_limiters_own_law_runs(seed: int) -> None:
    """The law of the EMT in a quasi-static network, from 100° to 170°, with 1 Hz beside the grid: W falls, and the
    angle comes back. The tolerance is what one sample of 0.1 ms moves of W at the steepest place."""
    (loops,) = random_loops(REGION, 1, seed, error=(0.0, 0.0, 0.1)[seed])
    rng = np.random.default_rng(seed)
    delta = float(rng.choice([-1.0, 1.0]) * math.radians(rng.uniform(100.0, 170.0)))
    W, run = energy_along(loops, delta, float(rng.choice([-1.0, 1.0])) * 2.0 * math.pi, 1.2)
    assert np.diff(W).max() <= 1e-3 * np.ptp(W)
    rest = math.remainder(loops.rest, 2.0 * math.pi)
    assert abs(run.delta - rest) < 0.02
    assert run.longest == 0.0  # |Z| I_max < V_g sin α: the voltage that is held is never beyond the largest power
    # What is compared with is large: the function fell by most of its height.
    assert W[-1] - potential(loops, np.linspace(-math.pi, loops.rest, 4001))[-1] < 0.02 * np.ptp(W)


@pytest.mark.parametrize(("k", "error"), [(0, 0.0), (0, 0.17), (3, 0.1), (4, 0.1)])
def test_the_programs_are_the_equations(k: int, error: float) -> None:
    """Two writings of the limited voltage: symbols in units of the estimate, and complex numbers in volts; for a closed
    form on either basis of the SCR and for a table."""
    here, rng = systems()[k] if k else system(), np.random.default_rng(1)
    weak = replace(REGION, scr=(2.0, 10.0), x_over_r=(0.8, 9.0))
    boxes = with_angle(whole_region(here, weak), -3.0, 3.0, error)
    which = rng.integers(len(boxes), size=4000)
    places = boxes.low[which] + rng.random((4000, 6)) * (boxes.high - boxes.low)[which]
    exact = places * [1.0, 1.0, 1.0, 1.0, 0.0, 0.0]
    own, compared = parameters_of(here, Boxes(exact, exact, boxes.piece[which]), whole_region(here, weak)), 0
    for test in limited_tests(here, weak, LAW):
        least, most, _ = bounds(test.program, places, places, own)
        count = len(test.names)
        inside = ((most[count:] >= test.conditions[:, :1]) & (least[count:] <= test.conditions[:, 1:])).all(axis=0)
        for i in np.flatnonzero(inside)[:10]:
            loops, _ = loops_at(here, LAW, places[i], False)
            at, g = loops.limited(float(places[i, 4])), loops.gains
            told = dict(zip(test.names, 0.5 * (least + most)[:count, i], strict=True))
            assert math.atan2(told["turned"], told["left"]) == pytest.approx(at.phi, abs=1e-9)
            assert told["pulled_by_P"] == pytest.approx(g.K_ip * (at.P - loops.P), rel=1e-8, abs=1e-8)
            assert told["turned_by_Q"] == pytest.approx(g.k_Q * (at.Q - loops.Q), rel=1e-8, abs=1e-8)
            assert told["kept"] == pytest.approx(loops.kept, rel=1e-9)
            compared += 1
    assert compared >= 12


def test_bounds_enclose_the_points_of_a_box() -> None:
    here, rng = system(), np.random.default_rng(2)
    boxes = with_angle(whole_region(here, REGION), 0.5, 2.5, 0.1)
    test = limited_tests(here, REGION, LAW)[3]
    width = boxes.high - boxes.low
    low = boxes.low + rng.random((20, 6)) * 0.9 * width
    high = low + 0.1 * width
    least, most, _ = bounds(test.program, low, high, parameters_of(here, boxes, boxes)[:, [0] * 20])
    for _ in range(20):
        places = low + rng.random((20, 6)) * (high - low)
        one, other, _ = bounds(test.program, places, places, np.ones((4, 20)))
        bounded = np.isfinite(least) & np.isfinite(most) & np.isfinite(one)
        assert bounded.any()
        assert ((one >= least - 1e-9) & (other <= most + 1e-9))[bounded].all()


def test_what_is_proved_holds_at_random_states() -> None:
    """The proof is about boxes of operating points; here are points, with an error of the angle, and random speeds."""
    found = swing_statement(STUDY, SPEC, REGION, start=SwingStart(angle_error=0.05), parts=(1, 1), budget=300_000)
    assert found.proved
    assert "proved to return to its rest on 1 of 1 parts" in swing_text(found)
    assert found.as_document()["parts"][0]["grade"] == "proved"
    rng = np.random.default_rng(3)
    for loops in random_loops(REGION, 60, 3, error=0.05):
        assert loops.limited(loops.unstable_rest()).phi != 0.0
        for _ in range(10):
            delta, speed = float(rng.uniform(-found.start.angle, found.start.angle)), float(rng.normal(0.0, 10.0))
            assert loops.slope(delta, speed) <= 1e-9


def test_an_error_of_the_angle_takes_the_largest_angles_from_a_weak_grid() -> None:
    """At SCR 1.6, 174.5° and an error of 10° the held current turns the voltage against the reference: V_g sin δ is
    less than |Z| I_max sin ε."""
    region = replace(REGION, scr=(1.6, 1.62), x_over_r=(15.0, 16.0))
    start = SwingStart(math.radians(174.5))
    assert swing_statement(STUDY, SPEC, region, start=start, parts=(1, 1), budget=100_000).proved
    start = replace(start, angle_error=math.radians(10.0))
    (part,) = swing_statement(STUDY, SPEC, region, start=start, parts=(1, 1), budget=100_000).parts
    assert (part.grade, part.undecided) == ("not proved", "edge")
    (loops,) = random_loops(region, 1, 7)
    wrong = replace(loops, angle_error=-math.radians(10.0))
    assert loops.limited(start.angle).phi > 0.0 > wrong.limited(start.angle).phi


def test_nothing_is_proved_where_the_gate_may_close_on_a_grid_that_is_whole() -> None:
    """At SCR 1.3 the disc of what the grid admits comes as near to zero as the gate's voltage, close to half a turn.
    The gate of the limiter itself says so."""
    region = replace(REGION, scr=(1.3, 1.32), x_over_r=(15.0, 16.0))
    (part,) = swing_statement(STUDY, SPEC, region, parts=(1, 1), budget=100_000).parts
    assert (part.grade, part.undecided) == ("not proved", "rest")
    c = limiter_settings(1e-4).limiter
    for scr, some in ((region.scr, True), ((1.6, 1.62), False)):
        closed = 0
        for loops in random_loops(replace(region, scr=scr), 20, 5):
            for delta in np.linspace(-math.pi, math.pi, 101):
                v, i = held_voltage(loops, float(delta))
                if loops.limited(float(delta)).phi != 0.0:
                    v, drop = rms_to_peak(v), rms_to_peak(complex(loops.R, loops.X) * i)
                    drops = drop.real, drop.imag, drop.real, drop.imag
                    closed += grid_voltage_gate(v.real, v.imag, *drops, c.v_gate_pk, c.doubt) < 1.0
        assert (closed > 0) == some


def test_without_the_one_sided_power_a_counterexample_is_found() -> None:
    """P may then drive the angle away from the admitted voltage: the energy rises, which the equations confirm."""
    slow = replace(LAW, g=2.0)  # the pull of the frequency alone is then too weak to outweigh the power
    region = replace(REGION, scr=(3.0, 3.3), x_over_r=(3.0, 3.3))
    assert swing_statement(STUDY, SPEC, region, law=slow, parts=(1, 1), budget=100_000).proved
    law = replace(slow, one_sided=False)
    found = swing_statement(STUDY, SPEC, region, law=law, parts=(1, 1), budget=100_000)
    (part,) = found.parts
    assert part.grade == "counterexample"
    assert part.at is not None
    assert part.at.condition == "falling"
    assert "the energy rises while the limit acts" in swing_text(found)
    assert part.at.delta is not None


def test_an_unstable_rest_within_the_limit_is_a_counterexample_and_keeps_the_angle() -> None:
    """A weak resistive grid: from beyond the unstable rest the angle does not come back. Without filter and low-pass it
    rests at the very edge of the disc, where no way back begins."""
    region = Region((1.5, 1.6), (0.36, 0.42), (-0.1 * S, -0.05 * S), (0.15 * S, 0.25 * S))
    (part,) = swing_statement(STUDY, SPEC, region, parts=(1, 1), budget=100_000).parts
    assert (part.grade, part.undecided) == ("counterexample", "rest")
    loops = next(one for one in random_loops(region, 30, 4) if one.limited(one.unstable_rest()).phi == 0.0)
    other = loops.unstable_rest()
    assert np.abs(loops.rates(other, 0.0)).max() < 1e-9
    away = math.copysign(0.02, other - loops.rest)
    _, inside = energy_along(loops, other - away, 0.0, 1.2)
    assert abs(inside.delta - loops.rest) < 0.05
    _, outside = energy_along(loops, other + away, 0.0, 1.2)
    assert abs(outside.delta - loops.rest) > abs(other - loops.rest)
    assert outside.longest < 0.5  # the soft limit acts in less than half of the samples


@pytest.mark.parametrize("speed", [-8.0, -1.0, 1.0])
def test_on_the_way_back_an_energy_falls(speed: float) -> None:
    """mΔ²/2 + g∫s dδ, where s follows both pulls. The angle of the voltage ends half-way between the largest import and
    that of the grid."""
    region = Region((1.2, 1.4), (0.3, 0.5), (-0.1 * S, 0.1 * S), (-0.1 * S, 0.1 * S))
    loops, mesh = random_loops(region, 1, 1)[0], np.linspace(-math.pi, math.pi, 4001)
    law, alpha = loops.law, math.atan2(loops.X, loops.R)
    turned = np.array([cmath.phase(held_voltage(loops, delta)[0]) for delta in mesh])
    both = np.array([loops.limited(delta).phi for delta in mesh]) / law.tau + turned / WAY_BACK_S
    pull = law.g * np.clip(both, -law.largest_pull, law.largest_pull)
    pulled = np.concatenate([[0.0], np.cumsum(0.5 * (pull[1:] + pull[:-1]) * np.diff(mesh))])
    run, states = Controller(loops, -1.6, speed), []
    run.beyond = 1.0
    while run.beyond >= 1.0:
        states.append((run.delta, run.speed))
        run.step()
    deltas, speeds = np.array(states).T
    energy = 0.5 * loops.kept * speeds**2 + np.interp(deltas, mesh, pulled)
    assert len(states) > 100
    assert np.diff(energy).max() <= 1e-3 * np.ptp(energy)
    assert cmath.phase(held_voltage(loops, run.delta)[0]) == pytest.approx(-0.5 * alpha, abs=0.01)


def test_a_rest_does_not_touch_a_low_soft_limit() -> None:
    """A soft limit below 0.9 of the limit leaves out what rests above it."""
    study = replace(STUDY, limiter_given=(("soft_limit_pu", 0.9),))
    law = swing_law(study, SPEC)
    assert law.i_rest < law.i_soft < 0.9 * law.i_max
    assert LAW.i_rest == pytest.approx(0.9 * LAW.i_max)


def test_the_gains_of_estimates_with_an_error_of_Z_are_decided_on_their_boxes() -> None:
    """K_ip > 0 for every estimate of a resistive and of an inductive grid, and a place that fails is of the region."""
    region = Region((5.0, 5.5), (12.0, 15.0), (0.0, 0.1 * S), (0.0, 0.1 * S), error=0.1, error_Z=0.1)
    here = replace(system(), region=region)
    boxes = whole_region(here, region)
    assert boxes.errors is not None
    assert boxes.high[:, 1].max() > 0.5 * math.pi  # R̂ < 0
    found = cover(looks(here, gains_tests(here, region, LAW), boxes, gains_hold), boxes, 20_000, lambda _: False)
    assert len(found.left) == 0
    assert found.proved > 0
    rng = np.random.default_rng(1)
    points, _ = here.matrices(random_points(region, 200, rng))
    gains = here.cells(points).gains
    assert (np.asarray(gains.K_ip) > 0.0).all()


def test_nothing_is_claimed_where_there_is_no_operating_point() -> None:
    region = Region((1.2, 1.3), (0.3, 0.35), (-0.9 * S, -0.8 * S), (0.3 * S, 0.4 * S))
    found = swing_statement(STUDY, SPEC, region, parts=(1, 1), budget=100_000)
    assert found.parts[0].grade == "no operating point"
    assert not found.proved


def test_it_is_asked_only_where_it_means_something() -> None:
    circular = replace(SPEC, current_limiter="circular")
    with pytest.raises(InfeasibleStudyError, match="projection"):
        swing_statement(STUDY, circular, REGION)
    assert large_signal(STUDY, circular, REGION) is None
    with pytest.raises(StudyError, match="angle_error"):
        swing_statement(STUDY, SPEC, REGION, start=SwingStart(4.0, angle_error=math.nan))
