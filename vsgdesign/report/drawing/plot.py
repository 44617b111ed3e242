"""A signal over time as a sketch: axes with round ticks, limits as an area, curves that leave the scale said so."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.drawing.sketch import END, MIDDLE, Area, Sketch, Stroke, Words
from vsgdesign.report.drawing.time_axis import extreme_indices

Array = NDArray[np.float64]

WIDTH, HEIGHT = 340.0, 190.0
"""Size of one plot, px: three are side by side on a page and one fills a telephone's screen."""

_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 8.0, 20.0, 32.0
_FRAME, _GRID, _AREA, _AREA_EDGE, _LEVEL = "#333333", "#E4E4E4", "#DDEFE8", "#5B8C7B", "#444444"
_COLUMNS = 140


@dataclass(frozen=True, eq=False)
class Curve:
    """A signal over time, both (n,). ``dashes`` as multiples of the line's width."""

    t_s: Array
    y: Array
    colour: str
    dashes: tuple[float, ...] = ()
    width: float = 1.3


@dataclass(frozen=True, eq=False)
class Band:
    """Two curves over time between which a signal must stay, (n,) each. NaN: no limit."""

    t_s: Array
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class Plot:
    """What one plot shows. ``within``: the scale never goes beyond these values."""

    title: str
    label: str
    curves: Sequence[Curve]
    bands: Sequence[Band] = ()
    levels: Sequence[tuple[float, str]] = ()
    """Horizontal lines: value and what it is."""
    within: tuple[float, float] = (-math.inf, math.inf)


def plot_sketch(plot: Plot, width: float = WIDTH, height: float = HEIGHT) -> Sketch:
    """Draw it. A curve beyond the scale is cut there, and the upper right corner says how far it goes."""
    begin, end = _time_range(plot)
    low, high, beyond = _scale(plot)
    sketch = Sketch(width, height, f"{plot.title}: {plot.label} over time")
    axes = _Axes(_LEFT, _TOP, width - _LEFT - _RIGHT, height - _TOP - _BOTTOM, (begin, end), (low, high))
    for band in plot.bands:
        sketch.parts += axes.band(band)
    _draw_frame(sketch, axes, plot)
    for value, what in plot.levels:
        if low < value < high:
            y = float(axes.up(value))
            sketch.line((axes.x, y), (axes.x + axes.width, y), _LEVEL, 1.0, (3.0, 2.0))
            sketch.parts.append(Words(axes.x + axes.width - 3.0, y - 3.0, what, 9.5, END, _LEVEL))
    for curve in plot.curves:
        sketch.parts.append(axes.curve(curve))
    if beyond:
        sketch.parts.append(Words(axes.x + axes.width, _TOP - 6.0, beyond, 10.0, END, "#A33B00"))
    return sketch


@dataclass(frozen=True)
class _Axes:
    x: float
    y: float
    width: float
    height: float
    times: tuple[float, float]
    values: tuple[float, float]

    def along(self, t: Array | float) -> Array | float:
        return self.x + self.width * (t - self.times[0]) / (self.times[1] - self.times[0])

    def up(self, value: Array | float) -> Array | float:
        return self.y + self.height * (self.values[1] - np.clip(value, *self.values)) / (
            self.values[1] - self.values[0]
        )

    def curve(self, curve: Curve) -> Stroke:
        picks = extreme_indices(np.where(np.isfinite(curve.y), curve.y, self.values[1]), _COLUMNS)
        points = np.stack([self.along(curve.t_s[picks]), self.up(curve.y[picks])], axis=1)
        return Stroke(points, curve.colour, curve.width, curve.dashes)

    def band(self, band: Band) -> list[Area | Stroke]:
        # A limit on one side alone leaves the other side open, to the end of the scale.
        known = ~(np.isnan(band.low) & np.isnan(band.high))
        if np.count_nonzero(known) < 2:
            return []
        t, low, high = band.t_s[known], band.low[known], band.high[known]
        low, high = np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)
        low, high = np.clip(low, *self.values), np.clip(high, *self.values)
        picks = np.unique(np.concatenate([extreme_indices(low, _COLUMNS), extreme_indices(high, _COLUMNS)]))
        x = self.along(t[picks])
        lower, upper = np.stack([x, self.up(low[picks])], axis=1), np.stack([x, self.up(high[picks])], axis=1)
        edges = [Stroke(points, _AREA_EDGE, 0.8) for points in (lower, upper)]
        return [Area(np.concatenate([lower, upper[::-1]]), _AREA), *edges]


