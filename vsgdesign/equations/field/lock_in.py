"""The part of the field estimator that runs with every sample: the probe and the sums of a cycle.

Two lines at odd halves of the flywheel's speed lie half-way between the harmonics at any frequency. Everything is
turned by phasors that are themselves recursions, so that a sample needs no sine and no cosine.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vsgdesign.equations.field.data import FieldSettings, LineSums, LockIn
from vsgdesign.equations.field.tracks import SIGN_1, SIGN_2, lines_at
from vsgdesign.equations.frames import rotate_back
from vsgdesign.equations.integration import TURN, advanced

BEYOND = 50.0
"""A sample of more than this many per unit is not a measurement."""


def no_sums() -> LineSums:
    """Sums of nothing."""
    return LineSums(v_re=0.0, v_im=0.0, i_re=0.0, i_im=0.0, u_re=0.0, u_im=0.0)


def first_lock_in(settings: FieldSettings, omega: Any) -> LockIn:
    """The lock-in before the first sample; ``omega`` is the converter's frequency, rad/s."""
    amplitude = settings.amplitude_burst
    step = 0.5 * omega * settings.T_s
    # A sample stands for the time from half a period before it to half a period after it: the first cycle begins at 0.
    return LockIn(
        phi=step,
        omega=omega,
        half_re=np.cos(0.5 * step),
        half_im=np.sin(0.5 * step),
        step_less_one=turn_less_one(step),
        step_im=np.sin(step),
        v_re=0.0,
        v_im=0.0,
        i_re=0.0,
        i_im=0.0,
        u_re=0.0,
        u_im=0.0,
        i_before_re=0.0,
        i_before_im=0.0,
        primed=0.0,
        mean=no_sums(),
        line_1=no_sums(),
        line_2=no_sums(),
        weight=0.0,
        left=0.0,
        i_start_re=0.0,
        i_start_im=0.0,
        samples=0.0,
        limited=0.0,
        spoilt=0.0,
        muted=0.0,
        a_1=SIGN_1 * amplitude,
        a_2=SIGN_2 * amplitude,
        closed=0.0,
    )


def probe_value(lock: LockIn, allowed: Any, settings: FieldSettings) -> tuple[Any, Any]:
    """The probe of the coming sample (:eq:`field-probe`), relative to the rated voltage, in the converter's dq frame.

    ``allowed`` is 0 to send none, else 1. Nothing is sent after a sample in which the limiter acted. The caller adds it
    to its voltage, V' e^{jθ'} = (V + V_n u) e^{jθ}, takes it off again after the sample, and hands what it sent to
    :func:`listen`. Returns (u_d, u_q).
    """
    share = allowed * (1.0 - lock.muted)
    whole_re = lock.half_re * lock.half_re - lock.half_im * lock.half_im
    whole_im = 2.0 * lock.half_re * lock.half_im
    first_re, first_im, second_re, second_im = lines_at(lock.half_re, lock.half_im, whole_re, whole_im, settings.line)
    u_d = share * (lock.a_1 * first_re + lock.a_2 * second_re)
    u_q = share * (lock.a_1 * first_im + lock.a_2 * second_im)
    return u_d, u_q


def turn_less_one(angle: Any) -> Any:
    """cos(angle) − 1 with all its digits: −2 sin²(angle/2)."""
    sine = np.sin(0.5 * angle)
    return -2.0 * sine * sine


def mean_sums(sums: LineSums, v_re: Any, v_im: Any, i_re: Any, i_im: Any, u_re: Any, u_im: Any, w: Any) -> LineSums:
    """The sums of the fundamental with a sample added, which has the weight w."""
    return LineSums(
        v_re=sums.v_re + w * v_re,
        v_im=sums.v_im + w * v_im,
        i_re=sums.i_re + w * i_re,
        i_im=sums.i_im + w * i_im,
        u_re=sums.u_re + w * u_re,
        u_im=sums.u_im + w * u_im,
    )


def line_sums(
    sums: LineSums, v_re: Any, v_im: Any, i_re: Any, i_im: Any, u_re: Any, u_im: Any, cosine: Any, sine: Any
) -> LineSums:
    """The sums with v, i and u added, turned back by an angle; cosine and sine carry the sample's weight."""
    return LineSums(
        v_re=advanced(sums.v_re, v_re * cosine + v_im * sine),
        v_im=advanced(sums.v_im, v_im * cosine - v_re * sine),
        i_re=sums.i_re + (i_re * cosine + i_im * sine),
        i_im=sums.i_im + (i_im * cosine - i_re * sine),
        u_re=sums.u_re + (u_re * cosine + u_im * sine),
        u_im=sums.u_im + (u_im * cosine - u_re * sine),
    )


