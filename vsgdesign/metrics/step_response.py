"""Results of one response: settling time, overshoot, rise time, ITAE, begin of a movement. None if a result has no
meaning."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.placing import SETTLING_BAND

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ResponseMetrics:
    """One signal after one event. Times are measured from the event. None: not reached, or without meaning."""

    initial: float
    """Value before the event."""
    final: float | None
    """The final value; None if it is not known."""
    overshoot_pct: float | None
    """Distance beyond the final value, in per cent of the step; None for a disturbance."""
    settling_time_s: float | None
    """Time from which the signal stays within the band; None if it is still outside at the end."""
    rise_time_s: float | None
    """Time from 10 % to 90 % of the step; None for a disturbance."""
    peak_deviation: float | None
    """Largest distance from the final value, in the signal's unit."""
    itae_s2: float | None
    """∫ t·|error| dt over the step (or, for a disturbance, over its reference), s²."""


def no_figures(initial: float, final: float | None = None) -> ResponseMetrics:
    """A response of which only the initial value and perhaps the final value are known."""
    return ResponseMetrics(
        initial=initial,
        final=final,
        overshoot_pct=None,
        settling_time_s=None,
        rise_time_s=None,
        peak_deviation=None,
        itae_s2=None,
    )


def cycle_mean(y: Array, samples_per_cycle: int, begin: int = 0) -> Array:
    """Mean over the cycle, or the whole cycles, that end at each sample from sample ``begin`` on; before the first end,
    over what there is. The samples of ``y`` are along its last axis."""
    if samples_per_cycle <= 1:
        return y[..., begin:].copy()
    n = min(samples_per_cycle, y.shape[-1])
    # In memory that runs along the samples, wherever those of y lie.
    mean = np.subtract(y, y[..., :1], dtype=float, order="C")
    total = np.cumsum(mean, axis=-1)
    whole, mean = max(n, begin), mean[..., begin:]
    np.divide(total[..., begin:n], np.arange(begin + 1, n + 1), out=mean[..., : whole - begin])
    rest = mean[..., whole - begin :]
    np.subtract(total[..., whole:], total[..., whole - n : -n], out=rest)
    rest /= n
    mean += y[..., :1]
    return mean


def mean_in_words(cycles: int) -> str:
    """What a mean over so many cycles is called."""
    return {1: "one-cycle mean", 2: "two-cycle mean"}[cycles]


def step_response(
    t: Array, y: Array, initial: float, final: float, band: float = SETTLING_BAND, half_steps: Array | None = None
) -> ResponseMetrics:
    """Results of a response to a step of the reference from ``initial`` to ``final``.

    ``t`` is measured from the event. ``band`` is a fraction of the step. ``half_steps``: half the steps of ``t``, where
    they are known. Raises ValueError if there is no step.
    """
    step = final - initial
    if step == 0.0:
        raise ValueError("a step response needs a step: initial and final are equal")
    least, most = float(np.min(y)), float(np.max(y))
    overshoot = 100.0 * max(((most if step > 0.0 else least) - initial) / step - 1.0, 0.0)
    first_10, first_90 = (_reached(t, y, initial, step, level) for level in (0.1, 0.9))
    rise = None if first_10 is None or first_90 is None else first_90 - first_10

    def error_of(rows: slice) -> Array:
        error = y[rows] - initial
        error /= step
        error -= 1.0
        return np.abs(error, out=error)

    settling_time_s, itae_s2 = _of_error(t, error_of, band, half_steps)
    return ResponseMetrics(
        initial=initial,
        final=final,
        overshoot_pct=overshoot,
        settling_time_s=settling_time_s,
        rise_time_s=rise,
        peak_deviation=max(abs(most - final), abs(least - final)),
        itae_s2=itae_s2,
    )


def disturbance_response(
    t: Array,
    y: Array,
    initial: float,
    final: float,
    reference: float,
    band: float = SETTLING_BAND,
    half_steps: Array | None = None,
) -> ResponseMetrics:
    """Results of a response to anything other than a step of this signal. ``band`` is a fraction of ``reference``, and
    ``half_steps`` are those of :func:`step_response`."""

    def error_of(rows: slice) -> Array:
        error = y[rows] - final
        np.abs(error, out=error)
        error /= reference
        return error

    settling_time_s, itae_s2 = _of_error(t, error_of, band, half_steps)
    most = max(abs(float(np.max(y)) - final), abs(float(np.min(y)) - final))
    return ResponseMetrics(
        initial=initial,
        final=final,
        overshoot_pct=None,
        settling_time_s=settling_time_s,
        rise_time_s=None,
        peak_deviation=most / reference * reference,
        itae_s2=itae_s2,
    )


_ROWS = 32_768
"""So many rows are worked on at a time: few enough for the cache, and so many that the calls of NumPy cost little."""


def half_steps_of(t: Array) -> Array:
    """Half the steps of times t (n,): (n − 1,)."""
    steps = np.diff(t)
    steps *= 0.5
    return steps


