"""What every n-th sample of a run says of those before it: peaks of the current, and the energy of the dc link."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import Loop, LoopSpec, compiled_loop, empty_rows, flat_block
from vsgdesign.equations.frames import clarke_inverse
from vsgdesign.simulation.bridge_energy import BridgeFilter, averaged_energy, bridge_filter_of
from vsgdesign.simulation.circuit_sample import PlantState
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_COUNTED = 256
"""After so many rows the energy of the dc link is counted from zero again: what a row has of it is not lost in a large
sum."""

_COLUMNS = len(PlantState._fields)
"""The first ones of a log."""


class RowsAsked(NamedTuple):
    """Which rows are wanted of a run: from sample ``first`` on, a whole multiple of ``every``, ``every`` samples apart.
    The bridge is averaged."""

    first: int
    every: int
    thin: bool = False
    """Whether the log of the run has these rows alone, from sample 0 on, and beside it a few columns of every sample
    (:data:`vsgdesign.simulation.loop.SEEN_COLUMNS`); else the study says what is logged."""


class Row(NamedTuple):
    """Of the samples since the row before: the largest squared length of the converter current's vector (A²), the
    largest phase current (A), and the energy of the dc link since it was counted from zero (J)."""

    length_sq: Any
    phase: Any
    energy: Any


def row_after(row: Row, before: PlantState, x: PlantState, begins: Any, counted: Any, of: BridgeFilter) -> Any:
    """What there is of a row after a sample. ``begins`` is 1 in its first one, ``counted`` where the energy is counted
    from zero. Returns (row_after, before_after)."""
    length_sq = x.i_s_alpha * x.i_s_alpha + x.i_s_beta * x.i_s_beta
    a, b, c = clarke_inverse(x.i_s_alpha, x.i_s_beta)
    phase = np.maximum(np.maximum(np.abs(a), np.abs(b)), np.abs(c))
    energy = averaged_energy(before, x, of)
    after = Row(
        np.where(begins > 0.5, length_sq, np.maximum(row.length_sq, length_sq)),
        np.where(begins > 0.5, phase, np.maximum(row.phase, phase)),
        np.where(counted > 0.5, energy, row.energy + energy),
    )
    return after, x


class BetweenRows:
    """What is taken of the samples of runs side by side while they are logged."""

    def __init__(self, study: Study, asked: RowsAsked, samples: int, lanes: int = 1, vectors: int = 1) -> None:
        loop, every = _loop(lanes, vectors), asked.every
        after = np.arange(_COUNTED * every) - 1
        flags = np.array([after % every == 0, (after - asked.first) % len(after) == 0], dtype=float)
        self._log = np.zeros((1, -(-samples // every), len(loop.spec.logged), loop.spec.width))
        self._loop = loop.standing(
            empty_rows(loop.spec, 1),
            np.array(bridge_filter_of(study)),
            cyclic=np.ascontiguousarray(flags.T),
            log=self._log,
            every=every,
        )

    def take(self, begin: int, rows: Array) -> None:
        """The rows (1, n, m, L) of a log, of samples ``begin`` to ``begin`` + n − 1; each once, in their order."""
        self._loop(begin, begin + rows.shape[1], rows[:, :, :_COLUMNS])

    def of(self, lane: int) -> Array:
        """What has been taken of a run, (n, 3) as in :class:`Row`, of the samples 0, every, 2·every, …"""
        return self._log[0, :, :, lane]


def taken_of_log(study: Study, log: Array, asked: RowsAsked) -> Array:
    """The same of one run from its whole log, (samples, 6 or more)."""
    found = BetweenRows(study, asked, len(log))
    found.take(0, np.ascontiguousarray(log[:, :_COLUMNS])[None, :, :, None])
    return found.of(0)


def between_rows(study: Study, rows: Array, taken: Array, asked: RowsAsked) -> tuple[Array, Array, Array]:
    """Of the samples since the row before, (n,) each: the largest length of the converter current's vector and the
    largest phase current (A peak), and the mean power of the dc link (W). The first row has its own sample, and the
    second one's power. ``rows``: those that were asked for of the log, (n, 2 or more)."""
    first, every = asked.first, asked.every
    length_sq, phase, energy = taken[first // every : first // every + len(rows)].T.copy()
    own = rows[0, :2].tolist()
    length_sq[0], phase[0] = own[0] * own[0] + own[1] * own[1], max(map(abs, clarke_inverse(*own)))
    before = np.concatenate([[0.0], energy[:-1]])
    before[1::_COUNTED] = 0.0
    power = (energy - before) / (every * study.converter.T_s)
    power[0] = power[1] if len(power) > 1 else 0.0
    return np.sqrt(length_sq), phase, power


@functools.cache
def _loop(lanes: int, vectors: int) -> Loop:
    """:func:`row_after`, sample by sample, with the bits of NumPy."""
    states = [(f"row.{name}", f"row_after.{name}") for name in Row._fields]
    states += [(f"before.{name}", f"before_after.{name}") for name in PlantState._fields]
    spec = LoopSpec(
        bodies=(flat_block(row_after),),
        state=tuple(states),
        uniform=tuple(f"of.{name}" for name in BridgeFilter._fields),
        cyclic=("begins", "counted"),
        fed=tuple(f"x.{name}" for name in PlantState._fields),
        logged=tuple(f"row_after.{name}" for name in Row._fields),
        lanes=lanes,
        vectors=vectors,
        strict=True,
    )
    return compiled_loop(spec)
