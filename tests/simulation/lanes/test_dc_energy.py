"""What is told beforehand of a source that is full or empty: against a closed form, and against the runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.simulation.one_by_one import run_one
from tests.simulation.test_lanes import study_named
from vsgdesign import event
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import cases_of, families, uniforms_of
from vsgdesign.equations.dc_control import reactive_rest
from vsgdesign.equations.limiter_interface import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.many import DC_ENERGY_IN_DOUBT, DC_FAULTS, Lanes, many_steady_states
from vsgdesign.linear.operating_point.many_rests import reactive_curve
from vsgdesign.simulation.dc_start import dc_columns, moved_rest
from vsgdesign.simulation.lanes import dc_energy, rests
from vsgdesign.simulation.lanes import run as lanes_run
from vsgdesign.simulation.lanes.beforehand import told_beforehand
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.results import BLOCKED, JUDGED
from vsgdesign.simulation.segments import Segments
from vsgdesign.simulation.survival.running import record_of
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.study import ControllerSpec


def battery(study: Study, charge: float, control: str = "power_clamp", **given: Any) -> Study:
    """On a battery whose capacitor stores 20 ms of the rating."""
    c = study.converter
    own = {"R_i": 0.05 * c.V_dc**2 / c.S_rated, "i_max": 1.5 * c.S_rated / c.V_dc, "charge": charge}
    own |= {"capacity_Ah": c.S_rated / c.V_dc, "open_circuit": [(1.03 + 0.02 * k) * c.V_dc for k in range(6)]}
    dc = {"source": "battery", "C": 0.04 * c.S_rated / c.V_dc**2, "control": control, "battery": own | given}
    return study.with_changes(dc=dc)


def test_a_jump_of_the_phase_moves_the_energy_of_its_closed_form() -> None:
    """∫(P − P_ref) dt = −D_p φ (:eq:`dc-jump-by-hand`), for both signs and three grids."""
    study, _ = study_named("survival", "angle_damped")
    study = battery(study, 0.6, "none")
    study = replace(study, converter=replace(study.converter, current_limit_pu=None))
    c, refs = study.converter, study.converter.references()
    S, D_p = c.S_rated, c.S_rated / (0.02 * c.omega_n)
    gains = PowerLoopGains(*(np.full(6, value) for value in (3e-3 * 5000.0 / S, D_p, 2e-3, 50.0, 0.0, 0.0, 4e-4, 0.0)))
    R_g, L_g = (np.tile([0.02, 0.05, 0.1], 2) * c.V_rated_rms**2 * 3.0 / S / k for k in (1.0, 0.1 * c.omega_n))
    refs = refs._replace(P_ref=np.full(6, 0.4 * S), Q_ref=np.zeros(6))
    lanes = Lanes(R_g, L_g, c.V_rated_rms, c.omega_n, *refs)
    start = many_steady_states(study, lanes, gains)
    jump, loops, zero = np.repeat([0.1, -0.1], 3), dc_energy.PhasorLoops(study), np.zeros(6)
    links = dc_energy.links_at_rest(study, start)
    assert links is not None
    i_g = (start.plant[4] + 1j * start.plant[5]) * np.exp(-1j * start.controller.theta)
    x = dc_energy.Swing(start.controller._replace(theta=start.delta - jump), np.full(6, c.omega_n), 0.0, links, i_g)
    grid = Segments(zero, R_g, L_g, np.full(6, c.V_rated_rms), zero, np.full(6, c.omega_n), zero, zero, zero)
    moved = np.zeros(6)
    for _ in range(2500):
        x = loops.step(x, grid, refs, gains, GridEstimate(R_g, L_g))
        moved += dc_energy.STEP_S * (x.state.P_f - refs.P_ref)
    np.testing.assert_allclose(x.state.P_f, refs.P_ref, atol=1e-3 * S)
    np.testing.assert_allclose(moved, -D_p * jump, rtol=0.01)


def test_a_limited_current_is_the_share_of_what_its_loop_asks_for() -> None:
    """i = min(1, I/|w|) w with w = w_0 + A i (:eq:`dc-told`), with feedback that would make an iteration diverge."""
    rng = np.random.default_rng(5)
    drawn_pairs = rng.normal(size=(2, 200, 2)).view(np.complex128)[..., 0]
    asked, fed_back = 8.0 * drawn_pairs[0], 3.0 * drawn_pairs[1] - 4.0
    i = dc_energy.limited_current(asked, fed_back, 1.0)
    w = asked + fed_back * i
    over = np.abs(w) > 1.0 + 1e-9
    assert 20 < over.sum() < 180
    np.testing.assert_allclose(i, np.where(over, w / np.abs(w), w), atol=1e-12)


def test_the_current_of_the_grid_moves_as_its_differential_equation_says() -> None:
    """L di/dt = v − v_g − (R + jωL) i with constant voltages, by DOP853 (:eq:`dc-told-current`)."""
    study = battery(study_named("survival", "angle_damped")[0], 1.0)
    f, omega, zero = study.filter, study.converter.omega_n, np.zeros(1)
    R_g, L_g, v, v_g, before = (
        np.array([0.3]),
        np.array([2e-3]),
        150.0 + 20j,
        np.array([90.0 - 60j]),
        np.array([9 - 4j]),
    )
    grid = Segments(zero, R_g, L_g, zero, zero, np.full(1, omega), zero, zero, zero)
    circuit = dc_energy.PhasorLoops(study)._circuit(grid, v_g, before)
    i_s = (v - circuit.v_g) / circuit.Z + 1j * circuit.omega_C * v
    R, L = 0.3 + f.R_2, 2e-3 + f.L_2
    found = solve_ivp(
        lambda _, i: (v - v_g - (R + 1j * omega * L) * i) / L, (0.0, dc_energy.STEP_S), before, "DOP853", rtol=1e-11
    )
    made, i_g = circuit.at(i_s)
    np.testing.assert_allclose(i_g, found.y[:, -1], rtol=1e-9)
    np.testing.assert_allclose(made, v, rtol=1e-12)


def drawn(study: Study, spec: ControllerSpec, names: tuple[str, ...], count: int) -> LaneCases:
    """Cases of several families in turn."""
    kinds = np.resize([families().index(name) for name in names], count)
    return cases_of(study, spec, uniforms_of(33, 0, count), kinds, NOTHING)[0]


def test_what_is_told_of_a_full_battery_is_lost_in_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine tenths of it, and no other is lost (none in the evidence dc_side). Below full charge nothing is told, and
    nothing is lost."""
    study, spec = study_named("survival", "angle_damped")
    cases, full = drawn(study, spec, ("phase", "ramp", "grid", "sag"), 40), battery(study, 1.0)
    results = lanes_run.run_lanes(full, spec, NOTHING, cases)
    told = np.isin(results.fault, DC_FAULTS)
    assert not (results.status == BLOCKED).any()
    monkeypatch.setattr(rests, "beyond_the_capacitor", lambda *_: np.zeros(len(cases), dtype=bool))
    blocked = lanes_run.run_lanes(full, spec, NOTHING, cases).status == BLOCKED
    assert 10 <= told.sum() <= 30
    assert blocked[told].mean() >= 0.9
    assert not blocked[~told].any()
    below = lanes_run.run_lanes(battery(study, 0.8), spec, NOTHING, cases).status
    assert (below[below >= JUDGED] == JUDGED).all()


