"""Envelopes: recomputed by hand, from an independent solution, and from published curves."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.envelopes import (
    ENVELOPES,
    Bounds,
    Machine,
    Margins,
    change_curves,
    declared_machine,
    power_after_jump,
    power_curves,
)
from vsgdesign.campaigns.compliance.measuring import MeasureInput, Ratings, Trace
from vsgdesign.campaigns.compliance.reading import suite_from_text
from vsgdesign.campaigns.compliance.suite import SuiteTest
from vsgdesign.equations.power_loops import PowerLoopGains

SLOW = Machine(H_s=5.0, D_pu=250.0, X_pu=0.37, omega_n=314.0)
"""Overdamped: ε = 1.36."""
SWINGS = Machine(H_s=5.0, D_pu=95.0, X_pu=0.37, omega_n=314.0)
"""ε = 0.52."""


@pytest.mark.parametrize("machine", [SLOW, SWINGS])
def test_the_response_solves_the_swing_equation(machine: Machine) -> None:
    """Exact propagation of the two states (angle, speed) by the matrix exponential's eigenvectors."""
    A = np.array(
        [[0.0, machine.omega_n], [-1.0 / (2.0 * machine.H_s * machine.X_pu), -machine.D_pu / (2.0 * machine.H_s)]]
    )
    values, vectors = np.linalg.eig(A)
    t = np.linspace(0.0, 2.0, 41)
    start = np.linalg.solve(vectors, np.array([0.1, 0.0]))
    angle = np.real(np.exp(np.outer(t, values)) * start @ vectors.T)[:, 0]
    np.testing.assert_allclose(power_after_jump(t, 0.1, machine), angle / machine.X_pu, rtol=0.0, atol=1e-12)


def test_it_also_solves_it_where_both_rates_are_equal() -> None:
    critical = Machine(H_s=5.0, D_pu=95.0 / SWINGS.damping_ratio, X_pu=0.37, omega_n=314.0)
    assert critical.damping_ratio == pytest.approx(1.0, abs=1e-12)
    t = np.array([0.0, 0.05, 0.3])
    near = Machine(H_s=5.0, D_pu=critical.D_pu * (1.0 + 1e-7), X_pu=0.37, omega_n=314.0)
    np.testing.assert_allclose(power_after_jump(t, 0.1, critical), power_after_jump(t, 0.1, near), rtol=0.0, atol=1e-6)


def test_an_envelope_is_that_of_a_calculation_by_hand() -> None:
    """The overdamped machine 0.1 s after a jump of 0.111 rad (0.3 pu), from the formulas alone."""

    def response(D: float, H: float, t: float) -> float:
        half = D / (4.0 * H)
        root = math.sqrt(half * half - 314.0 / (2.0 * H * 0.37))
        fast, slow = half + root, half - root
        return 0.3 * (fast * math.exp(-slow * t) - slow * math.exp(-fast * t)) / (fast - slow)

    nominal = response(250.0, 5.0, 0.1)
    candidates = [
        nominal,
        response(225.0, 4.5, 0.1),
        response(275.0, 5.5, 0.1),
        1.5 * nominal,
        0.5 * response(250.0, 5.0, 0.09),
    ]
    tunnel = 0.02 * (1.0 - math.exp(-0.08 / 0.3))
    low, high = change_curves(np.array([0.1]), 0.111, SLOW, Margins())
    assert low[0] == pytest.approx(min(candidates) - tunnel, abs=1e-9)
    assert high[0] == pytest.approx(max(candidates) + tunnel, abs=1e-9)


