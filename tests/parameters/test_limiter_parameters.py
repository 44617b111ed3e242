"""The parameters of a current limiter in a study: defaults from the ratings, and one message for all faults."""

from __future__ import annotations

import math

import pytest

from vsgdesign.errors import StudyError
from vsgdesign.study.parameters import Study, study_from_text

STUDY = """base = "case:hoang2025_5kva"
[converter]
{converter}
[simulation]
duration = "1 s"
P_ref = "1 kW"
Q_ref = "0 var"
[[controllers]]
name = "a"
kind = "fixed"
{controller}
"""
PROJECTION = 'current_limit_pu = 1.2\ncurrent_limiter = "projection"\n'


def study(converter: str = "", controller: str = "") -> Study:
    return study_from_text(STUDY.format(converter=converter, controller=controller))


def faults(converter: str = "", controller: str = "") -> str:
    with pytest.raises(StudyError) as caught:
        study(converter, controller)
    return str(caught.value)


def test_defaults_follow_from_the_ratings() -> None:
    found = study(PROJECTION)
    c, own = found.converter, found.controller_settings().limiter
    assert own.i_soft_pk == pytest.approx(1.15 * math.sqrt(2.0) * 5000.0 / 3.0 / 110.0, rel=1e-12)
    assert own.Z_v == pytest.approx(0.2 * 3.0 * 110.0**2 / 5000.0, rel=1e-12)
    assert (own.V_low, own.V_high) == (pytest.approx(0.70 * 110.0), pytest.approx(1.30 * 110.0))
    assert own.share == pytest.approx(1.0 - math.exp(-c.T_s / 20e-3), rel=1e-9)
    assert own.g * own.largest_pull / c.T_s == pytest.approx(20.0, rel=1e-12)  # rad/s²


def test_a_study_sets_them_with_their_units() -> None:
    found = study(PROJECTION + '[converter.limiter]\npull_time = "40 ms"\nsoft_limit_pu = 1.1\n')
    assert found.limiter_given == (("soft_limit_pu", 1.1), ("pull_time", 0.04))
    assert found.limiter_values["frequency_pull"] == pytest.approx(6.25)  # 1/(4 · 40 ms): the default follows
    assert found.controller_settings().limiter.i_soft_pk == pytest.approx(1.1 * found.converter.I_rated_pk)


def test_all_faults_come_at_once_with_their_limits() -> None:
    text = faults(
        PROJECTION
        + '[converter.limiter]\nsoft_limit_pu = 1.3\npull_time = "1 s"\ngate_voltage_pu = nan\n'
        + 'frequency_pull = "-2 1/s"\nangle = 3\n'
    )
    assert "5 faults" in text
    assert "converter.limiter.soft_limit_pu = 1.3: outside 0.84 to 1.2" in text
    assert "converter.limiter.pull_time" in text
    assert "outside 5 ms to 200 ms" in text
    assert "converter.limiter.gate_voltage_pu" in text
    assert "must be a finite number" in text
    assert "converter.limiter.angle: unknown parameter" in text
    assert 'current_limiter = "projection" has the parameters soft_limit_pu, virtual_impedance_pu' in text


def test_a_parameter_of_another_limiter_is_refused() -> None:
    text = faults("current_limit_pu = 1.2\n[converter.limiter]\npull_time = 0.02\n")
    assert 'converter.limiter.pull_time: unknown parameter. current_limiter = "circular" has no parameters.' in text
    assert "there is no current limit" in faults(
        'current_limiter = "projection"\n[converter.limiter]\npull_time = 0.02\n'
    )
    with pytest.raises(ValueError, match="pull_time: current_limiter"):
        study("current_limit_pu = 1.2\n").limiter.constants(None, {"pull_time": 0.02})  # type: ignore[arg-type]


def test_a_controller_has_its_own_or_those_of_the_study() -> None:
    converter = PROJECTION + '[converter.limiter]\npull_time = "30 ms"\n'
    inherited = study(converter, "current_limit_pu = 1.5\n")
    with_it = inherited.with_limit_of(inherited.controllers[0])
    assert with_it.limiter_values["pull_time"] == 0.03
    assert with_it.limiter_values["soft_limit_pu"] == pytest.approx(1.15 / 1.2 * 1.5)
    own = study(converter, 'limiter = { pull_time = "40 ms", gate_voltage_pu = 0.2 }\n')
    assert dict(own.with_limit_of(own.controllers[0]).limiter_given) == {"pull_time": 0.04, "gate_voltage_pu": 0.2}
    other = study(converter, 'current_limiter = "circular"\n')
    assert other.with_limit_of(other.controllers[0]).limiter_given == ()
    assert "has no effect" in faults(converter, 'current_limiter = "none"\nlimiter = { pull_time = "40 ms" }\n')
    shared = PROJECTION + "[converter.limiter]\nsoft_limit_pu = 1.15\n"
    assert "outside 0.7 to 1 with this controller's limit" in faults(shared, "current_limit_pu = 1.0\n")
