"""One answer to the page: numbers for a table in a header, and curves as arrays; and its bytes on the wire.

Of a run few rows are drawn, and every minimum and maximum stays.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.files import plain

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


def joined_emt(parts: Sequence[tuple[Sequence[int], Answer]]) -> Answer:
    """The answer of its parts, each with its places."""
    listed = [pair for places, part in parts for pair in zip(places, part.header["controllers"], strict=True)]
    arrays = {name: values for _, part in parts for name, values in part.arrays.items()}
    rows = [row for _, row in sorted(listed, key=lambda pair: pair[0])]
    names = sorted(arrays, key=lambda name: int(name.partition("/")[0]))
    return emt_of_rows(rows, parts[0][1].header["bands"], {name: arrays[name] for name in names})


def emt_of_rows(rows: list[dict[str, Any]], limits: list[dict[str, Any]], arrays: dict[str, Any]) -> Answer:
    """The answer of the rows of the controllers, of bands and limits, and of curves."""
    reasons = {row["why"] for row in rows}
    words = reasons.pop() if not arrays and len(reasons) == 1 else ""
    return Answer({"event_s": 0.0, "controllers": rows, "bands": limits, "words": words}, arrays)


Array = NDArray[np.float64]

MOST = 800
"""Rows that are drawn at most."""

_BUCKETS = 320
_SMALLEST = 2e-3
"""A turning point that sticks out of its bucket's ends by less than this share of the whole range is not kept for
itself: it is a fraction of a pixel."""


def thinned(signals: Sequence[Array], most: int = MOST) -> NDArray[np.intp]:
    """Rows, in ascending order and at most ``most``, with which all ``signals`` (n each) can be drawn.

    The rows are divided into buckets of equal length. The first row of each bucket stays, and so do the rows of its
    minimum and maximum of a signal where these stick out of the bucket. The first and the last row and the rows of
    every signal's own minimum and maximum always stay, unless ``most`` is smaller than these.
    """
    n = len(signals[0])
    if n <= most:
        return np.arange(n)
    values = np.stack([np.asarray(signal, dtype=float) for signal in signals])
    always = np.unique([0, n - 1, *np.argmin(values, axis=1), *np.argmax(values, axis=1)])
    buckets = min(_BUCKETS, most // 2)
    while True:
        rows = np.union1d(always, _rows(values, max(-(-n // buckets), 2)))
        if len(rows) <= most or buckets <= 8:
            return rows if len(rows) <= most else always
        buckets = min(int(0.95 * buckets * most / len(rows)), buckets - 1)


def _rows(values: Array, length: int) -> NDArray[np.intp]:
    """First rows of the buckets of ``length`` rows, and those of their extremes that stick out of them."""
    signals, n = values.shape
    count = n // length
    parts = values[:, : count * length].reshape(signals, count, length)
    starts = np.arange(count) * length
    # A bucket is left towards the first row of the next one, which is drawn, too.
    following = np.minimum(starts + length, n - 1)
    ends = np.stack([values[:, starts], values[:, following]])
    slack = _SMALLEST * np.ptp(values, axis=1)[:, None]
    found = [starts, np.arange(count * length, n, length)]
    for pick, sticks in ((parts.argmin(axis=2), -1.0), (parts.argmax(axis=2), 1.0)):
        extreme = np.take_along_axis(parts, pick[:, :, None], axis=2)[:, :, 0]
        out = (sticks * extreme[None] > sticks * ends + slack).all(axis=0)
        found.append((starts[None, :] + pick)[out])
    return np.unique(np.concatenate(found))
