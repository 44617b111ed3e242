"""Trains the field estimator's network: Student-t likelihood, split by run, a conformal radius for each mode."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from vsgdesign.artifacts.field_weights import MODES, FieldLayers
from vsgdesign.equations.field.fusion import CHI_SQUARE_95, Posterior, posterior_distance
from vsgdesign.errors import Fault, StudyError
from vsgdesign.estimator.data_set import FieldCycles, Split
from vsgdesign.estimator.scores import evaluate
from vsgdesign.estimator.training import not_finite, too_few, torch_threads
from vsgdesign.execution.progress import Progress, silent

Array = NDArray[np.float64]

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
    _check(cycles, split, settings, seed)
    # Matrices of 24 × 24: threads would cost more than they save, and the order of their sums would decide the bits.
    with torch_threads(1):
        return _train(cycles, split, settings, seed, progress)


def _train(
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


def _check(cycles: FieldCycles, split: Split, settings: FieldTrainingSettings, seed: int) -> None:
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
