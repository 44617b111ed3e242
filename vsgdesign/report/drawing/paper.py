"""Pages of a PDF without a browser: text, lines and sketches at places in points, written by matplotlib's PDF backend.

matplotlib sets out each text as an object of its own, which takes a second for twenty pages. Here a page is one object
that hands its texts straight to the backend. x runs to the right and y downwards, in pt from the upper left corner.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D

from vsgdesign.report.drawing.sketch import END, MIDDLE, Area, Part, Sketch, Stroke, Words
from vsgdesign.report.drawing.style import look

WIDTH, HEIGHT = 841.9, 595.3
"""A4, on its side: a matrix is wide."""

MARGIN = 36.0

_PER_INCH = 72.0

_BOX = 0.6


@dataclass
class Sheet:
    """One page: parts in the order in which they are drawn."""

    parts: list[Part] = field(default_factory=list)

    def text(self, x: float, y: float, text: str, size: float = 7.0, **look_of: Any) -> None:
        """A line of text with its baseline at y."""
        self.parts.append(Words(x, y, text, size, **look_of))

    def line(self, start: tuple[float, float], end: tuple[float, float], colour: str = "#333333", width: float = 0.5):
        """A straight line."""
        self.parts.append(Stroke(np.array([start, end]), colour, width))

    def sketch(self, sketch: Sketch, x: float, y: float, scale: float) -> None:
        """A sketch with its upper left corner at a place, in ``scale`` pt for each of its px."""
        corner = np.array([x, y])
        for part in sketch.parts:
            if isinstance(part, Words):
                moved = Words(
                    x + scale * part.x, y + scale * part.y, part.text, scale * part.size, part.anchor, part.colour,
                    part.bold, part.upright,
                )  # fmt: skip
            elif isinstance(part, Stroke):
                moved = Stroke(corner + scale * part.points, part.colour, scale * part.width, part.dashes)
            else:
                moved = Area(corner + scale * part.points, part.colour, part.edge, part.opacity)
            self.parts.append(moved)


def save(sheets: Sequence[Sheet], path: str | Path, title: str) -> Path:
    """Write pages. The same pages give the same bytes."""
    path = Path(path)
    # Without a date and without versions, so that the file depends on its content alone.
    about: dict[str, Any] = {"Title": title, "Creator": None, "Producer": None, "CreationDate": None}
    with look(), matplotlib.rc_context({"pdf.fonttype": 42}), warnings.catch_warnings():
        # A name may have any letters; a missing glyph costs a box, no more.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        _save(sheets, path, about)
    return path


def _save(sheets: Sequence[Sheet], path: Path, about: dict[str, Any]) -> None:
    with PdfPages(path, metadata=about) as pages:
        for sheet in sheets:
            figure = Figure(figsize=(WIDTH / _PER_INCH, HEIGHT / _PER_INCH), dpi=_PER_INCH)
            figure.add_artist(_Content(sheet))
            pages.savefig(figure)


@functools.lru_cache(maxsize=20_000)
def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width of a text in pt."""
    return size * sum(_advance(letter, bold) for letter in text)


def wrapped(text: str, size: float, width: float, bold: bool = False, most: int = 99) -> list[str]:
    """The text in lines of at most ``width`` pt. What is beyond ``most`` lines becomes an ellipsis."""
    text = " ".join(text.split())
    if text_width(text, size, bold) <= width:
        return [text]
    lines: list[str] = []
    line = ""
    for word in text.split():
        longer = f"{line} {word}" if line else word
        if text_width(longer, size, bold) <= width:
            line = longer
            continue
        if line:
            lines.append(line)
        line = word
        while text_width(line, size, bold) > width and len(line) > 1:
            fits = next(n for n in range(len(line) - 1, 0, -1) if n == 1 or text_width(line[:n], size, bold) <= width)
            lines.append(line[:fits])
            line = line[fits:]
    lines.append(line)
    if len(lines) > most:
        last = lines[most - 1]
        while last and text_width(last + " …", size, bold) > width:
            last = last[:-1]
        lines = [*lines[: most - 1], last.rstrip() + " …"]
    return lines


class _Content(Artist):
    """Everything of a page, drawn in one go."""

    def __init__(self, sheet: Sheet) -> None:
        super().__init__()
        self._sheet = sheet

    def draw(self, renderer: Any) -> None:
        """Hand the parts to the backend."""
        flip = Affine2D().scale(1.0, -1.0).translate(0.0, HEIGHT)
        for part in self._sheet.parts:
            gc = renderer.new_gc()
            if isinstance(part, Words):
                _draw_words(renderer, gc, part)
            elif isinstance(part, Area):
                gc.set_linewidth(0.4 if part.edge else 0.0)
                gc.set_foreground(part.edge or part.colour)
                closed = Outline(part.points, closed=False)
                face = (*matplotlib.colors.to_rgb(part.colour), part.opacity)
                renderer.draw_path(gc, closed, flip, face)
            else:
                gc.set_linewidth(part.width)
                gc.set_foreground(part.colour)
                gc.set_joinstyle("round")
                if part.dashes:
                    gc.set_dashes(0.0, [part.width * length for length in part.dashes])
                renderer.draw_path(gc, Outline(part.points), flip, None)
            gc.restore()


def _draw_words(renderer: Any, gc: Any, part: Words) -> None:
    gc.set_foreground(part.colour)
    x, y = part.x, HEIGHT - part.y
    if part.anchor in (MIDDLE, END):
        back = text_width(part.text, part.size, part.bold) * (0.5 if part.anchor == MIDDLE else 1.0)
        x, y = (x, y - back) if part.upright else (x - back, y)
    renderer.draw_text(gc, x, y, part.text, _font(part.size, part.bold), 90.0 if part.upright else 0.0)


@functools.lru_cache(maxsize=64)
def _font(size: float, bold: bool) -> FontProperties:
    return FontProperties(family="DejaVu Sans", size=size, weight="bold" if bold else "normal")


@functools.lru_cache(maxsize=4096)
def _advance(letter: str, bold: bool) -> float:
    """Width of a letter at a size of 1."""
    font = get_font(findfont(_font(10.0, bold)))
    if not font.get_char_index(ord(letter)):
        return _BOX  # what the font does not have is drawn as a box
    font.set_size(100.0, _PER_INCH)
    return font.load_char(ord(letter)).linearHoriAdvance / 65536.0 / 100.0
