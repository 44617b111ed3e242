"""Events of the source of the dc link: in runs, survival cases and suites, with what is told of them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from tests.simulation.event_kinds import TEXT
from vsgdesign.artifacts.time_series import UNITS
from vsgdesign.campaigns.compliance.case import Subject as OfSuite
from vsgdesign.campaigns.compliance.reading import suite_from_text
from vsgdesign.campaigns.compliance.run import run_test
from vsgdesign.equations.dc_sources import DC_SOURCES
from vsgdesign.errors import StudyError
from vsgdesign.report.scenario.tables import dc_row
from vsgdesign.simulation.dc_start import DcFigures
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.survival import CaseRun, GridState, Subject, SurvivalCase, dc_set, trace_case
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.event import Event

STAGE = """
[dc]
source = "converter"
C = "2 mF"
[dc.converter]
p_max = "6 kW"
p_charge_max = "6 kW"
"""


OWN = {
    "battery": {"battery": {"R_i": "1 ohm", "i_max": 20, "capacity_Ah": 5}},
    "converter": {"converter": {"p_max": "6 kW"}},
    "photovoltaic": {"photovoltaic": {"modules": 16, "strings": 2}},
}


def study_with(more: str = "") -> Study:
    return study_from_text(TEXT + STAGE + more)


def test_what_the_rest_of_the_source_cannot_give_is_told_and_lost() -> None:
    """2 kW rest with half of 6 kW, and with a fifth of it they do not: 1.2 kW."""
    for share, status in ((0.5, "settled"), (0.2, "blocked")):
        text = f"[[events]]\ntime = '0.2 s'\ndc_power = {share}\n"
        one = run_scenario(study_with(text)).controllers[0]
        assert one.outcome.status == status
        obstacle = one.rests[-1].obstacle
        assert (obstacle is None) == (status == "settled")
        if obstacle is not None:
            assert "its limits are -1200 to 1200 W" in obstacle
    assert study_with(text).events[0].name == "dc source 0.2"
    both = study_with("[[events]]\ntime = '0.2 s'\ndc_power = 0.2\n[[events]]\ntime = '0.3 s'\ndc_power = 1\n")
    assert run_scenario(both).controllers[0].outcome.status == "settled"


@pytest.mark.parametrize("source", DC_SOURCES)
def test_every_number_of_a_clamped_link_has_its_unit(source: str) -> None:
    """A file of the run can be written."""
    study = study_from_text(TEXT.replace("2.4 s", "0.1 s")).with_changes(
        dc={"source": source, "C": "2 mF", "control": "power_clamp"} | OWN[source]
    )
    (one,) = run_scenario(study).controllers
    assert "P_cut" in one.series
    assert set(one.series) <= set(UNITS)


def test_survival_cases_and_suites_have_them() -> None:
    study = study_with()
    subject = Subject(study=study, spec=study.controllers[0], limit_pu=1.2)
    start, asked = GridState(scr=5.0, x_over_r=5.0, P_pu=0.4, Q_pu=0.1), {}
    for share in (0.5, 0.2):
        case = SurvivalCase(group="one", start=start, changes=(Event.of_pu(0.0, dc_power=share),), cleared_s=0.0)
        run = trace_case(subject, case)
        asked[share] = (run.verdict if isinstance(run, CaseRun) else run).status
    assert asked == {0.5: "survived", 0.2: "no rest"}
    text = "[[tests]]\nname = 'one'\nscr = 5\nx_over_r = 5\nP_pu = 0.4\nevents = [{ dc_power = 0.5 }]\n"
    (test,) = suite_from_text(text).tests
    assert run_test(OfSuite(study=study, spec=study.controllers[0]), test).survival.status == "survived"
    ideal = replace(study, dc=None)
    from vsgdesign.campaigns.compliance.applies import not_applicable

    assert not_applicable(OfSuite(study=ideal, spec=study.controllers[0]), test) == (
        "the dc link is ideal: the study has no [dc]"
    )


def test_a_faulty_source_still_has_its_events() -> None:
    """Of a battery without its resistance that is said alone, and not that a battery has no charge."""
    text = TEXT + '[dc]\nsource = "battery"\nC = "1 mF"\nbattery = { i_max = 15, capacity_Ah = 10 }\n'
    with pytest.raises(StudyError) as caught:
        study_from_text(text + "[[events]]\ntime = '1 s'\ndc_charge = 0\n")
    assert [fault.field for fault in caught.value.faults] == ["dc.battery.R_i"]


def test_an_empty_source_is_not_less_than_empty() -> None:
    """What the last sample took leaves a rounding below zero."""
    figures = DcFigures(lowest_v=690.0, highest_v=700.0, spare_v=9.0, least_p_w=0.0, most_p_w=1.0, given_j=1.0, end={})
    found: Any = SimpleNamespace(dc=figures, outcome=SimpleNamespace(status="blocked"))
    for charge, said in ((-4.2e-9, "0"), (0.61, "61.00")):
        found.dc = replace(figures, end={"dc_charge": charge})
        row = dc_row(found)
        assert row is not None
        assert row[-1] == said


def test_the_set_of_survive_has_what_may_become_of_the_source() -> None:
    assert dc_set(None) == ()
    changes = [[change.of_dc for change in case.changes] for case in dc_set(study_with().dc)]
    assert [{"dc_power": 0.5}, {}] in changes
    assert [{"dc_charge": 0.0}] in changes
    assert not any("irradiance" in change for each in changes for change in each)


@pytest.mark.parametrize(
    ("base", "more", "field", "problem"),
    [
        (TEXT, "[[events]]\ntime = '1 s'\ndc_charge = 0\n", "events.dc_charge", "no [dc]"),
        (TEXT + STAGE, "[[events]]\ntime = '1 s'\nirradiance = 500\n", "events.irradiance", "has no irradiance"),
        (TEXT + STAGE, "[[events]]\ntime = nan\nirradiance = 500\n", "events.irradiance", '= "500": source'),
        (TEXT + STAGE, "[[events]]\ntime = '1 s'\ndc_power = 1.5\n", "dc_power", "outside"),
        (TEXT, "[verification.dc_power]\nweight = 1\n", "verification.dc_power.weight", "no [dc]"),
    ],
)
def test_faults(base: str, more: str, field: str, problem: str) -> None:
    with pytest.raises(StudyError) as caught:
        study_from_text(base + more)
    assert field in str(caught.value)
    assert problem in str(caught.value)
