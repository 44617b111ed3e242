"""Comparison of all methods on the same grids and steps: error and bound, disturbance, delay after a change of grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.network_weights import NetworkWeights
from vsgdesign.estimator.bound import Bound, probe_bound, sensor_noise, steady_window_bound, windows_bound
from vsgdesign.estimator.comparison_runs import (
    LINE_ORDERS,
    Record,
    Run,
    has_surroundings,
    measure,
    run_case,
    surroundings_in_words,
)
from vsgdesign.estimator.data_set import check_enough
from vsgdesign.estimator.methods import (
    BEFORE,
    JUDGED,
    ComparisonSettings,
    Estimates,
    Method,
    comparison_recipe,
    methods_of,
    probe_name,
    runnable_settings,
    window_of,
    with_sensors,
)
from vsgdesign.estimator.recipes import CONTINUOUS, PUBLISHED, WindowRecipe
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.identification.classical import TwoWindows
from vsgdesign.identification.interface import ProbeLines
from vsgdesign.study.parameters.ranges import one_of
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

WITHIN = 0.10
"""Error of |Z| that counts as found again after a change of grid."""


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Errors |Ẑ − Z|/|Z| of one method over windows and draws, and the bound of its signals: (S,) for S SCR."""

    method: str
    signals: str
    rms: Array
    p95: Array
    bound: Array
    """NaN if the method measures nothing."""


@dataclass(frozen=True, eq=False)
class Disturbance:
    """The largest change of instantaneous P and Q by a probe at rest, relative to the rating: (S,) for S SCR."""

    method: str
    P: Array
    Q: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class GridStep:
    """A change of grid seen by one method: (draws, W) estimates of |Z| (Ω) and their relative errors."""

    method: str
    scr: tuple[float, float]
    t_s: Array
    """(W,): end of each window after the change, s; negative before."""
    Z: Array
    Z_true: Array
    """(W,): Ω."""
    error: Array
    delay: tuple[float, ...]
    """Of each draw, s: from the change to the end of the first window from which on the error stays within
    ``WITHIN`` to the end of the run; infinite if there is none."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The results of a comparison."""

    settings: ComparisonSettings
    accuracy: tuple[Accuracy, ...]
    disturbances: tuple[Disturbance, ...]
    grid_steps: tuple[GridStep, ...]
    weights: dict[str, str] = field(default_factory=dict)
    """Hash of each network's weights by method."""
    left_out: tuple[str, ...] = ()
    """A sentence for each grid on which the converter cannot run. ``settings`` do not contain these grids."""
    around: str = ""
    """Background and sensors of the runs in words; empty where sensors came after them."""


def train_networks(
    study: Study,
    recipes: Sequence[WindowRecipe] = (),
    settings: ComparisonSettings | None = None,
    *,
    seed: int = 0,
    workers: int | None = 1,
    progress: Progress = silent,
) -> list[tuple[str, NetworkWeights]]:
    """Trains a network for each recipe, which takes some seconds each. Returns their names and weights.

    Without recipes these are the published network and one of continuous grids that is trained with noise. Raises
    ArtifactError if the windows of the recipes differ, and the errors of
    :func:`vsgdesign.estimator.specification.train`.
    """
    from vsgdesign.estimator.specification import WINDOW_NETWORK, train

    settings = settings or ComparisonSettings()
    wanted = [(f"Neural, {recipe.name}", recipe) for recipe in recipes] or [
        ("Neural, published", PUBLISHED),
        ("Neural, continuous", with_sensors(CONTINUOUS, settings)),
    ]
    # Before the first is trained: networks of different windows could not be compared.
    for _, recipe in wanted:
        check_enough(recipe.scenarios, "scenarios")
    comparison_recipe(study, settings, {name: window_of(recipe, study.converter) for name, recipe in wanted})
    return [
        (name, train(WINDOW_NETWORK, study, recipe, seed=seed, workers=workers, progress=progress).weights)
        for name, recipe in wanted
    ]


