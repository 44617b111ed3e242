"""What is told of a source that is full or empty: against a sum by hand, and of every command alike."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from evidence._dc_sums import refused
from tests.simulation.one_by_one import run_one
from tests.simulation.test_lanes import study_named
from vsgdesign import event, simulate
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import cases_of, families, uniforms_of
from vsgdesign.equations.dc_control import reactive_rest
from vsgdesign.equations.dc_source_interface import DcRatings
from vsgdesign.equations.dc_sources import DC_SOURCES
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.many import DC_ENERGY, Lanes, many_steady_states
from vsgdesign.linear.operating_point.many_rests import reactive_curve
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.dc_beyond import said_of_energy
from vsgdesign.simulation.dc_start import dc_columns, moved_rest
from vsgdesign.simulation.lanes import part
from vsgdesign.simulation.lanes import run as lanes_run
from vsgdesign.simulation.lanes.beforehand import told_beforehand
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.results import BLOCKED, JUDGED
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


def drawn(study: Study, spec: ControllerSpec, names: tuple[str, ...], count: int) -> LaneCases:
    """Cases of several families in turn."""
    kinds = np.resize([families().index(name) for name in names], count)
    return cases_of(study, spec, uniforms_of(33, 0, count), kinds, NOTHING)[0]


def test_what_is_told_of_a_full_battery_is_refused_by_hand_as_well() -> None:
    """All but one of twenty, by a sum that is made apart (:mod:`evidence._dc_sums`), and no bridge is blocked that is
    not told. Below full charge nothing is told, and nothing is lost."""
    study, spec = study_named("survival", "angle_damped")
    cases, full = drawn(study, spec, ("phase", "ramp", "grid", "sag"), 40), battery(study, 1.0)
    results = lanes_run.run_lanes(full, spec, NOTHING, cases)
    told = results.fault == DC_ENERGY
    assert not (results.status == BLOCKED).any()
    assert 10 <= told.sum() <= 30
    assert (told & ~refused(full, spec, cases)).sum() <= 1
    assert (np.isfinite(results.dc_beyond_j) == told).all()
    assert (results.dc_beyond_j[told] > 0.0).all()
    below = lanes_run.run_lanes(battery(study, 0.8), spec, NOTHING, cases).status
    assert (below[below >= JUDGED] == JUDGED).all()


def thrown(study: Study, charge: float = 1.0) -> Study:
    """On a battery, with a jump of the phase that pushes more into a full one than its capacitor takes."""
    one = study.with_events(event("0.5 s", phase_jump="-40 deg"))
    return battery(one.with_changes(simulation={"P_ref": 0.0, "duration": 2.0}), charge)


def test_one_figure_is_told_by_every_command() -> None:
    """Of a case in a batch, of a run of the same study, and without a run of its own."""
    given, spec = study_named("survival", "angle_damped")
    full = replace(thrown(given), controllers=(spec,))
    results = lanes_run.run_lanes(full, spec, NOTHING, LaneCases.of_studies([full]))
    assert results.fault.tolist() == [DC_ENERGY]
    said = said_of_energy(float(results.dc_beyond_j[0]))
    assert said.startswith("not possible, because the events move ")
    warned: list[str] = []
    run = simulate(full, warn=warned.append)
    outcome = run.result.controllers[0].outcome
    assert outcome.status == "blocked"
    assert str(outcome.reason).endswith(f"; what is asked for is {said}")
    assert warned == [f"angle_damped: {said}."] == list(told_beforehand(full))
    assert told_beforehand(full, run=False) == told_beforehand(thrown(given, 0.8)) == ()


def test_what_no_link_survives_is_not_excused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without angle damping the converter swings for seconds. Its battery is full, so that nothing but the run on a
    stiff link says that the control is at fault."""
    given, spec = study_named("survival", "angle_damped")
    gains = gain_law(given, spec, NOTHING)(given.grid.R_g, given.grid.L_g, 0.0, 0.0, given.converter.V_rated_rms)
    wrong = replace(spec, kind="fixed", gains=PowerLoopGains(*map(float, gains))._replace(k_P=0.0))
    study = replace(thrown(given), controllers=(wrong,))
    results = lanes_run.run_lanes(study, wrong, NOTHING, LaneCases.of_studies([study]))
    assert results.status.tolist() == [BLOCKED]
    assert results.fault.tolist() == [0]
    assert np.isnan(results.dc_beyond_j).all()
    assert told_beforehand(study) == ()
    monkeypatch.setattr(lanes_run, "_tell_of_source", lambda *_: None)
    assert lanes_run.run_lanes(study, wrong, NOTHING, LaneCases.of_studies([study])).dc_beyond_j[0] > 0.0


