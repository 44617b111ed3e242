"""What is paid before and beside the work: start, import, compilation, memory."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from bench.timing import Row, figure, run_python

PUBLISHED = str(Path(__file__).resolve().parents[1] / "studies" / "published_averaged" / "study.toml")

COMPILE = """
import time
from vsgdesign.parameters import load_study
from vsgdesign.simulation import build_timeline, gain_changes, simulate
from dataclasses import replace
study = load_study({path!r})
study = replace(study, simulation=replace(study.simulation, duration=0.01), events=())
changes = gain_changes(study, study.controllers[0], build_timeline(study))
seconds = []
for _ in range(2):
    begin = time.perf_counter()
    simulate(study, changes)
    seconds.append(time.perf_counter() - begin)
print(seconds[0] - seconds[1])
"""


def start() -> list[Row]:
    """CPU time of the smallest uses."""
    help_ = [run_python(["-m", "vsgdesign.cli.program", "--help"]).cpu_s for _ in range(9)][2:]
    bare = figure([run_python(["-c", "import numpy"]).cpu_s for _ in range(9)][2:])
    shipped = [run_python(["-c", "import vsgdesign.runtime"]).cpu_s for _ in range(9)][2:]
    beyond = figure([max(value - bare.value, 0.0) * 1e3 for value in shipped])
    return [
        Row("start", "vsgdesign --help, CPU time", figure(help_), "s", target=0.2, limit="Python and click"),
        Row(
            "start",
            "import vsgdesign.runtime, CPU time beyond NumPy's",
            beyond,
            "ms",
            limit=f"dataclasses; NumPy itself takes {1e3 * bare.value:.0f} ms",
        ),
    ]


def compilation() -> list[Row]:
    """The EMT loop: from nothing, and from the disk cache."""
    code = COMPILE.format(path=PUBLISHED)
    cold, cached = [], []
    for _ in range(5):
        with tempfile.TemporaryDirectory() as folder:
            environment = {"NUMBA_CACHE_DIR": folder}
            cold.append(float(run_python(["-c", code], environment).output))
            cached.append(float(run_python(["-c", code], environment).output))
    return [
        Row("compilation", "EMT loop compiled, empty cache", figure(cold), "s", limit="LLVM; once a source change"),
        Row("compilation", "EMT loop loaded from the disk cache", figure(cached), "s", limit="Numba's cache index"),
    ]


def memory() -> list[Row]:
    """Peak memory of whole processes."""
    command = [
        "-c",
        "import os, sys; from vsgdesign.cli.program import main; main(sys.argv[1:] + [os.environ['OUT'] + '/out'])",
    ]
    code = "import vsgdesign.simulation"
    base = figure([run_python(["-c", code]).peak_mb for _ in range(5)])
    whole = figure([run_python([*command, "simulate", PUBLISHED, "--json", "--out"]).peak_mb for _ in range(5)])
    return [
        Row(
            "memory",
            "vsgdesign simulate, published, 2 × 60 s logged at 200 us, peak",
            whole,
            "MB",
            target=500.0,
            limit=f"13 logged columns and 18 series of 3e5 doubles; imports alone {base.value:.0f} MB",
        ),
    ]


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"start": start, "compilation": compilation, "memory": memory}
