"""Data sets of windows, straight from EMT: each scenario one run that begins at rest.

A window is what an online scheduler is given in the loop, cut by the same code, so a network is trained on
what it will see.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.estimator.blocks import Arrays, ArraysJob, made_arrays
from vsgdesign.estimator.data_set import DataSet, check_data_target, write_data_set
from vsgdesign.estimator.recipes import WindowRecipe, check_recipe
from vsgdesign.estimator.sampling import turn_per_window, with_sampling
from vsgdesign.estimator.scenarios import Scenario, check_draws, draw_scenarios
from vsgdesign.estimator.sensing import background, measured_channels
from vsgdesign.execution.executors import How
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.frames import rotate
from vsgdesign.identification import Estimator, Probe
from vsgdesign.parameters.study import Event, Study
from vsgdesign.simulation import MeasuredWindow, Recorder, simulate
from vsgdesign.simulation.estimated import samples_of

BLOCK = 20
"""Scenarios that are made, kept and handed between processes together."""


@dataclass(frozen=True)
class _TwoGains:
    """Gains of the first grid, then of the second from the first update that has seen it."""

    gains: tuple[PowerLoopGains, PowerLoopGains]
    change_s: float
    update_period: float
    sample_interval: float

    def first_gains(self) -> PowerLoopGains:
        return self.gains[0]

    def update(self, window: MeasuredWindow) -> PowerLoopGains:
        return self.gains[int(window.t_s > self.change_s + 0.5 * window.sample_interval)]


class _Probing:
    """A scheduler whose windows go to an estimator as well, which says what probe is sent."""

    def __init__(self, scheduler: _TwoGains, prober: Estimator) -> None:
        self._scheduler, self._prober = scheduler, prober
        self.update_period, self.sample_interval = scheduler.update_period, scheduler.sample_interval
        self.probe_hold = prober.needs.probe_hold
        self._state = prober.first()

    def first_gains(self) -> PowerLoopGains:
        return self._scheduler.first_gains()

    def wanted(self) -> Probe | None:
        return self._prober.probe(self._state)

    def update(self, window: MeasuredWindow) -> PowerLoopGains:
        for samples in samples_of(window, self._prober.needs):
            self._state, _ = self._prober.update(self._state, samples)
        return self._scheduler.update(window)


def generate_windows(
    study: Study,
    recipe: WindowRecipe,
    seed: int,
    *,
    out: str | Path | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **how: Unpack[How],
) -> DataSet:
    """The windows of a recipe on a study's converter, and their file if ``out`` is given.

    The study gives converter, filter, inner loops and the target of the gains; grid, source, set points and bridge come
    from the recipe. The result depends on study, recipe and seed alone, not on the workers that ``how`` asks for (an
    ``executor`` replaces them). Sampling that the recipe leaves open follows from the converter
    (:func:`vsgdesign.estimator.sampling.with_sampling`); the header has it filled in. With ``out``, finished blocks are
    kept beside it until the file is whole, so that the same call takes up an interrupted one. Raises StudyError for a
    faulty recipe or seed, InfeasibleStudyError where most of its draws cannot be run, ArtifactError where the file
    cannot be written.
    """
    check_recipe(recipe)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise StudyError("windows", [Fault("seed", str(seed), "must be a whole number, zero or more")])
    workers = how.get("workers", 1)
    if workers is not None and (not isinstance(workers, int) or workers < 1):
        raise StudyError("windows", [Fault("workers", str(workers), "must be a whole number, one or more")])
    if out is not None:
        check_data_target(out)
    recipe = with_sampling(recipe, study.converter)
    header = _header(study, recipe, seed)
    blocks = [range(first, min(first + BLOCK, recipe.scenarios)) for first in range(0, recipe.scenarios, BLOCK)]
    job = ArraysJob(
        what="windows",
        header=header | {"block": BLOCK},
        make=make_block,
        arguments=[(study, recipe, seed, block) for block in blocks],
    )
    with made_arrays(
        job,
        out,
        executor=executor,
        progress=progress or silent,
        before=lambda: check_draws(study, recipe, seed),
        **how,
    ) as arrays:
        data = DataSet(**arrays, header=header)
        if out is not None:
            write_data_set(out, data)
    return data


def _header(study: Study, recipe: WindowRecipe, seed: int) -> dict[str, Any]:
    c = study.converter
    loops = (
        study.inner_gains,
        study.omega_t,
        study.target,
        study.tau_P,
        study.tau_Q,
        *([study.notch] if study.has_notch else []),
    )
    used = (c, study.filter, *loops, study.grid_source.V_g_rms)
    return {
        "recipe": recipe.document(),
        "seed": seed,
        "synchronised": recipe.synchronised,
        "study": study.name,
        "converter_hash": hashlib.sha256(repr(used).encode()).hexdigest(),
        "S_rated": c.S_rated,
        "V_rated_rms": c.V_rated_rms,
        "omega_n": c.omega_n,
        "T_s": c.T_s,
    }


def make_block(study: Study, recipe: WindowRecipe, seed: int, indices: range) -> Arrays:
    """Arrays of a :class:`DataSet` for some scenarios."""
    rows: list[Arrays] = [run_windows(study, recipe, one) for one in draw_scenarios(study, recipe, seed, indices)]
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


class Kept(NamedTuple):
    """Which windows of a run are kept: their numbers, the first after the change, and the instant of the change, s."""

    windows: tuple[int, ...]
    begins: int
    change_s: float


def kept_windows(recipe: WindowRecipe) -> Kept:
    """The windows of a recipe whose sampling is filled in."""
    begins = recipe.settle + recipe.before
    kept = list(range(recipe.settle, begins))
    kept += range(begins + recipe.skip, begins + recipe.skip + recipe.after * recipe.every, recipe.every)
    return Kept(tuple(kept), begins, begins * recipe.update_period)


def scenario_study(study: Study, recipe: WindowRecipe, scenario: Scenario) -> Study:
    """The study of one scenario: its grids, its source, its set points and its bridge."""
    kept = kept_windows(recipe)
    (P_ref, Q_ref), (P_new, Q_new) = scenario.references
    events = [Event(0.0, "phase", phase_jump=scenario.phase)] if scenario.phase else []
    if recipe.after:
        events.append(Event(kept.change_s, "change", grid=scenario.grids[1], P_ref=P_new, Q_ref=Q_new))
    spec = replace(
        study.simulation,
        duration=(kept.windows[-1] + 1) * recipe.update_period,
        bridge=recipe.bridge,
        start="steady_state",
        log_interval=recipe.sample_interval,
        P_ref=P_ref,
        Q_ref=Q_ref,
    )
    return replace(study, grid=scenario.grids[0], grid_source=scenario.source, simulation=spec, events=tuple(events))


def record_windows(
    study: Study, recipe: WindowRecipe, scenario: Scenario, prober: Estimator | None = None
) -> tuple[list[MeasuredWindow], NDArray[np.bool_], NDArray[np.float64]]:
    """Simulate one scenario: its windows, which come after the change, and v_pcc and i_pcc before the sensors.

    The recipe's sampling is filled in. The last is (N, 2, 2, n): voltage and current, α and β, with the background's
    harmonics. ``prober`` is an estimator whose probe is sent, as it wants it from what it sees without sensors' noise.
    """
    kept = kept_windows(recipe)
    case = scenario_study(study, recipe, scenario)
    scheduler = _TwoGains(scenario.gains, kept.change_s, recipe.update_period, recipe.sample_interval)
    recorder = Recorder(scheduler if prober is None else _Probing(scheduler, prober))
    simulate(case, recorder).to_its_end()
    windows = [recorder.windows[k] for k in kept.windows]
    after = np.array([k >= kept.begins for k in kept.windows])
    vectors = np.array([(w.v_pcc.T, w.i_pcc.T) for w in windows])
    if scenario.harmonics:
        vectors = vectors + background(case, recipe, scenario, windows, after)
    return windows, after, vectors


def synchronised_vectors(
    study: Study, recipe: WindowRecipe, windows: Sequence[MeasuredWindow], vectors: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(N, 2, 2, n) turned so that a grid of nominal frequency begins every window at the same angle.

    The same array where windows are whole cycles, or are not synchronised anyway.
    """
    step = turn_per_window(recipe, study.converter)
    if step == 0.0 or not recipe.synchronised:
        return vectors
    back = -step * np.array([window.index for window in windows])[:, None, None]
    return np.stack(rotate(vectors[:, :, 0], vectors[:, :, 1], np.cos(back), np.sin(back)), axis=2)


