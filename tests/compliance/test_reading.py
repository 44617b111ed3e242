"""Suite files: what they become, and what a user is told of a wrong one."""

from __future__ import annotations

import math

import pytest

from vsgdesign.campaigns.compliance.reading import SUITES, suite_from_text, suite_named
from vsgdesign.campaigns.compliance.suite import Criterion
from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.parameters.event import BASIS, Event
from vsgdesign.study.parameters.grid import Fault as ShortCircuit
from vsgdesign.study.parameters.grid import Load, Place, Sag

ONE = """
[[tests]]
name = "one"
scr = 3
x_over_r = 5
"""


def one_event(text: str) -> tuple[Event, ...]:
    return suite_from_text(f"{ONE}\nevents = [{text}]").tests[0].events


def faults_of(text: str) -> dict[str, Fault]:
    with pytest.raises(StudyError) as caught:
        suite_from_text(text)
    return {fault.field: fault for fault in caught.value.faults}


def test_a_list_makes_one_test_per_value_with_an_id_that_says_it() -> None:
    suite = suite_from_text(
        """
        title = "Mine"
        criteria = [{ measure = "survived", at_least = 1 }]
        [[tests]]
        name = "jump"
        scr = [1.5, 10]
        x_over_r = 5
        P_pu = [0, 0.7]
        events = [{ phase_jump = ["30 deg", "-30 deg"] }]
        """
    )
    assert [test.id for test in suite.tests] == [
        f"jump, {sign}30 deg, SCR {scr}, P {P} pu" for sign in "+-" for scr in ("1.5", "10") for P in ("0", "0.7")
    ]
    last = suite.tests[-1]
    assert (last.scr, last.x_over_r, last.P_pu, last.Q_pu) == (10.0, 5.0, 0.7, 0.0)
    assert last.events == (Event.of_pu(0.0, phase_deg=-30.0),)
    assert last.criteria == (Criterion(measure="survived", at_least=1.0),)
    assert (last.source.document, last.source.confidence) == ("Mine", "user")


def test_what_lasts_is_undone_and_the_rest_stays() -> None:
    assert one_event('{ time = "1 s", sag = { type = "C", V_pu = 0.3 }, phase_jump = "5 deg", lasts = "150 ms" }') == (
        Event.of_pu(1.0, sag=Sag(kind="C", V_pu=0.3), phase_deg=5.0),
        Event.of_pu(1.15, V_g_pu=1.0),
    )
    assert one_event('{ fault = { kind = "phase_to_phase", R_pu = 0.1, at = "50 %" }, lasts = "0.2 s" }') == (
        Event.of_pu(0.0, fault=ShortCircuit(kind="phase_to_phase", R=0.1, at=0.5)),
        Event.of_pu(0.2, fault="cleared"),
    )
    assert one_event('{ breaker = "open", load = { P_pu = 0.5 }, lasts = "2 s" }') == (
        Event.of_pu(0.0, breaker="open", load=Load(R_parallel=2.0)),
        Event.of_pu(2.0, breaker="closed", load="none"),
    )


def test_a_voltage_that_lasts_returns_to_the_one_before() -> None:
    events = one_event('{ V_g_pu = 0.9 }, { time = "1 s", V_g_pu = 0.5, lasts = "1 s" }')
    assert [(event.t_s, event.V_g_rms) for event in events] == [(0.0, 0.9), (1.0, 0.5), (2.0, 0.9)]


def test_what_an_end_would_undo_is_a_fault() -> None:
    sag = '{ sag = { type = "A", V_pu = 0.3 }, lasts = "150 ms" }'
    for time in ("100 ms", "150 ms"):
        found = faults_of(f'{ONE}events = [{sag}, {{ time = "{time}", V_g_pu = 0.9 }}]')
        problem = "tests[0].events[1] changes the voltage before this ends, at 0.15 s"
        assert found["tests[0].events[0].lasts"].problem == problem
    assert len(one_event(f'{sag}, {{ time = "100 ms", breaker = "open" }}, {{ time = "1 s", V_g_pu = 0.9 }}')) == 4


def test_a_wrong_duration_is_one_fault() -> None:
    """It was told twice, the second time as lasts = "nan s"."""
    said = '{ phase_jump = "10 deg", lasts = "-1 s" }'
    with pytest.raises(StudyError) as caught:
        one_event(said)
    assert [str(fault.value) for fault in caught.value.faults] == ['"-1 s"']


def test_a_rate_becomes_the_duration_of_a_ramp_from_the_frequency_before() -> None:
    events = one_event('{ df = "1 Hz", df_per_s = 4 }, { time = "2 s", df = "-1 Hz", df_per_s = "0.5 Hz/s" }')
    assert [(event.df_hz, event.over) for event in events] == [(1.0, 0.25), (-1.0, 4.0)]