def round_ticks(low: float, high: float, most: int) -> list[float]:
    """At most so many multiples of 1, 2 or 5 times a power of ten between two values."""
    span = high - low
    if not (span > 0.0 and math.isfinite(span)):
        return []
    power = 10.0 ** math.floor(math.log10(span / most))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0, 20.0) if span / (m * power) <= most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def _draw_frame(sketch: Sketch, axes: _Axes, plot: Plot) -> None:
    bottom = axes.y + axes.height
    for value in round_ticks(*axes.values, 5):
        y = float(axes.up(value))
        sketch.line((axes.x, y), (axes.x + axes.width, y), _GRID)
        sketch.parts.append(Words(axes.x - 4.0, y + 3.5, plain(value + 0.0, 6), 10.0, END))
    for t in round_ticks(*axes.times, 6):
        x = float(axes.along(t))
        sketch.line((x, bottom), (x, bottom - 4.0), _FRAME, 0.8)
        sketch.parts.append(Words(x, bottom + 12.0, plain(t + 0.0, 6), 10.0, MIDDLE))
    corners = [(axes.x, axes.y), (axes.x + axes.width, axes.y), (axes.x + axes.width, bottom), (axes.x, bottom)]
    sketch.parts.append(Stroke(np.array([*corners, corners[0]]), _FRAME, 0.8))
    sketch.parts.append(Words(axes.x, axes.y - 6.0, plot.title, 11.0, bold=True))
    sketch.parts.append(Words(axes.x + axes.width / 2.0, bottom + 26.0, "t [s]", 10.5, MIDDLE))
    sketch.parts.append(Words(11.0, axes.y + axes.height / 2.0, plot.label, 10.5, MIDDLE, upright=True))


def _time_range(plot: Plot) -> tuple[float, float]:
    known = [curve.t_s for curve in plot.curves if len(curve.t_s) > 1]
    if not known:
        return 0.0, 1.0
    return min(float(t[0]) for t in known), max(float(t[-1]) for t in known)


def _scale(plot: Plot) -> tuple[float, float, str]:
    """(low, high, words about what is beyond)."""
    ends = [value for curve in plot.curves for value in _ends(curve.y)]
    asked = [value for band in plot.bands for curve in (band.low, band.high) for value in _ends(curve)]
    asked += [value for value, _ in plot.levels]
    if not ends + asked:
        return 0.0, 1.0, ""
    low, high = min(ends + asked), max(ends + asked)
    furthest = max(ends, key=lambda value: max(plot.within[0] - value, value - plot.within[1]), default=0.0)
    outside = furthest < plot.within[0] or furthest > plot.within[1]
    low, high = max(low, plot.within[0]), min(high, plot.within[1])
    room = 0.08 * (high - low)
    if room <= 1e-9 * max(abs(low), abs(high)):
        room = 0.05 * max(abs(high), 0.1)
    # The words above a level need room of their own.
    above = max(room, 0.14 * (high - low)) if any(value >= high - room for value, _ in plot.levels) else room
    return low - room, high + above, f"beyond the scale: {plain(furthest, 3)}" if outside else ""


def _ends(y: Array) -> list[float]:
    known = y[np.isfinite(y)]
    return [float(known.min()), float(known.max())] if len(known) else []
