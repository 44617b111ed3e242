"""What every benchmark shares: medians of repeats, CPU time of a process, rows of the table."""

from __future__ import annotations

import math
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from numpy._core._multiarray_umath import __cpu_features__  # type: ignore[attr-defined]

REPEATS = 7


@dataclass(frozen=True)
class Figure:
    """The median of several repeats, and their extremes: how far apart they are is what the machine adds."""

    value: float
    low: float
    high: float
    repeats: int


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    group: str
    """What ``--only`` selects by."""
    what: str
    """Model, step and length in simulated time."""
    figure: Figure
    unit: str
    """``RT`` (simulated seconds per second) is better when larger; every other unit when smaller."""
    anchor: float | None = None
    whose: str = ""
    """Whose figure the anchor is, with its model and step."""
    target: float | None = None
    limit: str = ""
    """What keeps our figure from being better."""

    @property
    def ratio(self) -> float | None:
        """How many times better than the anchor."""
        if self.anchor is None:
            return None
        if self.unit == "RT":
            return self.figure.value / self.anchor
        # No difference at all is better than any anchor.
        return self.anchor / self.figure.value if self.figure.value else math.inf

    @property
    def on_target(self) -> bool | None:
        """Whether the target is met; None without one."""
        if self.target is None:
            return None
        return self.figure.value >= self.target if self.unit == "RT" else self.figure.value <= self.target


def figure(values: Sequence[float]) -> Figure:
    """The median of what was measured."""
    return Figure(statistics.median(values), min(values), max(values), len(values))


def scaled(measured: Figure, factor: float) -> Figure:
    """The same figure in another unit."""
    return Figure(measured.value * factor, measured.low * factor, measured.high * factor, measured.repeats)


def real_time_factor(seconds: Sequence[float], simulated_s: float) -> Figure:
    """Simulated seconds per second."""
    return figure([simulated_s / value for value in seconds])


def repeat(function: Callable[[], object], repeats: int = REPEATS, warm_up: int = 1) -> list[float]:
    """Wall seconds of each call, after unmeasured ones."""
    for _ in range(warm_up):
        function()
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - begin)
    return seconds


@dataclass(frozen=True)
class ProcessCost:
    """What one process used."""

    cpu_s: float
    peak_mb: float
    output: str


def run_python(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> ProcessCost:
    """A fresh interpreter, measured by the kernel's own account of that one process.

    A small process starts it: Linux counts the parent's memory into the peak of a child that has not yet
    replaced its image, so the peak is the parent's where that is larger.
    """
    starter = (
        "import os, subprocess, sys\n"
        "process = subprocess.Popen([sys.executable, *sys.argv[1:]])\n"
        "_, status, usage = os.wait4(process.pid, 0)\n"
        "process.returncode = os.waitstatus_to_exitcode(status)\n"
        "sys.stderr.write(f'{process.returncode} {usage.ru_utime + usage.ru_stime} {usage.ru_maxrss}\\n')\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        run = subprocess.run(
            [sys.executable, "-S", "-c", starter, *arguments],
            capture_output=True,
            text=True,
            check=True,
            env=os.environ | dict(environment or {}) | {"OUT": folder},
        )
    code, cpu_s, peak = run.stderr.splitlines()[-1].split()
    if code != "0":
        raise RuntimeError(f"{arguments} ended with {code}: {run.stderr}")
    per_unit = 2**-20 if sys.platform == "darwin" else 2**-10
    return ProcessCost(float(cpu_s), float(peak) * per_unit, run.stdout)


def environment() -> dict[str, str]:
    """What the figures depend on. No host name and no path."""
    versions = {name: metadata.version(name) for name in ("vsgdesign", "numpy", "numba")}
    load = f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "nan"
    git = ["git", "show", "-s", "--abbrev=8", "--date=format:%Y-%m-%dT%H%M", "--format=%h %cd"]
    said = subprocess.run(git, cwd=Path(__file__).parent, capture_output=True, text=True, check=False).stdout
    commit, committed = said.split() or ("unknown", "unknown")
    sets = [name for name in ("AVX512F", "AVX2") if __cpu_features__.get(name)]
    return {
        "commit": commit,
        "committed": committed,
        "measured": time.strftime("%Y-%m-%d", time.gmtime()),
        "python": platform.python_version(),
        **versions,
        "machine": platform.machine(),
        "cores": str(os.cpu_count()),
        "vectors": next(iter(sets), "none"),
        "load before": load,
    }
