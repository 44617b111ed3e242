"""Steps of the references in EMT at one operating point, to test linear requirements with the real inner loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.metrics.events import time_needed
from vsgdesign.metrics.modes import to_continuous
from vsgdesign.metrics.step_response import SETTLING_BAND, ResponseMetrics, step_response
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.run import simulate
from vsgdesign.study.parameters.grid import PLAIN, Grid
from vsgdesign.study.parameters.study import Event, Study

Array = NDArray[np.float64]

STEP_PU = 0.05
_BEFORE = 0.02
_INTERVAL = 1e-3


def references_at(study: Study, grid: Grid, gains: PowerLoopGains, P: float, Q: float) -> tuple[float, float]:
    """P_ref (W) and Q_ref (var) with which the converter rests at (P, Q), whatever its droops are."""
    R, X = study.path_to_grid(grid, study.grid_source.omega_g)
    V_rms = float(operating_point(P, Q, study.grid_source.V_g_rms, R, X)[0])
    c = study.converter
    return (
        P - float(gains.D_p) * (c.omega_n - study.grid_source.omega_g),
        Q - float(gains.D_q) * (c.V_rated_rms - V_rms),
    )


def simulate_step(
    study: Study,
    grid: Grid,
    gains: PowerLoopGains,
    P: float,
    Q: float,
    signal: str,
    size: float,
    duration: float,
    every: int | None = None,
) -> tuple[Array, Array]:
    """A step of one reference by ``size`` from the steady state at (P, Q) on a grid alone, averaged EMT.

    Returns time from the step in s and the signal's change in W or var, at every ``every``-th sample (None: 1 ms).
    """
    every = every or max(round(_INTERVAL / study.converter.T_s), 1)
    interval = every * study.converter.T_s
    start = round(_BEFORE / interval)
    P_ref, Q_ref = references_at(study, grid, gains, P, Q)
    event = Event(
        t_s=start * interval,
        name="step",
        P_ref=P_ref + size if signal == "P" else None,
        Q_ref=Q_ref + size if signal == "Q" else None,
    )
    spec = replace(
        study.simulation,
        duration=start * interval + duration,
        bridge="averaged",
        start="steady_state",
        log_interval=interval,
        P_ref=P_ref,
        Q_ref=Q_ref,
    )
    alone = replace(study.undisturbed, grid=grid, network=PLAIN, simulation=spec, events=(event,))
    run = simulate(alone, [GainChange(0.0, gains)])
    run.to_its_end()
    values = run.column(signal)
    return run.t_s[start:] - start * interval, values[start:] - values[start - 1]


def emt_step(
    study: Study,
    grid: Grid,
    gains: PowerLoopGains,
    P: float,
    Q: float,
    signal: str,
    *,
    size_pu: float = STEP_PU,
    duration: float = 4.0,
) -> ResponseMetrics | None:
    """Figures of ``signal`` ("P" or "Q") after a step of its reference.

    The result is None if the signal does not settle within ``duration``, if this time is too short to know
    (:eq:`window-needed`), or if the run cannot start. The final value is the steady state of the full-order model,
    which includes the droop of Q.
    """
    size = size_pu * study.converter.S_rated
    P_ref, Q_ref = references_at(study, grid, gains, P, Q)
    end = Cell(grid, gains, P_ref + size * (signal == "P"), Q_ref + size * (signal == "Q"))
    model = linearise_full_order(study, [end])
    states = model.steady
    if len(model.index) == 0 or states is None:
        return None
    decay = -float(to_continuous(np.linalg.eigvals(model.A[0]), model.T_s).real.max())
    final = float(states.P[0]) - P if signal == "P" else float(states.Q[0]) - Q
    # What ends within the band around zero is no answer to the step, and nothing to take shares of.
    if not decay > 0.0 or abs(final) < SETTLING_BAND * abs(size):
        return None
    try:
        t_s, response = simulate_step(study, grid, gains, P, Q, signal, size, duration)
    except (InfeasibleStudyError, SimulationDivergedError):
        return None
    if time_needed(t_s, np.abs(response / final - 1.0), decay) > duration:
        return None
    return step_response(t_s, response, 0.0, final, SETTLING_BAND)
