"""The circular limit: the current reference keeps its direction and is cut to the allowed length."""

from __future__ import annotations

from typing import Any

from vsgdesign.equations.controller_data import ControllerSettings
from vsgdesign.equations.inner_loops import limit_length
from vsgdesign.equations.limiter_interface import (
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
"""The only limiter so far. It does not change the power loops."""
