"""Stress test of the estimators: one quantity at a time differs from its nominal value, on the same runs for all."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.network_weights import NetworkWeights
from vsgdesign.estimator.comparison import judged, probed_runs, relative_errors
from vsgdesign.estimator.comparison_runs import surroundings_in_words
from vsgdesign.estimator.methods import (
    ComparisonSettings,
    comparison_recipe,
    methods_of,
    nominal_settings,
    probe_name,
    runnable_settings,
    runnable_values,
)
from vsgdesign.estimator.recipes import WindowRecipe
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.study.parameters.ranges import one_of
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StressAxis:
    """One quantity with its values and with the change of the nominal recipe that a value makes."""

    name: str
    title: str
    unit: str
    values: tuple[float, ...]
    nominal: float
    change: Callable[[WindowRecipe, float, float], WindowRecipe]
    """Function of the nominal recipe, a value and ω_n (rad/s) that returns the recipe of this value."""
    frequency_error: float = 0.0
    """Error of the grid's frequency, as the converter knows it, for a value of 1, rad/s."""


def _shift(recipe: WindowRecipe, samples: float, omega_n: float) -> WindowRecipe:
    return replace(recipe, phase=one_of(samples * omega_n * recipe.sample_interval))


def _frequency(recipe: WindowRecipe, frequency_hz: float, omega_n: float) -> WindowRecipe:
    return replace(recipe, f_g_pu=one_of(2.0 * math.pi * frequency_hz / omega_n))


def _noise(recipe: WindowRecipe, noise_pct: float, _: float) -> WindowRecipe:
    return replace(recipe, noise_v=one_of(0.01 * noise_pct), noise_i=one_of(0.01 * noise_pct))


def _harmonics(recipe: WindowRecipe, share_pct: float, _: float) -> WindowRecipe:
    return replace(recipe, harmonic_5=one_of(0.01 * share_pct), harmonic_7=one_of(0.01 * share_pct))


STRESS_SETTINGS = ComparisonSettings(noise=0.0, adc_bits=0)
"""Ideal sensors, as published."""

_FREQUENCIES = (-0.1, -0.05, -0.01, 0.0, 0.01, 0.05, 0.1)
"""Hz beside the nominal frequency."""

_OTHER_AXES = (
    StressAxis("shift", "Window shifted by", "samples", (-2.0, -1.0, 0.0, 1.0, 2.0), 0.0, _shift),
    StressAxis("V_g", "Grid voltage", "pu", (0.95, 0.99, 1.0, 1.01, 1.05), 1.0,
               lambda recipe, value, _: replace(recipe, V_g_pu=one_of(value))),
    StressAxis("x_over_r", "X/R", "1", (0.3, 0.5, 1.0, 2.0, 4.0, 8.0), 1.0,
               lambda recipe, value, _: replace(recipe, x_over_r=one_of(value))),
    StressAxis("scr", "SCR", "1", (2.0, 3.0, 5.0, 8.0, 12.0, 20.0), 8.0,
               lambda recipe, value, _: replace(recipe, scr=one_of(value))),
    StressAxis("noise", "Sensor noise", "%", (0.0, 0.01, 0.05, 0.1, 0.3, 1.0), 0.0, _noise),
    StressAxis("frequency_error", "Frequency known within", "mHz", (0.0, 0.1, 0.3, 1.0, 3.0, 10.0), 0.0,
               lambda recipe, _value, _: recipe, 2e-3 * math.pi),
    StressAxis("harmonics", "5th and 7th harmonic, each", "%", (0.0, 0.5, 1.0, 2.0, 3.0), 0.0, _harmonics),
)  # fmt: skip


def stress_axes(f_n: float) -> tuple[StressAxis, ...]:
    """The axes of the stress test on a grid of the nominal frequency ``f_n`` (Hz).

    The references keep the powers constant, whatever the droops are.
    """
    values = tuple(round(f_n + by, 6) for by in _FREQUENCIES)
    return StressAxis("frequency", "Grid frequency", "Hz", values, round(f_n, 6), _frequency), *_OTHER_AXES


