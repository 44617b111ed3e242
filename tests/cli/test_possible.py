"""What a grid cannot carry is refused by every verb in the same words, before any work."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.small_studies import call, study_file

STUDY = """
base = "case:hoang2025_5kva"
power_loops = {{ structure = "angle_damped" }}
grid = {{ scr = 1.5, x_over_r = 2, scr_basis = "impedance" }}
simulation = {{ duration = "0.1 s", P_ref = "{P_ref}", Q_ref = "0 var" }}
specification = {{ settling_time = "1.3 s", overshoot = "5 %", scr = [2, 5], x_over_r = [1, 3], P = ["-2 kW", "0 kW"] }}
controllers = [{{ name = "a", kind = "scheduled"{more} }}]
"""
OUTAGE = '[[events]]\ntime = "0.02 s"\nV_g_pu = 0.3\n'
BACK = '[[events]]\ntime = "0.04 s"\nV_g_pu = 1\n'


@pytest.mark.parametrize(
    ("P_ref", "more", "events", "said"),
    [
        ("-1.5 kW", "", OUTAGE, "from 0.02 s on: no operating point"),
        # The table is neither designed nor missing: its closed form says what it will be.
        ("-1.5 kW", ', schedule = "table"', OUTAGE, "from 0.02 s on: no operating point"),
        ("-9.9 kW", "", "", "the start: no operating point"),
        ("-1.5 kW", "", OUTAGE + BACK, ""),
    ],
    ids=["outage", "table", "start", "possible"],
)
def test_validate_and_simulate_agree(P_ref: str, more: str, events: str, said: str, tmp_path: Path) -> None:
    study = study_file(tmp_path, STUDY.format(P_ref=P_ref, more=more) + events)
    checked, as_json = call("validate", study), call("validate", study, "--json")
    simulated = call("simulate", study, "--out", tmp_path / "out")
    assert {checked.exit_code, as_json.exit_code, simulated.exit_code} == {1 if said else 0}
    assert said in checked.output
    assert (tmp_path / "out").exists() == (not said)
    document = json.loads(as_json.output)
    assert document["valid"] == (not said)
    if said:
        assert checked.output.strip() == simulated.output.strip()
        assert document["faults"][0]["problem"] in " ".join(simulated.output.split())
