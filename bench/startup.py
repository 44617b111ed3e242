"""What is paid before and beside the work: start, import, compilation, memory."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from bench.timing import Row, figure, run_python

PUBLISHED = str(Path(__file__).resolve().parents[1] / "studies" / "published_averaged" / "study.toml")

COMPILE = """
import time
from vsgdesign.study.parameters import load_study
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

DESIGNS = """
import time
from vsgdesign.design import kernels
begin = time.process_time()
for sample in (kernels._taylor_sample, kernels._doubling_sample, kernels._step_sample, kernels._disk_sample):
    kernels._loop(sample, 5)
print(time.process_time() - begin)
"""

BOXES = """
import time
from vsgdesign.certificate.box_check import compile_ahead
begin = time.process_time()
compile_ahead()
print(time.process_time() - begin)
"""


def start() -> list[Row]:
    """CPU time of the smallest uses."""
    help_ = [run_python(["-m", "vsgdesign.verbs.cli.program", "--help"]).cpu_s for _ in range(9)][2:]
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
    """The EMT loops of both bridges and the figures of designs, which every process compiles anew; and what Numba keeps
    on disk."""
    code = COMPILE.format(path=PUBLISHED)
    seconds = [float(run_python(["-c", code]).output) for _ in range(5)]
    designs = [float(run_python(["-c", DESIGNS]).output) for _ in range(5)]
    empty, cached = [], []
    for _ in range(3):
        with tempfile.TemporaryDirectory() as folder:
            for found in (empty, cached):
                found.append(float(run_python(["-c", BOXES], {"NUMBA_CACHE_DIR": folder}).output))
    limit = "LLVM, which optimises each function again in each that calls it"
    return [
        Row(
            "compilation", "EMT loops of both bridges", figure(seconds), "s", target=0.5, limit="LLVM; Python's reading"
        ),
        Row("compilation", "figures of designs, five states", figure(designs), "s", limit="LLVM; tracing"),
        Row("compilation", "a certificate's boxes, empty cache", figure(empty), "s", limit=limit),
        Row("compilation", "a certificate's boxes from the disk cache", figure(cached), "s", limit="Numba's index"),
    ]


def memory() -> list[Row]:
    """Peak memory of whole processes."""
    command = [
        "-c",
        "import os, sys; from vsgdesign.verbs.cli.program import main; "
        "main(sys.argv[1:] + [os.environ['OUT'] + '/out'])",
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
