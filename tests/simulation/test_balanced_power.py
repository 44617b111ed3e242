"""The limiter `balanced_power`: against an independent integration, as a linear model, and what it does in a fault."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.oracles.emt_dc import WithLink
from tests.oracles.emt_reference import run_reference
from tests.oracles.emt_sequence import reference_over_current
from tests.simulation.one_by_one import run_one, verdict_of
from tests.simulation.studies import GAINS, lc_study, lcl_study
from tests.simulation.test_dc_link import BATTERY
from tests.simulation.test_emt_against_dop853 import errors_pu, library_start
from tests.simulation.test_lanes import drawn, rests_in, study_named
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.equations.frames import clarke_inverse
from vsgdesign.equations.limiters import BALANCED_POWER, PROJECTION
from vsgdesign.equations.limiters.balanced_power import BalancedConstants, BalancedMemory
from vsgdesign.equations.limiters.projection import ProjectionConstants, ProjectionMemory
from vsgdesign.linear.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.metrics.survival import ExpectedRest
from vsgdesign.simulation import GainChange, Simulation, gain_changes, simulate
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.simulation.energy import dc_energy_steps
from vsgdesign.simulation.lanes.cases import segments_of
from vsgdesign.simulation.lanes.rests import last_of
from vsgdesign.simulation.lanes.results import JUDGED
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.survival.cases import settling_time_of
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.study.parameters.grid import Place

STUDIES = Path(__file__).resolve().parents[2] / "studies" / "survival"

TWO_PHASES = '[[events]]\ntime = "3.007 ms"\nsag = { type = "C", V_pu = 0.7 }\n'


def balanced(study: Study, limit_pu: float = 3.0, **given: float) -> Study:
    converter = replace(study.converter, current_limit_pu=limit_pu)
    return replace(study, converter=converter, current_limiter="balanced_power", limiter_given=tuple(given.items()))


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_against_dop853(build: Any) -> None:
    """Circuit, controller and dc link in a two-phase sag: 1e-8 of rated is asked for the link, 1e-9 for the others."""
    study = balanced(build("18 ms", TWO_PHASES + BATTERY))
    assert study.dc is not None
    gains = [GainChange(0.0, GAINS)]
    run = simulate(study, gains, log_states=10**9)
    assert run.dc_log is not None
    names = dc_columns(study)
    first = dict(zip(names, run.dc_log[0].tolist(), strict=True))
    memory = [value for name, value in first.items() if name.startswith("memory.")]
    link = WithLink(study, first["v"], first["p"], memory)
    errors = errors_pu(study, run, run_reference(study, gains, False, library_start(study, gains), circuits=link))
    errors["v_dc"] = float(np.abs(run.dc_log[:, names.index("v")] - link.trace).max()) / study.converter.V_dc
    print({name: f"{e:.1e}" for name, e in errors.items()})
    assert run.column("limited_samples")[-1] == 0.0
    nu = np.hypot(run.controller_log[:, -2], run.controller_log[:, -1])
    assert nu.max() > 0.05 * np.sqrt(2.0) * study.converter.V_rated_rms
    assert errors.pop("v_dc") < 1e-8
    assert max(errors.values()) < 1e-9, errors


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_the_impedance_is_that_of_the_loop(build: Any) -> None:
    study = balanced(build("1 ms"))
    c, f, g = study.controller_settings().limiter, study.filter, study.grid
    rate = study.converter.T_s / (10e-3 * 0.75 * np.sqrt(2.0) * study.converter.V_rated_rms)
    Z = f.R_2 + 0.5 * g.R_g - 1j * study.converter.omega_n * (f.L_2 + 0.5 * g.L_g)
    found = Z * complex(c.of_grid_d, c.of_grid_q) + complex(c.own_d, c.own_q)
    assert found / rate == pytest.approx(reference_over_current(study), rel=1e-12)


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_without_a_ripple_nothing_changes(build: Any) -> None:
    """A step of P: the run has the bits of `projection`."""
    study = build("60 ms", '[[events]]\ntime = "10 ms"\nP_ref = "2.5 kW"\n')
    own = balanced(study, 1.2)
    on, off = (
        simulate(one, [GainChange(0.0, GAINS)], log_states=10**9)
        for one in (own, replace(own, current_limiter="projection"))
    )
    assert on.log.tobytes() == off.log.tobytes()
    assert on.controller_log[:, :-5].tobytes() == off.controller_log.tobytes()
    assert not on.controller_log[:, -2:].any()
    assert np.abs(on.controller_log[:, -5]).max() > 0.0  # the notch hears the step


def model_of(study: Study) -> FullOrderModel:
    return linearise_full_order(study, [Cell(study.grid, GAINS, 1500.0, 300.0)])


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_entries_of_the_linear_model(build: Any) -> None:
    """Every entry of the sampled matrix against central differences of fourth order, 1e-9 of the largest of its row.
    With a dead zone the model is that of `projection`."""
    model = model_of(balanced(build("1 ms"), untouched_ripple_pu=0.0))
    z, p = model.z[0], model.p[0]
    unit = np.maximum(np.abs(z), 1e-2)
    unit[[model.states.index(f"limiter_{name}") for name in ("ripple", "nu_d", "nu_q")]] = 10.0, 1.0, 1.0
    found = np.empty_like(model.A[0])
    for k in range(len(z)):
        d = np.zeros_like(z)
        d[k] = 1e-3 * unit[k]
        at = [np.array(model.map.step(z + j * d, p)[0]).ravel() for j in (-2, -1, 1, 2)]
        found[:, k] = (at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * d[k])
    scaled = [A * unit[None, :] for A in (found, model.A[0])]
    largest = np.maximum(np.abs(scaled[1]).max(axis=1, keepdims=True), 1e-30)
    assert np.abs((scaled[0] - scaled[1]) / largest).max() <= 1e-9
    nu = [model.states.index(f"limiter_nu_{axis}") for axis in "dq"]
    assert np.abs(model.A[0][nu]).max(axis=0)[model.states.index("i_s_d")] > 0.0  # the loop is closed
    assert np.abs(np.linalg.eigvals(model.A[0])).max() < 1.0
    still, plain = (
        model_of(replace(balanced(build("1 ms")), current_limiter=n)) for n in ("balanced_power", "projection")
    )
    n = len(plain.states)
    np.testing.assert_array_equal(still.A[0][:n, :n], plain.A[0])
    assert not still.A[0][nu][:, : nu[0]].any()


def fault(file: str, sag: dict[str, Any], limiter: str) -> tuple[Study, Simulation]:
    """0.4 s of a sag at SCR 6 and X/R 5, half of rated, every sample logged."""
    study = load_study(STUDIES / file)
    c = study.converter
    grid = Place(6.0, 5.0, study.scr_basis).grid(c)
    spec = next(spec for spec in study.controllers if spec.name == "angle_damped")
    simulation = replace(
        study.simulation, duration=0.6, log_interval=c.T_s, P_ref=-0.4 * c.S_rated, Q_ref=0.0, csv_interval=0.0
    )
    dc = {"source": "converter", "C": 0.2 * c.S_rated / c.V_dc**2}
    dc |= {"converter": {"p_max": 1.3 * c.S_rated, "p_charge_max": 1.3 * c.S_rated, "tau": "5 ms"}}
    study = study.with_events({"time": 0.05, "sag": sag}).with_changes(dc=dc)
    study = replace(study, grid=grid, simulation=simulation, current_limiter=limiter)
    study = replace(study, controllers=(replace(spec, kind="fixed", design_grid=grid),))
    return study, simulate(study, gain_changes(study, study.controllers[0], build_timeline(study)))


def twice(study: Study, values: np.ndarray) -> float:
    """Amplitude at twice the nominal frequency in the last five cycles."""
    c = study.converter
    count = round(10.0 * np.pi / c.omega_n / c.T_s)
    turn = np.exp(-2j * c.omega_n * c.T_s * np.arange(count))
    return float(2.0 * abs(np.mean(values[-count:] * turn)))


@pytest.mark.parametrize("file", ["laboratory.toml", "utility.toml"])
@pytest.mark.parametrize("sag", [{"type": "B", "V_pu": 0.5}, {"type": "D", "V_pu": 0.7}], ids=["one", "two"])
def test_the_power_does_not_ripple_in_a_fault(file: str, sag: dict[str, Any]) -> None:
    """One phase, and two phases: the ripple at 2ω falls by more than 90 %, and that of the link is p/(2ω C v)."""
    power, link = {}, {}
    for limiter in ("projection", "balanced_power"):
        study, run = fault(file, sag, limiter)
        c = study.converter
        assert run.dc_log is not None
        assert study.dc is not None
        v = run.dc_log[:, dc_columns(study).index("v")]
        power[limiter], link[limiter] = twice(study, dc_energy_steps(run.log.T, study)) / c.T_s, twice(study, v)
        by_hand = power[limiter] / (2.0 * c.omega_n * study.dc.C * v[-1000:].mean())
        assert link[limiter] == pytest.approx(by_hand, rel=0.03)
        phases = np.array(clarke_inverse(run.column("i_s_alpha"), run.column("i_s_beta"))) / c.I_rated_pk
        late = run.t_s > 0.055
        assert np.abs(phases[:, late]).max() < 1.2 * 1.01
    print(file, sag, power, link)
    assert power["projection"] > 0.1 * c.S_rated
    assert power["balanced_power"] < 0.1 * power["projection"]
    assert link["balanced_power"] < 0.1 * link["projection"]


def test_a_batch_is_its_single_runs() -> None:
    """Random sags of types A to G: recovery, peaks and the time in the limiter of lanes and of single runs."""
    study, spec = study_named("survival", "decoupled")
    study = replace(study, current_limiter="balanced_power")
    cases = drawn(study, spec, "sag", 5)
    results = run_lanes(study, spec, NOTHING, cases)
    rests, T = rests_in(study, spec, cases), settling_time_of(spec, NOTHING)
    last = last_of(segments_of(cases))
    judged = np.flatnonzero(results.status >= JUDGED).tolist()
    assert len(judged) >= 4
    for k in judged:
        run = run_one(study, spec, NOTHING, cases, k, "averaged")
        P, Q, delta = (float(getattr(rests, name)[k]) for name in ("P_end", "Q_end", "delta_end"))
        rest = ExpectedRest(P=P, Q=Q, delta=delta, i_s_pu=0.5)
        verdict, _ = verdict_of(study.with_limit_of(spec), run, cases, k, rest, T, float(last.omega[k]))
        assert results.recovery_s[k] == pytest.approx(verdict.recovery_s, abs=1e-8)
        assert results.peak_pu[k] == pytest.approx(verdict.peak_pu, abs=1e-9)
        assert results.limited_s[k] == pytest.approx(verdict.limited_s, abs=1e-12)


def test_it_has_the_parameters_of_projection() -> None:
    """Its constants and its memory begin with those of `projection`, which is given to it as they are."""
    own = ["balance_time", "untouched_ripple_pu", "negative_sequence_pu"]
    assert [one.name for one in BALANCED_POWER.parameters] == [*(one.name for one in PROJECTION.parameters), *own]
    assert BalancedConstants._fields[: len(ProjectionConstants._fields)] == ProjectionConstants._fields
    assert BalancedMemory._fields[: len(ProjectionMemory._fields)] == ProjectionMemory._fields
