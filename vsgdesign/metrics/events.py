"""Figures of every event of a run, on the raw signal and on its one-cycle mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.step_response import ResponseMetrics, disturbance_response, one_cycle_mean, step_response

Array = NDArray[np.float64]

_SMALLEST_STEP = 1e-3
"""A change of less than this fraction of the rating is not a step."""


@dataclass(frozen=True)
class EventWindow:
    """What one event's figures are taken from: times of the event and of the next, and what was stepped."""

    name: str
    t_s: float
    end_s: float
    steps_signal: bool
    """Whether the event steps this signal's own reference."""


@dataclass(frozen=True)
class EventMetrics:
    """One signal around one event."""

    name: str
    t_s: float
    signal: str
    kind: str
    """``step``: its own reference was stepped; ``disturbance``: something else was."""
    raw: ResponseMetrics
    one_cycle_mean: ResponseMetrics
    peak_current_pu: float


def measure_event(
    window: EventWindow, signal: str, t: Array, y: Array, current_pu: Array, rating: float, samples_per_cycle: int
) -> EventMetrics:
    """Figures of one signal in one window.

    ``t`` (s), ``y`` and ``current_pu`` (length of the current vector over the rated peak) are the whole run.
    The value before is the mean of the cycle before the event, the final value that of the last tenth of the
    window and at least a cycle. Bands: 2 % of the step, or of ``rating`` for a disturbance.
    """
    # Half a sample of slack: event and sample times are both rounded.
    slack = 0.5 * (t[1] - t[0])
    begin, end = np.searchsorted(t, [window.t_s - slack, window.end_s - slack])
    begin, end = int(begin), int(max(end, begin + 2))
    before = y[max(begin - samples_per_cycle, 0) : begin] if begin > 0 else y[:1]
    tail = max((end - begin) // 10, min(samples_per_cycle, end - begin))
    initial, final = float(np.mean(before)), float(np.mean(y[end - tail : end]))
    since = t[begin:end] - window.t_s
    is_step = window.steps_signal and abs(final - initial) > _SMALLEST_STEP * rating

    def measure(values: Array) -> ResponseMetrics:
        if is_step:
            return step_response(since, values, initial, final)
        return disturbance_response(since, values, initial, final, rating)

    mean = one_cycle_mean(y[max(begin - samples_per_cycle, 0) : end], samples_per_cycle)[-(end - begin) :]
    return EventMetrics(
        window.name, window.t_s, signal, "step" if is_step else "disturbance",
        measure(y[begin:end]), measure(mean), float(np.max(current_pu[begin:end])),
    )  # fmt: skip
