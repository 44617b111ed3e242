"""Pages of a PDF without a browser: text, lines and sketches at places in points.

x runs to the right and y downwards, in pt from the upper left corner.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.pdf_file import BOLD, FONTS, REGULAR, Mark, encoded, letters_of, pdf_bytes
from vsgdesign.report.drawing.sketch import END, MIDDLE, Area, Part, Sketch, Stroke, Words

Array = NDArray[np.float64]

WIDTH, HEIGHT = 841.9, 595.3
"""A4, on its side: a matrix is wide."""

MARGIN = 36.0


@dataclass
class Sheet:
    """One page: parts in the order in which they are drawn. ``marks``: entries of the list of contents, with y."""

    parts: list[Part] = field(default_factory=list)
    marks: list[tuple[str, float]] = field(default_factory=list)

    def text(self, x: float, y: float, text: str, size: float = 7.0, **look_of: Any) -> None:
        """A line of text with its baseline at y."""
        self.parts.append(Words(x, y, text, size, **look_of))

    def line(
        self, start: tuple[float, float], end: tuple[float, float], colour: str = "#333333", width: float = 0.5
    ) -> None:
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
                moved = Area(corner + scale * part.points, part.colour, part.edge)
            self.parts.append(moved)


def save(sheets: Sequence[Sheet], path: str | Path, title: str) -> Path:
    """Write pages. The same pages give the same bytes, whenever and wherever they are written."""
    path = Path(path)
    used: dict[str, set[str]] = {REGULAR: set(), BOLD: set()}
    for sheet in sheets:
        for part in sheet.parts:
            if isinstance(part, Words):
                used[_font(part.bold)].update(part.text)
    marks = [Mark(text, k, HEIGHT - y) for k, sheet in enumerate(sheets) for text, y in sheet.marks]
    path.write_bytes(pdf_bytes([_content(sheet) for sheet in sheets], (WIDTH, HEIGHT), title, used, marks))
    return path


@functools.lru_cache(maxsize=20_000)
def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width of a text in pt."""
    letters = letters_of(_font(bold))
    return 1e-3 * size * sum(letters.widths[letters.glyph(letter)] for letter in text)


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


def _font(bold: bool) -> str:
    return BOLD if bold else REGULAR


def _content(sheet: Sheet) -> bytes:
    """The operators that draw a page."""
    found = [b"1 j 0 J"]
    for part in sheet.parts:
        if isinstance(part, Words):
            found.append(_words(part))
        elif isinstance(part, Area):
            path = _path(part.points) + b" h"
            if part.edge:
                found.append(b"0.4 w %s rg %s RG %s B" % (_rgb(part.colour), _rgb(part.edge), path))
            else:
                found.append(b"%s rg %s f" % (_rgb(part.colour), path))
        else:
            dashes = b" ".join(b"%.2f" % (part.width * length) for length in part.dashes)
            found += [b"%.2f w %s RG [%s] 0 d" % (part.width, _rgb(part.colour), dashes)]
            found += [_path(run) + b" S" for run in part.runs()]
    return b"\n".join(found)


def _words(part: Words) -> bytes:
    font, x, y = _font(part.bold), part.x, HEIGHT - part.y
    if part.anchor in (MIDDLE, END):
        back = text_width(part.text, part.size, part.bold) * (0.5 if part.anchor == MIDDLE else 1.0)
        x, y = (x, y - back) if part.upright else (x - back, y)
    turn = b"0 1 -1 0" if part.upright else b"1 0 0 1"
    name, shown = FONTS[font].encode(), encoded(part.text, font)
    return b"BT %s rg /%s %.2f Tf %s %.2f %.2f Tm %s Tj ET" % (_rgb(part.colour), name, part.size, turn, x, y, shown)


def _path(points: Array) -> bytes:
    whole = [b"%.2f %.2f" % (x, HEIGHT - y) for x, y in points.tolist()]
    return whole[0] + b" m " + b" l ".join(whole[1:]) + (b" l" if len(whole) > 1 else b"")


@functools.lru_cache(maxsize=256)
def _rgb(colour: str) -> bytes:
    """``#1A2B3C`` or ``#ABC`` as three shares."""
    digits = colour.removeprefix("#")
    digits = "".join(2 * digit for digit in digits) if len(digits) == 3 else digits
    return b" ".join(b"%.3f" % (int(digits[k : k + 2], 16) / 255.0) for k in (0, 2, 4))
