"""The phasor of the grid behind the impedance in force: the flywheel follows it, and its steps are the events."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import DOUBT, TRACK
from vsgdesign.equations.field.tracks import Fit, Window, residual
from vsgdesign.equations.frames import rotate, rotate_back

SLIP_SHARE = 0.15
"""Share with which the mean slip follows the slip of a cycle."""
FLYWHEEL_SHARE = 0.06
"""Share of the slip that the flywheel takes up in a cycle: slow on purpose."""
LARGEST_CORRECTION = 1.5e-3
"""Largest change of the flywheel's turn per cycle in one cycle, rad."""
LARGEST_SLIP = 0.2
"""Largest change of the flywheel's turn per cycle where it is set anew, rad: 1.6 Hz at 50 Hz."""
REFERENCE_SHARE = 0.4
"""Share with which the reference follows the phasor."""
EVENT_SIGMAS = 6.0
LEAST_EVENT = 0.006
"""Least step of the phasor that is an event, pu. A frequency that changes by 2 Hz/s makes 0.005."""
UNSURE = 0.02
"""Error of the impedance that the test for an event allows for, relative."""
VARIANCE_MEMORY = 50.0
LEAST_VARIANCE = 4e-8
"""pu²"""


class Prediction(NamedTuple):
    """What the phasor is expected to be in the present cycle, from what it was some cycles ago."""

    re: Any
    im: Any
    slip: Any
    """Its turn per cycle, rad."""


class GridPhasor(NamedTuple):
    """What is remembered of the grid's phasor, pu."""

    v_re: Any
    v_im: Any
    i_re: Any
    i_im: Any
    x_re: Any
    x_im: Any
    """Fundamental of the last cycle."""
    seen: Any
    """0 before the first cycle; 0.5 if there is no step yet to predict the next one from; then 1."""
    now: Prediction
    """The reference of this cycle. In doubt it only turns on: it is what the grid would be if it had not changed."""
    one: Prediction
    two: Prediction
    three: Prediction
    """References of one, two and three cycles ago, turned on to this cycle."""
    slip: Any
    """Mean turn of the phasor per cycle in the flywheel's frame, rad."""
    step_re: Any
    step_im: Any
    """Its last relative step."""
    variance: Any
    """Variance of what its step cannot be predicted by, pu²."""
    innovation: Any
    """Length of the last such step, pu."""


def no_prediction() -> Prediction:
    """Nothing known."""
    return Prediction(re=0.0, im=0.0, slip=0.0)


def first_grid_phasor() -> GridPhasor:
    """Before the first cycle."""
    none = no_prediction()
    return GridPhasor(
        v_re=0.0,
        v_im=0.0,
        i_re=0.0,
        i_im=0.0,
        x_re=0.0,
        x_im=0.0,
        seen=0.0,
        now=none,
        one=none,
        two=none,
        three=none,
        slip=0.0,
        step_re=0.0,
        step_im=0.0,
        variance=4e-7,
        innovation=0.0,
    )


def turned_on(prediction: Prediction) -> Prediction:
    """The prediction for the next cycle."""
    re, im = rotate(prediction.re, prediction.im, np.cos(prediction.slip), np.sin(prediction.slip))
    return Prediction(re=re, im=im, slip=prediction.slip)


def in_faster_frame(prediction: Prediction, correction: Any) -> Prediction:
    """The same phasor where the flywheel turns faster by ``correction`` (rad) per cycle from the next cycle on."""
    return Prediction(re=prediction.re, im=prediction.im, slip=prediction.slip - correction)


