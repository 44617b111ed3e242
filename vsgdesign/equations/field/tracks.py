"""The probe's lines: from the sums of a cycle to each line's equation v = R i + X x + g, and its third difference over
four cycles. And the instrument: sums of a line's equations times the sent probe, with forgetting, and the impedance
that fits.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import FieldSettings, LineSums, LockIn
from vsgdesign.equations.frames import rotate, rotate_back

SIGN_1 = 1.0
SIGN_2 = -1.0
"""Signs of the lines. With opposite ones the probe is zero where a cycle begins: a change of its sign is no step."""

SIZE_1 = 1.1
SIZE_2 = 1.7
"""Sizes of the lines at rest, relative to what σ* needs of equal lines (:eq:`field-amplitude`). The second one hardly
moves the mean of the power."""


def second_line(line: Any) -> Any:
    """Speed of the second line, in the flywheel's frame and relative to it: the next one farther from 0."""
    return line + 1.0 if line > 0.0 else line - 1.0


def lines_at(half_re: Any, half_im: Any, whole_re: Any, whole_im: Any, line: Any) -> tuple[Any, Any, Any, Any]:
    """The phasors of both lines (:eq:`field-pairs`), from e^{jφ/2} and e^{jφ}; ``line`` is the speed of the first, 1/2,
    ±5/2 or ±9/2. Returns (first_re, first_im, second_re, second_im)."""
    twice_re, twice_im = rotate(whole_re, whole_im, whole_re, whole_im)
    four_re, four_im = rotate(twice_re, twice_im, twice_re, twice_im)
    far = line > 3.0 or line < -3.0
    by_re = four_re if far else twice_re
    by_im = four_im if far else twice_im
    moved_re, moved_im = rotate(half_re, half_im, by_re, by_im)
    away = line > 1.0 or line < -1.0
    first_re = moved_re if away else half_re
    first_im = moved_im if away else half_im
    second_re, second_im = rotate(whole_re, whole_im, first_re, first_im)
    back = line < 0.0
    first_im = -first_im if back else first_im
    second_im = -second_im if back else second_im
    return first_re, first_im, second_re, second_im


class Window(NamedTuple):
    """Phasors of one line over a cycle, or their third difference: v = R i + X x + the grid, and the probe u, pu."""

    v_re: Any
    v_im: Any
    i_re: Any
    i_im: Any
    x_re: Any
    x_im: Any
    """(di/dt)/omega_n"""
    u_re: Any
    u_im: Any


class History(NamedTuple):
    """The windows of one line in the last three cycles."""

    one: Window
    two: Window
    three: Window
    """The oldest."""


def no_window() -> Window:
    """A window of nothing."""
    return Window(v_re=0.0, v_im=0.0, i_re=0.0, i_im=0.0, x_re=0.0, x_im=0.0, u_re=0.0, u_im=0.0)


def no_history() -> History:
    """A history of nothing."""
    return History(one=no_window(), two=no_window(), three=no_window())


def current_at_the_end(lock: LockIn) -> tuple[Any, Any]:
    """The current where the cycle ended, between two samples. Returns (i_re, i_im)."""
    place = 0.5 - lock.left
    i_re = lock.i_re + place * (lock.i_re - lock.i_before_re)
    i_im = lock.i_im + place * (lock.i_im - lock.i_before_im)
    return i_re, i_im


def window_of(
    sums: LineSums, weight: Any, turns: Any, boundary_re: Any, boundary_im: Any, settings: FieldSettings
) -> Window:
    """The window of a line from its sums (:eq:`field-boundary`).

    ``turns`` is the line's frequency in the stationary frame relative to omega_n. ``boundary`` is the current at the
    end of the cycle less the one at its beginning, both turned back by the line's angle there.
    """
    i_re = sums.i_re / weight
    i_im = sums.i_im / weight
    edge = 1.0 / (settings.omega_n * settings.T_s * weight)
    return Window(
        v_re=sums.v_re / weight,
        v_im=sums.v_im / weight,
        i_re=i_re,
        i_im=i_im,
        x_re=edge * boundary_re - turns * i_im,
        x_im=edge * boundary_im + turns * i_re,
        u_re=sums.u_re / weight,
        u_im=sums.u_im / weight,
    )


def windows_of_cycle(lock: LockIn, settings: FieldSettings) -> tuple[Window, Window, Window]:
    """The windows of a closed cycle: of the fundamental and of both lines. Returns (mean, line_1, line_2)."""
    end_re, end_im = current_at_the_end(lock)
    turns = lock.omega / settings.omega_n
    mean = window_of(lock.mean, lock.weight, turns, end_re - lock.i_start_re, end_im - lock.i_start_im, settings)
    # e^{−jνφ} is +1 or −1 where a cycle begins and the opposite where it ends, for both lines alike.
    sign = 1.0 if lock.half_re > 0.0 else -1.0
    both_re = sign * (end_re + lock.i_start_re)
    both_im = sign * (end_im + lock.i_start_im)
    line_1 = window_of(lock.line_1, lock.weight, (1.0 + settings.line) * turns, both_re, both_im, settings)
    line_2 = window_of(lock.line_2, lock.weight, (1.0 + second_line(settings.line)) * turns, both_re, both_im, settings)
    return mean, line_1, line_2


