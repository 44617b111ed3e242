"""What is looked at in a recorded voltage before it is played: fundamental, sequences, offset and clipping.

The fundamental's phasor and the mean of each phase are those of the first cycles under a Hann window, at the frequency
with the largest magnitude. Whether a record is clipped is counted over all of its samples.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import clarke

LARGEST_NEGATIVE = 0.1
"""Largest negative sequence over the positive one."""

LARGEST_OFF_NOMINAL = 0.05
"""Largest distance of the fundamental from the nominal frequency, relative to it."""

LARGEST_OFFSET = 0.1
"""Largest mean of a phase over the amplitude of the fundamental."""

LARGEST_CLIPPED = 0.01
"""Largest share of the samples of a phase at the same extreme."""

MORE_THAN_NEXT = 6.0
"""A sine of few bits has many samples at its extreme, too, but at most this many times those of the next value."""

PER_CYCLE = 40
"""Instants in a nominal cycle at which the beginning is looked at."""

_PADDED = 16
"""How much finer than its length the spectrum of the beginning is."""

_NO_SWING = 1e-3
"""A phase that moves by less than this share of its largest value is no voltage."""

Wrong = tuple[str, str]
"""A problem and what to do about it."""


class Seen(NamedTuple):
    """What is told of a record."""

    hz: float
    """Frequency of the fundamental."""
    negative: float
    """Negative over positive sequence; 0 of one phase."""
    offset: float
    """Largest mean over the fundamental's amplitude."""
    clipped: float
    """Largest share of a phase's samples at the same extreme."""


NOTHING_SEEN = Seen(math.nan, math.nan, math.nan, math.nan)


def look_at(beginning: NDArray[np.float64], values: NDArray[np.float64], f_n: float) -> tuple[Seen, list[Wrong]]:
    """What is seen of a record, and everything that is wrong with it.

    ``beginning`` (n, 1 or 3): ``PER_CYCLE`` instants in each nominal cycle of the beginning. ``values``: all samples.
    ``f_n`` in Hz.
    """
    window = np.hanning(len(beginning) + 1)[:-1, None]
    means = (window * beginning).sum(axis=0) / window.sum()
    swings = beginning - means
    strongest = int(np.argmax(np.abs(swings).max(axis=0)))
    if not np.abs(swings[:, strongest]).max() > _NO_SWING * np.abs(beginning).max():
        nothing = "no phase changes in the first cycles: there is no voltage", "Choose other columns, or a later begin."
        return NOTHING_SEEN, [nothing]
    lines = np.abs(np.fft.rfft(window[:, 0] * swings[:, strongest], _PADDED * len(beginning)))
    hz = f_n * PER_CYCLE * _peak(lines) / (_PADDED * len(beginning))
    if not abs(hz / f_n - 1.0) <= LARGEST_OFF_NOMINAL:
        problem = f"its fundamental is at {hz:.4g} Hz, and the converter's f_n is {f_n:g} Hz"
        return NOTHING_SEEN, [(problem, "Check sampling_rate; or take another record.")]
    turn = np.exp(-2j * math.pi * hz / (f_n * PER_CYCLE) * np.arange(len(beginning)))
    phasors = 2.0 * (window[:, 0] * turn) @ swings / window.sum()
    offset = float((np.abs(means) / np.abs(phasors).max()).max())
    clipped = max(_clipped(column) for column in values.T)
    negative, wrong = 0.0, []
    if len(phasors) == 3:
        negative, wrong = _sequences(phasors)
    if offset > LARGEST_OFFSET:
        wrong.append(
            (
                f"its mean is {_percent(offset)} of the fundamental, and the limit is {_percent(LARGEST_OFFSET)}",
                "Take the recorder's offset away.",
            )
        )
    if clipped > LARGEST_CLIPPED:
        wrong.append(
            (
                f"it is clipped: {_percent(clipped)} of the samples of a phase are at the same extreme, and the limit "
                f"is {_percent(LARGEST_CLIPPED)}",
                "Take a record whose range is larger than the voltage.",
            )
        )
    return Seen(hz, negative, offset, clipped), wrong


def _peak(lines: NDArray[np.float64]) -> float:
    """The place of the largest of these magnitudes, between the places of a parabola through their logarithms."""
    k = int(np.argmax(lines))
    if not 0 < k < len(lines) - 1 or not lines[k - 1 : k + 2].min() > 0.0:
        return float(k)
    left, top, right = np.log(lines[k - 1 : k + 2])
    return k + 0.5 * float((left - right) / (left - 2.0 * top + right))


def _sequences(phasors: NDArray[np.complex128]) -> tuple[float, list[Wrong]]:
    """The negative sequence over the positive one, and what makes it too large."""
    negative = _unbalance(phasors)
    if negative <= LARGEST_NEGATIVE:
        return negative, []
    sizes = np.abs(phasors)
    if np.ptp(phasors.real) + np.ptp(phasors.imag) < LARGEST_NEGATIVE * sizes.max():
        return negative, [("its three phases are the same", "Choose three different columns, or one phase alone.")]
    weak = [f"{k + 1}" for k in range(3) if sizes[k] < LARGEST_NEGATIVE * sizes.max()]
    if weak:
        said = f"phase {' and '.join(weak)} of its columns has no fundamental"
        return negative, [(said, "Choose the columns of all three phases, or one phase alone.")]
    if _unbalance(phasors[[0, 2, 1]]) <= LARGEST_NEGATIVE:
        return negative, [("its phases are in the order a, c, b", "Exchange the second and the third of `columns`.")]
    for k in range(3):
        signs = np.ones(3)
        signs[k] = -1.0
        if _unbalance(signs * phasors) <= LARGEST_NEGATIVE:
            return negative, [(f"phase {k + 1} of its columns has the wrong sign", "Turn the sign in the file.")]
    problem = (
        f"its negative sequence is {_percent(negative)} of the positive one, and the limit is "
        f"{_percent(LARGEST_NEGATIVE)}"
    )
    return negative, [(problem, "Check the order and the signs of the phases; or begin later, or take another record.")]


def _unbalance(phasors: NDArray[np.complex128]) -> float:
    """Negative over positive sequence of the phasors of the phases a, b, c; infinite without a positive one."""
    alpha, beta = clarke(*phasors)
    negative, positive = abs(alpha - 1j * beta), abs(alpha + 1j * beta)
    return float(negative / positive) if positive > 1e-9 * np.abs(phasors).max() else math.inf


def _clipped(column: NDArray[np.float64]) -> float:
    """The share of samples at an extreme, if they are too many for a sine of these steps; else 0."""
    share = 0.0
    for values in (column, -column):
        top = float(values.max())
        below = values[values < top]
        at_top = len(values) - len(below)
        beside = int(np.count_nonzero(below == below.max())) if len(below) else 0
        if at_top > MORE_THAN_NEXT * beside or at_top > 0.25 * len(values):
            share = max(share, at_top / len(values))
    return share


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"
