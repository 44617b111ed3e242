"""What the field estimator does once per cycle of its flywheel."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import DOUBT, LEARN, TRACK, FieldAnswer, FieldSettings, LineSums, LockIn
from vsgdesign.equations.field.doubt import (
    FAR,
    NEAR,
    NEAR_STEP,
    Doubt,
    distance_of,
    doubt_with,
    no_doubt,
    verdict_of,
)
from vsgdesign.equations.field.grid_phasor import (
    GridPhasor,
    first_grid_phasor,
    phasor_moved,
    resynchronised,
    settled,
    without_last,
)
from vsgdesign.equations.field.lock_in import turn_less_one
from vsgdesign.equations.field.noise import DIFFERENCE_GAIN, Noise, first_noise, noise_of_probe, noise_with
from vsgdesign.equations.field.residuals import Residuals, misfit, no_residuals, residuals_with
from vsgdesign.equations.field.sign_code import (
    Response,
    SignCode,
    code_moved,
    first_code,
    line_amplitude,
    no_response,
    response_of,
)
from vsgdesign.equations.field.tracks import Fit, Track, fit_of, forgotten, merged, no_track, taken, with_gain
from vsgdesign.equations.field.windows import (
    History,
    Window,
    current_at_the_end,
    no_history,
    residual,
    shifted,
    third_difference,
    windows_of_cycle,
)
from vsgdesign.equations.integration import TURN
from vsgdesign.frames import rotate, rotate_back

SLOW_MEMORY = 100.0
"""Cycles of the track that the answer follows."""
LARGE_UNTIL = 0.025
LARGE_CYCLES = 15.0
"""Relative standard deviation, and cycles of the slow track, after which the probe is no longer large."""
YOUNG = 15.0
YOUNG_SHARE = 2.0
"""A young track remembers so many times its cycles, but YOUNG at least: the first ones hold the end of a transient."""
LONGER_FROM = 0.02
"""Relative standard deviation from which on it remembers more cycles, as many as bring it back there."""
LONGER = 3.0
"""Up to so many times more."""
FAST_MEMORY = 6.0
"""Cycles of the track that tells whether something has changed."""
SOFT = 6.0
"""Squared distance of both tracks from which on the slow one forgets faster."""
LOUD_WEIGHT = 16.0
"""Square of a residual over its variance from which on a cycle counts less."""
CALIBRATION = 0.75
"""Factor of the covariance, from the ratio of the squared errors to it over many grids."""


class FieldTrack(NamedTuple):
    """What changes once per cycle."""

    history_1: History
    history_2: History
    filled: Any
    """Cycles in the histories, up to 4. The first cycle is thrown away, because the low-passes still settle in it."""
    skip: Any
    """Cycles after an event that are not used: each difference spans four cycles."""
    slow: Track
    fast: Track
    fast_fit: Fit
    residuals: Residuals
    """Of the fast track's memory."""
    noise: Noise
    answer: Fit
    """The impedance in force from the measured voltage to the grid's source, pu, its covariance before CALIBRATION."""
    prior: Fit
    """The impedance that the step of a change has told, for some cycles after it; ``known`` is 0 without."""
    mode: Any
    """LEARN, TRACK or DOUBT."""
    phasor: GridPhasor
    doubt: Doubt
    code: SignCode
    response_1: Response
    response_2: Response
    misfit: Any
    """Square of the last residual over its variance."""
    loud: Any
    """Cycles in a row in which it was too large."""
    apart: Any
    """Cycles in a row in which the fast and the slow track contradicted each other."""
    suspect: Any
    """Cycles in a row in which they nearly did."""


def no_fit() -> Fit:
    """Nothing known."""
    return Fit(R=0.0, X=0.0, P_RR=1.0, P_RX=0.0, P_XX=1.0, known=0.0)


