"""What a quantity is drawn from, run by run: each of some values in turn, or a range, linear or logarithmic."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

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
