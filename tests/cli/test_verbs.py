"""Help, version, validate and design; and that help is cheap."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.small_studies import as_json, call, study_file
from vsgdesign import __version__

VERBS = ("run", "simulate", "design", "validate")
HEAVY = {"casadi", "numba", "llvmlite", "matplotlib", "control", "scipy", "rich", "jinja2", "torch", "numpy"}


def test_version() -> None:
    result = call("--version")
    assert result.exit_code == 0
    assert result.stdout.strip() == f"vsgdesign, version {__version__}"


def test_help_names_every_verb_and_the_exit_codes() -> None:
    for flag in ("--help", "-h"):
        result = call(flag)
        assert result.exit_code == 0
        for verb in VERBS:
            assert re.search(rf"^  {verb} +[A-Z]", result.stdout, re.MULTILINE)
        assert "0 done, 1 the study asks for something impossible" in result.stdout


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_each_verb(verb: str) -> None:
    result = call(verb, "--help")
    assert result.exit_code == 0
    assert "STUDY.toml" in result.stdout
    assert "--json" in result.stdout
    assert ("--out DIR" in result.stdout) == (verb in ("run", "simulate"))


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["desing", "x.toml"], "No such command 'desing'"),
        (["design"], "Missing argument 'STUDY.toml'"),
        (["simulate", "x.toml", "--bridge", "ideal"], "'ideal' is not one of 'averaged', 'pwm'"),
        (["validate", "x.toml", "--fast"], "No such option"),
    ],
)
def test_wrong_usage_is_wrong_input(arguments: list[str], problem: str) -> None:
    result = call(*arguments)
    assert result.exit_code == 2
    assert problem in result.stderr


def test_validate(tmp_path: Path) -> None:
    study = study_file(tmp_path)
    result = call("validate", study)
    assert (result.exit_code, result.stdout) == (0, f"{study}: valid (2 controllers, 2 events)\n")
    document = as_json("validate", study)
    assert document["valid"] is True
    assert document["study"] == "small"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.toml"]


def test_the_hash_is_of_the_content(tmp_path: Path) -> None:
    plain = as_json("validate", study_file(tmp_path))["hash"]
    text = (tmp_path / "small.toml").read_text()
    (tmp_path / "small.toml").write_text("# a comment\n" + text)
    assert as_json("validate", tmp_path / "small.toml")["hash"] == plain
    assert as_json("validate", study_file(tmp_path, duration='"0.31 s"'))["hash"] != plain


def test_design(tmp_path: Path) -> None:
    study = study_file(tmp_path)
    document = as_json("design", study)
    assert document["study"] == "small"
    assert document["hash"] == as_json("validate", study)["hash"]
    designs = document["designs"]
    assert [d["controller"] for d in designs] == ["fixed", "fixed", "scheduled", "scheduled"]
    for d in designs:
        assert set(d["gains"]) == {"K_ip", "D_p", "K_iq", "D_q"}
        assert {"P", "Q", "V_rms", "delta", "A", "B", "C", "D"} <= set(d["point"])
        assert {"R_g", "L_g"} <= set(d["grid"])
        assert d["margins_P"]["phase_margin_deg"] > 30.0
        assert d["margins_P"]["gain_margin_db"] is None
    # Critically damped wherever it is scheduled: tan(margin) = 2/√(√5 − 2), 76.3°.
    assert [d["margins_P"]["phase_margin_deg"] for d in designs[2:]] == pytest.approx([76.3454, 76.3454], abs=1e-3)
    assert designs[0]["gains"] == designs[1]["gains"]
    assert designs[2]["gains"] != designs[3]["gains"]


def test_design_in_words(tmp_path: Path) -> None:
    result = call("design", study_file(tmp_path))
    assert result.exit_code == 0
    for shown in ("SCR on the reactance basis", "A [W/rad]", "D [var/V]", "K_ip [rad/(s²W)]", "76.3°", "1.369!"):
        assert shown in result.stdout
    assert "! the design point needs a voltage outside 0.85 to 1.25 pu" in result.stdout


def modules_after(code: str) -> set[str]:
    code += "; import sys; print('MODULES', *{name.split('.')[0] for name in sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return set(run.stdout.split("MODULES")[-1].split())


def test_the_command_line_itself_is_light() -> None:
    assert modules_after("import vsgdesign.cli").isdisjoint(HEAVY)
    help_ = "from click.testing import CliRunner; from vsgdesign.cli import main; CliRunner().invoke(main, ['--help'])"
    assert modules_after(help_).isdisjoint(HEAVY)


def test_validate_is_light_but_for_numpy(tmp_path: Path) -> None:
    study = str(study_file(tmp_path))
    code = f"from vsgdesign.cli import main; main(['validate', {study!r}], standalone_mode=False)"
    assert modules_after(code) & HEAVY == {"numpy"}
