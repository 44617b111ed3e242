"""Runs of the field estimator in a disturbed grid, straight from the EMT simulation: one row for each of its cycles.

The estimator drives the controller's gains, as in the field. Nothing is lent by the simulator.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.field import FieldAnswer, FieldFeatures
from vsgdesign.equations.field_fusion import step_refuted
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.estimator.blocks import Arrays, ArraysJob, made_arrays
from vsgdesign.estimator.data_set import check_data_target
from vsgdesign.estimator.field.cycles import FieldCycles, write_cycles
from vsgdesign.estimator.field.recipe import FieldRecipe, check_field_recipe
from vsgdesign.estimator.field.scenarios import FieldScenario, draw_field_scenario, target_of
from vsgdesign.execution.executors import How
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.parameters.background import draw_background
from vsgdesign.parameters.sensors import draw_sensors
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.simulation import simulate
from vsgdesign.simulation.field_feed import FieldScheduler, settings_of_study
from vsgdesign.simulation.timeline import build_timeline

BLOCK = 6
"""Runs that are made, kept and handed between processes together."""


class Listened(NamedTuple):
    """A cycle as the network sees it."""

    t_s: float
    answer: FieldAnswer
    features: FieldFeatures


class ListeningScheduler(FieldScheduler):
    """The scheduler of a run with the field estimator, which also keeps what the network is given in every cycle."""

    def begin(self) -> ListeningScheduler:
        """Starts afresh."""
        super().begin()
        self.listened: list[Listened] = []
        return self

    def conclude(self, sample: int, present: PowerLoopGains, state: ControllerState) -> PowerLoopGains:
        """Ends the estimator's cycle before a sample. Returns the gains from this sample on."""
        gains = super().conclude(sample, present, state)
        row = self.rows[-1]
        self.listened.append(Listened(row.t_s, row.answer, self._memory.seen))
        return gains


