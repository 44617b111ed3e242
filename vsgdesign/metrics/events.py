"""Results for every event of a run, from the mean of a signal over whole cycles and from the raw signal, or why there
are none.

The mean is the signal that is judged everywhere (docs/definitions.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.step_response import (
    SETTLING_BAND,
    ResponseMetrics,
    cycle_mean,
    disturbance_response,
    half_steps_of,
    no_figures,
    step_response,
)

Array = NDArray[np.float64]

MEASURED, NOT_SETTLED, TOO_SHORT = "measured", "not settled", "window too short"
UNSTABLE, NO_STEADY_STATE = "unstable", "no steady state"
DIVERGED, NO_MODEL = "diverged", "no model"
STATUSES = (MEASURED, NOT_SETTLED, TOO_SHORT, UNSTABLE, NO_STEADY_STATE, DIVERGED, NO_MODEL)
"""The status of an event. The first two have results; ``not settled`` has no settling time. ``no model`` means that it
is not known in what state the signal settles."""

SIGMAS = 4.5
"""So many times its rms the noise of a difference may be: of the means over two cycles within 10 s, none is more."""

_APART = 1.5
"""Lengths of the mean that lie between values of which the noise is found: neighbouring means are alike, because the
power loops smooth what the sensors' rounding leaves."""

_VALUES = 20
"""Values in the length of a mean from which its noise is found."""

_MOST_NOISE = 1.5
"""So many times as much noise as one mean the difference of two has at most: √2, and what an estimate may be off."""

_LEAST_MEANS = 10
"""Means at rest from which their noise is found."""

_SMALLEST_STEP = 1e-3
"""A change of less than this share of the rating is not a step."""

SHARE_OF_BAND = 0.1
"""Accuracy, as a share of the band, of a final value that is itself a mean of the signal."""

_LATE = 2.0
"""In a window with this many times the time that its largest deviation needs, a signal that is late outside the band
is not explained by the slowest mode: only the square of the band would remain of it.
"""


@dataclass(frozen=True)
class EndState:
    """The state in which a signal settles after an event, computed from the model instead of the signal.

    ``final`` is the computed steady state; None: use the mean of the last whole cycles of the window (a switched
    bridge). ``decay`` is the decay rate of the slowest mode there in 1/s, and not positive if the mode does not
    decay; None: there is no such state. ``obstacle`` says why there is no state or no decay. ``changed_s``: the end
    of the last ramp within the window, s of the run.
    """

    final: float | None
    decay: float | None
    obstacle: str | None = None
    changed_s: float = 0.0
    samples_per_cycle: int | None = None
    """Period of the grid at the end; None: the nominal one."""
    modelled: bool = True
    """Whether a model knows the circuit. If not, nothing is known of the state, and ``obstacle`` says why."""


@dataclass(frozen=True)
class EventWindow:
    """The times of an event and of the next event, and what was stepped."""

    name: str
    t_s: float
    end_s: float
    steps_signal: bool
    """Whether the event steps this signal's own reference."""


@dataclass(frozen=True)
class StepNoise:
    """What noise does to the figures of a step or of a disturbance (:eq:`twin-noise`)."""

    step: float
    """The size of the step, in the unit of the signal, with its sign beside a twin; of a disturbance the rating."""
    left: float
    """Rms of the noise that is left in what is judged, in the unit of the signal; infinite where it is not known."""
    rest: float
    """Rms by which the judged mean moves at rest, without the step or after the disturbance, in the unit of the
    signal."""
    twin: bool = True
    """Whether the difference from a twin is judged. Without one all of the noise is left."""

    @property
    def share(self) -> float:
        """What the noise may do to the difference, as a share of the step."""
        return SIGMAS * self.left / abs(self.step) if self.step != 0.0 else math.inf

    @property
    def judgeable(self) -> bool:
        """Whether the noise stays within the band."""
        return self.share <= SETTLING_BAND

    @property
    def least_step(self) -> float:
        """The smallest step that could be judged with this noise, in the unit of the signal."""
        return self.least_band / SETTLING_BAND

    @property
    def least_band(self) -> float:
        """The smallest band that the noise does not leave, in the unit of the signal."""
        return SIGMAS * self.left


