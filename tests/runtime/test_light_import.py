"""What ships needs NumPy alone: proven in a fresh interpreter."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("casadi", "torch", "scipy", "numba", "llvmlite", "matplotlib", "control", "click", "rich", "jinja2")


def imported(statement: str) -> set[str]:
    """Top-level modules that a statement leaves in sys.modules."""
    code = f"import sys; {statement}; print(*{{name.split('.')[0] for name in sys.modules}})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return set(run.stdout.split())


@pytest.mark.parametrize(
    "module",
    [
        "vsgdesign.runtime",
        "vsgdesign.equations.controller",
        "vsgdesign.frames",
        "vsgdesign.parameters",
        "vsgdesign.artifacts",
        "vsgdesign.metrics",
    ],
)
def test_light(module: str) -> None:
    names = imported(f"import {module}")
    assert "vsgdesign" in names
    assert names.isdisjoint(HEAVY)


def test_light_in_use() -> None:
    """Not only imported: asked for gains, it stays light."""
    call = (
        "ClosedFormSchedule(P=4500.0, Q=1000.0, V_g_rms=110.0, omega=314.16, settling_time=1.0, damping_ratio=1.0, "
        "droop_ratio=0.01).gains(3.63, 0.01155)"
    )
    names = imported(f"from vsgdesign.runtime import ClosedFormSchedule; {call}")
    assert "vsgdesign" in names
    assert names.isdisjoint(HEAVY)


def test_the_proof_can_fail() -> None:
    assert "casadi" in imported("import vsgdesign.model")


def test_the_top_package_imports_nothing() -> None:
    bare, with_package = imported("pass"), imported("import vsgdesign")
    assert with_package - bare <= {"vsgdesign", "__future__"}


def test_what_ships_reads_no_study_files() -> None:
    """The runtime's own rooms and nothing of what reads and checks TOML."""
    code = "import sys, vsgdesign.runtime; print(*{'.'.join(name.split('.')[:2]) for name in sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    rooms = {name.split(".")[1] for name in run.stdout.split() if name.startswith("vsgdesign.")}
    assert rooms == {"runtime", "identification", "equations", "frames", "errors"}
