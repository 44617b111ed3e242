"""Grid-following inverters and constant-power loads in a plant, against DOP853 on equations written here by hand.

The controller is written again in complex numbers, and so is the circuit of the drawing; the solver is stopped at every
instant at which a converter samples and at every event. Tolerance: 1e-8 of rated.
"""

from __future__ import annotations

import cmath
import itertools
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.oracles.emt_controller import SampledController, State
from tests.simulation.test_plants import GAINS, OMEGA, T_S, found_states, plant_of, plant_study, run
from tests.stability.test_modes_of_units import rest_of
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.linear.operating_point.rest_of_units import rest_of_units
from vsgdesign.linear.stability.modes_of_units import modes_of_units
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.units import plant_timeline
from vsgdesign.simulation.units.start import situation_at
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.power_plant import Inverter

TOLERANCE = 1e-8
ROOT_2 = math.sqrt(2.0)

SECTIONS = """
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
[[network.units]]
name = "near"
node = "pcc"
reactance = 0.05
[[network.inverters]]
name = "pv"
node = "far"
S_rated = "4 kVA"
P_ref = "2.5 kW"
Q_ref = "0.3 kvar"
reactance = 0.06
pll_bandwidth = "40 Hz"
offset = 0.4
[[network.loads]]
name = "drive"
node = "pcc"
kind = "constant_power"
P = "2 kW"
Q = "0.4 kvar"
pll_bandwidth = "40 Hz"
voltage_filter = "1.6 ms"
"""

EVENTS = """
[[events]]
time = "4.02 ms"
phase_jump = "20 deg"
[[events]]
time = "7.011 ms"
element = "pv"
breaker = "open"
[[events]]
time = "9 ms"
element = "pv"
P_ref = "1 kW"
[[events]]
time = "10 ms"
element = "drive"
P_ref = "-1 kW"
[[events]]
time = "11.0333 ms"
element = "pv"
breaker = "closed"
"""


@dataclass
class Memory:
    """Of the follower: angle, frequency above nominal, filtered voltage, its length, integrator; waiting voltage."""

    theta: float
    slip: float = 0.0
    v: complex = 0j
    V: float = 0.0
    xi: complex = 0j


class Follower:
    """The controller of docs/theory/plants.md in complex numbers, one call a sample."""

    def __init__(self, S: float, V: float, pll_hz: float, tau_V: float, T: float, *, tau: float = 2e-4) -> None:
        Z = 3.0 * V * V / S
        self.T, self.V_n = T, ROOT_2 * V
        self.L, self.C = 0.1 * Z / OMEGA, 0.05 / Z / OMEGA
        natural, bandwidth = 2.0 * math.pi * pll_hz, 2.0 * math.pi * min(500.0, 0.04 / T)
        self.K, self.K_i = 2.0 * 0.707 * natural, natural**2
        self.K_p, self.K_c = bandwidth * self.L, 0.1 * bandwidth**2 * self.L
        self.a, self.b = 1.0 - math.exp(-T / tau), 1.0 - math.exp(-T / tau_V)
        self.i_max, self.v_max = 1.2 * ROOT_2 * S / 3.0 / V, 400.0 / math.sqrt(3.0)

    def step(self, m: Memory, v: complex, i: complex, S_ref: complex) -> tuple[Memory, complex]:
        frame = cmath.exp(-1j * m.theta)
        v, i = v * frame, i * frame
        error = v.imag / max(abs(v), 0.1 * self.V_n)
        omega = OMEGA + m.slip + self.K * error
        V = m.V + self.b * (abs(v) - m.V)
        taken = max(V, 0.1 * self.V_n)
        wanted = S_ref.conjugate() / (1.5 * taken) + 1j * OMEGA * self.C * taken
        ref = wanted * min(1.0, self.i_max / max(abs(wanted), 1e-12))
        v_f = m.v + self.a * (v - m.v)
        u = self.K_p * (ref - i) + m.xi + v_f + 1j * OMEGA * self.L * i
        b = u * min(1.0, self.v_max / abs(u))
        xi = m.xi + self.T * self.K_c * (ref - i + (b - u) / self.K_p)
        after = Memory(m.theta + self.T * omega, m.slip + self.T * self.K_i * error, v_f, V, xi)
        return after, b * cmath.exp(1j * (m.theta + 1.5 * self.T * omega))


