"""What the field estimator does once per cycle of its flywheel, and what a cycle means for the answer, by mode: learn,
track or doubt."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.beside import beside_with, own_lines, with_again, with_beside
from vsgdesign.equations.field.data import DOUBT, LEARN, TRACK, FieldAnswer, FieldSettings, LineSums, LockIn
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
from vsgdesign.equations.field.lock_in import turn_less_one
from vsgdesign.equations.field.measuring import AGAIN, FAST_MEMORY, Happening, Measured, happening_of, measured
from vsgdesign.equations.field.noise import Noise, misfit, noise_of_probe
from vsgdesign.equations.field.sign_code import Response, code_moved, foreign_with, line_amplitude, response_of, towards
from vsgdesign.equations.field.state import FastTrack, FieldTrack, first_track, grid_sigma, no_fast
from vsgdesign.equations.field.tracks import (
    CALIBRATION,
    SIGN_1,
    SIGN_2,
    SIZE_1,
    SIZE_2,
    Fit,
    LineTrack,
    Track,
    current_at_the_end,
    fit_of,
    forgotten,
    lines_at,
    merged,
    no_fit,
    shifted,
    third_difference,
    wider_by,
    windows_of_cycle,
    with_gain,
)
from vsgdesign.equations.frames import rotate, rotate_back
from vsgdesign.equations.integration import TURN

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


LARGE_UNTIL = 0.025
LARGE_CYCLES = 15.0
"""Relative standard deviation, and cycles of the slow track, after which the probe is no longer large."""
LARGER_BY = 1.2
"""By how much the probe may be larger because the grid is only a part of the impedance that it measures."""
LIMITED = 0.3
"""Share of a cycle's samples with a limited current above which no change is decided."""


def carried(lock: LockIn, cosine: Any, sine: Any) -> LineSums:
    """The part of the last sample that belongs to the next cycle, turned back by an angle."""
    v_re, v_im = rotate_back(lock.v_re, lock.v_im, cosine, sine)
    i_re, i_im = rotate_back(lock.i_re, lock.i_im, cosine, sine)
    u_re, u_im = rotate_back(lock.u_re, lock.u_im, cosine, sine)
    w = lock.left
    return LineSums(v_re=w * v_re, v_im=w * v_im, i_re=w * i_re, i_im=w * i_im, u_re=w * u_re, u_im=w * u_im)


def next_cycle(lock: LockIn, omega: Any, a_1: Any, a_2: Any, settings: FieldSettings) -> LockIn:
    """The lock-in at the beginning of a cycle, at another speed and with other amplitudes of the probe."""
    # The last sample was one step before the angle that the phasor has now.
    last_re, last_im = rotate_back(lock.half_re, lock.half_im, 1.0 + lock.step_less_one, lock.step_im)
    whole_re, whole_im = rotate(last_re, last_im, last_re, last_im)
    first_re, first_im, second_re, second_im = lines_at(last_re, last_im, whole_re, whole_im, settings.line)
    # The recursion of the phasor loses digits; its angle is known.
    sign = 1.0 if lock.half_re > 0.0 else -1.0
    end_re, end_im = current_at_the_end(lock)
    step = 0.5 * omega * settings.T_s
    return lock._replace(
        omega=omega,
        half_re=sign * np.cos(0.5 * lock.phi),
        half_im=sign * np.sin(0.5 * lock.phi),
        step_less_one=turn_less_one(step),
        step_im=np.sin(step),
        mean=carried(lock, 1.0, 0.0),
        line_1=carried(lock, first_re, first_im),
        line_2=carried(lock, second_re, second_im),
        weight=lock.left,
        left=0.0,
        i_start_re=end_re,
        i_start_im=end_im,
        samples=0.0,
        limited=0.0,
        spoilt=0.0,
        a_1=a_1,
        a_2=a_2,
        closed=0.0,
    )


def response_with(
    before: Response, slow: LineTrack, fast: LineTrack, by_fast: Any, settings: FieldSettings
) -> Response:
    """The response of a line from the fast track in doubt, else from the slow one."""
    return response_of(fast, before, settings) if by_fast > 0.5 else response_of(slow, before, settings)


def whole_over_grid(fit: Fit, settings: FieldSettings) -> Any:
    """Square of the measured impedance over that of the grid alone, up to LARGER_BY squared (:eq:`field-amplitude`)."""
    R, X = fit.R - settings.R_2, fit.X - settings.X_2
    ratio = (fit.R * fit.R + fit.X * fit.X) / np.maximum(R * R + X * X, 1e-12)
    return ratio if ratio < LARGER_BY * LARGER_BY else LARGER_BY * LARGER_BY  # of a memory that is no number, too


def size_of_probe(
    lock: LockIn, decision: Decision, noise: Noise, suspect: Any, one: Response, two: Response, settings: FieldSettings
) -> tuple[Any, Any]:
    """The amplitudes of both lines in the next cycle. Returns (a_1, a_2)."""
    # After a change the probe stays large until the new impedance is known.
    known = grid_sigma(decision.answer, settings) < LARGE_UNTIL or decision.slow.count > LARGE_CYCLES
    rest = 1.0 if decision.mode == TRACK and suspect < 0.5 and known else 0.0
    both = noise_of_probe(noise) * whole_over_grid(decision.answer, settings)
    a_1 = line_amplitude(both, rest, SIZE_1, lock.a_1, one, settings)
    a_2 = line_amplitude(both, rest, SIZE_2, lock.a_2, two, settings)
    return a_1, a_2


