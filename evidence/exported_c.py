"""The exported controller against Python while its limiter acts, and with any input at all.

C is compared with Python over one step from 100,000 random states in and outside of all limits, for every limiter and
both precisions. Then a million samples go through the controller, its retune and its scheduler, with NaN, infinite,
huge, zero and denormal numbers among them, under the sanitizers for addresses and undefined behaviour. The test suite
has samples of both. Before them, 100,000 random updates of the scheduler, in which every guard acts, are compared in
Python, in C of both precisions and in machine code. It needs gcc.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from evidence._tables import leave, table
from tests.export.exchange import compare, random_calls, written
from tests.export.footprint import COMPILER, measure_footprint
from tests.export.fuzzing import build_control_fuzz, run_control_fuzz
from tests.export.random_states import compare_steps
from tests.runtime.test_many import Inputs as RandomUpdates
from vsgdesign.equations.limiters import LIMITERS
from vsgdesign.export import compile_c, export_c_files
from vsgdesign.runtime import ManySchedulers, Scheduler, load_scheduler
from vsgdesign.simulation.compiled_schedulers import CompiledSchedulers

STATES, CALLS, SEED = 100_000, 1_000_000, 1
LANES = 100


def _updates(scheduler: Scheduler, folder: Path) -> list[dict[str, Any]]:
    """Random updates of the scheduler in Python, in C and in machine code. Prints a table and returns its rows."""
    rows: list[dict[str, Any]] = []
    calls = random_calls(scheduler, STATES, SEED)
    for double in (True, False):
        found = compare(scheduler, compile_c(folder, double=double), calls)
        rows.append({"updates": found.calls, "of": f"C, {'double' if double else 'single'} precision", **vars(found)})
    lookup, settings = scheduler.lookup, scheduler.settings
    compiled = ManySchedulers(lookup, settings, LANES, CompiledSchedulers(lookup, settings))
    shipped = ManySchedulers(lookup, settings, LANES)
    inputs, statuses, gains, place = RandomUpdates(SEED, LANES), 0, 0.0, 0.0
    for _ in range(STATES // LANES):
        given = inputs.next()
        pairs = np.array([compiled.update(**given), shipped.update(**given)])
        a, b = compiled.answers, shipped.answers
        if a is None or b is None:
            raise RuntimeError("An update gave no answer.")
        statuses += int(((a.status != b.status) | (a.reason != b.reason)).sum())
        gains = max(gains, float(np.max(np.abs(pairs[0] - pairs[1]) / np.maximum(np.abs(pairs[1]), 1e-9))))
        ratios = np.array([a.scr / b.scr, a.r_over_x / b.r_over_x])
        place = max(place, float(np.max(np.abs(ratios - 1.0))))
    rows.append({"updates": STATES, "of": "machine code", "statuses": statuses, "gains": gains, "place": place})
    cells = ([f"{r['updates']:,}", r["of"], f"{r['statuses']}", f"{r['gains']:.1e}", f"{r['place']:.1e}"] for r in rows)
    lines = table(("updates", "against Python", "decided otherwise", "gains", "place"), cells)
    print("\n".join(lines), end="\n\n")
    return rows


def main(folder: Path) -> None:
    """Prints a table and writes its rows to exported_c.json. Raises RuntimeError if the fuzzing finds something."""
    rows: list[dict[str, Any]] = []
    head = ("limiter", "precision", f"worst of {STATES:,} steps", "limited", "decided otherwise")
    print("\n".join(table((*head, f"{CALLS:,} fuzzed samples"), ())))
    with tempfile.TemporaryDirectory(prefix="vsg") as name:
        place = Path(name)
        table_file, _ = written(place)
        scheduler = load_scheduler(table_file)
        rows += _updates(scheduler, export_c_files(table_file, place / "scheduler").folder)
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
    leave(folder, "exported_c", rows)
