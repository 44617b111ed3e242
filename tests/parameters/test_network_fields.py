"""Load, fault, breaker and dip in a study file."""

from __future__ import annotations

import cmath
import math
from typing import Any

import pytest

from tests.parameters.documents import build, case_document, changed, faults_of, the_fault
from vsgdesign.errors import Fault as Wrong
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.given_files import toml_text
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.grid import PLAIN, Fault, Load, Network, Sag, SynchroCheck
from vsgdesign.study.parameters.loading import changed as with_changes
from vsgdesign.study.parameters.network_fields import (
    Base,
    fault_document,
    load_document,
    read_fault,
    read_load,
    read_sag,
    sag_document,
)
from vsgdesign.study.parameters.reader import TableReader

BASE = Base(7.26, 100.0 * math.pi, 5000.0)


def study_of(*events: dict[str, Any], **sections: Any) -> dict[str, Any]:
    return case_document() | {"events": list(events)} | sections


def field_of(name: str, value: Any) -> list[str]:
    """The faults of one event at 1 s."""
    return [str(fault) for fault in faults_of(study_of({"time": 1.0, name: value}))]


def test_a_study_without_them_is_plain() -> None:
    study = build(case_document())
    assert study.network is PLAIN
    assert all(event.network is None for event in study.events)


def test_an_event_changes_only_what_it_names() -> None:
    """The load stays while a fault comes and goes, and the fault stays in the island."""
    study = build(
        study_of(
            {"time": "1 s", "fault": {"kind": "phase_to_phase", "R": "0.1 ohm", "phases": "ca"}},
            {"time": "1.5 s", "breaker": "open"},
            {"time": "1.6 s", "fault": "cleared", "P_ref": "1 kW"},
            {"time": "2 s", "breaker": "closed", "grid": {"scr": 4}},
            {"time": "3 s", "load": "none"},
            network={"load": {"R_pu": 2.0}},
        )
    )
    load = Load(R_parallel=2.0 * study.converter.Z_base)
    fault = Fault(kind="phase_to_phase", R=0.1, phases="ca")
    assert study.network == Network(load=load)
    assert [event.network for event in study.events] == [
        Network(load=load, fault=fault),
        Network(load=load, fault=fault, connected=False),
        Network(load=load, connected=False),
        Network(load=load),
        PLAIN,
    ]
    assert [event.name for event in study.events] == [
        "fault from phase c to a at the PCC, 100 mohm",
        "breaker opens",
        "fault cleared, P_ref 1 kW",
        "SCR 4, X/R 1, breaker closes",
        "no load",
    ]
    assert all(event.of_grid for event in study.events)
    timeline = build_timeline(study)
    assert timeline.network_at(1.55) == Network(load=load, fault=fault, connected=False)
    assert timeline.network_at(0.5) == study.network


@pytest.mark.parametrize(
    ("table", "load"),
    [
        ({"R": "10 ohm", "L": "20 mH", "C": "50 uF"}, Load(R_parallel=10.0, L_parallel=0.02, C_parallel=5e-5)),
        ({"series": {"R": "5 ohm", "L": "2 mH"}}, Load(R_series=5.0, L_series=2e-3)),
        (
            {"R_pu": 2.0, "X_L_pu": 0.5, "X_C_pu": 4.0},
            Load(
                R_parallel=2.0 * BASE.Z,
                L_parallel=0.5 * BASE.Z / BASE.omega,
                C_parallel=1.0 / (4.0 * BASE.Z * BASE.omega),
            ),
        ),
        ({"P": "2.5 kW", "Q_pu": 0.5}, Load(R_parallel=2.0 * BASE.Z, L_parallel=2.0 * BASE.Z / BASE.omega)),
        ({"Q": "-5 kvar"}, Load(C_parallel=1.0 / (BASE.Z * BASE.omega))),
    ],
)
def test_a_load_is_read_by_elements_or_powers(table: dict[str, Any], load: Load) -> None:
    faults: list[Wrong] = []
    read = read_load(TableReader(table, "load", faults), BASE)
    assert not faults
    for name, value in vars(load).items():
        assert getattr(read, name) == (None if value is None else pytest.approx(value, rel=1e-12)), name


