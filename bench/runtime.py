"""What the runtime costs in Python and in C, its size, and the long comparisons and fuzzing that tests only sample."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.timing import Figure, Row, figure, repeat, run_python, scaled
from tests.export.exchange import KINDS, compare, exported, random_calls, windows, written
from tests.export.footprint import COMPILER, measure_footprint
from tests.export.fuzzing import build_fuzz, distance_from_table, run_fuzz
from vsgdesign.artifacts import read_table_file
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.export import compile_c
from vsgdesign.export.compiled import run_compiler
from vsgdesign.export.known_answers import gain_sizes
from vsgdesign.runtime import Scheduler, load_scheduler
from vsgdesign.simulation import build_timeline, simulate
from vsgdesign.simulation.shipped import ShippedScheduler, true_grid
from vsgdesign.study.parameters import load_study

CALLS, WINDOWS, FUZZED = 100_000, 20_000, 1_000_000
FIT = {"sample_interval": 200e-6}
IMPORT = """
import time, numpy
begin = time.process_time()
import vsgdesign.runtime
print(time.process_time() - begin)
"""


def in_python(scheduler: Scheduler) -> list[Row]:
    """One scheduling step, and the import."""
    v, i = 150.0 * np.sin(0.0628 * np.arange(100)), 20.0 * np.cos(0.0628 * np.arange(100))
    network = repeat(lambda: [scheduler.update(v, i, 3e3, 500.0, 112.0) for _ in range(1000)], 15)
    table = repeat(lambda: [scheduler.update_estimate(1.3, 4e-3, 3e3, 500.0, 112.0) for _ in range(1000)], 15)
    load = [float(run_python(["-c", IMPORT]).output) for _ in range(7)]
    return [
        Row("runtime", "import beyond NumPy", scaled(figure(load), 1e3), "CPU-ms", target=30.0, limit="modules"),
        Row(
            "runtime",
            "one step in Python: guards and table",
            scaled(figure(table), 1e3),
            "us",
            limit="Python's own overhead a call",
        ),
        Row(
            "runtime",
            "one step in Python: network, guards, table",
            scaled(figure(network), 1e3),
            "us",
            13.0,
            "NumPy, network and table without guards",
            40.0,
            "of which the network is a third",
        ),
    ]


def in_c(folder: Path) -> list[Row]:
    """The same in C, single precision, plain -O2."""
    program = folder.parent / "timing"
    source = Path(__file__).resolve().parents[1] / "tests" / "export" / "timing.c"
    run_compiler(
        ["gcc", "-std=c99", "-O2", f"-I{folder}", str(source), str(folder / "vsg_data.c"), "-o", str(program), "-lm"]
    )
    said = [subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout for _ in range(7)]
    runs = np.array([[float(line) for line in text.split()] for text in said])
    lookup, estimate, window = (figure(column.tolist()) for column in runs.T)
    return [
        Row("runtime", "C, table lookup alone: six columns", lookup, "ns", target=20.0, limit="two divisions"),
        Row("runtime", "C, one step: guards and table", estimate, "ns", limit="ten divisions, one after another"),
        Row(
            "runtime",
            "C, one step: 200–8–2 network, guards, table",
            scaled(window, 1e-3),
            "us",
            1.5,
            "C float32 -O2; 0.46 us with four accumulators",
            0.6,
            "1,600 products, eight tanh",
        ),
    ]


def size(folder: Path) -> list[Row]:
    """Flash, RAM and stack on a Cortex-M4F."""
    if shutil.which(COMPILER) is None:
        return []
    found = measure_footprint(folder)

    def row(what: str, value: int, target: float | None = None, limit: str = "") -> Row:
        return Row("runtime", what, Figure(value, value, value, 1), "bytes", target=target, limit=limit)

    return [
        row(
            "Cortex-M4F -Os, flash: 200–8–2, 12 × 10 cells, all code",
            found.flash,
            18_432.0,
            "weights 6.5 kB, table 2.9",
        ),
        row("Cortex-M4F, RAM of scheduler and power loops, with stack", found.ram + found.stack, 1536.0),
        row("Cortex-M4F, window buffer", found.window),
        row(
            "Cortex-M4F, flash of the whole controller's step", found.control[0], 1280.0, "seven compensated sums: 130"
        ),
        row("Cortex-M4F, stack of the whole controller's step", found.control[2], 160.0),
    ]


def against_python() -> list[Row]:
    """C against Python over CALLS calls of every kind; worst of all."""
    worst: dict[bool, list[float]] = {True: [], False: []}
    statuses = 0
    for structure, law in KINDS:
        with tempfile.TemporaryDirectory() as name:
            table_file, _ = written(Path(name), structure, law)
            folder, scheduler = exported(Path(name), structure, law), load_scheduler(table_file)
            calls = random_calls(scheduler, CALLS, seed=1)
            for double in worst:
                difference = compare(scheduler, compile_c(folder, double=double), calls)
                worst[double].append(difference.gains)
                statuses += difference.statuses
    count = f"{CALLS:,} calls × {len(KINDS)} kinds"
    return [
        Row(
            "runtime",
            f"C double against Python, {count}",
            figure([max(worst[True])]),
            "rel.",
            4e-15,
            "motulator-export, double",
            1e-12,
            "rounding",
        ),
        Row(
            "runtime",
            f"C single against Python, {count}",
            figure([max(worst[False])]),
            "rel.",
            target=2e-6,
            limit="rounding, gains near the limit of the grid",
        ),
        Row("runtime", "… statuses that differ, both", figure([float(statuses)]), "calls", target=0.0),
    ]


def through_the_network(folder: Path, scheduler: Scheduler) -> list[Row]:
    """Windows to gains, single precision."""
    compiled, worst, statuses = compile_c(folder), 0.0, 0
    for k, (v, i) in enumerate(windows(WINDOWS, seed=9)):
        wanted = scheduler.update(v, i, 3e3, 500.0, 112.0, 20_000 * k)
        got = compiled.update(v, i, 3e3, 500.0, 112.0, 20_000 * k)
        statuses += wanted[1:3] != got[1:3]
        sizes = gain_sizes(wanted.gains)
        worst = max(worst, *(abs(a - b) / s for a, b, s in zip(wanted.gains, got.gains, sizes, strict=True) if s))
    return [
        Row(
            "runtime",
            f"C single against Python, {WINDOWS:,} windows through the network",
            figure([worst]),
            "rel.",
            target=2e-6,
            limit=f"{statuses} statuses differ",
        ),
    ]


def in_the_loop() -> list[Row]:
    """The published 60 s scenario with C in the loop against Python in the loop, every logged sample."""
    study = load_study(Path(__file__).resolve().parents[1] / "studies" / "published_averaged" / "study.toml")
    truth, rows = true_grid(build_timeline(study)), []
    base = base_of(study, "reactance")
    with tempfile.TemporaryDirectory() as name:
        table_file, _ = written(Path(name), base=base)
        folder = exported(Path(name), base=base)
        scheduler = load_scheduler(table_file)
        scheduler.start(study.grid.R_g, study.grid.L_g)
        python = ShippedScheduler(scheduler, estimate=truth)
        wanted = simulate(study, python).log
        for double in (True, False):
            compiled = compile_c(folder, double=double)
            compiled.start(study.grid.R_g, study.grid.L_g)
            c = ShippedScheduler(compiled, estimate=truth)
            error = np.abs(simulate(study, c).log - wanted) / np.abs(wanted).max(axis=0)
            same = sum(a[1:3] == b[1:3] for a, b in zip(python.answers, c.answers, strict=True))
            what = f"60 s published, C {'double' if double else 'single'} in the loop: worst sample over peak"
            rows.append(
                Row(
                    "runtime",
                    what,
                    figure([float(error.max())]),
                    "rel.",
                    target=1e-12 if double else 2e-6,
                    limit=f"{same} of {len(c.answers)} statuses alike",
                )
            )
    return rows


def fuzzed(folder: Path, table_file: Path) -> list[Row]:
    """FUZZED calls with sanitizers in each precision."""
    rows = []
    for double in (True, False):
        code, said, answers = run_fuzz(build_fuzz(folder, folder.parent, double=double), FUZZED, seed=1)
        if code != 0:
            raise RuntimeError(f"fuzzing: {said}")
        distance = distance_from_table(read_table_file(table_file), answers)
        what = f"{FUZZED:,} fuzzed calls {'double' if double else 'single'}: gains from those of the box"
        rows.append(
            Row("runtime", what, figure([distance]), "rel.", target=1e-12 if double else 2e-6, limit=said.strip())
        )
    return rows


def runtime() -> list[Row]:
    """All of it; what needs a compiler that is not installed is left out."""
    with tempfile.TemporaryDirectory() as name:
        tables = written(Path(name))
        rows, scheduler = in_python(load_scheduler(*tables, fit=FIT)), load_scheduler(*tables, fit=FIT)
        if shutil.which("gcc") is None:
            return rows
        folder = exported(Path(name))
        return (
            rows
            + in_c(folder)
            + size(folder)
            + against_python()
            + through_the_network(folder, scheduler)
            + in_the_loop()
            + fuzzed(folder, tables[0])
        )


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"runtime": runtime}
