"""What is called impossible is so for every converter of this current: against a search over all currents."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from tests.compliance.bench_studies import subject, suite_test
from vsgdesign.campaigns.compliance.applies import impossible, largest_power, not_applicable
from vsgdesign.campaigns.compliance.run import run_test
from vsgdesign.campaigns.compliance.suite import Criterion
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.network import Fault, Load

DROP = Event.of_pu(0.0, P_pu=0.1)


@pytest.mark.parametrize("seed", range(12))
def test_the_largest_power_is_that_of_a_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    V_g, R, X = rng.uniform(0.2, 1.1), rng.uniform(0.01, 0.6), rng.uniform(0.05, 0.9)
    most_i, most_V = rng.uniform(0.5, 1.5), rng.uniform(1.0, 1.2)
    length, angle = np.meshgrid(np.linspace(0.0, most_i, 700), np.linspace(-math.pi, math.pi, 1401))
    i = length * np.exp(1j * angle)
    V = V_g + complex(R, X) * i
    P = np.where(np.abs(V) <= most_V, (V * i.conj()).real, -np.inf)
    found, words = largest_power(V_g, R, X, most_i, most_V)
    assert found == pytest.approx(float(P.max()), abs=4e-3)
    assert found >= float(P.max()) - 1e-9
    assert float(re.findall(r"= (\d+\.?\d*) pu", words)[-1]) == pytest.approx(found, rel=1e-3)


def test_a_power_beyond_the_grid_is_impossible_before_or_after() -> None:
    study = subject().own_study
    before = impossible(study, suite_test(DROP, scr=1.2, x_over_r=20.0, P_pu=1.5))
    assert before is not None
    assert before.startswith("Before the test P_ref = 1.5 pu is asked for")
    back = Criterion(measure="P_back_s", at_most=1.0)
    after = impossible(study, suite_test(Event.of_pu(0.0, V_g_pu=0.4), P_pu=0.9, criteria=(back,)))
    assert after is not None
    assert after.startswith("After the test P_ref = 0.9 pu")
    assert "V_g·I + R·I² = 0.4·" in after


def test_a_converter_survives_at_its_limit_what_the_grid_does_not_carry() -> None:
    """Such rows were called impossible for any converter, and this one is at rest with 97 % of what there is."""
    weaker = Event.of_pu(0.0, scr=1.5, x_over_r=2.0)
    test = suite_test(weaker, scr=20.0, x_over_r=2.0, P_pu=-0.9, criteria=(Criterion(measure="survived", at_least=1),))
    assert impossible(subject().own_study, test) is None
    run = run_test(subject(), test)
    assert run.survival.status == "survived"
    assert run.trace is not None
    R = 1.0 / 1.5 / math.hypot(1.0, 2.0)
    most = 1.2 - R * 1.2**2
    assert -0.9 < float(np.mean(run.trace.P_pu[-100:])) < -0.9 * most


def test_a_grid_at_another_frequency_asks_a_droop_for_less() -> None:
    event, back = Event.of_pu(0.0, V_g_pu=0.4, df_hz=0.5), Criterion(measure="P_back_s", at_most=1.0)
    assert impossible(subject().own_study, suite_test(event, P_pu=0.9, criteria=(back,))) is None


def test_a_fault_that_is_cleared_is_possible() -> None:
    study = subject().own_study
    cleared = Event.of_pu(0.2, fault="cleared")
    assert impossible(study, suite_test(Event.of_pu(0.0, fault=Fault()), cleared)) is None
    assert impossible(study, suite_test(Event.of_pu(0.0, V_g_pu=0.0), Event.of_pu(0.2, V_g_pu=1.0))) is None


def test_charging_beyond_the_current_is_impossible() -> None:
    words = impossible(subject().own_study, suite_test(DROP, P_pu=-1.4))
    assert words is not None
    assert "V_g·I − R·I²" in words


def test_an_island_larger_than_the_current_is_impossible() -> None:
    study = subject().own_study
    opens = Event.of_pu(0.0, breaker="open")
    load = Load(R_parallel=1.0 / 1.6)
    words = impossible(study, suite_test(opens, load=load))
    assert words is not None
    assert "takes 1.6 pu at the nominal voltage, which is 1.6·0.85 = 1.36 pu" in words
    assert impossible(study, suite_test(opens, load=Load(R_parallel=1.0))) is None
    # It is connected again: the grid takes over.
    assert impossible(study, suite_test(opens, Event.of_pu(1.0, breaker="closed"), load=load)) is None


def test_without_a_limit_nothing_is_impossible() -> None:
    assert impossible(subject("fixed").own_study, suite_test(DROP, scr=1.2, x_over_r=20.0, P_pu=1.5)) is None


def test_needs_are_said_with_their_reason() -> None:
    assert not_applicable(subject(), suite_test(DROP, needs=("50 Hz", "current limit", "schedule", "storage"))) is None
    why = not_applicable(subject("fixed"), suite_test(DROP, needs=("60 Hz", "current limit", "schedule")))
    assert why == (
        "the test is for a grid of 60 Hz, and the converter is made for 50 Hz; the controller has no current limit; "
        "the controller has fixed gains, and no schedule that could be late"
    )
    with pytest.raises(ValueError, match="needs = gold"):
        not_applicable(subject(), suite_test(DROP, needs=("gold",)))
