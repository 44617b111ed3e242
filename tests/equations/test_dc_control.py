"""The clamp of the power: an exact zero where the source can give what is asked for, and its closed form where not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vsgdesign as vd
from tests.simulation.event_kinds import TEXT
from vsgdesign.equations.dc_control import clamp_cut
from vsgdesign.equations.dc_source_interface import SourceLimits
from vsgdesign.equations.dc_sources.photovoltaic import array_curve
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import Study, study_from_text

SPECIFICATION = {
    "settling_time": "0.5 s",
    "P": ["0 W", "4 kW"],
    "Q": ["0 var", "1 kvar"],
    "scr": [2, 8],
    "x_over_r": [1, 5],
}
STAGE: dict[str, Any] = {"p_max": "3 kW", "p_charge_max": "1 kW", "tau": "5 ms"}


def study_with(events: str, control: str = "power_clamp", C: str = "100 mF", **given: Any) -> Study:
    study = study_from_text(TEXT + events)
    dc = {"source": "converter", "C": C, "control": control, "converter": STAGE | given}
    return study.with_changes(dc=dc)


def test_cut_in_closed_form() -> None:
    refs, gains = References(2000.0, 0.0, 314.0, 230.0), PowerLoopGains(1.0, 500.0, 1.0, 0.0)
    limits = SourceLimits(-1000.0, 3000.0)
    for omega, expected in ((314.0, 0.0), (312.5, 0.0), (311.0, -600.0), (322.0, 1000.0)):
        cut = clamp_cut(omega, refs, gains, limits, 100.0)
        assert cut == expected
        assert math.copysign(1.0, cut) == math.copysign(1.0, expected)
    empty = clamp_cut(314.0, refs, gains, SourceLimits(-1000.0, 0.0), 100.0)
    assert refs.P_ref + empty == -100.0  # it takes its own losses from the grid
    full = clamp_cut(314.0, refs, gains, SourceLimits(0.0, 50.0), 100.0)
    assert refs.P_ref + full == -50.0


def test_it_changes_no_bit_where_the_source_can_give_what_is_asked_for() -> None:
    events = "[[events]]\ntime = '0.1 s'\nP_ref = '2.8 kW'\n[[events]]\ntime = '0.5 s'\nphase_jump = '20 deg'\n"
    runs = [run_scenario(study_with(events, control)).controllers[0].simulation for control in ("none", "power_clamp")]
    np.testing.assert_array_equal(runs[0].log, runs[1].log)
    assert runs[0].dc_log is not None
    assert runs[1].dc_log is not None
    np.testing.assert_array_equal(runs[0].dc_log, runs[1].dc_log[:, : runs[0].dc_log.shape[1]])


def test_a_clamped_run_rests_at_what_the_source_gives_and_does_not_wind_up() -> None:
    """After a second at the limit, the power follows a new reference as if it had come from the limit itself."""
    asked = "[[events]]\ntime = '0.1 s'\nP_ref = '{}'\n[[events]]\ntime = '1.2 s'\nP_ref = '1 kW'\n"
    study = study_with(asked.format("6 kW"))
    assert study.dc is not None
    own = study.with_limit_of(study.controllers[0])
    limit = 3000.0 - study.dc.clamp(own.converter, own.filter).own
    one = run_scenario(study).controllers[0]
    assert one.outcome.status == "settled"
    assert [rest.P_pcc for rest in one.rests[1:]] == pytest.approx([limit, 1000.0], abs=1e-6)
    P, t = one.simulation.column("P"), one.simulation.t_s
    assert P[t < 1.2][-1] == pytest.approx(limit, abs=1e-3 * study.converter.S_rated)
    assert one.dc is not None
    assert one.dc.most_p_w <= 3000.0 * 1.05
    cut = 6000.0 - limit
    assert (one.dc.cut_most_w, one.dc.cut_j) == pytest.approx((cut, 1.1 * cut), rel=5e-3)
    assert one.dc.cut_s == pytest.approx(1.1, abs=2e-4)
    assert one.dc.cut_words.startswith("up to 3 kW of what was asked for was missing")
    direct = run_scenario(study_with(asked.format(f"{limit} W"))).controllers[0].simulation
    late = t > 1.2
    assert np.abs(P[late] - direct.column("P")[late]).max() < 1e-3 * study.converter.S_rated


def test_the_slow_part_of_the_droop_is_limited() -> None:
    """At 49.7 Hz a droop of 5 % asks for 2 kW + 0.12 · 5 kW, and the source gives 2.2 kW."""
    one = run_scenario(study_with("[[events]]\ntime = '0.1 s'\nf_g = 49.7\n", p_max="2.2 kW")).controllers[0]
    assert one.outcome.status == "settled"
    P = one.simulation.column("P")[-1]
    assert pytest.approx(one.rests[-1].P_pcc, abs=2.0) == P
    assert 2150.0 < P < 2200.0


def test_a_nearly_empty_source_gives_what_lasts() -> None:
    """2 kW of 9 kJ: what is left decays with the time that it is to last for, and the link stays up."""
    study = study_with("[[events]]\ntime = '0.1 s'\nP_ref = '2.5 kW'\n", energy=20000, charge=0.35)
    study = replace(study, dc=replace(study.dc, hold=1.0))  # type: ignore[type-var]
    one = run_scenario(study).controllers[0]
    assert one.simulation.dc_log is not None
    left = one.simulation.dc_log[:, dc_columns(study).index("memory.stored")]
    t = one.simulation.t_s
    late = (t > 2.0) & (t < 2.4)
    assert one.outcome.status != "blocked"
    assert left[-1] > 0.0
    rate = -np.polyfit(t[late], np.log(left[late]), 1)[0]
    assert 0.8 < rate < 1.2


def test_limits_of_the_sources() -> None:
    """Against the rests: the limit is one, and 3 % more is none."""
    for dc, most in (
        ({"source": "battery", "battery": {"R_i": "1 ohm", "i_max": 5, "capacity_Ah": 1}}, None),
        ({"source": "photovoltaic", "photovoltaic": {"modules": 16, "strings": 1}}, None),
        ({"source": "converter", "converter": {"p_max": "3 kW", "energy": 10000, "charge": 0.1}}, 200.0),
    ):
        study = study_from_text(TEXT).with_changes(dc=dc | {"C": "1 mF"})
        assert study.dc is not None
        of = study.converter, study.filter
        limits = study.dc.can_give(*of)
        study.dc.at_rest(0.999 * limits.high, *of)
        if most is not None:
            assert limits.high == most
            continue
        with pytest.raises(Exception, match=r"dc: .*(gives|would give)"):
            study.dc.at_rest(1.03 * limits.high, *of)
        if dc["source"] == "photovoltaic":
            v, i = array_curve(study.dc.settings(*of).source)
            assert limits.high == pytest.approx(0.98 * (v * i)[v >= study.dc.V_low].max(), rel=1e-9)


def test_what_knows_no_voltage_of_the_link_refuses_a_droop_of_it() -> None:
    study = study_with("", "voltage_droop")
    for verb in (vd.certify, vd.compare):
        with pytest.raises(vd.VsgDesignError, match="knows no voltage of the link"):
            verb(study)
    (spec,) = study.controllers
    tabled = study.with_changes(
        specification=SPECIFICATION, controllers=[{"name": spec.name, "kind": "scheduled", "schedule": "table"}]
    )
    with pytest.raises(vd.VsgDesignError, match="a gain table knows no voltage of the link"):
        vd.design_table(tabled)
    assert "has no closed form" in " ".join(vd.design_study(study).sentences())
