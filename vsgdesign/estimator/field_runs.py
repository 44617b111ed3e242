"""Runs of the field estimator in a disturbed grid, straight from the EMT simulation: one row for each of its cycles.

The estimator drives the controller's gains, as in the field. Nothing is lent by the simulator.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.field import FieldAnswer, FieldFeatures
from vsgdesign.equations.field_fusion import step_refuted
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.estimator.data_set import Arrays
from vsgdesign.estimator.field_scenarios import FieldScenario, target_of
from vsgdesign.estimator.recipes import FieldRecipe
from vsgdesign.parameters.background import draw_background
from vsgdesign.parameters.sensors import draw_sensors
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.simulation import simulate
from vsgdesign.simulation.field_feed import FieldScheduler, settings_of_study
from vsgdesign.simulation.timeline import build_timeline


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


def cycles_header(studies: Sequence[Study], recipe: FieldRecipe, seed: int) -> dict[str, Any]:
    """The header of :class:`vsgdesign.estimator.data_set.FieldCycles`."""
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


def run_cycles(studies: Sequence[Study], recipe: FieldRecipe, scenario: FieldScenario) -> Arrays:
    """Simulate one run, which ends where it diverges: arrays of :class:`vsgdesign.estimator.data_set.FieldCycles`."""
    case, spec = study_of(studies[scenario.converter], recipe, scenario)
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
