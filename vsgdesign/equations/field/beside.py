"""What lies beside a series resistance and inductance: a capacitance or a conductance at the PCC, or no passive grid.

Two lines say four numbers, of which a series R and X takes two. What it leaves tells whether a third one is needed,
and with it whether the grid is one of R, L and C or R, L and a load at all.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import FieldSettings
from vsgdesign.equations.field.noise import Noise
from vsgdesign.equations.field.tracks import CALIBRATION, Fit, Lines, LineTrack, Track, fit_of_line
from vsgdesign.equations.frames import rotate, rotate_back

UNEQUAL = 0.0023
"""Error of one line that the other one does not share, relative: half of the class of the sensors' gains."""
SETTLED = 10.5
"""Cycles of the slow track after which its lines are compared."""
REFUTED = 9.2
CONFIRMED = 6.0
"""χ² of R and X (two degrees of freedom) above which, and below which, they do not and do explain both lines."""
POSSIBLE = 13.8
POSSIBLE_SHUNT = 10.8
"""χ² with two degrees of freedom, and with one, that a passive grid may have: 99.9 %."""
ODDS = 0.02
"""Odds of a shunt before anything is measured, for what is answered."""
ODDS_OF_ERROR = 0.3
"""The same for the covariance."""
IMPOSSIBLE = 1e9
"""χ² of a model that cannot be."""
LARGEST_B = 0.5
LARGEST_G = 1.0
"""Standard deviation of a shunt's susceptance and conductance before anything is measured, pu."""
LARGEST_STEP = 0.2
"""Largest change of a shunt in one step of its fit, pu."""
OUTSIDE = 2.0
"""Shunts beyond this are begun anew."""
NEGATIVE = 3.0
NEGATIVE_SHARE = 0.02
"""Standard deviations by which a resistance may be negative, and the share of Z besides."""
MODEL_ERROR = 0.7
LARGEST_MODEL_ERROR = 0.08
"""Standard deviation of what a shunt moves the answer by, and of that at most, relative to Z."""
DISTRIBUTED = 0.05
"""Error of a line, relative to what a shunt moves the answer by, that the shape of a real shunt makes."""
LARGEST_LOAD = 0.17
"""Share of the current that a conductance may take: beyond it, inverters look the same."""
SHARE_OF_MISFIT = 0.1
"""Variance of R and X over the square of the difference of both lines, where these differ."""


class LineSeen(NamedTuple):
    """What one line says: an impedance at the PCC at the complex frequency p over ω_n, pu."""

    z_re: Any
    z_im: Any
    p_re: Any
    p_im: Any
    weight: Any
    """One over its variance on each axis."""


class Shunted(NamedTuple):
    """R and X in series, with Y beside: a susceptance B or a conductance G, pu."""

    R: Any
    X: Any
    Y: Any


class Normal(NamedTuple):
    """Normal equations of R, X and Y with what is left over."""

    a_11: Any
    a_12: Any
    a_13: Any
    a_22: Any
    a_23: Any
    a_33: Any
    b_1: Any
    b_2: Any
    b_3: Any
    chi_sq: Any


class Judged(NamedTuple):
    """A model's impedance at ω_n with its covariance, pu, and what speaks for it."""

    R: Any
    X: Any
    P_RR: Any
    P_RX: Any
    P_XX: Any
    chi_sq: Any
    moves_sq: Any
    """Square of its distance to the mean of what both lines say."""
    possible: Any
    """1 if neither its resistance nor its shunt is negative, else 0."""


class Beside(NamedTuple):
    """What is known of it from cycle to cycle."""

    capacitor: Shunted
    load: Shunted
    d_R: Any
    d_X: Any
    """What is added to the answer, pu."""
    P_RR: Any
    P_RX: Any
    P_XX: Any
    """What is added to its covariance, pu²."""
    refuted: Any
    """1 where R and X do not explain both lines, else 0. Each line then has a residual of its own."""
    misfit: Any
    """Variance of R and X that the difference of both lines then means, pu²."""
    passive: Any
    """0 where no passive grid explains both lines, else 1."""
    again: Any
    """How often a doubt has begun anew."""


