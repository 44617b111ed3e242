"""What is called impossible is so for every converter of this current: against a search over all currents, and against
converters with more current, other droops and other references."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.compliance.bench_studies import subject, suite_test
from tests.examples import TIMES
from vsgdesign.campaigns.compliance.applies import impossible, largest_power, not_applicable
from vsgdesign.campaigns.compliance.case import Subject
from vsgdesign.campaigns.compliance.run import run_test
from vsgdesign.campaigns.compliance.suite import Criterion, SuiteTest
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Fault, Load
from vsgdesign.study.parameters.loading import study_from_text

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
    assert after.startswith("After the test P is to be back at 0.85 pu or more, and at SCR 5")
    assert "V_g·I + R·I² = 0.4·" in after


def test_what_is_to_be_back_is_the_power_of_before_within_its_band() -> None:
    """P_ref after the test was compared, without the band: a converter that holds 1.17 of 1.5 pu is not asked for more
    than the 0.5 pu of before."""
    study, over = subject().own_study, Event.of_pu(0.0, P_pu=1.5)
    wide, narrow = (Criterion(measure="P_back_s", at_most=1.0, given=(("band_pu", band),)) for band in (0.2, 0.01))
    assert impossible(study, suite_test(over, scr=20.0, P_pu=0.5, criteria=(narrow,))) is None
    weak = Event.of_pu(0.0, V_g_pu=0.6)
    assert impossible(study, suite_test(weak, P_pu=0.95, criteria=(narrow,))) is not None
    assert impossible(study, suite_test(weak, P_pu=0.95, criteria=(wide,))) is None


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


RESTS = (Criterion(measure="survived", at_least=1.0),)
OPENS = Event.of_pu(0.0, breaker="open")


def test_an_island_larger_than_the_current_is_impossible() -> None:
    study = subject().own_study
    load = Load(R_parallel=1.0 / 1.6)
    words = impossible(study, suite_test(OPENS, load=load, criteria=RESTS))
    assert words is not None
    # 0.85·√(1.6² + 0.0685²) at 47 Hz, where the capacitor takes the least.
    B = 0.94 * study.converter.omega_n * study.filter.C * study.converter.Z_base
    assert f"takes {0.85 * math.hypot(1.6, B):.4g} pu of current or more" in words
    assert "at 47 Hz" in words
    assert impossible(study, suite_test(OPENS, load=Load(R_parallel=1.0), criteria=RESTS)) is None
    # It is connected again: the grid takes over. Without a demand on a rest, what happens is measured.
    closed = Event.of_pu(1.0, breaker="closed")
    assert impossible(study, suite_test(OPENS, closed, load=load, criteria=RESTS)) is None
    peak = (Criterion(measure="peak_after_5ms_pu", at_most=1.3),)
    assert impossible(study, suite_test(OPENS, load=load, criteria=peak)) is None


STUDY = """
base = "case:lab_12kva_lcl"
converter = {{ current_limit_pu = {limit}, current_limiter = "circular" }}
power_loops = {{ P_droop = {P_droop}, Q_droop = {Q_droop} }}
simulation = {{ duration = "8 s", P_ref = "4 kW", Q_ref = "0 var" }}
controllers = [{{ name = "damped", kind = "scheduled", structure = "angle_damped" }}]
"""


def converter(limit: float, P_droop: float = 0.06, Q_droop: float = 0.1) -> Subject:
    study = study_from_text(STUDY.format(limit=limit, P_droop=P_droop, Q_droop=Q_droop))
    return Subject(study=study, spec=study.controllers[0])


def test_an_inductive_island_above_the_nominal_frequency_is_possible() -> None:
    """It was called impossible at 1.2 pu. It ends at 1.12 pu, 0.90 pu of voltage and 52.2 Hz, with a silent limiter:
    X_2 and a higher frequency leave less current."""
    opens = Event.of_pu(0.0, breaker="open", load=Load(L_parallel=1.0 / 1.5))
    test, own = suite_test(opens, P_pu=0.9, criteria=RESTS), converter(1.2)
    assert impossible(own.own_study, test) is None
    run = run_test(own, test)
    assert run.survival.status == "survived"
    assert run.trace is not None
    assert float(np.mean(run.trace.i_s_pu[-100:])) == pytest.approx(1.1234, abs=2e-3)
    assert float(run.trace.limited[-100:].sum()) == 0.0


def least_current(test: SuiteTest) -> float:
    """The current that a test needs, from the words about a converter with hardly any."""
    study = converter(1.0).own_study
    words = impossible(
        replace(study, converter=replace(study.converter, current_limit_pu=0.05)), replace(test, P_pu=0.0)
    )
    assert words is not None
    return float(re.findall(r"takes (\d+\.?\d*) pu of current", words)[0])


def drawn_island(rng: np.random.Generator) -> SuiteTest:
    """An island with a load of any angle, and a set point of the voltage: what it needs is between 0.7 and 1.1 pu."""
    P, Q = rng.uniform(0.1, 0.9), rng.uniform(-0.9, 0.9)
    load = Load(R_parallel=1.0 / P, **{"L_parallel" if Q > 0.0 else "C_parallel": 1.0 / max(abs(Q), 0.05)})
    asked = suite_test(OPENS, load=load, criteria=RESTS, P_pu=0.2)
    size = rng.uniform(0.7, 1.1) / least_current(asked)
    load = Load(**{name: value / size for name, value in vars(load).items() if value is not None})
    opens = Event.of_pu(0.0, breaker="open", load=load, V_ref_pu=rng.uniform(0.85, 1.0))
    return suite_test(opens, criteria=RESTS, P_pu=rng.uniform(-0.2, 0.6), scr=8.0)


def test_no_other_droop_or_reference_makes_an_impossible_island_possible() -> None:
    """Converters with 20 % more current, with drawn droops and set points: what rests needs more than the limit."""
    rng, at_rest = np.random.default_rng(29 if TIMES == 1 else None), 0
    for _ in range(3 * TIMES):
        test = drawn_island(rng)
        limit = least_current(test) / 1.03
        assert impossible(converter(limit).own_study, test) is not None
        run = run_test(converter(1.2 * limit, rng.uniform(0.01, 0.1), rng.uniform(0.01, 0.15)), test)
        if run.survival.status == "survived" and run.trace is not None:
            at_rest += 1
            assert float(np.mean(run.trace.i_s_pu[-100:])) > limit
    assert at_rest >= TIMES


def test_no_other_converter_begins_where_it_is_impossible() -> None:
    """The same of the power before a test: what begins with 20 % more current needs more than the limit."""
    rng, began = np.random.default_rng(3 if TIMES == 1 else None), 0
    for _ in range(3 * TIMES):
        limit = rng.uniform(0.5, 1.0)
        given = {"scr": rng.uniform(1.5, 20.0), "x_over_r": rng.uniform(0.3, 20.0), "V_g_pu": rng.uniform(0.95, 1.05)}
        sign = rng.choice([-1.0, 1.0])
        powers = sign * limit * np.arange(0.7, 1.6, 0.002)
        own = converter(limit).own_study
        refused = [P for P in powers if impossible(own, suite_test(DROP, P_pu=float(P), **given)) is not None]
        run = run_test(
            converter(1.2 * limit, rng.uniform(0.01, 0.1), rng.uniform(0.01, 0.15)),
            suite_test(DROP, P_pu=float(refused[0]), **given),
        )
        if run.trace is not None:
            began += 1
            assert run.trace.i_s_pu[0] > limit
    assert began >= TIMES


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
