"""What is paid before and beside the work: start, import, compilation, memory."""

from __future__ import annotations

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
total = 0.0
for bridge in ("averaged", "pwm"):
    seconds = []
    for _ in range(2):
        begin = time.perf_counter()
        simulate(study, changes, bridge=bridge)
        seconds.append(time.perf_counter() - begin)
    total += seconds[0] - seconds[1]
print(total)
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
    """The EMT loops of both bridges, which every process compiles anew."""
    code = COMPILE.format(path=PUBLISHED)
    seconds = [float(run_python(["-c", code]).output) for _ in range(5)]
    return [
        Row(
            "compilation", "EMT loops of both bridges", figure(seconds), "s", target=0.5, limit="LLVM; Python's reading"
        )
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
