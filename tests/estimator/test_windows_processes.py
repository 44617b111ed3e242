"""A killed call leaves no process behind, and what it had finished is used."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from vsgdesign.estimator.data_set import read_data_set

SCRIPT = """
import os, sys
from dataclasses import replace
from tests.simulation.studies import lc_study
from vsgdesign.estimator.recipes import CONTINUOUS
from vsgdesign.estimator.specification import WINDOW_NETWORK, generate

def killed(what, share):
    if share > 0.0:
        os._exit(9)

if __name__ == "__main__":
    recipe = replace(CONTINUOUS, bridge="averaged", scenarios=41, before=1, after=0)
    out, kill = sys.argv[1], sys.argv[2] == "kill"
    workers, progress = (2, killed) if kill else (1, lambda what, share: print(share))
    generate(WINDOW_NETWORK, lc_study("1 s"), recipe, 0, out=out, workers=workers, progress=progress)
"""


def test_workers_end_with_the_one_that_waits_for_them(tmp_path: Path) -> None:
    """Workers hold its standard output: it ends only when they have ended."""
    script, out = tmp_path / "script.py", tmp_path / "w.npz"
    script.write_text(SCRIPT, encoding="utf-8")
    root = Path(__file__).resolve().parents[2]
    command = [sys.executable, "-P", str(script), str(out)]
    environment = os.environ | {"PYTHONPATH": str(root)}
    arguments = {"capture_output": True, "text": True, "timeout": 60.0, "env": environment, "cwd": root}
    killed = subprocess.run([*command, "kill"], **arguments)  # type: ignore[call-overload]
    assert killed.returncode == 9, killed.stderr
    assert not out.exists()
    resumed = subprocess.run([*command, "go on"], **arguments)  # type: ignore[call-overload]
    assert resumed.returncode == 0, resumed.stderr
    assert resumed.stdout.split()[0] != "0.0"
    assert len(read_data_set(out)) == 41