def sane(track: FieldTrack) -> bool:
    """Whether nothing has overflowed: the estimator then begins anew rather than never to answer again."""
    fit, noise, phasor = track.answer, track.noise, track.phasor
    size = fit.R * fit.R + fit.X * fit.X + noise.line_1.S + noise.line_2.S + phasor.variance
    spread = fit.P_RR + fit.P_XX
    return size < 1e6 and spread < 1e12 and noise.line_1.S > 0.0 and noise.line_2.S > 0.0


def conclude(lock: LockIn, track: FieldTrack, settings: FieldSettings) -> tuple[LockIn, FieldTrack, FieldAnswer]:
    """Concludes a closed cycle and begins the next one. Returns (lock, track, answer)."""
    mean, now_1, now_2 = windows_of_cycle(lock, settings)
    F_1 = third_difference(now_1, track.history_1)
    F_2 = third_difference(now_2, track.history_2)
    spoilt = 1.0 if lock.spoilt > 0.5 else 0.0
    calm = 1.0 if lock.limited <= LIMITED * lock.samples else 0.0
    happened = happening_of(track, mean, F_1, F_2, spoilt, calm)
    found = measured(track, happened, F_1, F_2, settings)
    decision = decided(track, happened, found, calm, settings)

    omega = lock.omega + happened.correction * settings.omega_n / TURN
    omega = np.minimum(np.maximum(omega, 0.95 * settings.omega_n), 1.05 * settings.omega_n)
    code = code_moved(track.code, decision.mode, decision.doubt.used)
    response_1, response_2 = track.response_1, track.response_2
    slow, fast = decision.slow, decision.fast.track
    by_fast = 1.0 if decision.mode == DOUBT else 0.0
    if happened.use > 0.5 and (by_fast < 0.5 or fast.count > 1.5):
        response_1 = response_with(response_1, slow.line_1, fast.line_1, by_fast, settings)
        response_2 = response_with(response_2, slow.line_2, fast.line_2, by_fast, settings)
    foreign = track.foreign
    if happened.filled > 3.5:
        lines = own_lines(track.slow, track.answer, track.beside.refuted)
        foreign = foreign_with(foreign, F_1, F_2, lines, found.noise.line_1.cycle, found.noise.line_2.cycle)
    beside = with_again(track.beside, happened.again)
    if happened.use > 0.5 and decision.mode != DOUBT and found.probed > 0.5 and settings.neighbours < 0.5:
        fit = fit_of(slow, found.noise.line_1.S, found.noise.line_2.S)
        beside = beside_with(beside, slow, fit, found.noise, settings)
    a_1, a_2 = size_of_probe(lock, decision, found.noise, found.suspect, response_1, response_2, settings)
    following = FieldTrack(
        history_1=shifted(now_1, track.history_1),
        history_2=shifted(now_2, track.history_2),
        filled=happened.filled,
        skip=decision.skip,
        slow=decision.slow,
        fast=decision.fast,
        noise=found.noise,
        answer=decision.answer,
        prior=decision.prior,
        mode=decision.mode,
        phasor=decision.phasor,
        doubt=decision.doubt,
        code=code,
        response_1=response_1,
        response_2=response_2,
        misfit=happened.misfit,
        loud=happened.loud,
        apart=decision.apart,
        suspect=found.suspect,
        foreign=foreign,
        beside=beside,
    )
    if not sane(following):
        following = first_track(settings)
        code = following.code
    told = answer_of(following, decision.changed, decision.event, lock, np.maximum(a_1, a_2), settings)
    at_rest = 1.0 if decision.mode == TRACK else 0.0
    sent_1 = towards(lock.a_1, SIGN_1 * code.sign, a_1, at_rest)
    sent_2 = towards(lock.a_2, SIGN_2 * code.sign, a_2, at_rest)
    return next_cycle(lock, omega, sent_1, sent_2, settings), following, told


def answer_of(
    track: FieldTrack, changed: Any, event: Any, lock: LockIn, amplitude: Any, settings: FieldSettings
) -> FieldAnswer:
    """The answer in SI units at the PCC."""
    fit = with_beside(wider_by(track.answer, CALIBRATION), track.beside)
    sigma = grid_sigma(fit, settings)
    odd = track.beside.passive < 0.5 or track.beside.again > AGAIN - 0.5
    passive = 0.0 if odd and settings.neighbours < 0.5 else 1.0
    told = fit.known > 0.5 and track.mode != DOUBT and sigma < settings.sigma_valid
    valid = 1.0 if told and track.foreign.heard < 0.5 and passive > 0.5 else 0.0
    spoilt = 1.0 if lock.spoilt > 0.5 else 0.0
    doubt = 1.0 if track.mode == DOUBT else 0.0
    ohm = settings.Z_base
    henry = settings.Z_base / settings.omega_n
    return FieldAnswer(
        R_g=(fit.R - settings.R_2) * ohm,
        L_g=(fit.X - settings.X_2) * henry,
        var_R=fit.P_RR * ohm * ohm,
        cov_RL=fit.P_RX * ohm * henry,
        var_L=fit.P_XX * henry * henry,
        sigma=sigma,
        valid=valid,
        changed=changed,
        event=event,
        doubt=doubt,
        mode=track.mode,
        limited=lock.limited / np.maximum(lock.samples, 1.0),
        spoilt=spoilt,
        amplitude=amplitude,
        foreign=track.foreign.heard,
        passive=passive,
    )
