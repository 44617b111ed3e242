"""What a gain table costs: to read, to ask for gains, to analyse anew."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.timing import Row, figure, repeat, run_python, scaled
from tests.gain_tables import table
from vsgdesign.artifacts import read_table_file, write_table_file
from vsgdesign.runtime import table_schedule

ANALYSE = """
from bench.gain_table import RATIO, SCR, repeat, table
from vsgdesign.linear.stability.gain_table import nominal_margins
made = table(scr=SCR, x_over_r=RATIO)
print(*repeat(lambda: nominal_margins(made), 5))
"""

SCR, RATIO = np.geomspace(1.5, 20.0, 12), np.geomspace(0.3, 20.0, 10)


def gain_tables() -> list[Row]:
    """A table of 12 × 10 cells."""
    made = table(scr=SCR, x_over_r=RATIO)
    schedule = table_schedule(made)
    R_g, L_g = np.full(10_000, 1.3), np.full(10_000, 4e-3)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.json"
        write_table_file(made, path)
        read = repeat(lambda: read_table_file(path), 15)
    one = repeat(lambda: [schedule.gains_measured(1.3, 4e-3, 3e3, 500.0, 112.0) for _ in range(1000)], 7)
    many = repeat(lambda: schedule.gains_measured(R_g, L_g, 3e3, 500.0, 112.0), 15)
    # BLAS threads are fixed when NumPy is loaded: one, in a process of its own.
    threads: dict[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    margins = [float(value) for value in run_python(["-c", ANALYSE], threads).output.split()]
    return [
        Row("table", "12 × 10 cells read and verified", scaled(figure(read), 1e3), "ms", limit="JSON, SHA-256 twice"),
        Row(
            "table",
            "gains of one estimate and measurement",
            scaled(figure(one), 1e3),
            "us",
            limit="NumPy's overhead on scalars; in C some 30 operations",
        ),
        Row("table", "gains of 10,000 estimates, each", scaled(figure(many), 100.0), "us", limit="NumPy's passes"),
        Row(
            "table",
            "120 nodes analysed anew: margins and both steps",
            figure(margins),
            "s",
            limit="10,000 points a step, 500 frequencies; one core",
        ),
    ]


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"table": gain_tables}
