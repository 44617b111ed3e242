"""The state of an estimator as a JSON document, with every number the same to the last bit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from vsgdesign.errors import ArtifactError


def memory_document(state: Any) -> Any:
    """A state (a NamedTuple of numbers, arrays and other states) in JSON's types; NaN is None."""
    if hasattr(state, "_asdict"):
        return {name: memory_document(value) for name, value in state._asdict().items()}
    if isinstance(state, np.ndarray):
        parts = state.view(float) if np.iscomplexobj(state) else state
        return {"shape": list(state.shape), "values": [memory_document(float(value)) for value in parts.ravel()]}
    if isinstance(state, complex):
        return [memory_document(state.real), memory_document(state.imag)]
    if isinstance(state, int) and not isinstance(state, bool):
        return state
    return float(state) if math.isfinite(state) else None


def memory_of(document: Any, like: Any, where: str = "state.memory") -> Any:
    """The state of a document. ``like`` is any state of the same estimator, of which it takes the types.

    Raises ArtifactError if the document is not such a state.
    """
    try:
        return _read(document, like, where)
    except (TypeError, ValueError, KeyError) as error:
        raise ArtifactError(f"{where}: it is not a state of this estimator; start afresh.") from error


def _read(document: Any, like: Any, where: str) -> Any:
    if hasattr(like, "_asdict"):
        if not isinstance(document, dict) or document.keys() != set(like._fields):
            raise ArtifactError(f"{where}: must have the fields {', '.join(like._fields)}; start afresh.")
        return type(like)(*(_read(document[name], getattr(like, name), f"{where}.{name}") for name in like._fields))
    if isinstance(like, np.ndarray):
        shape, values = document["shape"], np.array([_number(value) for value in document["values"]], dtype=float)
        if len(shape) != like.ndim:
            raise ArtifactError(f"{where}: must have {like.ndim} dimensions; start afresh.")
        return (values.view(complex) if np.iscomplexobj(like) else values).reshape(shape)
    if isinstance(like, complex):
        real, imag = document
        return complex(_number(real), _number(imag))
    if isinstance(like, int):
        if isinstance(document, bool) or not isinstance(document, int):
            raise ArtifactError(f"{where}: must be a whole number; start afresh.")
        return document
    return _number(document)


def _number(value: Any) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} is not a number")
    return float(value)
