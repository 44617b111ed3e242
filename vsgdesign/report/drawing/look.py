"""Colours, scales and cells of the stability maps: one look for all of them."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.drawing.style import TEXT_PT, text_width

Array = NDArray[np.float64]

UNSTABLE: dict[str, Any] = {"facecolor": "#3A2A45", "edgecolor": "#F2F2F2", "hatch": "//////", "linewidth": 0.0}
NO_POINT: dict[str, Any] = {"facecolor": "#ECECEC", "edgecolor": "#ECECEC", "linewidth": 0.0}
GATE_LINE: dict[str, Any] = {"color": "#000000", "linewidth": 1.1, "zorder": 5}
CROSS: dict[str, Any] = {"marker": "x", "markersize": 2.6, "markeredgewidth": 0.6, "color": "#8A8A8A", "linestyle": ""}
OUTSIDE: dict[str, Any] = {
    "marker": "o",
    "markersize": 3.0,
    "markeredgewidth": 0.7,
    "markerfacecolor": "#FFFFFF",
    "markeredgecolor": "#000000",
    "linestyle": "",
    "zorder": 6,
}
PARTIAL: dict[str, Any] = {"marker": ".", "markersize": 3.0, "color": "#000000", "linestyle": "", "zorder": 6}


MOST_VECTORS = 1100
"""Up to this number of cells in a figure, each cell is a shape of its own. More cells become an image, so that files
stay small.
"""


@dataclass(frozen=True)
class Scale:
    """How a quantity becomes a colour: the gate in the middle, worse on one side, better on the other.

    Without a gate, one ramp. Values beyond the ends take the end's colour.
    """

    low: float
    high: float
    gate: float | None = None
    larger_is_better: bool = True
    log: bool = False
    ticks: tuple[float, ...] = ()
    listed: Any = field(default=None, compare=False)
    """Colours from ``low`` to ``high``; None: the ramp, or the two sides of the gate."""

    def __call__(self, values: Any) -> Array:
        """Place on the colour bar, 0 to 1."""
        f = np.log if self.log else np.asarray
        anchors, places = [self.low, self.high], [0.0, 1.0]
        if self.gate is not None:
            anchors, places = [self.low, self.gate, self.high], [0.0, 0.5, 1.0]
        values = np.asarray(values, dtype=float)
        known = np.where(np.isnan(values), self.low, np.clip(values, self.low, self.high))
        return np.where(np.isnan(values), np.nan, np.interp(f(known), f(anchors), places))

    def passes(self, values: Array) -> NDArray[np.bool_]:
        """Which values meet the gate; False for NaN."""
        if self.gate is None:
            return np.zeros(np.shape(values), dtype=bool)
        with np.errstate(invalid="ignore"):
            return values >= self.gate if self.larger_is_better else values <= self.gate

    def shown_ticks(self) -> list[float]:
        """Ticks that have room on the bar: ends and gate first."""
        inside = [t for t in self.ticks if self.low <= t <= self.high]
        first = [] if self.gate is None else [self.gate]
        chosen: list[float] = []
        for tick in (*first, *inside):
            if all(abs(float(self(tick) - self(other))) > 0.07 for other in chosen):
                chosen.append(tick)
        return sorted(chosen)

    def colours(self) -> Any:
        """The colour map that goes with it."""
        if self.listed is not None:
            from matplotlib.colors import ListedColormap

            return ListedColormap(self.listed, name="listed")
        return _ramp_map() if self.gate is None else _gate_map(self.larger_is_better)


def scale_between(low: float, high: float) -> Scale:
    """Logarithmic for positive values that vary much, because the large ones would hide the rest.

    A value alone lies in the middle, and is the only tick.
    """
    if high - low <= 1e-6 * max(abs(low), abs(high)):
        room = 0.05 * abs(low) or 1.0
        return Scale(low - room, high + room, ticks=(low,))
    return Scale(low, high, log=low > 0.0 and high > 4.0 * low)


def gate_scale(
    low: float, high: float, gate: float, ticks: Sequence[float], *, larger_is_better: bool = True, log: bool = False
) -> Scale:
    """A scale with its gate strictly inside, wherever a study puts it."""
    if log:
        low, high = min(low, gate / 2.0), max(high, 2.0 * gate)
    else:
        low, high = min(low, gate - 0.1 * (high - low)), max(high, 1.5 * gate)
    return Scale(low, high, gate, larger_is_better, log, tuple(ticks))


@functools.cache
def _gate_map(larger_is_better: bool) -> Any:
    from matplotlib.colors import ListedColormap

    colours = np.concatenate([oranges(np.linspace(0.0, 1.0, 64))[::-1], blues(np.linspace(0.0, 1.0, 64))])
    return ListedColormap(colours if larger_is_better else colours[::-1], name="gate")


def blues(shares: Any) -> Array:
    """sRGB (..., 3) from pale (0) to dark blue (1)."""
    s = np.asarray(shares, dtype=float)
    return _oklch(0.91 - 0.51 * s, 0.045 + 0.07 * s, 225.0 + 33.0 * s)


def oranges(shares: Any) -> Array:
    """sRGB (..., 3) from pale (0) to dark orange (1)."""
    s = np.asarray(shares, dtype=float)
    return _oklch(0.89 - 0.43 * s, 0.085 + 0.04 * s, 75.0 - 30.0 * s)


@functools.cache
def _ramp_map() -> Any:
    import matplotlib

    return matplotlib.colormaps["cividis"]


def _oklch(L: Array, C: Array, h_deg: Array) -> Array:
    """sRGB of OKLCh colours: even steps of L look even."""
    a, b = C * np.cos(np.radians(h_deg)), C * np.sin(np.radians(h_deg))
    lms = (
        np.stack(
            [
                L + 0.3963377774 * a + 0.2158037573 * b,
                L - 0.1055613458 * a - 0.0638541728 * b,
                L - 0.0894841775 * a - 1.2914855480 * b,
            ]
        )
        ** 3
    )
    to_rgb = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip(to_rgb @ lms, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055).T


def edges(values: Array, log: bool = True) -> Array:
    """Borders between cells around values: half-way, on the axis's own scale."""
    v = np.log(values) if log else np.asarray(values, dtype=float)
    if len(v) == 1:
        half = np.log(1.25) if log else 0.5
        found = np.array([v[0] - half, v[0] + half])
    else:
        middle = 0.5 * (v[1:] + v[:-1])
        found = np.concatenate([[v[0] - (middle[0] - v[0])], middle, [v[-1] + (v[-1] - middle[-1])]])
    return np.exp(found) if log else found


