"""The design of inner loops: gain sets a second, one design, and what another converter would buy."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from bench.timing import Figure, Row, figure, repeat, scaled
from vsgdesign.design.inner import GridBox, design_inner_loops, score_inner_loops, what_would_help
from vsgdesign.design.inner.grids import corners, lattice
from vsgdesign.design.inner.promises import bench_of, evaluate
from vsgdesign.design.inner.search import COARSE, POINTS_SEARCH, POPULATION, closed_form_starts
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.execution.executors import one_thread
from vsgdesign.study.parameters import study_from_text

GOAL = "this project's: a design within 10 s on one thread"
STUDY = """
base = "case:{}"
[simulation]
duration = "1 s"
P_ref = "0 W"
Q_ref = "0 var"
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""
CASES = {"lab_12kva_lcl": "LCL, delay of one sample", "hoang2025_5kva": "LC, no delay"}


def inner_loop_design() -> list[Row]:
    """On one thread, in this process."""
    rows = []
    for case, words in CASES.items():
        study = study_from_text(STUDY.format(case))
        c, f, box = study.converter, study.filter, GridBox()
        gains, omega_t = closed_form_starts(c, f, 10.0)[0]
        many = InnerLoopGains(*(np.full(POPULATION, float(value)) for value in gains))
        corner = np.full(POPULATION, omega_t)
        with one_thread():
            bench = bench_of(c, f, box.basis, lattice(box, *COARSE), corners(box), points=POINTS_SEARCH)

            def population(bench=bench, many=many, corner=corner) -> object:
                return evaluate(bench, many, corner)

            seconds = repeat(population)
        what = f"{words}: one gain set, all promises on 12 grids and 16 circuits that are off"
        rows.append(Row("inner", what, scaled(figure(seconds), 1e3 / POPULATION), "ms", limit="LAPACK's eigenvalues"))
        begin = time.perf_counter()
        design = design_inner_loops(c, f, box)
        taken: Figure = figure([time.perf_counter() - begin])
        what = f"{words}: a design, {design.evaluations} gain sets, check included"
        rows.append(Row("inner", what, taken, "s", 10.0, GOAL, 10.0, "eigenvalues"))

        def score(c=c, f=f, box=box, design=design) -> object:
            return score_inner_loops(c, f, design.gains, design.omega_t, box)

        rows.append(Row("inner", f"{words}: the map over 13 × 13 grids", scaled(figure(repeat(score)), 1e3), "ms"))
        begin = time.perf_counter()
        count = len(what_would_help(c, f, box, design.gains, design.omega_t))
        taken = figure([time.perf_counter() - begin])
        rows.append(
            Row("inner", f"{words}: what {count} other converters would buy", taken, "s", limit="shorter searches")
        )
    return rows


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"inner": inner_loop_design}
