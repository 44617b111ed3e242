"""Drawings of few parts, made without matplotlib: lines, areas and words, as the text of inline SVG; and the HTML
around them.

A page with hundreds of figures needs them small and made in milliseconds. The same sketch can be painted on a page of a
PDF (:mod:`vsgdesign.report.drawing.paper`). x runs to the right and y downwards, in px.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

Array = NDArray[np.float64]

START, MIDDLE, END = "start", "middle", "end"

_TENTHS = 10.0
"""Coordinates in the file are whole tenths of a pixel."""


@dataclass(frozen=True, eq=False)
class Stroke:
    """A line through points (n, 2). It is cut where a coordinate is NaN."""

    points: Array
    colour: str
    width: float = 1.0
    dashes: tuple[float, ...] = ()

    def runs(self) -> list[Array]:
        """The runs of at least two points without NaN."""
        known = np.isfinite(self.points).all(axis=1)
        if known.all():
            return [self.points] if len(self.points) > 1 else []
        ends = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
        return [self.points[a:b] for a, b in zip(ends[::2], ends[1::2], strict=True) if b - a > 1]

    @cached_property
    def path(self) -> str:
        """The line as the path of an SVG; a figure may stand on a page and in a file of its own."""
        return "".join(_path(run) for run in self.runs())


@dataclass(frozen=True, eq=False)
class Area:
    """A filled polygon (n, 2), perhaps with an edge."""

    points: Array
    colour: str
    edge: str = ""


@dataclass(frozen=True)
class Words:
    """A line of text with its baseline at y, ``anchor`` at x; turned by 90° to the left if ``upright``."""

    x: float
    y: float
    text: str
    size: float = 11.0
    anchor: str = START
    colour: str = "#1A1A1A"
    bold: bool = False
    upright: bool = False


Part = Stroke | Area | Words


@dataclass
class Sketch:
    """Parts in the order in which they are drawn. ``label`` is read out in place of the drawing."""

    width: float
    height: float
    label: str
    parts: list[Part] = field(default_factory=list)
    kind: str = "sketch"
    """Its class on a page."""

    def __html__(self) -> str:
        """The sketch in a page that takes it as a part of a text, at its own size."""
        return svg(self, sized=True)

    def line(
        self, start: tuple[float, float], end: tuple[float, float], colour: str, width: float = 1.0, dashes: tuple = ()
    ) -> None:
        """A straight line between two points."""
        self.parts.append(Stroke(np.array([start, end], dtype=float), colour, width, dashes))

    def box(self, x: float, y: float, width: float, height: float, colour: str, edge: str = "") -> None:
        """A filled rectangle from its upper left corner."""
        corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
        self.parts.append(Area(np.array(corners, dtype=float), colour, edge))


def svg(sketch: Sketch, kind: str = "", stretched: bool = False, sized: bool = False) -> Markup:
    """The sketch as an element of a page: of class ``kind`` or its own, no larger than its size in px.

    ``stretched``: it keeps its height where the page is narrow. ``sized``: it has its own size wherever it stands.
    """
    body = "".join(_part(part) for part in sketch.parts)
    shape = f'preserveAspectRatio="none" height="{sketch.height:.0f}" ' if stretched else ""
    if sized:
        shape = f'width="{sketch.width:g}" height="{sketch.height:g}" '
    box = f"{sketch.width * _TENTHS:.0f} {sketch.height * _TENTHS:.0f}"
    label = filled('role="img" aria-label="{}"', sketch.label) if sketch.label else Markup('aria-hidden="true"')
    form = '<svg class="{}" {} viewBox="0 0 {}" {}style="max-width:{}px">{}</svg>'
    return filled(form, kind or sketch.kind, label, box, Markup(shape), f"{sketch.width:g}", Markup(body))


def svg_file(sketches: Sequence[Sketch], title: str, lines: Iterable[str] = ()) -> str:
    """Sketches side by side below a title and lines of text, as a file of its own."""
    texts = [Words(8.0, 18.0, title, 13.0, bold=True)]
    texts += [Words(8.0, 34.0 + 15.0 * k, line) for k, line in enumerate(lines)]
    top = texts[-1].y + 10.0
    width, height = sum(one.width for one in sketches), top + max((one.height for one in sketches), default=0.0)
    parts = ["".join(_part(text) for text in texts)]
    x = 0.0
    for one in sketches:
        parts.append(f'<g transform="translate({_TENTHS * x:.0f} {_TENTHS * top:.0f})">')
        parts += [*(_part(part) for part in one.parts), "</g>"]
        x += one.width
    size = f'viewBox="0 0 {_TENTHS * width:.0f} {_TENTHS * height:.0f}" width="{width:.0f}" height="{height:.0f}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="Arial, \'DejaVu Sans\', sans-serif">'
    return f'{head}<rect width="100%" height="100%" fill="#fff"/>{"".join(parts)}</svg>\n'


def _part(part: Part) -> str:
    if isinstance(part, Words):
        return _words(part)
    if isinstance(part, Area):
        edge = f' stroke="{part.edge}" stroke-width="8"' if part.edge else ""
        return f'<path d="{_path(part.points)}z" fill="{part.colour}"{edge}/>'
    dashes = " ".join(f"{_TENTHS * part.width * length:.0f}" for length in part.dashes)
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
    width = f"{_TENTHS * part.width:g}"
    path = part.path
    return f'<path d="{path}" fill="none" stroke="{part.colour}" stroke-width="{width}"{dashed}/>' if path else ""


def _words(part: Words) -> str:
    from markupsafe import escape

    x, y = round(_TENTHS * part.x), round(_TENTHS * part.y)
    turned = f' transform="rotate(-90 {x} {y})"' if part.upright else ""
    anchor = f' text-anchor="{part.anchor}"' if part.anchor != START else ""
    bold = ' font-weight="600"' if part.bold else ""
    look = f'font-size="{_TENTHS * part.size:g}" fill="{part.colour}"{anchor}{bold}{turned}'
    return f'<text x="{x}" y="{y}" {look}>{escape(part.text)}</text>'


def _path(points: Array) -> str:
    """A path through the points on the grid of tenths, without points on the straight line between their neighbours."""
    if len(points) == 2:  # ticks and rules, most lines of a figure: arrays take ten times as long for them
        (x, y), (to_x, to_y) = ((round(_TENTHS * x), round(_TENTHS * y)) for x, y in points.tolist())
        return f"M{x} {y}l{to_x - x}{' ' if to_y >= y else ''}{to_y - y}"
    whole = np.rint(_TENTHS * points).astype(np.int64)
    steps = whole[1:] - whole[:-1]
    moved = (steps[:, 0] != 0) | (steps[:, 1] != 0)
    moved[:1] = True  # a line of one point is a dot
    steps = steps[moved]
    if not len(steps):
        return ""
    before, after = steps[:-1], steps[1:]
    turns = before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]
    back = before[:, 0] * after[:, 0] + before[:, 1] * after[:, 1] < 0
    # Steps in one direction become one.
    corners = np.cumsum(steps, axis=0)[np.append(np.flatnonzero(turns | back), len(steps) - 1)]
    corners[1:] -= corners[:-1].copy()
    # All numbers are written at once: one at a time they take longer than everything before.
    form = " ".join(["%d%d" if up else "%d %d" for up in (corners[:, 1] < 0).tolist()])
    return f"M{whole[0, 0]} {whole[0, 1]}l{form % tuple(corners.ravel().tolist())}"


def filled(form: str, *values: object) -> Markup:
    """A form, which is HTML, with a value for each of its ``{}``: escaped, unless it is HTML itself.

    It gives what ``Markup(form).format(*values)`` gives in a fifth of the time, and pages have ten thousands of them.
    Raises ValueError where there are more places than values, or fewer.
    """
    first, *pieces = _pieces(form)
    parts = [first]
    for piece, value in zip(pieces, values, strict=True):
        parts += (value if type(value) is Markup else escape(value), piece)
    return Markup("".join(parts))


@functools.lru_cache(maxsize=1024)
def _pieces(form: str) -> list[str]:
    return form.split("{}")