def nothing_beside() -> Beside:
    """R and X alone."""
    none = Shunted(R=0.0, X=0.0, Y=0.0)
    return Beside(none, none, 0.0, 0.0, 0.0, 0.0, 0.0, refuted=0.0, misfit=0.0, passive=1.0, again=0.0)


def line_seen(line: LineTrack, noise: Any, settings: FieldSettings) -> LineSeen:
    """A line's impedance at the PCC, with its variance (:eq:`field-lines`)."""
    ii = np.maximum(line.i_re * line.i_re + line.i_im * line.i_im, 1e-30)
    v_re, v_im = rotate_back(line.v_re, line.v_im, line.i_re, line.i_im)
    x_re, x_im = rotate_back(line.x_re, line.x_im, line.i_re, line.i_im)
    z_re, z_im, p_re, p_im = v_re / ii, v_im / ii, x_re / ii, x_im / ii
    unequal = UNEQUAL * UNEQUAL * (z_re * z_re + z_im * z_im)
    variance = 0.5 * CALIBRATION * noise * line.u_sq / ii + unequal
    return LineSeen(
        z_re=z_re - settings.R_2 - settings.X_2 * p_re,
        z_im=z_im - settings.X_2 * p_im,
        p_re=p_re,
        p_im=np.maximum(p_im, 1e-3) if p_im > 0.0 else np.minimum(p_im, -1e-3),
        weight=1.0 / np.maximum(variance, 1e-12),
    )


def behind_shunt(model: Shunted, s_re: Any, s_im: Any, p_re: Any, p_im: Any) -> tuple[Any, Any, Any, Any]:
    """R and X with a shunt s Y at a complex frequency p (:eq:`field-shunt`), and its derivative by R.

    Returns (z_re, z_im, t_re, t_im).
    """
    q_re, q_im = model.R + p_re * model.X, p_im * model.X
    y_re, y_im = rotate(s_re, s_im, q_re, q_im)
    d_re, d_im = 1.0 + model.Y * y_re, model.Y * y_im
    size = np.maximum(d_re * d_re + d_im * d_im, 1e-6)
    n_re, n_im = d_re / size, -d_im / size
    z_re, z_im = rotate(q_re, q_im, n_re, n_im)
    t_re, t_im = rotate(n_re, n_im, n_re, n_im)
    return z_re, z_im, t_re, t_im


def normal_of(model: Shunted, line: LineSeen, by_frequency: Any) -> Normal:
    """A line's part of the normal equations. ``by_frequency``: 1 for a capacitance, 0 for a conductance."""
    s_re = line.p_re if by_frequency > 0.5 else 1.0
    s_im = line.p_im if by_frequency > 0.5 else 0.0
    z_re, z_im, t_re, t_im = behind_shunt(model, s_re, s_im, line.p_re, line.p_im)
    x_re, x_im = rotate(line.p_re, line.p_im, t_re, t_im)
    zz_re, zz_im = rotate(z_re, z_im, z_re, z_im)
    by_re, by_im = rotate(s_re, s_im, zz_re, zz_im)
    y_re, y_im = -by_re, -by_im
    e_re, e_im, w = line.z_re - z_re, line.z_im - z_im, line.weight
    return Normal(
        a_11=w * (t_re * t_re + t_im * t_im),
        a_12=w * (t_re * x_re + t_im * x_im),
        a_13=w * (t_re * y_re + t_im * y_im),
        a_22=w * (x_re * x_re + x_im * x_im),
        a_23=w * (x_re * y_re + x_im * y_im),
        a_33=w * (y_re * y_re + y_im * y_im),
        b_1=w * (t_re * e_re + t_im * e_im),
        b_2=w * (x_re * e_re + x_im * e_im),
        b_3=w * (y_re * e_re + y_im * e_im),
        chi_sq=w * (e_re * e_re + e_im * e_im),
    )


