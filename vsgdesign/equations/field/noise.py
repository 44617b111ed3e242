"""The noise of each line, measured from what the fit leaves: per cycle, and per chip of the sign code."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.windows import Window, instrumented

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
