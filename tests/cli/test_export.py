"""The verbs of ``vsgdesign export`` that take a study."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from vsgdesign.verbs.cli.program import main

STUDY = """
base = "case:lab_12kva_lcl"
grid = { scr_basis = "impedance", scr = 3, x_over_r = 5 }
simulation = { duration = "1 s", P_ref = "4 kW", Q_ref = "0 var" }
controllers = [{ name = "fixed gains", kind = "fixed" }, { name = "closed", kind = "scheduled" }]
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    file = tmp_path / "study.toml"
    file.write_text(STUDY.replace("fixed gains", "fixed-gains"), encoding="utf-8")
    return file


def told(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(main, [str(one) for one in ("export", *arguments)])
    return done.exit_code, done.output


def test_every_controller_of_a_study_as_c(study: Path, tmp_path: Path) -> None:
    out = tmp_path / "its C"
    for name in ("fixed-gains", "closed"):
        code, text = told("c", study, "--out", out, "--controller", name)
        assert code == 0, text
        assert f"of controller {name} of study" in text
        assert text.endswith(f"next: make -C '{out}' test\n")  # can be copied into a shell
        assert name in (out / "vsg_unit.h").read_text(encoding="utf-8")


def test_what_does_not_fit_is_said(study: Path, tmp_path: Path) -> None:
    out = tmp_path / "c"
    for arguments, words in (
        ((study, "--controller", "nobody"), "The study has: fixed-gains, closed."),
        ((study, "--study", study), "a study is given alone"),
        ((tmp_path / "t.json", "--controller", "closed"), "--study names the study"),
        ((study, "--v-limit", "5", "--grid-phase"), "--v-limit, --grid-phase: of a TABLE.json alone"),
    ):
        code, text = told("c", *arguments, "--out", out)
        assert code == 2
        assert words in text
    assert not out.exists()
    out.mkdir()
    (out / "mine.txt").write_text("mine", encoding="utf-8")
    code, text = told("c", study, "--out", out)
    assert code == 2
    assert "mine.txt" in text
    assert [file.name for file in out.iterdir()] == ["mine.txt"]


def test_a_wrapper_without_a_compiler(study: Path, tmp_path: Path) -> None:
    out = tmp_path / "modelica"
    for _ in range(2):  # the second one replaces the first
        code, text = told("modelica", study, "--out", out, "--variant", "reference")
        assert code == 0, text
        assert "of controller closed of study" in text
    assert next(out.glob("VsgController_*_closed_reference.mo")).is_file()
    next(out.glob("*.txt")).write_text("mine", encoding="utf-8")
    code, text = told("modelica", study, "--out", out)
    assert code == 2
    assert "was changed since" in text
