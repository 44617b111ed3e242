"""Every packaged case is a whole system that a study can stand on, and docs/converters.md lists it as it is."""

from __future__ import annotations

import math
import re
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from tests.parameters.documents import build
from vsgdesign.equations.frames import phase_to_ll
from vsgdesign.study.parameters import Study, case_names
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.reader import parse_quantity

PAGE = Path(__file__).resolve().parents[2] / "docs" / "converters.md"


def document(case: str) -> dict[str, Any]:
    """The case's file as it stands."""
    text = (resources.files("vsgdesign.study.parameters") / "cases" / f"{case}.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def system(case: str) -> Study:
    """A case's converter, filter and grid; the rule's inner gains stand in for designed ones, which cost a search."""
    return build(
        document(case)
        | {
            "inner_loops": {"current_response_time": "1 ms", "voltage_response_time": "10 ms"},
            "simulation": {"duration": "1 s", "P_ref": 0, "Q_ref": 0},
            "controllers": [{"name": "scheduled", "kind": "scheduled"}],
        }
    )


def sampling_over_resonance(study: Study) -> float:
    """Sampling frequency over that of L_1 and C with L_2 and the strongest, most resistive grid (SCR 20, X/R 0.3)."""
    f, grid = study.filter, Place(20.0, 0.3, "impedance").grid(study.converter)
    outer = f.L_2 + grid.L_g
    resonance = math.sqrt((f.L_1 + outer) / (f.L_1 * outer * f.C)) / (2.0 * math.pi)
    return 1.0 / (study.converter.T_s * resonance)


def rows() -> dict[str, list[str]]:
    lines = re.findall(r"^\| `case:(\w+)` \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return {case: [cell.strip() for cell in cells.split(" | ")] for case, cells in lines}


@pytest.mark.parametrize("case", case_names())
def test_a_case_is_a_system_and_cites_its_source(case: str) -> None:
    text = (resources.files("vsgdesign.study.parameters") / "cases" / f"{case}.toml").read_text(encoding="utf-8")
    assert text.startswith("# ")
    assert not {"simulation", "controllers", "events", "specification"} & document(case).keys()
    study = system(case)
    assert study.source
    assert study.grid.scr(study.converter, study.scr_basis) == pytest.approx(document(case)["grid"]["scr"])


def test_the_cases_cover_what_converters_differ_in() -> None:
    studies = [system(case) for case in case_names()]
    assert len(studies) >= 16
    assert min(s.converter.S_rated for s in studies) == 1e3
    assert max(s.converter.S_rated for s in studies) == 5e6
    assert {round(s.converter.omega_n / (2.0 * math.pi)) for s in studies} == {50, 60}
    assert {s.converter.delay_samples for s in studies} == {0, 1}
    assert {s.converter.samples_per_carrier for s in studies} == {1, 2}
    assert {s.filter.L_2 > 0.0 for s in studies} == {False, True}
    assert {s.converter.zero_sequence for s in studies} == {False, True}


def test_the_page_lists_every_case() -> None:
    assert sorted(rows()) == sorted(case_names())


@pytest.mark.parametrize("case", case_names())
def test_the_page_says_what_the_case_holds(case: str) -> None:
    rating, voltage, frequency, kind, per_unit, sampling, delay, ratio, source = rows()[case]
    study = system(case)
    c, f = study.converter, study.filter
    assert parse_quantity(rating, "VA") == c.S_rated
    assert parse_quantity(voltage, "V") == pytest.approx(phase_to_ll(c.V_rated_rms), rel=2e-3)
    assert parse_quantity(frequency, "Hz") == pytest.approx(c.omega_n / (2.0 * math.pi))
    assert kind == ("LCL" if f.L_2 else "LC")
    reactances = (f.L_1 * c.omega_n / c.Z_base, f.C * c.omega_n * c.Z_base, f.L_2 * c.omega_n / c.Z_base)
    assert per_unit == ", ".join(f"{x:.3f}" for x in reactances if x > 0.0)
    assert parse_quantity(sampling, "Hz") == pytest.approx(1.0 / c.T_s)
    assert delay == str(c.delay_samples)
    assert ratio == f"{sampling_over_resonance(study):.1f}"
    assert source
