"""Runs of the EMT as measures see them: of the published 5 kVA converter, with given gains, on a given grid."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from tests.compliance.made_runs import SOURCE
from vsgdesign.campaigns.compliance.measures import MeasureInput, Ratings
from vsgdesign.campaigns.compliance.run import nfp_of, trace_of
from vsgdesign.campaigns.compliance.suite import SuiteTest
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.stability.maps import gains_in_force
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.run import simulate
from vsgdesign.simulation.steps import references_at
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.loading import study_from_text
from vsgdesign.study.parameters.study import Study

INTERVAL_S = 5e-4


@cache
def study_of(structure: str, case: str = "hoang2025_5kva", **more: Any) -> Study:
    """A case with one scheduled controller of this structure."""
    fields = {"tau_P": "5 ms", "tau_Q": "5 ms", "structure": structure} | more
    runs = '[simulation]\nduration = "1 s"\nP_ref = "0 W"\nQ_ref = "0 var"\n[[controllers]]\nname = "own"'
    lines = "\n".join(f'{name} = "{value}"' for name, value in fields.items())
    return study_from_text(f'base = "case:{case}"\n[power_loops]\n{lines}\n{runs}\nkind = "scheduled"\n')


def real_run(study: Study, test: SuiteTest, gains: PowerLoopGains | None = None) -> tuple[MeasureInput, PowerLoopGains]:
    """A test's run with averaged bridge and constant gains, those of the study's controller unless others are given,
    and the gains."""
    c, spec = study.converter, study.controllers[0]
    grid = Place(test.scr, test.x_over_r, study.scr_basis).grid(c)
    P, Q = test.P_pu * c.S_rated, test.Q_pu * c.S_rated
    if gains is None:
        found = gains_in_force(
            study, gain_law(study, spec), np.array([grid.R_g]), np.array([grid.L_g]), np.array([P]), np.array([Q])
        )
        gains = PowerLoopGains(*(float(np.ravel(value)[0]) for value in found))
    P_ref, Q_ref = references_at(study, grid, gains, P, Q)
    last = test.events[-1]
    simulation = replace(
        study.simulation,
        duration=last.end_s + (test.duration_s or 1.0),
        bridge="averaged",
        start="steady_state",
        log_interval=c.T_s,
        P_ref=P_ref,
        Q_ref=Q_ref,
    )
    own = replace(
        study.undisturbed, grid=grid, simulation=simulation, events=tuple(event.on(c) for event in test.events)
    )
    run = simulate(own, [GainChange(0.0, gains)]).to_its_end()
    trace = trace_of(own, run, max(round(INTERVAL_S / c.T_s), 1), 0.0)
    ratings = Ratings.of(study, spec)
    return MeasureInput(test=test, trace=trace, ratings=ratings, gains=gains, nfp=nfp_of(own, gains)), gains


def grid_test(*events: Event, **more: Any) -> SuiteTest:
    """A test of these events."""
    return SuiteTest(id="real", group="real", title="real", source=SOURCE, events=events, **more)
