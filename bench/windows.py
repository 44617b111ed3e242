"""What it costs to ask a scheduler during a run, and to make a data set of windows."""

from __future__ import annotations

from collections.abc import Callable

from bench.emt import PUBLISHED
from bench.timing import Row, figure, repeat, run_python
from vsgdesign.simulation import FixedGains, GainChange, build_timeline, gain_changes, simulate
from vsgdesign.study.parameters import load_study

GENERATE = """
import sys
import time
from vsgdesign.estimator.recipes import WINDOW_RECIPES
from vsgdesign.estimator.specification import WINDOW_NETWORK, generate
from vsgdesign.study.parameters import load_study

if __name__ == "__main__":
    begin = time.perf_counter()
    study, recipe = load_study(sys.argv[1]), WINDOW_RECIPES.named(sys.argv[2])
    data = generate(WINDOW_NETWORK, study, recipe, 0, workers=int(sys.argv[3]))
    print(time.perf_counter() - begin, len(data))
"""


def online() -> list[Row]:
    """An update of an online schedule: the cut of the run alone, and with its window."""
    study = load_study(PUBLISHED)
    gains = gain_changes(study, study.controllers[-1], build_timeline(study))[0].gains
    period = 20e-3
    updates = round(study.simulation.duration / period)
    cut = [GainChange(k * period, gains) for k in range(updates)]
    uncut, cuts, asked = (
        min(repeat(lambda s=schedule: simulate(study, s, bridge="averaged")))
        for schedule in ([cut[0]], cut, FixedGains(gains, period))
    )
    what = "averaged, 5 kVA LC, 60 s with 3,000 updates: one update"
    return [
        Row(
            "online",
            f"{what}, cut of the run",
            figure([1e6 * (cuts - uncut) / updates]),
            "us",
            limit="a call of the compiled loop: 19 arguments unpacked",
        ),
        Row(
            "online",
            f"{what}, its window of 100 samples",
            figure([1e6 * (asked - cuts) / updates]),
            "us",
            target=50.0,
            limit="some 20 calls of NumPy",
        ),
    ]


def windows() -> list[Row]:
    """5,000 windows of the switched bridge in a process of their own, imports not counted."""
    rows = []
    for recipe in ("published", "continuous"):
        for workers in (1, 2):
            costs = [run_python(["-c", GENERATE, str(PUBLISHED), recipe, str(workers)]) for _ in range(3)]
            seconds = figure([float(cost.output.split()[0]) for cost in costs])
            what = f"{recipe}, 5,000 windows, PWM, {workers} process{'es' if workers > 1 else ''}"
            limit = "the loop for 300 simulated s; 500 steady states" if workers == 1 else "start of the processes"
            rows.append(Row("windows", what, seconds, "s", target=30.0, limit=limit))
            if workers == 1:
                memory = figure([cost.peak_mb for cost in costs])
                rows.append(Row("windows", f"{what}: peak memory", memory, "MB", target=1000.0))
    return rows


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"online": online, "windows": windows}
