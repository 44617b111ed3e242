"""What has happened in a cycle: an event, a second one within a doubt, or nothing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.beside import own_lines
from vsgdesign.equations.field.data import DOUBT, TRACK
from vsgdesign.equations.field.doubt import Doubt, doubt_begun, doubt_with
from vsgdesign.equations.field.grid_phasor import GridPhasor, phasor_moved, resynchronised, without_last
from vsgdesign.equations.field.noise import DIFFERENCE_GAIN
from vsgdesign.equations.field.state import FastTrack, FieldTrack, no_fast
from vsgdesign.equations.field.tracks import with_gain
from vsgdesign.equations.field.windows import Window, residual

LOUD = 25.0
"""Square of a residual over its variance that contradicts an impedance."""
UNEQUAL_GAINS = 0.006
"""Error that unequal gains of the sensors make in a transient, relative to its voltage."""
LOUD_WEIGHT = 16.0
"""Square of a residual over its variance from which on a cycle counts less."""
AGAIN = 2.0
"""How often a doubt begins anew before each line is compared with itself: R and X may not explain both."""
SKIPPED = 4.0
"""Cycles that are not used after a step of the grid's phasor: each difference spans four."""


class Surprise(NamedTuple):
    """What the residual of one cycle says before the cycle is used."""

    misfit: Any
    loud: Any
    event: Any
    """1 if the answer in force has been contradicted by two cycles in a row."""
    again: Any
    """1 if something has happened again within a doubt."""


def gain_residual(window: Window) -> Any:
    """Square of the residual that unequal gains leave of a transient."""
    return UNEQUAL_GAINS * UNEQUAL_GAINS * (window.v_re * window.v_re + window.v_im * window.v_im)


def surprise_of(track: FieldTrack, F_1: Window, F_2: Window) -> Surprise:
    """Compares the third difference with the answer in force, and in doubt with the fast track."""
    S_1 = DIFFERENCE_GAIN * track.noise.line_1.S + gain_residual(F_1)
    S_2 = DIFFERENCE_GAIN * track.noise.line_2.S + gain_residual(F_2)
    lines = own_lines(track.slow, track.answer, track.beside.refuted)
    e_1_re, e_1_im = residual(F_1, lines.R_1, lines.X_1)
    e_2_re, e_2_im = residual(F_2, lines.R_2, lines.X_2)
    of_answer = 0.5 * ((e_1_re * e_1_re + e_1_im * e_1_im) / S_1 + (e_2_re * e_2_re + e_2_im * e_2_im) / S_2)
    loud = track.loud + 1.0 if of_answer > LOUD and track.answer.known > 0.5 else 0.0
    fit = track.fast.fit
    apart = track.beside.refuted > 0.5 or track.beside.again > AGAIN - 0.5
    own = own_lines(track.fast.track, fit, 1.0 if apart else 0.0)
    f_1_re, f_1_im = residual(F_1, own.R_1, own.X_1)
    f_2_re, f_2_im = residual(F_2, own.R_2, own.X_2)
    # A fit of few cycles is itself not sure.
    i_1, x_1 = F_1.i_re * F_1.i_re + F_1.i_im * F_1.i_im, F_1.x_re * F_1.x_re + F_1.x_im * F_1.x_im
    i_2, x_2 = F_2.i_re * F_2.i_re + F_2.i_im * F_2.i_im, F_2.x_re * F_2.x_re + F_2.x_im * F_2.x_im
    of_fast = 0.5 * (
        (f_1_re * f_1_re + f_1_im * f_1_im) / (S_1 + i_1 * fit.P_RR + x_1 * fit.P_XX)
        + (f_2_re * f_2_re + f_2_im * f_2_im) / (S_2 + i_2 * fit.P_RR + x_2 * fit.P_XX)
    )
    event = 1.0 if track.mode == TRACK and loud > 1.5 else 0.0
    again = 1.0 if track.mode == DOUBT and track.fast.track.count > 1.5 and fit.known > 0.5 and of_fast > LOUD else 0.0
    return Surprise(misfit=of_answer, loud=loud, event=event, again=again)


