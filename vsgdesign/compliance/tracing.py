"""The trace of a run: rows at a constant interval from the log of every sample, per unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.compliance.trace import Trace
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.frames import clarke_inverse, rms_to_peak
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.energy import dc_energy
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
    c, circuit = study.converter, study.circuit()
    t = simulation.t_s - lead_s
    first = max(round((lead_s - BEFORE_S) / c.T_s) // every * every, 0)
    rows = np.arange(first, len(t), every)
    plant = np.ascontiguousarray(simulation.log[first : rows[-1] + 1, :6].T)  # columns side by side: five times as fast
    i_s, v_c, i_g = (plant[k : k + 2] for k in (0, 2, 4))
    node = capacitor_node_voltage(i_s, v_c, i_g, circuit)
    at = rows - first
    V_pk = rms_to_peak(c.V_rated_rms)
    # One instant of rounding later: the row of an event belongs to the source after it.
    phase = simulation.timeline.source_phase(simulation.t_s[rows] + _SAME_INSTANT * c.T_s)
    a, b, c_ = clarke_inverse(*i_s)
    phases = np.maximum(np.maximum(np.abs(a), np.abs(b)), np.abs(c_))
    mean = np.diff(dc_energy(simulation, study)[rows]) / (every * c.T_s)
    counted = simulation.column("limited_samples")[rows]
    return Trace(
        t_s=np.round(t[rows], 9) + 0.0,
        P_pu=simulation.column("P")[rows] / c.S_rated,
        Q_pu=simulation.column("Q")[rows] / c.S_rated,
        f_hz=simulation.column("omega")[rows] / (2.0 * np.pi),
        V_pu=simulation.column("V_rms")[rows] / c.V_rated_rms,
        delta_rad=np.unwrap(simulation.column("theta")[rows] - phase),
        i_s_pu=np.sqrt(_since_row_before(i_s[0] * i_s[0] + i_s[1] * i_s[1], every)) / c.I_rated_pk,
        i_phase_pu=_since_row_before(phases, every) / c.I_rated_pk,
        v_alpha_pu=node[0, at] / V_pk,
        v_beta_pu=node[1, at] / V_pk,
        i_g_alpha_pu=i_g[0, at] / c.I_rated_pk,
        i_g_beta_pu=i_g[1, at] / c.I_rated_pk,
        P_dc_pu=np.concatenate((mean[:1], mean)) / c.S_rated,
        limited=np.diff(counted, prepend=counted[:1]) / every,
    )


def _since_row_before(values: Array, every: int) -> Array:
    """The largest value since the row before: of the row's own sample for the first one."""
    later = values[1:].reshape(-1, every).max(axis=1)
    return np.concatenate((values[:1], later))
