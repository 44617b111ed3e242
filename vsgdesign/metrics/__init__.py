"""From arrays to named results: overshoot, settling time, margins, modes, errors of an estimate."""

from vsgdesign.metrics.events import EndState, EventMetrics, EventWindow, measure_event
from vsgdesign.metrics.step_response import ResponseMetrics, disturbance_response, one_cycle_mean, step_response

__all__ = [
    "EndState",
    "EventMetrics",
    "EventWindow",
    "ResponseMetrics",
    "disturbance_response",
    "measure_event",
    "one_cycle_mean",
    "step_response",
]