def test_a_swinging_envelope_is_that_of_a_calculation_by_hand() -> None:
    def response(D: float, H: float, t: float) -> float:
        half = D / (4.0 * H)
        turn = math.sqrt(314.0 / (2.0 * H * 0.37) - half * half)
        return 0.3 * math.exp(-half * t) * (math.cos(turn * t) + half / turn * math.sin(turn * t))

    t = 0.25
    decay = 0.3 * math.exp(-95.0 / 20.0 * (t - 0.01))
    varied = [response(factor * 95.0, factor * 5.0, t) for factor in (0.9, 1.0, 1.1)]
    candidates = [*varied, 0.5 * decay, 1.5 * decay]
    tunnel = 0.02 * (1.0 - math.exp(-0.23 / 0.3))
    low, high = change_curves(np.array([t]), 0.111, SWINGS, Margins())
    assert low[0] == pytest.approx(min(candidates) - tunnel, abs=1e-9)
    assert high[0] == pytest.approx(max(candidates) + tunnel, abs=1e-9)


PUBLISHED = {
    40: (0.7782, 0.8913),
    60: (0.7494, 0.8529),
    90: (0.7017, 0.7886),
    120: (0.6576, 0.7289),
    180: (0.5911, 0.6391),
    250: (0.5460, 0.5787),
}
"""Overdamped/PCS_RTE-IGFM1/S_VolAngStep2/OC2 of DyCoV's published curves: row, P, upper P, four digits."""
ROW_S = 5.0 / 2999.0


def test_the_published_curves_are_met() -> None:
    """D = 200, H = 5 s, X_eff = 0.27 pu at SCR 10 from 0.5 pu: a jump of −0.111 rad, with margins of 40 %.

    The file delays by whole rows, 11 in place of 20 ms. The published lower curve holds a varied response that swings,
    for which DyCoV's expression is not the solution of the swing equation (docs/theory/envelopes.md), so that only the
    response and the upper curve can be compared.
    """
    machine = Machine(H_s=5.0, D_pu=200.0, X_pu=0.37, omega_n=314.0)
    since = (np.array(list(PUBLISHED)) - 11) * ROW_S
    published = np.array(list(PUBLISHED.values()))
    response = 0.5 + power_after_jump(since, 0.111, machine)
    np.testing.assert_allclose(response, published[:, 0], rtol=0.0, atol=1e-4)
    _, high = power_curves(since, -0.111, 0.5, 1.2, machine, Margins(above=0.4, below=0.4))
    np.testing.assert_allclose(high, published[:, 1], rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("machine", [SLOW, SWINGS])
def test_curves_mirror_and_hold_the_response(machine: Machine) -> None:
    t = np.linspace(0.0, 3.0, 301)
    low, high = power_curves(t, 0.1, -0.4, 1.2, machine, Margins())
    mirrored_low, mirrored_high = power_curves(t, -0.1, 0.4, 1.2, machine, Margins())
    np.testing.assert_allclose(low, -mirrored_high, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(high, -mirrored_low, rtol=0.0, atol=1e-15)
    response = -0.4 - power_after_jump(t, 0.1, machine)
    assert (low <= response).all()
    assert (response <= high).all()


def test_what_is_asked_ends_below_the_rating_and_what_is_allowed_at_the_limit() -> None:
    low, high = power_curves(np.array([0.02]), -0.4, 0.9, 1.2, SLOW, Margins())
    assert low[0] == pytest.approx(1.0 - 0.05 * 0.4 / 0.37, abs=1e-12)
    assert high[0] == pytest.approx(1.2, abs=1e-12)


def run_of(test: SuiteTest, P_pu: NDArray[Any], t_s: NDArray[Any]) -> MeasureInput:
    fields = {field.name: np.zeros(len(t_s)) for field in dataclasses.fields(Trace)}
    ratings = Ratings(S_rated=1e4, V_rated_rms=230.0, f_n_hz=50.0, i_limit_pu=1.2, X_2_pu=0.05)
    return MeasureInput(test=test, trace=Trace(**{**fields, "t_s": t_s, "P_pu": P_pu}), ratings=ratings)


JUMP = """
[[tests]]
name = "jump"
scr = 10
x_over_r = 10
events = [{ phase_jump = -0.105 }]
"""


def test_a_response_on_the_declared_machine_is_inside_and_one_without_inertia_outside() -> None:
    test = suite_from_text(JUMP).tests[0]
    t = np.arange(-40, 2000, dtype=np.float64) * 1e-3
    given = {"H_s": 5.0, "D_pu": 200.0, "X_eff_pu": 0.27}
    X = 0.27 + 0.1 * 10.0 / math.hypot(1.0, 10.0)
    machine = Machine(H_s=5.0, D_pu=200.0, X_pu=X, omega_n=100.0 * math.pi)
    good = run_of(test, 0.5 + power_after_jump(t, 0.105, machine), t)
    bounds = ENVELOPES["swing_after_jump"].of(good, given)
    assert bounds.rows_of_mean == 20
    assert bounds.excess(good.trace) == 0.0
    assert np.isneginf(bounds.low[t < 0.0]).all()
    dead = run_of(test, np.full(len(t), 0.5), t)
    wanted = 0.5 * power_after_jump(np.array([0.0]), 0.105, machine)[0]
    assert bounds.excess(dead.trace) == pytest.approx(wanted, rel=0.05)


def test_the_declared_machine_has_the_poles_of_the_power_loops() -> None:
    """dδ/dt = ω − k_P K δ and dω/dt = −K_ip (K δ + D_p (ω − k_P K δ)) with K = S/X, against the swing's own poles."""
    gains = PowerLoopGains(K_ip=0.02, D_p=640.0, K_iq=1.0, D_q=1.0, k_P=4e-5)
    S, X, omega_n = 1e4, 0.4, 100.0 * math.pi
    K = S / X
    A = np.array([[-gains.k_P * K, 1.0], [-gains.K_ip * K * (1.0 - gains.D_p * gains.k_P), -gains.K_ip * gains.D_p]])
    machine = declared_machine(gains, S, X, omega_n)
    swing = np.roots([1.0, machine.D_pu / (2.0 * machine.H_s), omega_n / (2.0 * machine.H_s * X)])
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(A)), np.sort_complex(swing), rtol=1e-9)


