"""A trained estimator as data: layers, scaling, what its windows must be, what it was trained on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.guarded_file import GuardedFile, content_hash, is_number
from vsgdesign.study.given_files import WEIGHTS_BYTES

Array = NDArray[np.float64]

KIND = "vsgdesign network weights"
SCHEMA = 1
OUTPUTS = ("R_g", "L_g")
"""What the network's outputs are, in Ω and H."""


@dataclass(frozen=True, eq=False)
class Scaling:
    """Z-score with ``mean`` and ``deviation``, then ``low`` … ``high`` to −1 … 1, each per channel (:eq:`scaling`)."""

    mean: Array
    deviation: Array
    low: Array
    high: Array

    def __post_init__(self) -> None:
        fix_arrays(self)

    def gain_and_offset(self) -> tuple[Array, Array]:
        """α and β of αx + β."""
        gain = 2.0 / ((self.high - self.low) * self.deviation)
        return gain, -(self.mean + self.low * self.deviation) * gain - 1.0

    def apply(self, x: Array) -> Array:
        """Values to about −1 … 1, step by step as defined."""
        return 2.0 * ((x - self.mean) / self.deviation - self.low) / (self.high - self.low) - 1.0

    def restore(self, u: Array) -> Array:
        """The inverse of ``apply``."""
        return ((u + 1.0) * 0.5 * (self.high - self.low) + self.low) * self.deviation + self.mean


def fit_scaling(x: Array) -> Scaling:
    """The scaling of the rows of x (N, n). A channel that never changes is scaled to zero."""
    mean, deviation = x.mean(axis=0), x.std(axis=0)
    # A constant's deviation is rounding of its mean.
    moves = deviation > 1e-12 * np.maximum(np.abs(mean), 1e-300)
    deviation = np.where(moves, deviation, 1.0)
    z = (x - mean) / deviation
    return Scaling(mean, deviation, np.where(moves, z.min(axis=0), -1.0), np.where(moves, z.max(axis=0), 1.0))


@dataclass(frozen=True, eq=False)
class Network:
    """tanh layer W_1 (h, n), b_1 (h,); linear layer W_2 (m, h), b_2 (m,); scaling of inputs and outputs."""

    W_1: Array
    b_1: Array
    W_2: Array
    b_2: Array
    inputs: Scaling
    outputs: Scaling

    def __post_init__(self) -> None:
        fix_arrays(self)

    def evaluate(self, x: Array) -> Array:
        """(N, n) to (N, m) in SI, unfolded: scale, network, scale back (:eq:`network`)."""
        hidden = np.tanh(self.inputs.apply(x) @ self.W_1.T + self.b_1)
        return self.outputs.restore(hidden @ self.W_2.T + self.b_2)


@dataclass(frozen=True)
class WindowFormat:
    """What a window is: ``samples`` of each signal, ``sample_interval`` (s) apart, all samples of a signal in a row.

    ``channels``: ``phase_a``, ``alpha_beta`` or ``dq``, voltages (V) before currents (A). ``synchronised``: windows
    start at a known phase of the grid's voltage, so the weights mean nothing to whoever does not know it.
    """

    samples: int
    sample_interval: float
    channels: str
    synchronised: bool

    @property
    def period(self) -> float:
        """Time from one window's first sample to the next window's, s."""
        return self.samples * self.sample_interval

    @property
    def length(self) -> int:
        """Numbers in a window."""
        return 2 * CHANNELS.get(self.channels, 0) * self.samples


CHANNELS = {"phase_a": 1, "alpha_beta": 2, "dq": 2}
"""Components of a voltage or current by name."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NetworkWeights:
    """All of a weights file. Equal contents have equal hashes."""

    network: Network
    window: WindowFormat
    trained_on: dict[str, tuple[float, float]]
    """Least and largest of R_g (Ω), L_g (H), and of whatever else is known of the training part (P, Q, ...)."""
    data_hash: str = ""
    recipe: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    training: dict[str, Any] = field(default_factory=dict)
    """Settings, stop reason and, per split, mse and correlation."""
    provenance: dict[str, str] = field(default_factory=dict)

    @property
    def hash(self) -> str:
        """SHA-256 of the content."""
        return content_hash(weights_document(self))


def weights_document(weights: NetworkWeights) -> dict[str, Any]:
    """The content of the file, without its hash, in JSON's types."""
    lists = asdict(weights)
    network = {name: _lists(value) for name, value in lists.pop("network").items()}
    return {"kind": KIND, "schema": SCHEMA, "outputs": list(OUTPUTS), "network": network} | plain(lists)


def write_network_weights(weights: NetworkWeights, path: str | Path) -> None:
    """The weights as JSON with their sha256: equal weights give equal bytes. Whole or not at all.

    Raises ArtifactError with every fault where they are no weights.
    """
    WEIGHTS_FILE.write(weights, path)


def read_network_weights(path: str | Path) -> NetworkWeights:
    """Weights from their file.

    Raises ArtifactError with what to do where the file is missing, cut short, of another kind or a newer schema,
    changed since it was written, or holds what is no network.
    """
    return WEIGHTS_FILE.read(path)


