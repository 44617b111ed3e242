"""Sampling of windows on a converter, in whole control periods and whole cycles of the grid."""

from __future__ import annotations

import math
from typing import NamedTuple

from vsgdesign.errors import ArtifactError

INTERVAL = 200e-6
"""The published sample interval, s. An interval that is not given is as close to it as the converter allows."""

MOST_CYCLES = 6
"""Nominal cycles of the longest window that is chosen. A schedule that waits longer than 0.1 s is no longer online."""

LEAST_PER_CYCLE = 8
"""Least number of control periods in a cycle with which a window can be taken."""

PER_CYCLE = (40, 200)
"""Number of samples of a cycle in a chosen window, if the control period allows it."""

EXACT = 1e-6
"""Largest deviation, in cycles, of a window that counts as whole cycles. It allows for rounding of f_n and T_s."""

NEAR = 5e-3
"""Largest deviation from whole cycles, in cycles, of a chosen window where no window of whole cycles exists.

The angle of a synchronised window is corrected by this deviation."""


class WindowPlan(NamedTuple):
    """The sampling of a window."""

    steps: int
    """Number of control periods between two samples."""
    samples: int
    cycles: int
    missed: float
    """Deviation from a whole number of cycles, in cycles."""


def choose_window(
    rate: float, per_cycle: float, *, steps: int = 0, samples: int = 0, cycles: int = 0
) -> WindowPlan | None:
    """The window of a converter that samples ``rate`` times a second, ``per_cycle`` times in a nominal cycle.

    Values that are left open (0) are chosen here. The window is the least number of nominal cycles, up to
    ``MOST_CYCLES``, that is a whole number of sample intervals. Among these the interval is the one closest to
    ``INTERVAL``. If the control period divides no such number of cycles, the window is the shortest that differs from
    whole cycles by at most ``NEAR``. The result is None if no window has four samples.
    """
    found = []
    for whole in _cycles(per_cycle, steps, samples, cycles):
        for step in [steps] if steps else _steps(per_cycle, samples, whole):
            count = samples or round(whole * per_cycle / step)
            missed = abs(count * step - whole * per_cycle) / per_cycle
            off = abs(math.log(step / rate / INTERVAL))
            rank = (0, whole, off) if missed < EXACT else (1, whole, off) if missed < NEAR else (2, missed, whole)
            if count >= 4:
                found.append((rank, step, count, whole, missed))
    return WindowPlan(*min(found)[1:]) if found else None


def window_of_rate(rate: float, omega_n: float) -> WindowPlan:
    """The window that is chosen for a converter that samples ``rate`` times a second at the nominal frequency (rad/s).

    Raises ArtifactError if a cycle has too few control periods.
    """
    per_cycle = rate * 2.0 * math.pi / omega_n
    found = choose_window(rate, per_cycle) if per_cycle >= LEAST_PER_CYCLE else None
    if found is None:
        raise ArtifactError(
            f"{per_cycle:.3g} control periods in a cycle of the grid are too few to estimate it (least: "
            f"{LEAST_PER_CYCLE}). Raise f_sw or samples_per_carrier."
        )
    return found


def _cycles(per_cycle: float, steps: int, samples: int, cycles: int) -> list[int]:
    if cycles:
        return [cycles]
    if samples and steps:
        return [max(round(samples * steps / per_cycle), 1)]
    return list(range(1, MOST_CYCLES + 1))


def _steps(per_cycle: float, samples: int, cycles: int) -> list[int]:
    """The numbers of control periods that a sample interval may have."""
    if samples:
        return [max(round(cycles * per_cycle / samples), 1)]
    least, most = (per_cycle / count for count in reversed(PER_CYCLE))
    return list(range(max(math.ceil(least), 1), max(math.floor(most), 1) + 1))


def near_a_millisecond(periods: int, T_s: float) -> float:
    """The time in s closest to 1 ms that is a whole number of control periods and divides ``periods`` of them
    evenly."""
    divisors = [k for k in range(1, periods + 1) if periods % k == 0]
    return min(divisors, key=lambda k: abs(math.log(k * T_s / 1e-3))) * T_s
