"""The trained network of the field estimator as data: layers, features, radii, gate, what it was trained on."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.guarded_file import GuardedFile, content_hash, is_number
from vsgdesign.artifacts.network_weights import array_faults, fix_arrays
from vsgdesign.equations.field.fusion import GateLimits, Posterior
from vsgdesign.study.given_files import WEIGHTS_BYTES

Array = NDArray[np.float64]

KIND = "vsgdesign field network weights"
SCHEMA = 1

MODES = ("learning", "tracking", "doubt")
"""States of the recursions, each of which has its own radius, in the order of their number."""

PACKAGED = Path(__file__).parent / "weights" / "field.json"
"""The weights that come with the package."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FieldLayers:
    """W_3 tanh(W_2 tanh(W_1 (x − mean)/deviation + b_1) + b_2) + b_3 (:eq:`field-network`)."""

    mean: Array
    deviation: Array
    W_1: Array
    b_1: Array
    W_2: Array
    b_2: Array
    W_3: Array
    b_3: Array

    def __post_init__(self) -> None:
        fix_arrays(self)


@dataclass(frozen=True, eq=False, kw_only=True)
class FieldWeights:
    """All of a file of field weights. Equal contents have equal hashes."""

    features: tuple[str, ...]
    """Names of the inputs, in order: those of the recursions' FieldFeatures."""
    layers: FieldLayers
    radius_squared: dict[str, float]
    """Per mode: square of the radius that contains 95 % of the answers in the validation runs."""
    gate: GateLimits
    converters: tuple[dict[str, Any], ...]
    """The converters that it was trained on: name, S_rated (VA), V_rated_rms (V), f_n (Hz), T_s (s)."""
    data_hash: str = ""
    recipe: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    training: dict[str, Any] = field(default_factory=dict)
    """How the training went, and the comparison with the recursions alone on the test runs."""
    provenance: dict[str, str] = field(default_factory=dict)

    @property
    def hash(self) -> str:
        """SHA-256 of the content."""
        return content_hash(weights_document(self))

    @property
    def radii(self) -> tuple[float, ...]:
        """``radius_squared`` in the order of MODES."""
        return tuple(self.radius_squared[mode] for mode in MODES)


def weights_document(weights: FieldWeights) -> dict[str, Any]:
    """The content of the file, without its hash, in JSON's types."""
    values = {f.name: getattr(weights, f.name) for f in fields(weights) if f.name not in ("layers", "gate")}
    layers = {name: value.tolist() for name, value in asdict(weights.layers).items()}
    return {"kind": KIND, "schema": SCHEMA, "layers": layers, "gate": weights.gate._asdict()} | plain(values)


def read_field_weights(path: str | Path | None = None) -> FieldWeights:
    """Weights from their file; the packaged ones without a path.

    Raises ArtifactError with what to do where the file is missing, cut short, of another kind or a newer schema,
    changed since it was written, or holds what is no network.
    """
    return FIELD_WEIGHTS_FILE.read(PACKAGED if path is None else path)


def _from_document(document: dict[str, Any]) -> FieldWeights:
    values = {f.name: document[f.name] for f in fields(FieldWeights)}
    values["features"] = tuple(values["features"])
    values["layers"] = FieldLayers(**values["layers"])
    values["gate"] = GateLimits(**values["gate"])
    values["converters"] = tuple(values["converters"])
    return FieldWeights(**values)


def _faults(weights: FieldWeights) -> Iterator[str]:
    yield from _layer_faults(weights)
    names = weights.features
    if not all(isinstance(name, str) for name in names) or len(set(names)) != len(names):
        yield "features: must be different names"
    for mode in MODES:
        value = weights.radius_squared.get(mode)
        if not (is_number(value) and value > 0.0):  # type: ignore[operator]
            yield f"radius_squared.{mode}: {value!r} must be a positive number"
    yield from _gate_faults(weights.gate)
    if not weights.converters:
        yield "converters: names none, must name those that the network was trained on"
    for k, converter in enumerate(weights.converters):
        for name in ("S_rated", "V_rated_rms", "f_n", "T_s"):
            value = converter.get(name)
            if not (is_number(value) and value > 0.0):  # type: ignore[operator]
                yield f"converters[{k}].{name}: {value!r} must be a positive number"


def _layer_faults(weights: FieldWeights) -> Iterator[str]:
    layers, n, m = weights.layers, len(weights.features), len(Posterior._fields)
    h_1, h_2 = layers.b_1.size, layers.b_2.size
    wanted = {
        "mean": (n,),
        "deviation": (n,),
        "W_1": (h_1, n),
        "b_1": (h_1,),
        "W_2": (h_2, h_1),
        "b_2": (h_2,),
        "W_3": (m, h_2),
        "b_3": (m,),
    }
    yield from array_faults({f"layers.{name}": (getattr(layers, name), shape) for name, shape in wanted.items()})


def _gate_faults(gate: GateLimits) -> Iterator[str]:
    for name, value in gate._asdict().items():
        if not (is_number(value) and value >= 0.0):
            yield f"gate.{name}: {value!r} must be a number, zero or more"
            return
    if not (gate.first_refuted <= gate.first <= gate.last):
        yield "gate: needs first_refuted ≤ first ≤ last"
    if not 0.0 < gate.confident < math.inf:
        yield f"gate.confident: {gate.confident!r} must be positive"


FIELD_WEIGHTS_FILE = GuardedFile(
    kind=KIND,
    schema=SCHEMA,
    what="a trained network of the field estimator",
    origin='written by "vsgdesign estimator train --recipe field"',
    again="train again",
    document=weights_document,
    build=_from_document,
    faults=_faults,
    most_bytes=WEIGHTS_BYTES,
)
