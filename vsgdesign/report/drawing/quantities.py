"""Numbers as a reader wants them: an SI prefix chosen from the data, and sensible digits."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from vsgdesign.errors import visible

_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))

DASH = "–"

GAIN_UNITS = {
    "K_ip": "rad/(s²·W)",
    "D_p": "W·s/rad",
    "K_iq": "V/(s·var)",
    "D_q": "var/V",
    "K_pq": "rad/(s²·var)",
    "K_qp": "V/(s·W)",
    "k_P": "rad/(s·W)",
    "k_Q": "rad/(s·var)",
}
"""Units of the power loops' gains by name."""


def prefix_for(largest: float, smallest_factor: float = 1.0) -> tuple[float, str]:
    """(factor, prefix) that brings ``largest`` to 1 … 1000; no prefix below ``smallest_factor``."""
    for factor, prefix in _PREFIXES:
        # A hair of slack: 999.9999999 W is a kilowatt.
        if abs(largest) * (1.0 + 1e-9) >= factor or factor <= smallest_factor:
            return factor, prefix
    return 1.0, ""


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, a dash for None, thousands in full."""
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0.0:
        return "0"
    # Decimal places from the rounded value, so that 9.996 becomes 10.0 and not 10.00.
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -4 <= exponent < 6:
        text = f"{value:.{max(digits - 1 - exponent, 0)}f}"
        return _minus(text)
    mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
    return _minus(f"{mantissa}·10{_superscript(int(power))}")


def quantity(value: float | None, unit: str, digits: int = 3) -> str:
    """A number with its SI prefix and unit: ``0.0116, "H"`` gives ``11.6 mH``."""
    if value is None or not math.isfinite(value):
        return DASH
    factor, prefix = prefix_for(value, 1e-12) if value else (1.0, "")
    return f"{number(value / factor, digits)} {prefix}{unit}"


def plain(value: float, digits: int = 4) -> str:
    """The shortest text of a number: no trailing zeros."""
    text = number(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text and "·" not in text else text


def plain_quantity(value: float, unit: str, digits: int = 4) -> str:
    """``quantity`` without trailing zeros: ``2500, "W"`` gives ``2.5 kW``."""
    factor, prefix = prefix_for(value, 1e-12) if value else (1.0, "")
    return f"{plain(value / factor, digits)} {prefix}{unit}"


def percent(value: float | None, decimals: int = 1) -> str:
    """Percent with one decimal or more, without the sign of a zero; a dash for None."""
    if value is None:
        return DASH
    return _minus(f"{value:z.{decimals}f}")


_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\d)")


def merged(texts: Iterable[str]) -> dict[str, int]:
    """Texts that differ in their numbers alone as one, with "462 to 492.6" for a number that differs, and their count.

    The order is that in which they come first.
    """
    groups: dict[str, list[list[str]]] = {}
    for text in texts:
        groups.setdefault(_NUMBER.sub("\0", text), []).append(_NUMBER.findall(text))
    found = {}
    for pattern, rows in groups.items():
        ends = [(min(column, key=float), max(column, key=float)) for column in zip(*rows, strict=True)]
        said = iter(low if low == high else f"{low} to {high}" for low, high in ends)
        found[re.sub("\0", lambda _: next(said), pattern)] = len(rows)  # noqa: B023 - used at once
    return found


_NEGATIVE = re.compile(r"(?<![\w.\-−+/)])-(?=\d|∞|inf\b)")
_INFINITE = re.compile(r"(?<![\w.\-])inf(?![\w.\-])")


def typeset(text: str) -> str:
    """A text with a minus before negative numbers and ∞ for an infinite one, whoever wrote it, and without control
    characters."""
    return visible(_INFINITE.sub("∞", _NEGATIVE.sub("−", text)))


def _minus(text: str) -> str:
    return text.replace("-", "−")


def _superscript(power: int) -> str:
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
