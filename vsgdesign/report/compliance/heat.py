"""Survival maps as sketches: a number in every cell, a colour behind it, and words where there is no number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.sketch import END, MIDDLE, START, Sketch, Words
from vsgdesign.report.quantities import plain

Array = NDArray[np.float64]

_CELL_WIDTH, _CELL_HEIGHT = 44.0, 24.0
_LEFT, _TOP, _BOTTOM, _RIGHT = 64.0, 24.0, 36.0, 10.0
_NOTHING = "#F4F4F4"
_LEGEND = 30.0

_RAMP = np.array(
    [
        [0.78, 0.38, 0.08],
        [0.93, 0.65, 0.40],
        [0.97, 0.90, 0.80],
        [0.80, 0.89, 0.95],
        [0.42, 0.66, 0.84],
        [0.0, 0.35, 0.58],
    ]
)
"""Dark orange for the least value, dark blue for the largest: an order that eyes without red and green see, too."""


def heat_sketch(found: Mapping[str, Any]) -> Sketch:
    """One map of ``document["maps"]``: ``values`` has a row for each value of y, None where it is not known.

    ``mark`` may have a short text for each cell, which is printed in place of the number.
    """
    x, y = found["x"], found["y"]
    values = np.array([[np.nan if value is None else value for value in row] for row in found["values"]], dtype=float)
    marks = found.get("mark") or [[None] * len(x["values"]) for _ in y["values"]]
    columns, rows = len(x["values"]), len(y["values"])
    width = _LEFT + columns * _CELL_WIDTH + _RIGHT
    height = _TOP + rows * _CELL_HEIGHT + _BOTTOM + _LEGEND
    title = f"{found['title']}, {found['controller']}"
    sketch = Sketch(max(width, 300.0), height, f"{title}: a table of numbers")
    sketch.parts.append(Words(4.0, 14.0, title, 11.5, bold=True))
    low, high = _ends(values)
    for j in range(rows):
        # The largest y is on top, as on the axis of a figure.
        top = _TOP + (rows - 1 - j) * _CELL_HEIGHT
        sketch.parts.append(Words(_LEFT - 5.0, top + 16.0, plain(y["values"][j], 3), 10.0, END))
        for k in range(columns):
            _cell(sketch, (_LEFT + k * _CELL_WIDTH, top), values[j, k], marks[j][k], (low, high))
    bottom = _TOP + rows * _CELL_HEIGHT
    for k, value in enumerate(x["values"]):
        sketch.parts.append(Words(_LEFT + (k + 0.5) * _CELL_WIDTH, bottom + 13.0, plain(value, 3), 10.0, MIDDLE))
    middle = _LEFT + columns * _CELL_WIDTH / 2.0
    sketch.parts.append(Words(middle, bottom + 28.0, x["label"], 10.5, MIDDLE))
    sketch.parts.append(Words(12.0, _TOP + rows * _CELL_HEIGHT / 2.0, y["label"], 10.5, MIDDLE, upright=True))
    _legend(sketch, bottom + 42.0, found["unit"], (low, high))
    return sketch


def _cell(
    sketch: Sketch, corner: tuple[float, float], value: float, mark: str | None, ends: tuple[float, float]
) -> None:
    x, y = corner
    known = np.isfinite(value)
    share = _share(value, ends)
    colour = _colour(share) if known else _NOTHING
    sketch.box(x, y, _CELL_WIDTH, _CELL_HEIGHT, colour, "#FFFFFF")
    said = mark or (plain(value, 3) if known else "–")
    dark = known and (share < 0.13 or share > 0.75)
    sketch.parts.append(Words(x + _CELL_WIDTH / 2.0, y + 16.0, said, 10.0, MIDDLE, "#FFFFFF" if dark else "#1A1A1A"))


def _legend(sketch: Sketch, top: float, unit: str, ends: tuple[float, float]) -> None:
    steps, width = 24, 5.0
    for k in range(steps):
        sketch.box(_LEFT + width * k, top, width + 0.3, 8.0, _colour(k / (steps - 1)))
    sketch.parts.append(Words(_LEFT - 4.0, top + 8.0, plain(ends[0], 3), 9.5, END))
    said = f"{plain(ends[1], 3)} {'' if unit == '1' else unit}".strip()
    sketch.parts.append(Words(_LEFT + width * steps + 5.0, top + 8.0, said, 9.5, START))


def _ends(values: Array) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)


def _share(value: float, ends: tuple[float, float]) -> float:
    if not np.isfinite(value) or ends[1] <= ends[0]:
        return 0.5
    return float((value - ends[0]) / (ends[1] - ends[0]))


def _colour(share: float) -> str:
    places = np.linspace(0.0, 1.0, len(_RAMP))
    rgb: Sequence[float] = [float(np.interp(share, places, _RAMP[:, k])) for k in range(3)]
    return "#" + "".join(f"{round(255 * value):02X}" for value in rgb)
