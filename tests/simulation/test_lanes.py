"""A batch of runs against one run after the other: states, figures and verdicts."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.one_by_one import numbers, run_one, step_of, verdict_of
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import cases_of, families, uniforms_of
from vsgdesign.equations.controller import ControllerState
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.metrics.survival import ExpectedRest
from vsgdesign.simulation.lanes import run as lanes_run
from vsgdesign.simulation.lanes.cases import STEP, LaneCases, segments_of
from vsgdesign.simulation.lanes.rests import Rests, last_of, rests_of
from vsgdesign.simulation.lanes.results import JUDGED, LaneResults
from vsgdesign.simulation.lanes.telling import telling
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.simulation.survival.running import own_rest_of
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import ControllerSpec, Study

SEED = 7


@functools.cache
def study_named(name: str, controller: str) -> tuple[Study, ControllerSpec]:
    study = load_study(f"studies/{name}/study.toml")
    return study, next(spec for spec in study.controllers if spec.name == controller)


def drawn(study: Study, spec: ControllerSpec, family: str, count: int) -> LaneCases:
    return cases_of(study, spec, uniforms_of(SEED, 0, count), families().index(family), NOTHING)[0]


def rests_in(study: Study, spec: ControllerSpec, cases: LaneCases) -> Rests:
    """Where each case of a batch is at rest."""
    own = study.with_limit_of(spec)
    told, demand = telling(own, spec, NOTHING, cases), demand_of(own.converter, settling_time_of(spec, NOTHING))
    return rests_of(own, cases, segments_of(cases), told, demand, LaneResults.of_none(len(cases)))[0]


def states_after(study: Study, spec: ControllerSpec, cases: LaneCases) -> np.ndarray:
    """Every state at the end of each case of a batch."""
    own = study.with_limit_of(spec)
    results, told, segments = LaneResults.of_none(len(cases)), telling(own, spec, NOTHING, cases), segments_of(cases)
    demand = demand_of(own.converter, settling_time_of(spec, NOTHING))
    rests, gains = rests_of(own, cases, segments, told, demand, results)
    good = np.flatnonzero(results.status == JUDGED)
    parts = lanes_run.parts_of(own, cases, segments, rests, demand, good, "averaged", False)
    ends = {int(end) for part in parts for end in part.ends}
    lanes_run.drive(parts, told, gains, stop_at=min(ends) if len(ends) == 1 else None)
    rows = []
    for part in parts:
        names = [f"state.{name}" for name in ControllerState._fields if name != "limiter"]
        names += [name for name in part.place if name.startswith("state.limiter.")]
        plant = part.span("x")
        rows.append((part.index, [part.get(k) for k in range(plant.start, plant.stop)] + [part.get(n) for n in names]))
    states = np.full((len(cases), len(rows[0][1])), np.nan)
    for index, values in rows:
        states[index] = np.array(values).T
    return states


@pytest.mark.parametrize(
    ("name", "controller", "family"),
    [
        ("survival", "decoupled", "step"),
        ("laboratory", "scheduled", "step"),
        ("survival", "decoupled", "grid"),
        ("survival", "decoupled", "sag"),
        ("survival", "decoupled", "ramp"),
        ("utility", "scheduled", "grid"),
        ("laboratory", "fixed", "ramp"),
    ],
)
def test_figures_of_a_batch_are_those_of_single_runs(name: str, controller: str, family: str) -> None:
    study, spec = study_named(name, controller)
    cases = drawn(study, spec, family, 5)
    own, T = study.with_limit_of(spec), settling_time_of(spec, NOTHING)
    results, rests = lanes_run.run_lanes(study, spec, NOTHING, cases), rests_in(study, spec, cases)
    last = last_of(segments_of(cases))
    assert (results.status >= JUDGED).sum() >= 4
    for k in np.flatnonzero(results.status >= JUDGED).tolist():
        run = run_one(study, spec, NOTHING, cases, k, "averaged")
        if cases.kind[k] == STEP:
            final = (rests.P_end if cases.signal[k] == 0 else rests.Q_end)[k]
            overshoot, settling = step_of(own, run, cases, k, float(final))
            assert results.overshoot[k] == pytest.approx(overshoot, abs=1e-9)
            assert results.settling_s[k] == pytest.approx(settling, abs=1e-8)
            continue
        rest = ExpectedRest(
            P=float(rests.P_end[k]), Q=float(rests.Q_end[k]), delta=float(rests.delta_end[k]), i_s_pu=0.5
        )
        verdict, _ = verdict_of(own, run, cases, k, rest, T, float(last.omega[k]))
        assert verdict.survived == (results.status[k] == JUDGED)
        recovery = np.inf if verdict.recovery_s is None else verdict.recovery_s
        assert results.recovery_s[k] == pytest.approx(recovery, abs=1e-8)
        assert results.peak_pu[k] == pytest.approx(verdict.peak_pu, abs=1e-9)
        assert results.first_peak_pu[k] == pytest.approx(verdict.first_peak_pu, abs=1e-9)
        assert results.limited_s[k] == pytest.approx(verdict.limited_s, abs=1e-12)
        # The judge takes the source's phase a millionth of a sample later.
        assert results.swing_rad[k] == pytest.approx(verdict.swing_rad, abs=1e-7)


def test_a_switched_bridge_with_events_inside_its_intervals() -> None:
    study, spec = study_named("survival", "decoupled")
    own, T = study.with_limit_of(spec), settling_time_of(spec, NOTHING)
    for family in ("sag", "ramp"):
        cases = drawn(study, spec, family, 2)
        rests = rests_in(study, spec, cases)
        results = lanes_run.run_lanes(study, spec, NOTHING, cases, bridge="pwm")
        demand = demand_of(own.converter, T)
        for k in np.flatnonzero(results.status >= JUDGED).tolist():
            run = run_one(study, spec, NOTHING, cases, k, "pwm")
            rest = ExpectedRest(
                P=float(rests.P_end[k]), Q=float(rests.Q_end[k]), delta=float(rests.delta_end[k]), i_s_pu=0.5
            )
            omega_end = float(last_of(segments_of(cases)).omega[k])
            verdict, record = verdict_of(own, run, cases, k, rest, T, omega_end)
            beside = verdict.recovery_s
            rest = own_rest_of(rest, record, replace(demand, cycle_s=2.0 * np.pi / omega_end))
            verdict, _ = verdict_of(own, run, cases, k, rest, T, omega_end)
            assert verdict.recovery_s is not None
            # It has a rest of its own: a batch without one would be wrong by a hundred times what it is allowed.
            assert beside != pytest.approx(verdict.recovery_s, abs=1e-6)
            assert results.recovery_s[k] == pytest.approx(verdict.recovery_s, abs=1e-8)
            assert results.peak_pu[k] == pytest.approx(verdict.peak_pu, abs=1e-9)
            assert results.limited_s[k] == pytest.approx(verdict.limited_s, abs=1e-12)


@pytest.mark.parametrize(("name", "controller"), [("survival", "published"), ("laboratory", "scheduled")])
def test_every_state_at_the_end_of_a_step(name: str, controller: str) -> None:
    study, spec = study_named(name, controller)
    cases = drawn(study, spec, "step", 4)
    # The same instant for all: then all end at the same sample.
    cases.events.t_s[:] = 0.1037
    results, states = lanes_run.run_lanes(study, spec, NOTHING, cases), states_after(study, spec, cases)
    c = study.converter
    for k in np.flatnonzero(results.status >= JUDGED).tolist():
        one = numbers(run_one(study, spec, NOTHING, cases, k, "averaged"))
        currents, rest = np.abs(one - states[k])[[0, 1, 4, 5]], np.abs(one - states[k])
        assert currents.max() < 1e-10 * c.I_rated_pk
        assert rest[[9, 10]].max() < 1e-10 * c.S_rated  # P_f, Q_f
        assert (rest / np.maximum(np.abs(one), 1.0)).max() < 1e-9


def test_segments_are_those_of_the_timeline() -> None:
    study, spec = study_named("survival", "decoupled")
    for family in ("ramp", "sag", "grid"):
        cases = drawn(study, spec, family, 6)
        segments = segments_of(cases)
        from tests.simulation.one_by_one import study_of

        for k in range(6):
            timeline = build_timeline(study_of(study, cases, k, 1.0))
            used = np.isfinite(segments.t_s[k])
            assert used.sum() == len({s.t_s for s in timeline.sources} | {t for t, _ in timeline.grids})
            for j in np.flatnonzero(used):
                source, grid = timeline.source_at(segments.t_s[k, j]), timeline.grid_at(segments.t_s[k, j])
                assert (segments.R_g[k, j], segments.L_g[k, j]) == (grid.R_g, grid.L_g)
                found = [getattr(segments, name)[k, j] for name in ("V_g_rms", "V_slope", "omega", "omega_slope")]
                assert found == pytest.approx([source.V_g_rms, source.V_slope, source.omega, source.omega_slope])
                assert segments.phase[k, j] == pytest.approx(source.phase, abs=1e-12)


def test_a_batch_does_not_depend_on_its_neighbours() -> None:
    study, spec = study_named("survival", "decoupled")
    cases = drawn(study, spec, "grid", 20)
    together = lanes_run.run_lanes(study, spec, NOTHING, cases)
    apart = lanes_run.run_lanes(study, spec, NOTHING, cases.take(np.arange(3, 8)))
    for name in ("status", "recovery_s", "peak_pu", "swing_rad"):
        np.testing.assert_array_equal(getattr(apart, name), getattr(together, name)[3:8])


def test_strict_runs_have_the_same_bits_on_every_instruction_set(monkeypatch: pytest.MonkeyPatch) -> None:
    study, spec = study_named("survival", "decoupled")
    cases = drawn(study, spec, "sag", 9)
    native = lanes_run.run_lanes(study, spec, NOTHING, cases, strict=True)
    monkeypatch.setattr(lanes_run, "parts_of", functools.partial(lanes_run.parts_of, target="sse2"))
    oldest = lanes_run.run_lanes(study, spec, NOTHING, cases, strict=True)
    loose = lanes_run.run_lanes(study, spec, NOTHING, cases)
    for name in ("status", "recovery_s", "first_peak_pu", "peak_pu", "limited_s", "swing_rad"):
        np.testing.assert_array_equal(getattr(native, name), getattr(oldest, name))
    assert (native.recovery_s != loose.recovery_s).any()  # else nothing was compared


def test_what_cannot_be_run_in_a_batch_is_refused() -> None:
    study, spec = study_named("survival", "decoupled")
    odd = replace(study, converter=replace(study.converter, samples_per_carrier=3))
    with pytest.raises(InfeasibleStudyError, match="even number"):
        lanes_run.run_lanes(odd, spec, NOTHING, drawn(study, spec, "grid", 2), bridge="pwm")
