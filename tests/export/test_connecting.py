"""A converter that trips and connects again in the EMT: the exported C does the same with the same samples."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.export.conftest import built
from tests.export.exchange import written
from tests.parameters.documents import case_document, the_fault
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.equations.controller_data import Measurement
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import References
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.export import export_c_files
from vsgdesign.parameters import Study, study_from_text
from vsgdesign.simulation import build_timeline, simulate
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.reclosing import reclosed
from vsgdesign.simulation.run import Simulation

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


def test_the_exported_code_sets_the_same_angle_and_closes_at_the_same_sample(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    study = tripped("utility_1mva_60hz")
    found = reclosed(study, study.controllers[0])
    run, c = run_of(found), study.converter
    closing = next(event for event in found.events if event.name == "breaker closes in step")
    place = tmp_path_factory.mktemp("connecting")
    compiled = built(export_c_files(written(place)[0], place / "c", limiter="projection").folder, double=True)
    control = compiled.control(
        run.gain_changes[0].gains,
        study.inner_gains,
        GridEstimate(study.grid.R_g, study.grid.L_g),
        References(0.0, 0.0, c.omega_n, c.V_rated_rms),
        study.controller_settings(),
    )
    watch, circuit = control.grid_watch(), study.circuit()
    first, end = math.ceil(0.0701 / c.T_s - 1e-6), round(closing.t_s / c.T_s)
    ready = []
    for k in range(first, end):
        x = run.log[k]
        v = [float(capacitor_node_voltage(x[a], x[2 + a], x[4 + a], circuit)) for a in (0, 1)]
        ready.append(control.synchronise(watch, x[6], x[7], Measurement(*v, *map(float, (*x[0:2], *x[4:6])))))
        assert abs(math.remainder(control.data.state.theta - run.column("theta")[k], 2.0 * math.pi)) < 1e-9
        assert pytest.approx(run.column("V_rms")[k], rel=1e-9, abs=1e-9) == control.data.state.V
    held = round(0.2 / c.T_s)
    assert all(ready[-held:])
    assert not ready[-held - 1]
    # Behind the breaker flows nothing until it closes, and then only what the harmonics drive through the filter.
    current = np.hypot(run.column("i_g_alpha"), run.column("i_g_beta")) / c.I_rated_pk
    assert current[first + 1 : end].max() < 1e-9
    assert 1e-3 < current[end:].max() < 0.3


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
    found = reclosed(study, study.controllers[0])
    assert [event.name for event in found.events][-1] == "converter synchronises: the breaker never closes"
    assert not build_timeline(found).network_at(0.14).connected