def compare_methods(
    study: Study,
    networks: dict[str, NetworkWeights],
    settings: ComparisonSettings | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Runs all methods and compares them. Grids on which the converter cannot run are left out.

    ``networks`` has weights by name. Raises StudyError for settings that make no recipe, InfeasibleStudyError if no
    grid is left, and ArtifactError for networks with different windows.
    """
    settings, left_out = runnable_settings(study, settings or ComparisonSettings())
    recipe = comparison_recipe(study, settings, {name: one.window for name, one in networks.items()})
    methods = methods_of(study, networks, recipe, settings)
    count = len(settings.scr)
    by_probe = probed_runs(study, [(recipe, k) for k in range(count)], methods, settings, progress)
    records = {name: found.record(settings.draws) for name, found in by_probe.items()}
    accuracy = tuple(
        _accuracy(method, by_probe[probe_name(method)].runs, records[probe_name(method)], count) for method in methods
    )
    disturbances = tuple(
        _disturbance(method.name, by_probe[""].first_draws, by_probe[probe_name(method)].first_draws)
        for method in methods
        if method.probes
    )
    steps = tuple(
        step for pair in settings.grid_steps for step in _grid_steps(study, recipe, pair, methods, settings, progress)
    )
    hashes = {name: weights.hash for name, weights in networks.items()}
    return Comparison(settings, accuracy, disturbances, steps, hashes, left_out, surroundings_in_words(study))


@dataclass(frozen=True, eq=False)
class ProbedRuns:
    """The runs with one probe, case by case. If sensors or a background are in the loop, every case is run ``draws``
    times. Otherwise it is run once, because the noise is added to its result."""

    runs: list[Run]
    draws: int

    @property
    def first_draws(self) -> list[Run]:
        """One run of every case."""
        return self.runs[:: self.draws]

    def record(self, draws: int) -> Record:
        """The measured runs, ``draws`` of every case."""
        return measure(self.runs, 1 if self.draws > 1 or self.runs[0].sensed else draws)


def probed_runs(
    study: Study,
    cases: Sequence[tuple[WindowRecipe, int]],
    methods: Sequence[Method],
    settings: ComparisonSettings,
    progress: Progress,
) -> dict[str, ProbedRuns]:
    """The runs of every case (recipe, index) without a probe and with the probe of each method, by
    :func:`probe_name`."""
    probes: dict[str, Method | None] = {"": None} | {probe_name(m): m for m in methods if m.probes}
    times = {
        name: settings.draws if has_surroundings(study) or (method is not None and method.kind.by_sample) else 1
        for name, method in probes.items()
    }
    found: dict[str, ProbedRuns] = {}
    done, total = 0, len(cases) * sum(times.values())
    for name, method in probes.items():
        prober = None if method is None else method.estimator
        runs = []
        for recipe, index in cases:
            for draw in range(times[name]):
                runs.append(run_case(study, recipe, index, settings.seed, prober, draw))
                done += 1
                progress("runs", done / total)
        found[name] = ProbedRuns(runs, times[name])
    return found


def relative_errors(record: Record, found: Estimates) -> Array:
    """(B, W): |Ẑ − Z|/|Z| at the grid's frequency; NaN where there is no estimate."""
    omega = record.omega[:, None]
    truth = record.R_g + 1j * omega * record.L_g
    return np.abs(found.R_g + 1j * omega * found.L_g - truth) / np.abs(truth)


def judged(errors: Array, groups: int) -> tuple[Array, Array]:
    """Rms and 95th percentile (groups,) of errors (B, W) over draws and the last JUDGED windows.

    A missing estimate counts as an error of 100 %.
    """
    last = np.nan_to_num(errors[:, -JUDGED:], nan=1.0).reshape(groups, -1)
    return np.sqrt(np.mean(last**2, axis=1)), np.percentile(last, 95.0, axis=1)


def _accuracy(method: Method, runs: Sequence[Run], record: Record, count: int) -> Accuracy:
    rms, p95 = judged(relative_errors(record, method.estimate(record)), count)
    bounds = [bound_of_run(method, run) for run in runs]
    every = np.array([np.nan if one is None else one.Z for one in bounds]).reshape(count, -1)
    bound = np.sqrt(np.mean(every**2, axis=1))  # sensors that are in the loop differ between the draws
    return Accuracy(method.name, method.estimator.signals, rms, p95, bound)


def bound_of_run(method: Method, run: Run) -> Bound | None:
    """The bound of a method's signals at the end of a run, from the true currents; None if it measures nothing."""
    recipe, grid, estimator = run.recipe, run.grids[-1], method.estimator
    noise = sensor_noise(run.converter, run.noise, *run.adc)
    n, h = recipe.samples, recipe.sample_interval
    _, i = run.space_vectors
    i = i * np.exp(-1j * run.omega * h * np.arange(len(i)))
    windows = i.reshape(-1, n).mean(axis=1)
    about = (noise, n, grid.R_g, grid.L_g)
    if estimator.signals == "steady":
        return steady_window_bound(complex(windows[-1]), run.omega, *about, known_ratio=True)
    if isinstance(estimator, TwoWindows):
        # The pair that is still answering: the last that the gate lets pass moves by the gate at least.
        moved = np.abs(windows[estimator.apart :] - windows[: -estimator.apart])
        passed = np.flatnonzero(moved > estimator.gate * np.abs(windows).max())
        last = int(passed[-1]) if len(passed) else 0
        return windows_bound(windows[[last, last + estimator.apart]], run.omega, *about)
    if estimator.signals == "windows":
        return windows_bound(windows, run.omega, *about)
    if run.field is not None:
        orders = np.array(LINE_ORDERS)
        return probe_bound(run.field.lines, run.omega * orders, run.omega, noise, run.field.samples, *about[2:])
    if isinstance(estimator, ProbeLines):
        lines, slip, count = estimator.lines(i, h)
        return probe_bound(lines, run.omega + slip, run.omega, noise, count, *about[2:])
    return None


def _disturbance(name: str, plain: Sequence[Run], probed: Sequence[Run]) -> Disturbance:
    moves = []
    for without, with_probe in zip(plain, probed, strict=True):
        rest = slice(0, BEFORE * without.recipe.samples)
        pairs = zip(without.powers, with_probe.powers, strict=True)
        moves.append([np.abs(b[rest] - a[rest]).max() / without.converter.S_rated for a, b in pairs])
    P, Q = np.array(moves).T
    return Disturbance(name, P, Q)


def _grid_steps(
    study: Study,
    recipe: WindowRecipe,
    pair: tuple[float, float],
    methods: Sequence[Method],
    settings: ComparisonSettings,
    progress: Progress,
) -> list[GridStep]:
    ratio = max(pair[0] / pair[1], pair[1] / pair[0])
    changed = replace(
        recipe,
        name="grid_step",
        scr=one_of(*pair),
        P_step_pu=one_of(0.0),
        grid_step_share=1.0,
        grid_step_ratio=max(1.01 * ratio, recipe.grid_step_ratio),
    )
    by_probe = probed_runs(study, [(changed, 0)], methods, settings, progress)
    steps = []
    for method in methods:
        record = by_probe[probe_name(method)].record(settings.draws)
        found = method.estimate(record)
        error = relative_errors(record, found)
        omega = record.omega[:, None]
        period = record.samples * record.sample_interval
        t_s = np.asarray((np.arange(record.windows) + 1 - BEFORE) * period, dtype=np.float64)
        delay = tuple(_delay(row[BEFORE:], t_s[BEFORE:]) for row in error)
        truth = np.hypot(record.R_g, omega * record.L_g)[0]
        Z = np.hypot(found.R_g, omega * found.L_g)
        steps.append(GridStep(method=method.name, scr=pair, t_s=t_s, Z=Z, Z_true=truth, error=error, delay=delay))
    return steps


def _delay(error: Array, t_s: Array) -> float:
    """The end of the first window from which on every error is within the limit."""
    outside = np.flatnonzero(~(error <= WITHIN))
    first = 0 if len(outside) == 0 else int(outside[-1]) + 1
    return float(t_s[first]) if first < len(error) else float("inf")
