"""A converter that trips and connects again in the EMT. The exported C: tests/export/test_synchronising.py."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.parameters.documents import case_document, the_fault
from tests.simulation.finding import found_in
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation import build_timeline, simulate
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation
from vsgdesign.study.parameters import Study, study_from_text

TRIP = """
[[events]]
time = "0.05 s"
breaker = "open"
[[events]]
time = "0.0701 s"
breaker = "closed"
synchronise = true
"""


def tripped(case: str, events: str = TRIP, more: str = "") -> Study:
    study = study_from_text(f"""
base = "case:{case}"
controllers = [{{ name = "any", kind = "scheduled", structure = "angle_damped" }}]
converter = {{ current_limit_pu = 1.2, current_limiter = "projection" }}
inner_loops = {{ transient_resistance_pu = 0.08 }}
simulation = {{ duration = "1 s", P_ref = "0 W", Q_ref = "0 var" }}
[grid]
scr_basis = "impedance"
scr = 20
x_over_r = 5
components = [{{ order = -1, amplitude_pu = 0.01 }}, {{ order = -5, amplitude_pu = 0.02 }}]
{more}
{events}
""")
    return replace(study, simulation=replace(study.simulation, log_interval=study.converter.T_s))


def run_of(study: Study) -> Simulation:
    return simulate(study, feed_of(study, study.controllers[0], build_timeline(study), NOTHING))


def test_without_synchronising_there_is_a_surge() -> None:
    """The same with P_ref = 0.5 pu, which drives the free converter away: it closes out of phase at the same time."""
    apart = TRIP.replace('"0.0701 s"', '"0.4 s"').replace("synchronise = true\n", "")
    study = tripped("hoang2025_5kva", apart)
    study = replace(study, simulation=replace(study.simulation, P_ref=2500.0))
    run = run_of(study)
    current = np.hypot(run.column("i_g_alpha"), run.column("i_g_beta")) / study.converter.I_rated_pk
    assert current[run.t_s > 0.39].max() > 1.0


@pytest.mark.parametrize(
    ("event", "field", "problem"),
    [
        ({"synchronise": True}, "events[1].synchronise", "which this event does not"),
        ({"breaker": "closed", "synchronise": True, "synchro_check": {}}, "events[1].synchronise", "synchro_check"),
        ({"breaker": "closed", "synchronise": True, "load": {"P_pu": 1}}, "events[1].synchronise", "a load"),
        ({"breaker": "closed", "synchronise": 1}, "events[1].synchronise", "true or false"),
    ],
)
def test_faults(event: dict[str, Any], field: str, problem: str) -> None:
    events = [{"time": 1.0, "breaker": "open"}, {"time": 2.0} | event]
    assert problem in the_fault(case_document() | {"events": events}, field).problem


def test_what_cannot_be_synchronised_is_said() -> None:
    with pytest.raises(InfeasibleStudyError, match=r"synchronise: .*\[background\]"):
        run_of(tripped("hoang2025_5kva", more="[background]\n"))
    dark = TRIP + '[[events]]\ntime = "0.06 s"\nV_g_pu = 0.0\n'
    study = tripped("hoang2025_5kva", dark)
    study = replace(study, simulation=replace(study.simulation, duration=0.15))
    found = found_in(study)
    assert [event.name for event in found.events][-1] == "converter synchronises: the breaker never closes"
    assert not build_timeline(found).network_at(0.14).connected
