"""The trace of a run: rows at a constant interval from the log of every sample, per unit."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from vsgdesign.compliance.trace import Trace
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.frames import clarke_inverse, rms_to_peak
from vsgdesign.metrics.step_response import unwrapped
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.energy import dc_energy_steps
from vsgdesign.simulation.run import Simulation

Array = NDArray[np.float64]

BEFORE_S = 0.1
"""A trace begins so long before its test, s; what an estimator learned earlier is left out."""

_ROWS_COUNTED = 256
"""After so many rows the energy of the dc link is counted from zero again: what a row has of it is not lost in a large
sum."""

_ROWS_AT_ONCE = 2 * _ROWS_COUNTED

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
    at = simulation.log[rows]
    node = [capacitor_node_voltage(at[:, k], at[:, 2 + k], at[:, 4 + k], circuit) for k in (0, 1)]
    V_pk = rms_to_peak(c.V_rated_rms)
    # One instant of rounding later: the row of an event belongs to the source after it.
    phase = simulation.timeline.source_phase(simulation.t_s[rows] + _SAME_INSTANT * c.T_s)
    i_s, i_phase, P_dc = _between_rows(study, simulation, rows, every)
    counted = simulation.column("limited_samples")[rows]
    return Trace(
        t_s=np.round(t[rows], 9) + 0.0,
        P_pu=simulation.column("P")[rows] / c.S_rated,
        Q_pu=simulation.column("Q")[rows] / c.S_rated,
        f_hz=simulation.column("omega")[rows] / (2.0 * np.pi),
        V_pu=simulation.column("V_rms")[rows] / c.V_rated_rms,
        delta_rad=unwrapped(simulation.column("theta")[rows] - phase),
        i_s_pu=i_s / c.I_rated_pk,
        i_phase_pu=i_phase / c.I_rated_pk,
        v_alpha_pu=node[0] / V_pk,
        v_beta_pu=node[1] / V_pk,
        i_g_alpha_pu=at[:, 4] / c.I_rated_pk,
        i_g_beta_pu=at[:, 5] / c.I_rated_pk,
        P_dc_pu=P_dc / c.S_rated,
        limited=np.diff(counted, prepend=counted[:1]) / every,
    )


def _between_rows(
    study: Study, simulation: Simulation, rows: NDArray[np.intp], every: int
) -> tuple[Array, Array, Array]:
    """Of the samples since the row before: the largest length of the converter current's vector and the largest phase
    current (A peak), and the mean power of the dc link (W). The first row has its own sample, and the second one's
    power. The samples are looked at part by part, as a part stays in the processor's memory.
    """
    length, phase, power = (np.empty(len(rows)) for _ in range(3))
    for begin in range(0, max(len(rows) - 1, 1), _ROWS_AT_ONCE):
        end = min(begin + _ROWS_AT_ONCE, len(rows) - 1)
        columns = np.ascontiguousarray(simulation.log[rows[begin] : rows[end] + 1, :6].T)
        alpha, beta = columns[:2]
        squared = alpha * alpha + beta * beta
        largest = functools.reduce(np.maximum, map(np.abs, clarke_inverse(alpha, beta)))
        if begin == 0:
            length[0], phase[0] = squared[0], largest[0]
        length[begin + 1 : end + 1] = _largest(squared[1:], every)
        phase[begin + 1 : end + 1] = _largest(largest[1:], every)
        taken = dc_energy_steps(columns, study)
        for first in range(begin, end, _ROWS_COUNTED):
            last = min(first + _ROWS_COUNTED, end)
            energy = np.cumsum(taken[(first - begin) * every : (last - begin) * every])[every - 1 :: every]
            power[first + 1 : last + 1] = np.diff(energy, prepend=0.0) / (every * study.converter.T_s)
    power[0] = power[1] if len(rows) > 1 else 0.0
    return np.sqrt(length), phase, power


def _largest(values: Array, every: int) -> Array:
    """The largest of every so many values, in a third of the time of a reduction over a short axis."""
    return functools.reduce(np.maximum, [values[k::every] for k in range(every)])
