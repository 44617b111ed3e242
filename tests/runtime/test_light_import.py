"""What ships needs NumPy alone: proven in a fresh interpreter."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HEAVY = ("casadi", "torch", "scipy", "numba", "llvmlite", "matplotlib", "control", "click", "rich", "jinja2")


def imported(statement: str) -> set[str]:
    """Top-level modules that a statement leaves in sys.modules."""
    code = f"import sys; {statement}; print(*{{name.split('.')[0] for name in sys.modules}})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return set(run.stdout.splitlines()[-1].split())  # before it a verb may have printed


ROOMS = ("runtime", "equations.controller", "equations.frames", "study.parameters", "artifacts", "metrics")


def test_light() -> None:
    """The rooms together, and not only imported: asked for gains, they stay light."""
    call = (
        "ClosedFormSchedule(P=4500.0, Q=1000.0, V_g_rms=110.0, omega=314.16, settling_time=1.0, damping_ratio=1.0, "
        "droop_ratio=0.01).gains(3.63, 0.01155)"
    )
    rooms = ", ".join(f"vsgdesign.{room}" for room in ROOMS)
    names = imported(f"import {rooms}; from vsgdesign.runtime import ClosedFormSchedule; {call}")
    assert "vsgdesign" in names
    assert names.isdisjoint(HEAVY)


STUDY = """
base = "case:lab_12kva_lcl"
[simulation]
duration = "10 ms"
P_ref = "4 kW"
Q_ref = "0 var"
[[controllers]]
name = "published"
kind = "scheduled"
"""


def test_verbs_load_only_what_they_need(tmp_path: Path) -> None:
    """Help, a simulation and grid-code tests need no library of design and analysis: these take seconds to load."""
    study = tmp_path / "study.toml"
    study.write_text(STUDY)
    verbs = ["--help"], ["simulate", str(study), "--out", str(tmp_path / "out")]
    names = imported(
        "from vsgdesign.verbs.cli.program import main; "
        f"[main(verb, standalone_mode=False) for verb in {verbs}]; import vsgdesign.verbs.pipeline.comply"
    )
    assert (tmp_path / "out" / "results.json").exists()
    assert {"casadi", "llvmlite"} <= names  # it was simulated
    assert names.isdisjoint({"numba", "torch", "scipy", "control", "cvxpy", "matplotlib"})


def test_the_proof_can_fail() -> None:
    assert "casadi" in imported("import vsgdesign.linear.model")


def test_what_ships_reads_no_study_files() -> None:
    """The runtime's own rooms and nothing of what reads and checks TOML."""
    code = "import sys, vsgdesign.runtime; print(*{'.'.join(name.split('.')[:2]) for name in sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    rooms = {name.split(".")[1] for name in run.stdout.split() if name.startswith("vsgdesign.")}
    assert rooms == {"runtime", "identification", "equations", "errors"}
