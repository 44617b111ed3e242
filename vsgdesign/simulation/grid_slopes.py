"""The slope of the grid current over an interval in which the dc link moves the voltage of the bridge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.plant import state_matrices
from vsgdesign.simulation.circuits import Circuits
from vsgdesign.simulation.segments import Segments
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


class GridSlopes(NamedTuple):
    """What the slope of the grid current over an interval is, A, in n runs, and what becomes of the first states where
    it begins (:mod:`vsgdesign.simulation.link_piece`)."""

    h: Array
    """s (n,)."""
    fast: Array
    """(n,): 1 where it is too fast to be moved with the filter, else 0."""
    per_state: Array
    """(n, 2, S)."""
    per_source: Array
    """(n, 2, 2): for the components of the source, V peak."""
    begin: Array
    end: Array
    """Angles of the source at the beginning and at the end over its phasor at the sample, rad (n,)."""
    bend_per_state: Array
    bend_per_source: Array
    """(n, 2, S) and (n, 2, 2): the slope of this slope, without what the filter adds to it."""
    onto: Array
    """(n, 6, S)."""

    def rows(self, V_g: Array) -> Array:
        """Values of :func:`vsgdesign.simulation.link_piece.names_of_circuit` for a source of so many volts, of circuits
        whose axes act on each other and whose states may jump, (n, 19 + 10 S)."""
        n, at, bends = len(self.h), [], []
        for angle in (self.begin, self.end):
            c, s = V_g * np.cos(angle), V_g * np.sin(angle)
            turn = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=1)
            at.append((self.per_source @ turn).reshape(n, 4))
            bends.append((self.bend_per_source @ turn).reshape(n, 4))
        arc = -0.25 * (self.end - self.begin) ** 2
        bent = [self.bend_per_state.reshape(n, -1), *bends]
        return np.column_stack(
            [self.h, self.fast, arc, self.per_state.reshape(n, -1), *at, *bent, self.onto.reshape(n, -1)]
        )


def grid_slopes(
    study: Study, circuits: Circuits | None, source: Segments, h: Array, angle: Array, most_turns: float
) -> GridSlopes:
    """Those of n runs over intervals h (s) on these segments, whose sources are at these angles (rad) over their
    phasors at the sample. ``most_turns``: by how much filter and grid current may move in a sampling period, rad.
    Raises InfeasibleStudyError where they move by far more on a grid alone."""
    count = len(source.omega)
    if circuits is None:
        A, _, e = state_matrices(study.circuit()._replace(R_g=source.R_g, L_g=source.L_g))
        A, e = (np.kron(one, np.eye(2)) for one in (A, e[..., None]))
        driven, onto = np.zeros(count), np.tile(np.eye(6), (count, 1, 1))
    else:
        A, e, driven, onto = circuits.at_grid(source.place)
    turns = np.abs(np.linalg.eigvals(A[:, :6, :6])).max(axis=1) * study.converter.T_s
    fast = 1.0 * ((turns > most_turns) | (driven != 0.0))
    if (circuits is None or circuits.axes is None) and turns.max() > 2.0 * most_turns:
        raise InfeasibleStudyError(
            f"the filter on this grid moves by {turns.max():.3g} rad in a sampling period. With a dc link that "
            f"moves the voltage of the bridge at most {2.0 * most_turns:.3g} rad can be computed. Sample "
            "faster, or take a weaker grid."
        )
    length, begin = (np.broadcast_to(one, count).astype(np.float64) for one in (h, angle))
    over = length[:, None, None]
    per_state, per_source = A[:, 4:6] * over, e[:, 4:6] * over
    others = per_state[:, :, 6:] * over
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])  # the slope of the source's voltage is a quarter turn ahead
    bend_per_source = others @ e[:, 6:] + (source.omega * length)[:, None, None] * (per_source @ quarter)
    return GridSlopes(
        h=length,
        fast=fast,
        per_state=per_state,
        per_source=per_source,
        begin=begin,
        end=begin + source.omega * length,
        bend_per_state=others @ A[:, 6:],
        bend_per_source=bend_per_source,
        onto=onto,
    )
