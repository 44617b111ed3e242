"""The explorer's answers, in a process with one BLAS thread as the explorer has it: ``python -m bench.explore``."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.stability import ONE_THREAD
from bench.timing import Figure, Row, figure, repeat, run_python, scaled
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.report.explore.linear import linear_answer, modes_answer
from vsgdesign.report.explore.live import emt_answer
from vsgdesign.report.explore.maps import map_answer
from vsgdesign.report.explore.state import State, state_of
from vsgdesign.study.parameters import load_study

STUDY = Path(__file__).parents[1] / "studies" / "structures" / "study.toml"
GRIDS = 60


def measured() -> dict[str, list[float]]:
    """Seconds of each answer, with random grids as in a drag."""
    study, rng = load_study(STUDY), np.random.default_rng(2)
    low, high = np.log([1.6, 0.4]), np.log([19.0, 9.0])

    def state(figure: str) -> State:
        scr, x_over_r = np.exp(rng.uniform(low, high)).tolist()
        return state_of({"scr": scr, "x_over_r": x_over_r, "error_R": 0.1, "error_X": 0.1, "figure": figure}, study)

    linear_answer(study, NOTHING, state("disk_margin_output"))
    found = {"linear": repeat(lambda: linear_answer(study, NOTHING, state("disk_margin_output")), GRIDS)}
    found["modes"] = repeat(lambda: modes_answer(study, NOTHING, state("disk_margin_output")), GRIDS)
    found["emt"] = repeat(lambda: emt_answer(study, NOTHING, state("disk_margin_output")), GRIDS)
    for name, repeats in {"disk_margin_output": 9, "damping_all_modes": 9, "settling_s": 9, "survived": 3}.items():
        map_answer(study, NOTHING, state(name))
        found[name] = repeat(lambda name=name: map_answer(study, NOTHING, state(name)), repeats)
    return found


def explore() -> list[Row]:
    """Everything, measured in a process of its own."""
    results = json.loads(run_python(["-m", "bench.explore"], ONE_THREAD).output)
    f: dict[str, Figure] = {name: scaled(figure(values), 1e3) for name, values in results.items()}
    cells = "30 × 20 grids, full order"
    return [
        Row("explore", "linear answer of three controllers, full order", f["linear"], "ms", target=20.0,
            limit="NumPy calls of the margins' refinement"),
        Row("explore", "what takes part in their modes and what moves them", f["modes"], "ms",
            limit="derivatives of the map by 27 parameters"),
        Row("explore", "EMT of 2 s of three controllers, with figures", f["emt"], "ms",
            limit="the loop, a quarter; gains every 20 ms; steady states before and after"),
        Row("explore", f"map of the disk margin, {cells}", f["disk_margin_output"], "ms", target=100.0,
            limit="eigenvectors of 600 matrices of order 17, refinement"),
        Row("explore", f"map of the damping, {cells}", f["damping_all_modes"], "ms", target=100.0,
            limit="the same eigenvectors"),
        Row("explore", f"map of the settling time, {cells}", f["settling_s"], "ms", target=100.0,
            limit="the same, and 500 points of each response"),
        Row("explore", "map of what is survived, 30 × 20 grids, EMT", f["survived"], "ms",
            limit="600 runs side by side"),
    ]  # fmt: skip


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"explore": explore}

if __name__ == "__main__":
    if any(os.environ.get(name) != "1" for name in ONE_THREAD):
        sys.exit("set " + " ".join(f"{name}=1" for name in ONE_THREAD) + ", or run python -m bench --only explore")
    json.dump(measured(), sys.stdout)
