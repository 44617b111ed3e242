"""What a cycle means for the answer, by mode: learn, track or doubt."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import DOUBT, LEARN, TRACK, FieldSettings
from vsgdesign.equations.field.doubt import (
    FAR,
    NEAR,
    NEAR_STEP,
    Doubt,
    distance_of,
    doubt_begun,
    doubt_judged,
    verdict_of,
)
from vsgdesign.equations.field.grid_phasor import GridPhasor, settled
from vsgdesign.equations.field.measuring import FAST_MEMORY, Happening, Measured
from vsgdesign.equations.field.noise import misfit
from vsgdesign.equations.field.state import FastTrack, FieldTrack, grid_sigma, no_fast
from vsgdesign.equations.field.tracks import Fit, Track, fit_of, forgotten, merged, no_fit, wider_by, with_gain

FRESH_FROM = 2.5
FRESH_UNTIL = FAST_MEMORY + 1.5
"""Cycles since the sign began to change between which the fast track has seen both signs."""
AGEING = 1.01
"""Factor of the covariance in a cycle without a probe: 1.4 % become 15 % in about ten seconds."""
SOFT = 6.0
"""Squared distance of both tracks from which on the slow one forgets faster."""


def with_prior(fit: Fit, prior: Fit, count: Any, gain: Any) -> tuple[Fit, Fit]:
    """A fit together with what the step has told, and the prior that is left. Returns (fused, left)."""
    near = prior.known > 0.5 and count < 12.5 and distance_of(fit, prior, 1.0) < NEAR_STEP
    wider = 1.0 + count * count / 16.0
    det_1 = np.maximum(fit.P_RR * fit.P_XX - fit.P_RX * fit.P_RX, 1e-30)
    J_RR, J_RX, J_XX = fit.P_XX / det_1, -fit.P_RX / det_1, fit.P_RR / det_1
    J_0 = 1.0 / (wider * prior.P_RR)
    A, B, D = J_RR + J_0, J_RX, J_XX + J_0
    b_R = J_RR * fit.R + J_RX * fit.X + J_0 * prior.R
    b_X = J_RX * fit.R + J_XX * fit.X + J_0 * prior.X
    det_2 = np.maximum(A * D - B * B, 1e-30)
    fused = Fit(
        R=(D * b_R - B * b_X) / det_2,
        X=(A * b_X - B * b_R) / det_2,
        P_RR=D / det_2 + gain,
        P_RX=-B / det_2,
        P_XX=A / det_2 + gain,
        known=1.0,
    )
    alone = Fit(R=fit.R, X=fit.X, P_RR=fit.P_RR + gain, P_RX=fit.P_RX, P_XX=fit.P_XX + gain, known=1.0)
    known = 1.0 if near else 0.0
    left = Fit(R=prior.R, X=prior.X, P_RR=prior.P_RR, P_RX=prior.P_RX, P_XX=prior.P_XX, known=known)
    chosen = fused if near else alone
    return chosen, left


class Decision(NamedTuple):
    """What is believed after a cycle."""

    mode: Any
    answer: Fit
    prior: Fit
    slow: Track
    fast: FastTrack
    phasor: GridPhasor
    doubt: Doubt
    skip: Any
    apart: Any
    changed: Any
    """1 if it was decided that the impedance has changed."""
    event: Any
    """1 if a doubt has begun, or begun anew, in this cycle."""


def as_before(track: FieldTrack, happened: Happening, found: Measured) -> Decision:
    """Nothing decided: the answer is held. Without a probe it ages."""
    aged = wider_by(track.answer, AGEING) if happened.use > 0.5 and found.probed < 0.5 else track.answer
    return Decision(
        mode=happened.mode,
        answer=aged,
        prior=track.prior,
        slow=found.slow,
        fast=found.fast,
        phasor=happened.phasor,
        doubt=happened.doubt,
        skip=happened.skip,
        apart=track.apart,
        changed=0.0,
        event=happened.event,
    )


def learnt(track: FieldTrack, happened: Happening, found: Measured, settings: FieldSettings) -> Decision:
    """The answer while the first one is being formed."""
    answer, prior = with_prior(found.slow_fit, track.prior, found.slow.count, found.gain)
    enough = found.slow.count > 3.5 and grid_sigma(answer, settings) < settings.sigma_valid
    mode = TRACK if enough else LEARN
    return Decision(
        mode=mode,
        answer=answer,
        prior=prior,
        slow=found.slow,
        fast=found.fast,
        phasor=happened.phasor,
        doubt=happened.doubt,
        skip=happened.skip,
        apart=track.apart,
        changed=0.0,
        event=happened.event,
    )


def tracked(track: FieldTrack, happened: Happening, found: Measured) -> Decision:
    """The answer at rest. A doubt begins where both tracks contradict each other."""
    fast_fit, noise = found.fast.fit, found.noise
    slow_fit = with_gain(found.slow_fit, found.gain + track.beside.misfit)
    factor = misfit(found.fast.residuals, fast_fit.R, fast_fit.X, noise.line_1.S, noise.line_2.S)
    fresh_flip = track.code.since_flip > FRESH_FROM and track.code.since_flip < FRESH_UNTIL
    apart = track.apart + 1.0 if fresh_flip and distance_of(fast_fit, slow_fit, factor) > FAR else 0.0
    parted = apart > 1.5
    soft_sq = distance_of(fast_fit, slow_fit, 1.0)
    soft = soft_sq > SOFT
    fitted, left = with_prior(found.slow_fit, track.prior, found.slow.count, found.gain)
    widened = wider_by(fitted, 1.5 * soft_sq / SOFT) if soft else fitted
    answer = track.answer if parted else widened
    prior = track.prior if parted else left
    slow = forgotten(found.slow, 0.85) if soft and not parted else found.slow
    mode = DOUBT if parted else TRACK
    fast = no_fast() if parted else found.fast
    doubt = doubt_begun(1.0) if parted else happened.doubt
    skip = 2.0 if parted else happened.skip
    event = 1.0 if parted else happened.event
    apart = 0.0 if parted else apart
    return Decision(
        mode=mode,
        answer=answer,
        prior=prior,
        slow=slow,
        fast=fast,
        phasor=happened.phasor,
        doubt=doubt,
        skip=skip,
        apart=apart,
        changed=0.0,
        event=event,
    )


def doubted(track: FieldTrack, happened: Happening, found: Measured, calm: Any, settings: FieldSettings) -> Decision:
    """The answer in doubt: held until the probe has told whether the impedance has changed."""
    fast_fit, noise = found.fast.fit, found.noise
    factor = misfit(found.fast.residuals, fast_fit.R, fast_fit.X, noise.line_1.S, noise.line_2.S)
    used = happened.doubt.used + 1.0
    doubt = doubt_judged(happened.doubt, used, 0.0, 0.0)
    old = with_gain(track.answer, track.beside.misfit)
    verdict = verdict_of(doubt, happened.phasor, old, fast_fit, factor, track.code.since_flip, calm, settings)
    doubt = doubt_judged(doubt, used, verdict.d_old, verdict.d_step)
    changed, same = verdict.changed > 0.5, verdict.same > 0.5
    mode = LEARN if changed else (TRACK if same else DOUBT)
    slow = found.fast.track if changed else (merged(found.slow, found.fast.track) if same else found.slow)
    step = verdict.step
    by_step = 1.0 if verdict.d_step < NEAR and doubt.limited < 0.5 else 0.0
    told = Fit(R=step.R, X=step.X, P_RR=step.P_RR, P_RX=0.0, P_XX=step.P_XX, known=by_step)
    prior = told if changed else no_fit()
    fit = fast_fit if changed else fit_of(slow, noise.line_1.S, noise.line_2.S)
    fitted, left = with_prior(fit, prior, slow.count, found.gain)
    ended = changed or same
    answer = fitted if ended else track.answer
    prior = left if ended else track.prior
    seen = 0.5 if changed else 1.0
    phasor = settled(happened.phasor, answer, seen) if ended else happened.phasor
    return Decision(
        mode=mode,
        answer=answer,
        prior=prior,
        slow=slow,
        fast=found.fast,
        phasor=phasor,
        doubt=doubt,
        skip=happened.skip,
        apart=track.apart,
        changed=verdict.changed,
        event=happened.event,
    )


def decided(track: FieldTrack, happened: Happening, found: Measured, calm: Any, settings: FieldSettings) -> Decision:
    """The decision of the mode. ``calm`` is 0 where the current was limited for more than 30 % of the cycle."""
    decision = as_before(track, happened, found)
    if happened.mode == DOUBT and happened.use > 0.5 and found.probed > 0.5:
        decision = doubted(track, happened, found, calm, settings)
    elif happened.mode == LEARN and found.both > 0.5:
        decision = learnt(track, happened, found, settings)
    elif happened.mode == TRACK and found.both > 0.5:
        decision = tracked(track, happened, found)
    return decision
