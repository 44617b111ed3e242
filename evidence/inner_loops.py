"""Designed inner loops of every packaged converter: what they keep, and EMT steps beside ideal inner loops."""

from __future__ import annotations

import math
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from evidence._tables import leave, line, table
from vsgdesign.design.inner import GridBox, check_full_order, design_inner_loops, score_inner_loops
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.placing import current_loop_gains, voltage_loop_gains
from vsgdesign.errors import VsgDesignError
from vsgdesign.study.parameters import Study, case_names, study_from_text
from vsgdesign.study.parameters.study import InnerLoopRequest

BOX = GridBox((1.3, 20.0), (0.3, 20.0))
AROUND = """
base = "case:{}"
[inner_loops]
design = true
[simulation]
duration = "1 s"
P_ref = 0
Q_ref = 0
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""
GRIDS = 7
"""Of each axis: 49 grids."""
STEPS = ((20.0, 0.3), (20.0, 20.0), (4.0, 2.0), (1.3, 20.0), (1.3, 0.3))
"""SCR and X/R of the EMT steps."""
POWERS_PU = (0.1, 0.7)


def asked(case: str) -> tuple[Study, InnerLoopRequest]:
    """A packaged converter in a study that leaves its inner loops to be designed, and what it asks for."""
    requests: list[InnerLoopRequest] = []

    def source(request: InnerLoopRequest) -> tuple[InnerLoopGains, float]:
        requests.append(request)
        return InnerLoopGains(1.0, 1.0, 1.0, 1.0), 1.0

    study = study_from_text(AROUND.format(case), inner_loops=source)
    return study, requests[0]


def measure(case: str) -> dict[str, Any]:
    """One converter: designed over BOX, looked at on 49 grids, on the full order, and in EMT."""
    study, _ = asked(case)
    c, f = study.converter, study.filter
    design = design_inner_loops(c, f, BOX)
    score = score_inner_loops(c, f, design.gains, design.omega_t, BOX, scr=GRIDS, x_over_r=GRIDS)
    full = check_full_order(c, f, design.gains, design.omega_t, BOX)
    rule = InnerLoopGains(*voltage_loop_gains(10e-3, 1.0, f.C), *current_loop_gains(1e-3, 1.0, f.L_1))
    by_rule = score_inner_loops(c, f, rule, math.pi * 50.0, BOX, scr=GRIDS, x_over_r=GRIDS)
    steps = emt_steps(study, design.gains, design.omega_t)
    return {
        "case": case,
        "t": design.t,
        "search_t": design.search_t,
        "sampling_ratio": design.sampling_ratio,
        "limiting": design.limiting.name,
        "promises": {p.name: p.value for p in design.promises},
        "decay_over_omega_n": next(p.value for p in design.promises if p.name == "decay") / c.omega_n,
        "stable_49": int(score.stable.sum()),
        "rule_stable_49": int(by_rule.stable.sum()),
        "full_order": [full.stable, full.analysed],
        "full_order_grids": [full.stable_grids, full.grids],
        "steps": steps,
        "seconds": design.seconds,
    }


def emt_steps(study: Study, gains: InnerLoopGains, omega_t: float) -> dict[str, Any]:
    """5 % steps of P in EMT beside ideal inner loops: how much later they settle, how much more they overshoot."""
    from tests.design.inner.ideal import emt_beside_ideal

    later, more, missing = [], [], 0
    for point in STEPS:
        for P_pu in POWERS_PU:
            try:
                delay, overshoot = emt_beside_ideal(study.converter, study.filter, gains, omega_t, point, P_pu)
            except VsgDesignError:
                missing += 1  # no operating point, or a limit is in the way
                continue
            later.append(delay)
            more.append(overshoot)
    return {
        "steps": len(later),
        "without_operating_point": missing,
        "latest_s": max(later),
        "most_overshoot_pct": max(more),
    }


HEAD = (
    "converter",
    "f_s/f_r",
    "rule",
    "t",
    "ζ",
    "σ/ω_n",
    "disk",
    "sensors",
    "noise",
    "ζ ± 20 %",
    "stable",
    "full order",
)


def row(one: dict[str, Any]) -> tuple[str, ...]:
    """One line of the documents' table."""
    p, steps = one["promises"], one["steps"]
    return (
        f"`{one['case']}`",
        f"{one['sampling_ratio']:.1f}",
        f"{one['rule_stable_49']}/49",
        f"{one['t']:.2f}",
        f"{p['damping']:.2f}",
        f"{one['decay_over_omega_n']:.3f}",
        f"{p['disk']:.2f}",
        f"{p['sensors']:.2f}",
        f"{p['noise']:.1f}",
        f"{p['tolerance']:.2f}",
        f"{one['stable_49']}/49",
        "{}/{}".format(*one["full_order"]),
        f"{1e3 * steps['latest_s']:.0f} ms, {steps['most_overshoot_pct']:.2f} %",
        f"{one['seconds']:.1f}",
    )


def main(folder: Path) -> None:
    print("\n".join(table((*HEAD, "EMT later, more", "s"), ())))
    rows = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for one in pool.map(measure, case_names()):
            rows.append(one)
            print(line(row(one)), flush=True)
    leave(folder, "inner_loops", rows)
    reached = {least: sum(one["t"] >= least for one in rows) for least in (1.0, 0.7, 0.45)}
    print("t ≥ " + ", ≥ ".join(f"{least:g} at {count}" for least, count in reached.items()) + f" of {len(rows)}")
