"""What a program reads of the records that run on a converter."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.export.exchange import written
from vsgdesign.export.field import converter_constants, converter_numbers
from vsgdesign.runtime import load_scheduler
from vsgdesign.study.parameters import load_study

STUDY = """
base = "case:lab_12kva_lcl"
[simulation]
duration = "10 ms"
P_ref = "4 kW"
Q_ref = "0 var"
[[controllers]]
name = "published"
kind = "scheduled"
"""
WITHOUT_START = ("Measurement", "ControllerOutput", "SchedulerInput", "FieldAnswer")


def test_every_number_has_unit_meaning_and_start(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(STUDY)
    study = load_study(tmp_path / "study.toml")
    scheduler = load_scheduler(written(tmp_path)[0])
    records = converter_numbers(scheduler, converter_constants(study))
    assert sum(map(len, records.values())) > 300
    for name, numbers in records.items():
        assert len({number.name for number in numbers}) == len(numbers)
        for number in numbers:
            assert number.unit, number
            assert number.meaning, number
            assert not number.meaning.endswith(f", {number.unit}"), number
            if name in WITHOUT_START:
                assert number.start is None or number.name == "limited"
            else:
                assert number.start is not None, number
                assert math.isfinite(number.start)
    found = {f"{name}.{number.name}": number for name, numbers in records.items() for number in numbers}
    state, lost = found["SchedulerState.age"], scheduler.settings.lost_ticks + 1
    assert (state.unit, state.whole, state.start) == ("ticks", True, lost)
    assert found["SchedulerState.gains.K_ip"].unit == "rad/(s²·W)"
    assert found["SchedulerState.gains.K_ip"].start == scheduler.gains.K_ip
    assert found["ControllerState.xi_vd"].unit == "A peak"
    assert found["ControllerState.V"].start == pytest.approx(study.converter.V_rated_rms)
    assert found["References.V_n"] == found["References.V_n"]._replace(unit="V phase rms", whole=False)
    assert found["LockIn.omega"].unit == "rad/s"