def third(now: Any, one: Any, two: Any, three: Any) -> Any:
    """The weights 1, 3, 3, 1: because e^{−jνφ} changes its sign from cycle to cycle, this is a third difference."""
    return 0.125 * (now + 3.0 * (one + two) + three)


def third_difference(now: Window, history: History) -> Window:
    """What is not constant, linear or quadratic over four cycles: the probe's response (:eq:`field-difference`)."""
    one, two, three = history.one, history.two, history.three
    return Window(
        v_re=third(now.v_re, one.v_re, two.v_re, three.v_re),
        v_im=third(now.v_im, one.v_im, two.v_im, three.v_im),
        i_re=third(now.i_re, one.i_re, two.i_re, three.i_re),
        i_im=third(now.i_im, one.i_im, two.i_im, three.i_im),
        x_re=third(now.x_re, one.x_re, two.x_re, three.x_re),
        x_im=third(now.x_im, one.x_im, two.x_im, three.x_im),
        u_re=third(now.u_re, one.u_re, two.u_re, three.u_re),
        u_im=third(now.u_im, one.u_im, two.u_im, three.u_im),
    )


def shifted(now: Window, history: History) -> History:
    """The history after one more cycle."""
    return History(one=now, two=history.one, three=history.two)


def residual(window: Window, R: Any, X: Any) -> tuple[Any, Any]:
    """What R and X leave of v. Returns (e_re, e_im)."""
    return window.v_re - R * window.i_re - X * window.x_re, window.v_im - R * window.i_im - X * window.x_im


def instrumented(window: Window, re: Any, im: Any) -> tuple[Any, Any]:
    """A phasor times the conjugate of the probe. Returns (product_re, product_im)."""
    return rotate_back(re, im, window.u_re, window.u_im)


CALIBRATION = 0.75
"""Factor of the covariance, from the ratio of the squared errors to it over many grids."""


class LineTrack(NamedTuple):
    """Sums of v, i, x and u of one line times the conjugate of the probe u, and of the squares of its weights."""

    v_re: Any
    v_im: Any
    i_re: Any
    i_im: Any
    x_re: Any
    x_im: Any
    uu: Any
    u_sq: Any
    """The square of the probe with the squares of the weights, of which the variance is made."""


class Track(NamedTuple):
    """Both lines over a memory of so many cycles."""

    line_1: LineTrack
    line_2: LineTrack
    count: Any
    """Cycles taken in."""


class Fit(NamedTuple):
    """An impedance with its covariance, pu."""

    R: Any
    X: Any
    P_RR: Any
    P_RX: Any
    P_XX: Any
    known: Any
    """0 where the sums do not say it, else 1."""


class Lines(NamedTuple):
    """R and X of the first line, and of the second one, pu."""

    R_1: Any
    X_1: Any
    R_2: Any
    X_2: Any


def no_line() -> LineTrack:
    """Sums of nothing."""
    return LineTrack(v_re=0.0, v_im=0.0, i_re=0.0, i_im=0.0, x_re=0.0, x_im=0.0, uu=0.0, u_sq=0.0)


def no_track() -> Track:
    """Nothing taken in."""
    return Track(line_1=no_line(), line_2=no_line(), count=0.0)


def line_taken(line: LineTrack, window: Window, keep: Any, weight: Any) -> LineTrack:
    """The sums of a line after one more cycle: ``keep`` is what is left of those before."""
    v_re, v_im = instrumented(window, window.v_re, window.v_im)
    i_re, i_im = instrumented(window, window.i_re, window.i_im)
    x_re, x_im = instrumented(window, window.x_re, window.x_im)
    u_sq = window.u_re * window.u_re + window.u_im * window.u_im
    return LineTrack(
        v_re=keep * line.v_re + weight * v_re,
        v_im=keep * line.v_im + weight * v_im,
        i_re=keep * line.i_re + weight * i_re,
        i_im=keep * line.i_im + weight * i_im,
        x_re=keep * line.x_re + weight * x_re,
        x_im=keep * line.x_im + weight * x_im,
        uu=keep * line.uu + weight * u_sq,
        u_sq=keep * keep * line.u_sq + weight * weight * u_sq,
    )


def taken(track: Track, line_1: Window, line_2: Window, memory: Any, weight: Any) -> Track:
    """The track after one more cycle of both lines (:eq:`field-instrument`); ``memory`` is in cycles."""
    keep = 1.0 - 1.0 / memory
    return Track(
        line_1=line_taken(track.line_1, line_1, keep, weight),
        line_2=line_taken(track.line_2, line_2, keep, weight),
        count=track.count + 1.0,
    )


