"""What a network is given of the recursions once per cycle: numbers of order one, always finite."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import DOUBT, LEARN, FieldAnswer, FieldSettings, LockIn
from vsgdesign.equations.field.doubt import NEVER, impedance_of_step, step_of_grid
from vsgdesign.equations.field.noise import left_over
from vsgdesign.equations.field.state import FieldTrack, grid_sigma
from vsgdesign.equations.field.tracks import Fit
from vsgdesign.equations.integration import TURN

LN_10 = 2.302585092994046


class FieldFeatures(NamedTuple):
    """Features of one cycle. "lg" is the logarithm to base 10, "ln" the natural one; all are clipped."""

    learning: Any
    doubting: Any
    """1 or 0"""
    used: Any
    """Tenths of the cycles that the fast track has taken in since the event, up to 1; 0 outside a doubt."""
    waited: Any
    """Tenths of the cycles since the event, up to 1; 0 outside a doubt."""
    lg_sigma: Any
    """Relative standard deviation of the answer."""
    lg_S_1: Any
    lg_S_2: Any
    """Noise of both lines over 1e-8."""
    lg_chip_1: Any
    lg_chip_2: Any
    """Noise of the chips over that of the cycles."""
    lg_a_1: Any
    lg_a_2: Any
    """Amplitudes of both lines in the next cycle over 1e-3."""
    since_flip: Any
    """Tenths of the cycles since the code's last change of sign, up to 1."""
    fast_ln: Any
    fast_turn: Any
    """ln of the fast track's |Z| over the answer's, and the angle between them, rad."""
    lg_fast_sigma: Any
    """Relative standard deviation of the fast track."""
    fast_known: Any
    step_ln: Any
    step_turn: Any
    """The same for the impedance of the step."""
    lg_step_sigma: Any
    step_known: Any
    lg_step_misfit: Any
    """Scatter of the grid's phasor if the impedance is that of the step, over its usual scatter."""
    lg_grid_misfit: Any
    """Scatter of the grid's phasor about its new value if the impedance has not changed."""
    lg_grid_step: Any
    """Step of the grid's phasor if the impedance has not changed."""
    ln_d_old: Any
    ln_d_step: Any
    """ln(1 + squared distance) of the fast track to the old impedance and to that of the step."""
    current: Any
    """Length of the current, pu."""
    ln_Z: Any
    angle: Any
    """Of the answer's impedance."""
    lg_variance: Any
    """Variance of the grid's phasor over 1e-7."""
    ln_misfit: Any
    """ln(1 + squared residual of the answer over its variance)."""
    slip: Any
    """Mean turn of the grid's phasor per cycle, mrad, up to 3."""
    limited: Any
    """Share of the cycle's samples in which the current limiter acted."""
    lg_slow: Any
    """Cycles in the slow track."""


def lg(x: Any, least: Any, most: Any) -> Any:
    """Logarithm to base 10 of what is clipped."""
    return np.log(np.minimum(np.maximum(x, least), most)) / LN_10


def ratio_of(fit: Fit, answer: Fit) -> tuple[Any, Any]:
    """Length (ln) and angle of an impedance over another one's. Returns (ratio, turn)."""
    size = np.sqrt(fit.R * fit.R + fit.X * fit.X)
    own = np.sqrt(answer.R * answer.R + answer.X * answer.X)
    ratio = np.log(np.maximum(size, 1e-4) / np.maximum(own, 1e-4))
    turn = np.arctan2(fit.X, fit.R) - np.arctan2(answer.X, answer.R)
    turn = turn - TURN * np.floor(turn / TURN + 0.5)
    known = fit.known > 0.5
    ratio = np.minimum(np.maximum(ratio, -4.0), 4.0) if known else 0.0
    turn = turn if known else 0.0
    return ratio, turn


