"""The suite's properties on a hundred times as many examples, drawn anew each time."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

from evidence._tables import leave

ROOT = Path(__file__).resolve().parents[1]
TIMES = 100


def main(folder: Path) -> None:
    """Runs every test file that draws examples, and prints whether its properties hold."""
    rows = []
    print("| tests | time (s) | hold |\n| --- | --- | --- |")
    for file in property_files():
        begin = time.perf_counter()
        command = [sys.executable, "-m", "pytest", str(file), "-n", "0", "-p", "no:cacheprovider"]
        environment = os.environ | {"VSGDESIGN_EXAMPLES": str(TIMES)}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        row = {"file": str(file), "seconds": time.perf_counter() - begin, "holds": done.returncode == 0}
        rows.append(row)
        print(f"| {file} | {row['seconds']:.0f} | {'yes' if row['holds'] else 'no'} |", flush=True)
        if not row["holds"]:
            print(done.stdout)
    leave(folder, "properties", rows)


def property_files() -> list[Path]:
    """The test files that draw examples, relative to the project's folder."""
    found = (ROOT / "tests").rglob("test_*.py")
    drawn = re.compile(r"^@given\(|^from tests\.examples import TIMES$", re.MULTILINE)
    return sorted(path.relative_to(ROOT) for path in found if drawn.search(path.read_text(encoding="utf-8")))
