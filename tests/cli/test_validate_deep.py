"""``validate --deep`` refuses what a run refuses, in its words, and warns of what it warns of, without a simulation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.small_studies import call
from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.codegen.llvm import StandingLoop

HEAD = """
base = "case:hoang2025_5kva"
grid = { scr_basis = "impedance", scr = 4, x_over_r = 3 }
"""
RUN = 'simulation = { duration = "0.2 s", P_ref = "0 kW", Q_ref = "0 var" }\n'
ONE = 'controllers = [{ name = "a", kind = "scheduled", structure = "angle_damped" }]\n'
OPEN = """
network = { breaker = "open" }
simulation = { duration = "0.5 s", P_ref = "0 kW", Q_ref = "0 var", start = "cold" }
controllers = [{ name = "a", kind = "scheduled", structure = "angle_damped", estimate = "injection" }]
events = [{ time = "0.1 s", breaker = "closed", synchronise = true }]
"""
NEARLY_BOLTED = 'events = [{ time = "0.1 s", fault = { R_pu = 1e-9 }, load = { X_C_pu = 1000 } }]\n'
FIELD = ONE.replace(" }]", ', schedule = "table", table = "t.json", estimate = "field" }]')


@pytest.fixture
def no_run(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """No sample is simulated."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a loop was run")

    monkeypatch.setattr(StandingLoop, "__call__", refuse)
    return monkeypatch


def written(folder: Path, text: str) -> Path:
    path = folder / "s.toml"
    path.write_text(HEAD + text, encoding="utf-8")
    if "t.json" in text:
        write_table_file(table(), folder / "t.json")
    return path


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        (OPEN, 1, "sends no probe"),
        (RUN + ONE + NEARLY_BOLTED, 1, "the fastest mode dies out"),
        (RUN + ONE, 2, "is a file"),
    ],
    ids=["probe", "stiff", "folder"],
)
def test_what_a_run_refuses(text: str, code: int, said: str, no_run: pytest.MonkeyPatch, tmp_path: Path) -> None:
    study, out = written(tmp_path, text), tmp_path / "out"
    if code == 2:
        out.write_text("mine", encoding="utf-8")
    assert call("validate", study).exit_code == 0
    deep, as_json = (
        call("validate", study, "--deep", "--out", out),
        call("validate", study, "--deep", "--out", out, "--json"),
    )
    no_run.undo()
    run = call("simulate", study, "--out", out, "--workers", "1")
    assert deep.exit_code == as_json.exit_code == run.exit_code == code
    assert said in deep.stderr
    assert deep.stderr.split("error: ")[1] == run.stderr.split("error: ")[1]
    document = json.loads(as_json.stdout)
    assert not document["valid"]
    assert said in document["faults"][0]["problem"]


@pytest.mark.usefixtures("no_run")
def test_c_that_would_be_refused_after_the_run(tmp_path: Path) -> None:
    """The table fits the converter and is designed to another specification: a run simulates it, and its C with the
    field estimator needs the study that it was designed from."""
    study = written(tmp_path, RUN + FIELD)
    assert call("validate", study).exit_code == 0
    deep = call("validate", study, "--deep")
    assert deep.exit_code == 2
    assert "was not designed from this study" in deep.stderr


def test_what_a_run_warns_of(no_run: pytest.MonkeyPatch, tmp_path: Path) -> None:
    gains = "K_ip = 2e-2, D_p = 0, K_iq = 1e-4, D_q = 0"
    step = 'events = [{ time = "0.1 s", V_ref_pu = 1.02 }]\n'
    text = RUN + f'controllers = [{{ name = "a", kind = "fixed", gains = {{ {gains} }} }}]\n' + step
    study, out = written(tmp_path, text), tmp_path / "out"
    deep = call("validate", study, "--deep", "--out", out, "--json")
    assert deep.exit_code == 0
    assert not out.exists()
    assert deep.stderr == ""
    no_run.undo()
    run = call("simulate", study, "--out", out, "--workers", "1", "--json")
    warned = [line.removeprefix("warning: ") for line in run.stderr.splitlines() if line.startswith("warning: ")]
    assert json.loads(deep.stdout)["warnings"] == warned
    assert any("unstable" in text for text in warned)
    assert any("does not answer" in text for text in warned)


def test_out_belongs_to_deep(tmp_path: Path) -> None:
    found = call("validate", written(tmp_path, RUN + ONE), "--out", tmp_path / "out")
    assert found.exit_code == 2
    assert "--deep" in found.stderr
