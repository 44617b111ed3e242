"""The limiters of the literature against their formulas, in complex numbers."""

from __future__ import annotations

import cmath
import math
from typing import Any

import pytest

from vsgdesign.equations.controller_data import ControllerSettings
from vsgdesign.equations.inner_loops import InnerLoopGains, voltage_integrators
from vsgdesign.equations.limiters import GridEstimate, LimiterRatings, LimiterView, limiter_named
from vsgdesign.equations.limiters.projection import within_bridge
from vsgdesign.equations.power_loops import PowerLoopGains, References

RATINGS = LimiterRatings(
    T_s=1e-4,
    V_rated_pk=100.0,
    I_rated_pk=10.0,
    i_max_pk=12.0,
    Z_base=10.0,
    omega_0=314.0,
    R_2=0.0,
    L_2=0.0,
    V_low_pu=0.85,
    V_high_pu=1.25,
)
K_PV, K_IV = 0.08, 20.0


def answer(name: str, want: complex, e: complex = 3.0 - 1.0j, i_g: complex = 1j, **given: float) -> Any:
    """The limiter's answer at rest, and the step of the voltage integrators that follows from it, in A."""
    limiter = limiter_named(name)
    settings = ControllerSettings(
        1e-4, 1.0, 1.0, 0.0, 0.0, 12.0, 200.0, 1.0, 0.0, limiter=limiter.constants(RATINGS, given)
    )
    seen = {"i_g_d": i_g.real, "i_g_q": i_g.imag, "e_d": e.real, "e_q": e.imag, "i_want_d": want.real}
    seen |= {"i_want_q": want.imag, "V": 70.0, "omega_i": 314.0, "P": 5.0, "Q": 6.0, "K_pv": K_PV}
    view = LimiterView(**dict.fromkeys(LimiterView._fields, 0.0) | seen)
    memory = limiter.at_rest(view, 314.0, settings)
    found = limiter.law.limit(
        memory,
        view,
        GridEstimate(0.1, 1e-3),
        References(5.0, 6.0, 314.0, 70.0),
        PowerLoopGains(1.0, 1.0, 1.0, 1.0),
        settings,
    )
    cut = complex(found.i_ref_d, found.i_ref_q) - want
    gains = InnerLoopGains(K_PV, K_IV, 1.0, 1.0)
    step = voltage_integrators(found.e_d, found.e_q, cut.real, cut.imag, 0.0, 0.0, gains, RATINGS.T_s)
    assert (found.P, found.Q) == (5.0, 6.0)
    return found, complex(found.i_ref_d, found.i_ref_q), complex(*step)


@pytest.mark.parametrize("name", ["circular", "threshold_impedance", "saturation", "hybrid"])
def test_inside_the_limit_nothing_changes(name: str) -> None:
    found, i_ref, step = answer(name, 11.9 * cmath.exp(0.7j))
    assert found.limited == 0.0
    assert i_ref == 11.9 * cmath.exp(0.7j)
    assert step == pytest.approx(RATINGS.T_s * K_IV * (3.0 - 1.0j))


def test_saturation_has_the_given_angle() -> None:
    found, i_ref, _ = answer("saturation", -30.0 + 5j, current_angle=-0.4)
    assert found.limited == 1.0
    assert i_ref == pytest.approx(12.0 * cmath.exp(-0.4j))


def test_hybrid_feeds_the_removed_current_back_through_its_impedance() -> None:
    want = 20.0 * cmath.exp(0.7j)
    _, i_ref, step = answer("hybrid", want, feedback_resistance_pu=0.3, feedback_reactance_pu=0.7)
    assert i_ref == pytest.approx(12.0 * cmath.exp(0.7j))
    assert step == pytest.approx(RATINGS.T_s * K_IV * (3.0 - 1.0j - (3.0 + 7.0j) * (want - i_ref)))


def test_threshold_impedance_drops_the_given_voltage_at_the_limit() -> None:
    """In a bolted fault, v = 0, the impedance alone leaves no error at I_max; below its threshold it is nothing."""
    i_g = 12.0 * cmath.exp(-1.2j)
    want, e = 5.0 + 2.0j, 100.0 + 0.0j
    found, i_ref, step = answer("threshold_impedance", want, e, i_g)
    drop = 100.0 * (1.0 + 5.0j) / math.sqrt(26.0) * cmath.exp(-1.2j)
    assert i_ref == pytest.approx(want - K_PV * drop)
    assert step == pytest.approx(RATINGS.T_s * K_IV * (e - drop))
    assert found.limited == 1.0
    assert answer("threshold_impedance", want, e, 9.99 * i_g / 12.0)[1] == want


@pytest.mark.parametrize("size", [0.5, 6.0, 12.0])
def test_a_limited_current_needs_no_more_than_the_voltage_of_the_bridge(size: float) -> None:
    """What it gives up is the voltage beyond the limit over the impedance, in complex numbers."""
    Z, v_g, i = 0.4 + 2.1j, 90.0 * cmath.exp(0.3j), size * cmath.exp(-1.0j)
    given = i.real, i.imag, v_g.real, v_g.imag, Z.real, Z.imag, 100.0
    u, found = v_g + Z * i, complex(*within_bridge(*given, 1.0))
    assert (abs(u) > 100.0) == (size > 5.0)
    if abs(u) <= 100.0:
        assert found == i
    else:
        assert v_g + Z * found == pytest.approx(100.0 * u / abs(u), rel=1e-12)
    assert complex(*within_bridge(*given, 0.0)) == i