def normal_of_both(model: Shunted, one: LineSeen, two: LineSeen, by_frequency: Any) -> Normal:
    """The normal equations of both lines, with what is known of a shunt beforehand."""
    a, b = normal_of(model, one, by_frequency), normal_of(model, two, by_frequency)
    largest = LARGEST_B if by_frequency > 0.5 else LARGEST_G
    before = 1.0 / (largest * largest)
    return Normal(
        a_11=a.a_11 + b.a_11,
        a_12=a.a_12 + b.a_12,
        a_13=a.a_13 + b.a_13,
        a_22=a.a_22 + b.a_22,
        a_23=a.a_23 + b.a_23,
        a_33=a.a_33 + b.a_33 + before,
        b_1=a.b_1 + b.b_1,
        b_2=a.b_2 + b.b_2,
        b_3=a.b_3 + b.b_3 - before * model.Y,
        chi_sq=a.chi_sq + b.chi_sq,
    )


def factors_of(n: Normal) -> tuple[Any, Any, Any, Any, Any, Any]:
    """The factors L D Lᵀ of the normal equations. Returns (d_1, d_2, d_3, l_21, l_31, l_32)."""
    d_1 = np.maximum(n.a_11, 1e-12)
    l_21, l_31 = n.a_12 / d_1, n.a_13 / d_1
    d_2 = np.maximum(n.a_22 - l_21 * n.a_12, 1e-12)
    m_32 = n.a_23 - l_31 * n.a_12
    l_32 = m_32 / d_2
    d_3 = np.maximum(n.a_33 - l_31 * n.a_13 - l_32 * m_32, 1e-12)
    return d_1, d_2, d_3, l_21, l_31, l_32


def improved(model: Shunted, one: LineSeen, two: LineSeen, by_frequency: Any) -> Shunted:
    """A model after one step of Gauss and Newton."""
    n = normal_of_both(model, one, two, by_frequency)
    d_1, d_2, d_3, l_21, l_31, l_32 = factors_of(n)
    y_2 = n.b_2 - l_21 * n.b_1
    y_3 = n.b_3 - l_31 * n.b_1 - l_32 * y_2
    step = np.minimum(np.maximum(y_3 / d_3, -LARGEST_STEP), LARGEST_STEP)
    X = y_2 / d_2 - l_32 * step
    R = n.b_1 / d_1 - l_21 * X - l_31 * step
    return Shunted(R=model.R + R, X=model.X + X, Y=model.Y + step)


def judged(model: Shunted, one: LineSeen, two: LineSeen, by_frequency: Any) -> Judged:
    """What a model with a shunt says of the impedance at ω_n."""
    n = normal_of_both(model, one, two, by_frequency)
    d_1, d_2, d_3, l_21, l_31, l_32 = factors_of(n)
    s_re = 0.0 if by_frequency > 0.5 else 1.0
    z_re, z_im, t_re, t_im = behind_shunt(model, s_re, 1.0 - s_re, 0.0, 1.0)
    zz_re, zz_im = rotate(z_re, z_im, z_re, z_im)
    y_re, y_im = rotate(-s_re, s_re - 1.0, zz_re, zz_im)
    # Derivatives of R and X at ω_n by the three parameters: t, j t and −s z².
    r_2, r_3 = -t_im - l_21 * t_re, y_re - l_31 * t_re - l_32 * (-t_im - l_21 * t_re)
    x_2, x_3 = t_re - l_21 * t_im, y_im - l_31 * t_im - l_32 * (t_re - l_21 * t_im)
    e_3 = l_32 * l_21 - l_31
    R_sq = 1.0 / d_1 + l_21 * l_21 / d_2 + e_3 * e_3 / d_3
    size = np.sqrt(z_re * z_re + z_im * z_im)
    # Where R and X of both lines differ, their mean does not depend on the weights of the lines.
    middle_R = 0.5 * (one.z_re + two.z_re)
    middle_X = 0.5 * (one.z_im / one.p_im + two.z_im / two.p_im)
    moves_sq = (z_re - middle_R) * (z_re - middle_R) + (z_im - middle_X) * (z_im - middle_X)
    taken_sq = model.Y * model.Y * (model.R * model.R + model.X * model.X)
    least = -NEGATIVE * np.sqrt(R_sq) - NEGATIVE_SHARE * size
    most = 1e6 if by_frequency > 0.5 else LARGEST_LOAD * LARGEST_LOAD
    return Judged(
        R=z_re,
        X=z_im,
        P_RR=t_re * t_re / d_1 + r_2 * r_2 / d_2 + r_3 * r_3 / d_3,
        P_RX=t_re * t_im / d_1 + r_2 * x_2 / d_2 + r_3 * x_3 / d_3,
        P_XX=t_im * t_im / d_1 + x_2 * x_2 / d_2 + x_3 * x_3 / d_3,
        chi_sq=n.chi_sq,
        moves_sq=moves_sq,
        possible=1.0 if least < model.R and model.Y > 0.0 and taken_sq < most else 0.0,
    )


