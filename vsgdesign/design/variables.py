"""The variables of the optimiser: the free normalised parameters of a structure and law, with scales and bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.study.parameters.specification import Specification

Array = NDArray[np.float64]

_FIELDS = NormalisedGains._fields
_POLES = {"k_1_or_H": (1.0, 2e3), "d_1_or_zeta": (1.0, 100.0), "k_2": (0.5, 100.0)}
"""Least and largest value, dimensionless: times the settling time, or times its square for k_1."""
_ZETA = (0.3, 4.0)
_PULL_LOG, _PULL_SHARE = 1.5, 10.0
"""Weights of the distance from the centre. Where the figures hardly depend on the variables, neighbouring cells then
choose similar ones and can be interpolated. Partial decoupling is chosen only where it has a large effect."""


@dataclass(frozen=True)
class Variables:
    """Free parameters ``names`` of NormalisedGains; the rest is ``fixed``. In the optimizer they are y: logarithms
    of dimensionless values (``logarithmic``), or shares as they are."""

    names: tuple[str, ...]
    logarithmic: NDArray[np.bool_]
    low: Array
    high: Array
    scale: Array
    """SI value of a dimensionless 1."""
    fixed: dict[str, float]

    @property
    def pull(self) -> Array:
        """Weight of each variable's squared distance from the centre."""
        return np.where(self.logarithmic, _PULL_LOG, _PULL_SHARE)

    def normalised(self, y: Any) -> NormalisedGains:
        """Normalised gains from y: rows of designs (M, k) → arrays (M,), one design (k,) → numbers."""
        y = np.asarray(y, dtype=float)
        free = {
            name: self.scale[k] * (np.exp(y[..., k]) if self.logarithmic[k] else y[..., k])
            for k, name in enumerate(self.names)
        }
        shape = y.shape[:-1]
        return NormalisedGains(**{f: free[f] if f in free else np.full(shape, self.fixed[f]) for f in _FIELDS})

    def expression(self, y: Any, exp: Any) -> NormalisedGains:
        """Normalised gains from a CasADi column y (k,); ``exp`` is the exponential of CasADi."""
        free = {name: self.scale[k] * (exp(y[k]) if self.logarithmic[k] else y[k]) for k, name in enumerate(self.names)}
        return NormalisedGains(**{f: free.get(f, self.fixed.get(f)) for f in _FIELDS})

    def of(self, normalised: NormalisedGains) -> Array:
        """y (k,) of one design, moved into the bounds."""
        values = np.array([getattr(normalised, name) for name in self.names], dtype=float) / self.scale
        y = np.where(self.logarithmic, np.log(np.maximum(values, 1e-300)), values)
        return np.clip(y, self.low, self.high)

    def slower(self, normalised: NormalisedGains, share: float) -> Array:
        """Upper bounds of y (k,) that leave ``share`` of a design's d_1 and k_2, and the square of this share of its
        k_1."""
        y = self.of(normalised)
        powers = {"k_1_or_H": 2.0, "d_1_or_zeta": 1.0, "k_2": 1.0}
        cut = np.array([powers.get(name, 0.0) for name in self.names])
        return np.maximum(np.where(cut > 0.0, y + cut * np.log(share), self.high), self.low)


def variables(structure: str, spec: Specification) -> Variables:
    """The free parameters of a structure under a specification."""
    T = spec.settling_time
    entries: list[tuple[str, bool, float, float, float]] = []
    fixed = dict.fromkeys(_FIELDS, 0.0)
    if spec.settles:
        entries.append(("k_1_or_H", True, *_POLES["k_1_or_H"], 1.0 / T**2))
        high = min(_POLES["d_1_or_zeta"][1], spec.bandwidth_max * T)
        entries.append(("d_1_or_zeta", True, _POLES["d_1_or_zeta"][0], high, 1.0 / T))
    else:
        fixed["k_1_or_H"] = float(spec.H or 0.0)
        entries.append(("d_1_or_zeta", True, *_ZETA, 1.0))
    entries.append(("k_2", True, _POLES["k_2"][0], min(_POLES["k_2"][1], spec.bandwidth_max * T), 1.0 / T))
    entries += [(free.name, free.logarithmic, free.low, free.high, 1.0) for free in STRUCTURES[structure].free]
    names, logarithmic, low, high, scale = zip(*entries, strict=True)
    mask = np.array(logarithmic)
    least, most = (np.where(mask, np.log(np.where(mask, x, 1.0)), x) for x in (np.array(low), np.array(high)))
    return Variables(names, mask, least, most, np.array(scale), {f: v for f, v in fixed.items() if f not in names})


MARGIN_AIM = 1.15
"""More margin than this multiple of the least disk margin is not traded against inertia."""

GUARD_MARGIN = 1.03
"""Multiple of the required disk margin that a design has at a node, because filters and delay reduce it by 1 to 2 %."""

MARGIN_RESERVE = 0.015
"""Largest reduction of this factor where a requirement would be violated otherwise."""

WEIGHT_BROKEN, WEIGHT_MARGIN = 300.0, 30.0
"""Weights w_s of what is violated and w_α of missing margin; inertia, in natural logarithms, has the weight 1."""

WEIGHT_DAMPING = 0.2
"""Weight of the logarithms of damping and bandwidth with ``aim = "inertia"``: no more of both than needed."""


def cell_objective(price: Any, broken: Any, reserve: Any, short: Any, away: Any) -> Any:
    """The objective from its five terms (:eq:`cell-objective`), numbers or CasADi expressions.

    ``price``: −ln H, or WEIGHT_DAMPING times the logarithms of damping and bandwidth. ``broken``: the sum of what the
    requirements are violated by, relative. ``reserve``: the used reserve, weighted. ``short``: the missing margin.
    ``away``: the weighted squared distance to the centre.
    """
    return price + WEIGHT_BROKEN * broken + reserve + WEIGHT_MARGIN * short + away
