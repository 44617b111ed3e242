"""The dc link in the EMT: against an independent integration, in its energy balance, and without it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.oracles.dc_energy import energies
from tests.oracles.emt_dc import WithLink
from tests.oracles.emt_reference import run_reference
from tests.simulation.one_by_one import run_one
from tests.simulation.studies import GAINS, lc_study, lcl_study
from tests.simulation.test_emt_against_dop853 import errors_pu, library_start
from tests.simulation.test_lanes import drawn, study_named
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.dc_source_interface import DcRatings
from vsgdesign.equations.dc_sources import DC_SOURCES
from vsgdesign.equations.dc_sources.photovoltaic import array_curve
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.linear.operating_point.many import DC_ENERGY
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.dc_start import dc_columns, dc_figures
from vsgdesign.simulation.energy import dc_energy
from vsgdesign.simulation.lanes import run as lanes_run
from vsgdesign.simulation.lanes.results import BLOCKED, JUDGED
from vsgdesign.study.parameters import Study

TOLERANCE = 1e-8
"""Of rated: what the issue of the dc side asks for. The order of the link's step leaves 1e-10 to 3e-9 here."""

BATTERY = """
[dc]
source = "battery"
C = "500 uF"
R_bleed = "20 kohm"
[dc.battery]
R_i = "0.4 ohm"
i_max = 30
capacity_Ah = 0.5
charge = 0.61
"""

STAGE = """
[dc]
source = "converter"
C = "2 mF"
[dc.converter]
p_max = "3.5 kW"
p_charge_max = "1 kW"
tau = "2 ms"
ramp = 3e5
feed_forward = 0.8
"""

ARRAY = """
[dc]
source = "photovoltaic"
C = "3 mF"
[dc.photovoltaic]
modules = 8
strings = 3
irradiance = 900
temperature = 40
"""

EVENTS = """
[[events]]
time = "3 ms"
P_ref = "2.6 kW"
[[events]]
time = "6.0123 ms"
phase_jump = "-12 deg"
[[events]]
time = "9.3 ms"
V_g_pu = 0.8
[[events]]
time = "13 ms"
V_g_pu = 1.0
"""


NOT_COMPENSATED = '[dc]\ncompensation = "none"\n'

IN_SHORT = """
[[events]]
time = "1 ms"
P_ref = "2.6 kW"
[[events]]
time = "2.0123 ms"
phase_jump = "-12 deg"
[[events]]
time = "3.33 ms"
V_g_pu = 0.8
[[events]]
time = "5 ms"
V_g_pu = 1.0
"""

UNBALANCED = """
[[events]]
time = "1.5 ms"
fault = { kind = "phase_to_phase", phases = "ab", R = "5 ohm" }
[[events]]
time = "3.513 ms"
fault = "cleared"
[[events]]
time = "4.52 ms"
phase_jump = "-12 deg"
"""


def with_source(build, text: str, events: str = EVENTS, duration: str = "18 ms") -> Study:
    return build(duration, events + text)


def against_dop853(study: Study, bridge: str) -> dict[str, float]:
    """The largest errors of a run, per unit, that of the link's voltage included."""
    gains = [GainChange(0.0, GAINS)]
    run = simulate(study, gains, log_states=10**9, bridge=bridge)
    assert run.dc_log is not None
    names = dc_columns(study)
    first = dict(zip(names, run.dc_log[0].tolist(), strict=True))
    memory = [value for name, value in first.items() if name.startswith("memory.")]
    link = WithLink(study, first["v"], first["p"], memory, pwm=bridge == "pwm")
    reference = run_reference(study, gains, bridge == "pwm", library_start(study, gains), circuits=link)
    errors = errors_pu(study, run, reference)
    v = run.dc_log[:, names.index("v")]
    errors["v_dc"] = float(np.abs(v - np.array(link.trace)).max()) / study.converter.V_dc
    print(bridge, {name: f"{e:.1e}" for name, e in errors.items()}, f"v {v.min():.5g} to {v.max():.5g} V")
    assert np.ptp(v) > 0.001 * study.converter.V_dc  # the link moves
    return errors


SOURCES = {"battery": BATTERY, "converter": STAGE, "photovoltaic": ARRAY}


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_against_dop853(build, source: str) -> None:
    text = SOURCES[source]
    if build is lc_study:
        text = text.replace("modules = 8", "modules = 16").replace("strings = 3", "strings = 2")
    errors = against_dop853(with_source(build, text), "averaged")
    assert max(errors.values()) < TOLERANCE, errors


