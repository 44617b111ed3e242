"""What oscillates in a signal: its modes and the one that dominates, by the matrix pencil method; what a probe costs
the grid, interharmonics and ripple; and inertia and droop of a converter, told apart in its response to a ramp of the
frequency.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

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


_MOST_ROWS = 400
"""At most as many rows enter the fit: what follows is one of some hundred samples."""

_TIMES = 5.0
"""The columns may hide so many times what they leave unexplained: they are many, and most of an error fits in."""


class RampFit(NamedTuple):
    """ΔP = −D Δf/f_n − (2H/f_n) df/dt + what decays (:eq:`ramp-fit`)."""

    H_s: float
    """Inertia constant, s, with the delay of the power's filter taken out."""
    D_pu: float
    """Power per frequency, both per unit, positive if power rises when the frequency falls: 1/droop."""
    misfit: float
    """Rms of what the fit leaves of ΔP, over the rms of ΔP."""
    spread_s: float
    """Uncertainty of H, s: how far it is from that of a fit without dQ/dt and dV/dt, but at least what the unexplained
    part of ΔP could do to it, and at most five times that. It is large where a schedule changes the gains."""


def fit_ramp(
    P_pu: Array,
    Q_pu: Array,
    V_pu: Array,
    f_hz: Array,
    step_s: float,
    f_n_hz: float,
    cycle_rows: int,
    rest: tuple[float, float],
    lag_s: float = 0.0,
    limited: NDArray[np.bool_] | None = None,
) -> RampFit | None:
    """Inertia and droop from signals (n,) that begin at or before a ramp. None if they are too short.

    ``f_hz`` is the frequency of the converter's own voltage and ``rest`` the (P_pu, f_hz) before the ramp. The law
    of the power loops (:eq:`power-loop-law`) is linear in Δf, df/dt, dP/dt, dQ/dt and dV/dt, and a filter of P adds
    second derivatives, so that a least-squares fit over these columns holds during the transient as well, and no
    state of rest within the ramp is needed. All columns are means over a cycle. A filter of the delay ``lag_s``
    makes the droop lead by as much, which a ramp shows as D·lag/2 of H; it is subtracted. ``limited`` (n,) says where
    the current limiter acts: it may change the powers that the law sees, so that these rows are left out.
    """
    if len(P_pu) < 4 * cycle_rows + 8:
        return None
    P = P_pu - rest[0]
    f = (f_hz - rest[1]) / f_n_hz

    def mean(y: Array) -> Array:
        total = np.concatenate(([0.0], np.cumsum(0.5 * (y[1:] + y[:-1]))))
        return (total[cycle_rows:] - total[:-cycle_rows]) / cycle_rows

    def rate(y: Array) -> Array:
        return (y[cycle_rows:] - y[:-cycle_rows]) / (cycle_rows * step_s)

    columns = [mean(f), rate(f), *(rate(y) for y in (P, Q_pu, V_pu, np.gradient(P, step_s), np.gradient(f, step_s)))]
    # The windows of the first rows begin before the ramp, where its corner makes no difference to an exact law.
    A, y = np.column_stack(columns)[1:-1], mean(P)[1:-1]
    if limited is not None and limited.any():
        # A row's means reach back over a cycle, and the filter of P over one more.
        acted = np.concatenate(([0], np.cumsum(limited)))
        back = np.arange(len(limited) - cycle_rows)
        silent = acted[back + cycle_rows + 1] == acted[np.maximum(back - cycle_rows, 0)]
        A, y = A[silent[1:-1]], y[silent[1:-1]]
        if len(y) < 4 * cycle_rows:
            return None
    stride = max(len(y) // _MOST_ROWS, 1)
    A, y = A[::stride], y[::stride]
    size = float(np.linalg.norm(y))
    if size == 0.0 or not np.any(A[:, 0]):
        return None
    found, left = _solved(A, y)
    D = -float(found[0])
    fewer, _ = _solved(np.delete(A, (0, 3, 4), axis=1), y + D * A[:, 0])
    scale = _scale(A)
    hidden = left * float(np.linalg.norm(np.linalg.pinv(A / scale)[1])) / float(scale[1])
    spread = 0.5 * min(max(abs(float(found[1] - fewer[0])), hidden), _TIMES * hidden)
    return RampFit(0.5 * (-float(found[1]) - D * lag_s), D, left / size, spread)


def _solved(A: Array, y: Array) -> tuple[Array, float]:
    """Least-squares solution with columns of one size, and the norm of what is left."""
    scale = _scale(A)
    found = np.linalg.lstsq(A / scale, y, rcond=1e-12)[0]
    return found / scale, float(np.linalg.norm(A / scale @ found - y))


def _scale(A: Array) -> Array:
    """Largest magnitude in each column; one of a column of zeros."""
    largest = np.abs(A).max(axis=0)
    return np.where(largest > 0.0, largest, 1.0)
