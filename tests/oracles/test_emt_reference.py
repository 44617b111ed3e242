"""The reference's own parts against something simpler still: a root finder, a quadrature, Ohm's law."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from tests.oracles.emt_circuit import Powers, circuit_matrices, integrate, integrate_pieces, with_beta
from tests.oracles.emt_controller import bridge_pieces
from tests.oracles.emt_source import PiecewiseLinear
from tests.simulation.studies import lc_study, lcl_study
from vsgdesign.study.parameters import Grid


@pytest.mark.parametrize("sample", [0, 1, 2, 3])
def test_pulses_switch_where_the_carrier_meets_the_reference(sample: int) -> None:
    study = lc_study("1 ms", sections="[converter]\nsamples_per_carrier = 4\n", log="25 us")
    v_ref, T, f_sw = 150.0 * cmath.exp(0.7j), 25e-6, 10e3

    def triangle(t: float) -> float:
        return (2.0 / math.pi) * math.asin(-math.cos(2.0 * math.pi * f_sw * (t + sample * T)))

    expected = []
    for turn in (0.0, 2.0 * math.pi / 3.0, -2.0 * math.pi / 3.0):
        m = (v_ref * cmath.exp(-1j * turn)).real / 400.0
        # The carrier is monotone over a quarter of its period: at most one crossing.
        if (triangle(1e-12) - m) * (triangle(T - 1e-12) - m) < 0.0:
            expected.append(brentq(lambda t, m=m: triangle(t) - m, 1e-12, T - 1e-12, xtol=1e-18))
    found = [begin for begin, _, _ in bridge_pieces(v_ref, study, sample, True, [])][1:]
    # asin's slope at its ends costs brentq's function digits: 1e-14 s is 1e-8 of a carrier period squared.
    np.testing.assert_allclose(found, sorted(expected), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_mean_bridge_voltage_is_the_reference(build) -> None:
    """Over a whole carrier period a held reference comes out exactly, zero sequence or not."""
    study = build("1 ms")
    v_ref = 140.0 * cmath.exp(2.1j)
    T = study.converter.T_s
    mean = sum((end - begin) * v for k in (0, 1) for begin, end, v in bridge_pieces(v_ref, study, k, True, [])) / (
        2.0 * T
    )
    assert abs(mean - v_ref) < 1e-10


def test_running_integral_of_steps_and_ramps() -> None:
    quantity = PiecewiseLinear(3.0, [(1.0, 5.0, 2.0), (2.0, 1.0, 0.5), (3.0, 4.0, 0.0)])
    assert quantity.at(2.0)[0] == 4.0  # half-way up when the second move takes over
    for t in (0.5, 1.5, 2.25, 2.9, 3.0, 4.0):
        integral, _ = quad(lambda s: quantity.at(s)[0], 0.0, t, points=[1.0, 2.0, 2.5, 3.0], limit=200)
        assert quantity.at(t)[2] == pytest.approx(integral, abs=1e-9)


def test_circuit_at_standstill_obeys_ohm() -> None:
    """At ω the three state equations give the current that a voltage divider gives on paper."""
    study = lcl_study("1 ms")
    f, g, omega = study.filter, study.grid, 2.0 * math.pi * 50.0
    A, b, e = circuit_matrices(study, g)
    v_b, v_g = 160.0 + 20.0j, 155.0 + 0j
    i_s, v_c, i_g = np.linalg.solve(1j * omega * np.eye(3) - A, b * v_b + e * v_g)
    Z_1 = f.R_1 + 1j * omega * f.L_1
    Z_c = f.R_c + 1.0 / (1j * omega * f.C)
    Z_2 = f.R_2 + g.R_g + 1j * omega * (f.L_2 + g.L_g)
    v_node = (v_b / Z_1 + v_g / Z_2) / (1.0 / Z_1 + 1.0 / Z_c + 1.0 / Z_2)
    assert i_s == pytest.approx((v_b - v_node) / Z_1, rel=1e-12)
    assert i_g == pytest.approx((v_node - v_g) / Z_2, rel=1e-12)
    assert v_c == pytest.approx((i_s - i_g) / (1j * omega * f.C), rel=1e-12)


@pytest.mark.parametrize("unequal", [False, True])
def test_pieces_at_once_are_those_of_scipys_solver(unequal: bool) -> None:
    """Lengths from nothing to a period, of which the longest need several steps of the solver."""
    study, rng = lcl_study("1 ms"), np.random.default_rng(6)
    beta = Grid(0.4 * study.grid.R_g, 1.7 * study.grid.L_g) if unequal else study.grid
    matrices, atol = with_beta(study, study.grid, beta), np.full(3, 1e-11)
    pieces = [
        (
            length,
            complex(*rng.normal(0.0, 150.0, 2)),
            (150.0, 3e3, 0.3, 314.0, 50.0, ((-5.0, 4.0, 0.1),), ((470.0, 2.0, 1.0),), (3.0 - 1.0j, 2e4 + 1e3j)),
        )
        for length in (1e-9, 3e-6, 25e-6, 50e-6, 1e-3, 20e-6)
    ]
    at_once = x = np.array([10.0 - 5.0j, 150.0 + 20.0j, 8.0 + 1.0j])
    for piece in pieces:
        x = integrate(x, *piece, matrices, atol)
        at_once = integrate_pieces(at_once, [piece], Powers(matrices), atol)
        assert np.max(np.abs(at_once - x)) < 1e-11
    together = integrate_pieces(np.array([10.0 - 5.0j, 150.0 + 20.0j, 8.0 + 1.0j]), pieces, Powers(matrices), atol)
    assert np.max(np.abs(together - x)) < 1e-11
