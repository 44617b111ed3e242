"""Tests of a suite on a plant of equal units: the run of one of them is that of all in one loop, and the mode that it
does not show is that of the model of the whole plant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.compliance.bench_studies import TEXT, judged_test, suite_test
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.compliance.case import Subject, case_of
from vsgdesign.campaigns.compliance.rows import FAIL, PASS
from vsgdesign.campaigns.compliance.run import run_test
from vsgdesign.campaigns.compliance.suite import OURS, Criterion, Source, Suite
from vsgdesign.errors import StudyError
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.simulation.units import plant_timeline, simulate_plant
from vsgdesign.simulation.units.scenario import run_plant
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Grid, Load, Network
from vsgdesign.study.parameters.loading import study_from_text
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.comply import study_for_suites
from vsgdesign.verbs.pipeline.one_unit import written_as_unit

PLANT = "\n[grid]\nscr = 5\nx_over_r = 5\n[plant]\nunits = 3\nreactance = 0.04\nresistance = 0.01\n"
SUITE = Suite(name="made", title="made", about="", source=Source(document="", edition="", confidence=OURS), tests=())


def plant_study() -> Study:
    """Three 5 kVA units behind 4 %."""
    return study_from_text(TEXT.replace("CASE", "hoang2025_5kva") + PLANT)


def subject_of(study: Study) -> Subject:
    """A unit of the plant with its first controller."""
    own = written_as_unit(study, "this test")
    return Subject(study=own, spec=own.controllers[0], units=3)


def as_plant(study: Study, one: Study) -> Study:
    """The plant of which ``one`` is a unit, with its own grid, load and events."""
    assert study.plant is not None
    asked = {"P_ref": one.simulation.P_ref, "Q_ref": one.simulation.Q_ref}

    def shared(grid: Grid | None) -> Grid | None:
        return None if grid is None else Grid(grid.R_g / 3.0, grid.L_g / 3.0)

    def load(network: Network | None) -> Network | None:
        if network is None or network.load is None:
            return network
        return replace(network, load=network.load.times(1.0 / 3.0))

    grid, network = shared(one.grid), load(one.network)
    assert grid is not None
    assert network is not None
    return replace(
        one,
        filter=study.filter,
        plant=replace(study.plant, units=tuple(replace(unit, **asked) for unit in study.plant.units)),
        grid=grid,
        network=network,
        events=tuple(replace(e, grid=shared(e.grid), network=load(e.network)) for e in one.events),
    )


def test_a_run_is_that_of_all_units_in_one_loop() -> None:
    """A jump of the grid with a load at the common node, a ramp of the frequency, and a sag."""
    study = plant_study()
    subject = subject_of(study)
    assert subject.study.filter.L_2 > 0.0 == study.filter.L_2
    test = suite_test(
        Event.of_pu(0.0, scr=3.0, x_over_r=5.0, phase_deg=10.0),
        Event.of_pu(0.05, df_hz=0.5, over_s=0.1),
        Event.of_pu(0.2, V_g_pu=0.6),
        Event.of_pu(0.3, V_g_pu=1.0),
        P_pu=0.5,
        load=Load(R_parallel=2.0),
    )
    one = run_test(subject, test)
    simulation = one.simulation
    assert simulation is not None
    whole = as_plant(study, one.study)
    timeline = plant_timeline(whole, one.spec)
    told = build_timeline(one.study)  # of the grid without the load
    feeds: list[Any] = [feed_of(one.study, one.spec, told, NOTHING) for _ in timeline.units]
    run = simulate_plant(whole, feeds, timeline=timeline)
    rows = min(len(run.t_s), len(simulation.t_s))
    for name in ("P", "Q", "omega", "V_rms"):
        expected, scale = simulation.column(name)[:rows], np.abs(simulation.column(name)).max()
        for unit in run.units:
            assert np.abs(unit.column(name)[:rows] - expected).max() < 1e-6 * scale, name


@pytest.mark.parametrize(("scr", "verdict"), [(1.3, FAIL), (12.0, PASS)])
def test_the_units_against_each_other(scr: float, verdict: str) -> None:
    """Gains for a weak grid are too high for x_t alone: no run of units that move alike shows it, and the row fails.
    The decay is that of the split of the whole plant's model."""
    study = plant_study()
    subject = subject_of(study)
    survives = Criterion(measure="survived", at_least=1.0)
    test = suite_test(Event.of_pu(0.0, phase_deg=5.0), scr=scr, P_pu=0.3, criteria=(survives,))
    row = judged_test(subject, SUITE, test).row
    check = row.checks[-1]
    assert (row.status, row.verdict, check.verdict) == ("survived", verdict, verdict)
    whole = as_plant(study, case_of(subject, test))
    whole = replace(whole, simulation=replace(whole.simulation, survival=False), controllers=whole.controllers[:1])
    found = run_plant(whole).controllers[0]
    split = found.rests[0].split  # with the powers of the end
    assert split is not None
    assert check.value == pytest.approx(-split.differential[0].s.real, rel=1e-3)
    growth = f"the units grow against each other with {int(split.differential[0].s.real)}"
    assert row.why.partition(".")[0] == growth if verdict == FAIL else not row.why
    assert (found.outcome.status == "unstable") == (verdict == FAIL)  # rounding is enough to begin it


def test_what_a_plant_needs() -> None:
    """Own probes do not move alike; one common estimator does."""
    study = replace(plant_study(), controllers=(replace(plant_study().controllers[0], estimate="field"),))
    with pytest.raises(StudyError, match="probes of their own"):
        study_for_suites(written_as_unit(study, "this test"), (), 3)
    assert study.plant is not None
    common = replace(study, plant=replace(study.plant, common_estimate=True))
    assert study_for_suites(written_as_unit(common, "this test"), (), 3).plant is None
