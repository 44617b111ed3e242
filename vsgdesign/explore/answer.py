"""One answer to the page: numbers for a table in a header, and curves as arrays; and its bytes on the wire."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.files import plain

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
    document = plain({**answer.header, **more, "arrays": listed})
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % LENGTH_BYTES)
    return b"".join([len(text).to_bytes(LENGTH_BYTES, "little"), text, *blocks])
