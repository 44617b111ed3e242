"""Doubt: after a step, two rival explanations, the impedance or the grid's own phasor, told apart by the probe."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import FieldSettings
from vsgdesign.equations.field.grid_phasor import GridPhasor
from vsgdesign.equations.field.noise import Squares, left_over, no_squares
from vsgdesign.equations.field.tracks import Fit, Window, distance

FREQUENCY_UNSURE = 4e-4
"""How much less sure the turned-on reference becomes in a cycle, pu."""
STEP_UNSURE = 0.05
"""Error of the impedance from the step, relative, for what is not resistance and inductance."""
LEAST_CURRENT = 0.05
"""Mean current below which the step says nothing, pu."""
NEAR = 9.2
"""Square of a distance that is no contradiction (99 % of two dimensions)."""
NEAR_STEP = 12.0
FAR = 22.0
"""Square of a distance that is one."""
RATIO = 14.0
"""Difference of squared distances at which one explanation is preferred."""
SURE = 0.15
"""Relative standard deviation of the first difference after an event up to which it may decide alone."""
NEVER = 99.0
LONGEST = 25.0
"""Cycles of the fast track after which a doubt ends without a decision."""


class Doubt(NamedTuple):
    """What is collected while the answer is held."""

    used: Any
    """Cycles that the fast track has taken in since the last event."""
    cycles: Any
    """Cycles since the last event: those in the sums below."""
    squares: Squares
    """Sums of v − g, i and x of the fundamental, where g is the grid as it would be had it not changed."""
    v_re: Any
    v_im: Any
    i_re: Any
    i_im: Any
    x_re: Any
    x_im: Any
    """Sums of the same, for the step of the grid that they would mean."""
    no_step: Any
    """1 if the event was no step of the fundamental: then the step says nothing."""
    limited: Any
    """1 if a cycle since the event was limited for much of its samples: then the step says little."""
    d_old: Any
    d_step: Any
    """Squared distances of the fast track's impedance to the old one and to that of the step."""


class Verdict(NamedTuple):
    """What the probe says of the two explanations in one cycle."""

    changed: Any
    same: Any
    """1 if decided, else 0."""
    step: Fit
    """The impedance of the step, for the prior."""
    d_old: Any
    d_step: Any


def no_doubt() -> Doubt:
    """Nothing collected."""
    return Doubt(
        used=0.0,
        cycles=0.0,
        squares=no_squares(),
        v_re=0.0,
        v_im=0.0,
        i_re=0.0,
        i_im=0.0,
        x_re=0.0,
        x_im=0.0,
        no_step=0.0,
        limited=0.0,
        d_old=0.0,
        d_step=NEVER,
    )


def doubt_begun(no_step: Any) -> Doubt:
    """A doubt at its event."""
    none = no_doubt()
    return Doubt(
        used=0.0,
        cycles=0.0,
        squares=none.squares,
        v_re=0.0,
        v_im=0.0,
        i_re=0.0,
        i_im=0.0,
        x_re=0.0,
        x_im=0.0,
        no_step=no_step,
        limited=0.0,
        d_old=none.d_old,
        d_step=none.d_step,
    )


def doubt_judged(doubt: Doubt, used: Any, d_old: Any, d_step: Any) -> Doubt:
    """The doubt with the distances of this cycle."""
    return doubt._replace(used=used, d_old=d_old, d_step=d_step)


def doubt_with(doubt: Doubt, mean: Window, phasor: GridPhasor, calm: Any) -> Doubt:
    """The sums with the fundamental of one more cycle."""
    y_re = mean.v_re - phasor.now.re
    y_im = mean.v_im - phasor.now.im
    sums = doubt.squares
    return Doubt(
        used=doubt.used,
        cycles=doubt.cycles + 1.0,
        squares=Squares(
            vv=sums.vv + y_re * y_re + y_im * y_im,
            vi=sums.vi + y_re * mean.i_re + y_im * mean.i_im,
            vx=sums.vx + y_re * mean.x_re + y_im * mean.x_im,
            ii=sums.ii + mean.i_re * mean.i_re + mean.i_im * mean.i_im,
            ix=sums.ix + mean.i_re * mean.x_re + mean.i_im * mean.x_im,
            xx=sums.xx + mean.x_re * mean.x_re + mean.x_im * mean.x_im,
        ),
        v_re=doubt.v_re + y_re,
        v_im=doubt.v_im + y_im,
        i_re=doubt.i_re + mean.i_re,
        i_im=doubt.i_im + mean.i_im,
        x_re=doubt.x_re + mean.x_re,
        x_im=doubt.x_im + mean.x_im,
        no_step=doubt.no_step,
        limited=np.maximum(doubt.limited, 1.0 - calm),
        d_old=doubt.d_old,
        d_step=doubt.d_step,
    )


