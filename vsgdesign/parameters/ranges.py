"""Quantities that a study gives as a number or as a range [low, high], out of which a seed draws."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vsgdesign.parameters.reader import TableReader

Range = tuple[float, float]
"""Lower and upper end, SI; the same twice for a number."""


class Drawn(NamedTuple):
    """A quantity of a section that may be a range."""

    name: str
    unit: str
    low: float
    high: float
    logarithmic: bool = False
    """Whether its logarithm is what is drawn uniformly, as long as the range begins above zero."""


def read_range(table: TableReader, quantity: Drawn, default: Range) -> Range:
    """The range that a section gives for a quantity; the default where it gives none."""
    if not isinstance(table.table.get(quantity.name), list):
        value = table.quantity(quantity.name, quantity.unit, quantity.low, quantity.high, default=None)
        return default if value is None else (value, value)
    raw = table.table[quantity.name]
    ends = table.quantities(quantity.name, quantity.unit, quantity.low, quantity.high, default, increasing=False)
    if len(ends) != 2:
        table.fault(quantity.name, raw, "a range has two ends", f"For example {quantity.name} = [low, high].")
        return default
    if ends[0] > ends[1]:
        table.fault(quantity.name, raw, "the range is reversed", "Give the lower end first.")
        return default
    return ends[0], ends[1]


def drawn_value(quantity: Drawn, ends: Range, seed: int) -> float:
    """A number out of a range. Every quantity has its own stream, so that a number given for one changes no other."""
    low, high = ends
    if low == high or math.isnan(low + high):
        return low
    share = float(stream(seed, quantity.name).random())
    if quantity.logarithmic and low > 0.0:
        return low * (high / low) ** share
    return low + (high - low) * share


def drawn_values(quantities: tuple[Drawn, ...], ranges: Mapping[str, Range], seed: int) -> dict[str, float]:
    """A number for every quantity."""
    return {one.name: drawn_value(one, ranges[one.name], seed) for one in quantities}


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """The random numbers of one purpose, which ``names`` tell from all others of the same seed."""
    keys = [zlib.crc32(name.encode()) if isinstance(name, str) else name for name in names]
    return np.random.default_rng([seed, *keys])
