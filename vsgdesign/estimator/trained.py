"""From a study and a recipe to weights, with the data of a report on the training, in plain arrays without PyTorch."""

from __future__ import annotations

import importlib.util
import math
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts import provenance
from vsgdesign.artifacts.network_weights import NetworkWeights, WindowFormat
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.estimator.data_set import DataSet, check_enough
from vsgdesign.estimator.recipes import WindowRecipe
from vsgdesign.estimator.windows import generate_windows
from vsgdesign.execution.executors import How
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.parameters.study import Study

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
class TrainedEstimator:
    """Weights and how they came about."""

    weights: NetworkWeights
    parts: dict[str, PartOfData]
    """``training``, ``validation`` and ``test``."""
    history: dict[str, Array]
    """An array over epochs for each of HISTORY, of the start that was taken."""
    stop: str
    best_epoch: int
    epochs: int
    """Over all starts."""
    components: int
    draws: dict[str, Any]
    """How its scenarios came about (:attr:`vsgdesign.estimator.data_set.DataSet.draws`)."""
    timing_s: dict[str, float]
    """Wall time of ``windows`` and ``training``."""


def train_estimator(
    study: Study,
    recipe: WindowRecipe,
    *,
    seed: int = 0,
    hidden: int | None = None,
    components: int | None = None,
    starts: int | None = None,
    out: str | Path | None = None,
    progress: Progress = silent,
    **how: Unpack[How],
) -> TrainedEstimator:
    """Makes the windows of a recipe, trains a network on them and evaluates it. Values that are None are the recipe's.

    The same arguments give the same weights. The windows, and the finished blocks of an interrupted call, are saved in
    ``out``, and ``how`` says how they are made. An interrupted training, which takes seconds, raises KeyboardInterrupt.
    Raises InfeasibleStudyError without PyTorch, and the errors of :func:`vsgdesign.estimator.windows.generate_windows`.
    """
    require_torch()
    check_enough(recipe.scenarios, "scenarios")
    begin = time.perf_counter()
    data = generate_windows(study, recipe, seed, out=out, progress=progress, **how)
    timing = {"windows": time.perf_counter() - begin}
    network = {
        name: getattr(recipe, name) if value is None else value
        for name, value in (("hidden", hidden), ("components", components), ("starts", starts))
    }
    trained = train_on(study, data, seed=seed, progress=progress, **network)
    timing["training"] = time.perf_counter() - begin - timing["windows"]
    trained.timing_s.update(timing)
    return trained


def require_torch() -> None:
    """Raises InfeasibleStudyError where PyTorch is missing."""
    if importlib.util.find_spec("torch") is None:
        raise InfeasibleStudyError(
            'training needs PyTorch, which is not installed: pip install "vsgdesign[train]" brings it, or give trained '
            'weights (weights = "FILE.json" in [estimator]).'
        )


def train_on(
    study: Study, data: DataSet, *, seed: int, hidden: int, components: int, starts: int, progress: Progress = silent
) -> TrainedEstimator:
    """Trains a network on an existing data set and evaluates it."""
    require_torch()
    from vsgdesign.estimator.training import TrainingSettings, train_network

    settings = TrainingSettings(hidden=hidden, components=components, starts=starts)
    targets, split = np.column_stack([data.R_g, data.L_g]), data.split(seed=seed)
    training = train_network(data.windows, targets, split, settings, seed=seed, progress=progress)
    if training.stop == "interrupted":
        raise KeyboardInterrupt
    parts = {}
    for name, rows in vars(split).items():
        metrics = training.metrics[name]
        R, L = metrics.correlation
        truth, estimate = targets[rows], training.network.evaluate(data.windows[rows])
        errors = {
            kind: relative_errors(truth[chosen], estimate[chosen], study.converter.omega_n)
            for kind, chosen in (("rest", ~data.after_change[rows]), ("after_change", data.after_change[rows]))
        }
        parts[name] = PartOfData(truth, estimate, metrics.mse, (R, L), errors)
    box = {name: getattr(data, name)[split.training] for name in ("R_g", "L_g", "P", "Q")}
    c = study.converter
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
                name: {"mse": part.mse, "correlation": part.correlation, "errors": _finite(part.errors)}
                for name, part in parts.items()
            },
            "converter": {"S_rated": c.S_rated, "V_rated_rms": c.V_rated_rms, "f_n": c.omega_n / (2.0 * math.pi)},
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
        timing_s={},
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


def _finite(errors: dict[str, dict[str, tuple[float, float]]]) -> dict[str, Any]:
    """For a file: what is no number is None."""
    return {
        kind: {name: [value if math.isfinite(value) else None for value in pair] for name, pair in found.items()}
        for kind, found in errors.items()
    }