def test_a_load_in_power_draws_that_power_at_nominal_voltage() -> None:
    load = one_event("{ load = { P_pu = 0.8, Q_pu = -0.25 } }")[0].switched.load
    assert isinstance(load, Load)
    assert load.R_parallel is not None
    assert load.C_parallel is not None
    assert 1.0 / complex(load.R_parallel).conjugate() + 1.0 / complex(0.0, -load.C_parallel).conjugate() == 0.8 - 0.25j


def test_an_event_that_says_only_the_scr_keeps_the_ratio_before_it() -> None:
    events = one_event('{ scr = 2, x_over_r = 1 }, { time = "1 s", scr = 20 }')
    assert [event.place for event in events] == [Place(2.0, 1.0, BASIS), Place(20.0, 1.0, BASIS)]


def test_every_fault_is_told_at_once() -> None:
    found = faults_of(
        """
        title = ""
        colour = "red"
        [source]
        confidence = "recalled"
        [[tests]]
        nam = "x"
        scr = [1.5, nan, -3]
        x_over_r = []
        P_pu = "5 kW"
        needs = 3
        source = "aemo"
        events = [
            { phase_jump = "30 Hz", sag = { type = "H" }, V_g_pu = 0.5, lasts = "-1 s" },
            { time = "1 s" },
            { df = "1 Hz", over = "1 s", df_per_s = 2 },
            { fault = { kind = "three_phase", phases = "bc", R_pu = "2 ohm" }, load = {} },
        ]
        criteria = [{ measure = "survived", at_least = "a" }, {}, { measure = "survived", at_least = 2, at_most = 1 }]
        """
    )
    event = "tests[0].events"
    expected = {
        "title", "colour", "source.confidence", "tests[0].nam", "tests[0].name", "tests[0].scr", "tests[0].x_over_r",
        "tests[0].P_pu", "tests[0].needs", "tests[0].source", f"{event}[0].phase_jump", f"{event}[0].sag.type",
        f"{event}[0].sag.V_pu", f"{event}[0].V_g_pu", f"{event}[0].lasts", f"{event}[1]", f"{event}[2].df_per_s",
        f"{event}[3].fault.phases", f"{event}[3].fault.R_pu", f"{event}[3].load", "tests[0].criteria[0].at_least",
        "tests[0].criteria[1]", "tests[0].criteria[2].at_least", "tests[0].criteria[2].at_most",
    }  # fmt: skip
    assert found.keys() == expected
    assert str(found["tests[0].scr"]) == "tests[0].scr = -3: outside 0.05 to 10000. Give a value within these limits."


def test_criteria_are_checked_against_what_can_be_measured() -> None:
    found = faults_of(
        ONE
        + """
        events = [{ P_pu = 0 }]
        criteria = [
            { measure = "survivd", at_least = 1 },
            { measure = "recovery_s", at_most = "3 Hz" },
            { measure = "recovery_s", at_most = nan },
            { measure = "settling_s", band = 0.1 },
            { measure = "settling_s", band_pu = "5 s" },
            { envelope = "power_bnd" },
            { envelope = "power_band", at_most = 0 },
            { envelope = "power_band", to_s = "5 %" },
            { measure = "survived", envelope = "power_band" },
            { measure = "settling_s", band_pu = -0.1 },
            { envelope = "swing_after_jump", below_pu = 1.5 },
        ]
        """
    )
    at = "tests[0].criteria"
    expected = {
        f"{at}[0].measure", f"{at}[1].at_most", f"{at}[2].at_most", f"{at}[3].band", f"{at}[4].band_pu",
        f"{at}[5].envelope", f"{at}[6].at_most", f"{at}[7].to_s", f"{at}[8]",
        f"{at}[9].band_pu", f"{at}[10].below_pu",
    }  # fmt: skip
    assert found.keys() == expected
    assert "Did you mean survived?" in found[f"{at}[0].measure"].advice
    assert "Did you mean band_pu?" in found[f"{at}[3].band"].advice


@pytest.mark.parametrize(
    ("criterion", "field", "problem"),
    [
        ('measure = "survived", at_most = 0', "at_most", "would ask that it is not so"),
        ('measure = "survived", at_least = 0', "at_least", "must be above 0 and at most 1"),
        ('measure = "recovery_s", at_most = "-1 s"', "at_most", "must be at least 0 s and below 600 s"),
        ('measure = "settling_s", at_most = 1, band_pu = 10', "band_pu", "must be from 0.0001 pu to 0.2 pu"),
        ('measure = "damping_ratio", at_least = 2', "at_least", "must be above -1 and at most 1"),
        ('measure = "peak_pu", at_most = "1200 %"', "at_most", "must be at least 0 pu and below 10 pu"),
        ('measure = "limited_s", at_least = 0', "at_least", "must be above 0 s and at most 600 s"),
    ],
)
def test_a_limit_that_every_run_keeps_or_none_is_a_fault(criterion: str, field: str, problem: str) -> None:
    found = faults_of(f"{ONE}events = [{{ P_pu = 0 }}]\ncriteria = [{{ {criterion} }}]")
    assert {name: fault.problem for name, fault in found.items()} == {f"tests[0].criteria[0].{field}": problem}


