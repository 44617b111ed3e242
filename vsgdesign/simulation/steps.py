"""Steps of the references in EMT at one operating point: what a linear promise comes to with the real inner loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.metrics.step_response import ResponseMetrics, step_response
from vsgdesign.parameters.study import Event, Grid, Study
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.run import simulate

Array = NDArray[np.float64]

STEP_PU = 0.05
_BEFORE = 0.02
_INTERVAL = 1e-3


def references_at(study: Study, grid: Grid, gains: PowerLoopGains, P: float, Q: float) -> tuple[float, float]:
    """P_ref and Q_ref that put the converter at (P, Q) in spite of its droops."""
    R, X = study.path_to_grid(grid, study.grid_source.omega_g)
    V_rms = float(operating_point(P, Q, study.grid_source.V_g_rms, R, X)[0])
    c = study.converter
    return (
        P - float(gains.D_p) * (c.omega_n - study.grid_source.omega_g),
        Q - float(gains.D_q) * (c.V_rated_rms - V_rms),
    )


def simulate_step(
    study: Study, grid: Grid, gains: PowerLoopGains, P: float, Q: float, signal: str, size: float, duration: float,
    every: int | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """A step of one reference by ``size`` from the steady state at (P, Q), averaged EMT.

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
        study.simulation, duration=start * interval + duration, bridge="averaged", start="steady_state",
        log_interval=interval, P_ref=P_ref, Q_ref=Q_ref,
    )  # fmt: skip
    run = simulate(replace(study, grid=grid, simulation=spec, events=(event,)), [GainChange(0.0, gains)])
    values = run.column(signal)
    return run.t_s[start:] - start * interval, values[start:] - values[start - 1]


def emt_step(
    study: Study, grid: Grid, gains: PowerLoopGains, P: float, Q: float, signal: str,
    *, size_pu: float = STEP_PU, duration: float = 4.0,
) -> ResponseMetrics | None:  # fmt: skip
    """Figures of ``signal`` ("P" or "Q") after a step of its reference; None where it does not settle or start.

    Q ends where its droop lets it: the last tenth of the response is its final value.
    """
    size = size_pu * study.converter.S_rated
    try:
        t_s, response = simulate_step(study, grid, gains, P, Q, signal, size, duration)
    except (InfeasibleStudyError, SimulationDivergedError):
        return None
    tail = response[-max(len(response) // 10, 1) :]
    final = size if signal == "P" else float(tail.mean())
    # What ends within the band around zero is no answer to the step, and nothing to take shares of.
    if np.ptp(tail) > 0.02 * abs(size) or abs(final) < 0.02 * abs(size):
        return None
    return step_response(t_s, response, 0.0, final)
