"""When a signal begins to move and when it arrives, and the impedance that a jump of the grid's phase shows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.step_response import first_crossing

Array = NDArray[np.float64]
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
