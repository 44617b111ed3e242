"""When a case of a batch is over: in a batch and as a single run."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.survival import SurvivalDemand
from vsgdesign.simulation.lanes.cases import STEP, LaneCases
from vsgdesign.simulation.survival.running import SETTLING_TIMES, SETTLING_TIMES_FOR_EVER

STEP_WINDOW = 1.85
"""For how many settling times a step is watched."""


def end_samples(cases: LaneCases, settling_time: float, T_s: float) -> NDArray[np.int64]:
    """The number of samples (N,) of every case: a step is watched for STEP_WINDOW settling times, a disturbance for as
    long as its judge needs, and two cycles. The settling time and T_s are in s."""
    omega = cases.omega_g.copy()
    for k in range(cases.events.count):
        given = np.isfinite(cases.events.omega_g[:, k]) & np.isfinite(cases.events.t_s[:, k])
        omega[given] = cases.events.omega_g[given, k]
    needed = {times: _needed_s(settling_time, times) for times in (SETTLING_TIMES, SETTLING_TIMES_FOR_EVER)}
    watched = np.where(np.isinf(cases.silent_s), needed[SETTLING_TIMES_FOR_EVER], needed[SETTLING_TIMES])
    of_step = cases.events.t_s[:, 0] + STEP_WINDOW * settling_time
    end_s = np.where(cases.kind == STEP, of_step, cases.cleared_s + watched + 2.0 * (2.0 * math.pi / omega))
    return np.ceil(end_s / T_s - 1e-6).astype(np.int64)


def _needed_s(settling_time: float, times: float) -> float:
    demand = SurvivalDemand(S_rated=1.0, settling_time=settling_time, cycle_s=1.0, i_max_pu=None, settling_times=times)
    return demand.needed_s