def listen(
    lock: LockIn,
    v_alpha: Any,
    v_beta: Any,
    i_alpha: Any,
    i_beta: Any,
    sent_alpha: Any,
    sent_beta: Any,
    limited: Any,
    settings: FieldSettings,
) -> LockIn:
    """Takes in one sample (:eq:`field-sums`).

    ``v`` and ``i`` are the voltage at the filter's capacitor and the current into the grid as the sensors say them, V
    and A peak; ``sent`` is the probe that was really sent, u e^{jθ}, relative to the rated voltage; ``limited`` is 1 if
    the current limiter acted on this sample's output. After the sample in which ``closed`` becomes 1, the caller calls
    :func:`conclude` before the next sample. A sample that is not finite is replaced by the low-pass.
    """
    half_re, half_im = lock.half_re, lock.half_im
    whole_re = half_re * half_re - half_im * half_im
    whole_im = 2.0 * half_re * half_im
    good = (
        np.abs(v_alpha) * settings.per_volt < BEYOND
        and np.abs(v_beta) * settings.per_volt < BEYOND
        and np.abs(i_alpha) * settings.per_ampere < BEYOND
        and np.abs(i_beta) * settings.per_ampere < BEYOND
        and np.abs(sent_alpha) < 1.0
        and np.abs(sent_beta) < 1.0
    )
    v_re, v_im = rotate_back(settings.per_volt * v_alpha, settings.per_volt * v_beta, whole_re, whole_im)
    i_re, i_im = rotate_back(settings.per_ampere * i_alpha, settings.per_ampere * i_beta, whole_re, whole_im)
    u_re, u_im = rotate_back(sent_alpha, sent_beta, whole_re, whole_im)
    begun = lock.primed > 0.5  # else the first sample sets the low-passes
    share = settings.smoothing if begun else 1.0
    v_re = lock.v_re + share * (v_re - lock.v_re) if good else lock.v_re
    v_im = lock.v_im + share * (v_im - lock.v_im) if good else lock.v_im
    i_re = lock.i_re + share * (i_re - lock.i_re) if good else lock.i_re
    i_im = lock.i_im + share * (i_im - lock.i_im) if good else lock.i_im
    u_re = lock.u_re + share * (u_re - lock.u_re) if good else lock.u_re
    u_im = lock.u_im + share * (u_im - lock.u_im) if good else lock.u_im
    i_before_re = lock.i_re if begun else i_re
    i_before_im = lock.i_im if begun else i_im
    i_start_re = lock.i_start_re if begun else i_re
    i_start_im = lock.i_start_im if begun else i_im
    primed = 1.0 if good else lock.primed
    spoilt = lock.spoilt if good else lock.spoilt + 1.0

    # The sample stands for the angles from phi − ωT_s/2 to phi + ωT_s/2. The part beyond 2π is the next cycle's.
    turned = lock.omega * settings.T_s
    closed = 1.0 if lock.phi + 0.5 * turned >= TURN else 0.0
    left = closed * (lock.phi + 0.5 * turned - TURN) / turned
    w = 1.0 - left
    first_re, first_im, second_re, second_im = lines_at(half_re, half_im, whole_re, whole_im, settings.line)
    # The phasor is the sum of its small changes, so that single precision loses no digits of its length and angle.
    next_re = advanced(lock.half_re, lock.step_less_one * half_re - lock.step_im * half_im)
    next_im = advanced(lock.half_im, lock.step_less_one * half_im + lock.step_im * half_re)
    return LockIn(
        phi=advanced(lock.phi, turned) - TURN * closed,
        omega=lock.omega,
        half_re=next_re,
        half_im=next_im,
        step_less_one=lock.step_less_one,
        step_im=lock.step_im,
        v_re=v_re,
        v_im=v_im,
        i_re=i_re,
        i_im=i_im,
        u_re=u_re,
        u_im=u_im,
        i_before_re=i_before_re,
        i_before_im=i_before_im,
        primed=primed,
        mean=mean_sums(lock.mean, v_re, v_im, i_re, i_im, u_re, u_im, w),
        line_1=line_sums(lock.line_1, v_re, v_im, i_re, i_im, u_re, u_im, w * first_re, w * first_im),
        line_2=line_sums(lock.line_2, v_re, v_im, i_re, i_im, u_re, u_im, w * second_re, w * second_im),
        weight=lock.weight + w,
        left=left,
        i_start_re=i_start_re,
        i_start_im=i_start_im,
        samples=lock.samples + 1.0,
        limited=lock.limited + limited,
        spoilt=spoilt,
        muted=limited,
        a_1=lock.a_1,
        a_2=lock.a_2,
        closed=closed,
    )


def probe_offset(u_d: Any, u_q: Any, V_rms: Any, V_rated_rms: Any) -> tuple[Any, Any]:
    """What a probe adds to V (rms V) and to θ (rad) (:eq:`probe`): V' e^{jθ'} = (V + V_n u) e^{jθ}.

    u_d and u_q are relative to the rated voltage, in the converter's frame. After the controller's sample the same is
    taken off θ and V again, so that the power loops go on as if nothing had been added. Returns (added_V, added_theta).
    """
    whole_d = V_rms + V_rated_rms * u_d
    whole_q = V_rated_rms * u_q
    return np.sqrt(whole_d * whole_d + whole_q * whole_q) - V_rms, np.arctan2(whole_q, whole_d)
