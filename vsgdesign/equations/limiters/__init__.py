"""How a controller limits its current: one law for each name, all behind one interface."""

from __future__ import annotations

from vsgdesign.equations.limiter_interface import (
    GridEstimate,
    IntegratorSteps,
    KnownRatings,
    LimitedSample,
    Limiter,
    LimiterLaw,
    LimiterParameter,
    LimiterRatings,
    LimiterView,
)
from vsgdesign.equations.limiters.balanced_power import BALANCED_POWER
from vsgdesign.equations.limiters.circular import CIRCULAR, HYBRID, SATURATION
from vsgdesign.equations.limiters.projection import PROJECTION
from vsgdesign.equations.limiters.threshold_impedance import THRESHOLD_IMPEDANCE

LIMITERS: dict[str, Limiter] = {
    limiter.name: limiter for limiter in (CIRCULAR, THRESHOLD_IMPEDANCE, SATURATION, HYBRID, PROJECTION, BALANCED_POWER)
}
"""Every limiter that a study may name."""


def limiter_named(name: str) -> Limiter:
    """The limiter of that name. Raises ValueError with the names that there are."""
    if name not in LIMITERS:
        raise ValueError(f'current_limiter = "{name}": must be one of {", ".join(LIMITERS)}.')
    return LIMITERS[name]


__all__ = [
    "BALANCED_POWER",
    "CIRCULAR",
    "HYBRID",
    "LIMITERS",
    "PROJECTION",
    "SATURATION",
    "THRESHOLD_IMPEDANCE",
    "GridEstimate",
    "IntegratorSteps",
    "KnownRatings",
    "LimitedSample",
    "Limiter",
    "LimiterLaw",
    "LimiterParameter",
    "LimiterRatings",
    "LimiterView",
    "limiter_named",
]
