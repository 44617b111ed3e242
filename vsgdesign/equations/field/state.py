"""What the field estimator remembers from cycle to cycle."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.beside import Beside, nothing_beside
from vsgdesign.equations.field.data import LEARN, FieldSettings
from vsgdesign.equations.field.doubt import Doubt, no_doubt
from vsgdesign.equations.field.grid_phasor import GridPhasor, first_grid_phasor
from vsgdesign.equations.field.noise import Noise, Residuals, first_noise, no_residuals
from vsgdesign.equations.field.sign_code import Foreign, Response, SignCode, first_code, no_foreign, no_response
from vsgdesign.equations.field.tracks import Fit, History, Track, no_fit, no_history, no_track


class FastTrack(NamedTuple):
    """The track of few cycles, which tells whether something has changed."""

    track: Track
    fit: Fit
    residuals: Residuals


def no_fast() -> FastTrack:
    """Nothing taken in."""
    return FastTrack(track=no_track(), fit=no_fit(), residuals=no_residuals())


class FieldTrack(NamedTuple):
    """What changes once per cycle."""

    history_1: History
    history_2: History
    filled: Any
    """Cycles in the histories, up to 4. The first cycle is thrown away, because the low-passes still settle in it."""
    skip: Any
    """Cycles after an event that are not used: each difference spans four cycles."""
    slow: Track
    fast: FastTrack
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
    foreign: Foreign
    beside: Beside
    """What lies beside R and X."""


def first_track(settings: FieldSettings) -> FieldTrack:
    """The estimator before the first cycle."""
    return FieldTrack(
        history_1=no_history(),
        history_2=no_history(),
        filled=-1.0,
        skip=0.0,
        slow=no_track(),
        fast=no_fast(),
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
        foreign=no_foreign(),
        beside=nothing_beside(),
    )


def grid_sigma(fit: Fit, settings: FieldSettings) -> Any:
    """Standard deviation of the grid's impedance relative to its length."""
    R = fit.R - settings.R_2
    X = fit.X - settings.X_2
    return np.sqrt(np.maximum(fit.P_RR + fit.P_XX, 0.0) / np.maximum(R * R + X * X, 1e-12))
