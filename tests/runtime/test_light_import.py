"""What ships needs NumPy alone: proven in a fresh interpreter."""

from __future__ import annotations

import subprocess
import sys

HEAVY = ("casadi", "torch", "scipy", "numba", "llvmlite", "matplotlib", "control", "click", "rich", "jinja2")


def imported(statement: str) -> set[str]:
    """Top-level modules that a statement leaves in sys.modules."""
    code = f"import sys; {statement}; print(*{{name.split('.')[0] for name in sys.modules}})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return set(run.stdout.split())


ROOMS = ("runtime", "equations.controller", "frames", "parameters", "artifacts", "metrics")


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


def test_the_process_of_a_run_loads_what_it_needs_itself() -> None:
    """It simulates, draws and writes. Its workers design, train and certify with libraries that take long to load."""
    rooms = ("pipeline.run", "pipeline.verify", "design.table", "report.scenario.page", "report.scenario.files")
    names = imported(f"import {', '.join(f'vsgdesign.{room}' for room in rooms)}")
    assert {"casadi", "matplotlib"} <= names
    assert names.isdisjoint({"numba", "torch", "scipy", "control", "cvxpy"})


def test_the_proof_can_fail() -> None:
    assert "casadi" in imported("import vsgdesign.model")


def test_what_ships_reads_no_study_files() -> None:
    """The runtime's own rooms and nothing of what reads and checks TOML."""
    code = "import sys, vsgdesign.runtime; print(*{'.'.join(name.split('.')[:2]) for name in sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    rooms = {name.split(".")[1] for name in run.stdout.split() if name.startswith("vsgdesign.")}
    assert rooms == {"runtime", "identification", "equations", "frames", "errors"}
