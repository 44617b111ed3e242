"""Plants of several units in the EMT loop, against DOP853 on equations that are written here by hand.

The library moves from instant to instant with exact matrices out of the list of elements. The equations here are those
of the drawing, in complex numbers; every unit has a controller in complex numbers, and the solver is stopped at every
instant at which one of them samples and at every event. Tolerance: 1e-8 of rated.
"""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.oracles.emt_controller import SampledController, State
from tests.oracles.emt_dc import Link
from tests.simulation.studies import LCL
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.gains import gain_changes
from vsgdesign.simulation.units import PlantRun, plant_timeline, simulate_plant
from vsgdesign.simulation.wander import Wander
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.power_plant import PowerPlant

TOLERANCE = 1e-8
GAINS = PowerLoopGains(K_ip=0.0004, D_p=8000.0, K_iq=0.0115, D_q=0.687)
OMEGA, T_S = 2.0 * math.pi * 50.0, 50e-6

STUDY = (
    LCL.replace("transient_resistance_pu = 0.0", "transient_resistance_pu = 0.3")
    + """
[simulation]
duration = "20 ms"
log_interval = "50 us"
start = "cold"
P_ref = "2 kW"
Q_ref = "0.5 kvar"
[[controllers]]
name = "fixed"
kind = "fixed"
"""
)

Slope = Callable[[float, np.ndarray, np.ndarray, complex], np.ndarray]


def plant_study(sections: str, **replaced: str) -> Study:
    """The study above with a plant."""
    lines = STUDY.splitlines()
    for field, value in replaced.items():
        lines = [f"{field} = {value}" if line.startswith(f"{field} =") else line for line in lines]
    return study_from_text("\n".join(lines) + "\n" + sections)


def plant_of(study: Study) -> PowerPlant:
    """Its plant."""
    assert study.plant is not None
    return study.plant


def run(study: Study) -> PlantRun:
    """With the gains above in all units."""
    return simulate_plant(study, [[GainChange(0.0, GAINS)]] * len(plant_of(study).units))


def star(study: Study) -> Slope:
    """N units behind their reactances at one node: i_s, v_c and i_g of each."""
    plant, f, grid = plant_of(study), study.filter, study.grid
    count = len(plant.units)
    L = f.L_2 + plant.units[0].L
    R = f.R_2 + plant.units[0].R
    inverse = np.linalg.inv(L * np.eye(count) + grid.L_g * np.ones((count, count)))

    def slope(_: float, x: np.ndarray, v_b: np.ndarray, e: complex) -> np.ndarray:
        i_s, v_c, i_g = x[0:count], x[count : 2 * count], x[2 * count : 3 * count]
        v = v_c + f.R_c * (i_s - i_g)
        di_s = (v_b - v - f.R_1 * i_s) / f.L_1
        di_g = inverse @ (v - R * i_g - grid.R_g * i_g.sum() - e)
        return np.concatenate([di_s, (i_s - i_g) / f.C, di_g])

    return slope


