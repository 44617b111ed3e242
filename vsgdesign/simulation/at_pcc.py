"""Voltage and current at the PCC in the rows of a run's log, with whatever is connected there at their instants."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.filters import FilterGrid, pcc_voltage
from vsgdesign.linear.operating_point.network import network_circuit
from vsgdesign.simulation.circuits import connection_at, states_of_timelines
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_SAME_INSTANT = 1e-6
"""Part of a sampling period by which a change may lie behind a sample and still belong to it."""


def pcc_vectors(log: Array, circuit: FilterGrid) -> tuple[Array, Array]:
    """v_pcc and i_pcc, (n, 2) each as (α, β), of rows of a run's log where nothing but a grid is connected
    (:eq:`pcc-voltage`).

    R_g and L_g of the circuit are numbers, or (n, 1) where they change within the rows.
    """
    i_s, v_c, i_g, v_g = log[:, 0:2], log[:, 2:4], log[:, 4:6], log[:, 6:8]
    return pcc_voltage(i_s, v_c, i_g, v_g, circuit), i_g


def pcc_over_time(study: Study, timeline: Timeline, t_s: Array, log: Array, more: Array) -> tuple[Array, Array]:
    """v_pcc and i_pcc, (n, 2) each as (α, β), of rows of a run's log at increasing instants (:eq:`pcc-voltage`,
    :eq:`network-pcc`). i_pcc is the current out of the filter, into load, fault and grid together.

    ``more`` (n, m): the circuit's other states. A row at which the circuit changes has the voltage just after it.
    """
    return AtPcc(study, timeline).rows(t_s, log, more)


class AtPcc:
    """What :func:`pcc_over_time` needs to know of a run, for many parts of its log."""

    def __init__(self, study: Study, timeline: Timeline) -> None:
        """Finds the instants at which the circuit changes."""
        self._study, self._timeline = study, timeline
        self._states = states_of_timelines([timeline])
        changing = (timeline.grids,) if self._states is None else (timeline.grids, timeline.networks)
        self._instants = sorted({instant for listed in changing for instant, _ in listed})
        self._begins = np.array(self._instants) - _SAME_INSTANT * study.converter.T_s
        self._grids = [timeline.grid_at(instant) for instant in self._instants]

    def rows(self, t_s: Array, log: Array, more: Array) -> tuple[Array, Array]:
        """As :func:`pcc_over_time`."""
        held = np.searchsorted(self._begins, t_s, side="right") - 1
        if self._states is None:
            circuit = self._study.circuit()
            if len(held) and held[0] == held[-1]:  # as mostly: one grid in all rows
                grid = self._grids[held[0]]
                return pcc_vectors(log, circuit._replace(R_g=grid.R_g, L_g=grid.L_g))
            R_g, L_g = (np.array([getattr(grid, name) for grid in self._grids])[held, None] for name in ("R_g", "L_g"))
            return pcc_vectors(log, circuit._replace(R_g=R_g, L_g=L_g))
        x, v_g, v_pcc = np.column_stack([log[:, :6], more]), log[:, 6:8], np.empty((len(log), 2))
        for k in np.unique(held):
            connection = connection_at(self._timeline, self._instants[k])
            circuit = network_circuit(self._study.filter, *connection, self._states)
            rows = held == k
            v_pcc[rows] = x[rows] @ circuit.pcc_per_state.T + v_g[rows] @ circuit.pcc_per_source.T
        return v_pcc, log[:, 4:6]
