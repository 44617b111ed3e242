"""What a table for a pair of impedances does with whatever grid a unit of the plant finds: modes, and EMT.

A unit with its own probe finds a grid that is stronger than N Z_g (:eq:`plant-seen`); by how much depends on what its
neighbours are. So the modes are those of ``studies/plant`` for every grid that the units together may see, every power,
and the gains of any grid of the table that is as strong or stronger (:func:`modes_of_places`). In EMT units with
their own probes, units with one estimate and units that are told the true network step; beside these are the slowest
modes with the gains at the end. The table is built in the folder, and found again there.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._kept_runs import progress
from evidence._tables import leave, table
from evidence.plant_cases import AFTER_S, STUDIES, still
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.gain_table_file import read_table_file
from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.stability.modes_of_units import differential_modes
from vsgdesign.metrics.modes import to_continuous
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.units.scenario import run_plant
from vsgdesign.study.parameters import load_study, study_from_text
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.power_plant import behind_its_path
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.table import build_table_file

Array = NDArray[np.float64]

PLANT = STUDIES / "plant" / "study.toml"
SCR, X_OVER_R = (1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 40.0, 80.0), (1.0, 2.0, 5.0, 20.0)
P_SHARES, Q_SHARES = (-0.9, -0.45, 0.0, 0.45, 0.9), (-0.3, 0.0, 0.3)
STRONGER = (0.67, 0.8, 1.0, 1.5, 2.0, 4.0, 8.0, 20.0, 53.0)
"""SCR that is found over the true one; below 1 the estimate is wrong in the other direction."""
MOST_CURRENT = 0.9

CASES = ((2, 1.5), (2, 5.0), (3, 1.5), (4, 1.5), (4, 3.0))
"""Units on line, SCR on the rating of them."""
KINDS = ("own probes", "one estimate", "told the true network")
EVENT_S, DURATION_S = 4.0, 7.5

STUDY = """
base = "{base}"
grid = {{ scr = {scr}, x_over_r = 5 }}
plant = {{ units = {units}, reactance = 0.03, resistance = 0.006, estimators = "{estimators}" }}
simulation = {{ duration = {duration}, P_ref = "5 kW", Q_ref = "0 var" }}
controllers = [{{ name = "table", kind = "scheduled", schedule = "table", estimate = "{estimate}" }}]
events = [{{ time = {event}, element = "unit1", P_ref = "7 kW" }}]
[background]
level = "{background}"
seed = 1
{still}
[sensors]
level = "typical"
seed = 3
"""


def modes_of_places(study: Study, gain_table: GainTable) -> dict[float, tuple[int, complex, complex]]:
    """By the ratio of the SCR that is found to the true one: how many cases there are, and the slowest common and the
    slowest differential mode. Cases are true grids, powers, and X/R of what is found, all of the table's axes."""
    if study.plant is None:
        raise ValueError("no plant")
    own = replace(behind_its_path(study, study.plant.units[0]), plant=None)
    spec, c, V_g = own.controllers[0], own.converter, own.grid_source.V_g_rms
    most = MOST_CURRENT * (c.current_limit_pu or np.inf)
    law = gain_law(own, spec, Ready(tables={spec.name: gain_table}))
    found: dict[float, tuple[int, complex, complex]] = {}
    for ratio in STRONGER:
        cells, rows = [], []
        for scr, x, seen_x, p, q in itertools.product(SCR, X_OVER_R, X_OVER_R, P_SHARES, Q_SHARES):
            seen = ratio * scr
            grid, P, Q = Place(scr, x, "impedance").grid(c), p * c.S_rated, q * c.S_rated
            with np.errstate(invalid="ignore"):
                V, _ = operating_point(P, Q, V_g, *(np.array(one) for one in own.path_to_grid(grid, c.omega_n)))
            low, high = c.V_limits_rms
            current = np.hypot(p, q) * c.V_rated_rms / V
            if not (SCR[0] <= seen <= SCR[-1] and low <= V <= high and current <= most):
                continue
            told = Place(seen, seen_x, "impedance").grid(c)
            gains = PowerLoopGains(*(float(one) for one in law(told.R_g, told.L_g, P, Q, float(V))))
            if np.isfinite(gains[0]):
                cells.append(Cell(grid, gains, P, Q - gains.D_q * (c.V_rated_rms - float(V)), own.grid_source))
                rows.append((P, Q, float(V), *gains))
        model, given = linearise_full_order(own, cells), np.array(rows, dtype=float).T
        s = to_continuous(np.linalg.eigvals(model.A), model.T_s)
        common = s[np.arange(len(s)), np.argmax(s.real, axis=1)]
        apart = differential_modes(
            own, PowerLoopGains(*given[3:]), given[0], given[1], given[2], own.grid_source.omega_g
        )
        found[ratio] = len(common), *(one[np.nanargmax(one.real)] for one in (common, apart))
    return found


def step_of(units: int, scr: float, kind: str, gain_table: GainTable) -> dict[str, Any]:
    """A step of one unit: the slowest mode at the end, how much of the time later the answers are valid, and the false
    changes."""
    told = kind == KINDS[2]
    text = STUDY.format(
        base=PLANT.as_posix(), scr=scr, units=units, duration=DURATION_S, event=EVENT_S,
        estimators="common" if kind == KINDS[1] else "own", estimate="truth" if told else "field",
        background="clean" if told else "measured", still="" if told else still(),
    )  # fmt: skip
    study = study_from_text(text)
    study = replace(study, sensors=None) if told else study
    run = run_plant(study, Ready(tables={"table": gain_table})).controllers[0]
    logs = [one.estimates for one in run.units if one.estimates is not None and one.estimates.cycles is not None]
    valid = [float(one.cycles.valid[one.t_s > EVENT_S + AFTER_S].mean()) for one in logs if one.cycles is not None]
    false = [int(one.cycles.changed[one.t_s > 2.0].sum()) for one in logs if one.cycles is not None]
    slowest = float(run.rests[-1].modes[0].s.real)
    return {"units": units, "scr": scr, "kind": kind, "slowest": slowest, "valid": valid, "false_changes": sum(false)}


def main(folder: Path) -> None:
    file = folder / "plant_own_probe-table.json"
    if not file.exists():
        build_table_file(load_study(PLANT), file, workers=1, progress=progress("plant_own_probe"))
    gain_table = read_table_file(file)
    modes = modes_of_places(load_study(PLANT), gain_table)
    rows = [step_of(units, scr, kind, gain_table) for units, scr in CASES for kind in KINDS]
    cells = [
        (f"{ratio:g}", f"{count}", f"{common.real:+.2f} 1/s", f"{apart.real:+.2f} 1/s")
        for ratio, (count, common, apart) in modes.items()
    ]
    text = table(("SCR found over the true one", "cases", "slowest, together", "slowest, against each other"), cells)
    steps = []
    for units, scr in CASES:
        some = [one for one in rows if (one["units"], one["scr"]) == (units, scr)]
        steps.append((f"{units}, {scr:g}", *(f"{one['slowest']:+.2f}" for one in some)))
    valid = [value for one in rows for value in one["valid"]]
    false = sum(one["false_changes"] for one in rows)
    share = 100.0 * float(np.mean(valid))
    said = f"Valid later than {AFTER_S:g} s after the step: {share:.1f} % of the time; false changes: {false}."
    text = [*text, "", *table(("units, plant SCR", *KINDS), steps), "", said]
    leave(folder, "plant_own_probe", rows, text)