def test_a_full_battery_that_gives_something_takes_it_back_and_rests() -> None:
    """From P > 0 to P < 0: the clamp lets it take back what it gave, and the rest moves with it."""
    study, spec = study_named("survival", "angle_damped")
    S, cases, full = study.converter.S_rated, drawn(study, spec, ("reference",), 3), battery(study, 1.0)
    cases.P_ref[:], cases.Q_ref[:] = 0.6 * S, 0.0
    cases.R_g[:], cases.L_g[:] = study.grid.R_g, study.grid.L_g
    cases.events.P_ref[:, 0], cases.events.Q_ref[:, 0] = -0.4 * S, np.nan
    results, own = lanes_run.run_lanes(full, spec, NOTHING, cases), full.with_limit_of(spec)
    assert (results.status == JUDGED).all()
    run = run_one(full, spec, NOTHING, cases, 0, "averaged")
    assert run.dc_log is not None
    link = run.timeline.link_at(1.0)
    moved = moved_rest(own, link, run.dc_log)
    end = run.dc_log[-1, dc_columns(own).index("memory.charge")]
    assert link is not None
    given, room = link.values, 3600.0 * link.values["capacity_Ah"] * (1.0 - end) / link.hold  # A
    taken = room * (given["open_circuit"][-1] + given["R_i"] * room)
    assert moved is not None
    assert moved.P[-1] == pytest.approx(-taken, rel=1e-4)
    assert run.column("P")[-1] == pytest.approx(moved.P[-1], abs=0.005 * S)