def value_ticks(
    axis: Any, values: Sequence[float], length_in: float, log: bool, along: bool, factor: float = 1.0
) -> None:
    """Ticks at the values themselves; labels at those that have room, ends and round numbers first.

    ``along``: labels lie along the axis (a horizontal one). ``factor`` turns values into what is written.
    """
    from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

    from vsgdesign.report.drawing.ticks import Labels

    border = edges(np.asarray(values, dtype=float), log)
    scale = np.log if log else np.asarray
    span = float(scale(border[-1]) - scale(border[0]))
    texts = [plain(factor * v, 3) for v in values]
    place = [float(scale(v) - scale(border[0])) / span * length_in for v in values]
    size = [text_width(t) if along else TEXT_PT / 72.0 for t in texts]

    def rank(k: int) -> tuple[int, int]:
        ends = 0 if k in (0, len(values) - 1) else 1
        return ends, 0 if float(f"{factor * values[k]:.0e}") == factor * values[k] and texts[k][0] in "−0125" else 1

    chosen: list[int] = []
    for k in sorted(range(len(values)), key=rank):
        if all(abs(place[k] - place[j]) > 0.5 * (size[k] + size[j]) + (0.06 if along else 0.02) for j in chosen):
            chosen.append(k)
    chosen.sort()
    axis.set_major_locator(FixedLocator([values[k] for k in chosen]))
    axis.set_major_formatter(Labels(functools.partial(_value_text, factor)))
    rest = [v for k, v in enumerate(values) if k not in chosen]
    axis.set_minor_locator(FixedLocator(rest) if rest else NullLocator())
    axis.set_minor_formatter(NullFormatter())


