"""Runs of the field estimator in a disturbed grid, straight from the EMT simulation: one row for each of its cycles.

The estimator drives the controller's gains, as in the field. Nothing is lent by the simulator.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.field import FieldAnswer, FieldFeatures
from vsgdesign.equations.field.fusion import step_refuted
from vsgdesign.equations.frames import PHASES, rms_to_peak
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import PUBLISHED
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.estimator.data_set import CHANGES, Arrays
from vsgdesign.estimator.recipes import FieldRecipe
from vsgdesign.linear.operating_point import solve_operating_point
from vsgdesign.linear.operating_point.equilibrium import OperatingPoint, solve_with_droop
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.simulation import simulate
from vsgdesign.simulation.field_feed import FieldScheduler, settings_of_study
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.background import draw_background
from vsgdesign.study.parameters.grid import Grid, GridSource, Place
from vsgdesign.study.parameters.sensors import draw_sensors
from vsgdesign.study.parameters.study import ClosedFormTarget, ControllerSpec, Event, Study

DRIVING = "angle_damped"

ATTEMPTS = 200
"""Draws of a run before a recipe is given up as impossible."""

NEAR = math.log(2.0)
"""A near jump changes SCR by a factor of up to 2."""

_ADVICE = {
    "no operating point": "raise the low end of scr, or ask for less P_pu and Q_pu",
    "current": "ask for less P_pu and Q_pu, or raise largest_current_pu",
    "unstable": "lower the high end of scr or x_over_r",
}


@dataclass(frozen=True)
class _State:
    """What holds between two changes."""

    scr: float
    x_over_r: float
    V_g_pu: float
    f_g_pu: float
    P_ref: float
    Q_ref: float
    turned: float = 0.0
    """Phase step of the source with which it begins, rad."""


@dataclass(frozen=True)
class FieldChange:
    """A change of a run: when, what (a code of CHANGES), the factor by which |Z_g| becomes larger or smaller (at least
    1), and the current before it, pu."""

    t_s: float
    kind: int
    factor: float
    current: float


@dataclass(frozen=True, kw_only=True)
class FieldScenario:
    """One run."""

    index: int
    converter: int
    """Index of its converter among those of the recipe."""
    seed: int
    """Of its background and its sensors."""
    grid: Grid
    source: GridSource
    references: tuple[float, float]
    """(P_ref, Q_ref) at the start, W and var."""
    events: tuple[Event, ...]
    changes: tuple[FieldChange, ...]
    gains: tuple[PowerLoopGains, ...]
    """Gains of the closed form in each state: at the start and after each change."""
    redrawn: int
    """Draws that were thrown away before this one."""


def target_of(study: Study) -> ClosedFormTarget:
    """The target of the gains in the runs: that of the study.

    The droop of the published structure depends on the impedance that is believed, so that a start without an estimate
    would rest anywhere. In its place the angle-damped structure drives the runs.
    """
    return replace(study.target, structure=DRIVING) if study.target.structure == PUBLISHED.name else study.target


def draw_field_scenarios(
    studies: Sequence[Study], recipe: FieldRecipe, seed: int, indices: Sequence[int]
) -> list[FieldScenario]:
    """Runs of a recipe: each the first of its draws in which the converter rests before and after every change.

    A draw is thrown away where the grid cannot carry the power, the current exceeds ``largest_current_pu``, or the
    loops are unstable. Each depends on the recipe, the seed and its index alone. Raises InfeasibleStudyError after
    ATTEMPTS draws.
    """
    return [_draw_one(studies, recipe, seed, index) for index in indices]


def _draw_one(studies: Sequence[Study], recipe: FieldRecipe, seed: int, index: int) -> FieldScenario:
    converter = index % len(studies)
    study, thrown = studies[converter], Counter[str]()
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng((seed, index, attempt))
        found = _draw(study, recipe, rng, index // len(studies))
        if isinstance(found, str):
            thrown[found] += 1
            continue
        return FieldScenario(
            index=index,
            converter=converter,
            seed=int(rng.integers(2**31 - 1)),
            redrawn=attempt,
            **found,
        )
    parts = ", ".join(f"{count} {reason}" for reason, count in thrown.most_common())
    raise InfeasibleStudyError(
        f"recipe {recipe.name}, converter {study.name}: none of {ATTEMPTS} draws of run {index} can be run ({parts}); "
        f"{_ADVICE[thrown.most_common(1)[0][0]]}."
    )


def _draw(study: Study, recipe: FieldRecipe, rng: np.random.Generator, number: int) -> dict[str, Any] | str:
    """The fields of a scenario, or why the converter cannot rest somewhere in it."""
    c = study.converter
    first = _State(
        *(recipe.scr.draw(rng, number), recipe.x_over_r.draw(rng, number)),
        *(recipe.V_g_pu.draw(rng, number), recipe.f_g_pu.draw(rng, number)),
        *(recipe.P_pu.draw(rng, number) * c.S_rated, recipe.Q_pu.draw(rng, number) * c.S_rated),
    )
    grid, source = _grid(study, recipe, first), _source(study, first)
    try:
        gains = _gains(study, grid, first)
        V_rms = solve_operating_point(
            first.P_ref, first.Q_ref, source.V_g_rms, *study.path_to_grid(grid, source.omega_g)
        ).V_rms
    except NoOperatingPointError:
        return "no operating point"
    # The droops must not move the powers that were drawn.
    first = replace(
        first,
        P_ref=first.P_ref - gains.D_p * (c.omega_n - source.omega_g),
        Q_ref=first.Q_ref - gains.D_q * (c.V_rated_rms - V_rms),
    )
    states, kinds = [first], []
    for k in range(recipe.changes):
        kinds.append(_kind(recipe, rng))
        states.append(_next_state(recipe, rng, states[-1], kinds[-1], c.S_rated, number * recipe.changes + k))
    rests = _rests(study, recipe, states)
    if isinstance(rests, str):
        return rests
    cells, currents = rests
    events, changes = [], []
    for k, kind in enumerate(kinds):
        before, after = states[k], states[k + 1]
        t_s = recipe.first + k * recipe.between + float(rng.random()) * 2.0 * math.pi / c.omega_n
        t_s = round(t_s / c.T_s) * c.T_s
        old, new = (complex(one.grid.R_g, c.omega_n * one.grid.L_g) for one in cells[k : k + 2])
        changes.append(FieldChange(t_s, kind, max(abs(new / old), abs(old / new)), currents[k]))
        if kind == 0:
            continue
        given: dict[str, Any] = {"grid": cells[k + 1].grid} if new != old else {}
        if after.V_g_pu != before.V_g_pu:
            given["V_g_rms"] = after.V_g_pu * c.V_rated_rms
        if after.f_g_pu != before.f_g_pu:
            given["omega_g"] = after.f_g_pu * c.omega_n
        if kind == CHANGES.index("power_step"):
            given |= {"P_ref": after.P_ref, "Q_ref": after.Q_ref}
        events.append(Event(t_s, f"change {k + 1}: {CHANGES[kind]}", phase_jump=after.turned, **given))
    return {
        "grid": grid,
        "source": source,
        "references": (first.P_ref, first.Q_ref),
        "events": tuple(events),
        "changes": tuple(changes),
        "gains": tuple(one.gains for one in cells),
    }


def _kind(recipe: FieldRecipe, rng: np.random.Generator) -> int:
    shares = np.cumsum([recipe.jump_share, recipe.jump_and_step_share, recipe.grid_step_share, recipe.power_step_share])
    code = int(np.searchsorted(shares, rng.random(), side="right")) + 1
    return code if code < len(CHANGES) else 0


def _next_state(
    recipe: FieldRecipe, rng: np.random.Generator, state: _State, kind: int, S_rated: float, number: int
) -> _State:
    name, state = CHANGES[kind], replace(state, turned=0.0)
    if name.startswith("jump"):
        low, high = min(recipe.scr.values), max(recipe.scr.values)
        if rng.random() < recipe.near_share:
            scr = min(max(state.scr * math.exp(rng.uniform(-NEAR, NEAR)), low), high)
        else:
            scr = recipe.scr.draw(rng, number)
        x_over_r = recipe.x_over_r.draw(rng, number) if rng.random() < 0.5 else state.x_over_r
        state = replace(state, scr=scr, x_over_r=x_over_r)
    if name in ("jump_and_step", "grid_step"):
        # Voltage, phase, frequency, or voltage and half of a phase together.
        what = int(rng.integers(4))
        if what in (0, 3):
            state = replace(state, V_g_pu=state.V_g_pu + recipe.V_step_pu.draw(rng, number))
        if what in (1, 3):
            share = 1.0 if what == 1 else 0.5
            state = replace(state, turned=share * recipe.phase_step.draw(rng, number))
        if what == 2:
            state = replace(state, f_g_pu=state.f_g_pu + recipe.f_step_pu.draw(rng, number))
    if name == "power_step":
        state = replace(
            state,
            P_ref=state.P_ref + recipe.P_step_pu.draw(rng, number) * S_rated,
            Q_ref=state.Q_ref + recipe.Q_step_pu.draw(rng, number) * S_rated,
        )
    return state


def _rests(study: Study, recipe: FieldRecipe, states: Sequence[_State]) -> tuple[list[Cell], list[float]] | str:
    """Where the converter rests in each state and its current there, pu; or why it does not."""
    c = study.converter
    cells, currents = [], []
    for state in states:
        grid, source = _grid(study, recipe, state), _source(study, state)
        R, X = study.path_to_grid(grid, source.omega_g)
        try:
            gains = _gains(study, grid, state)
            P = state.P_ref + gains.D_p * (c.omega_n - source.omega_g)
            point = solve_with_droop(P, state.Q_ref, gains.D_q, c.V_rated_rms, source.V_g_rms, R, X)
        except NoOperatingPointError:
            return "no operating point"
        currents.append(_bridge_current(study, point))
        if currents[-1] > recipe.largest_current_pu:
            return "current"
        cells.append(Cell(grid, gains, state.P_ref, state.Q_ref, source))
    model = linearise_full_order(study, cells)
    if any(fault is not None for fault in model.faults):
        return "no operating point"
    if np.abs(np.linalg.eigvals(model.A)).max() > 1.0 + 1e-9:
        return "unstable"
    return cells, currents


def _bridge_current(study: Study, point: OperatingPoint) -> float:
    """Fundamental of the bridge's current at rest, pu of the rated peak: that of the grid and of the capacitor."""
    into_grid = complex(point.P, -point.Q) / (PHASES * point.V_rms)
    whole = into_grid + 1j * study.converter.omega_n * study.filter.C * point.V_rms
    return float(rms_to_peak(abs(whole)) / study.converter.I_rated_pk)


def _gains(study: Study, grid: Grid, state: _State) -> PowerLoopGains:
    """Gains of the closed form. Raises NoOperatingPointError where the grid cannot carry the references."""
    return closed_form_schedule(study, target_of(study), state.P_ref, state.Q_ref).gains(grid.R_g, grid.L_g)


def _grid(study: Study, recipe: FieldRecipe, state: _State) -> Grid:
    return Place(state.scr, state.x_over_r, recipe.scr_basis).grid(study.converter)


def _source(study: Study, state: _State) -> GridSource:
    c = study.converter
    return GridSource(state.V_g_pu * c.V_rated_rms, state.f_g_pu * c.omega_n)


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