def solved(
    study: Study,
    size: int,
    slopes: Sequence[tuple[float, Slope, Callable[[np.ndarray], np.ndarray]]],
    jumps: Sequence[tuple[float, float]] = (),
    P_steps: Sequence[tuple[float, int, float]] = (),
    source: Callable[[float, float, float], complex] | None = None,
    phase: float = -math.pi / 2.0,
    links: Sequence[Link | None] = (),
) -> np.ndarray:
    """The states at every sampling period of the study, complex. ``slopes``: (from s, dx/dt, what becomes of x then).
    ``jumps`` (s, rad) of the source's phase; ``P_steps`` (s, unit, W). ``source``: its voltage over the rated one at an
    instant, in the interval that begins at another one, with a phase (rad). ``phase``: of the source at t = 0.
    ``links``: of the units, whose voltages at their samples they then know; None, or none at all: ideal ones."""
    plant = plant_of(study)
    count = len(plant.units)
    controllers = [SampledController(study) for _ in plant.units]
    V = study.converter.V_rated_rms
    states = [State(phase, OMEGA, V, 0j, 0j, 0j) for _ in plant.units]
    held, waiting = np.zeros(count, dtype=complex), np.zeros(count, dtype=complex)
    periods = round(study.simulation.duration / T_S)
    due = [(k * T_S + unit.offset, u) for u, unit in enumerate(plant.units) for k in range(periods)]
    marks = sorted({0.0, periods * T_S, *(t for t, _ in due), *(t for t, _, _ in slopes), *(t for t, _ in jumps)})
    marks = [t for k, t in enumerate(marks) if k == 0 or t - marks[k - 1] > 1e-12]
    x, found, present = np.zeros(size, dtype=complex), [], slopes[0][1]
    of_links = np.zeros(3 * len(links), dtype=complex)  # voltage, state of the source, energy since the sample
    begun: set[int] = set()
    refs = [study.simulation.P_ref] * count
    for begin, end in itertools.pairwise(marks):
        changed = [one for one in slopes[1:] if abs(one[0] - begin) < 1e-12]
        if abs(begin / T_S - round(begin / T_S)) < 1e-7:
            found.append(x)
        for t_s, unit, P in P_steps:
            refs[unit] = P if begin >= t_s - 1e-12 else refs[unit]
        for u in sorted(u for t, u in due if abs(t - begin) < 1e-12):
            i_s, v_c, i_g = (complex(x[m * count + u]) for m in range(3))
            v = v_c + study.filter.R_c * (i_s - i_g)
            link = links[u] if links else None
            if link is not None:
                if u in begun:
                    link.at_end(*np.real(of_links[3 * u : 3 * u + 3]).tolist())
                begun.add(u)
                link.sampled(begin)
                of_links[3 * u : 3 * u + 3] = link.v, link.source.s, 0.0
                controllers[u].v_max = link.limit
            states[u], asked, _ = controllers[u].step(states[u], v, i_s, i_g, (refs[u], 500.0), GAINS)
            held[u], waiting[u] = waiting[u] if link is None else link.acting(waiting[u]), asked
        for _, slope, onto in changed:
            x, present = onto(x), slope
        phase += sum(angle for t_s, angle in jumps if abs(t_s - begin) < 1e-12)

        def along(
            t: float, y: np.ndarray, own: Slope = present, lead: float = phase, begin: float = begin
        ) -> np.ndarray:
            more = np.zeros(3 * len(links), dtype=complex)
            angle = OMEGA * t + lead
            e = cmath.exp(1j * angle) if source is None else source(t, begin, angle)
            of_circuit = own(t, y[:size], held, math.sqrt(2.0) * V * e)
            for u in begun:
                link, (v, s) = links[u], np.real(y[size + 3 * u : size + 3 * u + 2])
                assert link is not None
                more[3 * u : 3 * u + 3] = link.slopes(v, s, 1.5 * (held[u] * y[u].conjugate()).real)
            return np.concatenate([of_circuit, more])

        y = np.concatenate([x, of_links])
        y = solve_ivp(along, (begin, end), y, method="DOP853", rtol=1e-11, atol=1e-9).y[:, -1]
        x, of_links = y[:size], y[size:]
    return np.array(found)


def found_states(result: PlantRun) -> np.ndarray:
    """i_s of all units, then v_c, i_g and the other states, complex."""
    columns = [unit.log[:, 2 * m] + 1j * unit.log[:, 2 * m + 1] for m in range(3) for unit in result.units]
    rest = result.circuit_log
    return np.column_stack([*columns, *(rest[:, k] + 1j * rest[:, k + 1] for k in range(0, rest.shape[1], 2))])


def errors_pu(study: Study, result: PlantRun, expected: np.ndarray) -> float:
    """The largest difference over the rated values."""
    c, count = study.converter, len(result.units)
    rated = np.full(expected.shape[1], c.I_rated_pk)
    rated[count : 2 * count] = math.sqrt(2.0) * c.V_rated_rms
    found = found_states(result)[: len(expected), : expected.shape[1]]
    assert np.abs(expected).max(axis=0).min() > 0.1  # everything moves
    return float((np.abs(found - expected[: len(found)]) / rated).max())


