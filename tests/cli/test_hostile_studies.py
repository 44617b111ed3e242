"""Gains that are legal and make no sense: every verb answers without a raw warning, which is an error in tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.small_studies import call, study_file

STUDY = """
base = "case:{case}"
simulation = {{ duration = "0.1 s", P_ref = "{P_ref} W", Q_ref = "0 var" }}
stability = {{ scr = [3, 8], x_over_r = [1, 5] }}
grid = {{ scr_basis = "impedance", scr = 4.809, x_over_r = 1.371 }}
power_loops = {{ P_droop = 1 }}
[[controllers]]
name = "a"
kind = "fixed"
structure = "{structure}"
gains = {{ {gains} }}
"""
HOSTILE = {
    "no loop": ("lab_12kva_lcl", "12.5", "published", "K_ip = 0.000327913, D_p = 0, K_iq = 1.77387e-13, D_q = 0"),
    "growth": (
        "hoang2025_5kva",
        "1500",
        "angle_damped",
        "K_ip = 4e-6, D_p = 4.5e8, K_iq = 2.1e-15, D_q = 0.38, K_pq = 1e6, K_qp = 1e6, k_P = -1e6, k_Q = 2e-6",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("verb", ["simulate", "margins"])
def test_gains_without_sense_are_answered(verb: str, name: str, tmp_path: Path) -> None:
    case, P_ref, structure, gains = HOSTILE[name]
    study = study_file(tmp_path, STUDY.format(case=case, P_ref=P_ref, structure=structure, gains=gains))
    more = ("--out", tmp_path / "out", "--workers", "1") if verb == "simulate" else ()
    done = call(verb, study, *more)
    assert done.exit_code in (0, 1), done.output
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert "unstable" in done.output
