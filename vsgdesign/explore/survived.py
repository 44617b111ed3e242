"""Which grids of a map a controller survives the page's event on: the EMT of every cell, side by side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.explore.events import event_s, events_at, length_s, told_spec
from vsgdesign.explore.scene import Shown
from vsgdesign.explore.state import State
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.lanes.cases import ACTIVE, DISTURBANCE, REACTIVE, STEP, LaneCases, LaneEvents
from vsgdesign.simulation.lanes.results import JUDGED, NO_REST, OVER_LIMIT, LaneResults
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.stability.cells import CellSet

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def survived_cells(one: Shown, ready: Ready, state: State, cells: CellSet) -> tuple[Mask, Mask]:
    """Whether a verdict is known in every cell, and whether the controller survives the event there: (N,) each.

    A case without a rest before and after the event, or whose rest is beyond the current limit, has no verdict. A step
    of a reference is survived if the response settles.
    """
    known, good = np.zeros(len(cells.R_g), dtype=bool), np.zeros(len(cells.R_g), dtype=bool)
    index = np.flatnonzero(cells.good)
    if len(index) == 0:
        return known, good
    results = results_of(one, ready, state, cells.take(index))
    known[index] = ~np.isin(results.status, (NO_REST, OVER_LIMIT))
    settled = np.isfinite(results.settling_s) if state.event.kind == "step" else True
    good[index] = (results.status == JUDGED) & settled
    return known, good


def results_of(one: Shown, ready: Ready, state: State, cells: CellSet) -> LaneResults:
    """The results of :func:`vsgdesign.simulation.lanes.run.run_lanes` for cells without faults."""
    gains = type(cells.gains)(*(float(value[0]) for value in cells.gains))
    spec = told_spec(one, ready, state, gains)
    return run_lanes(one.study.undisturbed, spec, ready, lane_cases(one.study, state, cells))


def lane_cases(study: Study, state: State, cells: CellSet) -> LaneCases:
    """The page's event in cells without faults. The references put each cell at the state's powers in spite of the
    droops."""
    count, c, source = len(cells.R_g), study.converter, study.grid_source
    P_ref = cells.P - cells.gains.D_p * (c.omega_n - source.omega_g)
    Q_ref = cells.Q - cells.gains.D_q * (c.V_rated_rms - cells.V_rms)
    references = zip(P_ref.tolist(), Q_ref.tolist(), strict=True)
    none = np.zeros(count)
    return LaneCases(
        R_g=cells.R_g,
        L_g=cells.L_g,
        V_g_rms=np.full(count, source.V_g_rms),
        omega_g=np.full(count, source.omega_g),
        P_ref=P_ref,
        Q_ref=Q_ref,
        events=LaneEvents.of([events_at(study, state.event, event_s(study), *refs) for refs in references]),
        error_R=none + state.error_R,
        error_X=none + state.error_X,
        silent_s=none + (0.0 if state.event.kind == "step" else state.silent_s),
        cleared_s=none + event_s(study) + length_s(state.event),
        kind=np.full(count, STEP if state.event.kind == "step" else DISTURBANCE, dtype=np.int8),
        signal=np.full(count, ACTIVE if state.event.signal == "P" else REACTIVE, dtype=np.int8),
    )