@pytest.mark.parametrize(
    ("units", "sampling", "duration"), [(2, "together", 8), (3, "spread", 6), (4, "together", 6), (9, "together", 4)]
)
def test_equal_units(units: int, sampling: str, duration: int) -> None:
    """Two, three, four and nine units at one node, from a cold start."""
    text = f'[plant]\nunits = {units}\nreactance = 0.06\nresistance = 0.01\nsampling = "{sampling}"\n'
    study = plant_study(text, duration=f'"{duration} ms"')
    expected = solved(study, 3 * units, [(0.0, star(study), lambda x: x)])
    assert errors_pu(study, run(study), expected) < TOLERANCE


NETWORK = """
[[network.nodes]]
name = "pcc"
[[network.nodes]]
name = "far"
[[network.branches]]
name = "cable"
from = "pcc"
to = "far"
R = "0.05 ohm"
L = "0.3 mH"
C = "30 uF"
[[network.loads]]
name = "heater"
node = "far"
P = "3 kW"
Q = "1 kvar"
[[network.units]]
name = "near"
node = "pcc"
reactance = 0.05
resistance = 0.01
[[network.units]]
name = "second"
node = "far"
reactance = 0.08
resistance = 0.01
offset = 0.3
[[events]]
time = "4.02 ms"
phase_jump = "20 deg"
[[events]]
time = "7.011 ms"
element = "second"
breaker = "open"
[[events]]
time = "9 ms"
element = "near"
P_ref = "3 kW"
[[events]]
time = "11.0333 ms"
element = "second"
breaker = "closed"
"""


def test_cable_load_and_loss_of_a_unit() -> None:
    """Two units with clocks of their own at the ends of a cable with a load. The source jumps, one unit is lost and
    comes back, and the other one's set point steps, at instants between samples."""
    study = plant_study(NETWORK, duration='"15 ms"')
    result, expected = run(study), network_solved(study)
    assert result.names == ("i.grid", "i.cable", "v.cable.pcc", "v.cable.far", "i.heater.L")
    assert errors_pu(study, result, expected) < TOLERANCE


def network_solved(study: Study, links: Sequence[Link | None] = ()) -> np.ndarray:
    """NETWORK by DOP853."""
    plant, f, grid = plant_of(study), study.filter, study.grid
    load_R = 3.0 * study.converter.V_rated_rms**2 / 3000.0
    load_L = 3.0 * study.converter.V_rated_rms**2 / 1000.0 / OMEGA
    ratio = np.array([0.05, 0.08]) * study.converter.Z_base / OMEGA
    L, R = f.L_2 + ratio, f.R_2 + 0.01 * study.converter.Z_base
    assert plant.units[1].offset == pytest.approx(0.3 * T_S)

    def slope(_: float, x: np.ndarray, v_b: np.ndarray, e: complex, open_: bool = False) -> np.ndarray:
        i_s, v_c, i_g, (i_grid, i_cable, v_pcc, v_far, i_L) = x[0:2], x[2:4], x[4:6], x[6:11]
        v = v_c + f.R_c * (i_s - i_g)
        di_g = (v - R * i_g - np.array([v_pcc, v_far])) / L
        di_g[1] *= 0.0 if open_ else 1.0
        return np.concatenate(
            [
                (v_b - v - f.R_1 * i_s) / f.L_1,
                (i_s - i_g) / f.C,
                di_g,
                [
                    (v_pcc - grid.R_g * i_grid - e) / grid.L_g,
                    (v_pcc - 0.05 * i_cable - v_far) / 0.3e-3,
                    (i_g[0] - i_grid - i_cable) / 15e-6,
                    (i_cable + i_g[1] - v_far / load_R - i_L) / 15e-6,
                    v_far / load_L,
                ],
            ]
        )

    def opened(t: float, x: np.ndarray, v_b: np.ndarray, e: complex) -> np.ndarray:
        return slope(t, x, v_b, e, open_=True)

    def without(x: np.ndarray) -> np.ndarray:
        return np.where(np.arange(len(x)) == 5, 0.0, x)

    slopes = [(0.0, slope, lambda x: x), (7.011e-3, opened, without), (11.0333e-3, slope, lambda x: x)]
    steps = [(9e-3, 0, 3000.0)]
    return solved(study, 11, slopes, [(4.02e-3, math.radians(20.0))], steps, links=links)


