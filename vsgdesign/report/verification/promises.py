"""How far the cases stay from their limits: one line for each promise, from the median to the worst."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from vsgdesign.artifacts.verification_text import (
    bound_text,
    counted_of,
    families_of,
    family_title,
    most_of,
    promise_text,
    promises_of,
)
from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.style import COLOURS, NOTE_COLOUR, PAGE_IN, TEXT_PT, add_axes, look, new_figure
from vsgdesign.report.drawing.time_axis import symbols

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
        return _draw(rows)


def _is_drawn(promise: Mapping[str, Any]) -> bool:
    return bool(most_of(promise)) and promise["judged"] > 0


def _draw(families: list[tuple[str, Mapping[str, Any], list[tuple[str, Mapping[str, Any]]]]]) -> NamedFigure:
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