def test_limits_at_the_edge_of_what_a_measure_can_be() -> None:
    asked = '{ measure = "limited_s", at_most = 0 }, { measure = "damping_ratio", at_least = 0 }'
    criteria = suite_from_text(f"{ONE}events = [{{ P_pu = 0 }}]\ncriteria = [{asked}]").tests[0].criteria
    assert [(one.at_least, one.at_most) for one in criteria] == [(None, 0.0), (0.0, None)]


def test_a_need_is_one_that_is_known() -> None:
    fault = faults_of(ONE + 'events = [{ P_pu = 0 }]\nneeds = ["storag"]')["tests[0].needs"]
    assert "Did you mean storage?" in fault.advice


def test_a_limit_may_have_a_unit() -> None:
    text = 'criteria = [{ measure = "settling_s", at_most = "800 ms", band_pu = "5 %" }, { measure = "recovery_s" }]'
    first, second = suite_from_text(f"{ONE}events = [{{ P_pu = 0 }}]\n{text}").tests[0].criteria
    assert (first.at_most, first.given, first.informational) == (0.8, (("band_pu", 0.05),), False)
    assert second.informational


def test_a_fault_of_a_swept_test_is_told_once() -> None:
    with pytest.raises(StudyError) as caught:
        suite_from_text(ONE.replace("scr = 3", "scr = [1, 2, 3]") + 'events = [{ phase_jump = "400 deg" }]')
    assert len(caught.value.faults) == 1


def test_a_sweep_that_is_too_large_says_its_size() -> None:
    numbers = ", ".join(map(str, range(1, 61)))
    text = ONE.replace("= 3", f"= [{numbers}]").replace("= 5", f"= [{numbers}]") + "events = [{ P_pu = 0 }]"
    assert "makes 3,600 tests (scr 60 × x_over_r 60)" in faults_of(text)["tests[0]"].problem


def test_ids_are_unique() -> None:
    found = faults_of(f"{ONE}events = [{{ P_pu = 0 }}]\n{ONE}events = [{{ P_pu = 1 }}]")
    assert found["tests[1].name"].problem == "has the id of a test of tests[0]"
    assert (
        "gives 2 twice" in faults_of(ONE.replace("= 3", "= [2, 2]") + "events = [{ P_pu = 0 }]")["tests[0].scr"].problem
    )


def test_an_empty_file_says_what_a_suite_needs() -> None:
    assert "there is no test" in faults_of("")["tests"].problem
    assert "nothing happens" in faults_of(ONE)["tests[0].events"].problem


def test_an_unknown_suite_suggests_the_near_one() -> None:
    with pytest.raises(StudyError, match=r'Did you mean "ieee1547"\?'):
        suite_named("ieee1574")
    with pytest.raises(StudyError, match="there is no such file"):
        suite_named("mine.toml")


@pytest.mark.parametrize("name", SUITES)
def test_a_packaged_suite_is_whole(name: str) -> None:
    suite = suite_named(name)
    assert suite.name == name
    for test in suite.tests:
        assert test.source.confidence in ("read", "secondary", "ours")
        assert test.source.document
        numbers = [test.scr, test.x_over_r, test.P_pu, test.Q_pu, *(event.t_s for event in test.events)]
        assert all(map(math.isfinite, numbers))
        assert [event.t_s for event in test.events] == sorted(event.t_s for event in test.events)


def test_a_synchro_check_closes_one_breaker() -> None:
    check = 'breaker = "closed", synchro_check = { angle = "5 deg", around = "60 deg" }'
    last = one_event(f'{{ breaker = "open" }}, {{ time = "1 s", {check} }}')[-1]
    assert last.switched.breaker == "closed"
    assert last.synchro_check is not None
    assert math.degrees(last.synchro_check.around) == pytest.approx(60.0)
    found = faults_of(f'{ONE}events = [{{ breaker = "open", synchro_check = {{}} }}]')
    assert "closes the breaker" in found["tests[0].events[0].synchro_check"].problem
    found = faults_of(
        f'{ONE}events = [{{ breaker = "open" }}, {{ time = "1 s", {check} }}, {{ time = "9 s", breaker = "open" }}]'
    )
    assert "when its synchro-check allows" in found["tests[0].events[2].breaker"].problem