DIRTY = """
[background]
level = "dirty"
seed = 3
phase = 0
frequency_offset = 0
voltage_factor = 1
modulation = 0.01
modulation_frequency = "30 Hz"
interharmonic_frequency = "80 Hz"
interharmonic = 0.005
frequency_deviation = "50 mHz"
phasor_walk = 0.02
[[events]]
time = "2.013 ms"
components = [{ order = -1, amplitude_pu = 0.05, phase = "30 deg" }, { order = 7, amplitude_pu = 0.02 }]
[[events]]
time = "3 ms"
phase_jump = "10 deg"
"""


def test_a_source_with_components_and_a_wander() -> None:
    """Two units with offsets: the source wanders from period to period, has harmonics of its background, and gets a
    negative sequence and a seventh harmonic between two samples."""
    text = '[plant]\nunits = 2\nreactance = 0.06\nresistance = 0.01\nsampling = "spread"\n'
    study = plant_study(text + DIRTY, duration='"4 ms"')
    spec = study.background
    assert spec is not None
    assert len(spec.components) >= 2
    gain, angle = Wander(spec, T_S, OMEGA).factors(0, 200)
    assert np.ptp(angle) > 1e-3

    def source(t: float, begin: float, phase: float) -> complex:
        k = int(begin / T_S + 1e-6)
        turned = phase + angle[k]
        later = [(-1.0, 0.05, math.radians(30.0)), (7.0, 0.02, 0.0)] if begin >= 2.013e-3 - 1e-12 else []
        waves = [(one.order, one.amplitude_pu, one.phase) for one in spec.components] + later
        found = gain[k] * cmath.exp(1j * turned)
        found += sum(a * cmath.exp(1j * (n * turned + beta)) for n, a, beta in waves)
        if spec.interharmonic > 0.0:
            at = 2.0 * math.pi * spec.interharmonic_frequency * t + spec.interharmonic_phase
            found += spec.interharmonic * cmath.exp(1j * at)
        return complex(found)

    jumps = [(2.013e-3, 0.0), (3e-3, math.radians(10.0))]
    expected = solved(study, 6, [(0.0, star(study), lambda x: x)], jumps, source=source)
    result = run(study)
    assert errors_pu(study, result, expected) < TOLERANCE
    seen = result.units[0].log[:, 6] + 1j * result.units[0].log[:, 7]  # the source's voltage
    first = math.sqrt(2.0) * study.converter.V_rated_rms * source(0.0, 0.0, -math.pi / 2.0)
    assert seen[0] == pytest.approx(first, rel=1e-9)


RAMPS = """
[[events]]
time = "0.513 ms"
V_g_pu = 0.7
over = "1.21 ms"
[[events]]
time = "1 ms"
f_g = "55 Hz"
over = "2.02 ms"
[[events]]
time = "2.3 ms"
phase_jump = "10 deg"
"""


def test_a_source_on_ramps() -> None:
    """Two units with offsets: the voltage and the frequency of the source are on ramps that overlap, begin and end
    between samples, and the phase jumps within one. The frequency moves with 2.5 kHz/s, which is what its error of
    third order within a gap is small beside."""
    text = '[plant]\nunits = 2\nreactance = 0.06\nresistance = 0.01\nsampling = "spread"\n'
    study = plant_study(text + RAMPS, duration='"4 ms"')
    rate = 2.0 * math.pi * 5.0 / 2.02e-3

    def source(t: float, begin: float, phase: float) -> complex:
        del begin
        since = min(max(t - 1e-3, 0.0), 2.02e-3)
        turned = phase + 0.5 * rate * since**2 + rate * 2.02e-3 * max(t - 3.02e-3, 0.0)
        return (1.0 - 0.3 * min(max((t - 0.513e-3) / 1.21e-3, 0.0), 1.0)) * cmath.exp(1j * turned)

    jumps = [(0.513e-3, 0.0), (1e-3, 0.0), (1.723e-3, 0.0), (2.3e-3, math.radians(10.0)), (3.02e-3, 0.0)]
    expected = solved(study, 6, [(0.0, star(study), lambda x: x)], jumps, source=source)
    result = run(study)
    assert errors_pu(study, result, expected) < TOLERANCE
    seen = result.units[0].log[50, 6] + 1j * result.units[0].log[50, 7]  # the source's voltage, after the jump
    there = source(50 * T_S, 0.0, OMEGA * 50 * T_S - math.pi / 2.0 + math.radians(10.0))
    assert seen == pytest.approx(math.sqrt(2.0) * study.converter.V_rated_rms * there, rel=1e-9)


