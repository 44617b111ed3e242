"""What an impedance leaves of the probe's lines: the noise of each line, per cycle and per chip of the sign code, and
the quadratic sums of the last cycles, of which no list is kept.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.tracks import Window, instrumented

DIFFERENCE_GAIN = 0.3125
"""Variance of the third difference over that of a cycle, for white noise: (1 + 9 + 9 + 1)/64."""
NOISE_MEMORY = 50.0
"""Cycles over which the variance is averaged."""
NOISE_FIRST_COUNT = 6.0
"""Cycles for which the first assumption counts."""
CHIP_MEMORY = 14.0
"""Chips over which the variance of their sums is averaged."""
CHIP_CYCLES = 5.0
"""Cycles of one chip of the sign code."""
CHIP_MARGIN = 1.3
"""By how much chips may exceed the white variance before they count."""
OUTLIER = 12.0
"""A residual counts as at most so many times the variance."""


class LineNoise(NamedTuple):
    """Noise of one line, pu² of one cycle."""

    S: Any
    """Variance that the covariance is made of: that of a cycle, or of the chips where they are louder."""
    cycle: Any
    """From single cycles."""
    chip: Any
    """From chips."""
    sum_re: Any
    sum_im: Any
    """Sum of the running chip."""
    u_sq: Any
    """Square of the probe in it."""


class Noise(NamedTuple):
    """Noise of both lines, with what has been counted."""

    line_1: LineNoise
    line_2: LineNoise
    count: Any
    """Cycles in the averages, up to NOISE_MEMORY."""
    chips: Any
    """Chips in the averages, up to CHIP_MEMORY."""
    filled: Any
    """Cycles of the running chip."""


def first_noise(variance: Any) -> Noise:
    """The noise before anything has been measured."""
    line = LineNoise(S=variance, cycle=variance, chip=0.0, sum_re=0.0, sum_im=0.0, u_sq=0.0)
    return Noise(line_1=line, line_2=line, count=NOISE_FIRST_COUNT, chips=0.0, filled=0.0)


def line_noise(
    line: LineNoise,
    window: Window,
    e_re: Any,
    e_im: Any,
    share: Any,
    count: Any,
    chips: Any,
    ends: Any,
    weight: Any,
) -> LineNoise:
    """The noise of a line after one more residual e (:eq:`field-noise`).

    ``share`` is the part of the noise that a fit of few cycles leaves in its residual. ``ends`` is 1 where a chip ends.
    """
    u_sq = window.u_re * window.u_re + window.u_im * window.u_im
    active = u_sq > 1e-14
    seen = np.minimum((e_re * e_re + e_im * e_im) / (DIFFERENCE_GAIN * share), OUTLIER * line.cycle)
    cycle = line.cycle + (seen - line.cycle) / count if active else line.cycle
    c_re, c_im = instrumented(window, e_re, e_im)
    sum_re = line.sum_re + weight * c_re
    sum_im = line.sum_im + weight * c_im
    of_chip = line.u_sq + weight * weight * u_sq
    loud = (sum_re * sum_re + sum_im * sum_im) / np.maximum(of_chip, 1e-30)
    first = (
        loud
        if chips < 1.5
        else line.chip + (np.minimum(loud, 10.0 * np.maximum(line.chip, cycle)) - line.chip) / np.maximum(chips, 1.0)
    )
    chip = first if ends > 0.5 else line.chip
    ratio = chip / np.maximum(cycle, 1e-30) if chips > 2.5 else 1.0
    rest = 1.0 - ends
    return LineNoise(
        S=cycle * np.maximum(1.0, ratio / CHIP_MARGIN),
        cycle=cycle,
        chip=chip,
        sum_re=rest * sum_re,
        sum_im=rest * sum_im,
        u_sq=rest * of_chip,
    )


def noise_with(
    noise: Noise,
    line_1: Window,
    line_2: Window,
    e_1_re: Any,
    e_1_im: Any,
    e_2_re: Any,
    e_2_im: Any,
    share: Any,
    weight: Any,
) -> Noise:
    """The noise after one more cycle."""
    count = np.minimum(noise.count + 1.0, NOISE_MEMORY)
    filled = noise.filled + 1.0
    ends = 1.0 if filled >= CHIP_CYCLES else 0.0
    chips = np.minimum(noise.chips + ends, CHIP_MEMORY)
    return Noise(
        line_1=line_noise(noise.line_1, line_1, e_1_re, e_1_im, share, count, chips, ends, weight),
        line_2=line_noise(noise.line_2, line_2, e_2_re, e_2_im, share, count, chips, ends, weight),
        count=count,
        chips=chips,
        filled=filled * (1.0 - ends),
    )


def noise_of_probe(noise: Noise) -> Any:
    """The noise that the probe's size is made for: that of both lines together."""
    return 2.0 / (1.0 / noise.line_1.S + 1.0 / noise.line_2.S)


class Squares(NamedTuple):
    """Sums of products of v, i and x, from which Σ|v − R i − X x|² follows for any R and X, pu²."""

    vv: Any
    vi: Any
    vx: Any
    ii: Any
    ix: Any
    xx: Any


class Residuals(NamedTuple):
    """Both lines over the fast track's memory."""

    line_1: Squares
    line_2: Squares
    count: Any
    """Cycles in the sums, forgotten ones as what is left of them."""


def no_squares() -> Squares:
    """Sums of nothing."""
    return Squares(vv=0.0, vi=0.0, vx=0.0, ii=0.0, ix=0.0, xx=0.0)


def no_residuals() -> Residuals:
    """Nothing taken in."""
    return Residuals(line_1=no_squares(), line_2=no_squares(), count=0.0)


def squares_with(sums: Squares, window: Window, keep: Any) -> Squares:
    """The sums with one more window; ``keep`` is what is left of those before."""
    w = window
    return Squares(
        vv=keep * sums.vv + w.v_re * w.v_re + w.v_im * w.v_im,
        vi=keep * sums.vi + w.v_re * w.i_re + w.v_im * w.i_im,
        vx=keep * sums.vx + w.v_re * w.x_re + w.v_im * w.x_im,
        ii=keep * sums.ii + w.i_re * w.i_re + w.i_im * w.i_im,
        ix=keep * sums.ix + w.i_re * w.x_re + w.i_im * w.x_im,
        xx=keep * sums.xx + w.x_re * w.x_re + w.x_im * w.x_im,
    )


def residuals_with(residuals: Residuals, line_1: Window, line_2: Window, memory: Any) -> Residuals:
    """The sums of both lines with one more cycle."""
    keep = 1.0 - 1.0 / memory
    return Residuals(
        line_1=squares_with(residuals.line_1, line_1, keep),
        line_2=squares_with(residuals.line_2, line_2, keep),
        count=keep * residuals.count + 1.0,
    )


def left_over(sums: Squares, R: Any, X: Any) -> Any:
    """Σ|v − R i − X x|²."""
    linear = sums.vv - 2.0 * (R * sums.vi + X * sums.vx)
    return np.maximum(linear + R * R * sums.ii + 2.0 * R * X * sums.ix + X * X * sums.xx, 0.0)


def misfit(residuals: Residuals, R: Any, X: Any, noise_1: Any, noise_2: Any) -> Any:
    """How much larger the residuals of R and X are than the noise says, at least 1."""
    mean = 0.5 * (left_over(residuals.line_1, R, X) / noise_1 + left_over(residuals.line_2, R, X) / noise_2)
    ratio = mean / (DIFFERENCE_GAIN * np.maximum(residuals.count - 1.0, 1.0))
    return np.maximum(ratio, 1.0) if residuals.count > 2.0 else 1.0
