"""The worst figures of a design over its scenarios, and the promises that they do not keep."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from vsgdesign.design.evaluation import Evaluation
from vsgdesign.parameters.specification import Specification


@dataclass(frozen=True, kw_only=True)
class Figures:
    """The worst of a design over a cell's scenarios; fractions, s, and 1/s."""

    overshoot_P: float
    settling_P: float
    overshoot_Q: float
    settling_Q: float
    cross_peak: float
    """Largest of the other power, per unit step."""
    disk_margin: float
    damping_ratio: float
    abscissa: float

    @property
    def overshoot(self) -> float:
        """Of either power after a step of its own reference."""
        return max(self.overshoot_P, self.overshoot_Q)

    @property
    def settling_time(self) -> float:
        """Of either power after a step of its own reference."""
        return max(self.settling_P, self.settling_Q)


def worst(e: Evaluation, design: int = 0) -> Figures:
    """The worst figures of one evaluated design."""
    at = {name: values[design] for name, values in e.figures.items()}
    steps = {name: float(at[name].max()) for name in ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q")}
    return Figures(
        **steps,
        cross_peak=float(np.maximum(at["cross_P"], at["cross_Q"]).max()),
        disk_margin=float(at["disk_margin"].min()),
        damping_ratio=float(e.damping_ratio[design].min()),
        abscissa=float(e.abscissa[design].max()),
    )


def worse(one: Figures, other: Figures) -> Figures:
    """The worse of two of each figure."""
    low = ("disk_margin", "damping_ratio")
    values = {f.name: (getattr(one, f.name), getattr(other, f.name)) for f in fields(Figures)}
    return Figures(**{name: min(pair) if name in low else max(pair) for name, pair in values.items()})


def shortfalls(spec: Specification, f: Figures, inertia: float) -> dict[str, float]:
    """Promises that figures do not keep, each with the value that would have to be allowed."""
    missed: dict[str, float] = {}
    if spec.settles and not f.overshoot <= spec.overshoot:
        missed["overshoot"] = f.overshoot
    if spec.settles and not f.settling_time <= spec.settling_time:
        missed["settling_time"] = f.settling_time
    if not f.disk_margin >= spec.disk_margin:
        missed["disk_margin"] = f.disk_margin
    if not f.damping_ratio >= spec.damping_ratio:
        missed["damping_ratio"] = f.damping_ratio
    if inertia < spec.H_min * (1.0 - 1e-9):
        missed["H_min"] = inertia
    if inertia > spec.H_max * (1.0 + 1e-9):
        missed["H_max"] = inertia
    return missed