def _from_document(document: dict[str, Any]) -> NetworkWeights:
    if document["outputs"] != list(OUTPUTS):
        raise ValueError(f"outputs are {document['outputs']}, must be {list(OUTPUTS)}")
    values = {f.name: document[f.name] for f in fields(NetworkWeights)}
    network = dict(values["network"])
    network |= {name: Scaling(**network[name]) for name in ("inputs", "outputs")}
    values["network"] = Network(**network)
    values["window"] = WindowFormat(**values["window"])
    values["trained_on"] = {name: tuple(pair) for name, pair in values["trained_on"].items()}
    return NetworkWeights(**values)


def _faults(weights: NetworkWeights) -> Iterator[str]:
    network, window = weights.network, weights.window
    h, n, m = len(network.b_1), network.W_1.shape[-1], len(OUTPUTS)
    wanted: dict[str, tuple[Array, tuple[int, ...]]] = {
        "W_1": (network.W_1, (h, n)),
        "b_1": (network.b_1, (h,)),
        "W_2": (network.W_2, (m, h)),
        "b_2": (network.b_2, (m,)),
    }
    for side, size in (("inputs", n), ("outputs", m)):
        scaling = getattr(network, side)
        wanted |= {f"{side}.{f.name}": (getattr(scaling, f.name), (size,)) for f in fields(Scaling)}
    yield from array_faults(wanted)
    for name, size in (("inputs", n), ("outputs", m)):
        yield from _scaling_faults(name, getattr(network, name), size)
    if window.channels not in CHANNELS:
        yield f"window.channels: {window.channels!r} must be one of {', '.join(CHANNELS)}"
    elif window.length != n:
        yield f"window: {window.samples} samples of {window.channels} are {window.length} inputs, but W_1 has {n}"
    if not (isinstance(window.sample_interval, float) and 0.0 < window.sample_interval < math.inf):
        yield f"window.sample_interval: {window.sample_interval!r} must be a positive time in s"
    if not isinstance(window.synchronised, bool):
        yield f"window.synchronised: {window.synchronised!r} must be true or false"
    for name in OUTPUTS:
        if name not in weights.trained_on:
            yield f"trained_on.{name}: is missing"
    for name, pair in weights.trained_on.items():
        if len(pair) != 2 or not all(map(is_number, pair)) or pair[0] > pair[1]:
            yield f"trained_on.{name}: must be two numbers, the smaller first"
            return
    if set(OUTPUTS) <= weights.trained_on.keys() and all(
        getattr(network.outputs, f.name).shape == (m,) for f in fields(Scaling)
    ):
        yield from _box_faults(weights)


def _scaling_faults(side: str, scaling: Scaling, size: int) -> Iterator[str]:
    """What a fit cannot have given: values of mean 0 and deviation 1 have (:eq:`scaling`) low < 0 < high, and their
    variance is at most −low·high."""
    if any(getattr(scaling, f.name).shape != (size,) for f in fields(Scaling)):
        return
    bad = ~((scaling.low < scaling.high) & (-scaling.low * scaling.high >= 1.0 - 1e-9))
    if bad.any():
        k = int(np.argmax(bad))
        yield (
            f"{side}.low[{k}] = {scaling.low[k]:.6g}, {side}.high[{k}] = {scaling.high[k]:.6g}: low must be below "
            "high, and values of deviation 1 between them have −low·high of at least 1"
        )


def _box_faults(weights: NetworkWeights) -> Iterator[str]:
    """The outputs are scaled from the least to the largest value that they were trained on."""
    outputs = weights.network.outputs
    for k, name in enumerate(OUTPUTS):
        low, high = weights.trained_on[name]
        for word, value, made in (
            ("least", low, outputs.restore(-np.ones(2))[k]),
            ("largest", high, outputs.restore(np.ones(2))[k]),
        ):
            if low < high and abs(value - made) > 1e-9 * max(abs(low), abs(high)):
                yield f"trained_on.{name}: the {word} is {value:.9g}, the scaling of outputs gives {made:.9g}"


def array_faults(wanted: Mapping[str, tuple[Array, tuple[int, ...]]]) -> Iterator[str]:
    """What is wrong with arrays of a network, each by its name with the shape that it must have."""
    for name, (values, shape) in wanted.items():
        if values.shape != shape:
            yield f"{name}: has shape {values.shape}, must be {shape}"
        elif not np.all(np.isfinite(values)):
            yield f"{name}: holds what is not a number"
        elif name.endswith("deviation") and np.any(values <= 0.0):
            yield f"{name}: must be positive"


def _lists(value: Any) -> Any:
    return {name: _lists(item) for name, item in value.items()} if isinstance(value, dict) else value.tolist()


def fix_arrays(instance: Any) -> None:
    """Arrays of a frozen instance become read-only copies in float64."""
    for f in fields(instance):
        value: ArrayLike | Scaling = getattr(instance, f.name)
        if not isinstance(value, Scaling):
            array = np.array(value, dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(instance, f.name, array)


WEIGHTS_FILE = GuardedFile(
    kind=KIND,
    schema=SCHEMA,
    what="a trained network",
    origin='written by "vsgdesign estimator train"',
    again="train again",
    document=weights_document,
    build=_from_document,
    faults=_faults,
    most_bytes=WEIGHTS_BYTES,
)