MOVING = [
    ("pwm", "battery", True),
    ("averaged", "battery", True),
    ("averaged", "battery", False),
    ("averaged", "converter", False),
    ("pwm", "converter", False),
    ("averaged", "photovoltaic", False),
    ("pwm", "photovoltaic", True),
    ("pwm", "photovoltaic", False),
    ("pwm", "converter", True),
    ("pwm", "battery", False),
]


@pytest.mark.parametrize(("bridge", "source", "compensated"), MOVING)
def test_a_link_that_moves_the_bridge_against_dop853(bridge: str, source: str, compensated: bool) -> None:
    """A step, a jump and a sag, or an unbalanced fault and a jump; the carrier has its peak at a sample, or in one."""
    text = SOURCES[source] if compensated else SOURCES[source].replace("[dc]\n", NOT_COMPENSATED, 1)
    if source == "battery":
        study = with_source(lcl_study, text, UNBALANCED, "6 ms")
    elif source == "converter":
        study = lcl_study("6 ms", IN_SHORT + text, samples_per_carrier="1", f_sw='"20 kHz"')
    else:
        study = with_source(lcl_study, text, IN_SHORT, "6 ms")
    errors = against_dop853(study, bridge)
    assert max(errors.values()) < TOLERANCE, errors


OF_SOURCE = {
    "battery": ("dc_power = 0.1", "dc_charge = 0.95", "dc_charge = 0.0\ndc_power = 0.7"),
    "converter": ("dc_power = 0.5", "dc_power = 0.65", "dc_power = 1.0"),
    "photovoltaic": ("irradiance = 1050", "irradiance = 500", "irradiance = 800"),
}


@pytest.mark.parametrize("text", [BATTERY, STAGE, ARRAY], ids=list(OF_SOURCE))
def test_events_of_the_source_against_dop853(text: str) -> None:
    """Each event acts at the first sample at or after its instant, and what an event does not name stays."""
    (name,) = [one for one in OF_SOURCE if f'"{one}"' in text]
    times = ("4 ms", "8.01 ms", "11.03 ms")
    events = "".join(f"[[events]]\ntime = '{t}'\n{what}\n" for t, what in zip(times, OF_SOURCE[name], strict=True))
    study, still = (with_source(lcl_study, text, more, "15 ms") for more in (events, ""))
    gains = [GainChange(0.0, GAINS)]
    run, undisturbed = simulate(study, gains), simulate(still, gains)
    assert run.dc_log is not None
    assert undisturbed.dc_log is not None
    names = dc_columns(study)
    first = dict(zip(names, run.dc_log[0].tolist(), strict=True))
    link = WithLink(study, first["v"], first["p"], [value for key, value in first.items() if key.startswith("memory.")])
    run_reference(study, gains, False, library_start(study, gains), circuits=link)
    v, before = (rows[:, names.index("v")] for rows in (run.dc_log, undisturbed.dc_log))
    assert float(np.abs(v - np.array(link.trace)).max()) / study.converter.V_dc < TOLERANCE
    begin = round(4e-3 / study.converter.T_s)
    np.testing.assert_array_equal(v[: begin + 1], before[: begin + 1])
    assert np.abs(v - before).max() > 1e-3 * study.converter.V_dc


def test_the_bridge_blocks_at_the_sample_at_which_the_link_leaves_its_limits() -> None:
    """In a log of every tenth sample the run ends at the first row that is late; what is kept is sound."""
    text = STAGE.replace('C = "2 mF"', 'C = "600 uF"\nV_low = "{} V"')
    study, gains = with_source(lcl_study, text.format(330)), [GainChange(0.0, GAINS)]
    free = simulate(with_source(lcl_study, text.format(30)), gains)
    run = simulate(study, gains)
    assert free.dc_log is not None
    assert run.dc_log is not None
    v = free.dc_log[:, dc_columns(study).index("v")]
    first = int(np.argmax(v < 330.0))
    assert 10 < first < len(v) - 10
    assert run.divergence is not None
    assert run.divergence.blocked
    assert run.divergence.t_s == pytest.approx(first * study.converter.T_s, abs=1e-9)
    assert "330 V" in run.divergence.reason
    np.testing.assert_array_equal(run.log, free.log[:first])


