"""What the field estimator does once per cycle of its flywheel."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import LEARN, TRACK, FieldAnswer, FieldSettings, LineSums, LockIn
from vsgdesign.equations.field.noise import Noise, first_noise, noise_with
from vsgdesign.equations.field.tracks import Fit, Track, fit_of, no_track, taken
from vsgdesign.equations.field.windows import (
    History,
    current_at_the_end,
    no_history,
    residual,
    shifted,
    third_difference,
    windows_of_cycle,
)
from vsgdesign.frames import rotate, rotate_back

SLOW_MEMORY = 60.0
CALIBRATION = 0.75
"""Factor of the covariance, from the ratio of the squared errors to it over many grids."""


class FieldTrack(NamedTuple):
    """What changes once per cycle."""

    history_1: History
    history_2: History
    filled: Any
    """Cycles in the histories, up to 4. The first cycle is thrown away, because the low-passes still settle in it."""
    slow: Track
    noise: Noise
    answer: Fit
    """The impedance in force from the measured voltage to the grid's source, pu."""
    mode: Any


def first_track(settings: FieldSettings) -> FieldTrack:
    """The estimator before the first cycle."""
    return FieldTrack(
        history_1=no_history(),
        history_2=no_history(),
        filled=-1.0,
        slow=no_track(),
        noise=first_noise(settings.noise_first),
        answer=Fit(R=settings.R_first, X=settings.X_first, P_RR=100.0, P_RX=0.0, P_XX=100.0, known=0.0),
        mode=LEARN,
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
    last_re, last_im = rotate_back(lock.half_re, lock.half_im, lock.step_re, lock.step_im)
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
        step_re=np.cos(step),
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


def conclude(lock: LockIn, track: FieldTrack, settings: FieldSettings) -> tuple[LockIn, FieldTrack, FieldAnswer]:
    """Concludes a closed cycle and begins the next one. Returns (lock, track, answer)."""
    _, now_1, now_2 = windows_of_cycle(lock, settings)
    filled = np.minimum(track.filled + 1.0, 4.0) if lock.spoilt < 0.5 else -1.0
    use = filled > 3.5
    F_1 = third_difference(now_1, track.history_1)
    F_2 = third_difference(now_2, track.history_2)
    slow = taken(track.slow, F_1, F_2, SLOW_MEMORY, 1.0) if use else track.slow
    fit = fit_of(slow, track.noise.line_1.S, track.noise.line_2.S)
    e_1_re, e_1_im = residual(F_1, fit.R, fit.X)
    e_2_re, e_2_im = residual(F_2, fit.R, fit.X)
    share = np.maximum(1.0 - 0.7 / np.maximum(slow.count, 2.0), 0.4)
    noise = (
        noise_with(track.noise, F_1, F_2, e_1_re, e_1_im, e_2_re, e_2_im, share, 1.0)
        if use and slow.count > 2.5
        else track.noise
    )
    size_sq = fit.R * fit.R + fit.X * fit.X
    gain = settings.gain_class * settings.gain_class * size_sq
    known = fit.known > 0.5 and use
    answer = (
        Fit(
            R=fit.R,
            X=fit.X,
            P_RR=CALIBRATION * (fit.P_RR + gain),
            P_RX=CALIBRATION * fit.P_RX,
            P_XX=CALIBRATION * (fit.P_XX + gain),
            known=1.0,
        )
        if known
        else track.answer
    )
    sigma = grid_sigma(answer, settings)
    mode = TRACK if slow.count > 3.5 and sigma < settings.sigma_valid else LEARN
    wanted = np.sqrt(noise.line_1.S / SLOW_MEMORY) / settings.sigma_rest
    amplitude = np.minimum(np.maximum(wanted, settings.amplitude_least), settings.amplitude_rest)
    amplitude = amplitude if mode == TRACK else settings.amplitude_burst
    sign = 1.0 if lock.a_1 > 0.0 else -1.0
    following = FieldTrack(
        history_1=shifted(now_1, track.history_1),
        history_2=shifted(now_2, track.history_2),
        filled=filled,
        slow=slow,
        noise=noise,
        answer=answer,
        mode=mode,
    )
    valid = 1.0 if mode == TRACK else 0.0
    spoilt = 1.0 if lock.spoilt > 0.5 else 0.0
    ohm = settings.Z_base
    henry = settings.Z_base / settings.omega_n
    told = FieldAnswer(
        R_g=(answer.R - settings.R_2) * ohm,
        L_g=(answer.X - settings.X_2) * henry,
        var_R=answer.P_RR * ohm * ohm,
        cov_RL=answer.P_RX * ohm * henry,
        var_L=answer.P_XX * henry * henry,
        sigma=sigma,
        valid=valid,
        changed=0.0,
        event=0.0,
        doubt=0.0,
        mode=mode,
        limited=lock.limited / np.maximum(lock.samples, 1.0),
        spoilt=spoilt,
        amplitude=amplitude,
    )
    return next_cycle(lock, lock.omega, sign * amplitude, sign * amplitude, settings), following, told