def lcl(S: float, V: float) -> tuple[float, float, float, float, float, float]:
    """L_1, R_1, C, R_c, L_2 and R_2 of the default filter."""
    Z = 3.0 * V * V / S
    return 0.1 * Z / OMEGA, 0.005 * Z, 0.05 / Z / OMEGA, 0.2 * Z, 0.03 * Z / OMEGA, 0.002 * Z


def expected_states(study: Study) -> np.ndarray:
    """i_s, v_c, i_g of the unit, the inverter and the rectifier, then i.grid, i.cable and both halves of the cable."""
    f, grid, V = study.filter, study.grid, study.converter.V_rated_rms
    Z = study.converter.Z_base
    drive = 1.25 * math.hypot(2000.0, 400.0)
    rows = np.array([(f.L_1, f.R_1, f.C, f.R_c, f.L_2 + 0.05 * Z / OMEGA, f.R_2), lcl(4000.0, V), lcl(drive, V)]).T
    L_1, R_1, C, R_c, L_2, R_2 = rows
    L_2[1] += 0.06 * 3.0 * V * V / 4000.0 / OMEGA
    at_far = np.array([False, True, False])
    unit, state = SampledController(study), State(-math.pi / 2.0, OMEGA, V, 0j, 0j, 0j)
    others = [Follower(4000.0, V, 40.0, 2e-3, T_S), Follower(drive, V, 40.0, 1.6e-3, T_S)]
    memories = [Memory(-math.pi / 2.0, v=ROOT_2 * V + 0j, V=ROOT_2 * V) for _ in others]
    asked = [2500.0 + 300.0j, -2000.0 - 400.0j]
    held, waiting = np.zeros(3, dtype=complex), np.zeros(3, dtype=complex)
    periods = round(study.simulation.duration / T_S)
    due = [(k * T_S + (0.4 * T_S if u == 1 else 0.0), u) for u in range(3) for k in range(periods)]
    jumps, opens, closes = 4.02e-3, 7.011e-3, 11.0333e-3
    marks = sorted({periods * T_S, *(t for t, _ in due), jumps, opens, closes, 9e-3, 10e-3})
    marks = [t for k, t in enumerate(marks) if k == 0 or t - marks[k - 1] > 1e-12]
    x, found, phase, gone = np.zeros(13, dtype=complex), [], -math.pi / 2.0, False
    for begin, end in itertools.pairwise(marks):
        if abs(begin / T_S - round(begin / T_S)) < 1e-7:
            found.append(x)
        asked[0] = (1000.0 if begin >= 9e-3 - 1e-12 else 2500.0) + 300.0j
        asked[1] = (-1000.0 if begin >= 10e-3 - 1e-12 else -2000.0) - 400.0j
        for u in sorted(u for t, u in due if abs(t - begin) < 1e-12):
            i_s, v_c, i_g = (complex(x[3 * m + u]) for m in range(3))
            v = v_c + R_c[u] * (i_s - i_g)
            if u == 0:
                state, new, _ = unit.step(state, v, i_s, i_g, (2000.0, 500.0), GAINS)
            else:
                memories[u - 1], new = others[u - 1].step(memories[u - 1], v, i_s, asked[u - 1])
            held[u], waiting[u] = waiting[u], new
        phase += math.radians(20.0) if abs(begin - jumps) < 1e-12 else 0.0
        if abs(begin - opens) < 1e-12:
            gone, x = True, np.where(np.arange(13) == 7, 0.0, x)
        gone = gone and abs(begin - closes) > 1e-12

        def slope(t: float, x: np.ndarray, lead: float = phase, gone: bool = gone) -> np.ndarray:
            e = ROOT_2 * V * cmath.exp(1j * (OMEGA * t + lead))
            i_s, v_c, i_g, (i_grid, i_cable, v_pcc, v_far) = x[0:3], x[3:6], x[6:9], x[9:13]
            v = v_c + R_c * (i_s - i_g)
            di_g = (v - R_2 * i_g - np.where(at_far, v_far, v_pcc)) / L_2
            di_g[1] *= 0.0 if gone else 1.0
            outside = [
                (v_pcc - grid.R_g * i_grid - e) / grid.L_g,
                (v_pcc - 0.05 * i_cable - v_far) / 0.3e-3,
                (i_g[0] + i_g[2] - i_grid - i_cable) / 15e-6,
                (i_cable + i_g[1]) / 15e-6,
            ]
            return np.concatenate([(held - v - R_1 * i_s) / L_1, (i_s - i_g) / C, di_g, outside])

        x = solve_ivp(slope, (begin, end), x, method="DOP853", rtol=1e-11, atol=1e-9).y[:, -1]
    return np.array(found)