def test_in_pu_and_in_si_are_the_same_load() -> None:
    """Without a converter a document is read in pu; on a base the two give the same admittance."""
    table = {"P_pu": 0.8, "Q_pu": -0.3, "series": {"R_pu": 2.0, "X_L_pu": 0.7, "X_C_pu": 0.2}}
    faults: list[Wrong] = []
    in_pu = read_load(TableReader(table, "load", faults), None)
    in_si = read_load(TableReader(table, "load", faults), BASE)
    assert not faults
    Y = 0.8 + 0.3j + 1.0 / (2.0 + 0.5j)
    assert in_si.admittance(BASE.omega) * BASE.Z == pytest.approx(Y, rel=1e-12)
    assert in_pu.in_si(BASE.Z, BASE.omega).admittance(BASE.omega) * BASE.Z == pytest.approx(Y, rel=1e-12)


def test_what_is_written_is_read_again() -> None:
    load = Load(R_parallel=10.0, C_parallel=2e-5, R_series=3.0, L_series=1e-3)
    fault = Fault(kind="phase_to_phase", at=0.25, R=0.3, phases="ab")
    network = Network(load=load, fault=fault, connected=False)
    written = {"load": load_document(load), "fault": fault_document(fault), "breaker": "open"}
    assert build(study_of(network=written)).network == network
    faults: list[Wrong] = []
    assert read_load(TableReader(load_document(load), "load", faults), BASE) == load
    per_unit = Load(R_parallel=2.0, L_parallel=0.5, C_series=0.3)
    assert read_load(TableReader(load_document(per_unit, per_unit=True), "load", faults), None) == per_unit
    fault = Fault(R=0.02)
    assert read_fault(TableReader(fault_document(fault, per_unit=True), "fault", faults), None) == fault
    for sag in (Sag(kind="D", V_pu=0.3), Sag(kind="C", V_pu=0.3, angle=-0.4)):
        assert read_sag(TableReader(sag_document(sag), "sag", faults)) == sag
    assert not faults


@pytest.mark.parametrize(
    ("name", "value", "parts"),
    [
        ("load", {"R": "10 ohm", "R_pu": 1.0}, ["gives both R and R_pu"]),
        ("load", {}, ["is no load"]),
        ("load", {"P_pu": 0.0}, ["is no load"]),
        ("load", {"P_pu": 1.0, "R_pu": 1.0}, ["load.R_pu", "P stands for it"]),
        ("load", {"Q_pu": 1.0, "X_C_pu": 1.0}, ["load.X_C_pu", "Q stands for it"]),
        ("load", {"C": "20 F"}, ["load.C", "outside"]),
        ("load", {"L": "-2 mH"}, ["load.L", "outside"]),
        ("load", {"R_pu": math.nan}, ["load.R_pu", "finite"]),
        ("load", {"series": {}}, ["load.series", "has no element"]),
        ("load", {"series": {"X_L_pu": 0.5, "X_C_pu": 0.5}}, ["load.series", "0 pu, less than 0.01 pu"]),
        ("load", {"R_parallel": 1.0}, ["load.R_parallel", "unknown field"]),
        ("load", "off", ['must be a table or the word "none"']),
        ("load", "none", ["there is no load"]),
        ("fault", "cleared", ["there is no fault"]),
        ("fault", {"kind": "earth"}, ["fault.kind", "three_phase"]),
        ("fault", {"at": 1.0}, ["fault.at", "short the source"]),
        ("fault", {"at": 1.5}, ["fault.at", "outside 0 to 1"]),
        ("fault", {"R": "-1 ohm"}, ["fault.R", "outside 0 ohm"]),
        ("fault", {"phases": "ab"}, ["fault.phases", "no pair of phases"]),
        ("fault", {"kind": "phase_to_phase", "phases": "ac"}, ["fault.phases", '"ab", "bc", "ca"']),
        ("breaker", "closed", ["it is closed already"]),
        ("breaker", True, ["breaker", '"open", "closed"']),
        ("breaker", "shut", ["breaker", '"open", "closed"']),
        ("sag", {"type": "H", "V_pu": 0.5}, ["sag.type", '"A"']),
        ("sag", {"type": "C"}, ["sag.V_pu", "missing"]),
        ("sag", {"type": "C", "V_pu": 1.2}, ["sag.V_pu", "outside 0 to 1"]),
        ("sag", "none", ["there is no sag"]),
    ],
)
def test_a_fault_names_field_value_and_limit(name: str, value: Any, parts: list[str]) -> None:
    found = field_of(name, value)
    matching = [one for one in found if all(part in one for part in parts)]
    assert len(matching) == 1, found


