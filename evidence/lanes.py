"""Many runs side by side against one run after the other: every state after 1.5 s, over the rating or its own value."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.equations.controller import ControllerState
from vsgdesign.frames import rms_to_peak
from vsgdesign.parameters import Study, load_study
from vsgdesign.parameters.grid import Grid
from vsgdesign.simulation.feeds import LateSchedule, safe_grid
from vsgdesign.simulation.lanes.alone import study_of_case
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.rests import rests_of
from vsgdesign.simulation.lanes.results import JUDGED, LaneResults
from vsgdesign.simulation.lanes.run import drive, parts_of, run_lanes
from vsgdesign.simulation.lanes.telling import telling
from vsgdesign.simulation.run import simulate
from vsgdesign.simulation.segments import segments_of
from vsgdesign.simulation.survival.demand import demand_of, settling_time_of
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.verification.draws import FAMILIES, cases_of, uniforms_of

_SURVIVAL = Path(__file__).resolve().parents[1] / "studies" / "survival"
STUDIES = ("study", "laboratory", "utility")
"""Of studies/survival: 5 kVA LC, 12.5 kVA LCL with a sample of delay, 1 MVA at 60 Hz; projection limiter."""

CONTROLLER = "decoupled"
CASES = 36
"""Of each family and study."""

SEED = 200
AFTER_S = 1.5

Array = NDArray[np.float64]
Row = dict[str, Any]


def states_of_lanes(study: Study, cases: LaneCases, samples: int) -> tuple[LaneResults, Array]:
    """Results of a batch, and every state of each case before a sample, in units of the ratings."""
    spec = next(one for one in study.controllers if one.name == CONTROLLER)
    own = study.with_limit_of(spec)
    results, told, segments = LaneResults.of_none(len(cases)), telling(own, spec, NOTHING, cases), segments_of(cases)
    demand = demand_of(own.converter, settling_time_of(spec, NOTHING))
    rests, gains = rests_of(own, cases, segments, told, demand, results)
    parts = parts_of(own, cases, segments, rests, demand, np.flatnonzero(results.status == JUDGED), "averaged", False)
    drive(parts, told, gains, stop_at=samples)
    names = [f"state.{name}" for name in ControllerState._fields if name != "limiter"]
    states = np.full((len(cases), 6 + len(names)), np.nan)
    for part in parts:
        x = part.span("x").start
        columns = [part.get(x + k) for k in range(6)] + [part.get(name) for name in names]
        states[part.index] = np.array(columns).T
    return run_lanes(study, spec, NOTHING, cases), states / ratings(study)


def ratings(study: Study) -> Array:
    """What the states of the circuit and of the controller are divided by."""
    c = study.converter
    I_pk, V_pk = c.I_rated_pk, rms_to_peak(c.V_rated_rms)
    circuit = [I_pk] * 2 + [V_pk] * 2 + [I_pk] * 2
    loops = [1.0, c.omega_n, c.V_rated_rms, c.S_rated, c.S_rated] + [I_pk] * 2 + [V_pk] * 2
    filters = [I_pk] * 2 + [V_pk] * 2 + [c.S_rated] * 4
    return np.array(circuit + loops + filters)


def state_of_one(study: Study, cases: LaneCases, k: int, samples: int) -> Array:
    """The same of one run."""
    spec = next(one for one in study.controllers if one.name == CONTROLLER)
    own = study_of_case(study.with_limit_of(spec), cases, k, samples)
    timeline = build_timeline(own)
    feed = LateSchedule(own, spec, _told(cases, k, timeline), NOTHING, safe=safe_grid(own, spec, NOTHING))
    run = simulate(replace(own, simulation=replace(own.simulation, log_interval=20e-3)), feed)
    return np.array([*run.final_plant, *run.final_state[:-1]]) / ratings(study)


def _told(cases: LaneCases, k: int, timeline: Timeline) -> list[tuple[float, Grid | None]]:
    def seen(t_s: float) -> Grid:
        grid = timeline.grid_at(t_s)
        return Grid(grid.R_g * (1.0 + float(cases.error_R[k])), grid.L_g * (1.0 + float(cases.error_X[k])))

    e = cases.events
    of_grid = np.isfinite(e.R_g[k]) | np.isfinite(e.V_g_rms[k]) | np.isfinite(e.omega_g[k]) | (e.phase_jump[k] != 0.0)
    instants = e.t_s[k][of_grid & np.isfinite(e.t_s[k])].tolist()
    said: list[tuple[float, Grid | None]] = [(0.0, seen(0.0))]
    for t_s, following in itertools.pairwise([*instants, np.inf]):
        said.append((t_s, None))
        if t_s + float(cases.silent_s[k]) < following:
            said.append((t_s + float(cases.silent_s[k]), seen(t_s + 1e-9)))
    return said


def compared(name: str) -> list[Row]:
    """Every case of a study."""
    study, rows = load_study(_SURVIVAL / f"{name}.toml"), []
    spec = next(one for one in study.controllers if one.name == CONTROLLER)
    samples = round(AFTER_S / study.converter.T_s)
    for number, family in enumerate(FAMILIES):
        cases = cases_of(study, spec, uniforms_of(SEED, 0, CASES), number)[0]
        results, states = states_of_lanes(study, cases, samples)
        for k in np.flatnonzero(results.status == JUDGED).tolist():
            one = state_of_one(study, cases, k, samples)
            away = np.abs(states[k] - one) / np.maximum(np.abs(one), 1.0)
            away[6] = abs((away[6] + np.pi) % (2.0 * np.pi) - np.pi)  # θ is kept within a turn
            limited = bool(results.limited_s[k] > 0.0)
            rows.append({"study": name, "family": family, "limited": limited, "difference": float(away.max())})
    return rows


def main(folder: Path) -> None:
    """Prints and keeps the largest and the median differences."""
    rows = [row for name in STUDIES for row in compared(name)]
    (folder / "lanes.json").write_text(json.dumps(rows), encoding="utf-8")
    lines = ["| study | limiter | cases | median | largest |", "| --- | --- | --- | --- | --- |"]
    for name in STUDIES:
        for limited in (False, True):
            some = [row["difference"] for row in rows if row["study"] == name and row["limited"] == limited]
            if some:
                acts = "acts" if limited else "does not act"
                lines.append(f"| {name} | {acts} | {len(some)} | {np.median(some):.1e} | {max(some):.1e} |")
    text = "\n".join(lines)
    (folder / "lanes.md").write_text(text + "\n", encoding="utf-8")
    print(text)
