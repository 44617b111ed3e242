"""Both tracks and the noise after one more cycle, and what has happened in it: an event, a second one within a doubt,
or nothing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.beside import own_lines
from vsgdesign.equations.field.data import DOUBT, TRACK, FieldSettings
from vsgdesign.equations.field.doubt import NEAR, Doubt, distance_of, doubt_begun, doubt_with
from vsgdesign.equations.field.grid_phasor import GridPhasor, phasor_moved, resynchronised, without_last
from vsgdesign.equations.field.noise import DIFFERENCE_GAIN, Noise, noise_with, residuals_with
from vsgdesign.equations.field.state import FastTrack, FieldTrack, grid_sigma, no_fast
from vsgdesign.equations.field.tracks import Fit, Track, Window, fit_of, residual, taken, with_gain

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


SLOW_MEMORY = 100.0
"""Cycles of the track that the answer follows."""
YOUNG = 15.0
YOUNG_SHARE = 2.0
"""A young track remembers so many times its cycles, but YOUNG at least: the first ones hold the end of a transient."""
LONGER_FROM = 0.02
"""Relative standard deviation from which on it remembers more cycles, as many as bring it back there."""
LONGER = 3.0
"""Up to so many times more."""
FAST_MEMORY = 6.0
"""Cycles of the track that tells whether something has changed."""
NO_PROBE = 1e-11
"""Square of the probe below which none was sent: the tracks then neither learn nor forget, and the answer ages."""
LONGEST_SUSPICION = 15.0
"""Cycles for which the noise may be taken from the fast track because both tracks differ."""


class Measured(NamedTuple):
    """Tracks, fits and noise of a cycle."""

    slow: Track
    slow_fit: Fit
    fast: FastTrack
    noise: Noise
    suspect: Any
    gain: Any
    """Variance of the impedance from the gains of the sensors, pu²."""
    both: Any
    """1 if both fits are known, else 0."""
    probed: Any
    """1 if a probe was sent, else 0."""


def memory_of(track: FieldTrack, settings: FieldSettings) -> Any:
    """The cycles that the slow track remembers (:eq:`field-memory`)."""
    sure = grid_sigma(track.answer, settings) / LONGER_FROM
    memory = SLOW_MEMORY * np.minimum(np.maximum(sure * sure, 1.0), LONGER)
    return np.minimum(memory, np.maximum(YOUNG_SHARE * track.slow.count, YOUNG))


def measured(track: FieldTrack, happened: Happening, F_1: Window, F_2: Window, settings: FieldSettings) -> Measured:
    """Takes the third difference into the tracks, and what they leave of it into the noise."""
    sent = F_1.u_re * F_1.u_re + F_1.u_im * F_1.u_im + F_2.u_re * F_2.u_re + F_2.u_im * F_2.u_im
    use, mode, weight = happened.use > 0.5 and sent > NO_PROBE, happened.mode, happened.weight
    slow, fast, residuals = track.slow, happened.fast.track, happened.fast.residuals
    if use:
        fast = taken(fast, F_1, F_2, FAST_MEMORY, weight)
        residuals = residuals_with(residuals, F_1, F_2, FAST_MEMORY)
        if mode != DOUBT:
            slow = taken(slow, F_1, F_2, memory_of(track, settings), weight)
    noise = track.noise
    slow_fit = fit_of(slow, noise.line_1.S, noise.line_2.S)
    fast_fit = fit_of(fast, noise.line_1.S, noise.line_2.S) if use else happened.fast.fit
    size_sq = track.answer.R * track.answer.R + track.answer.X * track.answer.X
    gain = settings.gain_class * settings.gain_class * size_sq
    both = use and slow_fit.known > 0.5 and fast_fit.known > 0.5
    wide_fit = with_gain(slow_fit, gain + track.beside.misfit)
    differ = both and mode == TRACK and distance_of(fast_fit, wide_fit, 1.0) > NEAR
    suspect = track.suspect + 1.0 if differ else (track.suspect if mode == TRACK and not use else 0.0)

    # The noise is what the better of both leaves: a real change must not hide itself in it.
    by_fast = mode == DOUBT or (differ and suspect < LONGEST_SUSPICION + 0.5)
    source = fast_fit if by_fast else slow_fit
    inside = (fast.count if mode == DOUBT else 5.0) if by_fast else slow.count
    share = np.maximum(1.0 - 0.7 / np.minimum(np.maximum(inside, 2.0), SLOW_MEMORY), 0.4)
    by_slow_lines = own_lines(slow, slow_fit, track.beside.refuted)
    lines = own_lines(fast, fast_fit, track.beside.refuted) if by_fast else by_slow_lines
    e_1_re, e_1_im = residual(F_1, lines.R_1, lines.X_1)
    e_2_re, e_2_im = residual(F_2, lines.R_2, lines.X_2)
    if use and source.known > 0.5 and inside > 2.5:
        noise = noise_with(noise, F_1, F_2, e_1_re, e_1_im, e_2_re, e_2_im, share, weight)
    if use:
        slow_fit = fit_of(slow, noise.line_1.S, noise.line_2.S)
        fast_fit = fit_of(fast, noise.line_1.S, noise.line_2.S)
    known = 1.0 if both else 0.0
    probed = 1.0 if sent > NO_PROBE else 0.0
    return Measured(
        slow=slow,
        slow_fit=slow_fit,
        fast=FastTrack(track=fast, fit=fast_fit, residuals=residuals),
        noise=noise,
        suspect=suspect,
        gain=gain,
        both=known,
        probed=probed,
    )