def test_all_faults_are_told_at_once() -> None:
    found = faults_of(
        study_of(
            {"time": 1.0, "breaker": "closed", "fault": {"at": -1, "R": "1 V"}, "load": {"R_pu": 0.0}},
            {"time": 2.0, "sag": {"type": "C", "V_pu": 0.5}, "V_g_pu": 0.9, "over": "0.1 s"},
            network={"fault": "cleared", "load": "none", "brake": "open"},
        )
    )
    assert {fault.field for fault in found} == {
        "events[0].breaker",
        "events[0].fault.at",
        "events[0].fault.R",
        "events[0].load.R_pu",
        "events[1].sag",
        "events[1].over",
        "network.fault",
        "network.load",
        "network.brake",
    }


@pytest.mark.parametrize(
    ("one", "two", "field"),
    [
        ({"load": {"R_pu": 1}}, {"load": {"R_pu": 2}}, "load"),
        ({"fault": {}}, {"fault": {"at": 0.5}}, "fault"),
        ({"sag": {"type": "A", "V_pu": 0.5}}, {"sag": {"type": "B", "V_pu": 0.5}}, "sag"),
        ({"sag": {"type": "A", "V_pu": 0.5}}, {"V_g_pu": 0.5}, "V_g_pu"),
        ({"V_g_pu": 0.5}, {"sag": {"type": "A", "V_pu": 0.5}}, "sag"),
    ],
)
def test_two_events_of_one_instant_may_not_disagree(one: dict[str, Any], two: dict[str, Any], field: str) -> None:
    fault = the_fault(study_of({"time": 1.0} | one, {"time": 1.0} | two), f"events[1].{field}")
    assert "events[0] gives" in fault.problem
    same = build(study_of({"time": 1.0} | one, {"time": 1.0} | one))
    assert same.events[0].network == same.events[1].network


def test_a_breaker_may_be_said_twice_at_one_instant() -> None:
    study = build(study_of({"time": 1.0, "breaker": "open"}, {"time": 1.0, "breaker": "open", "fault": {}}))
    assert build_timeline(study).network_at(1.0) == Network(fault=Fault(), connected=False)


def test_a_base_says_the_same_thing_in_other_words() -> None:
    """Tables merge field by field, and one way of saying an element replaces the other."""
    study = build(study_of(network={"load": {"R_pu": 1.0, "X_C_pu": 2.0}}))
    load = with_changes(study, {"network": {"load": {"R": "10 ohm"}}}).network.load
    assert load is not None
    assert load.R_parallel == 10.0
    assert load.C_parallel is not None
    assert with_changes(study, {"network": {"load": {"P_pu": 0.5}}}).network.load == Load(
        R_parallel=2.0 * study.converter.Z_base, C_parallel=load.C_parallel
    )
    assert changed("network.load", {"P_pu": 1.0})["network"] == {"load": {"P_pu": 1.0}}


def voltage_at(study: Any, t_s: float, since: float) -> complex:
    """The source's space vector in pu of the rated peak, from the timeline's description."""
    timeline = build_timeline(study)
    source = timeline.source_at(since).at(t_s)
    v = source.V_g_rms / study.converter.V_rated_rms * cmath.exp(1j * source.phase)
    for c in timeline.components_at(since):
        v += c.amplitude_pu * cmath.exp(1j * (c.order * source.phase + c.phase))
    return v


PHASORS = {
    "A": lambda V: (V, V * cmath.exp(-2j * math.pi / 3), V * cmath.exp(2j * math.pi / 3)),
    "B": lambda V: (V, cmath.exp(-2j * math.pi / 3), cmath.exp(2j * math.pi / 3)),
    "C": lambda V: (1, -0.5 - 0.5j * math.sqrt(3) * V, -0.5 + 0.5j * math.sqrt(3) * V),
    "D": lambda V: (V, -V / 2 - 0.5j * math.sqrt(3), -V / 2 + 0.5j * math.sqrt(3)),
    "E": lambda V: (1, V * cmath.exp(-2j * math.pi / 3), V * cmath.exp(2j * math.pi / 3)),
    "F": lambda V: (V, -V / 2 - 1j * (2 + V) / math.sqrt(12), -V / 2 + 1j * (2 + V) / math.sqrt(12)),
    "G": lambda V: (
        2 / 3 + V / 3,
        -1 / 3 - V / 6 - 0.5j * math.sqrt(3) * V,
        -1 / 3 - V / 6 + 0.5j * math.sqrt(3) * V,
    ),
}
"""Bollen's table of the phases, before the zero sequence is left out."""