def test_energy_balance() -> None:
    """What the source gives is what the bridge takes, what the bleeder takes and what the capacitor keeps; and what the
    bridge takes is what the filter keeps and loses, and what reaches the node of its capacitor."""
    study = with_source(lcl_study, BATTERY.replace("capacity_Ah = 0.5", "capacity_Ah = 5"), duration="2 s")
    assert study.dc is not None
    run = simulate(study, [GainChange(0.0, GAINS)])
    assert run.dc_log is not None
    names, rows, T = dc_columns(study), run.dc_log.T, study.converter.T_s
    v, given, taken = (rows[names.index(name)] for name in ("v", "given", "taken"))
    inner = slice(1, -1)
    bled = T * (np.sum(v[inner] ** 2) + 0.5 * (v[0] ** 2 + v[-1] ** 2)) / 20e3
    stored = 0.5 * study.dc.C * (v[-1] ** 2 - v[0] ** 2)
    S, duration = study.converter.S_rated, run.t_s[-1]
    assert abs(given[-1] - taken[-1] - bled - stored) < 1e-8 * S * duration
    assert abs(given[-1] - taken[-1] - bled - stored) < 1e-4 * 0.5 * study.dc.C * study.converter.V_dc**2
    # An independent sum of the bridge's energy, from the filter's states alone.
    assert abs(dc_energy(run, study)[-1] - taken[-1]) < 2e-7 * S * duration
    assert taken[-1] > 0.1 * S * duration


@pytest.mark.parametrize(
    ("bridge", "compensation"), [("averaged", "none"), ("pwm", "measured"), ("averaged", "measured")]
)
def test_energy_of_the_source_goes_to_the_grid(bridge: str, compensation: str) -> None:
    """By an integration of every sample of its own, over a step and a sag: ∫p_src − ∫p_grid − losses − ΔW."""
    events = """
    [[events]]
    time = "50 ms"
    P_ref = "2.6 kW"
    [[events]]
    time = "0.25 s"
    V_g_pu = 0.9
    """
    study = with_source(lcl_study, BATTERY.replace("capacity_Ah = 0.5", "capacity_Ah = 5"), events, "0.5 s")
    study = study.with_changes(dc={"compensation": compensation})
    run = simulate(study, [GainChange(0.0, GAINS)], log_states=10**9, bridge=bridge)
    columns = [ControllerState._fields.index(name) for name in ("u_alpha", "u_beta")]
    found = energies(study, run, run.controller_log[:, columns], pwm=bridge == "pwm")
    limit = 1e-8 * study.converter.S_rated * run.t_s[-1]
    # What the run sums up has the error of the link's step in it alone; what the battery gives by its own voltage, that
    # of its charge in the middle of a sample as well, which the transients of the first seconds leave.
    assert abs(found.given - found.grid - found.lost - found.stored) < limit
    assert abs(found.source - found.given) < 8.0 * limit
    assert found.grid > 0.2 * study.converter.S_rated * run.t_s[-1]


RUN_SO = [
    ("none", "averaged", "measured"),
    ("power_clamp", "averaged", "measured"),
    ("voltage_droop", "averaged", "measured"),
    ("none", "averaged", "none"),
    ("none", "pwm", "measured"),
]


@pytest.mark.parametrize(("control", "bridge", "compensation"), RUN_SO)
def test_a_batch_has_the_links_of_single_runs(control: str, bridge: str, compensation: str) -> None:
    """Voltages of the links of lanes and of single runs, and the same verdicts where half of them block."""
    study, spec = study_named("survival", "decoupled")
    text = {"source": "converter", "C": "400 uF", "V_low": "300 V", "control": control, "compensation": compensation}
    study = study.with_changes(dc=text | {"converter": {"p_max": "9 kW", "p_charge_max": "9 kW", "tau": "10 ms"}})
    assert study.dc is not None
    cases = drawn(study, spec, "grid", 6)
    own = study.with_limit_of(spec)
    lowest = []
    for k in range(len(cases)):
        run = run_one(study, spec, NOTHING, cases, k, bridge)
        figures = dc_figures(own, run.dc_end)
        assert figures is not None
        lowest.append(figures.lowest_v)
    assert np.ptp(lowest) > 1.0
    limit = float(np.median(lowest)) + 1e-6
    narrow = replace(study, dc=replace(study.dc, V_low=limit))
    results = lanes_run.run_lanes(narrow, spec, NOTHING, cases, bridge=bridge)
    judged = results.status >= JUDGED
    assert judged.sum() >= 4
    assert (results.status == BLOCKED)[judged].tolist() == (np.array(lowest) < limit)[judged].tolist()
    assert 0 < (results.status == BLOCKED).sum() < judged.sum()


