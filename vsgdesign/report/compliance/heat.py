"""Survival maps as sketches: a number or a word in every cell, with a colour behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.look import blues, scale_between
from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.drawing.sketch import END, MIDDLE, Sketch, Words

Array = NDArray[np.float64]

_CELL_WIDTH, _CELL_HEIGHT = 41.0, 19.0
_LEFT, _TOP, _BOTTOM, _RIGHT = 56.0, 26.0, 34.0, 8.0
_LEGEND = 24.0
_LOST, _HATCH, _NO_VERDICT = "#F0B48C", "#B4622A", "#E4E4E4"

_SHORT = {
    "slipped": "slips",
    "latched": "latches",
    "diverged": "diverges",
    "blocked": "blocks",
    "not at rest": "late",
    "no rest": "–",
    "rest over limit": "–",
    "not known": "?",
}
"""The judge's words as they fit into a cell."""

_WITHOUT_VERDICT = ("–", "?")

LEGEND = (
    "A number is a run that survives, and its shade is the value. Hatched cells are lost: “slips” (the angle slips by "
    "a turn), “latches” (the current limit stays active), “diverges”, “late” (not at the new rest in time). "
    "A dash in a grey cell says that there is no steady state within the current limit, so there is no verdict."
)


def heat_sketches(maps: Sequence[Mapping[str, Any]]) -> list[Sketch]:
    """All maps of a document. Maps of one title have one scale, so that their shades can be compared."""
    of: dict[str, list[Array]] = {}
    for one in maps:
        of.setdefault(one["title"], []).append(_values(one).ravel())
    ends = {title: _ends(np.concatenate(values)) for title, values in of.items()}
    return [heat_sketch(one, ends[one["title"]]) for one in maps]


def heat_sketch(found: Mapping[str, Any], ends: tuple[float, float] | None = None) -> Sketch:
    """One map of ``document["maps"]``: ``values`` has a row for each value of y, None where it has none.

    ``status`` says for each cell whether it survives, how it is lost, or why there is no verdict. ``ends``: least and
    largest value of the scale; None: those of the map.
    """
    x, y = found["x"], found["y"]
    values = _values(found)
    status = found.get("status") or [["" for _ in x["values"]] for _ in y["values"]]
    columns, rows = len(x["values"]), len(y["values"])
    width = _LEFT + columns * _CELL_WIDTH + _RIGHT
    height = _TOP + rows * _CELL_HEIGHT + _BOTTOM + _LEGEND
    sketch = Sketch(max(width, 300.0), height, f"{found['title']} of {found['controller']}, a table of values")
    sketch.parts.append(Words(_LEFT, 17.0, str(found["controller"]), 11.0, bold=True))
    ends = ends or _ends(values)
    for j in range(rows):
        # The largest y is on top, as on the axis of a figure.
        top = _TOP + (rows - 1 - j) * _CELL_HEIGHT
        sketch.parts.append(Words(_LEFT - 5.0, top + 13.0, plain(y["values"][j], 3), 9.5, END))
        for k in range(columns):
            _cell(sketch, (_LEFT + k * _CELL_WIDTH, top), float(values[j, k]), str(status[j][k]), ends)
    bottom = _TOP + rows * _CELL_HEIGHT
    for k, value in enumerate(x["values"]):
        sketch.parts.append(Words(_LEFT + (k + 0.5) * _CELL_WIDTH, bottom + 12.0, plain(value, 3), 9.5, MIDDLE))
    middle = _LEFT + columns * _CELL_WIDTH / 2.0
    sketch.parts.append(Words(middle, bottom + 26.0, _label(x), 10.0, MIDDLE))
    sketch.parts.append(Words(12.0, _TOP + rows * _CELL_HEIGHT / 2.0, _label(y), 10.0, MIDDLE, upright=True))
    _legend(sketch, bottom + 36.0, found, ends)
    return sketch


def maps_by_title(document: Mapping[str, Any], sketches: Sequence[Sketch]) -> list[tuple[str, str, list[Sketch]]]:
    """Maps of the same title with their words: (title, words, one sketch for each controller)."""
    found: dict[str, list[Sketch]] = {}
    words: dict[str, str] = {}
    for one, sketch in zip(document.get("maps") or (), sketches, strict=True):
        title = str(one["title"])
        found.setdefault(title, []).append(sketch)
        # A scheduled controller has a sentence about its schedule more than a fixed one.
        words[title] = max(words.get(title, ""), str(one["words"]), key=len)
    return [(title, words[title], some) for title, some in found.items()]


def _label(axis: Mapping[str, Any]) -> str:
    unit = axis.get("unit")
    return f"{axis['label']} [{unit}]" if unit else str(axis["label"])


def _cell(sketch: Sketch, corner: tuple[float, float], value: float, status: str, ends: tuple[float, float]) -> None:
    x, y = corner
    said = _said(value, status)
    # A fault of no length at all is what a converter survives that survives none.
    known = bool(np.isfinite(value)) and value != 0.0
    lost = _NO_VERDICT if said in _WITHOUT_VERDICT else _LOST
    colour = _colour(float(scale_between(*ends)(value))) if known else lost
    sketch.box(x, y, _CELL_WIDTH, _CELL_HEIGHT, colour, "#FFFFFF")
    if colour == _LOST:
        # Along the lower edge, so that the word stays readable.
        for k in range(1, 9):
            left = x + k * _CELL_WIDTH / 9.0
            sketch.line((left - 2.0, y + _CELL_HEIGHT - 1.0), (left + 2.0, y + _CELL_HEIGHT - 4.0), _HATCH, 0.8)
    size = 9.5 if len(said) < 7 else 8.5
    words = Words(x + _CELL_WIDTH / 2.0, y + 12.5, said, size, MIDDLE, words_on(colour))
    sketch.parts.append(words)


def words_on(colour: str) -> str:
    """Black or white, whichever has the larger contrast to a colour such as #5B9BD5: at least 4.5 to 1 (WCAG 2.2)."""
    parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    luminance = float(linear @ np.array([0.2126, 0.7152, 0.0722]))
    return "#FFFFFF" if 1.05 / (luminance + 0.05) > (luminance + 0.05) / 0.05 else "#000000"


def _said(value: float, status: str) -> str:
    if np.isfinite(value):
        return f"≥ {plain(value, 2)}" if status.startswith("survived up to") else plain(value, 2)
    return _SHORT.get(status, "–")


def _legend(sketch: Sketch, top: float, found: Mapping[str, Any], ends: tuple[float, float]) -> None:
    steps, width = 24, 4.0
    unit = "" if found["unit"] == "1" else f" {found['unit']}"
    sketch.parts.append(Words(_LEFT - 4.0, top + 8.0, plain(ends[0], 2), 9.0, END))
    for k in range(steps):
        sketch.box(_LEFT + width * k, top, width + 0.3, 8.0, _colour(k / (steps - 1)))
    said = f"{plain(ends[1], 2)}{unit}: {str(found.get('label') or found['title']).lower()}"
    sketch.parts.append(Words(_LEFT + width * steps + 5.0, top + 8.0, said, 9.0))


def _values(found: Mapping[str, Any]) -> Array:
    return np.array([[np.nan if value is None else value for value in row] for row in found["values"]], dtype=float)


def _ends(values: Array) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)


def _colour(share: float) -> str:
    return "#" + "".join(f"{round(255 * value):02X}" for value in blues(share).tolist())
