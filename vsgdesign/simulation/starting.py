"""The state in which a run begins: cold, or in the steady state of its first references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.operating_point.sampled import SampledState, cold_start, steady_state
from vsgdesign.parameters.study import GridSource, Study
from vsgdesign.simulation.circuits import Circuits
from vsgdesign.simulation.timeline import Timeline


def start_of(study: Study, timeline: Timeline, circuits: Circuits, gains: PowerLoopGains) -> SampledState:
    """The state at t = 0, with all the states of the circuit.

    Raises InfeasibleStudyError where a steady start is asked for and there is no steady state.
    """
    source = timeline.source_at(0.0)
    if study.simulation.start == "cold":
        return _widened(cold_start(study, source.phase), circuits, at_rest=False)
    if not source.steady:
        raise InfeasibleStudyError("a steady-state start cannot begin inside a ramp: move the ramp after t = 0.")
    network = timeline.network_at(0.0)
    if not network.connected or network.fault is not None:
        what = "an open breaker" if not network.connected else "a fault"
        raise InfeasibleStudyError(
            f"the start: with {what} there is no steady state to start in. Let it come at an event, or use "
            'start = "cold".'
        )
    if network.load is not None:
        raise InfeasibleStudyError(
            'the start: a run cannot start with a load. Let it come at an event, or use start = "cold".'
        )
    P_ref, Q_ref = timeline.references_at(0.0)
    grid, at_start = timeline.grid_at(0.0), GridSource(source.V_g_rms, source.omega)
    try:
        return _widened(steady_state(study, grid, at_start, P_ref, Q_ref, gains, source.phase), circuits, at_rest=True)
    except InfeasibleStudyError as error:
        error.args = (f"the start: {error}",)
        raise


def _widened(start: SampledState, circuits: Circuits, *, at_rest: bool) -> SampledState:
    """The state with those states of the circuit that i_s, v_c and i_g leave out."""
    plant = np.zeros(circuits.states)
    plant[: len(start.plant)] = start.plant
    if at_rest and circuits.more is not None:  # the whole grid has the current into the PCC, and no load has any
        for k, name in enumerate(circuits.more.names):
            if name.startswith("i_grid"):
                plant[2 * k : 2 * k + 2] = start.plant[4:6]
    return replace(start, plant=plant)
