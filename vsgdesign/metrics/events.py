"""Figures of every event of a run, on the raw signal and on its one-cycle mean, or why there are none."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.step_response import (
    ResponseMetrics,
    disturbance_response,
    no_figures,
    one_cycle_mean,
    step_response,
)

Array = NDArray[np.float64]

MEASURED, NOT_SETTLED, TOO_SHORT = "measured", "not settled", "window too short"
UNSTABLE, NO_STEADY_STATE = "unstable", "no steady state"
STATUSES = (MEASURED, NOT_SETTLED, TOO_SHORT, UNSTABLE, NO_STEADY_STATE)
"""What became of the figures of an event. The first two have figures; ``not settled`` has no settling time."""

BAND = 0.02
"""Half the width of the band of the settling time, over the step or the rating."""

_SMALLEST_STEP = 1e-3
"""A change of less than this fraction of the rating is not a step."""

_SHARE_OF_BAND = 0.1
"""A final value that is itself a mean of the signal has to be right to this share of the band."""

_LATE = 2.0
"""In a window of this many times the time that its largest deviation needs, what is outside the band late on is not
the slowest mode: the square of the band would be left of it."""


@dataclass(frozen=True)
class EndState:
    """Where a signal comes to rest after an event, from the model instead of from the signal.

    ``final`` is the computed steady state; None: the mean of the window's last whole cycles (a switched bridge).
    ``decay`` is the rate of the slowest mode there in 1/s, not positive where it does not die; None: there is no such
    state. ``obstacle`` says why it does not or there is none. ``changed_s``: when the last ramp within the window is
    over, s of the run.
    """

    final: float | None
    decay: float | None
    obstacle: str | None = None
    changed_s: float = 0.0
    samples_per_cycle: int | None = None
    """Of the grid's cycle in the end; None: the nominal one."""


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
    status: str = MEASURED
    """One of STATUSES."""
    reason: str | None = None
    """Why there are no figures, in words; None where there are."""
    needs_s: float | None = None
    """How long the window would have to be, s, where it is too short."""


def measure_event(
    window: EventWindow,
    signal: str,
    t: Array,
    y: Array,
    current_pu: Array,
    rating: float,
    samples_per_cycle: int,
    end: EndState,
) -> EventMetrics:
    """Figures of one signal in one window.

    ``t`` (s), ``y`` and ``current_pu`` (length of the current vector over the rated peak) are the whole run.
    The value before is the mean of the cycle before the event. The final value is that of ``end``, or, where that has
    none, the mean of the whole cycles in the window's last tenth, at least one. Bands: 2 % of the step, or of
    ``rating`` for a disturbance. Where the window is too short to know them (:func:`time_needed`), or there is no
    state to come to, there are no figures and a reason.
    """
    # Half a sample of slack: event and sample times are both rounded.
    slack = 0.5 * (t[1] - t[0])
    begin, stop = np.searchsorted(t, [window.t_s - slack, window.end_s - slack])
    begin, stop = int(begin), int(max(stop, begin + 2))
    before = y[max(begin - samples_per_cycle, 0) : begin] if begin > 0 else y[:1]
    initial = float(np.mean(before))
    last = _whole_cycles(y[begin:stop], end.samples_per_cycle or samples_per_cycle)
    final = last if end.final is None else end.final
    since = t[begin:stop] - window.t_s
    mean = one_cycle_mean(y[max(begin - samples_per_cycle, 0) : stop], samples_per_cycle)[-(stop - begin) :]
    is_step = window.steps_signal and abs(final - initial) > _SMALLEST_STEP * rating
    reference = abs(final - initial) if is_step else rating
    observed = window.end_s - window.t_s

    status, reason, needs = MEASURED, None, None
    if end.decay is None:
        status, reason = NO_STEADY_STATE, end.obstacle
    elif not end.decay > 0.0:
        status, reason = UNSTABLE, end.obstacle
    else:
        tested, share = (y[begin:stop], 1.0) if end.final is not None else (mean, _SHARE_OF_BAND)
        error = np.abs(tested - final) / reference
        moved_s = max(end.changed_s - window.t_s, 0.0)
        needed = time_needed(since, error, end.decay, moved_s, share)
        if needed > observed:
            what = "step" if is_step else "event"
            expected = moved_s + math.log(max(float(error.max()), 1.0) / (share * BAND)) / end.decay
            if observed > _LATE * expected:
                late = float(since[np.flatnonzero(error > BAND)[-1]])
                status = NOT_SETTLED
                reason = (
                    f"outside its band {late:.3g} s after the {what}, where the slowest mode needs {expected:.3g} s: "
                    "it does not come to rest as the linear model does (a limit or ripple)"
                )
            else:
                status, needs = TOO_SHORT, needed
                reason = (
                    f"the window is too short: {observed:.3g} s after the {what}, "
                    f"the slowest mode needs {_rounded_up(needed)} s"
                )

    def measure(values: Array) -> ResponseMetrics:
        if status not in (MEASURED, NOT_SETTLED):
            return no_figures(initial, end.final)
        found = (
            step_response(since, values, initial, final, BAND)
            if is_step
            else disturbance_response(since, values, initial, final, rating, BAND)
        )
        return found if status == MEASURED else replace(found, settling_time_s=None)

    return EventMetrics(
        window.name,
        window.t_s,
        signal,
        "step" if is_step else "disturbance",
        measure(y[begin:stop]),
        measure(mean),
        float(np.max(current_pu[begin:stop])),
        status,
        reason,
        needs,
    )


def time_needed(since: Array, error: Array, decay: float, moved_s: float = 0.0, share: float = 1.0) -> float:
    """How long a window must be for its settling time to be the settling time, s (:eq:`window-needed`).

    A deviation e(t) that was seen may come back, but no larger than e(t)·exp(−decay·(T − t)) at T, for the slowest
    mode dies at that rate. The window is long enough when all of these are within the band at its end: then nothing
    outside the band is still to come. The whole step (or the rating) counts as seen at ``moved_s``, when the last
    change was over, though the signal itself may not have begun to move. ``error`` is relative to the step or the
    rating; ``share``: of the band.
    """
    needed = moved_s + math.log(max(float(error[0]), 1.0) / (share * BAND)) / decay
    outside = error > BAND
    if outside.any():
        needed = max(needed, float(np.max(since[outside] + np.log(error[outside] / (share * BAND)) / decay)))
    return needed


def _whole_cycles(y: Array, samples_per_cycle: int) -> float:
    """Mean of the whole cycles within the last tenth, at least one; of everything where there is less than one."""
    count = max(len(y) // 10 // samples_per_cycle, 1) * samples_per_cycle
    return float(np.mean(y[-count:]))


def _rounded_up(seconds: float) -> str:
    """Three digits, never less than the value."""
    unit = 10.0 ** (math.floor(math.log10(seconds)) - 2)
    return f"{math.ceil(seconds / unit - 1e-9) * unit:.3g}"
