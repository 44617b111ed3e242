"""Certified steps in the EMT: from inside, where no limit may act after 5 ms, and from outside, where it should."""

from __future__ import annotations

import math
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from evidence._field_converters import CONTROLLER, CONVERTERS
from evidence._field_converters import STUDIES as FOLDER
from evidence._tables import leave, table
from vsgdesign.artifacts.certificate_record import StepRow, StepStatement
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate import Certificate, Region, certified_steps, certify, region_of
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.region import System, random_points
from vsgdesign.errors import InfeasibleStudyError, LimitHitError, SimulationDivergedError
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.run import simulate
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Event

STUDIES = tuple(CONVERTERS.values())
REGION: dict[str, Any] = {"scr": (2.0, 20.0), "x_over_r": (1.0, 20.0), "Q_pu": (-0.3, 0.3), "error": 0.2}
KINDS = ("P_ref", "Q_ref", "phase", "V_g", "omega_g")
FACTORS = (0.9, 1.5, 2.0, 3.0, 5.0)
RUNS = 1000
"""For each study and factor."""

_STEP_S = 0.1
_END_S = 1.6
_FAST_S = 5e-3
_UPDATES_S = 0.05


@dataclass(frozen=True)
class SteppedRun:
    """One step in the EMT."""

    study: str
    kind: str
    factor: float
    scr: float
    x_over_r: float
    P: float
    Q: float
    load: float
    """Largest P of the row, W."""
    limited_fast: int
    """Limited samples in the first 5 ms after the step."""
    limited_later: int
    largest_pu: float
    """Largest converter current from 5 ms after the step on, pu of the rated peak."""


def stepped_run(study: Study, system: System, row: StepRow, factor: float, seed: int) -> SteppedRun | None:
    """A step of a random kind and sign, ``factor`` times the certified one, to a random cell of a row.

    The estimate is another one within its error every 50 ms. None where the run has no steady state to begin from.
    """
    rng = np.random.default_rng(seed)
    region = Region(row.scr, (REGION["x_over_r"]), row.P, row.Q, REGION["error"])
    # Every second coordinate is at a limit: that is where little room is left.
    points = random_points(region, 40, rng)
    low, high = region.limits
    points = np.where(rng.random(points.shape) < 0.5, np.where(rng.random(points.shape) < 0.5, low, high), points)
    cells = system.cells(points, partial=True)
    if len(cells.points) == 0:
        return None
    weakness, angle, P, Q, _, _ = cells.points[0]
    c, f, source = study.converter, study.filter, study.grid_source
    grid = Grid(float(cells.R[0] - f.R_2), float(cells.X[0] / source.omega_g - f.L_2))
    V = float(cells.V_rms[0])
    changes = []
    for k in range(round(_END_S / _UPDATES_S)):
        e_R, e_L = rng.uniform(-region.error, region.error, 2)
        gains = system.schedule.gains_measured(grid.R_g * (1.0 + e_R), grid.L_g * (1.0 + e_L), P, Q, V)
        changes.append(GainChange(k * _UPDATES_S, type(gains)(*(float(value) for value in gains))))
    kind, sign = KINDS[rng.integers(len(KINDS))], float(rng.choice([-1.0, 1.0]))
    step = sign * factor * float(getattr(row, kind))
    Q_ref = Q + changes[0].gains.D_q * (V - c.V_rated_rms)
    before = {"P_ref": float(P), "Q_ref": float(Q_ref)}
    after, start = dict(before), source
    event = Event(_STEP_S, kind)
    if kind in before:
        before[kind] -= step
        event = replace(event, **{kind: float(after[kind])})
    elif kind == "phase":
        event = replace(event, phase_jump=step)
    elif kind == "V_g":
        start, event = replace(source, V_g_rms=source.V_g_rms - step), replace(event, V_g_rms=source.V_g_rms)
    else:
        start, event = replace(source, omega_g=source.omega_g - step), replace(event, omega_g=source.omega_g)
    simulation = replace(study.simulation, duration=_END_S, log_interval=c.T_s, **before)
    run = replace(study, grid=grid, grid_source=start, events=(event,), simulation=simulation)
    try:
        found = simulate(run, tuple(changes)).to_its_end()
    except (InfeasibleStudyError, LimitHitError, SimulationDivergedError):
        return None
    limited, t_s = found.column("limited_samples"), found.t_s
    at, later = (np.searchsorted(t_s, when) for when in (_STEP_S, _STEP_S + _FAST_S))
    current = np.hypot(found.column("i_s_alpha"), found.column("i_s_beta"))[later:].max() / c.I_rated_pk
    return SteppedRun(
        study=study.name,
        kind=kind,
        factor=factor,
        scr=float(1.0 / weakness),
        x_over_r=float(math.tan(angle)),
        P=float(P),
        Q=float(Q),
        load=row.P[1],
        limited_fast=int(limited[later - 1] - limited[at - 1]),
        limited_later=int(limited[-1] - limited[later - 1]),
        largest_pu=float(current),
    )


def stated(name: str = STUDIES[0], budget: int = 150_000, **options: Any) -> tuple[Study, System, StepStatement]:
    """A study, its loops and what is certified of it. ``options``: of :func:`vsgdesign.certificate.certify`."""
    study = load_study(FOLDER / f"{name}.toml")
    spec, region = region_of(study, CONTROLLER, **REGION)
    study = study.with_limit_of(spec)
    certificate = certify(study, spec, region, budget=0, **options)
    if not isinstance(certificate, Certificate):
        raise InfeasibleStudyError("the evidence's region has a counterexample")
    system, _ = prepared(study, spec, region, NOTHING, None, None)
    return study, system, certified_steps(study, spec, certificate, budget=budget)


def _of_seed(study: Study, system: System, rows: list[StepRow], factor: float, seed: int) -> SteppedRun | None:
    return stepped_run(study, system, rows[seed % len(rows)], factor, seed)


def main(folder: Path) -> None:
    """Prints how often a limit acts, by study, factor and kind."""
    runs: list[SteppedRun] = []
    for name in STUDIES:
        study, system, found = stated(name)
        rows = [row for row in found.rows if row.possible]
        with ProcessPoolExecutor(os.cpu_count()) as pool:
            waiting = [
                pool.submit(_of_seed, study, system, rows, factor, seed) for factor in FACTORS for seed in range(RUNS)
            ]
            own = [run for one in waiting if (run := one.result()) is not None]
        _print(study.title, [row.proof for row in rows], own)
        runs += own
    leave(folder, "certified_steps", [vars(run) for run in runs])


def _print(title: str, proofs: list[str], runs: list[SteppedRun]) -> None:
    print(f"{title}: {proofs.count('gap-free')} of {len(proofs)} rows gap-free\n")
    rows = []
    for factor in FACTORS:
        some = [run for run in runs if run.factor == factor]
        later, fast = (sum(getattr(run, n) > 0 for run in some) for n in ("limited_later", "limited_fast"))
        largest = max((run.largest_pu for run in some), default=math.nan)
        counts = []
        for kind in KINDS:
            own = [run for run in some if run.kind == kind]
            counts.append(f"{kind} {sum(run.limited_later > 0 for run in own)}/{len(own)}")
        rows.append((f"{factor:g}", f"{len(some)}", f"{later}", f"{fast}", f"{largest:.3f}", ", ".join(counts)))
    head = ("size", "runs", "a limit acts after 5 ms", "in the first 5 ms", "largest current, pu", "later, by kind")
    print("\n".join(table(head, rows)), end="\n\n")
