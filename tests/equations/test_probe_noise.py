"""What the probe leaves in the mean of P over two cycles at rest, where its sign changes: for every pair of lines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.equations.test_field_recursions import OMEGA, T_S, V_BASE, Z_BASE, Line, floats, run
from vsgdesign.equations.field import TRACK, sign_code, tracks
from vsgdesign.equations.field.cycle import FRESH_UNTIL, LARGER_BY, whole_over_grid
from vsgdesign.equations.field.measuring import FAST_MEMORY
from vsgdesign.equations.field.sign_code import SignCode, code_moved, towards
from vsgdesign.equations.field.tracks import Fit
from vsgdesign.identification.field import PAIRS, field_settings

LINES = [(0.5, 1.5), (-2.5, -3.5), (2.5, 3.5), (-4.5, -5.5)]
"""Of the pairs 1 to 4, in the flywheel's frame."""
N, CYCLES = 40, 400
PHI = 2.0 * math.pi * (np.arange(N) + 0.5) / N


def signs() -> list[float]:
    """The sign code of every cycle at rest."""
    code, found = SignCode(bits=7.0, second=1.0, cycles=1.0, sign=1.0, since_flip=50.0), []
    for _ in range(CYCLES):
        code = code_moved(code, TRACK, 0.0)
        found.append(float(code.sign))
    return found


def probe_now(amplitudes: tuple[float, float], line: float) -> Any:
    """u of every sample, with the product's lines, signs and changes, where the ripple of P limits it."""
    half: Any = np.exp(0.5j * PHI)
    whole: Any = np.exp(1j * PHI)
    first_re, first_im, second_re, second_im = tracks.lines_at(half.real, half.imag, whole.real, whole.imag, line)
    share, b_1, b_2, cycles = sign_code.RIPPLE_SHARE, 0.0, 0.0, []
    for m, sign in enumerate(signs()):
        b_1 = towards(b_1, tracks.SIGN_1 * sign, share * tracks.SIZE_1 * amplitudes[0], 1.0)
        b_2 = towards(b_2, tracks.SIGN_2 * sign, share * tracks.SIZE_2 * amplitudes[1], 1.0)
        cycles.append((-1.0) ** m * (b_1 * (first_re + 1j * first_im) + b_2 * (second_re + 1j * second_im)))
    return np.concatenate(cycles)


def probe_before(amplitudes: tuple[float, float]) -> Any:
    """u of lines at 1/2 and 3/2 with equal signs that change at once, as the probe was sent before."""
    lines = sum(a * np.exp(1j * nu * PHI) for a, nu in zip(amplitudes, LINES[0], strict=True))
    return np.concatenate([(-1.0) ** m * sign * lines for m, sign in enumerate(signs())])


def noise_of_mean(u: Any, R: float, X: float) -> float:
    """Standard deviation of P's mean over two cycles, behind R and X (pu) at a voltage of 1 pu."""
    h, i, power = 2.0 * math.pi / N, 0j, []
    before = 0j
    for now in u.tolist():
        i = ((X - 0.5 * h * complex(R, X)) * i + 0.5 * h * (before + now)) / (X + 0.5 * h * complex(R, X))
        before = now
        power.append(i.real)
    total = np.cumsum(power[20 * N :])
    return float(np.std(total[2 * N :] - total[: -2 * N])) / (2 * N)


@pytest.mark.parametrize(("R", "X"), [(0.035, 0.035), (0.035, 0.29)])
def test_no_pair_moves_the_power_at_rest_as_the_first_did(R: float, X: float) -> None:
    """SCR 20 at X/R 1, alone and behind a transient reactance. Each line drives the same current, as on a strong grid,
    where the ripple of P limits the probe. Of equal lines with the reversed line alone the first pair would keep 0.57
    and 0.41 of its noise, with the slow change alone 0.47 and 0.39."""

    def amplitudes(pair: tuple[float, float]) -> tuple[float, float]:
        return abs(complex(R, X * (1.0 + pair[0]))), abs(complex(R, X * (1.0 + pair[1])))

    before = noise_of_mean(probe_before(amplitudes(LINES[0])), R, X)
    found = [noise_of_mean(probe_now(amplitudes(pair), pair[0]), R, X) / before for pair in LINES]
    assert found[0] < 0.4
    assert max(found[1:]) < 0.1


def test_no_two_pairs_have_a_line_in_common() -> None:
    """Half-integer multiples of one frequency are orthogonal over a cycle."""
    lines = [line for first in PAIRS for line in (first, tracks.second_line(first))]
    assert len(set(lines)) == 2 * len(PAIRS)
    assert all(line % 1.0 == 0.5 for line in lines)


