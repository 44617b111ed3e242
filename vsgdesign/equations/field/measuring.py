"""Both tracks and the noise after one more cycle."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.beside import own_lines
from vsgdesign.equations.field.data import DOUBT, TRACK, FieldSettings
from vsgdesign.equations.field.doubt import NEAR, distance_of
from vsgdesign.equations.field.happening import Happening
from vsgdesign.equations.field.noise import Noise, noise_with, residuals_with
from vsgdesign.equations.field.state import FastTrack, FieldTrack, grid_sigma
from vsgdesign.equations.field.tracks import Fit, Track, fit_of, taken, with_gain
from vsgdesign.equations.field.windows import Window, residual

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
