"""Voltage and current at the PCC in the rows of a run's log, with whatever is connected there at their instants."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.filters import FilterGrid, pcc_voltage
from vsgdesign.linear.operating_point.network import network_circuit
from vsgdesign.simulation.circuits import connection_at, states_of_timelines
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_AT_PCC = FilterGrid(L_1=0.0, R_1=0.0, C=0.0, R_c=0.0, L_2=0.0, R_2=0.0, R_g=0.0, L_g=1.0)
"""A circuit whose voltage at the PCC is that of its capacitor."""

_SAME_INSTANT = 1e-6
"""Part of a sampling period by which a change may lie behind a sample and still belong to it."""


def pcc_vectors(log: Array, circuit: FilterGrid) -> tuple[Array, Array]:
    """v_pcc and i_pcc, (n, 2) each as (α, β), of rows of a run's log where nothing but a grid is connected
    (:eq:`pcc-voltage`).

    R_g and L_g of the circuit are numbers, or (n, 1) where they change within the rows.
    """
    i_s, v_c, i_g, v_g = log[:, 0:2], log[:, 2:4], log[:, 4:6], log[:, 6:8]
    return pcc_voltage(i_s, v_c, i_g, v_g, circuit), i_g


class AtPcc:
    """Voltage and current at the PCC of a run, for many parts of its log (:eq:`pcc-voltage`, :eq:`network-pcc`)."""

    def __init__(self, study: Study, timeline: Timeline) -> None:
        """Finds the instants at which the circuit changes."""
        self._study, self._timeline = study, timeline
        self._states = states_of_timelines([timeline])
        changing = (timeline.grids,) if self._states is None else (timeline.grids, timeline.networks)
        self._instants = sorted({instant for listed in changing for instant, _ in listed})
        self._begins = np.array(self._instants) - _SAME_INSTANT * study.converter.T_s
        own, grids = study.circuit(), [timeline.grid_at(instant) for instant in self._instants]
        self._circuits = [
            own._replace(R_g=grid.R_g, L_g=grid.L_g) if self._states is None else _AT_PCC for grid in grids
        ]

    @property
    def grid_alone(self) -> bool:
        """Whether nothing but a grid is connected at any time."""
        return self._states is None

    def rows(self, t_s: Array, log: Array, more: Array) -> tuple[Array, Array]:
        """v_pcc and i_pcc, (n, 2) each as (α, β), of rows of a run's log at increasing instants. i_pcc is the current
        out of the filter, into load, fault and grid together.

        ``more`` (n, m): the circuit's other states. A row at which the circuit changes has the voltage just after it.
        """
        if self._states is not None:
            return self._behind_network(t_s, log, more), log[:, 4:6]
        parts = list(self.parts(t_s, log, more, len(log)))
        if len(parts) == 1:  # as mostly: one grid in all rows
            return pcc_vectors(*parts[0])
        return np.concatenate([pcc_vectors(*part)[0] for part in parts]), log[:, 4:6]

    def parts(self, t_s: Array, log: Array, more: Array, most: int) -> Iterator[tuple[Array, FilterGrid]]:
        """Rows of a run's log at increasing instants in parts of at most so many rows and one circuit, of which
        :func:`vsgdesign.equations.filters.pcc_voltage` has the voltage at the PCC: (n, 8) of their first columns.
        Behind a network, they have this voltage in place of the capacitor's."""
        if self._states is not None:
            log = np.hstack([log[:, :2], self._behind_network(t_s, log, more), log[:, 4:8]])
        cuts = [0, *np.searchsorted(t_s, self._begins[1:]).tolist(), len(log)]
        for circuit, (begin, end) in zip(self._circuits, itertools.pairwise(cuts), strict=True):
            for first in range(begin, end, most):
                yield log[first : min(first + most, end), :8], circuit

    def _behind_network(self, t_s: Array, log: Array, more: Array) -> Array:
        """v_pcc (n, 2) of rows."""
        x, v_g, v_pcc = np.column_stack([log[:, :6], more]), log[:, 6:8], np.empty((len(log), 2))
        held = np.searchsorted(self._begins, t_s, side="right") - 1
        for k in np.unique(held):
            connection = connection_at(self._timeline, self._instants[k])
            circuit = network_circuit(self._study.filter, *connection, self._states)
            rows = held == k
            v_pcc[rows] = x[rows] @ circuit.pcc_per_state.T + v_g[rows] @ circuit.pcc_per_source.T
        return v_pcc
