"""Hybrid: the circular limit, whose anti-windup feeds the removed current back through an impedance.

The law is that of the limiter of the same name in PowerSimulationsDynamics.jl, after Baeckeland and Seo, "Novel Hybrid
Current Limiter for Grid-Forming Inverter Control During Unbalanced Faults", 2023.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from vsgdesign.equations.controller_data import ControllerSettings, Nothing
from vsgdesign.equations.inner_loops import limit_length
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
