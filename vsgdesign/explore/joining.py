"""An EMT answer of the rows of its controllers, which several processes may have computed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from vsgdesign.explore.answer import Answer


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
