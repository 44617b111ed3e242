"""The dc links of a plant's units: against DOP853, against one converter, in the linear model, and in what is said."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.oracles.emt_dc import Link
from tests.simulation.test_dc_link import BATTERY, STAGE
from tests.simulation.test_plants import (
    GAINS,
    NETWORK,
    TOLERANCE,
    errors_pu,
    network_solved,
    plant_of,
    plant_study,
    run,
    solved,
    star,
)
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.operating_point.rest_of_units import UnitsAtRest, rest_of_units
from vsgdesign.linear.stability.loci import modes
from vsgdesign.linear.stability.modes_of_units import modes_of_units, split_modes
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.simulation.scenario.controllers import run_scenario
from vsgdesign.simulation.units import PlantRun, plant_timeline
from vsgdesign.simulation.units.run import _Run
from vsgdesign.simulation.units.scenario import PlantController, run_plant
from vsgdesign.simulation.units.start import StartOfPlant, situation_at
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.verbs.pipeline.one_unit import as_one_converter

IDEAL, OFFSETS = "", (0.0, 0.3, 0.0, 0.0)
SOURCES = {"b": BATTERY, "s": STAGE, "i": IDEAL}


def units(sources: str, offsets: tuple[float, ...] = (0.0,) * 4, more: str = "") -> str:
    """Units behind 6 % at one node; each letter is the source of one: a battery, a stage, or an ideal link."""
    text = '[[network.nodes]]\nname = "pcc"\n'
    for k, letter in enumerate(sources):
        text += f'[[network.units]]\nname = "unit{k + 1}"\nnode = "pcc"\nreactance = 0.06\nresistance = 0.01\n'
        text += f"offset = {offsets[k]}\n" + SOURCES[letter].replace("[dc", "[network.units.dc")
    return text + more


EVENTS = """
[[events]]
time = "1.51 ms"
phase_jump = "-15 deg"
[[events]]
time = "2.5 ms"
element = "unit1"
P_ref = "3 kW"
[[events]]
time = "3.01 ms"
element = "unit2"
dc_power = 0.02
"""


def voltage(found: PlantRun, k: int) -> NDArray[np.float64]:
    """Of the link of a unit, at its last sample before each row."""
    unit = found.units[k]
    assert unit.dc_log is not None
    return unit.dc_log[:, dc_columns(unit.study).index("v")]


def links_of(found: PlantRun) -> list[Link | None]:
    """Those of the reference, from where the run begins."""
    links: list[Link | None] = []
    for one in found.units:
        first = {} if one.dc_log is None else dict(zip(dc_columns(one.study), one.dc_log[0].tolist(), strict=True))
        memory = [value for name, value in first.items() if name.startswith("memory.")]
        links.append(Link(one.study, first["v"], first["p"], memory) if first else None)
    return links


@pytest.mark.parametrize(
    ("sources", "offsets", "duration"), [("bs", (0.0, 0.3), 5), ("sbis", (0.0, 0.5, 0.25, 0.0), 4)]
)
def test_against_dop853(sources: str, offsets: tuple[float, ...], duration: int) -> None:
    """Two and four units with sources of their own that sample at different instants, from a cold start: a jump of the
    phase between two samples, a step of one unit, and the loss of nearly all of a source."""
    count = len(sources)
    study = plant_study(units(sources, offsets, EVENTS), duration=f'"{duration} ms"')
    found = run(study)
    links = links_of(found)
    jumps, steps = [(1.51e-3, math.radians(-15.0))], [(2.5e-3, 0, 3000.0)]
    expected = solved(study, 3 * count, [(0.0, star(study), lambda x: x)], jumps, steps, links=links)
    assert errors_pu(study, found, expected) < TOLERANCE
    for k, link in enumerate(links):
        if link is not None:
            v = voltage(found, k)[1 if offsets[k] else 0 :]  # a unit that samples later has not sampled at the start
            known = np.array(link.trace)[: len(v)]
            assert np.abs(v[: len(known)] - known).max() < TOLERANCE * study.converter.V_dc
            assert np.ptp(v) > 2.0


def test_a_cable_a_load_and_a_breaker_against_dop853() -> None:
    """The currents of a unit jump where its breaker opens and closes between two samples."""
    ends, start = "resistance = 0.01\n", NETWORK.partition("[[network.nodes]]")[0]
    first, second, rest = NETWORK.removeprefix(start).split(ends)
    own = [SOURCES[letter].replace("[dc", "[network.units.dc") for letter in "bs"]
    offset, events = rest.split("\n", 1)
    text = f"{first}{ends}{own[0]}{second}{ends}{offset}\n{own[1]}{events}"
    study = plant_study(text, duration='"13 ms"')
    found = run(study)
    links = links_of(found)
    assert errors_pu(study, found, network_solved(study, links)) < TOLERANCE
    for k, link in enumerate(links):
        assert link is not None
        v = voltage(found, k)[k:]
        assert np.abs(v - np.array(link.trace)[: len(v)]).max() < TOLERANCE * study.converter.V_dc
        assert np.ptp(v) > 2.0


@pytest.mark.parametrize(("source", "control"), [(BATTERY, "none"), (STAGE, "none"), (STAGE, "power_clamp")])
def test_one_unit_is_a_converter(source: str, control: str) -> None:
    """The same to rounding, over a step of a set point, of the grid and of the source."""
    events = '[[events]]\ntime = "4 ms"\nP_ref = "3 kW"\n[[events]]\ntime = "6 ms"\ngrid = { scr = 2 }\n'
    events += (
        f'[[events]]\ntime = "8 ms"\nelement = "unit1"\n{"dc_power = 0.8" if control == "none" else "Q_ref = 0"}\n'
    )
    own = source.replace("[dc]\n", f'[dc]\ncontrol = "{control}"\n', 1).replace("3.5 kW", "2.7 kW")
    study = plant_study(f"[plant]\nunits = 1\nreactance = 0.06\n{events}{own}", start='"steady_state"')
    alone = plant_timeline(study).units[0]
    expected, found = simulate(alone, [GainChange(0.0, GAINS)]), run(study).units[0]
    assert expected.dc_log is not None
    assert found.dc_log is not None
    for one, other in ((expected.log, found.log), (expected.dc_log, found.dc_log)):
        assert np.abs((one - other) / np.maximum(np.abs(one).max(axis=0), 1e-3)).max() < 1e-11
    most = dict(zip(dc_columns(alone), expected.dc_log[-1].tolist(), strict=True)).get("clamp.most", 0.0)
    assert (most > 100.0) == (control == "power_clamp")


def rest_of(study: Study) -> UnitsAtRest:
    timeline = plant_timeline(study)
    count = len(timeline.units)
    return rest_of_units(situation_at(study, timeline, timeline.segments[0], [GAINS] * count, range(count)))


def test_rows_of_the_links_against_differences_of_the_emt() -> None:
    """One period of the plant's clock, in which one unit samples later: the states of both links after it, by
    differences of fourth order of the compiled loop."""
    text = units("bs", (0.0, 0.3)).replace("ramp = 3e5\n", "")  # which a difference would reach
    study = plant_study(text, start='"steady_state"')
    timeline, rest = plant_timeline(study), rest_of(study)
    model, phase = rest.model, timeline.segments[0].source.phase
    loop = _Run(study, timeline, [[GainChange(0.0, GAINS)]] * 2)
    at, period, first, turn = loop._at, len(model.clock.instants), loop.records.done.copy(), np.exp(1j * phase)
    states = ("unit1.v_dc", "unit1.p_dc", "unit2.v_dc", "unit2.p_dc", "unit2.dc_p")
    own = [model.names.index(name) for name in states]
    places = ("u0.dc.v", "u0.dc.p", "u1.dc.v", "u1.dc.p", "u1.dc.memory.p")

    def after(z: NDArray[np.float64]) -> NDArray[np.float64]:
        loop.records.done[:] = first
        StartOfPlant(at, loop.kind, study, timeline, [GAINS] * 2).put(UnitsAtRest(model, z, rest.A))
        for place, name in zip(places, own, strict=True):
            at(place)[:] = z[name]
        for k in range(2):
            before = (z[model.slices[k].before][0::2] + 1j * z[model.slices[k].before][1::2]) * turn
            at(f"u{k}.began")[:] = np.stack([before.real, before.imag], axis=1).ravel()
            at(f"u{k}.begun")[:] = 1.0
        loop._phase(0)
        loop.loop(0, period, loop.rows, loop.uniform, program=loop.records, cycle=np.array([0, 1]))
        return np.array([at(place)[0] for place in places])

    unit = np.maximum(np.abs(rest.z), 1e-2)
    columns = np.flatnonzero(model.kept)
    found = np.empty((len(own), len(columns)))
    for j, k in enumerate(columns.tolist()):
        d = np.zeros(len(rest.z))
        d[k] = 1e-3 * unit[k]
        near = [after(rest.z + j * d) for j in (-2, -1, 1, 2)]
        found[:, j] = (near[0] - 8.0 * near[1] + 8.0 * near[2] - near[3]) / (12.0 * d[k])
    rows = [int(np.flatnonzero(columns == k)[0]) for k in own]
    A = rest.A[rows] * unit[columns]
    wrong = np.abs(found * unit[columns] - A) / np.abs(A).max(axis=1, keepdims=True)
    assert wrong.max() < 1e-9
    assert (np.abs(A).max(axis=1) > 0.0).all()


def test_modes_have_the_voltage_of_each_link() -> None:
    """Those of a unit are its own, those of equal units are in both models, and they are those of one converter."""
    found = modes_of_units(rest_of(plant_study(units("bs"))))
    own = [one for one in found if one.units == ((one.units[0][0], pytest.approx(1.0, abs=1e-6)),)]
    assert {one.units[0][0] for one in own if one.s.real > -500.0} == {"unit2"}
    equal = plant_study(f"[plant]\nunits = 2\nreactance = 0.06\n{STAGE}")
    split = split_modes(rest_of(equal))
    assert split is not None
    alone = plant_timeline(equal).units[0]
    model = linearise_full_order(alone, [Cell(alone.grid, GAINS, alone.simulation.P_ref, alone.simulation.Q_ref)])
    at = [model.states.index(name) for name in ("v_dc", "dc_p")]
    of_link = np.log(np.linalg.eigvals(model.A[0][np.ix_(at, at)]).astype(complex)) / alone.converter.T_s
    for s in of_link:
        for part in (split.common, split.differential):
            assert min(abs(one.s - s) for one in part) < 1e-4 * abs(s)
    assert len(modes(model.states, model.A[0], model.T_s)) < len(split.common)  # the states at the last sample


LOSS = """
base = "case:lab_12kva_lcl"
grid = { scr = 5, x_over_r = 4 }
power_loops = { structure = "angle_damped", P_droop = "2 %", Q_droop = "5 %", settling_time = "0.4 s" }
simulation = { duration = "2.6 s", P_ref = "4 kW", Q_ref = "0.7 kvar" }
controllers = [{ name = "vsg", kind = "fixed" }]
[network]
nodes = [{ name = "pcc" }]
loads = [{ name = "works", node = "pcc", P = "12 kW", Q = "2 kvar" }]
[[network.units]]
name = "first"
node = "pcc"
reactance = 0.06
[network.units.dc]
source = "converter"
C = "3 mF"
control = "CONTROL"
converter = { p_max = "6 kW", p_charge_max = "6 kW", tau = "4 ms" }
[[network.units]]
name = "second"
node = "pcc"
reactance = 0.06
[network.units.dc]
source = "battery"
C = "2 mF"
battery = { R_i = "0.8 ohm", i_max = 15, capacity_Ah = 20 }
[[network.units]]
name = "third"
node = "pcc"
reactance = 0.06
[[events]]
time = "0.1 s"
element = "grid"
breaker = "open"
[[events]]
time = "0.9 s"
element = "first"
dc_power = 0.5
"""


def lost(folder: Path, control: str) -> PlantController:
    (folder / "loss.toml").write_text(LOSS.replace("CONTROL", control), encoding="utf-8")
    return run_plant(load_study(folder / "loss.toml")).controllers[0]


def test_the_others_carry_what_half_a_source_no_longer_gives(tmp_path: Path) -> None:
    """On an island: a unit that clamps its power gives what is left of its source, less its own losses."""
    found = lost(tmp_path, "power_clamp")
    assert found.outcome.status == "settled"
    P = [one.series["P_pcc"] for one in found.units]
    assert P[0][-1] == pytest.approx(2.83e3, abs=30.0)
    assert P[1][-1] == pytest.approx(P[2][-1], rel=1e-6)
    t_s = found.units[0].series["t_s"]
    before = int(np.searchsorted(t_s, 0.89))
    total = [sum(one[k] for one in P) for k in (before, -1)]
    assert total[1] == pytest.approx(total[0], rel=2e-3)  # what the load takes
    assert P[1][-1] - P[1][before] == pytest.approx(0.5 * (P[0][before] - P[0][-1]), rel=0.02)
    first, second, third = (one.dc for one in found.units)
    assert first is not None
    assert second is not None
    assert third is None
    assert first.cut_most_w == pytest.approx(1.63e3, rel=0.02)
    assert 590.0 < first.lowest_v < first.highest_v < 710.0
    assert second.end["dc_charge"] < 0.6 - 1e-5
    assert "v_dc" in found.units[1].series


def test_a_bridge_that_blocks_is_lost_and_the_others_go_on(tmp_path: Path) -> None:
    found = lost(tmp_path, "none")
    assert found.outcome.status == "blocked"
    assert "first: its bridge blocks after 1." in str(found.outcome.reason)
    assert found.units[0].outcome.status == "blocked"
    blocks = found.rests[-1]
    assert blocks.name == "first: its bridge blocks"
    assert blocks.on_line == ("second", "third")
    at_end = [one for one in found.sharing if one.t_s == blocks.t_s]
    assert [one.fault for one in at_end] == [None, None]
    assert sum(one.P for one in at_end) == pytest.approx(11.6e3, rel=0.02)
    series = found.units[0].series
    first = int(np.searchsorted(series["t_s"], blocks.t_s))
    assert series["v_dc"][first - 1] >= 490.0
    assert np.isnan(series["v_dc"][first:]).all()
    assert np.abs(series["P_pcc"][first + 1000 :]).max() < 1.0


JUDGED = (
    LOSS.partition("[network]")[0].replace('"2.6 s"', '"0.3 s", survival = true')
    + """[plant]
