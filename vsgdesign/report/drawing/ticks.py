"""Labels of ticks as plain text: a formula takes matplotlib fifty times as long to set, and each tick would be one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure
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
