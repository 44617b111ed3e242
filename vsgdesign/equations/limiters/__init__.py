"""How a controller limits its current: one law for each name, all behind one interface."""

from __future__ import annotations

from vsgdesign.equations.limiters.circular import CIRCULAR
from vsgdesign.equations.limiters.interface import (
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
from vsgdesign.equations.limiters.projection import PROJECTION

LIMITERS: dict[str, Limiter] = {limiter.name: limiter for limiter in (CIRCULAR, PROJECTION)}
"""Every limiter that a study may name."""


def limiter_named(name: str) -> Limiter:
    """The limiter of that name. Raises ValueError with the names that there are."""
    if name not in LIMITERS:
        raise ValueError(f'current_limiter = "{name}": must be one of {", ".join(LIMITERS)}.')
    return LIMITERS[name]


__all__ = [
    "CIRCULAR",
    "LIMITERS",
    "PROJECTION",
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
