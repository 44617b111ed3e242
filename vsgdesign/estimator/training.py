"""From windows to a trained network: scaling, projection, training with restarts, folding, metrics."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from vsgdesign.artifacts.network_weights import Network, fit_scaling
from vsgdesign.errors import Fault, StudyError, counted
from vsgdesign.estimator.data_set import Split
from vsgdesign.estimator.levenberg_marquardt import Damping, Epoch, Fit, minimise
from vsgdesign.estimator.tanh_network import (
    NetworkProblem,
    Projection,
    Shape,
    initial_parameters,
    mean_squared_error,
    principal_components,
    with_ones,
)
from vsgdesign.execution.progress import Progress, silent

Array = NDArray[np.float64]

FORMS = ("components", "full")


@dataclass(frozen=True)
class TrainingSettings:
    """What is trained, and how. The defaults are those of the published network.

    With the ``form`` ``components`` the network is trained on principal components of the inputs: ``components`` of
    them, or with 0 those above the noise. With ``full`` it is trained on all inputs. Both give a network on all inputs.
    ``regularisation`` is the share γ of the parameters in the cost (:eq:`network-cost`). If a start does not reach the
    goal, another one follows, up to ``starts``, and the best by validation is taken.
    """

    hidden: int = 8
    form: str = "components"
    components: int = 0
    regularisation: float = 0.0
    starts: int = 4
    damping: Damping = field(default_factory=Damping)


@dataclass(frozen=True)
class SplitMetrics:
    """How good a network is on one part: number of windows, mean squared error of the scaled targets, and for each
    output the correlation and the rms error (Ω, H)."""

    windows: int
    mse: float
    correlation: tuple[float, ...]
    rms_error: tuple[float, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Training:
    """A trained network with the history of its training and its metrics.

    ``history`` and ``stop`` are those of the start that was taken, and ``epochs`` counts those of all starts.
    ``components`` is the number of inputs of the training, and ``metrics`` has one entry for each part of the split.
    """

    network: Network
    stop: str
    best_epoch: int
    history: tuple[Epoch, ...]
    epochs: int
    components: int
    metrics: dict[str, SplitMetrics]


def train_network(
    inputs: Array,
    targets: Array,
    split: Split,
    settings: TrainingSettings | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> Training:
    """Trains a network on windows (N, n) and their targets (N, 2); ``split`` assigns the rows to the three parts.

    The same seed gives the same network. Raises StudyError with every fault of data and settings.
    """
    settings = TrainingSettings() if settings is None else settings
    _check(inputs, targets, split, settings, seed)
    # Components are few: on a busy machine, threads that wait for each other cost a hundredfold of what they
    # save. And on one thread the same seed gives the same bits on any number of cores.
    with torch_threads(1 if settings.form == "components" else torch.get_num_threads()):
        return _train(inputs, targets, split, settings, seed, progress)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """PyTorch on so many threads within the block of ``with``."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _train(
    inputs: Array, targets: Array, split: Split, settings: TrainingSettings, seed: int, progress: Progress
) -> Training:
    scaling_in, scaling_out = fit_scaling(inputs[split.training]), fit_scaling(targets[split.training])
    scaled, wanted = scaling_in.apply(inputs), scaling_out.apply(targets)
    projection = _projection(scaled[split.training], settings)
    x = with_ones(torch.from_numpy(projection.project(scaled)))
    y = torch.from_numpy(wanted)
    shape = Shape(x.shape[1] - 1, settings.hidden, y.shape[1])
    problem = NetworkProblem(shape, x[split.training], y[split.training], settings.regularisation)
    kept = [(x[rows], y[rows]) for rows in (split.validation, split.test)]

    def scores(parameters: torch.Tensor) -> tuple[float, float]:
        validation, test = (mean_squared_error(shape, parameters, *part) for part in kept)
        return validation, test

    fits: list[Fit] = []
    while not fits or (fits[-1].stop != "goal" and len(fits) < settings.starts):
        first = initial_parameters(shape, seed, len(fits))
        fits.append(minimise(problem, first, settings.damping, scores, progress))
    best = min(fits, key=lambda fit: fit.score)
    hidden, output = (layer.numpy() for layer in shape.layers(best.x))
    W_1, b_1 = projection.fold(hidden[:, :-1], hidden[:, -1])
    network = Network(W_1, b_1, output[:, :-1], output[:, -1], scaling_in, scaling_out)
    return Training(
        network=network,
        stop=best.stop,
        best_epoch=best.epoch,
        history=best.history,
        epochs=sum(fit.history[-1].epoch for fit in fits),
        components=shape.inputs,
        metrics={part: split_metrics(network, inputs[rows], targets[rows]) for part, rows in vars(split).items()},
    )