@dataclass(frozen=True, kw_only=True)
class EventMetrics:
    """One signal around one event."""

    name: str
    t_s: float
    signal: str
    kind: str
    """``step``: the signal's own reference was stepped; ``disturbance``: something else changed."""
    raw: ResponseMetrics
    """Of the instantaneous signal."""
    cycle_mean: ResponseMetrics
    """Of its mean over whole cycles: these figures are shown and judged."""
    peak_current_pu: float | None
    """None where the simulation diverged, or where no current is known."""
    status: str = MEASURED
    """One of STATUSES."""
    reason: str | None = None
    """Why there are no results, in words; None if there are results."""
    needs_s: float | None = None
    """The length that the window would need, s, if it is too short."""
    drift: float = 0.0
    """By how much the mean of the last cycle before the event differs from that of the cycle before it, in the unit of
    the signal; 0 where there are no two cycles, and beside a twin."""
    noise: StepNoise | None = None
    """Of a step that was judged beside its twin, and of all that was judged alone in a run that never rests; else
    None."""
    so_far: ResponseMetrics | None = None
    """What a step has reached in a window that is too short for it, of the mean; None in any other window."""

    @property
    def lost_in_noise(self) -> bool:
        """Whether it is a disturbance that cannot be judged, because the power leaves the band without it."""
        return self.kind == "disturbance" and self.noise is not None and not self.noise.judgeable


