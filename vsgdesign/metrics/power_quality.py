"""What a probe costs the grid: voltage between the harmonics, and ripple of the power."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

WINDOW_S = 0.2
"""Length of a window at nominal frequency, s: 10 cycles of 50 Hz or 12 of 60 Hz, so that a bin is 5 Hz wide."""

_BESIDE = 2
"""The bins from here on count. The one next to a harmonic belongs to this harmonic."""


def interharmonic_rms(
    values: ArrayLike, step_s: float, frequency_hz: float, order: int, nominal_hz: float = 50.0
) -> float:
    """Rms value of what a signal has between its harmonics ``order`` and ``order`` + 1, in the signal's unit.

    ``values`` (n,): samples of one phase every ``step_s`` s, at least one window long. A window has whole cycles of
    the fundamental ``frequency_hz``, 10 for a nominal 50 Hz and 12 for 60 Hz. The rms values of its bins from the
    second to the last but second between the two harmonics are added as squares, and windows are averaged as squares.
    This is the centred interharmonic subgroup of IEC 61000-4-7. Raises ValueError for a record shorter than a window.
    """
    x = np.asarray(values, dtype=float)
    cycles = round(WINDOW_S * nominal_hz)
    length = cycles / frequency_hz / step_s
    windows = math.floor((len(x) - 1) / length)
    if windows < 1:
        raise ValueError(
            f"values: {len(x)} samples every {step_s:g} s are {len(x) * step_s:g} s, and a window has "
            f"{cycles / frequency_hz:g} s. Give a longer record."
        )
    first, last = cycles * order + _BESIDE, cycles * (order + 1) - _BESIDE
    t = np.arange(len(x), dtype=np.float64) * step_s
    x = x - _fundamental(x, t, frequency_hz)
    parts = [_window(k * length, (k + 1) * length) for k in range(windows)]
    # One bin after the other, each turned by one bin more than the one before: an exponential of every sample and bin
    # would take ten times as long.
    further = np.exp(-2j * math.pi * frequency_hz / cycles * t)
    turned = x * np.exp(-2j * math.pi * first * frequency_hz / cycles * t)
    squares = np.zeros(windows)
    for _ in range(first, last + 1):
        amplitudes = 2.0 / length * np.abs([weights @ turned[chosen] for chosen, weights in parts])
        squares += 0.5 * amplitudes**2
        turned *= further
    return math.sqrt(float(np.mean(squares)))


def ripple_rms(values: ArrayLike) -> float:
    """Rms value of a signal about its mean, in its unit."""
    return float(np.std(np.asarray(values, dtype=float)))


def _fundamental(x: Array, t: Array, frequency_hz: float) -> Array:
    """The signal's mean and fundamental, by least squares: its leakage from a window of not quite whole samples would
    hide what is a thousand times smaller."""
    angle = 2.0 * math.pi * frequency_hz * t
    basis = np.column_stack([np.ones_like(t), np.cos(angle), np.sin(angle)])
    return basis @ np.linalg.lstsq(basis, x, rcond=None)[0]


def _window(begin: float, end: float) -> tuple[slice, Array]:
    """The samples k whose interval, [k − ½, k + ½] in samples, has a part in [begin, end] − ½, and how much of each."""
    first, stop = math.floor(begin), math.ceil(end)
    edges = np.arange(first, stop + 1, dtype=float)
    return slice(first, stop), np.diff(np.clip(edges, begin, end))
