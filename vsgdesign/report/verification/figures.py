"""Figures of a verification: maps over SCR and X/R, and how far the cases stay from their limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.verification_text import (
    bound_text,
    counted_of,
    families_of,
    family_noun,
    family_title,
    figure_of,
    figure_words,
    most_of,
    promise_about,
    promise_text,
    promises_of,
    value_text,
)
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.look import Scale, bin_axes, blues, oranges, paint, round_numbers
from vsgdesign.report.drawing.panels import Scaled, scaled_maps, surface_scale
from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.drawing.style import COLOURS, NOTE_COLOUR, PAGE_IN, TEXT_PT, add_axes, look, new_figure
from vsgdesign.report.drawing.time_axis import symbols

Array = NDArray[np.float64]

MAPS = 2
"""Part of the page."""

_EMPTY = "#C9C9C9"
"""Grey of bins without cases: apart from the pale blue of bins without a broken case."""
_SHARES = np.concatenate([[[0.90, 0.945, 0.975]], oranges(np.linspace(0.04, 1.0, 255))])
"""Nothing broken is pale blue; shares go from light to dark orange."""
_COUNTS = blues(np.linspace(0.0, 0.7, 256))
"""Few cases are pale and many are blue, so that marks of any other colour stand out."""
_BROKEN: dict[str, Any] = {
    "marker": "o",
    "markersize": 3.4,
    "markerfacecolor": "#000000",
    "markeredgecolor": "#FFFFFF",
    "markeredgewidth": 0.6,
    "linestyle": "",
    "zorder": 6,
}
_RANK: dict[str, Any] = {"marker": "+", "markersize": 5.0, "markeredgewidth": 1.0, "linestyle": "", "zorder": 7}
_FOUND: dict[str, Any] = {"marker": "x", "markersize": 4.4, "markeredgewidth": 1.1, "linestyle": "", "zorder": 7}


@dataclass(frozen=True, eq=False)
class _Panel(Scaled):
    """A quantity of every bin; NaN where it has no cases.

    ``broken``: which bins get a dot. ``places``: whether the worst cases are marked in it.
    """

    broken: NDArray[np.bool_] | None = None
    places: bool = False


@dataclass(frozen=True, eq=False)
class _Bins:
    scr: Array
    x_over_r: Array
    scr_label: str
    judged: Array
    broken: Array
    worst: Sequence[Mapping[str, Any]]
    found: Sequence[Mapping[str, Any]]


def map_figures(document: Mapping[str, Any]) -> Iterator[NamedFigure]:
    """One figure for each family of which cases were judged."""
    found = document.get("map") or {"families": {}}
    for name, family in families_of(document):
        one = found["families"].get(name, {"judged": [0]})
        if not np.any(one["judged"]):
            continue
        basis = found.get("scr_basis")
        axes = [np.asarray(found[f"{axis}_edges"], dtype=float) for axis in ("scr", "x_over_r")]
        judged, broken = (_joined(np.asarray(one[key], dtype=float), axes, np.sum) for key in ("judged", "broken"))
        worst = {
            key: _joined(_with_infinity(rows, one["judged"]), axes, _largest) for key, rows in one["worst_of"].items()
        }
        bins = _Bins(
            _widened(axes[0]),
            _widened(axes[1]),
            f"SCR, {basis} basis [1]" if basis else "SCR [1]",
            judged,
            broken,
            [case for case in document["worst"] if case["family"] == name],
            [case for case in document["search"]["found"] if case["family"] == name],
        )
        panels = [*_worst_panels(family, worst), *_count_panels(name, family, bins)]
        with look():
            yield _draw(name, family, panels, bins)


def _with_infinity(rows: Any, judged: Any) -> Array:
    """Worst values of every bin: infinite where a judged case has none, because it never settled; NaN without cases."""
    values = np.array([[np.inf if value is None else value for value in row] for row in rows], dtype=float)
    return np.where(np.asarray(judged) > 0, values, np.nan)


def _joined(values: Array, axes: Sequence[Array], join: Callable[..., Array]) -> Array:
    """Bins along an axis of which only one value is drawn are one bin."""
    for k, edges in enumerate(axes):
        if edges[0] == edges[-1]:
            values = join(values, axis=k, keepdims=True)
    return values


def _largest(values: Array, axis: int, keepdims: bool) -> Array:
    # fmax leaves NaN out, and does not warn where there is nothing else.
    return np.fmax.reduce(values, axis=axis, keepdims=keepdims)


def _widened(edges: Array) -> Array:
    """Edges that can be drawn: a single value becomes a bin around it."""
    return edges if edges[0] < edges[-1] else np.array([edges[0] / 1.25, 1.25 * edges[0]])


def _worst_panels(family: Mapping[str, Any], worst: Mapping[str, Array]) -> Iterator[_Panel]:
    """The figures that a promise limits; where nothing is limited, the first two."""
    limited = [key for key in worst if promise_about(family, key) is not None]
    for key in limited or list(worst)[:2]:
        found = promise_about(family, key)
        name = key if found is None else figure_of(*found)
        words = figure_words(name)
        values = words.factor * worst[key]
        known = values[np.isfinite(values)]
        if not len(known):
            continue
        label = f"{words.title} [{words.unit}]"
        if found is None:
            yield _Panel(f"Worst {_lower_first(words.title)}", label, values, surface_scale(known))
            continue
        at_least = bool(found[1].get("at_least"))
        limit = words.factor * (found[1]["limit"] if at_least else most_of(found[1]))
        low, high = 0.0 if words.unit == "%" else float(known.min()), float(known.max())
        low, high = min(low, 0.9 * limit), max(high, 1.5 * limit)
        ticks = (*_round_ticks(low, limit, 4), *_round_ticks(limit, high, 3))
        scale = Scale(low, high, limit, at_least, ticks=ticks)
        with np.errstate(invalid="ignore"):
            broken = values < limit if at_least else values > limit
        asked = f"{'≥' if at_least else '≤'} {value_text(name, found[1]['limit'])}"
        title = f"Worst {_lower_first(words.title)}, asked for {asked}"
        yield _Panel(title, label, values, scale, broken)


def _count_panels(name: str, family: Mapping[str, Any], bins: _Bins) -> Iterator[_Panel]:
    noun = family_noun(name, family)
    empty = bins.judged == 0.0
    if bins.broken.any():
        shares = np.where(empty, np.nan, 100.0 * bins.broken / np.where(empty, 1.0, bins.judged))
        top = float(np.nanmax(shares))
        scale = Scale(0.0, top, ticks=tuple(_round_ticks(0.0, top)), listed=_SHARES)
        yield _Panel("Share of broken cases", "Broken [%]", shares, scale, bins.broken > 0.0)
    counts = np.where(empty, np.nan, bins.judged)
    top = float(bins.judged.max())
    title = f"Judged {noun}" + (", and the worst of them" if bins.worst or bins.found else "")
    scale = Scale(0.0, top, ticks=tuple(_round_ticks(0.0, top)), listed=_COUNTS)
    yield _Panel(title, "Cases [1]", counts, scale, places=True)


def _round_ticks(low: float, high: float, count: int = 6) -> list[float]:
    from matplotlib.ticker import MaxNLocator

    return [float(tick) for tick in MaxNLocator(count).tick_values(low, high)]


def _draw(name: str, family: Mapping[str, Any], panels: Sequence[_Panel], bins: _Bins) -> NamedFigure:
    def draw(axes: Any, k: int, _width: float, _height: float) -> None:
        _draw_panel(axes, panels[k], bins)

    figure = scaled_maps(panels, bins.scr_label, draw, _legend_entries(panels, bins))
    caption = (
        "How to read: each bin is a range of SCR and X/R of the grid on which a case ends. The colour of a worst "
        "figure is that of the worst judged case in the bin: blue within the limit, orange beyond it. Bins without "
        "judged cases are grey."
    )
    if bins.broken.any():
        caption += " A black dot marks a bin in which a case breaks what the panel shows."
    if bins.worst:
        caption += " Plus signs: the worst drawn cases, in the table below."
    if bins.found:
        caption += " Crosses: found by searching, which do not count in any share."
    return NamedFigure(
        f"verification_map_{name}", f"{family_title(name, family)} over the grids", caption, figure, MAPS
    )


def _draw_panel(axes: Any, panel: _Panel, bins: _Bins) -> None:
    x, y = bins.scr, bins.x_over_r
    axes.set_facecolor(_EMPTY)
    bin_axes(axes, x, y)
    paint(axes, x, y, panel.values, panel.scale)
    for axis, ends in ((axes.xaxis, x), (axes.yaxis, y)):
        _log_ticks(axis, float(ends[0]), float(ends[-1]))
    if panel.places:
        for cases, style, colour in ((bins.worst, _RANK, COLOURS[1]), (bins.found, _FOUND, COLOURS[6])):
            ends = [case.get("end") or case["start"] for case in cases]
            places = [(end["scr"], end["x_over_r"]) for end in ends]
            if places:
                axes.plot(*zip(*places, strict=True), color=colour, clip_on=False, **style)
    if panel.broken is not None and panel.broken.any():
        places = np.argwhere(panel.broken)
        middle_x, middle_y = np.sqrt(x[1:] * x[:-1]), np.sqrt(y[1:] * y[:-1])
        axes.plot(middle_x[places[:, 0]], middle_y[places[:, 1]], **_BROKEN)


def _tick_text(value: float, _position: int | None) -> str:
    return plain(value, 3)


def _log_ticks(axis: Any, low: float, high: float) -> None:
    """Ticks at 1, 2 and 5 of every decade, and at both ends where they are apart from those."""
    from matplotlib.ticker import FixedLocator, NullLocator

    if high / low < 1.6:  # one value alone
        axis.set_major_locator(FixedLocator([math.sqrt(low * high)]))
        axis.set_major_formatter(_tick_text)
        axis.set_minor_locator(NullLocator())
        return
    apart = [tick for tick in round_numbers(low, high) if min(tick / low, high / tick) > 1.25]
    axis.set_major_locator(FixedLocator([low, *apart, high]))
    axis.set_major_formatter(_tick_text)
    axis.set_minor_locator(NullLocator())


def _legend_entries(panels: Sequence[_Panel], bins: _Bins) -> list[tuple[Any, str]]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[tuple[Any, str]] = []
    if any(panel.broken is not None and panel.broken.any() for panel in panels):
        entries.append((Line2D([], [], **_BROKEN), "broken in this bin"))
    if (bins.judged == 0.0).any():
        entries.append((Patch(facecolor=_EMPTY, edgecolor="#999999", linewidth=0.4), "no judged cases"))
    if bins.worst:
        entries.append((Line2D([], [], color=COLOURS[1], **_RANK), "worst drawn"))
    if bins.found:
        entries.append((Line2D([], [], color=COLOURS[6], **_FOUND), "found by searching"))
    return entries


def _lower_first(text: str) -> str:
    return text[:1].lower() + text[1:]


PROMISES = 1
"""Part of the page."""

_LEFT, _RIGHT, _BOTTOM, _TOP = 1.62, 1.55, 0.62, 0.08
_ROW, _HEADING = 0.22, 0.24
_FARTHEST = 2.0
"""A worst value beyond this share of its limit is drawn at the edge, with its share beside it."""

_MARKS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("50", "median", {"marker": "|", "markersize": 8.0, "markeredgewidth": 1.2, "color": COLOURS[0]}),
    ("90", "90 %", {"marker": "o", "markersize": 3.4, "color": COLOURS[0], "markerfacecolor": "#FFFFFF"}),
    ("99", "99 %", {"marker": "o", "markersize": 3.4, "color": COLOURS[0]}),
    ("99.9", "99.9 %", {"marker": "s", "markersize": 3.6, "color": COLOURS[0]}),
)
_WORST: dict[str, Any] = {"marker": "D", "markersize": 4.2, "linestyle": ""}


def promises_figure(document: Mapping[str, Any]) -> NamedFigure | None:
    """One row for each promise with a limit, by family; None where there is none with values."""
    rows = [
        (family_name, family, [(name, p) for name, p in promises_of(family) if _is_drawn(p)])
        for family_name, family in families_of(document)
    ]
    rows = [row for row in rows if row[2]]
    if not rows:
        return None
    with look():
        return _draw_promises(rows)


def _is_drawn(promise: Mapping[str, Any]) -> bool:
    return bool(most_of(promise)) and promise["judged"] > 0


def _draw_promises(families: list[tuple[str, Mapping[str, Any], list[tuple[str, Mapping[str, Any]]]]]) -> NamedFigure:
    from matplotlib.lines import Line2D

    count = sum(len(promises) for _, _, promises in families)
    height = _ROW * count + _HEADING * len(families)
    width = PAGE_IN - _LEFT - _RIGHT
    total = _BOTTOM + height + _TOP
    figure = new_figure(PAGE_IN, total)
    axes = add_axes(figure, _LEFT, _BOTTOM, width, height)
    shares = [_share_of_limit(p, p["worst"]) for _, _, promises in families for _, p in promises]
    right = max([1.12, *(1.06 * share for share in shares if share <= _FARTHEST)])
    if max(shares) > right:
        right = max(right, 1.3)
    axes.set_xlim(0.0, 100.0 * right)
    axes.set_ylim(height, 0.0)
    axes.grid(False, axis="y")
    axes.axvline(100.0, color="#000000", linewidth=1.1, zorder=2)
    axes.axvspan(100.0, 100.0 * right, color="#FBEFE6", linewidth=0.0, zorder=0.5)
    beside = {"fontsize": TEXT_PT, "va": "center", "clip_on": False}
    at, aside = 0.0, 10.0 * right / width
    axes.text(100.0 * right + aside, 0.6 * _HEADING, "broken of judged, bound", ha="left", color=NOTE_COLOUR, **beside)
    for family_name, family, promises in families:
        axes.text(
            -(_LEFT - 0.04) / width * 100.0 * right,
            at + 0.6 * _HEADING,
            symbols(family_title(family_name, family)),
            ha="left",
            fontweight="bold",
            **beside,
        )
        at += _HEADING
        for name, promise in promises:
            y = at + 0.5 * _ROW
            at += _ROW
            _draw_row(axes, y, promise, right)
            title = symbols(promise_text(name, promise))
            axes.text(-1.5 * right, y, title, ha="right", **beside)
            said = f"{counted_of(promise['broken'])} of {counted_of(promise['judged'])}, < {bound_text(promise)}"
            axes.text(100.0 * right + aside, y, said, ha="left", **beside)
    axes.set_yticks([])
    axes.set_xlabel("Value over the largest that is allowed [%]")
    for side in ("left", "right", "top"):
        axes.spines[side].set_visible(False)
    entries = [(Line2D([], [], linestyle="", **style), label) for _, label, style in _MARKS]
    entries.append((Line2D([], [], color=COLOURS[0], **_WORST), "worst, within the limit"))
    if any(share > 1.0 for share in shares):
        entries.append((Line2D([], [], color=COLOURS[1], **_WORST), "worst, beyond it"))
    figure.legend(
        *zip(*entries, strict=True),
        ncols=len(entries),
        loc="lower left",
        bbox_to_anchor=(0.0, 0.03 / total),
        handlelength=1.0,
    )
    caption = (
        "How to read: each row is a promise, and its marks are quantiles of all judged cases over what is allowed, "
        "from the median to the worst. Right of the black line the promise is broken. On the right: broken and judged "
        "cases, and below which share the broken ones are at the stated confidence."
    )
    return NamedFigure("verification_promises", "How far the cases stay from their limits", caption, figure, PROMISES)


def _draw_row(axes: Any, y: float, promise: Mapping[str, Any], right: float) -> None:
    worst = _share_of_limit(promise, promise["worst"])
    marks = {q: _share_of_limit(promise, promise["quantiles"].get(q)) for q, _, _ in _MARKS}
    ends = [min(share, right) for share in (*marks.values(), worst)]
    axes.plot([100.0 * min(ends), 100.0 * max(ends)], [y, y], color="#BDBDBD", linewidth=1.2, zorder=1)
    for q, _, style in _MARKS:
        if marks[q] <= right:
            axes.plot([100.0 * marks[q]], [y], linestyle="", zorder=3, **style)
    colour = COLOURS[1] if worst > 1.0 else COLOURS[0]
    at = 100.0 * (worst if worst <= right else 0.98 * right)
    axes.plot([at], [y], color=colour, zorder=4, **_WORST)
    if worst > right:
        beyond = f"{100.0 * worst:.0f} %" if math.isfinite(worst) else "∞"
        axes.text(at, y - 0.05, beyond, ha="center", va="bottom", fontsize=TEXT_PT)


def _share_of_limit(promise: Mapping[str, Any], value: float | None) -> float:
    """Value over the largest that keeps the promise, infinite without a value; for a lower limit, limit over value:
    above 1 is broken in both."""
    if value is None:
        return math.inf
    if promise.get("at_least"):
        return promise["limit"] / value if value > 0.0 else math.inf
    return value / most_of(promise)