def fit_of(track: Track, noise_1: Any, noise_2: Any) -> Fit:
    """The least squares of both lines with their noise (:eq:`field-fit`), pu² of one cycle."""
    one, two = track.line_1, track.line_2
    # A line without a probe has sums of zero and counts for nothing.
    w_1 = 1.0 / np.maximum(one.u_sq * noise_1, 1e-30)
    w_2 = 1.0 / np.maximum(two.u_sq * noise_2, 1e-30)
    ii = w_1 * (one.i_re * one.i_re + one.i_im * one.i_im) + w_2 * (two.i_re * two.i_re + two.i_im * two.i_im)
    ix = w_1 * (one.i_re * one.x_re + one.i_im * one.x_im) + w_2 * (two.i_re * two.x_re + two.i_im * two.x_im)
    xx = w_1 * (one.x_re * one.x_re + one.x_im * one.x_im) + w_2 * (two.x_re * two.x_re + two.x_im * two.x_im)
    iv = w_1 * (one.i_re * one.v_re + one.i_im * one.v_im) + w_2 * (two.i_re * two.v_re + two.i_im * two.v_im)
    xv = w_1 * (one.x_re * one.v_re + one.x_im * one.v_im) + w_2 * (two.x_re * two.v_re + two.x_im * two.v_im)
    determinant = ii * xx - ix * ix
    known = determinant > 1e-6 * ii * xx and ii * xx > 0.0
    divisor = determinant if known else 1.0
    return Fit(
        R=(xx * iv - ix * xv) / divisor,
        X=(ii * xv - ix * iv) / divisor,
        P_RR=0.5 * xx / divisor,
        P_RX=-0.5 * ix / divisor,
        P_XX=0.5 * ii / divisor,
        known=1.0 if known else 0.0,
    )


def fit_of_line(line: LineTrack) -> Fit:
    """The resistance and the reactance that one line says for itself, without a covariance."""
    turned = line.i_re * line.x_im - line.i_im * line.x_re
    size_sq = line.i_re * line.i_re + line.i_im * line.i_im
    known = turned > 1e-3 * size_sq or turned < -1e-3 * size_sq
    divisor = turned if known else 1.0
    return Fit(
        R=(line.v_re * line.x_im - line.v_im * line.x_re) / divisor,
        X=(line.i_re * line.v_im - line.i_im * line.v_re) / divisor,
        P_RR=0.0,
        P_RX=0.0,
        P_XX=0.0,
        known=1.0 if known and size_sq > 0.0 else 0.0,
    )


def distance(R: Any, X: Any, P_RR: Any, P_RX: Any, P_XX: Any) -> Any:
    """The square of a difference over its covariance."""
    return (P_XX * R * R - 2.0 * P_RX * R * X + P_RR * X * X) / np.maximum(P_RR * P_XX - P_RX * P_RX, 1e-30)


def line_forgotten(line: LineTrack, keep: Any) -> LineTrack:
    """The sums of a line times a factor."""
    return LineTrack(
        v_re=keep * line.v_re,
        v_im=keep * line.v_im,
        i_re=keep * line.i_re,
        i_im=keep * line.i_im,
        x_re=keep * line.x_re,
        x_im=keep * line.x_im,
        uu=keep * line.uu,
        u_sq=keep * keep * line.u_sq,
    )


def forgotten(track: Track, keep: Any) -> Track:
    """The track with less of the past."""
    one, two = line_forgotten(track.line_1, keep), line_forgotten(track.line_2, keep)
    return Track(line_1=one, line_2=two, count=track.count)


def line_merged(one: LineTrack, other: LineTrack) -> LineTrack:
    """The sums of both."""
    return LineTrack(
        v_re=one.v_re + other.v_re,
        v_im=one.v_im + other.v_im,
        i_re=one.i_re + other.i_re,
        i_im=one.i_im + other.i_im,
        x_re=one.x_re + other.x_re,
        x_im=one.x_im + other.x_im,
        uu=one.uu + other.uu,
        u_sq=one.u_sq + other.u_sq,
    )


def merged(one: Track, other: Track) -> Track:
    """Two tracks of different cycles as one."""
    line_1, line_2 = line_merged(one.line_1, other.line_1), line_merged(one.line_2, other.line_2)
    return Track(line_1=line_1, line_2=line_2, count=one.count + other.count)


def with_gain(fit: Fit, gain: Any) -> Fit:
    """The fit with the variance of the sensors' gains added."""
    return Fit(R=fit.R, X=fit.X, P_RR=fit.P_RR + gain, P_RX=fit.P_RX, P_XX=fit.P_XX + gain, known=fit.known)


def no_fit() -> Fit:
    """Nothing known."""
    return Fit(R=0.0, X=0.0, P_RR=1.0, P_RX=0.0, P_XX=1.0, known=0.0)


def wider_by(fit: Fit, factor: Any) -> Fit:
    """The fit with its covariance times a factor."""
    return Fit(
        R=fit.R,
        X=fit.X,
        P_RR=factor * fit.P_RR,
        P_RX=factor * fit.P_RX,
        P_XX=factor * fit.P_XX,
        known=fit.known,
    )