@pytest.mark.parametrize("kind", "ABCDEFG")
@pytest.mark.parametrize("angle", [0.0, -20.0])
def test_a_sag_is_the_three_phases_of_its_type(kind: str, angle: float) -> None:
    """The source's voltage over a cycle is that of Bollen's phasors less their mean, with what was there before."""
    unbalanced = [
        {"order": -1, "amplitude_pu": 0.02, "phase": "70 deg"},
        {"order": -5, "amplitude_pu": 0.03, "phase": 0.4},
    ]
    grid = case_document()["grid"] | {"components": unbalanced}
    sag = {"type": kind, "V_pu": 0.4} | ({"angle": f"{angle} deg"} if angle else {})
    study = build(
        study_of(
            {"time": 1.003, "V_g_pu": 0.9},
            {"time": 2.0017, "sag": sag},
            {"time": 2.1, "phase_jump": "10 deg"},
            {"time": 2.2, "sag": "none"},
            grid=grid,
        )
    )
    plain = build(
        study_of({"time": 1.003, "V_g_pu": 0.9}, {"time": 2.1, "phase_jump": "10 deg"}, grid=grid | {"components": []})
    )
    a, b, c = PHASORS[kind](0.4 * cmath.exp(1j * math.radians(angle)))
    mean = (a + b + c) / 3
    for t_s in (2.0017, 2.004, 2.011, 2.02):
        turn = voltage_at(plain, t_s, t_s)  # 0.9 e^{jωt}: phase a's phasor before the dip
        va, vb, vc = ((phase - mean) * turn for phase in (a, b, c))
        v = va.real + 1j * (vb.real - vc.real) / math.sqrt(3)
        angle_before = cmath.phase(turn)
        for order, amplitude, phase in ((-1, 0.02, math.radians(70)), (-5, 0.03, 0.4)):
            v += amplitude * cmath.exp(1j * (order * angle_before + phase))
        assert voltage_at(study, t_s, t_s) == pytest.approx(v, abs=1e-12)
    after = build_timeline(study)
    assert after.components_at(2.3) == study.grid_source.components
    for t_s in (2.25, 2.31):
        assert after.source_at(t_s).V_g_rms == build_timeline(plain).source_at(t_s).V_g_rms
        before = build_timeline(plain).source_at(t_s)
        assert abs(cmath.rect(1, after.source_at(t_s).phase) - cmath.rect(1, before.phase)) < 1e-9
    name = f"sag type {kind} to 0.4 pu"
    assert [event.name for event in study.events][1] == (name if angle == 0.0 else f"{name}, {angle:+.3g}°")
    assert study.events[-1].name == "sag ends"


def test_a_voltage_that_is_given_ends_a_sag() -> None:
    study = build(
        study_of({"time": 1, "sag": {"type": "C", "V_pu": 0.5, "angle": "-30 deg"}}, {"time": 2, "V_g_pu": 0.95})
    )
    dip, end = study.events
    assert dip.components
    assert dip.components[0].order == -1
    assert end.components == ()
    assert end.phase_jump == -dip.phase_jump != 0.0
    assert end.V_g_rms == 0.95 * study.converter.V_rated_rms


def test_a_sag_needs_a_voltage_that_holds() -> None:
    ramp = {"time": 1.0, "V_g_pu": 0.9, "over": "0.5 s"}
    fault = the_fault(study_of(ramp, {"time": 1.2, "sag": {"type": "A", "V_pu": 0.5}}), "events[1].sag")
    assert "goes on to 1.5 s" in fault.problem
    build(study_of(ramp, {"time": 1.5, "sag": {"type": "A", "V_pu": 0.5}}))


def test_a_document_with_all_of_them_survives_writing() -> None:
    document = study_of(
        {"time": 1, "sag": {"type": "F", "V_pu": 0.3, "angle": "-10 deg"}},
        {"time": 2, "sag": "none", "fault": {"kind": "phase_to_phase", "at": 0.2, "R_pu": 0.01, "phases": "ab"}},
        {"time": 3, "fault": "cleared", "breaker": "open", "load": {"Q": "-1 kvar", "series": {"R": 9, "L": "1 mH"}}},
        {"time": 4, "breaker": "closed", "synchro_check": {"angle": "7 deg", "df": 0.2}},
        network={"load": {"P_pu": 0.5}},
    )
    written = study_from_text(toml_text(document))
    assert written.events == build(document).events
    assert written.network == build(document).network
    assert written.events[-1].synchro_check == SynchroCheck(
        angle=math.radians(7.0), V_pu=0.1, omega=2.0 * math.pi * 0.2
    )