def all_states(result: Any) -> np.ndarray:
    """Of a run, in the same order."""
    own = found_states(result)
    columns = [own[:, m] if j < 0 else _of(result.inverters[j], m) for m in range(3) for j in (-1, 0, 1)]
    return np.column_stack([*columns, own[:, 3:]])


def _of(one: Any, m: int) -> np.ndarray:
    found: np.ndarray = one.log[:, 2 * m] + 1j * one.log[:, 2 * m + 1]
    return found


def test_an_inverter_and_a_constant_power_load() -> None:
    """One unit, an inverter that samples later at the far end of a cable, and an active rectifier, from cold."""
    study = plant_study(SECTIONS + EVENTS, duration='"14 ms"')
    result, expected = run(study), expected_states(study)
    found = all_states(result)[: len(expected)]
    assert result.names == ("i.grid", "i.cable", "v.cable.pcc", "v.cable.far")
    assert np.abs(expected).max(axis=0).min() > 0.1  # everything moves
    rated = np.full(13, study.converter.I_rated_pk)
    rated[3:6] = rated[11:13] = ROOT_2 * study.converter.V_rated_rms
    assert (np.abs(found - expected) / rated).max() < TOLERANCE


def at_rest(**replaced: str) -> Study:
    """The same from its steady state."""
    return plant_study(SECTIONS, start='"steady_state"', **replaced)


def test_they_start_at_rest_with_their_powers() -> None:
    found = run(at_rest())
    pv, drive = found.inverters
    for one, P, Q in ((pv, 2500.0, 300.0), (drive, -2000.0, -400.0)):
        power, reactive = one.column("P")[1:], one.column("Q")[1:]
        assert np.ptp(power) < 1e-5
        assert power[-1] == pytest.approx(P, rel=2e-3)  # R_c takes its share of the capacitor's current
        assert reactive[-1] == pytest.approx(Q, abs=0.02 * abs(P))
        assert one.column("omega")[-1] == pytest.approx(OMEGA, rel=1e-9)


def test_their_model_is_the_derivative_of_the_map() -> None:
    rest = rest_of(at_rest())
    model, rng = rest.model, np.random.default_rng(5)
    size = np.abs(rest.z) + 1e-3
    for _ in range(4):
        step = np.where(model.kept, rng.normal(size=len(rest.z)) * size * 1e-6, 0.0)
        ahead, back = (model(rest.z + sign * step, derivative=False)[0] for sign in (1.0, -1.0))
        expected = (0.5 * (ahead - back))[model.kept]
        assert np.abs(rest.A @ step[model.kept] - expected).max() < 1e-6 * np.abs(expected).max()


def test_they_take_part_in_modes() -> None:
    """A fast phase-locked loop on a weak grid is unstable, and the inverter takes the largest part in this mode."""
    stable = modes_of_units(rest_of(at_rest()), 12)
    assert stable[0].s.real < 0.0
    assert {"pv", "drive"} <= {name for one in stable for name, _ in one.units}
    text = SECTIONS.replace('S_rated = "4 kVA"', 'S_rated = "16 kVA"').replace('"2.5 kW"', '"9 kW"')
    text = text.replace('pll_bandwidth = "40 Hz"\noffset', 'pll_bandwidth = "150 Hz"\noffset')
    weak = modes_of_units(rest_of(plant_study(text, scr="2", start='"steady_state"')), 1)[0]
    assert weak.s.real > 0.0
    assert weak.units[0][0] == "pv"


def test_an_unstable_inverter_grows_as_its_mode_says() -> None:
    """The growth of a run near its unstable rest is that of the full-order model."""
    text = SECTIONS.replace('S_rated = "4 kVA"', 'S_rated = "16 kVA"').replace('"2.5 kW"', '"9 kW"')
    text = text.replace('pll_bandwidth = "40 Hz"\noffset', 'pll_bandwidth = "150 Hz"\noffset')
    study = plant_study(text, scr="2", start='"steady_state"', duration='"110 ms"')
    kick = '[[events]]\ntime = "20 ms"\nphase_jump = "1e-6 deg"\n'
    moved = plant_study(text + kick, scr="2", start='"steady_state"', duration='"110 ms"')
    s = modes_of_units(rest_of(study), 1)[0].s
    apart = np.abs(run(moved).inverters[0].column("P") - run(study).inverters[0].column("P"))
    ratio = apart[1800:2200].max() / apart[1000:1400].max()
    assert math.log(ratio) / (800 * T_S) == pytest.approx(s.real, rel=0.1)


