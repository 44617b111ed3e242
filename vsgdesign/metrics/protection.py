"""Whether a protection would trip a converter: rate of change of frequency, over- and under-voltage.

The judge sees arrays alone, as that of survival does (:mod:`vsgdesign.metrics.survival`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.step_response import cycle_mean
from vsgdesign.study.parameters.specification import ProtectionLimits

Array = NDArray[np.float64]


class Trip(NamedTuple):
    """The first trip of a protection."""

    t_s: float
    """Time in the record, s."""
    reason: str


def first_trip(
    t_s: Array, f_hz: Array, V_pu: Array, limits: ProtectionLimits, since_s: float, cycle_s: float
) -> Trip | None:
    """The first trip from ``since_s`` on; None where no limit is reached.

    Arrays (n,), equally spaced in time: time (s), frequency of the converter (Hz), and length of the voltage's vector
    at the control point over its rated peak. The voltage counts as a mean over a nominal cycle (``cycle_s``). A trip
    comes when a limit has been exceeded without interruption for its time, and of the frequency at the end of its
    window.
    """
    if len(t_s) < 2:
        return None
    step = float(t_s[1] - t_s[0])
    mean = cycle_mean(V_pu, max(round(cycle_s / step), 1))
    found = [
        _rocof(t_s, f_hz, limits, since_s, step),
        _held(t_s, mean, limits.V_high_pu, limits.V_high_time, since_s, step, above=True),
        _held(t_s, mean, limits.V_low_pu, limits.V_low_time, since_s, step, above=False),
    ]
    return min((trip for trip in found if trip is not None), default=None)


def _rocof(t_s: Array, f_hz: Array, limits: ProtectionLimits, since_s: float, step: float) -> Trip | None:
    if limits.rocof is None:
        return None
    rows = max(round(limits.rocof_window / step), 1)
    if len(f_hz) <= rows:
        return None
    rate = np.abs(f_hz[rows:] - f_hz[:-rows]) / (rows * step)
    beyond = np.flatnonzero((rate > limits.rocof) & (t_s[rows:] >= since_s))
    if not beyond.size:
        return None
    at = float(t_s[rows + beyond[0]])
    return Trip(at, rate_in_words(f"{float(rate[beyond[0]]):.3g}", limits.rocof, limits.rocof_window))


def rate_in_words(rate: str, limit: float, window_s: float) -> str:
    """Why a protection trips that has seen this rate, in Hz/s, over a window."""
    return f"its frequency changes by {rate} Hz/s over {window_s:.3g} s, limit {limit:.3g} Hz/s"


def held_in_words(limit_pu: float, time_s: float, *, above: bool) -> str:
    """Why a protection trips that has seen a voltage beyond a limit for longer than a time."""
    return f"its voltage is {'above' if above else 'below'} {limit_pu:.3g} pu for longer than {time_s:.3g} s"


def _held(
    t_s: Array, V_pu: Array, limit: float | None, time_s: float, since_s: float, step: float, *, above: bool
) -> Trip | None:
    """Where the voltage has been beyond a limit for longer than a time without interruption."""
    if limit is None:
        return None
    beyond = ((V_pu > limit) if above else (V_pu < limit)) & (t_s >= since_s - 1e-3 * step)
    rows = np.arange(len(t_s))
    last_good = np.maximum.accumulate(np.where(beyond, -1, rows))
    held = np.where(beyond, (rows - last_good) * step, 0.0)
    tripped = np.flatnonzero(held > time_s + 1e-3 * step)
    if not tripped.size:
        return None
    k = int(tripped[0])
    return Trip(float(t_s[k]), held_in_words(limit, time_s, above=above))
