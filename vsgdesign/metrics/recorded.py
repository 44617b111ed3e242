"""Figures of a step in a measured series. It has no twin, so a mean that is long enough takes the noise out."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.errors import Fault, StudyError
from vsgdesign.metrics.events import EndState, EventWindow, StepNoise, measure_event
from vsgdesign.metrics.step_response import SETTLING_BAND, cycle_mean

Array = NDArray[np.float64]

LENGTHS = (1, 2, 4, 8, 16, 32, 64)
"""Nominal cycles over which the mean may be taken."""

_SIGMAS, _SHARE = 4.0, 0.5
"""So many times the noise of the mean must be within this share of the band."""

_LEAST_MEANS = 4
"""Means before the step, one behind the other, from which its noise can be told."""


@dataclass(frozen=True, kw_only=True)
class RecordedStep:
    """A step in a measured series. Values are in the unit of the series, and times are measured from the step."""

    initial: float
    """Mean before the step."""
    final: float
    """Mean over the last tenth of the series."""
    settling_time_s: float | None
    """From when on the mean is within 2 % of the step about the final value; None: it is outside at the end."""
    overshoot_pct: float
    """Largest distance of the mean beyond the final value, in per cent of the step."""
    rise_time_s: float | None
    """From 10 to 90 %; None if 90 % are not reached."""
    cycles: int
    """Nominal cycles over which the mean is taken: the fewest that the noise allows. It is late by half of them."""
    noise: StepNoise
    """``left``: rms of this mean at rest, before the step. ``rest``: that of the mean over one cycle."""


def step_figures(t: ArrayLike, P: ArrayLike, *, at: float, f_hz: float = 50.0) -> RecordedStep:
    """Figures of a step of a measured power.

    ``t`` (n,) in s, ascending in equal steps, at least ten to a cycle; ``P`` (n,) in any unit, measured over at least
    four cycles before the step and ten behind it; ``at``: when its reference was stepped, s; ``f_hz``: the nominal
    frequency. The noise before the step decides over how many cycles the mean is taken: the fewest with which four
    times its rms are within half the band of 2 %. Raises StudyError with every fault of the arguments, or with the
    smallest step that could be judged where no mean is quiet enough.
    """
    t_s, y = np.atleast_1d(np.asarray(t, dtype=float)), np.atleast_1d(np.asarray(P, dtype=float))
    if faults := list(_faults(t_s, y, at, f_hz)):
        raise StudyError("step_figures", faults)
    step_s = float((t_s[-1] - t_s[0]) / (len(t_s) - 1))
    cycle, begin = max(round(1.0 / (f_hz * step_s)), 1), int(np.searchsorted(t_s, at - 0.5 * step_s))
    late = max((len(t_s) - begin) // 10 // cycle, 1) * cycle
    size = abs(float(np.mean(y[-late:]) - np.mean(y[:begin])))
    noise = {n: _noise(y[:begin], n * cycle) for n in LENGTHS if begin >= _LEAST_MEANS * n * cycle}
    quiet = [n for n, rms in noise.items() if _SIGMAS * rms <= _SHARE * SETTLING_BAND * size]
    if not quiet:
        least = _SIGMAS * min(noise.values()) / (_SHARE * SETTLING_BAND)
        advice = (
            "Make a larger step, or record more of the rest before it: longer means then take out more of the noise."
        )
        problem = f"too small for its noise: a step of at least {least:.3g} could be judged with this record"
        raise StudyError("step_figures", [Fault("P", f"a step of {size:.3g}", problem, advice)])
    n = quiet[0]
    # The response of a record is as complete as it is: no model says how it would go on.
    window, end = EventWindow("step", at, float(t_s[-1]) + step_s, True), EndState(None, math.inf)
    found = measure_event(window, "P", t_s, _at_rest_before(y, begin), size, n * cycle, end).cycle_mean
    if found.final is None or found.overshoot_pct is None:
        raise StudyError("step_figures", [Fault("P", f"{size:g}", "there is no step in it", "Give the time of one.")])
    return RecordedStep(
        initial=found.initial,
        final=found.final,
        settling_time_s=found.settling_time_s,
        overshoot_pct=found.overshoot_pct,
        rise_time_s=found.rise_time_s,
        cycles=n,
        noise=StepNoise(found.final - found.initial, noise[n], noise[1], twin=False),
    )


def _at_rest_before(y: Array, begin: int) -> Array:
    """The series with its mean before the step in place of what it was there: a long mean begins at it."""
    found = y.copy()
    found[:begin] = np.mean(y[:begin])
    return found


def _noise(before: Array, samples: int) -> float:
    """Rms of the mean over so many samples at rest, as few means tell it."""
    count = len(before) / samples
    return float(np.std(cycle_mean(before, samples)[samples - 1 :])) * math.sqrt(count / (count - 1.0))


def _faults(t_s: Array, y: Array, at: float, f_hz: float) -> Iterator[Fault]:
    if t_s.ndim != 1 or t_s.shape != y.shape or len(t_s) < 2:
        shapes = f"{t_s.shape} and {y.shape}"
        yield Fault("t and P", shapes, "are not two rows of the same length", "Give one instant for each value.")
        return
    if not (np.isfinite(t_s).all() and np.isfinite(y).all()):
        yield Fault("t or P", "NaN or inf", "is no number", "Leave such values out, or fill them in.")
        return
    if not (math.isfinite(f_hz) and f_hz > 0.0):
        yield Fault("f_hz", f"{f_hz:g}", "must be above zero", "Give the nominal frequency, 50 or 60.")
        return
    steps, cycle_s = np.diff(t_s), 1.0 / f_hz
    if steps.min() <= 0.0 or np.ptp(steps) > 0.01 * float(np.mean(steps)):
        spread = f"steps of {steps.min():.3g} to {steps.max():.3g} s"
        yield Fault("t", spread, "does not ascend in equal steps", "Resample the record.")
    elif float(np.mean(steps)) > 0.1 * cycle_s:
        problem = f"is less than ten values a cycle of {cycle_s:.3g} s"
        yield Fault("t", f"steps of {np.mean(steps):.3g} s", problem, "Record faster.")
    first, last = t_s[0] + _LEAST_MEANS * cycle_s, t_s[-1] - 10.0 * cycle_s
    if not first <= at <= last:
        problem = f"must be between {first:.4g} and {last:.4g} s, four cycles of rest before it and ten behind it"
        yield Fault("at", f"{at:g} s", problem, "Give the time of the step, or more of the record.")
