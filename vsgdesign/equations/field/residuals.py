"""What an impedance leaves of the last cycles, as quadratic sums: no list of cycles is kept."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.noise import DIFFERENCE_GAIN
from vsgdesign.equations.field.windows import Window


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