def test_without_gains_or_a_jump_there_is_no_envelope_and_it_says_why() -> None:
    t = np.arange(-40, 100, dtype=np.float64) * 1e-3
    test = suite_from_text(JUMP).tests[0]
    bounds = ENVELOPES["swing_after_jump"].of(run_of(test, np.zeros(len(t)), t))
    assert "gains are not known" in bounds.why
    other = suite_from_text(JUMP.replace("phase_jump", "P_pu")).tests[0]
    assert "no phase jump" in ENVELOPES["swing_after_jump"].of(run_of(other, np.zeros(len(t)), t)).why


def test_rounding_is_inside_and_a_value_that_is_no_number_is_not() -> None:
    t = np.arange(100, dtype=np.float64) * 1e-3
    run = run_of(suite_from_text(JUMP).tests[0], np.full(100, 0.5), t)
    bounds = Bounds("P_pu", t, np.full(100, 0.5 + 1e-15), np.full(100, 1.0))
    assert bounds.excess(run.trace) == 0.0
    assert math.isnan(bounds.excess(dataclasses.replace(run.trace, P_pu=np.full(100, np.nan))))


def test_a_band_is_asked_from_one_instant_to_another_after_the_last_change() -> None:
    test = suite_from_text(JUMP).tests[0]
    t = np.arange(-40, 2000, dtype=np.float64) * 1e-3
    run = run_of(test, 0.5 + np.where((t >= 0.0) & (t < 1.2), 0.3, 0.0), t)
    envelope = ENVELOPES["power_band"]
    given = {"low_pu": 0.4, "high_pu": 0.55, "from_s": 1.25}
    assert envelope.of(run, given).excess(run.trace) == 0.0
    assert envelope.of(run, given | {"from_s": 1.0}).excess(run.trace) == pytest.approx(0.25)
    assert envelope.of(run, given | {"from_s": 1.0, "to_s": 0.9}).excess(run.trace) == 0.0
    with pytest.raises(ValueError, match="no parameter within"):
        envelope.of(run, {"within": 1.0})