def without_shunt(fit: Fit, one: LineSeen, two: LineSeen, settings: FieldSettings) -> Judged:
    """What R and X alone say."""
    R, X = fit.R - settings.R_2, fit.X - settings.X_2
    n = normal_of_both(Shunted(R=R, X=X, Y=0.0), one, two, 0.0)
    least = -NEGATIVE * np.sqrt(np.maximum(CALIBRATION * fit.P_RR, 0.0)) - NEGATIVE_SHARE * np.sqrt(R * R + X * X)
    return Judged(
        R=R,
        X=X,
        P_RR=CALIBRATION * fit.P_RR,
        P_RX=CALIBRATION * fit.P_RX,
        P_XX=CALIBRATION * fit.P_XX,
        chi_sq=n.chi_sq,
        moves_sq=0.0,
        possible=1.0 if least < R else 0.0,
    )


def next_model(before: Shunted, fresh: Any, alone: Judged, one: LineSeen, two: LineSeen, by_frequency: Any) -> Shunted:
    """A model two steps on; ``fresh`` is 1 where it begins at R and X alone."""
    begins = fresh > 0.5 or not (before.Y < OUTSIDE and before.Y > -OUTSIDE and before.X > 0.0)
    start = Shunted(R=alone.R if begins else before.R, X=alone.X if begins else before.X, Y=0.0 if begins else before.Y)
    return improved(improved(start, one, two, by_frequency), one, two, by_frequency)


def odds_of(chi_sq: Any, best: Any) -> Any:
    """The probability of a model over that of the best one, both being equally probable beforehand."""
    return np.exp(np.maximum(0.5 * (best - chi_sq), -30.0))


def agrees(model: Judged, finest: Any, most: Any) -> bool:
    """Whether both lines may be those of a model; ``finest`` is the least variance of a line."""
    slack = finest / (finest + DISTRIBUTED * DISTRIBUTED * model.moves_sq)
    return model.possible > 0.5 and model.chi_sq * slack < most


