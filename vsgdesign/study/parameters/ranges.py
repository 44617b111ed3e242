"""Quantities that a study gives as a number or as a range [low, high], out of which a seed draws; and those that are
drawn run by run, each of some values in turn or out of a range.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from vsgdesign.study.parameters.fields import Field


Range = tuple[float, float]
"""Lower and upper end, SI; the same twice for a number."""


def drawn_value(quantity: Field, ends: Range, seed: int) -> float:
    """A number out of a range. Every quantity has its own stream, so that a number given for one changes no other."""
    low, high = ends
    if low == high or math.isnan(low + high):
        return low
    share = float(stream(seed, quantity.name).random())
    if quantity.logarithmic and low > 0.0:
        return low * (high / low) ** share
    return low + (high - low) * share


def drawn_values(quantities: tuple[Field, ...], ranges: Mapping[str, Range], seed: int) -> dict[str, float]:
    """A number for every quantity."""
    return {one.name: drawn_value(one, ranges[one.name], seed) for one in quantities}


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """The random numbers of one purpose, which ``names`` tell from all others of the same seed."""
    keys = [zlib.crc32(name.encode()) if isinstance(name, str) else name for name in names]
    return np.random.default_rng([seed, *keys])


def uniform_of(ends: Range, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values of a range for numbers from 0 to 1."""
    return ends[0] + (ends[1] - ends[0]) * u


def logarithmic_of(ends: Range, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same, uniform in the logarithm; a range that begins at zero is uniform itself."""
    low, high = ends
    return low * np.exp(np.log(high / low) * u) if low > 0.0 else uniform_of(ends, u)


def signed_of(ends: Range, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """A size out of its range with either sign, both from one number."""
    x = 2.0 * u - 1.0
    return np.where(x < 0.0, -1.0, 1.0) * uniform_of(ends, np.abs(x))


KINDS = ("one_of", "uniform", "log_uniform")


@dataclass(frozen=True)
class Spread:
    """What a quantity is drawn from."""

    kind: str
    """One of :data:`KINDS`."""
    values: tuple[float, ...]
    """The values of ``one_of``; low and high of the others."""

    def draw(self, rng: np.random.Generator, index: int) -> float:
        """One value; ``one_of`` goes by the scenario's index, so that every value is used equally often."""
        if self.kind == "one_of":
            return self.values[index % len(self.values)]
        low, high = self.values
        if self.kind == "uniform":
            return float(rng.uniform(low, high))
        return float(math.exp(rng.uniform(math.log(low), math.log(high))))

    def document(self) -> Any:
        """As a file has it: a number, or a table with the kind alone."""
        return self.values[0] if self.kind == "one_of" and len(self.values) == 1 else {self.kind: list(self.values)}


def one_of(*values: float) -> Spread:
    """Each of the values in turn."""
    return Spread("one_of", values)


def uniform(low: float, high: float) -> Spread:
    """Evenly between two values."""
    return Spread("uniform", (low, high))


def log_uniform(low: float, high: float) -> Spread:
    """Evenly in the logarithm between two values."""
    return Spread("log_uniform", (low, high))
