"""One answer to the page: numbers for a table in a header, and curves as arrays; and its bytes on the wire."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

LENGTH_BYTES = 4
"""Bytes before the header; they contain its length."""


@dataclass(frozen=True)
class Answer:
    """What a session says about one state."""

    header: Mapping[str, Any]
    """Figures and words, in JSON's types. A number that is not finite becomes null."""
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """Curves and maps by name. They are sent as 32-bit floats; NaN says that there is no value."""


def as_bytes(answer: Answer, **more: Any) -> bytes:
    """An answer as it is sent: the length of the header (uint32), the header as JSON, and the arrays one after another
    (float32). All numbers are little endian. ``more`` is added to the header.

    The header's ``arrays`` lists name, shape and offset (bytes from the end of the header) of every array. Blanks at
    the end of the header place the arrays at a multiple of four bytes, as a typed array of JavaScript needs it.
    """
    import numpy as np

    listed, blocks, offset = [], [], 0
    for name, values in answer.arrays.items():
        block = np.ascontiguousarray(values, dtype="<f4")
        listed.append({"name": name, "shape": list(block.shape), "offset": offset})
        blocks.append(block.tobytes())
        offset += block.nbytes
    document = json_value({**answer.header, **more, "arrays": listed})
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % LENGTH_BYTES)
    return b"".join([len(text).to_bytes(LENGTH_BYTES, "little"), text, *blocks])


def json_value(value: Any) -> Any:
    """A value in JSON's types: NumPy's numbers as numbers, arrays and tuples as lists, what is not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    if hasattr(value, "tolist"):
        return json_value(value.tolist())
    raise TypeError(f"{type(value).__name__} has no word in JSON: {value!r:.100}")