def _of_error(
    t: Array, error_of: Callable[[slice], Array], band: float, half_steps: Array | None
) -> tuple[float | None, float]:
    """:func:`settling_time` and ∫ t·error dt of an error that is computed for some rows at a time, as a new array."""
    areas, last = np.empty(len(t) - 1), -1
    half_steps = half_steps_of(t) if half_steps is None else half_steps
    for first in range(0, max(len(t) - 1, 1), _ROWS):
        rows = slice(first, first + _ROWS + 1)
        error = error_of(rows)
        outside = np.flatnonzero(error > band)
        last = first + int(outside[-1]) if outside.size else last
        area = areas[first : first + _ROWS]
        error *= t[rows]
        np.add(error[1:], error[:-1], out=area)
        area *= half_steps[first : first + _ROWS]
    settled_s = 0.0
    if last >= 0:
        end = slice(last, last + 2)
        settled_s = settling_time(t[end], error_of(end), band)
    return settled_s, float(areas.sum())


def _reached(t: Array, y: Array, initial: float, step: float, level: float) -> float | None:
    """The first time at which a response reaches a share of its step, as :func:`first_crossing` finds it."""
    for first in range(0, len(y), _ROWS):
        rows = slice(max(first - 1, 0), first + _ROWS)
        found = first_crossing(t[rows], (y[rows] - initial) / step, level)
        if found is not None:
            return found
    return None


def settling_time(t: Array, error: Array, band: float) -> float | None:
    """The last time at which the error enters the band, interpolated; None if it ends outside."""
    outside = np.flatnonzero(error > band)
    if outside.size == 0:
        return 0.0
    k = int(outside[-1])
    if k == len(t) - 1:
        return None
    fraction = (error[k] - band) / (error[k] - error[k + 1])
    return float(t[k] + fraction * (t[k + 1] - t[k]))


def settling_times(dt: Array, error: Array, band: float) -> Array:
    """:func:`settling_time` of N responses: errors (N, K) at 0, dt, 2·dt … with own dt (N,); inf where it ends
    outside."""
    count = error.shape[1]
    outside = error > band
    ever = outside.any(axis=1)
    last = np.where(ever, count - 1 - np.argmax(outside[:, ::-1], axis=1), 0)
    rows, after = np.arange(len(error)), np.minimum(last + 1, count - 1)
    out, into = error[rows, last], error[rows, after]
    fraction = (out - band) / np.where(out > into, out - into, 1.0)
    return np.where(~ever, 0.0, np.where(last == count - 1, np.inf, dt * (last + fraction)))


def first_crossing(t: Array, y: Array, level: float) -> float | None:
    """The first time at which y reaches a level from below, interpolated; None if it does not."""
    above = y >= level
    k = int(np.argmax(above))
    if not above[k]:
        return None
    if k == 0:
        return float(t[0])
    return float(t[k - 1] + (level - y[k - 1]) / (y[k] - y[k - 1]) * (t[k] - t[k - 1]))


def unwrapped(angle: Array) -> Array:
    """The angle in rad, (n,), without jumps of half a turn or more: numpy.unwrap with the same bits, in a fifth of the
    time where there are few jumps."""
    step = np.diff(angle)
    jumps = np.flatnonzero(~(np.abs(step) < np.pi))
    found = angle.copy()
    if jumps.size:
        jump = step[jumps]
        within = np.mod(jump + np.pi, 2.0 * np.pi) - np.pi
        within[(within == -np.pi) & (jump > 0.0)] = np.pi
        turned = np.cumsum(within - jump)
        found[jumps[0] + 1 :] += np.repeat(turned, np.diff(np.append(jumps, len(step))))
    return found


Complex = NDArray[np.complexfloating[Any, Any]]


def onset(since: Array, change: Array, share: float) -> float | None:
    """Time in s at which a change (n,), in any unit, first reaches a share of its largest value, interpolated.

    ``since`` (n,) is measured from the event, s, and begins at or before it. None if nothing changes.
    """
    size = np.abs(change)
    largest = float(size.max(initial=0.0))
    if not largest > 0.0:
        return None
    return first_time(since, size, share * largest)


def first_time(since: Array, values: Array, level: float) -> float | None:
    """Time in s, not before the event, at which values (n,) first reach a level, interpolated; None if they do not.

    ``since`` (n,) is measured from the event, s.
    """
    found = first_crossing(since, values, level)
    return None if found is None else max(found, 0.0)


def phasor_change(vector: Complex, t: Array, hz: float, event_s: float, begin_s: float, end_s: float) -> complex:
    """Change of the positive-sequence phasor of a space vector (n,) by an event, in the frame that turns at ``hz``.

    ``t`` (n,) and the instants are in s, and the change is in the unit of the vector.

    Before: the mean over the cycle before ``event_s``. After: the constant of a fit with a dc component and a
    negative sequence to the rows of [event_s + begin_s, event_s + end_s]. NaN if there are fewer than six rows.
    """
    turned = vector * np.exp(-2j * math.pi * hz * t)
    early = (t < event_s - 1e-9) & (t >= event_s - 1.0 / hz - 1e-9)
    late = (t >= event_s + begin_s - 1e-9) & (t <= event_s + end_s + 1e-9)
    if int(late.sum()) < 6 or not early.any():
        return complex(math.nan, math.nan)
    back = np.exp(-2j * math.pi * hz * (t[late] - event_s))
    basis = np.column_stack([np.ones_like(back), back, back * back])
    return complex(np.linalg.lstsq(basis, turned[late], rcond=None)[0][0] - np.mean(turned[early]))