def impedance_of_step(doubt: Doubt, phasor: GridPhasor) -> Fit:
    """The impedance that explains the step if the grid's own phasor has not moved (:eq:`field-step`)."""
    s = doubt.squares
    determinant = s.ii * s.xx - s.ix * s.ix
    n = np.maximum(doubt.cycles, 1.0)
    known = (
        doubt.no_step < 0.5
        and doubt.cycles > 0.5
        and s.ii > LEAST_CURRENT * LEAST_CURRENT * n
        and determinant > 1e-6 * s.ii * s.xx
    )
    divisor = determinant if known else 1.0
    R = (s.xx * s.vi - s.ix * s.vx) / divisor
    X = (s.ii * s.vx - s.ix * s.vi) / divisor
    drift = FREQUENCY_UNSURE * doubt.cycles
    current_sq = np.maximum(s.ii / n, 1e-12)
    variance = (phasor.variance * (n + 4.0) + drift * drift) / (2.0 * current_sq)
    variance = variance + 0.5 * STEP_UNSURE * STEP_UNSURE * (R * R + X * X)
    known_flag = 1.0 if known else 0.0
    return Fit(R=R, X=X, P_RR=variance, P_RX=0.0, P_XX=variance, known=known_flag)


def distance_of(one: Fit, other: Fit, factor: Any) -> Any:
    """Squared distance of two impedances; ``factor`` is by how much the first one's covariance counts more."""
    return distance(
        one.R - other.R,
        one.X - other.X,
        factor * one.P_RR + other.P_RR,
        factor * one.P_RX + other.P_RX,
        factor * one.P_XX + other.P_XX,
    )


def verdict_of(
    doubt: Doubt,
    phasor: GridPhasor,
    old: Fit,
    fast: Fit,
    factor: Any,
    since_flip: Any,
    calm: Any,
    settings: FieldSettings,
) -> Verdict:
    """Weighs both explanations against the fast track (:eq:`field-rivals`).

    ``factor`` is the misfit of the fast track, ``since_flip`` the cycles since the code's last change of sign; ``calm``
    is 0 in a cycle in which the current was limited, where no change is decided.
    """
    step = impedance_of_step(doubt, phasor)
    d_old = distance_of(fast, old, 1.0)
    d_sure = distance_of(fast, old, factor)
    d_step = distance_of(fast, step, 1.0) if step.known > 0.5 else NEVER
    R_g = fast.R - settings.R_2
    X_g = fast.X - settings.X_2
    size = np.sqrt(R_g * R_g + X_g * X_g)
    sigma = np.sqrt(np.maximum(fast.P_RR + fast.P_XX, 0.0))
    possible = X_g > 0.008 and -0.25 * X_g - 0.03 < R_g and fast.known > 0.5 and calm > 0.5
    # One difference that is not sure agrees by chance with a step that was the grid's own.
    sure = (sigma < SURE * size and doubt.limited < 0.5) or doubt.used > 1.5
    by_step = d_step < NEAR_STEP and d_old - d_step > RATIO and sure
    fresh_flip = since_flip > 2.5 and since_flip < 6.5
    by_probe = d_sure > FAR and doubt.used > 5.5 and fresh_flip
    changed = 1.0 if possible and (by_step or by_probe) else 0.0
    refuted = step.known > 0.5 and d_old < NEAR and d_old - d_step < -RATIO and sigma < 0.10 * size and doubt.used > 1.5
    waited = doubt.used > 7.5 and d_old < NEAR and sigma < 0.15 * size
    over = doubt.used > LONGEST
    same = 1.0 if changed < 0.5 and fast.known > 0.5 and (refuted or waited or over) else 0.0
    return Verdict(changed=changed, same=same, step=step, d_old=d_old, d_step=d_step)


def step_of_grid(doubt: Doubt, answer: Fit) -> tuple[Any, Any, Any]:
    """If the impedance has not changed: the mean step of the grid's phasor, and the scatter about it.

    Returns (g_re, g_im, scatter), pu.
    """
    n = np.maximum(doubt.cycles, 1.0)
    g_re = (doubt.v_re - answer.R * doubt.i_re - answer.X * doubt.x_re) / n
    g_im = (doubt.v_im - answer.R * doubt.i_im - answer.X * doubt.x_im) / n
    total = left_over(doubt.squares, answer.R, answer.X) - n * (g_re * g_re + g_im * g_im)
    return g_re, g_im, np.sqrt(np.maximum(total, 0.0) / np.maximum(n - 1.0, 1.0))
