"""From data to weights, with what a report shows of how they came about, in plain arrays without PyTorch."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts import provenance
from vsgdesign.artifacts.field_weights import FieldWeights
from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.network_weights import NetworkWeights, WindowFormat
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.estimator.data_set import DataSet, FieldCycles
from vsgdesign.estimator.recipes import FieldRecipe, WindowRecipe
from vsgdesign.estimator.scores import GroupScore, changes_by_name, field_scores, short_document
from vsgdesign.execution.executors import Progress

Array = NDArray[np.float64]

HISTORY = ("epoch", "cost", "validation", "test", "gradient", "mu", "checks")
"""Columns of a training's history."""


@dataclass(frozen=True, eq=False)
class PartOfData:
    """Windows of one purpose: true and estimated (R_g, L_g), (N, 2) in Ω and H, and what was made of them."""

    truth: Array
    estimate: Array
    mse: float
    """Of the targets scaled to −1 … 1."""
    correlation: tuple[float, float]
    errors: dict[str, dict[str, tuple[float, float]]]
    """Of ``rest`` and ``after_change``, windows before and after a run's change: median and 95th percentile of
    |Ẑ − Z|/|Z| at nominal frequency (``Z``) and of the relative errors of ``R_g`` and ``L_g``. NaN without windows."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Trained:
    """What every training leaves beside its weights."""

    history: dict[str, Array]
    """Arrays over epochs by name."""
    best_epoch: int
    timing_s: dict[str, float] = field(default_factory=dict)
    """Wall time of making the data (``windows`` or ``runs``) and of ``training``."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TrainedEstimator(Trained):
    """A network of windows and how it came about. Its history is of the start that was taken, by HISTORY."""

    weights: NetworkWeights
    parts: dict[str, PartOfData]
    """``training``, ``validation`` and ``test``."""
    stop: str
    epochs: int
    """Over all starts."""
    components: int
    draws: dict[str, Any]
    """How its scenarios came about (:attr:`vsgdesign.estimator.data_set.DataSet.draws`)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TrainedFieldNetwork(Trained):
    """The field estimator's network and how it came about. Its history has ``epoch``, ``training`` and ``validation``
    loss."""

    weights: FieldWeights
    scores: dict[str, dict[str, GroupScore]]
    """The three ways on the test runs, by way and group (:mod:`vsgdesign.estimator.scores`)."""
    runs: dict[str, int]
    """Runs of each part."""
    cycles: dict[str, int]
    """Cycles of each part."""
    broken: int
    """Runs that diverged and ended there."""
    changes: dict[str, int]
    """Changes of each kind in the test runs."""


def require_torch() -> None:
    """Raises InfeasibleStudyError where PyTorch is missing."""
    if importlib.util.find_spec("torch") is None:
        raise InfeasibleStudyError(
            'training needs PyTorch, which is not installed: pip install "vsgdesign[train]" brings it, or give trained '
            'weights (weights = "FILE.json" in [estimator]).'
        )


def train_on_windows(
    data: DataSet,
    recipe: WindowRecipe,  # noqa: ARG001 - every training takes it; the data of windows have their own
    size: Mapping[str, int],
    seed: int,
    progress: Progress,
) -> TrainedEstimator:
    """Trains a network of windows and evaluates it. ``size`` has ``hidden``, ``components`` and ``starts``."""
    from vsgdesign.estimator.training import TrainingSettings, train_network

    settings = TrainingSettings(hidden=size["hidden"], components=size["components"], starts=size["starts"])
    targets, split = np.column_stack([data.R_g, data.L_g]), data.split(seed=seed)
    training = train_network(data.windows, targets, split, settings, seed=seed, progress=progress)
    omega_n = data.header["omega_n"]
    parts = {}
    for name, rows in vars(split).items():
        metrics = training.metrics[name]
        R, L = metrics.correlation
        truth, estimate = targets[rows], training.network.evaluate(data.windows[rows])
        errors = {
            kind: relative_errors(truth[chosen], estimate[chosen], omega_n)
            for kind, chosen in (("rest", ~data.after_change[rows]), ("after_change", data.after_change[rows]))
        }
        parts[name] = PartOfData(truth, estimate, metrics.mse, (R, L), errors)
    box = {name: getattr(data, name)[split.training] for name in ("R_g", "L_g", "P", "Q")}
    converter = {name: data.header[name] for name in ("S_rated", "V_rated_rms")} | {"f_n": omega_n / (2.0 * math.pi)}
    weights = NetworkWeights(
        network=training.network,
        window=WindowFormat(data.samples, data.sample_interval, data.channels, data.synchronised),
        trained_on={name: (float(values.min()), float(values.max())) for name, values in box.items()},
        data_hash=data.hash,
        recipe=dict(data.header["recipe"]),
        seed=seed,
        training={
            "settings": asdict(settings),
            "stop": training.stop,
            "epochs": training.epochs,
            "components": training.components,
            "parts": {
                name: {"mse": part.mse, "correlation": part.correlation, "errors": plain(part.errors)}
                for name, part in parts.items()
            },
            "converter": converter,
            "draws": data.draws,
        },
        provenance=dict(provenance()),
    )
    history = {name: np.array([getattr(line, name) for line in training.history], dtype=float) for name in HISTORY}
    return TrainedEstimator(
        weights=weights,
        parts=parts,
        history=history,
        stop=training.stop,
        best_epoch=training.best_epoch,
        epochs=training.epochs,
        components=training.components,
        draws=data.draws,
    )


def train_on_cycles(
    cycles: FieldCycles, recipe: FieldRecipe, size: Mapping[str, int], seed: int, progress: Progress
) -> TrainedFieldNetwork:
    """Trains the field estimator's network and judges the three ways on the test runs. ``size`` has ``hidden``."""
    from vsgdesign.estimator.training import FieldTrainingSettings, train_layers

    settings = FieldTrainingSettings(
        hidden=size["hidden"], epochs=recipe.epochs, weight=recipe.weight, weighted=recipe.weighted
    )
    split = cycles.split(seed)
    training = train_layers(cycles, split, settings, seed, progress)
    test = cycles.rows(split.test)
    scores = field_scores(test, training.layers, training.radius_squared, recipe.gate)
    runs = {name: len(np.unique(cycles.run[rows])) for name, rows in vars(split).items()}
    weights = FieldWeights(
        features=cycles.names,
        layers=training.layers,
        radius_squared=training.radius_squared,
        gate=recipe.gate,
        converters=tuple(cycles.header["converters"]),
        data_hash=cycles.hash,
        recipe=dict(cycles.header["recipe"]),
        seed=seed,
        training={
            "settings": asdict(settings),
            "best_epoch": training.best_epoch,
            "loss": {name: float(training.history[name][training.best_epoch]) for name in ("training", "validation")},
            "runs": runs,
            "test": short_document(scores),
        },
        provenance=dict(provenance()),
    )
    return TrainedFieldNetwork(
        weights=weights,
        scores=scores,
        history=training.history,
        best_epoch=training.best_epoch,
        runs=runs,
        cycles={name: len(rows) for name, rows in vars(split).items()},
        broken=len(np.unique(cycles.run[cycles.broken])),
        changes=changes_by_name(test),
    )


def relative_errors(truth: Array, estimate: Array, omega: float) -> dict[str, tuple[float, float]]:
    """Median and 95th percentile of |Ẑ − Z|/|Z| at ω (rad/s), and of |error|/truth of R_g and L_g; (N, 2) in Ω and H.

    NaN without rows, and of R_g on a grid without resistance infinite.
    """
    apart, ohm = np.abs(estimate - truth), np.array([1.0, omega])
    with np.errstate(divide="ignore", invalid="ignore"):
        values = {
            "Z": np.hypot(*(apart * ohm).T) / np.hypot(*(truth * ohm).T),
            "R_g": apart[:, 0] / truth[:, 0],
            "L_g": apart[:, 1] / truth[:, 1],
        }
    if len(truth) == 0:
        return dict.fromkeys(values, (math.nan, math.nan))
    return {name: (float(np.median(one)), float(np.percentile(one, 95.0))) for name, one in values.items()}