@dataclass(frozen=True, eq=False)
class AxisResult:
    """Errors |Ẑ − Z|/|Z| of every method along one axis: rms and 95th percentile, (methods, values)."""

    axis: StressAxis
    rms: Array
    p95: Array


@dataclass(frozen=True, eq=False)
class Stress:
    """The results of a stress test."""

    settings: ComparisonSettings
    methods: tuple[str, ...]
    results: tuple[AxisResult, ...]
    f_n: float = 50.0
    """Nominal frequency of the grid, Hz."""
    weights: dict[str, str] = field(default_factory=dict)
    around: str = ""
    """As in :class:`vsgdesign.estimator.comparison.Comparison`."""
    left_out: tuple[str, ...] = ()
    """A sentence for each value with which the converter cannot run. The axes do not contain these values."""

    def at(self, method: str, axis: str, value: float) -> float:
        """The rms error of one method at one value."""
        result = next(result for result in self.results if result.axis.name == axis)
        return float(result.rms[self.methods.index(method), result.axis.values.index(value)])


def stress_methods(
    study: Study,
    networks: dict[str, NetworkWeights],
    settings: ComparisonSettings | None = None,
    axes: tuple[StressAxis, ...] | None = None,
    progress: Progress = silent,
) -> Stress:
    """Runs every value of every axis (None: :func:`stress_axes`).

    Without ``settings``, the runs are on SCR 8 with ideal sensors, as published. Raises the errors of
    :func:`vsgdesign.estimator.comparison.compare_methods`.
    """
    settings, _ = runnable_settings(study, nominal_settings(settings or STRESS_SETTINGS))
    nominal = comparison_recipe(study, settings, {name: one.window for name, one in networks.items()})
    methods = methods_of(study, networks, nominal, settings)
    omega_n = study.converter.omega_n
    axes = stress_axes(omega_n / (2.0 * math.pi)) if axes is None else axes
    sensed = study.sensors is not None
    if sensed:
        axes = tuple(axis for axis in axes if axis.name != "noise")
    axes, left_out = _runnable(study, nominal, axes, settings)
    if sensed:
        left_out = (*left_out, "The axis of sensor noise is left out: the sensors in the loop have their own.")
    cases = [(axis.change(nominal, value, omega_n), 0) for axis in axes for value in axis.values]
    by_probe = probed_runs(study, cases, methods, settings, progress)
    rms, p95 = (np.empty((len(methods), len(cases))) for _ in range(2))
    wrong = np.repeat([axis.frequency_error * value for axis in axes for value in axis.values], settings.draws)
    records = {}
    for name, runs in by_probe.items():
        record = runs.record(settings.draws)
        records[name] = replace(record, omega=record.omega + wrong)
    for k, method in enumerate(methods):
        progress("estimates", k / len(methods))
        record = records[probe_name(method)]
        rms[k], p95[k] = judged(relative_errors(record, method.estimate(record)), len(cases))
    ends = np.cumsum([len(axis.values) for axis in axes])[:-1]
    results = tuple(
        AxisResult(axis, *parts)
        for axis, *parts in zip(axes, np.split(rms, ends, axis=1), np.split(p95, ends, axis=1), strict=True)
    )
    hashes = {name: weights.hash for name, weights in networks.items()}
    names = tuple(method.name for method in methods)
    around = surroundings_in_words(study)
    return Stress(settings, names, results, omega_n / (2.0 * math.pi), hashes, around, left_out)


def _runnable(
    study: Study, nominal: WindowRecipe, axes: tuple[StressAxis, ...], settings: ComparisonSettings
) -> tuple[tuple[StressAxis, ...], tuple[str, ...]]:
    """The axes with the values alone that the converter can be run with, and a sentence on each other."""
    kept, sentences = [], []
    for axis in axes:
        recipes = {value: axis.change(nominal, value, study.converter.omega_n) for value in axis.values}
        values, left_out = runnable_values(study, recipes, axis.title, settings.seed)
        kept.append(replace(axis, values=values))
        sentences += left_out
    return tuple(kept), tuple(sentences)