def first_track(settings: FieldSettings) -> FieldTrack:
    """The estimator before the first cycle."""
    return FieldTrack(
        history_1=no_history(),
        history_2=no_history(),
        filled=-1.0,
        skip=0.0,
        slow=no_track(),
        fast=no_track(),
        fast_fit=no_fit(),
        residuals=no_residuals(),
        noise=first_noise(settings.noise_first),
        answer=Fit(R=settings.R_first, X=settings.X_first, P_RR=100.0, P_RX=0.0, P_XX=100.0, known=0.0),
        prior=no_fit(),
        mode=LEARN,
        phasor=first_grid_phasor(),
        doubt=no_doubt(),
        code=first_code(settings),
        response_1=no_response(),
        response_2=no_response(),
        misfit=1.0,
        loud=0.0,
        apart=0.0,
        suspect=0.0,
    )


def grid_sigma(fit: Fit, settings: FieldSettings) -> Any:
    """Standard deviation of the grid's impedance relative to its length."""
    R = fit.R - settings.R_2
    X = fit.X - settings.X_2
    return np.sqrt(np.maximum(fit.P_RR + fit.P_XX, 0.0) / np.maximum(R * R + X * X, 1e-12))


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
    second_re, second_im = rotate(whole_re, whole_im, last_re, last_im)
    # The recursion of the phasor loses digits; its angle is known.
    sign = 1.0 if lock.half_re > 0.0 else -1.0
    end_re, end_im = current_at_the_end(lock)
    step = 0.5 * omega * settings.T_s
    return LockIn(
        phi=lock.phi,
        omega=omega,
        half_re=sign * np.cos(0.5 * lock.phi),
        half_im=sign * np.sin(0.5 * lock.phi),
        step_less_one=turn_less_one(step),
        step_im=np.sin(step),
        v_re=lock.v_re,
        v_im=lock.v_im,
        i_re=lock.i_re,
        i_im=lock.i_im,
        u_re=lock.u_re,
        u_im=lock.u_im,
        i_before_re=lock.i_before_re,
        i_before_im=lock.i_before_im,
        primed=lock.primed,
        mean=carried(lock, 1.0, 0.0),
        line_1=carried(lock, last_re, last_im),
        line_2=carried(lock, second_re, second_im),
        weight=lock.left,
        left=0.0,
        i_start_re=end_re,
        i_start_im=end_im,
        samples=0.0,
        limited=0.0,
        spoilt=0.0,
        muted=lock.muted,
        a_1=a_1,
        a_2=a_2,
        closed=0.0,
    )


class Surprise(NamedTuple):
    """What the residual of one cycle says before the cycle is used."""

    misfit: Any
    loud: Any
    event: Any
    """1 if the answer in force has been contradicted by two cycles in a row."""
    again: Any
    """1 if something has happened again within a doubt."""


LOUD = 25.0
"""Square of a residual over its variance that contradicts an impedance."""


UNEQUAL_GAINS = 0.006
"""Error that unequal gains of the sensors make in a transient, relative to its voltage."""


def gain_residual(window: Window) -> Any:
    """Square of the residual that unequal gains leave of a transient."""
    return UNEQUAL_GAINS * UNEQUAL_GAINS * (window.v_re * window.v_re + window.v_im * window.v_im)