def features(lock: LockIn, track: FieldTrack, answer: FieldAnswer, settings: FieldSettings) -> FieldFeatures:
    """The features of the cycle that :func:`conclude` has just concluded, from what it returned."""
    fit, noise, doubt, phasor = track.answer, track.noise, track.doubt, track.phasor
    doubting = 1.0 if track.mode == DOUBT else 0.0
    learning = 1.0 if track.mode == LEARN else 0.0
    step = impedance_of_step(doubt, phasor)
    known = doubting * step.known
    step = Fit(R=step.R, X=step.X, P_RR=step.P_RR, P_RX=0.0, P_XX=step.P_XX, known=known)
    fast_ratio, fast_turn = ratio_of(track.fast.fit, fit)
    step_ratio, step_turn = ratio_of(step, fit)
    usual = np.sqrt(phasor.variance)
    n = np.maximum(doubt.cycles - 1.0, 1.0)
    g_re, g_im, scatter = step_of_grid(doubt, fit)
    of_step = np.sqrt(left_over(doubt.squares, step.R, step.X) / n)
    present = doubting if doubt.cycles > 0.5 else 0.0
    fast_sigma = grid_sigma(track.fast.fit, settings)
    step_sigma = grid_sigma(step, settings)
    current = np.sqrt(phasor.i_re * phasor.i_re + phasor.i_im * phasor.i_im)
    fast_known = track.fast.fit.known
    d_step = doubt.d_step if doubting > 0.5 else NEVER
    slip = np.minimum(np.maximum(1e3 * phasor.slip, -3.0), 3.0)
    line_1, line_2 = noise.line_1, noise.line_2
    return FieldFeatures(
        learning=learning,
        doubting=doubting,
        used=doubting * np.minimum(0.1 * doubt.used, 1.0),
        waited=doubting * np.minimum(0.1 * doubt.cycles, 1.0),
        lg_sigma=lg(answer.sigma, 1e-3, 10.0),
        lg_S_1=lg(1e8 * line_1.S, 1e-4, 1e6),
        lg_S_2=lg(1e8 * line_2.S, 1e-4, 1e6),
        lg_chip_1=lg(line_1.chip / np.maximum(line_1.cycle, 1e-30), 1e-2, 1e2),
        lg_chip_2=lg(line_2.chip / np.maximum(line_2.cycle, 1e-30), 1e-2, 1e2),
        lg_a_1=lg(1e3 * np.abs(lock.a_1), 1e-2, 1e2),
        lg_a_2=lg(1e3 * np.abs(lock.a_2), 1e-2, 1e2),
        since_flip=np.minimum(0.1 * track.code.since_flip, 1.0),
        fast_ln=fast_ratio,
        fast_turn=fast_turn,
        lg_fast_sigma=fast_known * lg(fast_sigma, 1e-3, 10.0) + (1.0 - fast_known),
        fast_known=fast_known,
        step_ln=step_ratio,
        step_turn=step_turn,
        lg_step_sigma=known * lg(step_sigma, 1e-3, 10.0) + (1.0 - known),
        step_known=known,
        lg_step_misfit=known * lg(of_step / usual + 1e-2, 1e-2, 1e4),
        lg_grid_misfit=present * lg(scatter / usual + 1e-2, 1e-2, 1e4),
        lg_grid_step=present * lg(np.sqrt(g_re * g_re + g_im * g_im) / usual + 1e-2, 1e-2, 1e4),
        ln_d_old=doubting * np.log(1.0 + np.minimum(doubt.d_old, 1e4)),
        ln_d_step=np.log(1.0 + np.minimum(d_step, 1e4)),
        current=np.minimum(current, 3.0),
        ln_Z=np.log(np.minimum(np.maximum(np.sqrt(fit.R * fit.R + fit.X * fit.X), 1e-3), 1e2)),
        angle=np.arctan2(fit.X, fit.R),
        lg_variance=lg(1e7 * phasor.variance, 1e-2, 1e6),
        ln_misfit=np.log(1.0 + np.minimum(track.misfit, 1e4)),
        slip=slip,
        limited=answer.limited,
        lg_slow=lg(track.slow.count, 1.0, 1e3),
    )
