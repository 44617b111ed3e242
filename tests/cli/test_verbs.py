"""Help, version, validate and design; and that help is cheap."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from tests.cli.small_studies import as_json, call, failure, study_file
from tests.cli.test_named_files import with_table
from tests.gain_tables import table as gain_table
from vsgdesign import __version__
from vsgdesign.artifacts import write_table_file
from vsgdesign.design.study_design import design_study
from vsgdesign.equations.placing import placed_poles
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.page.terminal import print_terminal
from vsgdesign.report.stability.design import design_blocks
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters import load_study
from vsgdesign.verbs.pipeline import make_ready

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
    assert ("--out DIR" in result.stdout) == (verb in ("run", "simulate", "design", "validate"))


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


@pytest.mark.parametrize("verb", ["verify", "explore", "pil", "certify", "export fmu"])
def test_a_table_and_its_study_are_asked_for_in_the_same_words(verb: str, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out") if verb.startswith("export") else ()
    alone = call(*verb.split(), tmp_path / "t.json", *out)
    assert alone.exit_code == 2
    assert "If it is a gain table, --study names the study with its converter" in alone.output
    twice = call(*verb.split(), tmp_path / "s.toml", "--study", tmp_path / "s.toml", *out)
    assert twice.exit_code == 2
    assert "--study belongs to a TABLE.json" in twice.output


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
    for shown in ("SCR on the reactance basis", "[W/rad]", "[var/V]", "K_ip", "[rad/(s²W)]", "76.3", "1.369!"):
        assert shown in result.stdout
    assert "! the design point needs a voltage outside 0.85 to 1.25 pu" in result.stdout


def test_design_says_that_it_leaves_a_load_out(tmp_path: Path) -> None:
    path = study_file(tmp_path)
    assert "warning" not in call("design", path).stderr
    text = Path(path).read_text(encoding="utf-8") + "\n[network]\nload = { P_pu = 0.5 }\n"
    Path(path).write_text(text, encoding="utf-8")
    result = call("design", path)
    assert result.exit_code == 0
    assert "warning: [network] is left out" in result.stderr


COUPLED = """
base = "case:hoang2025_5kva"
power_loops = { structure = "angle_damped", tau_P = "5 ms", tau_Q = "5 ms" }
simulation = { duration = "0.1 s", P_ref = "2 kW", Q_ref = "1 kvar" }
controllers = [
    { name = "damped", kind = "scheduled" },
    { name = "decoupled", kind = "scheduled", structure = "decoupled" },
    { name = "published", kind = "scheduled", structure = "published" },
    { name = "guessing", kind = "scheduled", estimate = "neural" },
    { name = "tabled", kind = "scheduled", schedule = "table" },
]
estimator = { grid_phase = true }
specification = { scr = [2, 8], x_over_r = [1, 3] }
"""


def test_design_shows_every_controller_every_gain_and_what_the_grid_sees(tmp_path: Path) -> None:
    """Four of eleven columns had no heading, tables and networks were left out in silence, there was no H, no kW/Hz."""
    document = as_json("design", study_file(tmp_path, COUPLED))
    found = {d["controller"]: d for d in document["designs"]}
    assert list(found) == ["damped", "decoupled", "published", "guessing"]
    assert found["guessing"]["gains"] == found["damped"]["gains"]  # those of the true grid
    (missing,) = document["missing"]
    assert missing.startswith("tabled: its gain table is not built yet.")
    for name, k_1 in (("published", 16.0), ("decoupled", placed_poles(0.99 * 0.97).k_1)):
        # Whatever the coupling, H is A ω_0/(2 S k_1); the published k_1 is (4/T)², the other one placed for T_d.
        H = found[name]["point"]["A"] * 100.0 * np.pi / (2.0 * 5e3 * k_1)
        assert found[name]["inertia_s"] == pytest.approx(H, rel=1e-9)
    for d in found.values():
        assert d["droop_W_per_Hz"] == pytest.approx(2.0 * np.pi * d["gains"]["D_p"])
    g = found["damped"]["gains"]
    naive = 100.0 * np.pi / (2.0 * 5e3 * g["K_ip"])
    coupled = 100.0 * np.pi / (2.0 * 5e3 * (g["K_ip"] - g["K_pq"] * g["K_qp"] / g["K_iq"]))
    assert found["damped"]["inertia_s"] == pytest.approx(coupled, rel=1e-12)
    assert abs(coupled / naive - 1.0) > 0.05

    result = call("design", tmp_path / "small.toml")
    for heading in ("K_ip", "D_p", "K_iq", "D_q", "K_pq", "K_qp", "k_P", "k_Q", " H ", "P–f droop", "Q–V droop"):
        assert heading in result.stdout
    for unit in ("[s]", "[kW/Hz]", "[% of f_n]", "[kvar/V]", "[V/(s·W)]", "[rad/(s·W)]"):
        assert unit in result.stdout
    assert f"{coupled:.3g}" in result.stdout
    assert "tabled: its gain table is not built yet." in result.stdout
    assert "guessing: estimates the grid; shown with the gains of the true one." in result.stdout


def test_design_fits_a_terminal_of_80_columns(tmp_path: Path) -> None:
    """Nothing is folded: every number stands whole on its line."""
    study = load_study(study_file(tmp_path, COUPLED))
    study = replace(study, controllers=study.controllers[:4])
    shown = {}
    for width in (80, 200):
        out = StringIO()
        blocks = [block for block in design_blocks(design_study(study)) if isinstance(block, Table)]
        print_terminal([replace(block, notes=()) for block in blocks], Console(file=out, width=width))
        shown[width] = [line.rstrip() for line in out.getvalue().splitlines()]
    assert shown[80] == shown[200]
    assert max(len(line) for line in shown[80]) <= 80


def test_design_of_a_table_that_is_there(tmp_path: Path) -> None:
    study = with_table(tmp_path / "there")
    document = as_json("design", study)
    found = [d for d in document["designs"] if d["controller"] == "tabled"]
    assert len(found) == 2  # on both grids of the scenario
    assert document["missing"] == []
    loaded = load_study(study)
    law = gain_law(loaded, loaded.controllers[-1], make_ready(loaded))
    for d in found:
        point, grid = d["point"], d["grid"]
        expected = law(grid["R_g"], grid["L_g"], point["P"], point["Q"], point["V_rms"])
        assert [d["gains"][name] for name in ("K_ip", "D_p", "K_iq", "D_q")] == pytest.approx(
            [float(value) for value in expected[:4]], rel=1e-12
        )


def modules_after(code: str) -> set[str]:
    code += "; import sys; print('MODULES', *{name.split('.')[0] for name in sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return set(run.stdout.split("MODULES")[-1].split())


def test_the_command_line_itself_is_light() -> None:
    assert modules_after("import vsgdesign.verbs.cli.program").isdisjoint(HEAVY)
    help_ = (
        "from click.testing import CliRunner; from vsgdesign.verbs.cli.program import main; "
        "CliRunner().invoke(main, ['--help'])"
    )
    assert modules_after(help_).isdisjoint(HEAVY)


def test_validate_is_light_but_for_the_rests(tmp_path: Path) -> None:
    """Whether there is a rest takes NumPy; CasADi comes with the models beside it."""
    study = str(study_file(tmp_path))
    code = f"from vsgdesign.verbs.cli.program import main; main(['validate', {study!r}], standalone_mode=False)"
    assert modules_after(code) & HEAVY == {"numpy", "casadi"}


def test_the_package_is_the_program() -> None:
    command = [sys.executable, "-m", "vsgdesign", "--version"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.startswith("vsgdesign, version")


@pytest.mark.parametrize("verb", ["run", "simulate", "compare", "table build"])
def test_a_verb_that_designs_tables_takes_workers(verb: str, tmp_path: Path) -> None:
    assert "--workers" in call(*verb.split(), "--help").output
    assert "0 is not in the range" in call(*verb.split(), study_file(tmp_path), "--workers", "0").stderr


@pytest.mark.parametrize("option", ["--v-limit", "--i-limit"])
def test_limits_of_sensors_that_nothing_has_are_refused(option: str, tmp_path: Path) -> None:
    """They were taken without a word, a negative one too."""
    write_table_file(gain_table(), tmp_path / "t.json")
    said = failure(2, "export", "c", tmp_path / "t.json", "--out", tmp_path / "c", option, "-5")
    assert f"{option[2:].replace('-', '_')} = -5: the samples of a network are held against it" in said
    assert not (tmp_path / "c").exists()
