"""Quantities as an engineer writes them: ``"11.6 mH"``, ``"5 kVA"``, ``0.0116``. A bare number is SI."""

from __future__ import annotations

import math
import re
from decimal import Decimal

from vsgdesign.errors import VsgDesignError

_PREFIXES = {"": 0, "p": -12, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "k": 3, "M": 6, "G": 9}
"""Decimal exponents: scaled as decimals, "50 uF" is the float nearest to 5e-5, not 50 times that of 1e-6."""

_DIMENSIONS: dict[str, dict[str, float]] = {
    "V": {"V": 1.0},
    "A": {"A": 1.0},
    "W": {"W": 1.0},
    "VA": {"VA": 1.0},
    "var": {"var": 1.0, "VAr": 1.0, "VAR": 1.0},
    "Hz": {"Hz": 1.0},
    "s": {"s": 1.0},
    "H": {"H": 1.0},
    "F": {"F": 1.0},
    "ohm": {"ohm": 1.0, "Ohm": 1.0, "\u03a9": 1.0, "\u2126": 1.0},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0},
    "1": {"": 1.0, "pu": 1.0, "%": 0.01, "pct": 0.01},
}
_UNPREFIXED = {"deg", "°", "", "pu", "%", "pct"}

_NUMBER = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$")


class UnitError(VsgDesignError):
    """A quantity's text cannot be read in the unit that the field asks for."""


def _unit_scale(unit: str, dimension: str) -> tuple[int, float]:
    """Decimal exponent and factor from ``unit`` to the SI unit of ``dimension``."""
    bases = _DIMENSIONS.get(dimension)
    if bases is None:  # a compound SI unit such as "rad/(s²·W)": only itself, unscaled
        if unit == dimension:
            return 0, 1.0
        raise UnitError(f"expected a plain number in {dimension}")
    for base, factor in bases.items():
        if unit == base:
            return 0, factor
        if base not in _UNPREFIXED and unit.endswith(base) and unit[: -len(base)] in _PREFIXES:
            return _PREFIXES[unit[: -len(base)]], factor
    raise UnitError(f"expected {_examples(dimension)}")


def parse_quantity(value: object, dimension: str) -> float:
    """A TOML value as a float in SI. ``dimension`` is the SI unit ("H", "VA", …) or "1" for a ratio.

    Raises UnitError with the reason: not a number, a unit of another dimension, NaN or infinite.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise UnitError(f"expected {_examples(dimension)}")
    try:
        if isinstance(value, str):
            match = _NUMBER.match(value)
            if match is None:
                raise UnitError(f"not a number with a unit; expected {_examples(dimension)}")
            exponent, factor = _unit_scale(match.group(2), dimension) if match.group(2) else (0, 1.0)
            number = float(Decimal(match.group(1)).scaleb(exponent)) * factor
        else:
            number = float(value)
    except ArithmeticError:  # beyond the range of float, or of Decimal
        number = math.inf
    if not math.isfinite(number):
        raise UnitError("must be a finite number")
    return number


def same_quantity(a: object, b: object) -> bool:
    """Whether two TOML values say the same quantity, as "8 kW" and 8000 do."""

    def in_si(value: object, dimension: str) -> float:
        try:
            return parse_quantity(value, dimension)
        except UnitError:
            return math.nan

    return any(in_si(a, dimension) == in_si(b, dimension) for dimension in _DIMENSIONS)


def _examples(dimension: str) -> str:
    if dimension == "1":
        return 'a ratio such as 0.05 or "5 %"'
    if dimension == "rad":
        return 'an angle such as "30 deg" or 0.52 (rad)'
    prefixed = {"H": "mH", "F": "uF", "s": "ms", "VA": "kVA", "W": "kW", "var": "kvar", "Hz": "kHz", "ohm": "mohm"}
    unit = prefixed.get(dimension, dimension)
    return f'a number in {dimension} or a text such as "1.5 {unit}"'


def format_quantity(value: float, dimension: str) -> str:
    """A value for messages, in engineering notation: ``0.0116, "H"`` gives ``11.6 mH``."""
    if dimension == "1" or value == 0.0 or not math.isfinite(value):
        return f"{value:.6g}" if dimension == "1" else f"{value:.6g} {dimension}"
    if dimension == "rad" or dimension not in _DIMENSIONS:
        return f"{value:.6g} {dimension}"
    exponent = min(max(3 * math.floor(math.log10(abs(value)) / 3), -12), 9)
    prefix = {-12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}[exponent]
    return f"{value / 10.0**exponent:.6g} {prefix}{dimension}"
