"""Sketches of the size of a word: a step response, a bar against its limit, a line's key.

They need no axes: words beside them say the figures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.sketch import Area, Sketch, Stroke
from vsgdesign.report.drawing.style import line_style
from vsgdesign.report.drawing.time_axis import extreme_indices

Array = NDArray[np.float64]

WIDTH, HEIGHT = 132.0, 40.0
"""Size of a step response, px."""

_BAR_WIDTH, _BAR_HEIGHT = 90.0, 10.0
_COLUMNS = 66
_CIRCLE = 2.6 * np.stack([f(np.linspace(0.0, 2.0 * math.pi, 17)) for f in (np.cos, np.sin)], axis=1)


def key(index: int) -> Sketch:
    """A sample of the line that the curve with this index has in the page's figures."""
    sketch = Sketch(26.0, 8.0, "", kind="key")
    sketch.parts.append(_stroke(np.array([[0.0, 4.0], [26.0, 4.0]]), index, 2.0))
    return sketch


def step(
    t: Array,
    y: Array,
    window: tuple[float, float],
    levels: tuple[float, float],
    index: int,
    label: str,
    final: float | None = None,
    due: float | None = None,
    settled: float | None = None,
    band: float = 0.0,
) -> Sketch:
    """A response y over t (both (n,), same length) within a window of time and between two levels.

    ``final`` is a dashed line, with ``band`` on both sides of it in grey. The time ``due`` at which it is asked to be
    there is a dotted line, and the time at which it has settled a circle on the curve. What lies beyond the levels
    is cut off. ``index`` gives the colour and the dashes of the figures, ``label`` is read out in place of the
    picture.
    """
    sketch = Sketch(WIDTH, HEIGHT, label, kind="spark")

    def place(t: Any, y: Any) -> Array:
        # Far beyond the levels a curve is outside the picture wherever it is, and short numbers keep the page small.
        x = WIDTH * (np.asarray(t) - window[0]) / (window[1] - window[0])
        down = HEIGHT * (levels[1] - np.asarray(y)) / (levels[1] - levels[0])
        return np.stack([x, np.clip(down, -HEIGHT, 2.0 * HEIGHT)], axis=-1)

    if final is not None and band > 0.0:
        (x, top), (right, bottom) = place(window, (min(final + band, levels[1]), max(final - band, levels[0]))).tolist()
        sketch.box(x, top, right - x, bottom - top, "#CCCCCC")
    if final is not None:
        sketch.parts.append(Stroke(place(window, (final, final)), "#777777", 1.0, (3.0, 2.0)))
    if due is not None and window[0] <= due <= window[1]:
        sketch.parts.append(Stroke(place((due, due), levels), "#444444", 1.0, (1.0, 2.0)))
    inside = (t >= window[0]) & (t <= window[1]) & np.isfinite(y)
    if np.count_nonzero(inside) > 1:
        t, y = t[inside], y[inside]
        picks = extreme_indices(y, _COLUMNS)
        sketch.parts.append(_stroke(place(t[picks], y[picks]), index, 1.5))
        if settled is not None and t[0] <= settled <= t[-1]:
            middle = place(settled, np.interp(settled, t, y))
            sketch.parts.append(Area(middle + _CIRCLE, "#FFFFFF", line_style(index)["color"]))
    return sketch


def bar(value: float, limit: float | None, largest: float, label: str) -> Sketch:
    """A value as a bar, its limit as a black line across it. ``largest`` is the end of the scale,
    which is shaded.

    The part beyond the limit is hatched, so that it is seen without colours too.
    """
    sketch = Sketch(_BAR_WIDTH, _BAR_HEIGHT, label, kind="bar")
    end = _BAR_WIDTH * value / largest
    within = end if limit is None else min(end, _BAR_WIDTH * limit / largest)
    sketch.box(0.0, 0.0, _BAR_WIDTH, _BAR_HEIGHT, "#EEEEEE")
    sketch.box(0.0, 0.0, within, _BAR_HEIGHT, "#8FB8D0")
    if end > within:
        sketch.box(within, 0.0, end - within, _BAR_HEIGHT, "#E8A077")
        for x in np.arange(within + 1.0, end - 4.0, 4.0):
            sketch.line((x, _BAR_HEIGHT), (x + 4.0, 0.0), "#7A2E00")
    if limit is not None:
        x = _BAR_WIDTH * limit / largest
        sketch.line((x, -2.0), (x, _BAR_HEIGHT + 2.0), "#000000", 2.0)
    return sketch


def levels_of(curves: Sequence[Array], besides: Sequence[float]) -> tuple[float, float]:
    """Levels between which all curves and values lie, with a little room; never a range of zero."""
    ends = [float(f(y)) for y in curves if len(y) for f in (np.min, np.max)] + list(besides)
    low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
    room = 0.08 * (high - low) or 0.5 * max(abs(high), 1.0)
    return low - room, high + room


def _stroke(points: Array, index: int, width: float) -> Stroke:
    """A line in the colour and the dashes of the figures."""
    style = line_style(index)
    dashes = () if isinstance(style["linestyle"], str) else tuple(1.2 * one / width for one in style["linestyle"][1])
    return Stroke(points, style["color"], width, dashes)
