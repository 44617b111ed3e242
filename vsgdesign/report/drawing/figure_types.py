"""The results of the functions that make figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

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