def test_a_clamp_that_asks_for_too_much_is_not_excused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clamp of the loop takes the charge for one that lasts for ever: it fills the battery, and the bridge blocks.
    With the clamp as it is, the same case survives."""
    study, spec = study_named("survival", "angle_damped")
    S, cases, full = study.converter.S_rated, drawn(study, spec, ("reference",), 1), battery(study, 1.0)
    cases.P_ref[:], cases.Q_ref[:], cases.events.P_ref[:, 0], cases.events.Q_ref[:, 0] = 0.6 * S, 0.0, -0.4 * S, np.nan
    cases.R_g[:], cases.L_g[:] = study.grid.R_g, study.grid.L_g
    assert lanes_run.run_lanes(full, spec, NOTHING, cases).status.tolist() == [JUDGED]
    rest = part._rest_link

    def broken(own: part.Part, *rests: Any) -> None:
        rest(own, *rests)
        own.put("clamp_of.hold", np.full(len(own), 1e-6))

    monkeypatch.setattr(part, "_rest_link", broken)
    results = lanes_run.run_lanes(full, spec, NOTHING, cases)
    assert results.status.tolist() == [BLOCKED]
    assert np.isnan(results.dc_beyond_j).all()


@pytest.mark.parametrize(
    ("source", "given", "v", "p", "left"),
    [
        ("battery", {"R_i": 1.0, "i_max": 10.0, "capacity_Ah": 1.0, "charge": 0.5}, 400.0, 0.0, (True, True)),
        ("battery", {"R_i": 1.0, "i_max": 10.0, "capacity_Ah": 1.0, "charge": 0.5}, 380.0, 0.0, (False, True)),
        ("battery", {"R_i": 1.0, "i_max": 10.0, "capacity_Ah": 1.0, "charge": 0.5}, 420.0, 0.0, (True, False)),
        ("battery", {"R_i": 1.0, "i_max": 10.0, "capacity_Ah": 1.0, "charge": 1.0}, 424.0, 0.0, (True, False)),
        ("converter", {"p_max": 5e3, "p_charge_max": 1e3, "energy": 2e4, "charge": 0.0}, 400.0, 0.0, (False, True)),
        ("converter", {"p_max": 5e3, "p_charge_max": 1e3, "energy": 2e4}, 400.0, 5001.0, (False, True)),
        ("converter", {"p_max": 5e3, "p_charge_max": 1e3, "energy": 2e4}, 400.0, -1001.0, (True, False)),
        ("photovoltaic", {"modules": 8, "strings": 2}, 300.0, 0.0, (False, False)),
        ("photovoltaic", {"modules": 8, "strings": 2}, 440.0, 0.0, (True, False)),
    ],
)
def test_what_a_source_could_still_do(
    source: str, given: dict[str, float], v: float, p: float, left: tuple[bool, bool]
) -> None:
    """At a limit of its current or its power, or at an end of its charge, it could do no more in that direction."""
    ratings = DcRatings(1e-4, 400.0, 1e-3, np.inf, 5e3)
    kind = DC_SOURCES[source]
    values = kind.values(ratings, given)
    constants = kind.build(ratings, values)
    _, memory = kind.rest(0.0, ratings, constants, values)
    assert kind.left is not None
    found = kind.left(memory, v, p, constants)
    assert (found.give > 0.0, found.take > 0.0) == left


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


def test_what_an_empty_battery_cannot_give_is_told() -> None:
    """Jumps of the phase and sags that it would have to feed: its link collapses. All but one of twelve that are told
    are refused by hand as well."""
    study, spec = study_named("survival", "angle_damped")
    cases, empty = drawn(study, spec, ("phase", "sag"), 12), battery(study, 0.0)
    results = lanes_run.run_lanes(empty, spec, NOTHING, cases)
    told = results.fault == DC_ENERGY
    assert told.sum() >= 4
    assert not (results.status == BLOCKED).any()
    assert (results.dc_beyond_j[told] < 0.0).all()
    assert (told & ~refused(empty, spec, cases)).sum() <= 1


def test_an_empty_battery_without_power_rests() -> None:
    """No current is within the limits of an empty and of a full battery, whatever the rounding."""
    for charge in (0.0, 1.0):
        study = battery(study_named("survival", "angle_damped")[0], charge)
        assert study.dc is not None
        c = study.converter
        v = study.dc.at_rest(0.0, c, study.filter).v
        assert v == pytest.approx((1.03 + 0.1 * charge) * c.V_dc, rel=1e-12)
