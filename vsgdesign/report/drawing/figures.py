"""The results of the functions that make figures, and their files: SVG and PNG, small, and the same in every run."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from vsgdesign.report.drawing.style import look

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class NamedFigure:
    """A figure with what a page needs around it. ``name`` becomes its file name."""

    name: str
    title: str
    caption: str
    figure: Figure
    part: int = 0
    """The part of the report to which it belongs, if the report has parts."""


@dataclass(frozen=True)
class WrittenFigure:
    """A figure on disk, as SVG and as PNG."""

    name: str
    title: str
    caption: str
    svg: Path
    png: Path
    part: int = 0


@dataclass(frozen=True)
class ExplorerFile:
    """The page of the explorer beside a report, or why there is none."""

    name: str = ""
    size_bytes: int = 0
    why: str = ""
    """In a whole sentence, where there is no file."""

    @property
    def megabytes(self) -> str:
        """Its size in words."""
        return f"{self.size_bytes / 1e6:.1f} MB"


_PATH = re.compile(r'(?<= d=")[^"]*')
_LONG_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_SPACE = re.compile(r"\s+")
_IMAGE_ID = re.compile(r' id="image[0-9a-f]+"')
_FAMILY = re.compile("'DejaVu Sans'(, sans-serif)?")


def write_figure(named: NamedFigure, folder: Path) -> WrittenFigure:
    """One figure as NAME.svg and NAME.png."""
    svg, png = folder / f"{named.name}.svg", folder / f"{named.name}.png"
    svg.write_text(svg_text(named.figure), encoding="utf-8", newline="\n")
    with look(), warnings.catch_warnings():
        # A controller may have any letters in its name; a missing glyph costs a box in the PNG, no more.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        named.figure.savefig(png, format="png", metadata={"Software": None})
    return WrittenFigure(named.name, named.title, named.caption, svg, png, named.part)


def write_all(figures: Iterable[NamedFigure], folder: str | Path) -> list[WrittenFigure]:
    """Every figure into ``folder``, which is made if missing; one is written before the next one is made."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return [write_figure(figure, folder) for figure in figures]


def svg_text(figure: Figure) -> str:
    """The text of a figure's SVG file."""
    from vsgdesign.report.drawing.ticks import plain_ticks

    plain_ticks(figure)
    buffer = io.StringIO()
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    with look(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure.savefig(buffer, format="svg", metadata=nothing)
    return compact(buffer.getvalue())


def compact(svg: str) -> str:
    """The same drawing with path coordinates to a hundredth of a point, and a font list that every system has."""
    svg = _PATH.sub(lambda match: _LONG_NUMBER.sub(_rounded, _SPACE.sub(" ", match.group()).strip()), svg)
    svg = _IMAGE_ID.sub("", svg)  # equal images would have equal ids, and nothing refers to them
    return _FAMILY.sub("'DejaVu Sans', Verdana, sans-serif", svg)


def _rounded(match: re.Match[str]) -> str:
    return f"{float(match.group()):.2f}".rstrip("0").rstrip(".")