def measure_event(
    window: EventWindow,
    signal: str,
    t: Array,
    y: Array,
    rating: float,
    samples_per_cycle: int,
    end: EndState,
    without: Array | None = None,
    restless: bool = False,
    largest_pu: Callable[[slice], float] | None = None,
) -> EventMetrics:
    """Results of one signal in one window.

    ``t`` (s) and ``y`` cover the whole run. ``largest_pu`` gives the largest length of the current vector in rows of
    it, over the rated peak.

    The initial value is the mean of the cycle before the event. The final value is that of ``end``. If ``end`` has
    none, it is the mean of the whole cycles in the last tenth of the window, at least one. The bands are 2 % of the
    step, or of ``rating`` for a disturbance. If the window is too short (:func:`time_needed`), or if there is no state
    in which the signal settles, a reason is given instead of results.

    ``without`` (the whole run): the signal of the same run without the step, equal before it. What is judged is then
    the difference of both (:eq:`twin`): the initial and the final value are the means of ``without`` and of ``y`` over
    the last whole cycles. It is left out where there is no steady state.

    ``restless``: whether the signal never rests, because of noise or of the grid. An event without a twin then has the
    noise of its own rest. Where this leaves the band, a disturbance has no settling time, and the reason says so.
    """
    # Half a sample of slack: event and sample times are both rounded.
    slack = 0.5 * (t[1] - t[0])
    begin, stop = np.searchsorted(t, [window.t_s - slack, window.end_s - slack])
    begin, stop = int(begin), int(max(stop, begin + 2))
    observed, since = window.end_s - window.t_s, t[begin:stop] - window.t_s
    if end.decay is None or not end.decay > 0.0:
        without = None
    noise, cycle = None, end.samples_per_cycle or samples_per_cycle
    if without is None:
        judged, drift = y[begin:stop], _drift(y[:begin], samples_per_cycle)
        before = y[max(begin - samples_per_cycle, 0) : begin] if begin > 0 else y[:1]
        initial = float(np.mean(before))
        last = late_mean(judged, cycle)
        final = last if end.final is None else end.final
        mean = cycle_mean(y[max(begin - samples_per_cycle, 0) : stop], samples_per_cycle)[-(stop - begin) :]
    else:
        initial, drift, end = late_mean(without[begin:stop], cycle), 0.0, replace(end, final=None)
        of_both = [cycle_mean(one[max(begin - samples_per_cycle, 0) : stop], samples_per_cycle) for one in (y, without)]
        judged = initial + (y[begin:stop] - without[begin:stop])
        final = late_mean(judged, cycle)
        left = (of_both[0] - of_both[1])[-(stop - begin) :]
        mean = initial + left
        alone = of_both[1][-(stop - begin) :]
        noise = StepNoise(final - initial, noise_left(left, alone, samples_per_cycle), float(np.std(alone)))
    is_step = window.steps_signal and abs(final - initial) > _SMALLEST_STEP * rating
    reference = abs(final - initial) if is_step else rating
    moved_s = max(end.changed_s - window.t_s, 0.0)
    noise = noise if is_step else None
    if without is None and restless and end.decay is not None and end.decay > 0.0:
        moves = moved_s + time_within_band(float(np.abs(mean - final).max()) / reference, end.decay)
        noise = _noise_of_rest(mean[since >= max(moves, 0.5 * observed)], reference, samples_per_cycle)
    judgeable = noise is None or noise.judgeable
    status, reason, needs = MEASURED, None, None
    if end.decay is None:
        status, reason = NO_STEADY_STATE if end.modelled else NO_MODEL, end.obstacle
    elif not end.decay > 0.0:
        status, reason = UNSTABLE, end.obstacle
    else:
        share = 1.0 if end.final is not None else SHARE_OF_BAND
        error = mean - final
        np.abs(error, out=error)
        error /= reference
        if not judgeable:  # the noise alone leaves the band
            error = error[:1]
        needed = time_needed(since[: len(error)], error, end.decay, moved_s, share)
        if needed > observed:
            what = "step" if is_step else "event"
            expected = moved_s + time_within_band(float(error.max()), end.decay, share)
            if observed > _LATE * expected:
                late = float(since[np.flatnonzero(error > SETTLING_BAND)[-1]])
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
    if status == MEASURED and not is_step and not judgeable:
        reason = lost_in_noise(noise, signal)

    half_steps = half_steps_of(since)

    def measure(values: Array) -> ResponseMetrics:
        if status not in (MEASURED, NOT_SETTLED):
            return no_figures(initial, end.final)
        found = (
            step_response(since, values, initial, final, SETTLING_BAND, half_steps)
            if is_step
            else disturbance_response(since, values, initial, final, rating, SETTLING_BAND, half_steps)
        )
        return found if status == MEASURED and reason is None else replace(found, settling_time_s=None)

    return EventMetrics(
        name=window.name,
        t_s=window.t_s,
        signal=signal,
        kind="step" if is_step else "disturbance",
        raw=measure(judged),
        cycle_mean=measure(mean),
        peak_current_pu=None if largest_pu is None else largest_pu(slice(begin, stop)),
        status=status,
        reason=reason,
        needs_s=needs,
        drift=drift,
        noise=noise,
        so_far=step_response(since, mean, initial, final) if is_step and status == TOO_SHORT else None,
    )


def lost_in_noise(noise: StepNoise | None, signal: str) -> str | None:
    """Why a disturbance cannot be judged, with the smallest band that could be; None without noise."""
    if noise is None:
        return None
    name, unit = ("P", "W") if signal == "P_pcc" else ("Q", "var")
    band, rest, least = (f"{value:.3g} {unit}" for value in (SETTLING_BAND * noise.step, noise.rest, noise.least_band))
    return (
        f"cannot be judged: {name} rests in {rest} rms, and its noise leaves the band of {band} (2 % of the rating) by "
        f"itself; with this noise, a band of at least {least} could be judged"
    )


def time_within_band(error: float, decay: float, share: float = 1.0) -> float:
    """When the slowest mode has brought a relative error, at least the whole step, into the band, s. ``share``: of the
    band."""
    return math.log(max(error, 1.0) / (share * SETTLING_BAND)) / decay


