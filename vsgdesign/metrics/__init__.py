"""From arrays to named results: overshoot, settling time, margins, modes, errors of an estimate, survival."""

from vsgdesign.metrics.events import EndState, EventMetrics, EventWindow, measure_event
from vsgdesign.metrics.step_response import ResponseMetrics, disturbance_response, one_cycle_mean, step_response
from vsgdesign.metrics.survival import ExpectedRest, Survival, SurvivalDemand, SurvivalRecord, judge_survival

__all__ = [
    "EndState",
    "EventMetrics",
    "EventWindow",
    "ExpectedRest",
    "ResponseMetrics",
    "Survival",
    "SurvivalDemand",
    "SurvivalRecord",
    "disturbance_response",
    "judge_survival",
    "measure_event",
    "one_cycle_mean",
    "step_response",
]