def surprise_of(track: FieldTrack, F_1: Window, F_2: Window) -> Surprise:
    """Compares the third difference with the answer in force, and in doubt with the fast track."""
    S_1 = DIFFERENCE_GAIN * track.noise.line_1.S + gain_residual(F_1)
    S_2 = DIFFERENCE_GAIN * track.noise.line_2.S + gain_residual(F_2)
    e_1_re, e_1_im = residual(F_1, track.answer.R, track.answer.X)
    e_2_re, e_2_im = residual(F_2, track.answer.R, track.answer.X)
    of_answer = 0.5 * ((e_1_re * e_1_re + e_1_im * e_1_im) / S_1 + (e_2_re * e_2_re + e_2_im * e_2_im) / S_2)
    loud = track.loud + 1.0 if of_answer > LOUD and track.answer.known > 0.5 else 0.0
    fit = track.fast_fit
    f_1_re, f_1_im = residual(F_1, fit.R, fit.X)
    f_2_re, f_2_im = residual(F_2, fit.R, fit.X)
    # A fit of few cycles is itself not sure.
    i_1, x_1 = F_1.i_re * F_1.i_re + F_1.i_im * F_1.i_im, F_1.x_re * F_1.x_re + F_1.x_im * F_1.x_im
    i_2, x_2 = F_2.i_re * F_2.i_re + F_2.i_im * F_2.i_im, F_2.x_re * F_2.x_re + F_2.x_im * F_2.x_im
    of_fast = 0.5 * (
        (f_1_re * f_1_re + f_1_im * f_1_im) / (S_1 + i_1 * fit.P_RR + x_1 * fit.P_XX)
        + (f_2_re * f_2_re + f_2_im * f_2_im) / (S_2 + i_2 * fit.P_RR + x_2 * fit.P_XX)
    )
    event = 1.0 if track.mode == TRACK and loud > 1.5 else 0.0
    again = 1.0 if track.mode == DOUBT and track.fast.count > 1.5 and fit.known > 0.5 and of_fast > LOUD else 0.0
    return Surprise(misfit=of_answer, loud=loud, event=event, again=again)


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
        d_old=none.d_old,
        d_step=none.d_step,
    )


def doubt_judged(doubt: Doubt, used: Any, d_old: Any, d_step: Any) -> Doubt:
    """The doubt with the distances of this cycle."""
    return Doubt(
        used=used,
        cycles=doubt.cycles,
        squares=doubt.squares,
        v_re=doubt.v_re,
        v_im=doubt.v_im,
        i_re=doubt.i_re,
        i_im=doubt.i_im,
        x_re=doubt.x_re,
        x_im=doubt.x_im,
        no_step=doubt.no_step,
        d_old=d_old,
        d_step=d_step,
    )


