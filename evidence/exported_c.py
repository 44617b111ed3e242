"""The exported controller against Python while its limiter acts, and with any input at all.

C is compared with Python over one step from 100,000 random states in and outside of all limits, for every limiter and
both precisions. Then a million samples go through the controller, its retune and its scheduler, with NaN, infinite,
huge, zero and denormal numbers among them, under the sanitizers for addresses and undefined behaviour. The test suite
has samples of both. It needs gcc.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from tests.export.exchange import written
from tests.export.fuzzing import build_control_fuzz, run_control_fuzz
from tests.export.random_states import compare_steps
from vsgdesign.equations.limiters import LIMITERS
from vsgdesign.export import compile_c, export_c_files
from vsgdesign.export.footprint import COMPILER, measure_footprint
from vsgdesign.runtime import load_scheduler

STATES, CALLS, SEED = 100_000, 1_000_000, 1


def main(folder: Path) -> None:
    """Prints a table and writes its rows to exported_c.json. Raises RuntimeError if the fuzzing finds something."""
    rows: list[dict[str, Any]] = []
    print(
        f"| limiter | precision | worst of {STATES:,} steps | limited | decided otherwise | {CALLS:,} fuzzed samples |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory(prefix="vsg") as name:
        place = Path(name)
        table_file, _ = written(place)
        scheduler = load_scheduler(table_file)
        for limiter, found in LIMITERS.items():
            exported = export_c_files(table_file, place / limiter, limiter=limiter).folder
            for double in (True, False):
                far = compare_steps(scheduler, found, compile_c(exported, double=double), STATES, SEED)
                code, said = run_control_fuzz(
                    build_control_fuzz(exported, place, scheduler, found, double=double), CALLS, SEED
                )
                if code != 0:
                    raise RuntimeError(f"fuzzing of {limiter}: {said}")
                precision = "double" if double else "single"
                print(
                    f"| {limiter} | {precision} | {far.worst:.1e} of scale | {100.0 * far.limited:.0f} % | "
                    f"{100.0 * far.decided:.3g} % | {said.strip()} |",
                    flush=True,
                )
                rows.append({"limiter": limiter, "precision": precision, **vars(far), "fuzzed": said.strip()})
            if shutil.which(COMPILER) is not None:
                flash, ram, stack = measure_footprint(exported).control
                print(f"| {limiter} | Cortex-M4F | flash {flash} B, RAM {ram} B, stack {stack} B | | | |", flush=True)
                rows.append({"limiter": limiter, "flash": flash, "ram": ram, "stack": stack})
    (folder / "exported_c.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