def test_nothing_but_inverters() -> None:
    """A plant without units runs, too."""
    study = at_rest()
    plant = plant_of(study)
    alone = replace(study, plant=replace(plant, units=()))
    found = run(alone)
    assert found.units == ()
    assert found.inverters[0].column("P")[-1] == pytest.approx(2500.0, rel=2e-3)


def test_the_settings_are_those_of_the_fields() -> None:
    pv: Inverter = plant_of(at_rest()).inverters[0]
    natural = 2.0 * math.pi * 40.0
    assert pv.settings.K_slip == pytest.approx(natural**2, rel=1e-12)
    assert pv.settings.i_max_pk == pytest.approx(1.2 * ROOT_2 * 4000.0 / 3.0 / 110.0, rel=1e-12)
    assert pv.offset == pytest.approx(0.4 * T_S, rel=1e-12)


PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "beside-photovoltaics.md"


def slowest_beside(scr: float, share: float, pll: float, *, alone: bool) -> tuple[float, float]:
    """The slowest mode (1/s, Hz) of the plant of the page without its drive."""
    text = of_page()
    text = text[: text.index("[[network.loads]]")].replace("scr = 2.5", f"scr = {scr}")
    text = text.replace('"12.5 kVA"', f'"{12.5 * share} kVA"').replace('"8.75 kW"', f'"{8.75 * share} kW"')
    return slowest(text.replace("50 Hz", f"{pll} Hz"), alone=alone)


def of_page() -> str:
    """The study of the page."""
    found = re.search(r"<!-- file: beside.toml -->\n```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return found.group(1)


def slowest(text: str, *, alone: bool = False) -> tuple[float, float]:
    """The slowest mode of a plant with one unit."""
    study = study_from_text(text, folder=str(PAGE.parents[2]))
    timeline = plant_timeline(study, study.controllers[0])
    feed: Any = feed_of(timeline.units[0], timeline.units[0].controllers[0], timeline.timelines[0], NOTHING)
    units = () if alone else (0,)
    mode = modes_of_units(rest_of_units(situation_at(study, timeline, timeline.segments[0], [feed[0].gains], units)), 1)
    return mode[0].s.real, abs(mode[0].s.imag) / 2.0 / math.pi


@pytest.mark.parametrize(
    ("scr", "share", "pll", "alone", "expected"),
    [
        (1.5, 1, 20, True, (-31.7, 127)),
        (2.5, 1, 50, True, (45.0, 140)),
        (5, 1, 100, True, (154.0, 182)),
        (1.5, 1, 50, False, (-4.03, 0.4)),
        (1.5, 1, 100, False, (57.1, 162)),
        (2.5, 2, 50, False, (-3.60, 0.4)),
        (5, 1, 20, False, (-4.35, 0.0)),
        (2.5, 2, 100, False, (250.0, 124)),
        (5, 2, 100, False, (142.0, 160)),
    ],
)
def test_the_table_of_the_page(scr: float, share: float, pll: float, alone: bool, expected: Any) -> None:
    real, hertz = slowest_beside(scr, share, pll, alone=alone)
    assert real == pytest.approx(expected[0], rel=5e-3)
    assert hertz == pytest.approx(expected[1], rel=5e-3, abs=0.06)


@pytest.mark.parametrize(("scr", "P", "expected"), [(2.5, 12.5, -4.44), (5, 6.25, -4.36), (12, 3.75, -4.37)])
def test_a_load_of_constant_power_leaves_the_slowest_mode(scr: float, P: float, expected: float) -> None:
    text = of_page()
    begin, end = text.index("[[network.inverters]]"), text.index("[[network.loads]]")
    text = (text[:begin] + text[end : text.index("[[events]]")]).replace("scr = 2.5", f"scr = {scr}")
    text = text.replace('P = "2 kW"', f'P = "{P} kW"\npll_bandwidth = "40 Hz"\nvoltage_filter = "1.6 ms"')
    assert slowest(text)[0] == pytest.approx(expected, abs=0.01)