@pytest.mark.parametrize("family", ["dc_power", "dc_charge"])
def test_a_batch_has_the_lost_sources_of_single_runs(family: str) -> None:
    """The same verdicts; what is told of lost power and of lost energy is lost in a run."""
    study, spec = study_named("survival", "decoupled")
    stage = {"p_max": "4.5 kW", "p_charge_max": "4.5 kW", "energy": 20000}
    study = study.with_changes(dc={"source": "converter", "C": "3 mF", "converter": stage})
    cases = drawn(study, spec, family, 12)
    results, blocks = lanes_run.run_lanes(study, spec, NOTHING, cases), []
    for k in range(len(cases)):
        run = run_one(study, spec, NOTHING, cases, k, "averaged")
        blocks.append(run.divergence is not None and run.divergence.blocked)
    lost = (results.status == BLOCKED) | (results.fault == DC_ENERGY)
    assert blocks == (results.status != JUDGED if family == "dc_power" else lost).tolist()
    assert 2 <= sum(blocks) <= 10


_OF_BATTERY = {"R_i": "1 ohm", "i_max": 10, "capacity_Ah": 1}


@pytest.mark.parametrize(
    ("changed", "field", "problem"),
    [
        ({"battery": _OF_BATTERY | {"capacity_Ah": 0}}, "dc.battery.capacity_Ah", "outside"),
        ({"battery": {"R_i": "1 ohm", "i_max": 10}}, "dc.battery.capacity_Ah", "missing"),
        ({"C": "nan"}, "dc.C", "expected a number in F"),
        ({"battery": _OF_BATTERY | {"open_circuit": [380, 400]}}, "dc.battery.open_circuit", "6 voltages"),
        (
            {"battery": _OF_BATTERY | {"open_circuit": [380, float("nan"), 390, 400, 410, 420]}},
            "open_circuit",
            "must be a finite number",
        ),
        (
            {"battery": _OF_BATTERY | {"open_circuit": [150, 160, 170, 180, 190, 200]}},
            "open_circuit",
            "the bridge needs",
        ),
        ({"battery": _OF_BATTERY | {"open_circuit": [420, 410, 400, 390, 380, 370]}}, "open_circuit", "must not fall"),
        ({"C": 0}, "dc.C", "outside 100 nF"),
        ({"V_low": "450 V", "V_high": "350 V"}, "dc.V_high", "outside 400 V to 2 kV"),
        ({"control": "voltage_droop", "voltage_droop": {"share": 2}}, "dc.voltage_droop.share", "outside 0 to 1"),
        ({"voltage_droop": {"share": 0.1}}, "dc.voltage_droop", "does not read this table"),
        ({"V_low": "500 V"}, "dc.V_low", "outside"),
        ({"converter": {"p_max": 1000}}, "dc.converter", "does not read this table"),
        ({"source": "sun"}, "dc.source", "battery"),
    ],
)
def test_faults(changed: dict[str, Any], field: str, problem: str) -> None:
    with pytest.raises(StudyError) as caught:
        lcl_study("40 ms").with_changes(dc={"source": "battery", "C": "1 mF", "battery": _OF_BATTERY} | changed)
    assert field in str(caught.value)
    assert problem in str(caught.value)


def test_a_source_that_cannot_give_the_power_is_told_before_the_run() -> None:
    weak = BATTERY.replace('R_i = "0.4 ohm"', 'R_i = "25 ohm"')
    with pytest.raises(InfeasibleStudyError, match="gives at most"):
        simulate(with_source(lcl_study, weak), [GainChange(0.0, GAINS)])
    high = STAGE.replace("3.5 kW", "1.5 kW")
    with pytest.raises(InfeasibleStudyError, match="its limits are"):
        simulate(with_source(lcl_study, high), [GainChange(0.0, GAINS)])


def test_an_array_is_that_of_its_module() -> None:
    """Against pvlib's figures of the CS5P-220M: 220 W at 46.9 V, 59.4 V open, 5.1 A short (database of the CEC)."""
    source = DC_SOURCES["photovoltaic"]
    ratings = DcRatings(5e-5, 400.0, 1e-3, np.inf, 5000.0)
    constants = source.build(ratings, source.values(ratings, {"modules": 1.0, "strings": 1.0}))
    v, i = array_curve(constants)
    best = int(np.argmax(v * i))
    assert v[best] * i[best] == pytest.approx(220.0, rel=2e-3)
    assert v[best] == pytest.approx(46.9, rel=5e-3)
    assert v[-1] == pytest.approx(59.4, rel=2e-3)
    assert i[0] == pytest.approx(5.1, rel=2e-3)
