"""Pictures of the size of a word, as the text of inline SVG: a step response, a bar against its limit, a line's key.

They need no axes: words beside them say the figures. Coordinates are rounded to a tenth of a pixel, so that two builds
are the same and a page stays small.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from vsgdesign.report.drawing.decimation import extreme_indices
from vsgdesign.report.drawing.style import line_style

Array = NDArray[np.float64]

WIDTH, HEIGHT = 132, 40
"""Size of a step response, px."""

_BAR_WIDTH, _BAR_HEIGHT = 90, 10
_COLUMNS = 66


def key(index: int) -> Markup:
    """A sample of the line that the curve with this index has in the page's figures."""
    return Markup('<svg class="key" viewBox="0 0 26 8" width="26" height="8" aria-hidden="true">{}</svg>').format(
        Markup('<line x1="0" y1="4" x2="26" y2="4"{}/>').format(_stroke(index, 2.0))
    )


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
) -> Markup:
    """A response y over t (both (n,), same length) within a window of time and between two levels.

    ``final`` is drawn as a dashed line, the time ``due`` at which it is asked to be there as a dotted one, and the time
    at which it has settled as a circle on the curve. What lies beyond the levels is cut off. ``index`` gives the colour
    and the dashes of the figures, ``label`` is read out in place of the picture.
    """
    parts = []
    if final is not None:
        parts.append(_line(0.0, _up(final, levels), WIDTH, _up(final, levels), "#777", "3 2"))
    if due is not None and window[0] <= due <= window[1]:
        x = _along(due, window)
        parts.append(_line(x, 0.0, x, HEIGHT, "#444", "1 2"))
    inside = (t >= window[0]) & (t <= window[1]) & np.isfinite(y)
    if np.count_nonzero(inside) > 1:
        t, y = t[inside], y[inside]
        picks = extreme_indices(y, _COLUMNS)
        # Far beyond the levels a curve is outside the picture wherever it is, and short numbers keep the page small.
        ys = np.clip(_up(y[picks], levels), -HEIGHT, 2.0 * HEIGHT)
        points = " ".join(f"{_short(a)},{_short(b)}" for a, b in zip(_along(t[picks], window), ys, strict=True))
        parts.append(Markup('<polyline points="{}" fill="none"{}/>').format(points, _stroke(index, 1.5)))
        if settled is not None and t[0] <= settled <= t[-1]:
            at = float(np.interp(settled, t, y))
            parts.append(
                Markup('<circle cx="{}" cy="{}" r="2.6" fill="#fff"{}/>').format(
                    _short(_along(settled, window)), _short(_up(at, levels)), _stroke(index, 1.3, dashed=False)
                )
            )
    return _picture("spark", WIDTH, HEIGHT, label, parts)


def bar(value: float, limit: float | None, largest: float, label: str) -> Markup:
    """A value as a bar, its limit as a black line across it. ``largest`` is the end of the scale,
    which is shaded.

    The part beyond the limit is hatched, so that it is seen without colours too.
    """
    end = _BAR_WIDTH * value / largest
    within = end if limit is None else min(end, _BAR_WIDTH * limit / largest)
    parts = [_box(0.0, _BAR_WIDTH, "#EEE"), _box(0.0, within, "#8FB8D0")]
    if end > within:
        parts.append(_box(within, end - within, "#E8A077"))
        parts += [_line(x, _BAR_HEIGHT, x + 4.0, 0.0, "#7A2E00") for x in np.arange(within + 1.0, end - 4.0, 4.0)]
    if limit is not None:
        x = _BAR_WIDTH * limit / largest
        parts.append(_line(x, -2.0, x, _BAR_HEIGHT + 2.0, "#000", width=2.0))
    return _picture("bar", _BAR_WIDTH, _BAR_HEIGHT, label, parts)


def levels_of(curves: Sequence[Array], besides: Sequence[float]) -> tuple[float, float]:
    """Levels between which all curves and values lie, with a little room; never a range of zero."""
    ends = [float(f(y)) for y in curves if len(y) for f in (np.min, np.max)] + list(besides)
    low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
    room = 0.08 * (high - low) or 0.5 * max(abs(high), 1.0)
    return low - room, high + room


def _picture(kind: str, width: float, height: float, label: str, parts: Sequence[Markup]) -> Markup:
    return Markup(
        '<svg class="{}" role="img" aria-label="{}" viewBox="0 0 {} {}" width="{}" height="{}">{}</svg>'
    ).format(kind, label, width, height, width, height, Markup("").join(parts))


def _along(t: Any, window: tuple[float, float]) -> Any:
    return WIDTH * (t - window[0]) / (window[1] - window[0])


def _up(y: Any, levels: tuple[float, float]) -> Any:
    return HEIGHT * (levels[1] - y) / (levels[1] - levels[0])


def _stroke(index: int, width: float, dashed: bool = True) -> Markup:
    style = line_style(index)
    dashes = style["linestyle"]
    dash = "" if isinstance(dashes, str) or not dashed else " ".join(f"{1.2 * length:g}" for length in dashes[1])
    text = Markup(' stroke="{}" stroke-width="{:g}"').format(style["color"], width)
    return text + Markup(' stroke-dasharray="{}"').format(dash) if dash else text


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, dashes: str = "", width: float = 1.0) -> Markup:
    dashed = Markup(' stroke-dasharray="{}"').format(dashes) if dashes else Markup("")
    return Markup('<line x1="{}" y1="{}" x2="{}" y2="{}" stroke="{}" stroke-width="{:g}"{}/>').format(
        *(_short(value) for value in (x1, y1, x2, y2)), colour, width, dashed
    )


def _box(x: float, width: float, colour: str) -> Markup:
    return Markup('<rect x="{}" y="0" width="{}" height="{}" fill="{}"/>').format(
        _short(x), _short(width), _BAR_HEIGHT, colour
    )


def _short(value: float) -> str:
    return f"{round(float(value), 1) + 0.0:g}"