def beside_with(before: Beside, slow: Track, fit: Fit, noise: Noise, settings: FieldSettings) -> Beside:
    """What lies beside R and X, from the slow track and its fit (:eq:`field-beside`)."""
    one = line_seen(slow.line_1, noise.line_1.S, settings)
    two = line_seen(slow.line_2, noise.line_2.S, settings)
    alone = without_shunt(fit, one, two, settings)
    settled = slow.count > SETTLED and fit.known > 0.5
    fresh = 0.0 if slow.count > SETTLED + 1.0 else 1.0
    capacitor = next_model(before.capacitor, fresh, alone, one, two, 1.0)
    load = next_model(before.load, fresh, alone, one, two, 0.0)
    C, G = judged(capacitor, one, two, 1.0), judged(load, one, two, 0.0)
    chi_C = C.chi_sq if C.possible > 0.5 else IMPOSSIBLE
    chi_G = G.chi_sq if G.possible > 0.5 else IMPOSSIBLE
    best = np.minimum(alone.chi_sq, np.minimum(chi_C, chi_G))
    odds_0, odds_C, odds_G = odds_of(alone.chi_sq, best), odds_of(chi_C, best), odds_of(chi_G, best)
    all_said = odds_0 + ODDS * (odds_C + odds_G)
    w_C, w_G = ODDS * odds_C / all_said, ODDS * odds_G / all_said
    d_R = w_C * (C.R - alone.R) + w_G * (G.R - alone.R)
    d_X = w_C * (C.X - alone.X) + w_G * (G.X - alone.X)
    all_meant = odds_0 + ODDS_OF_ERROR * (odds_C + odds_G)
    v_C, v_G = ODDS_OF_ERROR * odds_C / all_meant, ODDS_OF_ERROR * odds_G / all_meant
    v_0 = 1.0 - v_C - v_G
    c_R, c_X, g_R, g_X = C.R - alone.R - d_R, C.X - alone.X - d_X, G.R - alone.R - d_R, G.X - alone.X - d_X
    R, X = alone.R + d_R, alone.X + d_X
    most = LARGEST_MODEL_ERROR * LARGEST_MODEL_ERROR * (R * R + X * X)
    of_model = np.minimum(MODEL_ERROR * MODEL_ERROR * (v_C * C.moves_sq + v_G * G.moves_sq), most)
    finest = 1.0 / np.maximum(one.weight, two.weight)
    passive = (
        (alone.possible > 0.5 and alone.chi_sq < POSSIBLE)
        or agrees(C, finest, POSSIBLE_SHUNT)
        or agrees(G, finest, POSSIBLE_SHUNT)
    )
    limit = CONFIRMED if before.refuted > 0.5 else REFUTED
    sane = settled and d_R * d_R + d_X * d_X < 1e6
    wider = C.P_RR + C.P_XX + G.P_RR + G.P_XX < 1e12
    P_RR = v_C * (C.P_RR - alone.P_RR + c_R * c_R) + v_G * (G.P_RR - alone.P_RR + g_R * g_R) + v_0 * d_R * d_R
    P_RX = v_C * (C.P_RX - alone.P_RX + c_R * c_X) + v_G * (G.P_RX - alone.P_RX + g_R * g_X) + v_0 * d_R * d_X
    P_XX = v_C * (C.P_XX - alone.P_XX + c_X * c_X) + v_G * (G.P_XX - alone.P_XX + g_X * g_X) + v_0 * d_X * d_X
    said = sane and wider
    refuted = 1.0 if settled and alone.chi_sq > limit else 0.0
    return Beside(
        capacitor=capacitor,
        load=load,
        d_R=d_R if said else 0.0,
        d_X=d_X if said else 0.0,
        P_RR=P_RR + of_model if said else 0.0,
        P_RX=P_RX if said else 0.0,
        P_XX=P_XX + of_model if said else 0.0,
        refuted=refuted,
        misfit=misfit_of(slow, refuted),
        passive=1.0 if passive or not settled else 0.0,
        again=before.again,
    )


def misfit_of(slow: Track, refuted: Any) -> Any:
    """Variance of R and X that the difference of both lines means, where R and X do not explain them."""
    one, two = fit_of_line(slow.line_1), fit_of_line(slow.line_2)
    R, X = one.R - two.R, one.X - two.X
    known = refuted > 0.5 and one.known > 0.5 and two.known > 0.5
    return SHARE_OF_MISFIT * (R * R + X * X) if known else 0.0


def own_lines(track: Track, fit: Fit, apart: Any) -> Lines:
    """R and X of both lines: those of each line itself where they lie ``apart`` (1), else those of the fit."""
    one, two = fit_of_line(track.line_1), fit_of_line(track.line_2)
    own = apart > 0.5 and one.known > 0.5 and two.known > 0.5
    R_1 = one.R if own else fit.R
    X_1 = one.X if own else fit.X
    R_2 = two.R if own else fit.R
    X_2 = two.X if own else fit.X
    return Lines(R_1=R_1, X_1=X_1, R_2=R_2, X_2=X_2)


def with_again(beside: Beside, again: Any) -> Beside:
    """The same after a doubt has begun anew so often."""
    return beside._replace(again=again)


def with_beside(fit: Fit, beside: Beside) -> Fit:
    """What is answered: R and X at ω_n, with what lies beside."""
    return Fit(
        R=fit.R + beside.d_R,
        X=fit.X + beside.d_X,
        P_RR=fit.P_RR + beside.P_RR,
        P_RX=fit.P_RX + beside.P_RX,
        P_XX=fit.P_XX + beside.P_XX,
        known=fit.known,
    )
