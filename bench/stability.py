"""Small-signal speed: maps, margins, modes and admittance, each on one core beside what others take for the same.

BLAS threads are fixed when NumPy is loaded, so all of it runs in a process of its own: ``python -m bench.stability``.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.timing import Figure, Row, figure, repeat, run_python, scaled
from vsgdesign.linear.stability.loops import ReducedLoop, output_admittance
from vsgdesign.linear.stability.maps import (
    CellSet,
    cells_under,
    full_order_cells,
    grid_arrays,
    margin_map,
    reduced_cells,
)
from vsgdesign.linear.stability.margins import frequency_grid
from vsgdesign.metrics.margins import disk_margin_steps, refined
from vsgdesign.metrics.modes import participation_factors
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters import Study, study_from_text

ONE_THREAD: dict[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

STUDY = """
base = "case:{case}"
[power_loops]
tau_Q = "20 ms"
[simulation]
duration = "1 s"
log_interval = "10 ms"
P_ref = "0 W"
Q_ref = "0 var"
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""

SCR, RATIO = np.geomspace(1.5, 25.0, 40), np.geomspace(0.4, 10.0, 30)
SUBSET = 12
"""Cells that python-control analyses; its time for the map is theirs times 1200/12."""


def study(case: str) -> Study:
    """A packaged case with a filter on Q: four states in the reduced model."""
    return study_from_text(STUDY.format(case=case))


def whole_map(case: str, model: str) -> Callable[[], object]:
    """One map of 40 × 30 cells at one operating point."""
    s = study(case)
    law, P = gain_law(s, s.controllers[0]), 0.4 * s.converter.S_rated
    return lambda: margin_map(s, law, SCR.tolist(), RATIO.tolist(), (P,), (0.0,), model)


def by_control() -> float:
    """Seconds that python-control and slycot take for the reduced map: modes, disk margins at both ends, loop margins.

    Measured on cells spread over the map. The matrices are given; S is not refined between its 500 frequencies.
    """
    import control

    s = study("hoang2025_5kva")
    R_g, L_g = grid_arrays(s, SCR, RATIO)
    law = gain_law(s, s.controllers[0])
    model = reduced_cells(s, cells_under(s, law, R_g, L_g, 0.4 * s.converter.S_rated, 0.0))
    omega = frequency_grid()
    chosen = np.linspace(0, len(model.A) - 1, SUBSET).astype(int)
    begin = time.perf_counter()
    for k in chosen:
        A_K, B_K, C_K, J = (m[k] for m in (model.A_K, model.B_K, model.C_K, model.J))
        control.StateSpace(model.A[k], model.B[k], model.C[k], model.D[k]).poles()
        for b, c in ((B_K, J @ C_K), (B_K @ J, C_K)):
            control.disk_margins(control.ss(A_K, b, -c, np.zeros((2, 2))), omega, skew=0.0)
        for loop in (0, 1):
            other = 1 - loop
            closed = A_K + np.outer(B_K[:, other], (J @ C_K)[other])
            control.stability_margins(control.ss(closed, B_K[:, [loop]], -(J @ C_K)[[loop]], 0.0))
    return (time.perf_counter() - begin) * SCR.size * RATIO.size / SUBSET


def one_disk_margin() -> tuple[Callable[[], object], Callable[[], object]]:
    """One loop, 500 frequencies: ours from state space to the refined minimum, and python-control's."""
    import control

    s = study("hoang2025_5kva")
    model = reduced_cells(s, one_cell(s))
    omega = frequency_grid()
    A_K, b, c = model.A_K[0], model.B_K[0], model.J[0] @ model.C_K[0]

    def ours() -> object:
        loop = ReducedLoop(model)
        return refined([disk_margin_steps(loop.on(omega), omega, loop.at)])

    return ours, lambda: control.disk_margins(control.ss(A_K, b, -c, np.zeros((2, 2))), omega, skew=0.0)


def one_cell(s: Study) -> CellSet:
    """The study's own grid."""
    g = s.grid
    return cells_under(s, gain_law(s, s.controllers[0]), g.R_g, g.L_g, 0.4 * s.converter.S_rated, 0.0)


def measured() -> dict[str, Any]:
    """Every timing of this file, in seconds."""
    ours, controls = one_disk_margin()
    lab = study("lab_12kva_lcl")
    model = full_order_cells(lab, one_cell(lab))
    matrix = np.random.default_rng(1).standard_normal((20, 20))
    ten = 2.0 * np.pi * np.array([10.0])
    many = 2.0 * np.pi * np.geomspace(1.0, 5e3, 500)

    def times(function: Callable[[], object], count: int) -> list[float]:
        def several() -> None:
            for _ in range(count):
                function()

        return [seconds / count for seconds in repeat(several)]

    return {
        "reduced map": repeat(whole_map("hoang2025_5kva", "reduced")),
        "reduced map by control": [by_control() for _ in range(3)],
        "full-order map": repeat(whole_map("lab_12kva_lcl", "full_order"), 3),
        "disk margin": times(ours, 20),
        "disk margin by control": repeat(controls, 5),
        "modes": times(lambda: participation_factors(matrix), 200),
        "admittance": times(lambda: output_admittance(model, 0, ten), 100),
        "admittances": times(lambda: output_admittance(model, 0, many), 3),
    }


def stability() -> list[Row]:
    """Everything, measured in a process with one BLAS thread."""
    results = json.loads(run_python(["-m", "bench.stability"], ONE_THREAD).output)
    f: dict[str, Figure] = {name: figure(values) for name, values in results.items()}
    control = f"python-control + slycot here, {SUBSET} of 1200 cells, no refinement"
    control_map, control_disk = f["reduced map by control"].value, f["disk margin by control"].value
    cells = "40 × 30 grids, modes, margins at 500 frequencies"
    disk = scaled(f["disk margin"], 1e3)
    return [
        Row("stability", f"coupled map, 4 states, {cells}", f["reduced map"], "s", control_map, control, 3.0,
            "1.2e6 systems of order 4 solved; peaks and crossings refined"),
        Row("stability", f"coupled map, 4 states, {cells}", f["reduced map"], "s", 100.0,
            "python-control + slycot, elsewhere", 3.0, "the same"),
        Row("stability", f"full-order map, 16 states, {cells}", f["full-order map"], "s", target=30.0,
            limit="1200 steady states by root finding, S as a sum over modes"),
        Row("stability", "one disk margin, 500 frequencies, refined", disk, "ms", 1e3 * control_disk,
            "python-control + slycot here, not refined", limit="NumPy calls of the refinement"),
        Row("stability", "one disk margin, 500 frequencies, refined", disk, "ms", 80.0,
            "python-control + slycot, elsewhere", limit="the same"),
        Row("stability", "eigenvalues and participation, 20 states", scaled(f["modes"], 1e3), "ms", 0.11,
            "DPsim 1.4, best of 0.11 to 0.14", limit="LAPACK geev"),
        Row("stability", "output admittance, LCL, one frequency", scaled(f["admittance"], 1e3), "ms", 6400.0,
            "motulator-impedance, CPU time, simulated", limit="NumPy calls"),
        Row("stability", "output admittance, LCL, 500 frequencies", scaled(f["admittances"], 1e3), "ms",
            limit="500 systems of order 16"),
    ]  # fmt: skip


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"stability": stability}

if __name__ == "__main__":
    if any(os.environ.get(name) != "1" for name in ONE_THREAD):
        sys.exit("set " + " ".join(f"{name}=1" for name in ONE_THREAD) + ", or run python -m bench --only stability")
    json.dump(measured(), sys.stdout)
