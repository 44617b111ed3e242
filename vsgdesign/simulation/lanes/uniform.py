"""Numbers that are the same for all runs of a loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import LoopSpec
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.field_feed import probe_of, settings_of_study

Array = NDArray[np.float64]


def uniform_values(spec: LoopSpec, study: Study, **others: float) -> Array:
    """The uniform numbers of a study in the order of the spec. ``others``: those of the demand, by name with ``__``
    for the dot."""
    settings = study.controller_settings()
    known: dict[str, float] = {
        "R_c": study.filter.R_c,
        "V_dc": study.converter.V_dc,
        **_flat(study.inner_gains, "inner_gains"),
        **_flat(settings, "settings"),
        **_flat(study.circuit(), "circuit"),
        **{name.replace("__", "."): value for name, value in others.items()},
    }
    return np.array([float(known[name]) for name in spec.uniform])


def listener_values(study: Study) -> dict[str, float]:
    """The shared numbers of a study's field estimators, by name with ``__`` for the dot."""
    settings = {f"field__{name}": float(value) for name, value in settings_of_study(study)._asdict().items()}
    return settings | {"V_rated_rms": study.converter.V_rated_rms, "allowed": float(probe_of(study).send)}


def _flat(record: Any, prefix: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, value in record._asdict().items():
        if hasattr(value, "_fields"):
            found |= _flat(value, f"{prefix}.{name}")
        elif not isinstance(value, Sequence):
            found[f"{prefix}.{name}"] = float(value)
    return found