def test_a_recorded_source(tmp_path: Path) -> None:
    """Two units with offsets on a record of a dirty grid, which is a straight line over each period of the clock."""
    at = np.arange(3000) / 5000.0
    three = [np.cos(2.0 * np.pi * (50.2 * at - k / 3.0)) + 0.03 * np.cos(2.0 * np.pi * 250.7 * at) for k in range(3)]
    np.savez(tmp_path / "grid.npz", v=np.array(three).T, sampling_rate=5000.0)
    record = f'[replay]\nfile = "{tmp_path / "grid.npz"}"\nscale = "150 V"\n'
    text = '[plant]\nunits = 2\nreactance = 0.06\nresistance = 0.01\nsampling = "spread"\n'
    study = plant_study(text + record, duration='"4 ms"')
    timeline = plant_timeline(study)
    replay = timeline.shared.replay
    assert replay is not None
    v = replay.vectors(0, 100) / (math.sqrt(2.0) * study.converter.V_rated_rms)

    def source(t: float, begin: float, _: float) -> complex:
        k = int(begin / T_S + 1e-6)
        return complex(v[k] + (v[k + 1] - v[k]) * (t - k * T_S) / T_S)

    slopes = [(0.0, star(study), lambda x: x)]
    expected = solved(study, 6, slopes, source=source, phase=timeline.segments[0].source.phase)
    assert errors_pu(study, run(study), expected) < TOLERANCE


def test_one_unit_is_a_converter() -> None:
    """A plant of one unit runs as one converter with x_t in its filter does: the same to rounding, over a step of a set
    point and of the grid."""
    events = '[[events]]\ntime = "10 ms"\nP_ref = "3 kW"\n[[events]]\ntime = "20.01 ms"\ngrid = { scr = 2 }\n'
    study = plant_study(f"[plant]\nunits = 1\nreactance = 0.06\n{events}", duration='"40 ms"', start='"steady_state"')
    alone = plant_timeline(study).units[0]
    assert alone.grid.L_g == pytest.approx(study.grid.L_g, rel=1e-12)
    x_t = 0.06 * study.converter.Z_base / OMEGA
    assert pytest.approx(study.filter.L_2 + x_t, rel=1e-12) == alone.filter.L_2
    expected, found = simulate(alone, [GainChange(0.0, GAINS)]), run(study).units[0]
    c = study.converter
    rated = [c.I_rated_pk] * 2 + [math.sqrt(2.0) * c.V_rated_rms] * 2 + [c.I_rated_pk] * 2
    assert np.abs((expected.log - found.log)[:, :6] / rated).max() < 1e-10
    assert np.ptp(expected.column("P")) > 500.0


def test_gains_that_follow_what_a_unit_measures() -> None:
    """At the end of every window, as of one converter: the same gains at the same instants, and two equal units have
    them both."""
    controller = '[[controllers]]\nname = "follows"\nkind = "scheduled"\nstructure = "angle_damped"\n'
    controller += 'operating_point = "reference"\nupdate_period = "2 ms"\n'
    text = f'{controller}[[events]]\ntime = "5 ms"\nP_ref = "3 kW"\n'
    study = plant_study(f"[plant]\nunits = 1\nreactance = 0.06\n{text}", start='"steady_state"')
    timeline = plant_timeline(study)
    alone, spec = timeline.units[0], study.controllers[-1]
    expected = simulate(alone, feed_of(alone, spec, timeline.timelines[0], NOTHING))
    own_feed: Any = feed_of(alone, spec, timeline.timelines[0], NOTHING)
    one = simulate_plant(study, [own_feed]).units[0]
    assert len(one.gain_changes) > 5
    assert [change.t_s for change in one.gain_changes] == pytest.approx([c.t_s for c in expected.gain_changes])
    for mine, theirs in zip(one.gain_changes, expected.gain_changes, strict=True):
        assert mine.gains == pytest.approx(theirs.gains, rel=1e-9)
    two = plant_study(f"[plant]\nunits = 2\nreactance = 0.06\n{text}", start='"steady_state"')
    seen = plant_timeline(two)
    feeds: list[Any] = [
        feed_of(own, spec, own_seen, NOTHING) for own, own_seen in zip(seen.units, seen.timelines, strict=True)
    ]
    first, second = simulate_plant(two, feeds).units
    assert len(first.gain_changes) == len(second.gain_changes) > 5
    assert first.gain_changes[-1].gains == pytest.approx(second.gain_changes[-1].gains, rel=1e-9)


