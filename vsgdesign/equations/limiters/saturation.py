"""Saturation: a current beyond the limit is replaced by one of a given angle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from vsgdesign.equations.controller_data import ControllerSettings, Nothing
from vsgdesign.equations.limiter_interface import (
    GridEstimate,
    LimitedSample,
    Limiter,
    LimiterLaw,
    LimiterParameter,
    LimiterRatings,
    LimiterView,
    always,
)
from vsgdesign.equations.limiters.circular import circular_move
from vsgdesign.equations.power_loops import PowerLoopGains, References


class SaturationConstants(NamedTuple):
    """The limited current, A peak."""

    i_d: Any
    i_q: Any


def saturation_limit(
    memory: Nothing,
    view: LimiterView,
    grid: GridEstimate,
    refs: References,
    gains: PowerLoopGains,
    settings: ControllerSettings,
) -> LimitedSample:
    """Replaces a requested current that is too large by the one of the given angle (:eq:`saturated-current`)."""
    c = settings.limiter
    length_sq = view.i_want_d * view.i_want_d + view.i_want_q * view.i_want_q
    limited = 1.0 * (length_sq > settings.i_max_pk * settings.i_max_pk)
    return LimitedSample(
        i_ref_d=view.i_want_d + limited * (c.i_d - view.i_want_d),
        i_ref_q=view.i_want_q + limited * (c.i_q - view.i_want_q),
        e_d=view.e_d,
        e_q=view.e_q,
        P=view.P,
        Q=view.Q,
        limited=limited,
    )


def saturation_constants(ratings: LimiterRatings, values: Mapping[str, float]) -> SaturationConstants:
    """The current at the limit, at its angle to the commanded voltage."""
    angle = values["current_angle"]
    return SaturationConstants(i_d=ratings.i_max_pk * math.cos(angle), i_q=ratings.i_max_pk * math.sin(angle))


SATURATION = Limiter(
    "saturation",
    LimiterLaw(saturation_limit, circular_move),
    saturation_constants,
    parameters=(
        LimiterParameter(
            "current_angle",
            "rad",
            low=always(-math.pi),
            high=always(math.pi),
            default=always(-math.pi / 9.0),
            meaning="angle of the limited current to the commanded voltage; negative lags",
        ),
    ),
)
"""It does not change the power loops."""
