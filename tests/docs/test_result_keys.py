"""The keys of results.json that two pages list, against documents that the program writes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.verbs.pipeline.run import run_study
from vsgdesign.verbs.pipeline.verify import Asked, verify_study

DOCS = Path(__file__).resolve().parents[2] / "docs" / "how-to"
STUDY = """
base = "case:lab_12kva_lcl"
simulation = { duration = "0.5 s", P_ref = "4 kW", Q_ref = "0 var" }
controllers = [{ name = "damped", kind = "scheduled", structure = "angle_damped" }]
events = [{ time = "0.2 s", P_ref = "4.5 kW" }]

[verification]
scr = [4, 6]
x_over_r = [2, 4]
P = ["1 kW", "4 kW"]
Q = ["0 var", "1 kvar"]
"""
SOMETIMES = {"controllers.dc", "estimator", "passivity", "phase_jumps", "controllers.knowledge", "controllers.survival"}
"""Keys that the page names and that this study does not ask for."""


@pytest.fixture(scope="module")
def study() -> Study:
    return study_from_text(STUDY)


def listed(page: str, heading: str) -> set[str]:
    """Keys in the first column of the table under a heading; ``.key`` after ``a.b.key`` stands for ``a.b.key``."""
    section = (DOCS / page).read_text(encoding="utf-8").partition(f"\n{heading}\n")[2].partition("\n## ")[0]
    found = set()
    for cell in re.findall(r"^\| (`[^|]*) \|", section, re.M):
        before = ""
        for key in re.findall(r"`([\w.]+)`", cell):
            before = key if not key.startswith(".") else before.rpartition(".")[0] + key
            found.add(before.replace(".NAME", ""))
    return found


def test_keys_of_a_run(study: Study, tmp_path: Path) -> None:
    document = run_study(study, tmp_path / "out", report=False)
    own = {f"controllers.{key}" for key in document["controllers"]["damped"]}
    written = set(document) - {"controllers"} | own
    assert written ^ listed("results.md", "## results.json") == SOMETIMES


def test_keys_of_a_verification(study: Study, tmp_path: Path) -> None:
    document = verify_study(study, tmp_path / "out", Asked(runs=4, search=0, explorer=False), workers=1)
    named = {key.partition(".")[0] for key in listed("verify.md", "## Read results.json")}
    assert set(document) == named
