"""The proof of the sampled full-order loop with gain tables of designs that it was not made for: for each packaged
case the power loops and the specification that ``vsgdesign new`` writes, a table with the nodes of this specification,
and the proof over the whole box of the table, as ``certify TABLE --model full`` makes it.

``VSGDESIGN_PROOF_SECONDS`` is the most time for the proof of a case (none given: no limit), ``VSGDESIGN_PROOF_CASES``
the names of the cases where not all are meant. Interrupted work goes on from the cells and cases that are finished.
"""

from __future__ import annotations

import math
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from evidence._kept_runs import kept_runs, progress
from evidence._tables import leave, table
from evidence.full_order_designs import SCR, X_OVER_R, proof_columns
from vsgdesign.artifacts.gain_table_file import read_table_file, write_table_file
from vsgdesign.artifacts.ready import Ready
from vsgdesign.certificate import on_basis_of_table, prove_full_order, region_of
from vsgdesign.design.table import build_table
from vsgdesign.errors import StudyError
from vsgdesign.execution.executors import executor_of
from vsgdesign.study.datasheet.study_text import nodes
from vsgdesign.verbs.pipeline.opening import check_study, open_study

WIDE = ("motulator_10kva_lcl", "sized_125kva_480v_60hz", "sized_50kva_208v_60hz")
"""Cases with the grids of ``full_order_designs``."""

CASES = (
    *WIDE,
    *("sized_1kva_208v_60hz", "sized_100kva_no_delay", "sized_5mva_3300v", "yang2020_1mva", "sized_500kva_storage"),
    *("sized_30kva_sic", "microgrid_gym_3kva_60hz", "pogaku2007_10kva", "simplus_100kva"),
)
"""Twelve of the packaged cases."""

AROUND = 1.8
"""Of the other cases: grids up to so many times weaker, stronger, or of another X/R than their own."""

STUDY = """
base = "case:{name}"
simulation = {{ duration = "1 s", P_ref = "0 W", Q_ref = "0 var" }}
power_loops = {{ structure = "angle_damped", tau_P = "5 ms", tau_Q = "5 ms", Q_droop = "50 %" }}
controllers = [{{ name = "table", kind = "scheduled", schedule = "table" }}]
[specification]
settling_time = "1.3 s"
overshoot = "5 %"
disk_margin = 1.0
damping_ratio = 0.5
P = [{P[0]}, {P[1]}]
Q = [{Q[0]}, {Q[1]}]
error = "20 %"
error_Z = "8 %"
scr_basis = "impedance"
scr = {scr}
x_over_r = {x_over_r}
"""


def main(folder: Path) -> None:
    """Builds the table of each case, and proves the loop with it."""
    names = os.environ.get("VSGDESIGN_PROOF_CASES", "").split() or CASES
    tasks = [(name, str(folder)) for name in names]
    rows = kept_runs(case, tasks, folder / "full_order_tables.jsonl", "tables", workers=1)
    head = ("case", "f_n, delay", "SCR, X/R", "nodes, of them met", "build, CPU s", "least decay found", "proved at")
    head += ("of the volume", "boxes", "CPU s", "left")
    leave(folder, "full_order_tables", rows, table(head, [_row(row) for row in rows]))


def case(task: tuple[str, str]) -> dict[str, Any]:
    """The table of one case, by its name and the folder for it, and the proof."""
    name, folder = task
    file = Path(folder) / f"full_order_tables-{name}.json"
    text = file.with_suffix(".toml")

    def written(P: float, Q: float, scr: tuple[float, float] = SCR, ratio: tuple[float, float] = X_OVER_R) -> Path:
        given = STUDY.format(name=name, P=(-P, P), Q=(-Q, Q), scr=nodes(scr), x_over_r=nodes(ratio))
        text.write_text(given, encoding="utf-8")
        return text

    of_case, _ = check_study(written(1.0, 1.0))
    rated = of_case.converter
    scr, ratio = SCR, X_OVER_R
    if name not in WIDE:
        at = of_case.grid.place(rated, "impedance")
        scr, ratio = ((round(x / AROUND, 2), round(x * AROUND, 2)) for x in (at.scr, at.x_over_r))
    study = open_study(written(0.9 * rated.S_rated, 0.4 * rated.S_rated, scr, ratio))
    spec = study.controllers[-1]
    begin = time.process_time()
    if not file.exists():
        cells = file.with_suffix(".cells")
        cells.mkdir(exist_ok=True)
        with executor_of(1, None) as executor:
            built = build_table(study, spec, cells, executor=executor, certificate=False, progress=progress(name))
        write_table_file(built.table, file)
    build = time.process_time() - begin
    own = read_table_file(file)
    ready = Ready(tables={spec.name: own})
    study = on_basis_of_table(replace(study, controllers=(spec,)), spec.name, ready)
    _, region = region_of(study, spec.name, None, None, ready=ready)
    begin = time.process_time()
    row = {
        "case": name,
        "f_n": rated.omega_n / (2.0 * math.pi),
        "delay": rated.delay_samples,
        "scr": region.scr,
        "x_over_r": region.x_over_r,
        "nodes": own.status.size,
        "met": int((own.status == "met").sum()),
        "build_s": round(build, 1),
    }
    given = os.environ.get("VSGDESIGN_PROOF_SECONDS")
    seconds = None if given is None else float(given)
    try:
        found = prove_full_order(study, spec, region, ready=ready, workers=1, seconds=seconds, progress=progress(name))
    except StudyError as error:
        return row | {"refused": str(error)}
    return row | {
        "least": found.slowest.decay,
        "slowest": found.slowest.__dict__,
        "decay": found.decay,
        "proved": found.proved,
        "boxes": found.boxes,
        "cpu_s": round(time.process_time() - begin, 1),
        "left": [part.__dict__ for part in found.left[:5]],
    }


def _row(row: dict[str, Any]) -> list[str]:
    scr, ratio = (SCR, X_OVER_R) if row["case"] in WIDE else (row["scr"], row["x_over_r"])
    grids = f"{scr[0]:g} to {scr[1]:g}, {ratio[0]:g} to {ratio[1]:g}"
    nodes_ = f"{row['nodes']}, {row['met']}"
    begin = [row["case"], f"{row['f_n']:.0f} Hz, {row['delay']}", grids, nodes_, f"{row['build_s']:.0f}"]
    if "refused" in row:
        return [*begin, *["–"] * 5, row["refused"]]
    return [*begin, *proof_columns(row)]
