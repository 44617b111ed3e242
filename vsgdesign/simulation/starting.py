"""The state in which a run begins: cold, or in the steady state of its first references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.operating_point.sampled import SampledState, cold_start, steady_state
from vsgdesign.parameters.source import GridSource
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.circuits import Circuits, circuit_at_rest, connection_at
from vsgdesign.simulation.timeline import Timeline


def start_of(study: Study, timeline: Timeline, circuits: Circuits, gains: PowerLoopGains) -> SampledState:
    """The state at t = 0, with all the states of the circuit.

    Raises InfeasibleStudyError where a steady start is asked for and there is no steady state.
    """
    source = timeline.source_at(0.0)
    if study.simulation.start == "cold":
        start = cold_start(study, source.phase)
        plant = np.zeros(circuits.states)
        plant[: len(start.plant)] = start.plant
        return replace(start, plant=plant)
    if not source.steady:
        raise InfeasibleStudyError("a steady-state start cannot begin inside a ramp: move the ramp after t = 0.")
    refs = timeline.references_at(0.0)
    first, at_start = connection_at(timeline, 0.0), GridSource(source.V_g_rms, source.omega)
    try:
        circuit = circuit_at_rest(study, first, circuits.more)
        state = steady_state(study, first.grid, at_start, refs, gains, source.phase, circuit)
    except InfeasibleStudyError as error:
        error.args = (f"the start: {error}",)
        raise
    plant = np.zeros(circuits.states)
    plant[: len(state.plant)] = state.plant
    return replace(state, plant=plant)
