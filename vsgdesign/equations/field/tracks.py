"""The instrument: sums of a line's equations times the sent probe, with forgetting, and the impedance that fits."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.windows import Window, instrumented

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
