"""The power loops as python-control systems, and classical margins, against what is known in closed form."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from vsgdesign.equations.power_flow import Lags
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point import solve_operating_point
from vsgdesign.linear.stability.loops import coupled_loop, loop_margins, power_loops

GAINS = PowerLoopGains(K_ip=0.00767, D_p=2087.0, K_iq=0.115, D_q=0.687)


@pytest.mark.parametrize("s", [0.3j, 4.0 + 1.0j, 50.0j])
def test_the_loops_are_systems_of_python_control(s: complex) -> None:
    """K_ip A/(s(s + D_p K_ip)) and K_iq D/(s + K_iq D_q), open and closed."""
    A, D = 8348.2, 68.7
    loops = power_loops(GAINS, A, D)
    P = GAINS.K_ip * A / (s * (s + GAINS.D_p * GAINS.K_ip))
    Q = GAINS.K_iq * D / (s + GAINS.K_iq * GAINS.D_q)
    pairs = (
        (loops.P_open, P),
        (loops.P_closed, P / (1.0 + P)),
        (loops.Q_open, Q),
        (loops.Q_closed, Q / (1.0 + Q)),
    )
    for found, expected in pairs:
        assert isinstance(found, control.TransferFunction)
        assert found(s) == pytest.approx(expected, rel=1e-12)


def test_a_coupled_loop_without_coupling_is_a_decoupled_one() -> None:
    """At no power through a reactance alone B = C = 0. With it, both loops differ."""
    rest, loaded = (solve_operating_point(P, 0.0, 110.0, 0.0, 1.2) for P in (0.0, 4000.0))
    s = 2.0j
    for point, same in ((rest, True), (loaded, False)):
        alone = power_loops(GAINS, point.A, point.D)
        for loop, expected in enumerate((alone.P_open, alone.Q_open)):
            found = coupled_loop(point, GAINS, 110.0, (0.0, 1.2), Lags(), loop)
            assert isinstance(found, control.TransferFunction)
            assert (abs(found(s) / expected(s) - 1.0) < 1e-9) == same


@pytest.mark.parametrize(("K", "a", "b"), [(3.0, 1.0, 20.0), (50.0, 2.0, 5.0), (1e4, 16.0, 400.0)])
def test_margins_of_three_poles(K: float, a: float, b: float) -> None:
    """K/(s(s + a)(s + b)) turns by half a turn at √(ab), where it is K/(ab(a + b))."""
    found = loop_margins(control.tf([K], [1.0, a + b, a * b, 0.0]))
    assert found.gain_margin_db == pytest.approx(20.0 * math.log10(a * b * (a + b) / K), rel=1e-9)
    omega = found.crossover_rad_s
    assert omega is not None
    assert omega * math.hypot(omega, a) * math.hypot(omega, b) == pytest.approx(K, rel=1e-9)
    phase = 90.0 - math.degrees(math.atan(omega / a) + math.atan(omega / b))
    assert found.phase_margin_deg == pytest.approx(phase, abs=1e-9)
    assert found.delay_margin_s == pytest.approx(math.radians(phase) / omega, rel=1e-9)


def test_a_loop_that_crosses_no_line_has_no_margin() -> None:
    found = loop_margins(control.tf([0.5], [1.0, 1.0]))
    assert found.gain_margin_db is None
    assert found.phase_margin_deg is found.delay_margin_s is found.crossover_rad_s is None


@pytest.mark.parametrize("pole", [0.0, 1e-15, -1e-15])
@pytest.mark.parametrize("zero", [0.0, 1e-15, -1e-15])
def test_rounding_makes_no_gain_margin(zero: float, pole: float) -> None:
    """K/(s(s + a)) never turns by half a turn. With a pole not quite at zero, or a zero very far away, it does."""
    K, a = 60.0, 16.0
    found = loop_margins(control.tf([K * zero, K], [1.0, a, pole]))
    assert found.gain_margin_db is None
    omega = math.sqrt(0.5 * (math.sqrt(a**4 + 4.0 * K * K) - a * a))
    assert found.phase_margin_deg == pytest.approx(90.0 - math.degrees(math.atan(omega / a)), abs=1e-9)


def test_the_margin_is_the_one_nearest_to_the_limit() -> None:
    """Three crossings beside a resonance: the phase margin is the least of them."""
    loop = control.tf([20.0], np.polymul([1.0, 0.0], [1.0, 0.4, 25.0]))
    omega = np.geomspace(0.1, 50.0, 400_001)
    response = loop(1j * omega)
    assert isinstance(response, np.ndarray)
    crosses = np.flatnonzero(np.diff(np.sign(np.abs(response) - 1.0)))
    assert len(crosses) == 3
    phases = np.remainder(np.angle(response[crosses], deg=True), 360.0) - 180.0
    assert loop_margins(loop).phase_margin_deg == pytest.approx(phases[np.argmin(np.abs(phases))], abs=0.05)