def test_fixed_gains_are_made_for_the_grid_that_a_unit_sees() -> None:
    """N units on the short-circuit ratio of all are one converter on the same ratio. A grid that a controller names is
    kept, and an event changes nothing."""
    event = '[[events]]\ntime = "5 ms"\ngrid = { scr = 2 }\n'

    def gains(units: int, named: str = "") -> list[PowerLoopGains]:
        plant = f"{named}[plant]\nunits = {units}\nreactance = 0.06\n"
        timeline = plant_timeline(plant_study(plant + event))
        found = zip(timeline.units, timeline.timelines, strict=True)
        changes = [gain_changes(unit, unit.controllers[0], seen) for unit, seen in found]
        assert {len(one) for one in changes} == {1}
        return [one[0].gains for one in changes]

    named = "design_grid = { scr = 4, x_over_r = 3 }\n"
    (alone,), (at_named,) = gains(1), gains(1, named)
    for found in gains(3):
        assert found == pytest.approx(alone, rel=1e-9)
    assert gains(3, named) == [at_named] * 3
    assert at_named.K_ip != pytest.approx(alone.K_ip, rel=0.01)


@pytest.mark.parametrize("sampling", ["together", "spread"])
def test_a_plant_starts_at_rest(sampling: str) -> None:
    """The start is the fixed point of the plant's own map, also where the units sample one after the other."""
    text = f'[plant]\nunits = 3\nreactance = 0.06\nsampling = "{sampling}"\n'
    found = run(plant_study(text, start='"steady_state"'))
    for unit in found.units:
        power = unit.column("P")[1:]  # one that samples later has not said anything at the start
        assert np.ptp(power) < 1e-6
        assert power[-1] == pytest.approx(2000.0, abs=1e-4)


def test_events_of_all_units_and_of_one() -> None:
    """A set point without an element is that of all units; the gains that follow the truth see the loss of a unit."""
    events = (
        '[[events]]\ntime = "5 ms"\nP_ref = "3 kW"\n'
        '[[events]]\ntime = "10 ms"\nelement = "unit2"\nbreaker = "open"\n'
        '[[events]]\ntime = "12 ms"\nelement = "unit1"\nQ_ref = "1 kvar"\n'
    )
    study = plant_study(f"[plant]\nunits = 2\nreactance = 0.06\n{events}")
    timeline = plant_timeline(study)
    assert [one.P_ref for _, one in timeline.timelines[1].references] == [2000.0, 3000.0]
    assert [one.Q_ref for _, one in timeline.timelines[0].references] == [500.0, 500.0, 1000.0]
    seen = [grid.L_g for _, grid in timeline.timelines[0].grids]
    assert seen == pytest.approx([2.0 * study.grid.L_g, study.grid.L_g], rel=1e-9)


def test_no_operating_point_is_told() -> None:
    """The network does not take all that is asked for; the message says what it takes."""
    study = plant_study("[plant]\nunits = 4\nreactance = 0.06\n", start='"steady_state"', scr="0.6", P_ref='"5 kW"')
    with pytest.raises(InfeasibleStudyError, match=r"the start: no operating point: .*unit1 5 kW.* about \d+ % of it"):
        run(study)
    limited = replace(study, grid=replace(study.grid, R_g=0.01, L_g=1e-4))
    assert run(limited).divergence is None
