"""The circular limit: the current reference keeps its direction and is cut to the allowed length."""

from __future__ import annotations

from typing import Any

from vsgdesign.equations.controller_data import ControllerSettings
from vsgdesign.equations.inner_loops import limit_length
from vsgdesign.equations.limiters.interface import (
    GridEstimate,
    IntegratorSteps,
    LimitedSample,
    Limiter,
    LimiterLaw,
    LimiterView,
    Nothing,
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
    """The wanted current no longer than the limit (:eq:`circular-limit`); everything else as it is."""
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
    """The steps that the power loops ask for, and still nothing to remember."""
    return steps, memory


CIRCULAR = Limiter("circular", LimiterLaw(circular_limit, circular_move))
"""Today's only limiter. It leaves the power loops alone."""