units = 2
reactance = 0.06
[dc]
source = "converter"
C = "0.3 mF"
converter = { p_max = "6 kW", p_charge_max = "6 kW", tau = "4 ms" }
[[events]]
time = "50 ms"
"""
)
"""Two units on the grid, whose events are judged as one disturbance."""


def test_the_verdict_on_a_unit_that_blocks(tmp_path: Path) -> None:
    """Half of its source is gone, so that what is asked for has no rest, on a link of any size. Nothing excuses it."""
    (tmp_path / "two.toml").write_text(JUDGED + 'element = "unit2"\ndc_power = 0.5\n', encoding="utf-8")
    verdicts = [one.survival for one in run_plant(load_study(tmp_path / "two.toml")).controllers[0].units]
    assert [one.status == "blocked" for one in verdicts if one is not None] == [False, True]


def test_events_that_move_too_much_energy_are_told_as_for_one_converter(tmp_path: Path) -> None:
    """Two equal units that move alike are one converter on the same short-circuit ratio, and so is what is told of
    each of them, and what is asked of its link up to the block, 0.2 ms after the last row of a log. The run of one
    converter is another program."""
    said, told, links = list[str](), {}, {}
    for count in (1, 2):
        text = JUDGED.replace("units = 2", f"units = {count}").replace('"fixed"', '"scheduled"')
        text = text.replace("survival = true", 'survival = true, log_interval = "5 ms"')
        text += 'phase_jump = "60 deg"\n'
        (tmp_path / f"{count}.toml").write_text(text, encoding="utf-8")
        study = load_study(tmp_path / f"{count}.toml")
        if count == 1:
            found = run_scenario(as_one_converter(study)).controllers
        else:
            found = run_plant(study, warn=said.append).controllers[0].units
        told[count] = [one.survival.reason for one in found if one.survival is not None]
        links[count] = [one.dc for one in found if one.dc is not None]
        assert {one.survival.status for one in found if one.survival is not None} == {"no rest"}
        assert all(f"what is asked for is {told[count][0]}" in str(one.outcome.reason) for one in found)
    assert told[2] == 2 * told[1]
    for one in links[2]:
        for name in ("lowest_v", "highest_v", "spare_v", "least_p_w", "most_p_w", "given_j"):
            assert getattr(one, name) == pytest.approx(getattr(links[1][0], name), rel=1e-9)
        assert 838.0 < one.highest_v == one.end["v_dc"] < 840.0  # a sample before V_high
    assert "more into the dc link than its source and its capacitor can take" in told[1][0]
    assert said == [f"vsg, {unit}: {told[1][0]}." for unit in ("unit1", "unit2")]


def test_a_source_that_cannot_give_its_power_is_told_with_its_unit() -> None:
    weak = units("ib").replace('R_i = "0.4 ohm"', 'R_i = "25 ohm"')
    with pytest.raises(InfeasibleStudyError, match=r"unit2: dc: the bridge takes .* gives at most"):
        run(plant_study(weak, start='"steady_state"'))
    study = plant_study(units("si"), start='"steady_state"')
    timeline = plant_timeline(study.with_changes(events=[{"time": "5 ms", "element": "unit1", "dc_power": 0.5}]))
    situation = situation_at(study, timeline, timeline.segments[0], [GAINS] * 2, range(2), 6e-3)
    with pytest.raises(InfeasibleStudyError, match=r"unit1: dc: .* its limits are"):
        rest_of_units(situation)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (units("bi").replace("[network.units.dc]\n", '[network.units.dc]\ncompensation = "none"\n', 1), "compensate"),
        (
            units("bi").replace("[network.units.dc]\n", '[network.units.dc]\ncontrol = "voltage_droop"\n', 1),
            "turn with",
        ),
        (f"[plant]\nunits = 2\n{BATTERY}".replace("[dc]\n", '[dc]\ncompensation = "none"\n', 1), "compensate"),
        (units("bi") + '[[events]]\ntime = "1 ms"\nelement = "unit2"\ndc_power = 0.5\n', "the dc link is ideal"),
        (units("bs") + '[[events]]\ntime = "1 ms"\nirradiance = 500\n', "has no irradiance"),
        (units("bi").replace("i_max = 30", "i_max = nan", 1), 'units["unit1"].dc.battery.i_max'),
    ],
)
def test_faults(text: str, problem: str) -> None:
    with pytest.raises(StudyError) as caught:
        plant_study(text)
    assert problem in str(caught.value)


def test_links_are_those_of_the_units() -> None:
    """Of a unit, of its study, and events of one unit and of all that have such a source."""
    events = '[[events]]\ntime = "1 ms"\ndc_power = 0.5\n[[events]]\ntime = "2 ms"\nelement = "unit2"\ndc_charge = 0\n'
    study = plant_study(units("ib", more=STAGE + events.replace("dc_charge = 0", "dc_charge = 0.2")))
    assert [one.dc.source for one in plant_of(study).units if one.dc is not None] == ["converter", "battery"]
    links = [[(t_s, link.values) for t_s, link in one.links] for one in plant_timeline(study).timelines]
    assert [t_s for t_s, _ in links[0]] == [0.0, 1e-3]
    assert links[0][-1][1]["p_max"] == 0.5 * links[0][0][1]["p_max"]
    assert [t_s for t_s, _ in links[1]] == [0.0, 1e-3, 2e-3]
    assert links[1][-1][1]["i_max"] == 15.0
    assert links[1][-1][1]["charge"] == 0.2
