"""Labels of figures as plain text, and formulas parsed once. A formula takes matplotlib fifty times as long to set, and
each tick would be one.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser
from matplotlib.ticker import Formatter, LogFormatterSciNotation, ScalarFormatter

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class PlainNumbers(ScalarFormatter):
    """matplotlib's labels of a linear axis without formulas. A factor common to all stands at the axis's end.

    ``powers``: the powers of ten from and up to which a factor is taken out; None means those of the look.
    """

    def __init__(self, powers: tuple[int, int] | None = None) -> None:
        super().__init__(useOffset=False, useMathText=False)
        if powers is not None:
            self.set_powerlimits(powers)

    def get_offset(self) -> str:
        """The common factor, ×10⁻³, or nothing."""
        number = super().get_offset().replace("−", "-")
        return f"×{ten_to(int(number.partition('e')[2]))}" if number else ""


class Labels(Formatter):
    """Labels that a function of the value gives. The function can be sent to another process if it is a module's own,
    or a partial of one; a lambda cannot."""

    def __init__(self, text: Callable[[float], str]) -> None:
        self._text = text

    def __call__(self, x: float, pos: int | None = None) -> str:  # noqa: ARG002
        """The label of a tick."""
        return self._text(x)


def power_of_ten(value: float) -> str:
    """A tick of a logarithmic axis; with its sign, and zero, for a symmetric one."""
    if value < 0.0:
        return "−" + power_of_ten(-value)
    if value == 0.0 or 1e-3 <= value < 9e3:
        return f"{value:g}"
    return ten_to(round(float(np.log10(value))))


def ten_to(power: int) -> str:
    """10⁻³ and its like."""
    return "10" + str(power).translate(_SUPERSCRIPT)


def plain_ticks(figure: Figure) -> None:
    """Gives every axis of a figure that has matplotlib's own labels plain ones."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            found: Any = type(axis.get_major_formatter())
            if found is ScalarFormatter:
                axis.set_major_formatter(PlainNumbers())
            elif found is LogFormatterSciNotation:
                axis.set_major_formatter(Labels(power_of_ten))


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