def conclude(  # noqa: C901
    lock: LockIn, track: FieldTrack, settings: FieldSettings
) -> tuple[LockIn, FieldTrack, FieldAnswer]:
    """Concludes a closed cycle and begins the next one. Returns (lock, track, answer)."""
    mean, now_1, now_2 = windows_of_cycle(lock, settings)
    spoilt = lock.spoilt > 0.5
    filled = -1.0 if spoilt else np.minimum(track.filled + 1.0, 4.0)
    calm = 1.0 if lock.limited <= 0.3 * lock.samples else 0.0

    # The grid's phasor: its steps begin a doubt.
    followed, stepped, correction = phasor_moved(track.phasor, mean, track.answer, track.mode)
    phasor = without_last(track.phasor) if spoilt else followed
    event = 0.0 if spoilt else stepped
    correction = 0.0 if spoilt else correction
    mode = DOUBT if event > 0.5 else track.mode
    doubt = track.doubt
    if event > 0.5:
        doubt = doubt_begun(0.0)
    elif mode == DOUBT and not spoilt:
        doubt = doubt_with(doubt, mean, phasor)
    skip = 4.0 if event > 0.5 else track.skip
    fast = no_track() if event > 0.5 else track.fast
    residuals = no_residuals() if event > 0.5 else track.residuals
    fast_fit = no_fit() if event > 0.5 else track.fast_fit

    # The third difference, where no event lies within its four cycles.
    F_1 = third_difference(now_1, track.history_1)
    F_2 = third_difference(now_2, track.history_2)
    full = filled > 3.5
    usable = full and skip < 0.5
    skip = skip - 1.0 if full and skip > 0.5 else skip
    surprise = surprise_of(track, F_1, F_2)
    contradicted = usable and surprise.event > 0.5
    again = usable and surprise.again > 0.5
    use = usable and not contradicted and not again
    if contradicted:
        mode = DOUBT
        skip = 3.0
    if again:
        # The grid may turn at another speed by now, which alone would contradict any impedance.
        phasor, correction = resynchronised(phasor)
        filled = 0.0
        skip = 1.0
    if contradicted or again:
        doubt = doubt_begun(doubt.no_step)
        fast = no_track()
        residuals = no_residuals()
        fast_fit = no_fit()
    loud = surprise.loud if usable else track.loud
    loud = 0.0 if contradicted or mode == DOUBT else loud
    weight = LOUD_WEIGHT / np.maximum(surprise.misfit, LOUD_WEIGHT) if mode == TRACK else 1.0

    # Both tracks, and the impedances that fit them.
    S_1, S_2 = track.noise.line_1.S, track.noise.line_2.S
    slow = track.slow
    sure = grid_sigma(track.answer, settings) / LONGER_FROM
    memory = SLOW_MEMORY * np.minimum(np.maximum(sure * sure, 1.0), LONGER)
    memory = np.minimum(memory, np.maximum(YOUNG_SHARE * slow.count, YOUNG))
    if use:
        fast = taken(fast, F_1, F_2, FAST_MEMORY, weight)
        residuals = residuals_with(residuals, F_1, F_2, FAST_MEMORY)
        if mode != DOUBT:
            slow = taken(slow, F_1, F_2, memory, weight)
    slow_fit = fit_of(slow, S_1, S_2)
    fast_fit = fit_of(fast, S_1, S_2) if use else fast_fit
    size_sq = track.answer.R * track.answer.R + track.answer.X * track.answer.X
    gain = settings.gain_class * settings.gain_class * size_sq
    both = use and slow_fit.known > 0.5 and fast_fit.known > 0.5
    apart_sq = distance_of(fast_fit, with_gain(slow_fit, gain), 1.0)
    near_doubt = both and mode == TRACK and apart_sq > NEAR
    suspect = track.suspect + 1.0 if near_doubt else (track.suspect if mode == TRACK and not use else 0.0)
    suspected = near_doubt and suspect < 15.5

    # The noise is what the better of both leaves: a real change must not hide itself in it.
    by_fast = mode == DOUBT or suspected
    source = fast_fit if by_fast else slow_fit
    inside = (fast.count if mode == DOUBT else 5.0) if by_fast else slow.count
    share = np.maximum(1.0 - 0.7 / np.minimum(np.maximum(inside, 2.0), SLOW_MEMORY), 0.4)
    e_1_re, e_1_im = residual(F_1, source.R, source.X)
    e_2_re, e_2_im = residual(F_2, source.R, source.X)
    noise = track.noise
    if use and source.known > 0.5 and inside > 2.5:
        noise = noise_with(noise, F_1, F_2, e_1_re, e_1_im, e_2_re, e_2_im, share, weight)
    if use:
        slow_fit = fit_of(slow, noise.line_1.S, noise.line_2.S)
        fast_fit = fit_of(fast, noise.line_1.S, noise.line_2.S)

    # What it means for the answer.
    answer, prior = track.answer, track.prior
    apart = track.apart
    changed = 0.0
    parted = 0.0
    factor = misfit(residuals, fast_fit.R, fast_fit.X, noise.line_1.S, noise.line_2.S)
    since_flip = track.code.since_flip
    if both and mode == LEARN:
        answer, prior = with_prior(slow_fit, prior, slow.count, gain)
        mode = TRACK if slow.count > 3.5 and grid_sigma(answer, settings) < settings.sigma_valid else LEARN
    elif both and mode == TRACK:
        sure_sq = distance_of(fast_fit, with_gain(slow_fit, gain), factor)
        fresh_flip = since_flip > 2.5 and since_flip < FAST_MEMORY + 0.5
        apart = apart + 1.0 if sure_sq > FAR and fresh_flip else 0.0
        parted = 1.0 if apart > 1.5 else 0.0
        soft_sq = distance_of(fast_fit, with_gain(slow_fit, gain), 1.0)
        if parted > 0.5:
            mode = DOUBT
            apart = 0.0
            doubt = doubt_begun(1.0)
            fast = no_track()
            residuals = no_residuals()
            fast_fit = no_fit()
            skip = 2.0
        else:
            answer, prior = with_prior(slow_fit, prior, slow.count, gain)
            if soft_sq > SOFT:
                answer = wider_by(answer, 1.5 * soft_sq / SOFT)
                slow = forgotten(slow, 0.85)
    elif use and mode == DOUBT:
        doubt = doubt_judged(doubt, doubt.used + 1.0, 0.0, 0.0)
        verdict = verdict_of(doubt, phasor, answer, fast_fit, factor, since_flip, calm, settings)
        doubt = doubt_judged(doubt, doubt.used, verdict.d_old, verdict.d_step)
        if verdict.changed > 0.5:
            changed = 1.0
            mode = LEARN
            slow = fast
            step = verdict.step
            by_step = 1.0 if verdict.d_step < NEAR else 0.0
            prior = Fit(R=step.R, X=step.X, P_RR=step.P_RR, P_RX=0.0, P_XX=step.P_XX, known=by_step)
            answer, prior = with_prior(fast_fit, prior, slow.count, gain)
            phasor = settled(phasor, answer, 0.5)
        elif verdict.same > 0.5:
            mode = TRACK
            slow = merged(slow, fast)
            answer, prior = with_prior(fit_of(slow, noise.line_1.S, noise.line_2.S), no_fit(), slow.count, gain)
            phasor = settled(phasor, answer, 1.0)

    omega = lock.omega + correction * settings.omega_n / TURN
    omega = np.minimum(np.maximum(omega, 0.95 * settings.omega_n), 1.05 * settings.omega_n)
    code = code_moved(track.code, mode, doubt.used)
    response_1, response_2 = track.response_1, track.response_2
    if use and mode != DOUBT:
        response_1 = response_of(slow.line_1, response_1, settings)
        response_2 = response_of(slow.line_2, response_2, settings)
    elif use and fast.count > 1.5:
        response_1 = response_of(fast.line_1, response_1, settings)
        response_2 = response_of(fast.line_2, response_2, settings)
    # After a change the probe stays large until the new impedance is known.
    settled_down = grid_sigma(answer, settings) < LARGE_UNTIL or slow.count > LARGE_CYCLES
    rest = 1.0 if mode == TRACK and suspect < 0.5 and settled_down else 0.0
    both_noise = noise_of_probe(noise)
    a_1 = line_amplitude(both_noise, rest, lock.a_1, response_1, settings)
    a_2 = line_amplitude(both_noise, rest, lock.a_2, response_2, settings)
    following = FieldTrack(
        history_1=shifted(now_1, track.history_1),
        history_2=shifted(now_2, track.history_2),
        filled=filled,
        skip=skip,
        slow=slow,
        fast=fast,
        fast_fit=fast_fit,
        residuals=residuals,
        noise=noise,
        answer=answer,
        prior=prior,
        mode=mode,
        phasor=phasor,
        doubt=doubt,
        code=code,
        response_1=response_1,
        response_2=response_2,
        misfit=surprise.misfit,
        loud=loud,
        apart=apart,
        suspect=suspect,
    )
    began = 1.0 if event > 0.5 or contradicted or again or parted > 0.5 else 0.0
    told = answer_of(following, changed, began, lock, np.maximum(a_1, a_2), settings)
    return next_cycle(lock, omega, code.sign * a_1, code.sign * a_2, settings), following, told


def answer_of(
    track: FieldTrack, changed: Any, event: Any, lock: LockIn, amplitude: Any, settings: FieldSettings
) -> FieldAnswer:
    """The answer in SI units at the PCC."""
    fit = wider_by(track.answer, CALIBRATION)
    sigma = grid_sigma(fit, settings)
    valid = 1.0 if fit.known > 0.5 and track.mode != DOUBT and sigma < settings.sigma_valid else 0.0
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
    )