def _projection(scaled: Array, settings: TrainingSettings) -> Projection:
    if settings.form == "full":
        n = scaled.shape[1]
        return Projection(np.zeros(n), np.eye(n))
    return principal_components(scaled, settings.components or None)


def split_metrics(network: Network, inputs: Array, targets: Array) -> SplitMetrics:
    """The metrics of a network on windows (N, n) with targets (N, 2); NaN if there are no windows."""
    if len(inputs) == 0:
        nothing = (math.nan,) * targets.shape[1]
        return SplitMetrics(0, math.nan, nothing, nothing)
    estimated = network.evaluate(inputs)
    mse = float(np.mean((network.outputs.apply(estimated) - network.outputs.apply(targets)) ** 2))
    rms = np.sqrt(np.mean((estimated - targets) ** 2, axis=0))
    return SplitMetrics(len(inputs), mse, _correlation(estimated, targets), tuple(rms.tolist()))


def _correlation(a: Array, b: Array) -> tuple[float, ...]:
    """The correlation of each column; NaN if a column is constant."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    size = np.sqrt(np.sum(a * a, axis=0) * np.sum(b * b, axis=0))
    with np.errstate(invalid="ignore", divide="ignore"):
        return tuple(np.where(size > 0.0, np.sum(a * b, axis=0) / size, np.nan).tolist())


def _check(inputs: Array, targets: Array, split: Split, settings: TrainingSettings, seed: int) -> None:
    faults = [*_data_faults(inputs, targets, split, settings.hidden), *_settings_faults(settings)]
    if seed < 0:
        faults.append(Fault("seed", str(seed), "must be a whole number, zero or more"))
    if faults:
        raise StudyError("training", faults)


def _data_faults(inputs: Array, targets: Array, split: Split, hidden: int) -> Iterator[Fault]:
    if inputs.ndim != 2 or targets.ndim != 2 or len(inputs) != len(targets) or targets.shape[-1] != 2:
        yield Fault("targets", str(targets.shape), f"must be (N, 2) for inputs of {inputs.shape}")
        return
    for name, values in (("inputs", inputs), ("targets", targets)):
        yield from not_finite(name, values, "row", "Leave these windows out.")
    yield from too_few(split, hidden)
    rows = np.concatenate([split.training, split.validation, split.test])
    if len(rows) and (rows.min() < 0 or rows.max() >= len(inputs)):
        yield Fault("split", f"{rows.min()} to {rows.max()}", f"has rows that {len(inputs)} windows have not")
    elif len(np.unique(rows)) != len(rows):
        yield Fault("split", str(len(rows)), "has a window twice", "A window is for one purpose only.")


def not_finite(name: str, values: Array, word: str, advice: str) -> Iterator[Fault]:
    """A fault if rows (N, n) of data are not finite; a row is a ``word``."""
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        yield Fault(name, counted(len(bad), word), f"not finite, first in row {bad[0]}", advice)


def too_few(split: Split, hidden: int) -> Iterator[Fault]:
    """A fault if too few rows are for the training of so many hidden units."""
    if len(split.training) < 2 * hidden:
        yield Fault("split.training", str(len(split.training)), f"too few for {hidden} hidden units")


def _settings_faults(settings: TrainingSettings) -> Iterator[Fault]:
    if settings.form not in FORMS:
        yield Fault("form", settings.form, f"must be one of {', '.join(FORMS)}")
    for name, least in (("hidden", 1), ("components", 0), ("starts", 1)):
        if getattr(settings, name) < least:
            yield Fault(name, str(getattr(settings, name)), f"must be at least {least}")
    if not 0.0 <= settings.regularisation < 1.0:
        yield Fault("regularisation", str(settings.regularisation), "must be from 0 to below 1")
    damping = settings.damping
    if not (0.0 < damping.mu <= damping.mu_max and damping.increase > 1.0 and 0.0 < damping.decrease < 1.0):
        needs = "needs 0 < mu ≤ mu_max, increase above 1, decrease between 0 and 1"
        yield Fault("damping", str(damping), needs)
    if damping.epochs < 0 or damping.checks < 1:
        yield Fault("damping", str(damping), "needs epochs of at least 0 and checks of at least 1")
