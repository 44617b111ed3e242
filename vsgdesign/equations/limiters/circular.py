"""Limits of the length of a current reference: the circular limit, and the two that are made of it.

- Circular: the current reference keeps its direction and is cut to the allowed length.
- Saturation: a current beyond the limit is replaced by one of a given angle.
- Hybrid: the circular limit, whose anti-windup feeds the removed current back through an impedance. The law is that of
  the limiter of the same name in PowerSimulationsDynamics.jl, after Baeckeland and Seo, "Novel Hybrid Current Limiter
  for Grid-Forming Inverter Control During Unbalanced Faults", 2023.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from vsgdesign.equations.controller_data import ControllerSettings, Nothing
from vsgdesign.equations.inner_loops import limit_length
from vsgdesign.equations.limiter_interface import (
    GridEstimate,
    IntegratorSteps,
    LimitedSample,
    Limiter,
    LimiterLaw,
    LimiterParameter,
    LimiterRatings,
    LimiterView,
    always,
)
from vsgdesign.equations.power_loops import PowerLoopGains, References


def circular_limit(
    memory: Nothing,
    view: LimiterView,
    grid: GridEstimate,
    refs: References,
    gains: PowerLoopGains,
    settings: ControllerSettings,
) -> LimitedSample:
    """Shortens the requested current to the limit (:eq:`circular-limit`) and leaves everything else unchanged."""
    i_ref_d, i_ref_q = limit_length(view.i_want_d, view.i_want_q, settings.i_max_pk)
    length_sq = view.i_want_d * view.i_want_d + view.i_want_q * view.i_want_q
    return LimitedSample(
        i_ref_d=i_ref_d,
        i_ref_q=i_ref_q,
        e_d=view.e_d,
        e_q=view.e_q,
        P=view.P,
        Q=view.Q,
        limited=1.0 * (length_sq > settings.i_max_pk * settings.i_max_pk),
    )


def circular_move(
    memory: Nothing,
    sample: LimitedSample,
    view: LimiterView,
    omega: Any,
    steps: IntegratorSteps,
    settings: ControllerSettings,
) -> Any:
    """Returns the steps that the power loops ask for. This limiter has no memory."""
    return steps, memory


CIRCULAR = Limiter("circular", LimiterLaw(circular_limit, circular_move))
"""It does not change the power loops."""


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


class HybridConstants(NamedTuple):
    """Impedance through which the removed current is fed back, Ω."""

    R_v: Any
    X_v: Any


def hybrid_limit(
    memory: Nothing,
    view: LimiterView,
    grid: GridEstimate,
    refs: References,
    gains: PowerLoopGains,
    settings: ControllerSettings,
) -> LimitedSample:
    """Shortens the requested current and lowers the integrated error by the drop of what it removed
    (:eq:`hybrid-limit`)."""
    c = settings.limiter
    i_ref_d, i_ref_q = limit_length(view.i_want_d, view.i_want_q, settings.i_max_pk)
    length_sq = view.i_want_d * view.i_want_d + view.i_want_q * view.i_want_q
    limited = 1.0 * (length_sq > settings.i_max_pk * settings.i_max_pk)
    over_d = limited * (view.i_want_d - i_ref_d)
    over_q = limited * (view.i_want_q - i_ref_q)
    # The integrators take up i_ref - i_want through 1/K_pv by themselves. This impedance replaces it.
    R = c.R_v - 1.0 / view.K_pv
    return LimitedSample(
        i_ref_d=i_ref_d,
        i_ref_q=i_ref_q,
        e_d=view.e_d - (R * over_d - c.X_v * over_q),
        e_q=view.e_q - (R * over_q + c.X_v * over_d),
        P=view.P,
        Q=view.Q,
        limited=limited,
    )


def hybrid_constants(ratings: LimiterRatings, values: Mapping[str, float]) -> HybridConstants:
    """The impedance on the converter's base."""
    return HybridConstants(
        R_v=values["feedback_resistance_pu"] * ratings.Z_base, X_v=values["feedback_reactance_pu"] * ratings.Z_base
    )


HYBRID = Limiter(
    "hybrid",
    LimiterLaw(hybrid_limit, circular_move),
    hybrid_constants,
    parameters=(
        LimiterParameter(
            "feedback_resistance_pu",
            "1",
            low=always(0.0),
            high=always(10.0),
            default=always(0.5),
            meaning="resistance through which the removed current is fed back, pu",
        ),
        LimiterParameter(
            "feedback_reactance_pu",
            "1",
            low=always(0.0),
            high=always(10.0),
            default=always(1.0),
            meaning="reactance through which the removed current is fed back, pu",
        ),
    ),
)
"""It does not change the power loops."""