def run_windows(study: Study, recipe: WindowRecipe, scenario: Scenario) -> Arrays:
    """Simulate one scenario and take its windows: the arrays of a :class:`DataSet`."""
    # A recipe has its own harmonics and noise.
    windows, after, vectors = record_windows(study.undisturbed, recipe, scenario)
    grids = [scenario.grids[int(later)] for later in after]
    rng = np.random.default_rng((*scenario.seed, 1))
    vectors = synchronised_vectors(study, recipe, windows, vectors)
    x = measured_channels(study.converter, recipe, vectors, np.array([w.theta for w in windows]), scenario.noise, rng)
    count = len(windows)
    return {
        "windows": x,
        "scenario": np.full(count, scenario.index, dtype=np.int64),
        "after_change": after,
        "R_g": np.array([grid.R_g for grid in grids]),
        "L_g": np.array([grid.L_g for grid in grids]),
        "P": np.array([w.P for w in windows]),
        "Q": np.array([w.Q for w in windows]),
        "V_rms": np.array([w.V_rms for w in windows]),
        "V_g_rms": np.full(count, scenario.source.V_g_rms),
        "omega_g": np.full(count, scenario.source.omega_g),
        "source_phase": np.array([w.source_phase for w in windows]),
        "t_s": np.array([w.t_s for w in windows]),
        "redrawn": np.tile(np.array(scenario.redrawn, dtype=np.int64), (count, 1)),
    }
