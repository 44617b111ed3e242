"""Pages of a PDF without a browser: text, lines and sketches at places in points.

x runs to the right and y downwards, in pt from the upper left corner.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.sketch import END, MIDDLE, START, Area, Part, Sketch, Stroke, Words

if TYPE_CHECKING:
    from fpdf import FPDF

Array = NDArray[np.float64]

WIDTH, HEIGHT = 841.9, 595.3
"""A4, on its side: a matrix is wide."""

MARGIN = 36.0

PNG_DPI = 200.0
"""Dots per inch of every figure's PNG."""

_FAMILY = "DejaVu"

_NO_DATE = datetime(2000, 1, 1, tzinfo=UTC)
"""The same in every file: equal pages are equal bytes."""


@dataclass(frozen=True)
class Picture:
    """A picture of a file (PNG) with its upper left corner at a place, in pt."""

    file: Path
    x: float
    y: float
    width: float
    height: float


@dataclass
class Sheet:
    """One page: parts in the order in which they are drawn. ``marks``: entries of the list of contents, with y."""

    parts: list[Part | Picture] = field(default_factory=list)
    marks: list[tuple[str, float]] = field(default_factory=list)
    width: float = WIDTH
    height: float = HEIGHT

    def text(self, x: float, y: float, text: str, size: float = 7.0, **look_of: Any) -> None:
        """A line of text with its baseline at y."""
        self.parts.append(Words(x, y, text, size, **look_of))

    def line(
        self, start: tuple[float, float], end: tuple[float, float], colour: str = "#333333", width: float = 0.5
    ) -> None:
        """A straight line."""
        self.parts.append(Stroke(np.array([start, end]), colour, width))

    def box(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """A filled rectangle from its upper left corner."""
        corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
        self.parts.append(Area(np.array(corners), colour))

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
                moved = Area(corner + scale * part.points, part.colour, part.edge)
            self.parts.append(moved)


def save(sheets: Sequence[Sheet], path: str | Path, title: str) -> Path:
    """Write pages. The same pages give the same bytes, whenever and wherever they are written."""
    from fpdf import FPDF
    from fpdf.enums import PageMode

    pdf = FPDF(unit="pt", format=(WIDTH, HEIGHT))
    pdf.set_auto_page_break(False)
    pdf.set_margin(0.0)
    pdf.set_title(title)
    pdf.set_producer("vsgdesign")
    pdf.set_creation_date(_NO_DATE)
    if any(sheet.marks for sheet in sheets):
        pdf.page_mode = PageMode.USE_OUTLINES
    for bold in (False, True):
        pdf.add_font(_FAMILY, "B" if bold else "", _font_file(bold))
    codes: dict[tuple[str, bool], str] = {}
    for sheet in sheets:
        pdf.add_page(format=(sheet.width, sheet.height))
        for text, y in sheet.marks:
            pdf.set_xy(0.0, y)
            pdf.start_section(text)
        for part in sheet.parts:
            _draw(pdf, part, codes)
    path = Path(path)
    path.write_bytes(bytes(pdf.output()))
    return path


def png_size(file: Path) -> tuple[float, float]:
    """Width and height of a figure's PNG on paper, pt: as large as its SVG."""
    size = np.frombuffer(file.read_bytes()[16:24], dtype=">u4")
    return float(size[0]) * 72.0 / PNG_DPI, float(size[1]) * 72.0 / PNG_DPI


@functools.lru_cache(maxsize=20_000)
def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width of a text in pt."""
    return size * _added(0.0, _drawable(text, bold), bold)


def _added(width: float, text: str, bold: bool) -> float:
    """A width with the widths of more characters, of size 1."""
    return sum(map(_widths(bold).__getitem__, text), width)


_EMPTY = "□"


def _drawable(text: str, bold: bool) -> str:
    """The text with an empty box in place of each letter that the font does not have."""
    widths = _widths(bold)
    if widths.keys() >= set(text):
        return text
    return "".join(letter if letter in widths else _EMPTY for letter in text)


def wrapped(text: str, size: float, width: float, bold: bool = False, most: int = 99) -> list[str]:
    """The text in lines of at most ``width`` pt. What is beyond ``most`` lines becomes an ellipsis."""
    text = " ".join(text.split())
    if text_width(text, size, bold) <= width:
        return [text]
    lines: list[str] = []
    line, taken = "", 0.0
    for word in text.split():
        more = f" {word}" if line else word
        longer = _added(taken, _drawable(more, bold), bold)
        if size * longer <= width:
            line, taken = line + more, longer
            continue
        if line:
            lines.append(line)
        line = word
        while text_width(line, size, bold) > width and len(line) > 1:
            fits = next(n for n in range(len(line) - 1, 0, -1) if n == 1 or text_width(line[:n], size, bold) <= width)
            lines.append(line[:fits])
            line = line[fits:]
        taken = text_width(line, 1.0, bold)
    lines.append(line)
    if len(lines) > most:
        last = lines[most - 1]
        while last and text_width(last + " …", size, bold) > width:
            last = last[:-1]
        lines = [*lines[: most - 1], last.rstrip() + " …"]
    return lines


@functools.cache
def _font_file(bold: bool) -> Path:
    """A font that comes with matplotlib: it has the signs of this field, and every machine has the same."""
    found = find_spec("matplotlib")  # which takes long to import, and says the same place
    if found is None or found.origin is None:
        raise ModuleNotFoundError("matplotlib, whose fonts are on the pages of a PDF, is not installed")
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return Path(found.origin).parent / "mpl-data" / "fonts" / "ttf" / name


@functools.cache
def _widths(bold: bool) -> Mapping[str, float]:
    """Widths of the characters of a font, as a share of its size."""
    from fontTools.ttLib import TTFont

    with TTFont(_font_file(bold), lazy=True) as font:
        metrics, scale = font["hmtx"].metrics, 1.0 / font["head"].unitsPerEm  # type: ignore[attr-defined]
        return {chr(code): scale * metrics[glyph][0] for code, glyph in (font.getBestCmap() or {}).items()}


@functools.cache
def _colour(text: str) -> Any:
    """A colour such as #1A1A1A as the library has it, which else reads its digits again for each part."""
    from fpdf.drawing_primitives import color_from_hex_string

    return color_from_hex_string(text)


def _draw(pdf: FPDF, part: Part | Picture, codes: dict[tuple[str, bool], str]) -> None:
    """``codes``: texts with their weights as the document has them so far."""
    if isinstance(part, Words):
        _words(pdf, part, codes)
    elif isinstance(part, Picture):
        pdf.image(part.file, part.x, part.y, part.width, part.height)
    elif isinstance(part, Area):
        pdf.set_fill_color(_colour(part.colour))
        if part.edge:
            pdf.set_draw_color(_colour(part.edge))
            pdf.set_line_width(0.4)
        _path(pdf, part.points, "h B" if part.edge else "h f")
    else:
        pdf.set_line_width(part.width)
        pdf.set_draw_color(_colour(part.colour))
        # The library's own pattern has one dash and one gap; lines of this field have up to three of each.
        pdf._out(f"[{' '.join(f'{part.width * length:.2f}' for length in part.dashes)}] 0 d")
        for run in part.runs():
            _path(pdf, run, "S")


def _path(pdf: FPDF, points: Array, end: str) -> None:
    # Its own polyline writes point by point, which takes longer than everything else of a page of curves.
    upwards = points * (1.0, -1.0) + (0.0, pdf.h)
    form = f"%.2f %.2f m{' %.2f %.2f l' * (len(points) - 1)} {end}"
    pdf._out(form % tuple(upwards.ravel().tolist()))


def _words(pdf: FPDF, part: Words, codes: dict[tuple[str, bool], str]) -> None:
    x, y, text = part.x, part.y, _drawable(part.text, part.bold)
    pdf.set_font(_FAMILY, "B" if part.bold else "", part.size)
    font: Any = pdf.current_font
    colour = _colour(part.colour)
    pdf.set_text_color(colour)
    back = {START: 0.0, MIDDLE: 0.5, END: 1.0}[part.anchor]
    if back:
        back *= text_width(text, part.size, part.bold)
    if part.upright:
        with pdf.rotation(90.0, x, y):
            pdf.text(x - back, y, text)
        return
    # What the library writes for a text, which it else encodes letter by letter each time that it comes.
    if not pdf.current_font_is_set_on_page:
        pdf._out(pdf._set_font_for_page(font, pdf.font_size_pt))
    code = codes.get((text, part.bold))
    if code is None:
        code = codes[text, part.bold] = font.encode_text(text)
    shown = f"BT {x - back:.2f} {pdf.h - y:.2f} Td {code} ET"
    if pdf.fill_color != colour:
        shown = f"q {colour.serialize().lower()} {shown} Q"
    pdf._out(shown)