def _value_text(factor: float, value: float) -> str:
    return plain(factor * value, 3)


def decades(axis: Any, most: int = 12) -> None:
    """Plain powers of ten on a logarithmic axis, without minor ticks: both cost matplotlib much time."""
    from matplotlib.ticker import LogLocator, NullLocator

    from vsgdesign.report.drawing.ticks import Labels, power_of_ten

    axis.set_major_locator(LogLocator(numticks=most))
    axis.set_major_formatter(Labels(power_of_ten))
    axis.set_minor_locator(NullLocator())


def round_decades(axis: Any, text: Callable[[float], str], steps: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """These steps of every decade on a logarithmic axis: over few decades they read more easily than powers of ten."""
    from matplotlib.ticker import LogLocator, NullFormatter

    from vsgdesign.report.drawing.ticks import Labels

    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(Labels(text))
    axis.set_minor_formatter(NullFormatter())


def round_numbers(low: float, high: float, steps: Sequence[float] = (1.0, 2.0, 5.0)) -> list[float]:
    """These steps of every decade from ``low`` to ``high``, both above zero."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [m * 10.0**d for d in powers for m in steps if low <= m * 10.0**d <= high]


@dataclass(frozen=True, kw_only=True)
class Cells:
    """One panel's cells: values over (x, y), and what else there is to say of each."""

    x: Array
    y: Array
    values: Array
    unstable: NDArray[np.bool_]
    missing: NDArray[np.bool_]
    partial: NDArray[np.bool_]
    """Whether some operating points of the cell could not be analysed, or are outside the converter's limits."""
    x_log: bool = True
    y_log: bool = True
    outside: NDArray[np.bool_] | None = None
    """The value is of operating points outside the converter's limits; None: of none."""


def draw_cells(axes: Any, cells: Cells, scale: Scale, width_in: float, height_in: float, raster: bool = False) -> None:
    """Colours, unstable and missing cells, and the staircase between cells that meet the gate and those that do not."""
    x, y = node_axes(axes, cells.x, cells.y, width_in, height_in, (cells.x_log, cells.y_log))
    paint(axes, x, y, np.where(cells.unstable | cells.missing, np.nan, cells.values), scale, raster)
    shade(axes, x, y, cells.missing, NO_POINT)
    shade(axes, x, y, cells.unstable, UNSTABLE)
    _marks(axes, cells, cells.missing, CROSS)
    _marks(axes, cells, cells.partial & ~cells.missing, PARTIAL)
    if cells.outside is not None:
        _marks(axes, cells, cells.outside & ~cells.missing, OUTSIDE)
    _gate_line(axes, x, y, cells, scale)


def node_axes(
    axes: Any, x: Array, y: Array, width_in: float, height_in: float, log: tuple[bool, bool] = (True, True)
) -> tuple[Array, Array]:
    """Axes with a tick at every node that has room, and the borders of the nodes' cells; linear ones in per cent."""
    x_edges, y_edges = edges(x, log[0]), edges(y, log[1])
    bin_axes(axes, x_edges, y_edges, log)
    value_ticks(axes.xaxis, x.tolist(), width_in, log[0], along=True, factor=1.0 if log[0] else 100.0)
    value_ticks(axes.yaxis, y.tolist(), height_in, log[1], along=False, factor=1.0 if log[1] else 100.0)
    return x_edges, y_edges


def bin_axes(axes: Any, x_edges: Array, y_edges: Array, log: tuple[bool, bool] = (True, True)) -> None:
    """Axes of a map from the first border of its cells to the last one."""
    axes.grid(False)
    axes.set_xscale("log" if log[0] else "linear")
    axes.set_yscale("log" if log[1] else "linear")
    axes.set_xlim(x_edges[0], x_edges[-1])
    axes.set_ylim(y_edges[0], y_edges[-1])
    axes.tick_params(which="both", direction="out")


def paint(axes: Any, x_edges: Array, y_edges: Array, values: Array, scale: Scale, raster: bool = False) -> None:
    """The colours of all cells, ``values`` (x, y); a cell that is NaN stays as it is."""
    axes.pcolormesh(
        x_edges,
        y_edges,
        np.ma.masked_invalid(scale(values).T),
        cmap=scale.colours(),
        vmin=0.0,
        vmax=1.0,
        zorder=1,
        edgecolors="face",
        linewidth=0.4,
        rasterized=raster,
        clip_on=False,
    )


def shade(axes: Any, x_edges: Array, y_edges: Array, cells: NDArray[np.bool_], style: dict[str, Any]) -> None:
    """A hatch or a colour over some cells (x, y)."""
    from matplotlib.collections import PolyCollection

    if cells.any():
        boxes = [_box(x_edges, y_edges, i, j) for i, j in np.argwhere(cells)]
        axes.add_collection(PolyCollection(boxes, zorder=2, **style), autolim=False)


def _box(x: Array, y: Array, i: int, j: int) -> list[tuple[float, float]]:
    return [(x[i], y[j]), (x[i + 1], y[j]), (x[i + 1], y[j + 1]), (x[i], y[j + 1])]


def _marks(axes: Any, cells: Cells, mask: NDArray[np.bool_], style: dict[str, Any]) -> None:
    places = np.argwhere(mask)
    if len(places):
        axes.plot(cells.x[places[:, 0]], cells.y[places[:, 1]], **style)


def _gate_line(axes: Any, x: Array, y: Array, cells: Cells, scale: Scale) -> None:
    from matplotlib.collections import LineCollection

    if scale.gate is None:
        return
    good = scale.passes(cells.values) & ~cells.unstable & ~cells.missing
    known = ~cells.missing
    lines = []
    for i, j in np.argwhere((good[1:] != good[:-1]) & known[1:] & known[:-1]):
        lines.append([(x[i + 1], y[j]), (x[i + 1], y[j + 1])])
    for i, j in np.argwhere((good[:, 1:] != good[:, :-1]) & known[:, 1:] & known[:, :-1]):
        lines.append([(x[i], y[j + 1]), (x[i + 1], y[j + 1])])
    if lines:
        axes.add_collection(LineCollection(lines, capstyle="projecting", **GATE_LINE))


def colour_bar(figure: Any, place: Sequence[float], scale: Scale, label: str, beyond: tuple[bool, bool]) -> None:
    """A colour bar with its own ticks; ``beyond``: whether values lie below and above its ends."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    width, height = (float(size) for size in figure.get_size_inches())
    left, bottom, w, h = place
    axes = figure.add_axes((left / width, bottom / height, w / width, h / height))
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
    mappable = ScalarMappable(Normalize(0.0, 1.0), scale.colours())
    bar = figure.colorbar(mappable, cax=axes, extend=extend, extendfrac=0.03)
    ticks = scale.shown_ticks()
    bar.set_ticks([float(scale(t)) for t in ticks], labels=[plain(t, 3) for t in ticks])
    bar.set_label(label, labelpad=3.0)
    bar.outline.set_linewidth(0.5)
    bar.solids.set_edgecolor("face")
    axes.grid(False)
    if scale.gate is not None:
        axes.axhline(float(scale(scale.gate)), color="#000000", linewidth=1.1)


def legend_patches(
    unstable: bool, missing: str | None, partial: bool, gate: str | None, outside: bool = False
) -> list[tuple[Any, str]]:
    """(handle, label) of what the panels contain besides colours. ``missing``: why cells have no value; None where all
    have one."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[tuple[Any, str]] = []
    if gate is not None:
        entries.append((Line2D([], [], color="#000000", linewidth=1.1), gate))
    if unstable:
        entries.append((Patch(**{**UNSTABLE, "hatch": "////////"}), "unstable"))
    if missing is not None:
        patch = Line2D([], [], **{**CROSS, "markersize": 4.0}, markerfacecolor="none")
        entries.append((patch, missing))
    if partial:
        entries.append((Line2D([], [], **{**PARTIAL, "markersize": 4.0}), "of some (P, Q) only"))
    if outside:
        entries.append((Line2D([], [], **{**OUTSIDE, "markersize": 4.0}), "outside the converter's limits"))
    return entries