def test_the_reactive_power_of_a_moved_rest_belongs_to_its_power() -> None:
    """On a weak grid of much resistance Q changes by more than the band between the rests; in a batch and alone."""
    study, spec = study_named("survival", "angle_damped")
    S, cases, full = study.converter.S_rated, drawn(study, spec, ("reference",), 3), battery(study, 1.0)
    cases.P_ref[:], cases.Q_ref[:] = 0.6 * S, 0.0
    cases.R_g[:], cases.L_g[:] = 2.5, 2.5 / study.converter.omega_n
    cases.events.P_ref[:, 0], cases.events.Q_ref[:, 0] = -0.4 * S, np.nan
    assert (lanes_run.run_lanes(full, spec, NOTHING, cases).status == JUDGED).all()
    run, own = run_one(full, spec, NOTHING, cases, 0, "averaged"), full.with_limit_of(spec)
    seen, lanes = (
        record_of(own, run).Q[-1],
        Lanes(2.5, 2.5 / study.converter.omega_n, 110.0, study.converter.omega_n, 0.0, 0.0),
    )
    gains = run.gain_changes[-1].gains
    at_zero = many_steady_states(study, lanes, gains).Q[0]
    assert abs(run.column("Q")[-1] - at_zero) > 0.02 * S
    assert seen == pytest.approx(at_zero, abs=0.005 * S)
    asked = -0.4 * S
    curve = reactive_curve(study, lanes._replace(P_ref=asked), gains, np.array([0.0]))
    for P in np.linspace(asked, 0.0, 6):
        rest = many_steady_states(study, lanes._replace(P_ref=P), gains).Q[0]
        assert reactive_rest(P, curve) == pytest.approx(rest, abs=5e-3 * S)  # a quarter of the band


def test_what_is_told_of_an_empty_battery_is_lost_in_a_run() -> None:
    """Jumps of the phase and sags that an empty battery would have to feed: its link collapses. At most one of twelve
    is told and survives (2 of 99 in docs/theory/dc-side.md), and one is lost that was not told."""
    study, spec = study_named("survival", "angle_damped")
    cases, empty = drawn(study, spec, ("phase", "sag"), 12), battery(study, 0.0)
    told = np.isin(lanes_run.run_lanes(empty, spec, NOTHING, cases).fault, DC_FAULTS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rests, "beyond_the_capacitor", lambda *_: np.zeros(len(cases), dtype=bool))
        blocked = lanes_run.run_lanes(empty, spec, NOTHING, cases).status == BLOCKED
    assert told.sum() >= 6
    assert (told & ~blocked).sum() <= 1
    assert blocked[~told].sum() <= 1


def test_an_empty_battery_without_power_rests() -> None:
    """No current is within the limits of an empty and of a full battery, whatever the rounding."""
    for charge in (0.0, 1.0):
        study = battery(study_named("survival", "angle_damped")[0], charge)
        assert study.dc is not None
        c = study.converter
        v = study.dc.at_rest(0.0, c, study.filter).v
        assert v == pytest.approx((1.03 + 0.1 * charge) * c.V_dc, rel=1e-12)


def test_a_study_is_told_what_its_events_ask_of_a_full_battery() -> None:
    """By the same sum; with room in the battery nothing is told."""
    given, spec = study_named("survival", "angle_damped")
    given = given.with_events(event("0.5 s", phase_jump="-40 deg")).with_changes(simulation={"P_ref": 0.0})
    full, below = (replace(battery(given, charge), controllers=(spec,)) for charge in (1.0, 0.8))
    (said,) = told_beforehand(full)
    assert said.startswith("angle_damped: not possible, because the events move more energy than")
    assert told_beforehand(below) == told_beforehand(given) == ()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rests, "beyond_the_capacitor", lambda *_: np.array([DC_ENERGY_IN_DOUBT]))
        (said,) = told_beforehand(below)
    assert said.startswith("angle_damped: in doubt, because the events may move more energy than")