class Step(NamedTuple):
    """What the fundamental says of a cycle."""

    mode: Any
    doubt: Doubt
    phasor: GridPhasor
    fast: FastTrack
    skip: Any
    event: Any
    correction: Any
    """What the flywheel shall turn faster per cycle, rad."""


def step_of(track: FieldTrack, mean: Window, spoilt: Any, calm: Any) -> Step:
    """Follows the grid's phasor: its steps begin a doubt. ``spoilt`` is 1 for a cycle that cannot be used."""
    answer = with_gain(track.answer, track.beside.misfit)
    followed, stepped, correction = phasor_moved(track.phasor, mean, answer, track.mode)
    bad = spoilt > 0.5
    event = 1.0 if stepped > 0.5 and not bad else 0.0
    phasor = without_last(track.phasor) if bad else followed
    turned = 0.0 if bad else correction
    mode = DOUBT if event > 0.5 else track.mode
    doubt = track.doubt
    if event > 0.5:
        doubt = doubt_begun(0.0)
    elif mode == DOUBT and not bad:
        doubt = doubt_with(doubt, mean, phasor, calm)
    skip = SKIPPED if event > 0.5 else track.skip
    fast = no_fast() if event > 0.5 else track.fast
    return Step(mode=mode, doubt=doubt, phasor=phasor, fast=fast, skip=skip, event=event, correction=turned)


class Happening(NamedTuple):
    """What fundamental and lines say of a cycle together."""

    mode: Any
    doubt: Doubt
    phasor: GridPhasor
    fast: FastTrack
    filled: Any
    skip: Any
    event: Any
    correction: Any
    use: Any
    """1 if the third difference is to be used, else 0."""
    weight: Any
    """How much it counts."""
    misfit: Any
    loud: Any
    again: Any
    """How often a doubt has begun anew."""


def happening_of(track: FieldTrack, mean: Window, F_1: Window, F_2: Window, spoilt: Any, calm: Any) -> Happening:
    """Follows the grid's phasor, and compares the third difference with what is believed.

    ``spoilt`` is 1 for a cycle that cannot be used, ``calm`` 0 for one that was limited for much of its samples.
    """
    step = step_of(track, mean, spoilt, calm)
    filled = -1.0 if spoilt > 0.5 else np.minimum(track.filled + 1.0, 4.0)
    full = filled > 3.5
    usable = full and step.skip < 0.5
    skip = step.skip - 1.0 if full and step.skip > 0.5 else step.skip
    surprise = surprise_of(track, F_1, F_2)
    contradicted = usable and surprise.event > 0.5
    again = usable and surprise.again > 0.5
    mode = DOUBT if contradicted else step.mode
    skip = SKIPPED - 1.0 if contradicted else skip
    phasor, correction = step.phasor, step.correction
    if again:
        # The grid may turn at another speed by now, which alone would contradict any impedance.
        phasor, correction = resynchronised(step.phasor)
        filled = 0.0
        skip = 1.0
    doubt, fast = step.doubt, step.fast
    if contradicted or again:
        doubt = doubt_begun(doubt.no_step)
        fast = no_fast()
    loud = surprise.loud if usable else track.loud
    loud = 0.0 if mode == DOUBT else loud
    event = 1.0 if step.event > 0.5 or contradicted or again else 0.0
    begun = track.beside.again + 1.0 if again else track.beside.again
    use = 1.0 if usable and not contradicted and not again else 0.0
    weight = LOUD_WEIGHT / np.maximum(surprise.misfit, LOUD_WEIGHT) if mode == TRACK else 1.0
    return Happening(
        mode=mode,
        doubt=doubt,
        phasor=phasor,
        fast=fast,
        filled=filled,
        skip=skip,
        event=event,
        correction=correction,
        use=use,
        weight=weight,
        misfit=surprise.misfit,
        loud=loud,
        again=begun if mode == DOUBT else 0.0,
    )