def phasor_moved(before: GridPhasor, mean: Window, answer: Fit, mode: Any) -> tuple[GridPhasor, Any, Any]:
    """Takes in the fundamental of a cycle (:eq:`field-event`).

    ``event`` is 1 where the phasor has made a step that neither the mean slip nor the error of the impedance explains;
    ``correction`` is what the flywheel shall turn faster per cycle, rad. Returns (phasor, event, correction).
    """
    g_re, g_im = residual(mean, answer.R, answer.X)
    di_re = mean.i_re - before.i_re
    di_im = mean.i_im - before.i_im
    dg_re = mean.v_re - before.v_re - answer.R * di_re - answer.X * (mean.x_re - before.x_re)
    dg_im = mean.v_im - before.v_im - answer.R * di_im - answer.X * (mean.x_im - before.x_im)
    before_re = g_re - dg_re
    before_im = g_im - dg_im
    expected_re, expected_im = rotate(before_re, before_im, before.step_re, before.step_im)
    miss_re = dg_re - expected_re
    miss_im = dg_im - expected_im
    miss_sq = miss_re * miss_re + miss_im * miss_im
    unsure = answer.P_RR + answer.P_XX + UNSURE * UNSURE * (answer.R * answer.R + answer.X * answer.X)
    allowed = before.variance + (di_re * di_re + di_im * di_im) * unsure
    least = np.maximum(EVENT_SIGMAS * EVENT_SIGMAS * allowed, LEAST_EVENT * LEAST_EVENT)
    following = answer.known > 0.5 and before.seen > 0.25 and mode != DOUBT
    testing = following and before.seen > 0.75
    event = 1.0 if testing and miss_sq > least else 0.0
    seen = np.minimum(miss_sq, 9.0 * before.variance)
    variance = before.variance + (seen - before.variance) / VARIANCE_MEMORY if testing else before.variance
    over_re, over_im = rotate_back(dg_re, dg_im, before_re, before_im)
    size_sq = np.maximum(before_re * before_re + before_im * before_im, 1e-6)
    stepped = answer.known > 0.5 and before.seen > 0.25
    step_re = over_re / size_sq if stepped else 0.0
    step_im = over_im / size_sq if stepped else 0.0
    calm = following and event < 0.5
    slip = before.slip + SLIP_SHARE * (step_im - before.slip) if calm else before.slip
    limited = np.minimum(np.maximum(FLYWHEEL_SHARE * slip, -LARGEST_CORRECTION), LARGEST_CORRECTION)
    correction = limited if calm else 0.0

    one = turned_on(before.one)
    two = turned_on(before.two)
    three = turned_on(before.three)
    turned = turned_on(before.now)
    share = REFERENCE_SHARE if mode == TRACK else 1.0
    followed = Prediction(
        re=turned.re + share * (g_re - turned.re), im=turned.im + share * (g_im - turned.im), slip=slip
    )
    # At an event the reference is what the phasor was three cycles ago, in which the event cannot have begun.
    now = followed if calm else (three if event > 0.5 else turned)
    fresh = Prediction(re=g_re, im=g_im, slip=slip)
    starts = before.seen < 0.25 or answer.known < 0.5
    now = fresh if starts else now
    last = fresh if starts else turned
    return (
        GridPhasor(
            v_re=mean.v_re,
            v_im=mean.v_im,
            i_re=mean.i_re,
            i_im=mean.i_im,
            x_re=mean.x_re,
            x_im=mean.x_im,
            seen=1.0,
            now=in_faster_frame(now, correction),
            one=in_faster_frame(last, correction),
            two=in_faster_frame(one, correction),
            three=in_faster_frame(two, correction),
            slip=now.slip - correction,
            step_re=step_re,
            step_im=step_im - correction,
            variance=np.maximum(variance, LEAST_VARIANCE),
            innovation=np.sqrt(miss_sq),
        ),
        event,
        correction,
    )


def settled(phasor: GridPhasor, answer: Fit, seen: Any) -> GridPhasor:
    """The phasor with everything forgotten that was before now: at the end of a doubt.

    ``seen`` is 0.5 if the impedance is another one than that with which the last step was found, else 1.
    """
    re = phasor.v_re - answer.R * phasor.i_re - answer.X * phasor.x_re
    im = phasor.v_im - answer.R * phasor.i_im - answer.X * phasor.x_im
    fresh = Prediction(re=re, im=im, slip=phasor.slip)
    return phasor._replace(seen=seen, now=fresh, one=fresh, two=fresh, three=fresh)


def without_last(phasor: GridPhasor) -> GridPhasor:
    """The phasor after a cycle that cannot be used: the next one is compared with nothing."""
    return phasor._replace(
        seen=0.0,
        now=turned_on(phasor.now),
        one=turned_on(phasor.one),
        two=turned_on(phasor.two),
        three=turned_on(phasor.three),
    )


def resynchronised(phasor: GridPhasor) -> tuple[GridPhasor, Any]:
    """The phasor where the flywheel takes up the last slip at once: only where the windows begin anew.

    ``correction`` is what it shall turn faster per cycle, rad. Returns (phasor, correction).
    """
    correction = np.minimum(np.maximum(phasor.step_im, -LARGEST_SLIP), LARGEST_SLIP)
    moved = phasor._replace(
        now=in_faster_frame(phasor.now, correction),
        one=in_faster_frame(phasor.one, correction),
        two=in_faster_frame(phasor.two, correction),
        three=in_faster_frame(phasor.three, correction),
        slip=phasor.slip - correction,
        step_im=phasor.step_im - correction,
    )
    return moved, correction