def generate_cycles(
    studies: Sequence[Study],
    recipe: FieldRecipe,
    seed: int,
    *,
    out: str | Path | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **how: Unpack[How],
) -> FieldCycles:
    """The cycles of a recipe's runs on some converters, and their file if ``out`` is given.

    The studies give converter, filter, inner loops, limiter and the target of the gains; grid, source, background,
    sensors and set points come from the recipe. The result depends on studies, recipe and seed alone, not on the
    workers that ``how`` asks for (an ``executor`` replaces them). With ``out``, finished blocks are kept beside it
    until the file is whole, so that the same call takes up an interrupted one. Raises StudyError for a faulty recipe or
    seed, InfeasibleStudyError where a converter cannot run what is drawn, ArtifactError where the file cannot be
    written.
    """
    check_field_recipe(recipe)
    for name, value, least in (("seed", seed, 0), ("workers", how.get("workers", 1) or 1, 1)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise StudyError("runs", [Fault(name, str(value), f"must be a whole number, {least} or more")])
    if out is not None:
        check_data_target(out)
    header = _header(studies, recipe, seed)
    blocks = [range(first, min(first + BLOCK, recipe.runs)) for first in range(0, recipe.runs, BLOCK)]
    job = ArraysJob(
        what="runs",
        header=header | {"block": BLOCK},
        make=make_runs,
        arguments=[(tuple(studies), recipe, seed, block) for block in blocks],
    )
    with made_arrays(
        job,
        out,
        executor=executor,
        progress=progress or silent,
        **how,
    ) as arrays:
        cycles = FieldCycles(**arrays, header=header)
        if out is not None:
            write_cycles(out, cycles)
    return cycles


def _header(studies: Sequence[Study], recipe: FieldRecipe, seed: int) -> dict[str, Any]:
    settings = [settings_of_study(study)._asdict() for study in studies]
    return {
        "kind": "runs of the field estimator",
        "recipe": recipe.document(),
        "seed": seed,
        "features": list(FieldFeatures._fields),
        "converters": [_converter(study) for study in studies],
        "settings": [{name: float(value) for name, value in one.items()} for one in settings],
    }


def _converter(study: Study) -> dict[str, Any]:
    c = study.converter
    used = (c, study.filter, study.inner_gains, study.omega_t, target_of(study), study.tau_P, study.tau_Q)
    return {
        "name": study.name,
        "S_rated": float(c.S_rated),
        "V_rated_rms": float(c.V_rated_rms),
        "f_n": float(c.omega_n / (2.0 * math.pi)),
        "T_s": float(c.T_s),
        "hash": hashlib.sha256(repr(used).encode()).hexdigest(),
    }


def make_runs(studies: Sequence[Study], recipe: FieldRecipe, seed: int, indices: range) -> Arrays:
    """Arrays of :class:`FieldCycles` for some runs."""
    rows = []
    for index in indices:
        scenario = draw_field_scenario(studies, recipe, seed, index)
        rows.append(run_cycles(studies[scenario.converter], recipe, scenario))
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


def study_of(study: Study, recipe: FieldRecipe, scenario: FieldScenario) -> tuple[Study, ControllerSpec]:
    """Returns the study of a run, and its controller."""
    spec = ControllerSpec(name="field", kind="scheduled", target=target_of(study), estimate="field")
    # The frequency and the voltage of the grid are those of the scenario, for which its rests were found.
    still = {"frequency_offset": (0.0, 0.0), "voltage_factor": (1.0, 1.0)}
    P_ref, Q_ref = scenario.references
    c = study.converter
    run = replace(
        study.with_limit_of(spec),
        grid=scenario.grid,
        grid_source=scenario.source,
        background=draw_background(still, scenario.seed, recipe.background),
        sensors=draw_sensors({}, scenario.seed, recipe.sensors),
        controllers=(spec,),
        events=scenario.events,
        simulation=replace(
            study.simulation,
            duration=round(recipe.duration / c.T_s) * c.T_s,
            bridge=recipe.bridge,
            start="steady_state",
            log_interval=round(0.1 / c.T_s) * c.T_s,
            P_ref=P_ref,
            Q_ref=Q_ref,
        ),
    )
    return run, spec


def run_cycles(study: Study, recipe: FieldRecipe, scenario: FieldScenario) -> Arrays:
    """Simulate one run: the arrays of a :class:`FieldCycles`. A run that diverges ends there."""
    case, spec = study_of(study, recipe, scenario)
    scheduler = ListeningScheduler(case, spec)
    broken = simulate(case, scheduler).divergence is not None
    timeline, T_s = build_timeline(case), case.converter.T_s
    kept = [
        row
        for row in scheduler.listened
        if row.t_s >= recipe.learn and np.isfinite(row.answer).all() and np.isfinite(row.features).all()
    ]
    t_s = np.array([row.t_s for row in kept], dtype=float)
    grids = [timeline.grid_at(t - 0.5 * T_s) for t in t_s]
    starts = np.array([change.t_s for change in scenario.changes])
    number = np.searchsorted(starts + 0.5 * T_s, t_s) - 1

    def of_change(name: str, without: float) -> Any:
        values = [float(getattr(change, name)) for change in scenario.changes]
        return np.array([*values, without])[number]

    count = len(kept)
    return {
        "features": np.array([row.features for row in kept], dtype=float).reshape(count, len(FieldFeatures._fields)),
        "answer": np.array([row.answer for row in kept], dtype=float).reshape(count, len(FieldAnswer._fields)),
        "refuted": np.array([step_refuted(row.features) > 0.5 for row in kept], dtype=bool),
        "truth": np.array([(grid.R_g, grid.L_g) for grid in grids], dtype=float).reshape(count, 2),
        "run": np.full(count, scenario.index, dtype=np.int64),
        "converter": np.full(count, scenario.converter, dtype=np.int64),
        "t_s": t_s,
        "change": of_change("kind", 0.0).astype(np.int64),
        "change_number": number.astype(np.int64),
        "since_change": t_s - of_change("t_s", -math.inf),
        "factor": of_change("factor", 1.0),
        "current": of_change("current", 0.0),
        "broken": np.full(count, broken),
    }
