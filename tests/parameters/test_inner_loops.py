"""The [inner_loops] section: gains that are given, or what they are to be designed for."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import StudyError
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.loading import base_files
from vsgdesign.study.parameters.study import InnerLoopRequest

CASE = """
base = "case:lab_12kva_lcl"
[simulation]
duration = "1 s"
P_ref = "2 kW"
Q_ref = 0
[[controllers]]
name = "a"
kind = "scheduled"
"""
DESIGNED = InnerLoopGains(0.1, 1.0, 10.0, 100.0, K_ff=-0.2, R_t=0.3, X_t=-0.1, kappa=1.4)


class Source:
    """Answers every request alike and remembers it."""

    def __init__(self) -> None:
        self.requests: list[InnerLoopRequest] = []

    def __call__(self, request: InnerLoopRequest) -> tuple[InnerLoopGains, float]:
        self.requests.append(request)
        return DESIGNED, 200.0


def designed(text: str) -> tuple[Study, list[InnerLoopRequest]]:
    source = Source()
    return study_from_text(text, inner_loops=source), source.requests


def faults(text: str) -> list[str]:
    with pytest.raises(StudyError) as caught:
        designed(text)
    return [f"{fault.field}: {fault.problem}" for fault in caught.value.faults]


def test_designed_gains_replace_those_of_the_base() -> None:
    study, requests = designed(CASE + "[inner_loops]\ndesign = true\n")
    assert study.inner_gains == DESIGNED
    assert study.omega_t == 200.0
    assert requests == [study.inner_request]
    request = requests[0]
    assert (request.scr, request.x_over_r, request.scr_basis) == ((1.2, 20.0), (0.3, 20.0), "impedance")
    assert (request.converter, request.filter) == (study.converter, study.filter)
    assert request.settling_time == study.target.settling_time


def test_an_absent_section_is_designed() -> None:
    text = CASE.replace("lab_12kva_lcl", "simplus_100kva") + "[inner_loops]\n"
    study, requests = designed(text)
    assert study.inner_gains == DESIGNED
    assert len(requests) == 1


def test_the_grids_are_the_specifications_or_ones_own() -> None:
    specification = '[specification]\nscr = [2, 5, 9]\nx_over_r = [0.5, 4]\nsettling_time = "0.5 s"\n'
    specification += 'scr_basis = "reactance"\n'
    _, (request,) = designed(CASE + "[inner_loops]\ndesign = true\n" + specification)
    assert (request.scr, request.x_over_r, request.scr_basis) == ((2.0, 9.0), (0.5, 4.0), "reactance")
    assert request.settling_time == 0.5
    own = "[inner_loops]\ndesign = true\nscr = [1.5, 30]\nseed = 7\n"
    _, (request,) = designed(CASE + own + specification)
    assert (request.scr, request.x_over_r, request.scr_basis) == ((1.5, 30.0), (0.5, 4.0), "impedance")
    assert request.seed == 7


def test_given_gains_replace_a_design_of_the_base() -> None:
    text = CASE.replace("lab_12kva_lcl", "simplus_100kva")
    study, requests = designed(text + "[inner_loops]\nK_pc = 1\nK_ic = 2\nK_pv = 3\nK_iv = 4\n")
    assert study.inner_gains[:4] == (3.0, 4.0, 1.0, 2.0)
    assert requests == []
    assert study.inner_request is None


def test_every_fault_at_once_and_nothing_is_designed_then() -> None:
    own = "[inner_loops]\ndesign = true\nK_pc = 3\nscr = [1, 2, 3]\nseed = -1\nfoo = 1\n"
    text = CASE.replace('"2 kW"', '"2 kV"') + own
    found = faults(text)
    assert [line.partition(":")[0] for line in found] == [
        "inner_loops.K_pc",
        "inner_loops.scr",
        "inner_loops.seed",
        "inner_loops.foo",
        "simulation.P_ref",
    ]


@pytest.mark.parametrize(
    ("lines", "field"),
    [
        ("scr = [1, 2]\n", "inner_loops.scr"),
        ("seed = 3\n", "inner_loops.seed"),
        ("design = 1\n", "inner_loops.design"),
    ],
)
def test_a_design_of_given_gains_is_a_fault(lines: str, field: str) -> None:
    assert any(line.startswith(field) for line in faults(CASE + "[inner_loops]\n" + lines))


def test_a_reader_that_designs_none_says_who_does() -> None:
    with pytest.raises(StudyError, match=r"vsgdesign\.verbs\.pipeline\.open_study"):
        study_from_text(CASE + "[inner_loops]\ndesign = true\n")


def test_a_prediction_needs_a_delay() -> None:
    text = CASE + "[inner_loops]\ncurrent_prediction = 1.2\n"
    assert study_from_text(text).inner_gains.kappa == 1.2
    late = text + "[converter]\ndelay_samples = 0\n"
    assert faults(late) == ["inner_loops.current_prediction: there is no delay to predict over"]


def test_a_transient_reactance_is_in_ohms_and_may_be_negative() -> None:
    study = study_from_text(CASE + '[inner_loops]\ntransient_reactance_pu = -0.05\ntransient_corner = "30 Hz"\n')
    assert study.inner_gains.X_t == pytest.approx(-0.05 * 400.0**2 / 12.5e3)
    assert study.omega_t == pytest.approx(2.0 * math.pi * 30.0)


def test_the_files_that_a_study_builds_on(tmp_path: Path) -> None:
    (tmp_path / "below.toml").write_text('base = "case:lab_12kva_lcl"\n')
    (tmp_path / "study.toml").write_text('base = "below.toml"\n')
    files = base_files(tmp_path / "study.toml")
    assert [file.name for file in files] == ["below.toml", "lab_12kva_lcl.toml"]
    assert all(file.is_file() for file in files)
    (tmp_path / "round.toml").write_text('base = "round.toml"\n')
    assert len(base_files(tmp_path / "round.toml")) < 100
