"""Formulas in labels, parsed once instead of once a figure, format and size."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser

_PARSE = MathTextParser.parse
_KINDS = ("vector", "raster")


@functools.lru_cache(4096)
def _parsed(kind: str, text: str, dpi: float, font: FontProperties | None, antialiased: bool | None) -> Any:
    parser = MathTextParser("path") if kind == "vector" else MathTextParser("agg")
    return _PARSE(parser, text, dpi, font, antialiased=antialiased)


def _parse(
    self: Any, s: str, dpi: float = 72, prop: FontProperties | None = None, *, antialiased: bool | None = None
) -> Any:
    kind = getattr(self, "_output_type", None)
    if kind not in _KINDS:
        return _PARSE(self, s, dpi, prop, antialiased=antialiased)
    return _parsed(kind, s, dpi, None if prop is None else prop.copy(), antialiased)


@contextmanager
def formulas_kept() -> Iterator[None]:
    """Inside, a formula is parsed once in a process.

    Every ``10^{-3}`` at a tick is a formula. matplotlib keeps its last 50, each for one figure only: half of the time
    that a report took to draw went into parsing the same ones again. The settings that a formula depends on are those
    of :func:`vsgdesign.report.drawing.style.look`, always the same.
    """
    MathTextParser.parse = _parse
    try:
        yield
    finally:
        MathTextParser.parse = _PARSE
