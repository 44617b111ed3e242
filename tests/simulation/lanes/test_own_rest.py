"""A switched bridge in lanes: its logs, the pieces that have room for them, and what is found in them."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from tests.simulation.survival.subjects import TEXT
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.blocks import VerificationJob
from vsgdesign.campaigns.verification.counting import MapAxes
from vsgdesign.campaigns.verification.draws import FAMILIES, cases_of, uniforms_of
from vsgdesign.campaigns.verification.emt import EMT
from vsgdesign.metrics.step_response import settling_time
from vsgdesign.simulation.lanes import own_rest
from vsgdesign.simulation.lanes.cases import STEP, LaneCases
from vsgdesign.simulation.lanes.part import first_judged
from vsgdesign.simulation.lanes.rests import SWITCHED_WINDOW
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.survival.cases import settling_time_of
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.study import Study


def a_study() -> Study:
    study = study_from_text(TEXT.replace('kind = "scheduled"', 'kind = "scheduled"\nsettling_time = 0.1', 1))
    return replace(study, controllers=study.controllers[:1])


def drawn(study: Study, count: int) -> LaneCases:
    families = np.resize([FAMILIES.index(name) for name in ("step", "sag", "grid")], count)
    return cases_of(study, study.controllers[0], uniforms_of(7, 0, count), families)[0]


def test_pieces_have_room_for_their_logs(monkeypatch: pytest.MonkeyPatch) -> None:
    study, rng = a_study(), np.random.default_rng(3)
    cases = drawn(study, 500)
    begin = first_judged(cases, study.converter.T_s)
    ends = begin + rng.integers(1000, 3000, 500)
    monkeypatch.setattr(own_rest, "LOG_BYTES", 2_000_000)
    found = list(own_rest.pieces(ends, cases, study.converter.T_s))
    assert sorted(np.concatenate(found).tolist()) == list(range(500))
    assert len(found) > 4
    for some in found:
        assert len(set(cases.kind[some])) == 1
        logged = 1 if cases.kind[some[0]] == STEP else 2
        assert len(some) * (ends[some].max() + 1 - begin[some].min()) * 8 * logged <= 2_000_000
    monkeypatch.setattr(own_rest, "LOG_BYTES", 1)  # one group is the least
    assert {len(some) for some in own_rest.pieces(ends, cases, study.converter.T_s)} <= {16, 167 % 16, 333 % 16}


def test_pieces_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    study = a_study()
    cases = drawn(study, 20)
    whole = run_lanes(study, study.controllers[0], NOTHING, cases, bridge="pwm")
    assert np.isfinite(whole.settling_s).any()
    assert np.isfinite(whole.recovery_s).any()
    monkeypatch.setattr(own_rest, "LOG_BYTES", 1)
    parts = run_lanes(study, study.controllers[0], NOTHING, cases, bridge="pwm")
    for f in fields(whole):
        np.testing.assert_array_equal(getattr(parts, f.name), getattr(whole, f.name), err_msg=f.name)


def test_the_last_entry_is_that_of_each_response_alone() -> None:
    rng, rows, lanes, log_begin = np.random.default_rng(5), 5000, 7, 40
    t = np.arange(rows)
    log = np.exp(-t[:, None] / rng.uniform(200.0, 1500.0, lanes)) * np.cos(t[:, None] / rng.uniform(30.0, 90.0, lanes))
    log[:, 5] = 1e-3  # never outside
    log[:, 6] = 0.5  # never inside
    begin, end = log_begin + rng.integers(0, 300, lanes), log_begin + rows - rng.integers(0, 300, lanes)
    found = own_rest._last_entry(log[:, None], log_begin, begin, end, lambda y: np.abs(y[..., 0, :]), 0.02)
    times = found.time(0.02, 0.25, np.asarray(0.25 * begin, dtype=np.float64))
    for k in range(lanes):
        own: Any = np.abs(log[begin[k] - log_begin : end[k] - log_begin, k])
        instants: Any = 0.25 * np.arange(len(own))
        expected = settling_time(instants, own, 0.02)
        assert times[k] == pytest.approx(np.inf if expected is None else expected, abs=1e-9)
    assert times[5] == 0.0
    assert np.isinf(times[6])


def test_a_switched_bridge_comes_to_its_own_rest_first() -> None:
    study = a_study()
    axes = MapAxes(scr=(1.0, 20.0), x_over_r=(0.3, 20.0), scr_basis="impedance")
    spec, families = study.controllers[0], tuple(FAMILIES)
    job = VerificationJob(
        study=study, spec=spec, tables={}, families=families, promises=(), axes=axes, runs=8, batch=EMT
    )
    first, _ = job.drawn(0, 8)
    later, _ = replace(job, bridge="pwm").drawn(0, 8)
    lead_s = SWITCHED_WINDOW * settling_time_of(study.controllers[0], NOTHING)
    assert (later.events.t_s[:, 0] >= lead_s).all()
    np.testing.assert_allclose(later.cleared_s - later.events.t_s[:, 0], first.cleared_s - first.events.t_s[:, 0])
    np.testing.assert_array_equal(later.R_g, first.R_g)
    rows = uniforms_of(1, 0, 3)
    assert (replace(job, bridge="pwm").cases_of(rows, FAMILIES.index("sag")).events.t_s[:, 0] >= lead_s).all()
