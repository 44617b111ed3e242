"""The field estimator where it is not alone: beside a load at the PCC, and beside another converter's modulation.

Its answers are compared with what it is asked for, the impedance at the grid's frequency: of grid and load together,
where there is a load. Grids are drawn over SCR 1.5 to 10 and X/R 0.3 to 10, with the surroundings of a clean grid and
typical sensors. ``VSGDESIGN_FIELD_SHARE=0.2`` measures a fifth of the grids.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from evidence._field_runs import answers_of_log
from evidence._kept_runs import share
from evidence._tables import leave, table
from vsgdesign.metrics.answers import inside_ellipse
from vsgdesign.simulation import simulate
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.study.parameters import study_from_text

GRIDS, FIRST_SEED, DURATION_S, REST_S = 10, 100000, 6.0, 2.0
"""How many grids, their seeds, and the part of a run that counts as rest: all but its first 2 s."""

CONDITIONS = {
    "alone": "",
    "a resistance of 0.1 pu of power": "[network]\nload = { P_pu = 0.1 }",
    "a resistance of 0.5 pu": "[network]\nload = { P_pu = 0.5 }",
    "a motor's 0.5 pu + j0.3 pu": "[network]\nload = { P_pu = 0.5, Q_pu = 0.3 }",
    "a modulation of 0.1 % at 25 Hz": "modulation = 0.001",
    "a modulation of 0.2 % at 25 Hz": "modulation = 0.002",
    "a modulation of 0.5 % at 25 Hz": "modulation = 0.005",
    "a modulation of 0.5 % at 24 Hz": "modulation = 0.005\nmodulation_frequency = 24",
}
"""What is beside the converter, as text of a study."""


def study_text(condition: str, seed: int) -> str:
    """The published converter on a drawn grid beside something."""
    rng = np.random.default_rng(seed)
    scr, x_over_r = np.exp(rng.uniform(np.log([1.5, 0.3]), np.log([10.0, 10.0])))
    P, Q = rng.uniform([-0.3, -0.1], [0.3, 0.1]) * 5e3
    text = CONDITIONS[condition]
    background = f'[background]\nlevel = "clean"\nseed = {seed}\n'
    if text.startswith("modulation"):
        at = "" if "frequency" in text else "\nmodulation_frequency = 25"
        background, text = f"{background}{text}{at}\n", ""
    return f"""
base = "case:hoang2025_5kva"
simulation = {{ duration = {DURATION_S}, P_ref = {P:.6g}, Q_ref = {Q:.6g} }}
grid = {{ scr_basis = "impedance", scr = {scr:.6g}, x_over_r = {x_over_r:.6g} }}
converter = {{ current_limit_pu = 1.2, current_limiter = "projection" }}
inner_loops = {{ transient_resistance_pu = 0.08 }}
power_loops = {{ structure = "angle_damped", P_droop = "5 %", Q_droop = "5 %" }}
controllers = [{{ name = "field", kind = "scheduled", estimate = "field" }}]
{background}
[sensors]
level = "typical"
seed = {seed}
{text}
"""


def measured(condition: str, seeds: range) -> dict[str, Any]:
    """Over all cycles at rest: the share with a valid answer, and of these the coverage of the 95 % ellipse and the
    error of Z."""
    valid, inside, error = [], [], []
    for seed in seeds:
        study = study_from_text(study_text(condition, seed))
        scheduler = FieldScheduler(study, study.controllers[0])
        run = simulate(study, scheduler).to_its_end()
        answers = answers_of_log(scheduler.log(run.timeline), study)
        at_rest = answers.t_s > REST_S
        good = at_rest & answers.valid
        valid.append(answers.valid[at_rest])
        inside.append(inside_ellipse(answers)[good])
        error.append(answers.error[good])
    every = [np.concatenate(rows) for rows in (valid, inside, error)]
    return {
        "condition": condition,
        "runs": len(seeds),
        "cycles": len(every[0]),
        "valid": float(every[0].mean()),
        "coverage": float(every[1].mean()) if len(every[1]) else None,
        "error_median": float(np.median(every[2])) if len(every[2]) else None,
        "error_p95": float(np.quantile(every[2], 0.95, method="inverted_cdf")) if len(every[2]) else None,
    }


def main(folder: Path) -> None:
    seeds = range(FIRST_SEED, FIRST_SEED + max(round(share() * GRIDS), 1))
    rows = [measured(condition, seeds) for condition in CONDITIONS]
    lines = table(
        ["beside the converter", "cycles", "valid", "coverage of the 95 % ellipse", "error of Z: median, p95"],
        [
            [
                row["condition"],
                f"{row['cycles']:,}",
                f"{100 * row['valid']:.1f} %",
                _per_cent(row["coverage"]),
                f"{_per_cent(row['error_median'])}, {_per_cent(row['error_p95'])}",
            ]
            for row in rows
        ],
    )
    leave(folder, "field_not_alone", rows, lines)


def _per_cent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"
