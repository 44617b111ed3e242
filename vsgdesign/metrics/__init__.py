"""From arrays to named results: overshoot, settling time, margins, modes, errors of an estimate, survival."""

from vsgdesign.metrics.events import EndState, EventMetrics, EventWindow, StepNoise, measure_event
from vsgdesign.metrics.step_response import (
    ResponseMetrics,
    cycle_mean,
    disturbance_response,
    mean_in_words,
    step_response,
)
from vsgdesign.metrics.survival import ExpectedRest, Survival, SurvivalDemand, SurvivalRecord, judge_survival

__all__ = [
    "EndState",
    "EventMetrics",
    "EventWindow",
    "ExpectedRest",
    "ResponseMetrics",
    "StepNoise",
    "Survival",
    "SurvivalDemand",
    "SurvivalRecord",
    "cycle_mean",
    "disturbance_response",
    "judge_survival",
    "mean_in_words",
    "measure_event",
    "step_response",
]
