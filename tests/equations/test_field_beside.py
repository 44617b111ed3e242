"""What lies beside R and X: the third number that two lines give, against impedances written with complex numbers."""

from __future__ import annotations

import numpy as np
import pytest

from vsgdesign.equations.field.beside import Beside, beside_with, nothing_beside, own_lines, with_beside
from vsgdesign.equations.field.data import FieldSettings
from vsgdesign.equations.field.noise import Noise, first_noise
from vsgdesign.equations.field.tracks import CALIBRATION, Fit, LineTrack, Track, fit_of, wider_by
from vsgdesign.identification.field import field_settings

R_2, X_2 = 0.01, 0.05
OMEGA = 2.0 * np.pi * 50.0
SETTINGS: FieldSettings = field_settings(T_s=1e-4, omega_n=OMEGA, V_base=1.0, Z_base=1.0, R_2=R_2, L_2=X_2 / OMEGA)
NOISE: Noise = first_noise(3e-8)
CYCLES, SENT = 100.0, 2e-3


def grid(p: complex, R: float, X: float, B: float = 0.0, G: float = 0.0) -> complex:
    """Z of R and X in series with a capacitance and a conductance beside."""
    return 1.0 / (1.0 / (R + p * X) + p * B + G)


def line(h: float, Z: complex, error: complex = 0j) -> LineTrack:
    """The sums of a line at h times the frequency behind R_2 and X_2, after CYCLES cycles of the probe SENT."""
    whole = Z + R_2 + 1j * h * X_2
    uu = CYCLES * SENT**2
    i = -uu / (whole + 0.1 + 0.2j * h)
    v, x = whole * i + error, 1j * h * i
    return LineTrack(v.real, v.imag, i.real, i.imag, x.real, x.imag, uu, uu)


def said(track: Track, cycles: int = 12) -> tuple[Fit, Beside]:
    """What is answered, pu, and what lies beside, after some cycles with these sums."""
    fit, beside = fit_of(track, NOISE.line_1.S, NOISE.line_2.S), nothing_beside()
    for _ in range(cycles):
        beside = beside_with(beside, track, fit, NOISE, SETTINGS)
    return with_beside(wider_by(fit, CALIBRATION), beside), beside


def track_of(**grid_of: float) -> Track:
    return Track(line(1.5, grid(1.5j, **grid_of)), line(2.5, grid(2.5j, **grid_of)), CYCLES)


def inside(fit: Fit, Z: complex) -> bool:
    """Whether Z at the PCC is in the answer's ellipse of 95 %."""
    e = np.array([fit.R - R_2 - Z.real, fit.X - X_2 - Z.imag])
    return bool(e @ np.linalg.solve(np.array([[fit.P_RR, fit.P_RX], [fit.P_RX, fit.P_XX]]), e) < 5.99)


@pytest.mark.parametrize("shunt", [{"B": 0.12}, {"B": 0.3}, {"G": 0.3}, {"G": 0.5}])
def test_a_shunt_is_found_and_taken_into_the_fundamental(shunt: dict[str, float]) -> None:
    """What R and X alone miss by more than 5 % is right to 1 %, and so are R, X and the shunt: the prior of Y counts
    for less than a tenth of its deviation."""
    own = {"R": 0.08, "X": 0.3, **shunt}
    fit, beside = said(track_of(**own))
    Z = grid(1j, **own)
    alone = fit_of(track_of(**own), NOISE.line_1.S, NOISE.line_2.S)
    assert abs(complex(alone.R - R_2, alone.X - X_2) - Z) > 0.05 * abs(Z)
    assert abs(complex(fit.R - R_2, fit.X - X_2) - Z) < 0.01 * abs(Z)
    assert beside.refuted == 1.0
    assert beside.passive == 1.0
    assert inside(fit, Z)
    model = beside.capacitor if "B" in shunt else beside.load
    assert pytest.approx((0.08, 0.3, *shunt.values()), rel=0.03) == (model.R, model.X, model.Y)


def test_r_and_x_alone_stay_what_they_are() -> None:
    own = {"R": 0.08, "X": 0.3}
    fit, beside = said(track_of(**own))
    assert abs(complex(fit.R - R_2, fit.X - X_2) - grid(1j, **own)) < 1e-4 * 0.31
    assert beside.refuted == 0.0
    assert beside.passive == 1.0
    lines = own_lines(track_of(**own), fit, 1.0)
    assert tuple(lines) == pytest.approx((0.09, 0.35, 0.09, 0.35), rel=1e-9)


@pytest.mark.parametrize(
    "lines",
    [
        (-0.05 + 0.6j, -0.1 + 1.0j),  # a resistance below 0
        (0.1 + 0.45j, 0.1 + 0.5j),  # a reactance that nearly stays
        (0.3 + 0.45j, 0.05 + 0.75j),  # a resistance that falls
        (0.06 + 0.45j, 0.4 + 1.2j),  # both rise too much for either shunt
    ],
)
def test_what_no_passive_grid_says_is_told(lines: tuple[complex, complex]) -> None:
    _, beside = said(Track(line(1.5, lines[0]), line(2.5, lines[1]), CYCLES))
    assert beside.passive == 0.0
    assert beside.refuted == 1.0


def test_young_tracks_say_nothing_beside() -> None:
    """The first differences hold the end of a transient."""
    young = track_of(R=0.08, X=0.3, B=0.3)._replace(count=8.0)
    _, beside = said(young)
    assert (beside.d_R, beside.d_X, beside.P_RR, beside.refuted, beside.passive) == (0.0, 0.0, 0.0, 0.0, 1.0)


def test_the_covariance_is_that_of_the_errors() -> None:
    """60 draws of the lines' noise on each of three grids: at least 90 % are inside the ellipse of 95 %."""
    rng = np.random.default_rng(8)
    deviation = np.sqrt(0.75 * NOISE.line_1.S * CYCLES * SENT**2 / 2.0)
    for own in ({}, {"B": 0.04}, {"G": 0.1}):
        Z, hits = {h: grid(h, 0.05, 0.25, **own) for h in (1j, 1.5j, 2.5j)}, 0
        for _ in range(60):
            errors = deviation * (rng.normal(size=2) + 1j * rng.normal(size=2))
            track = Track(line(1.5, Z[1.5j], errors[0]), line(2.5, Z[2.5j], errors[1]), CYCLES)
            hits += inside(said(track, 6)[0], Z[1j])
        assert hits >= 54, own