def test_a_change_of_the_sign_takes_three_cycles_at_rest() -> None:
    sent, found = 2e-3, []
    for _ in range(4):
        sent = towards(sent, -1.0, 2e-3, 1.0)
        found.append(sent)
    np.testing.assert_allclose(found, [2e-3 / 3.0, -2e-3 / 3.0, -2e-3, -2e-3], rtol=1e-12)
    assert towards(2e-3, -1.0, 7e-3, 0.0) == -7e-3  # in doubt at once


@pytest.mark.parametrize("pair", [1, 2, 3, 4])
def test_every_pair_finds_the_grid(pair: int) -> None:
    """The trapezoidal rule of the oracle is wrong by (ω T_s)²/12 at a line: 0.3 % at 5.5 times 50 Hz. The probe is zero
    where a cycle begins."""
    settings = floats(field_settings(T_s=T_S, omega_n=OMEGA, V_base=V_BASE, Z_base=Z_BASE, pair=pair))
    ones = tracks.lines_at(1.0, 0.0, 1.0, 0.0, settings.line)
    assert tracks.SIGN_1 * ones[0] + tracks.SIGN_2 * ones[2] == 0.0
    lines = tracks.lines_at(math.cos(0.2), math.sin(0.2), math.cos(0.4), math.sin(0.4), settings.line)
    np.testing.assert_allclose(complex(*lines[:2]), np.exp(0.4j * LINES[pair - 1][0]), rtol=1e-14)
    np.testing.assert_allclose(complex(*lines[2:]), np.exp(0.4j * LINES[pair - 1][1]), rtol=1e-14)
    answer = run(Line(0.1, 0.3), 14, settings=settings)[2][-1]
    assert answer.valid == 1.0
    found = complex(answer.R_g, OMEGA * answer.L_g) / Z_BASE
    assert abs(found - complex(0.1, 0.3)) < 0.01 * abs(complex(0.1, 0.3))


def slow(at_once: list[float]) -> Any:
    """The sign as it is sent at rest."""
    sent, found = 0.0, []
    for sign in at_once:
        sent = towards(sent, sign, 1.0, 1.0)
        found.append(sent)
    return np.array(found)


def test_the_lines_carry_more_information_within_the_same_limits() -> None:
    """What the third difference leaves of the probe, over both lines: 1.7 times that of equal lines whose sign changes
    at once. Where voltage or power limit them, their rms values over the changes are those of such lines."""
    at_once = signs()
    sent = slow(at_once)
    both = (tracks.SIZE_1**2 + tracks.SIZE_2**2) / 2.0
    before, now = (float(np.mean(np.convolve(c, [1.0, 3.0, 3.0, 1.0], "valid") ** 2)) for c in (at_once, sent))
    assert both * now > 1.7 * before
    rms = math.sqrt(np.mean(sent[5:] ** 2))
    assert abs(sign_code.RMS_OF_CHANGES - rms) < 2e-3
    assert sign_code.RIPPLE_SHARE * math.sqrt(both) * rms == pytest.approx(1.0, rel=2e-3)


def of_the_old_sign(sent: Any) -> float:
    """What the fast track's squares have of the sign before the last change."""
    F = np.convolve(sent, [1.0, 3.0, 3.0, 1.0], "valid")
    squares = (1.0 - 1.0 / FAST_MEMORY) ** np.arange(len(F))[::-1] * F**2
    return float(squares[F > 0.0].sum() / squares.sum())


def test_a_contradiction_counts_while_the_fast_track_knows_both_signs() -> None:
    """A slow change is a cycle later than one at once, of which the fast track has seen both signs up to its memory."""
    at_once = of_the_old_sign([1.0] * 40 + [-1.0] * int(FAST_MEMORY))
    last = math.floor(FRESH_UNTIL)
    assert of_the_old_sign(slow([1.0] * 40 + [-1.0] * last)) == pytest.approx(at_once, abs=0.01)
    assert of_the_old_sign(slow([1.0] * 40 + [-1.0] * (last + 1))) < 0.9 * at_once


def test_the_probe_is_larger_where_the_grid_is_a_part_of_what_is_measured() -> None:
    """By what the filter's grid side adds to it, and at most by LARGER_BY, in the square: without one not at all."""
    plain = field_settings(T_s=1e-4, omega_n=OMEGA, V_base=1.0, Z_base=1.0)
    behind = plain._replace(R_2=0.01, X_2=0.05)
    fit = Fit(R=0.10, X=0.55, P_RR=0.0, P_RX=0.0, P_XX=0.0, known=1.0)
    assert whole_over_grid(fit, plain) == 1.0
    assert whole_over_grid(fit, behind) == pytest.approx(abs(0.10 + 0.55j) ** 2 / abs(0.09 + 0.50j) ** 2, rel=1e-12)
    assert whole_over_grid(fit._replace(R=0.03, X=0.1), behind) == LARGER_BY**2
