"""The modes of which a signal consists, and the oscillation that dominates it, by the matrix pencil method."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

MOST_MODES = 12
_SMALLEST, _ABOVE_NOISE = 1e-4, 3.0
"""Singular values count above this share of the largest one, and above this multiple of what the noise has."""

_ROWS = 120
"""Points of a fit: the singular values of their matrix take 0.5 ms."""

_DECAYED = 0.01
"""The fit ends where the signal is below this share of its largest deviation for good; the rest adds only noise."""

_ALIASED, _FINEST_S = 0.2, 4e-3
"""If the modes miss more than this share of the signal between the rows, it has something faster than the rows can
show, and the fit is repeated on its beginning with rows of this interval."""

_SMALL = 1e-3
"""Share of the signal's energy that an oscillation has at least, and it has twice what the fit does not explain: what
is less may be the image of something faster."""


class Modes(NamedTuple):
    """Σ amplitude · exp(s t) with t from the first point; complex modes are there with their conjugates."""

    s: Complex
    """1/s."""
    amplitude: Complex
    """In the signal's unit; that of a pair counts twice."""
    misfit: float
    """Rms of what the modes leave of the signal, over the rms of the signal."""


class Oscillation(NamedTuple):
    """The oscillation with the largest energy."""

    damping: float
    """Damping ratio −Re s/|s|."""
    hz: float
    """Im s/2π."""
    amplitude: float
    """Half the largest distance between its peaks, in the unit of the signal, which is averaged over a cycle."""
    misfit: float
    """As in :class:`Modes`."""


def matrix_pencil(values: Array, step_s: float) -> Modes:
    """The modes of equally spaced values (n,), n ≥ 6 (:eq:`matrix-pencil`).

    The rows of the matrix Y are n − L successive pieces of the signal, L = n/3. Its right singular vectors that
    belong to the signal, without their last and without their first row, differ by the poles z = exp(s·step). How
    many belong to the signal follows from the singular values: those of noise are all of one size.
    """
    y = np.asarray(values, dtype=float)
    if y.size < 6 or not np.isfinite(y).all():
        raise ValueError(f"values: {y.size} numbers; at least six finite ones are needed.")
    length = y.size // 3
    _, singular, right = np.linalg.svd(np.lib.stride_tricks.sliding_window_view(y, length + 1), full_matrices=False)
    noise = float(np.median(singular[singular.size // 2 :]))
    count = int(np.sum(singular > max(_SMALLEST * singular[0], _ABOVE_NOISE * noise)))
    count = min(max(count, 1), MOST_MODES, length - 1)
    signal = right[:count].T
    z = np.linalg.eigvals(np.linalg.lstsq(signal[:-1], signal[1:], rcond=None)[0])
    z = z[np.abs(z) > 0.0].astype(complex)
    powers = np.exp(np.outer(np.arange(y.size), np.log(z)))
    amplitude = np.linalg.lstsq(powers, y.astype(complex), rcond=None)[0]
    left = float(np.linalg.norm(y - (powers @ amplitude).real))
    size = float(np.linalg.norm(y))
    return Modes(
        np.asarray(np.log(z) / step_s, dtype=complex),
        np.asarray(amplitude, dtype=complex),
        left / size if size > 0.0 else 0.0,
    )


def dominant_oscillation(
    values: Array, step_s: float, low_hz: float, high_hz: float, cycle_s: float
) -> Oscillation | None:
    """The oscillation between two frequencies that has the largest energy in a signal (n,) that ends at zero.

    The signal is averaged over the grid's cycle ``cycle_s``, which takes out what is at the grid's frequency and its
    multiples and moves no pole, up to where it has decayed. None: no mode there oscillates, or the signal is shorter
    than two cycles.
    """
    cycle = max(round(cycle_s / step_s), 1)
    mean = np.convolve(values, np.full(cycle, 1.0 / cycle), mode="valid") if values.size >= cycle else values[:0]
    if mean.size < max(cycle, 6):
        return None
    size = np.abs(mean)
    alive = int(np.flatnonzero(size >= _DECAYED * size.max())[-1]) + 1
    kept = mean[: min(max(alive, 5 * cycle), mean.size)]
    every = max(-(-kept.size // _ROWS), 1)
    modes = _fitted(kept, every, step_s, cycle)
    finest = max(int(_FINEST_S / step_s), 1)
    if modes is not None and every > finest and modes.misfit > _ALIASED:
        every, kept = finest, kept[: finest * _ROWS]
        modes = _fitted(kept, every, step_s, cycle)
    if modes is None:
        return None
    span = kept.size * step_s
    total = float(np.sum(kept * kept)) * step_s
    best, share = None, max(_SMALL, 2.0 * modes.misfit**2)
    for s, a in zip(modes.s, modes.amplitude, strict=True):
        f = float(s.imag) / (2.0 * math.pi)
        energy = 2.0 * _energy(complex(s), complex(a), span) / total
        if low_hz <= f <= high_hz and energy > share:
            largest = 2.0 * abs(a) * math.exp(min(max(float(s.real), 0.0) * span, 600.0))
            best, share = Oscillation(-float(s.real) / abs(s), f, largest, modes.misfit), energy
    return best


def _fitted(kept: Array, every: int, step_s: float, cycle: int) -> Modes | None:
    """Modes of every n-th value, with the misfit at the values half-way between, where an alias does not fit."""
    if every > cycle:  # the rows are further apart than a cycle: average over them, against aliases
        kept = np.convolve(kept, np.full(every, 1.0 / every), mode="valid")
    points, between = kept[::every], kept[every // 2 :: every]
    if points.size < 6:
        return None
    modes = matrix_pencil(points, every * step_s)
    times = step_s * (every // 2 + every * np.arange(between.size))
    left = between - (np.exp(np.outer(times, modes.s)) @ modes.amplitude).real
    size = float(np.linalg.norm(between))
    return modes._replace(misfit=float(np.linalg.norm(left)) / size if size > 0.0 else 0.0)


def _energy(s: complex, amplitude: complex, span_s: float) -> float:
    """∫ |a e^{st}|² dt over the fit; a mode that grows is capped so that it stays a number."""
    rate = 2.0 * float(s.real)
    exponent = min(rate * span_s, 600.0)
    return abs(amplitude) ** 2 * (span_s if abs(exponent) < 1e-9 else math.expm1(exponent) / (exponent / span_s))
