"""The trace of a run: rows at a constant interval from the log of every sample, per unit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.compliance.trace import Trace
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.frames import clarke_inverse, instantaneous_power, rms_to_peak
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.run import Simulation

Array = NDArray[np.float64]

BEFORE_S = 0.1
"""A trace begins so long before its test, s; what an estimator learned earlier is left out."""

_SAME_INSTANT = 1e-6
"""Share of a sample by which a row may lie before an event and is still after it: times are rounded."""


def trace_of(study: Study, simulation: Simulation, every: int, lead_s: float) -> Trace:
    """The trace of a run whose log has every sample, with a row for every ``every`` samples.

    Values are those of the row's sample. Peaks are the largest since the row before, and the power of the dc link and
    the share of limited samples are means over this time.
    """
    c, circuit, log = study.converter, study.circuit(), simulation.log
    t = simulation.t_s - lead_s
    first = max(round((lead_s - BEFORE_S) / c.T_s) // every * every, 0)
    rows = np.arange(first, len(t), every)
    at = log[rows]
    node = [capacitor_node_voltage(at[:, k], at[:, 2 + k], at[:, 4 + k], circuit) for k in (0, 1)]
    V_pk = rms_to_peak(c.V_rated_rms)
    # One instant of rounding later: the row of an event belongs to the source after it.
    phase = simulation.timeline.source_phase(simulation.t_s[rows] + _SAME_INSTANT * c.T_s)
    i_s = log[:, 0], log[:, 1]
    phases = np.abs(clarke_inverse(*i_s)).max(axis=0)
    counted = simulation.column("limited_samples")[rows]
    return Trace(
        t_s=np.round(t[rows], 9) + 0.0,
        P_pu=simulation.column("P")[rows] / c.S_rated,
        Q_pu=simulation.column("Q")[rows] / c.S_rated,
        f_hz=simulation.column("omega")[rows] / (2.0 * np.pi),
        V_pu=simulation.column("V_rms")[rows] / c.V_rated_rms,
        delta_rad=np.unwrap(simulation.column("theta")[rows] - phase),
        i_s_pu=_since_row_before(np.hypot(*i_s), first, every, len(rows)) / c.I_rated_pk,
        i_phase_pu=_since_row_before(phases, first, every, len(rows)) / c.I_rated_pk,
        v_alpha_pu=node[0] / V_pk,
        v_beta_pu=node[1] / V_pk,
        i_g_alpha_pu=at[:, 4] / c.I_rated_pk,
        i_g_beta_pu=at[:, 5] / c.I_rated_pk,
        P_dc_pu=_dc_power(study, log, rows) / c.S_rated,
        limited=np.diff(counted, prepend=counted[:1]) / every,
    )


def _since_row_before(values: Array, first: int, every: int, count: int) -> Array:
    """The largest value since the row before: of the row's own sample for the first one."""
    found = np.empty(count)
    found[0] = values[first]
    found[1:] = values[first + 1 : first + 1 + (count - 1) * every].reshape(count - 1, every).max(axis=1)
    return found


def _dc_power(study: Study, log: Array, rows: NDArray[np.intp]) -> Array:
    """Mean power from the bridge into the circuit since the row before, W; of the first row that of the second.

    The power into L_2 and the grid, the losses of R_1 and R_c, and the change of the energy in L_1 and C
    (:eq:`dc-power`), so that no voltage of the bridge has to be logged.
    """
    f, circuit = study.filter, study.circuit()
    i_s, v_c, i_g = (log[:, 2 * k : 2 * k + 2] for k in range(3))
    node = capacitor_node_voltage(i_s, v_c, i_g, circuit)
    power, _ = instantaneous_power(*node.T, *i_g.T)
    lost = f.R_1 * _squared(i_s) + f.R_c * _squared(i_s - i_g)
    stored = 0.5 * (f.L_1 * _squared(i_s[rows]) + f.C * _squared(v_c[rows]))
    flow = power + lost
    T_s = study.converter.T_s
    total = np.concatenate(([0.0], np.cumsum(0.5 * T_s * (flow[1:] + flow[:-1]))))[rows]
    every_s = T_s * float(rows[1] - rows[0]) if len(rows) > 1 else T_s
    mean = np.diff(total + stored) / every_s
    return np.concatenate((mean[:1], mean)) if len(mean) else flow[rows]


def _squared(vector: Any) -> Array:
    """3/2 |x|²: twice the energy of a peak space vector in an element of one ohm, henry or farad in each phase."""
    return instantaneous_power(*vector.T, *vector.T)[0]