def _noise_of_rest(mean: Array, reference: float, samples_per_mean: int) -> StepNoise | None:
    """The noise of what has no twin: the rms by which its mean moves at rest. None where there are fewer than
    _LEAST_MEANS of it."""
    if len(mean) < _LEAST_MEANS * samples_per_mean:
        return None
    rest = float(np.std(mean))
    return StepNoise(reference, rest, rest, twin=False)


def noise_left(difference: Array, without: Array, samples_per_mean: int) -> float:
    """Rms of the noise in the difference of a judged mean, (n,) over a window, from that ``without`` the step, (n,).

    It is that of the second differences (:eq:`twin-noise`), and not much more than two means without a step differ by:
    the rest is motion. Infinite where the window is too short.
    """
    of_difference, of_rest = (_second_difference(one, samples_per_mean) for one in (difference, without))
    return min(of_difference, _MOST_NOISE * of_rest)


def _second_difference(values: Array, samples_per_mean: int) -> float:
    every = max(samples_per_mean // _VALUES, 1)  # the values between them are nearly the same
    late, apart = values[len(values) // 2 :: every], round(_APART * samples_per_mean / every)
    if len(late) <= 2 * apart:
        return math.inf
    second = late[2 * apart :] - 2.0 * late[apart:-apart] + late[: -2 * apart]
    return math.sqrt(float(np.mean(second * second)) / 6.0)


def _drift(before: Array, samples_per_cycle: int) -> float:
    if len(before) < 2 * samples_per_cycle:
        return 0.0
    earlier, last = before[-2 * samples_per_cycle :].reshape(2, -1)
    return float(np.mean(last) - np.mean(earlier))


def diverged_event(window: EventWindow, signal: str, reason: str) -> EventMetrics:
    """An event in whose window the simulation diverged: there are no figures of it."""
    kind = "step" if window.steps_signal else "disturbance"
    nothing = no_figures(math.nan)
    return EventMetrics(
        name=window.name,
        t_s=window.t_s,
        signal=signal,
        kind=kind,
        raw=nothing,
        cycle_mean=nothing,
        peak_current_pu=None,
        status=DIVERGED,
        reason=reason,
    )


def time_needed(since: Array, error: Array, decay: float, moved_s: float = 0.0, share: float = 1.0) -> float:
    """How long a window must be for its settling time to be reliable, s (:eq:`window-needed`).

    A deviation e(t) may return, but it is at most e(t)·exp(−decay·(T − t)) at T, because the slowest mode decays at
    this rate. The window is long enough if all of these are within the band at its end. The whole step (or the
    rating) counts as seen at ``moved_s``, when the last change ended, even if the signal itself has not begun to
    move. ``error`` is relative to the step or the rating; ``share``: of the band.
    """
    needed = moved_s + time_within_band(float(error[0]), decay, share)
    outside = error > SETTLING_BAND
    if outside.any():
        needed = max(needed, float(np.max(since[outside] + np.log(error[outside] / (share * SETTLING_BAND)) / decay)))
    return needed


def late_rows(rows: Any, samples_per_cycle: Any) -> Any:
    """The rows of the whole cycles within the last tenth of a window, at least of one; numbers or arrays."""
    return np.maximum(rows // 10 // samples_per_cycle, 1) * samples_per_cycle


def late_mean(y: Array, samples_per_cycle: int) -> float:
    """Mean over these rows; the mean of everything if there is less than one cycle."""
    return float(np.mean(y[-int(late_rows(len(y), samples_per_cycle)) :]))


def _rounded_up(seconds: float) -> str:
    """Three digits, rounded up."""
    unit = 10.0 ** (math.floor(math.log10(seconds)) - 2)
    return f"{math.ceil(seconds / unit - 1e-9) * unit:.3g}"
