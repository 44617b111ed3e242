"""Trains both networks with PyTorch.

From windows: scaling, projection, training with restarts, folding, metrics. From cycles of the field estimator:
Student-t likelihood, split by run, a conformal radius for each mode.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from vsgdesign.artifacts.field_weights import MODES, FieldLayers
from vsgdesign.artifacts.network_weights import Network, fit_scaling
from vsgdesign.equations.field.fusion import CHI_SQUARE_95, Posterior, posterior_distance
from vsgdesign.errors import Fault, StudyError, counted
from vsgdesign.estimator.data_set import FieldCycles, Split
from vsgdesign.estimator.levenberg_marquardt import (
    Damping,
    Epoch,
    Fit,
    NetworkProblem,
    Projection,
    Shape,
    initial_parameters,
    mean_squared_error,
    minimise,
    principal_components,
    with_ones,
)
from vsgdesign.estimator.scores import evaluate
from vsgdesign.execution.executors import Progress, silent

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


FREEDOM = 6.0
"""Degrees of freedom ν of the Student-t distribution: a few wrong answers must not decide the fit."""

FIRST_DEVIATION = -2.5
"""Logarithm of the standard deviations that the untrained network answers."""


@dataclass(frozen=True)
class FieldTrainingSettings:
    """What is trained, and how."""

    hidden: int = 24
    """tanh units in each of the two hidden layers."""
    epochs: int = 80
    batch: int = 1024
    rate: float = 3e-3
    """First step size of Adam; it falls to a hundredth of this as half a cosine."""
    decay: float = 0.5
    """Share of the weights that decays in a step, over the step size: few runs must not be learnt by heart."""
    weight: float = 7.0
    """Weight of the cycles in the ``weighted`` seconds after a change; all others have 1."""
    weighted: float = 0.35


@dataclass(frozen=True, eq=False)
class FieldTraining:
    """A trained network and how it got there."""

    layers: FieldLayers
    radius_squared: dict[str, float]
    history: dict[str, Array]
    """``epoch``, and the mean loss of ``training`` and ``validation`` after it."""
    best_epoch: int


def train_layers(
    cycles: FieldCycles,
    split: Split,
    settings: FieldTrainingSettings | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> FieldTraining:
    """Trains on some runs and takes the epoch with the least loss on the validation runs (:eq:`field-loss`).

    The same arguments give the same network, on one thread. Raises StudyError with every fault of data and settings.
    """
    settings = FieldTrainingSettings() if settings is None else settings
    _check_layers(cycles, split, settings, seed)
    # Matrices of 24 × 24: threads would cost more than they save, and the order of their sums would decide the bits.
    with torch_threads(1):
        return _train_layers(cycles, split, settings, seed, progress)


def _train_layers(
    cycles: FieldCycles, split: Split, settings: FieldTrainingSettings, seed: int, progress: Progress
) -> FieldTraining:
    mean, deviation = _scaling(cycles.features[split.training])
    x_all = torch.from_numpy(((cycles.features - mean) / deviation).astype(np.float32))
    y_all = torch.from_numpy(cycles.targets.astype(np.float32))
    soon = cycles.since_change < settings.weighted
    w_all = torch.from_numpy(np.where(soon, settings.weight, 1.0).astype(np.float32))
    parts = {name: (x_all[rows], y_all[rows], w_all[rows]) for name, rows in vars(split).items()}
    x, y, w = parts["training"]
    source = torch.Generator().manual_seed(seed)
    parameters = _first_parameters(x.shape[1], settings.hidden, source)
    optimiser = torch.optim.AdamW(parameters, settings.rate, weight_decay=settings.decay)
    best, kept, lines = math.inf, [p.detach().clone() for p in parameters], []
    best_epoch = 0
    for epoch in range(settings.epochs):
        fall = 0.5 * (1.0 + math.cos(math.pi * epoch / settings.epochs))
        for group in optimiser.param_groups:
            group["lr"] = settings.rate * (0.01 + 0.99 * fall)
        order = torch.randperm(len(x), generator=source)
        for rows in order.split(settings.batch):
            loss = _loss(parameters, x[rows], y[rows], w[rows])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        with torch.no_grad():
            losses = [float(_loss(parameters, *parts[name])) for name in ("training", "validation")]
        lines.append((epoch, *losses))
        if losses[1] < best:
            best, best_epoch = losses[1], epoch
            kept = [p.detach().clone() for p in parameters]
        progress("training", (epoch + 1) / settings.epochs)
    arrays = [p.numpy().astype(np.float64) for p in kept]
    names = ("W_1", "b_1", "W_2", "b_2", "W_3", "b_3")
    layers = FieldLayers(mean=mean, deviation=deviation, **dict(zip(names, arrays, strict=True)))
    epochs, *both = np.array(lines, dtype=float).T
    history: dict[str, Array] = {"epoch": epochs, "training": both[0], "validation": both[1]}
    rows = split.validation
    return FieldTraining(layers, conformal_radii(layers, cycles, rows), history, best_epoch)


def _scaling(features: Array) -> tuple[Array, Array]:
    """Mean and deviation of each feature; a feature that never moves is only centred."""
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    return mean, np.where(deviation > 1e-9 * np.maximum(np.abs(mean), 1.0), deviation, 1.0)


def _first_parameters(inputs: int, hidden: int, source: torch.Generator) -> list[torch.Tensor]:
    """Random hidden layers; the output layer begins with no shift and a deviation of 8 %."""
    outputs = len(Posterior._fields)
    made = []
    for rows, columns in ((hidden, inputs), (hidden, hidden)):
        made += [torch.randn(rows, columns, generator=source) / math.sqrt(columns), torch.zeros(rows)]
    bias = torch.zeros(outputs)
    bias[2:4] = FIRST_DEVIATION
    made += [torch.zeros(outputs, hidden), bias]
    return [tensor.requires_grad_() for tensor in made]


def _loss(parameters: list[torch.Tensor], x: torch.Tensor, y: torch.Tensor, w: torch.Tensor) -> torch.Tensor:
    W_1, b_1, W_2, b_2, W_3, b_3 = parameters
    out = torch.tanh(torch.tanh(x @ W_1.T + b_1) @ W_2.T + b_2) @ W_3.T + b_3
    log_first, log_second = (torch.clamp(out[:, k], -6.0, 2.0) for k in (2, 3))
    apart = y - out[:, :2]
    u = apart[:, 0] * torch.exp(-log_first)
    v = (apart[:, 1] - out[:, 4] * apart[:, 0]) * torch.exp(-log_second)
    inner = torch.log1p((u * u + v * v) / FREEDOM)
    return torch.mean(w * (log_first + log_second + 0.5 * (FREEDOM + 2.0) * inner))


def conformal_radii(layers: FieldLayers, cycles: FieldCycles, rows: NDArray[np.int64]) -> dict[str, float]:
    """Per mode the squared radius that contains 95 % of the true values of some runs (:eq:`field-conformal`).

    A mode with fewer than 100 cycles there has the radius of a Gaussian with the network's own covariance, or that of
    all cycles if this is larger.
    """
    y = cycles.targets[rows]
    distance = posterior_distance(y[:, 0], y[:, 1], evaluate(layers, cycles.features[rows]))
    of_all = max(float(np.quantile(distance, 0.95)), CHI_SQUARE_95)
    found = {}
    for code, name in enumerate(MODES):
        part = distance[cycles.mode[rows] == code]
        found[name] = float(np.quantile(part, 0.95)) if len(part) >= 100 else of_all
    return found


def _check_layers(cycles: FieldCycles, split: Split, settings: FieldTrainingSettings, seed: int) -> None:
    faults: list[Fault] = []
    for name in ("features", "answer", "truth"):
        faults += not_finite(name, getattr(cycles, name), "cycle", "Leave them out.")
    for name in ("hidden", "epochs", "batch"):
        if getattr(settings, name) < 1:
            faults.append(Fault(name, str(getattr(settings, name)), "must be at least 1"))
    for name in ("rate", "weight", "weighted"):
        if not (math.isfinite(getattr(settings, name)) and getattr(settings, name) > 0.0):
            faults.append(Fault(name, str(getattr(settings, name)), "must be positive"))
    faults += too_few(split, settings.hidden)
    if seed < 0:
        faults.append(Fault("seed", str(seed), "must be a whole number, zero or more"))
    if faults:
        raise StudyError("training", faults)
