"""Whole runs from the command line: everything from the import to the page, with empty caches and with full ones."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from bench.timing import Row, figure, run_python

STUDIES = Path(__file__).resolve().parents[1] / "studies"

RUN = """
import os, sys
from vsgdesign.verbs.cli.program import main
main(["run", sys.argv[1], "--out", os.environ["OUT"] + "/run"])
"""
"""Its folder is thrown away with its process."""


def whole_runs() -> list[Row]:
    """What ``make paper`` runs, one after the other from empty caches, then again. Wall time on all cores."""
    rows = []
    with tempfile.TemporaryDirectory() as caches:
        environment = {"NUMBA_CACHE_DIR": f"{caches}/numba", "MPLCONFIGDIR": f"{caches}/matplotlib"}
        for caches_are, targets in (("empty", (35.0, None)), ("filled", (18.0, None))):
            total = 0.0
            for name, target in zip(("published", "field"), targets, strict=True):
                begin = time.perf_counter()
                run_python(["-c", RUN, str(STUDIES / name / "study.toml")], environment)
                seconds = time.perf_counter() - begin
                total += seconds
                what = f"vsgdesign run, studies/{name}, caches {caches_are} before"
                if caches_are == "empty" and name == "field":
                    what = f"vsgdesign run, studies/{name}, after the one above"
                rows.append(Row("run", what, figure([seconds]), "s", target=target, limit="Python, IPOPT, LLVM"))
            rows.append(
                Row(
                    "run",
                    f"make paper: both, caches {caches_are} before",
                    figure([total]),
                    "s",
                    target=60.0 if caches_are == "empty" else None,
                    limit="two cores",
                )
            )
    return rows


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"run": whole_runs}
