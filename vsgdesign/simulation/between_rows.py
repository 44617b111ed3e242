"""What every n-th sample of a run says of those before it: peaks of the current, the energy that a lossless bridge
takes from its dc link, and a few columns of every sample of runs whose logs have fewer rows."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.apart import TakenApart
from vsgdesign.codegen.llvm import Loop, LoopSpec, compiled_loop, empty_rows, flat_block
from vsgdesign.equations.frames import SPACE_VECTOR_POWER, clarke_inverse
from vsgdesign.simulation.circuit_sample import PlantState
from vsgdesign.simulation.loop import LOG_COLUMNS, SEEN_COLUMNS, Build
from vsgdesign.study.parameters.study import Study


class BridgeFilter(NamedTuple):
    """What the energy of the dc link depends on, in SI, and the sampling period, s."""

    R_1: Any
    L_1: Any
    R_c: Any
    C: Any
    T_s: Any


def bridge_filter_of(study: Study) -> BridgeFilter:
    """That of a study."""
    f = study.filter
    return BridgeFilter(f.R_1, f.L_1, f.R_c, f.C, study.converter.T_s)


class EnergyOfAxis(NamedTuple):
    """What one axis says of the energy of a sample: by how much the current of L_1 changes and its mean (A), and the
    integrals of the voltage behind L_1 (Vs) and of the current (As)."""

    step_i: Any
    middle: Any
    flux: Any
    charge: Any


def averaged_energy(before: PlantState, x: PlantState, of: BridgeFilter) -> Any:
    """The energy in J that an averaged bridge takes in a sample from the state ``before`` it to ``x``
    (:eq:`dc-energy`)."""
    alpha = _of_axis(before.i_s_alpha, before.v_c_alpha, before.i_g_alpha, x.i_s_alpha, x.v_c_alpha, x.i_g_alpha, of)
    beta = _of_axis(before.i_s_beta, before.v_c_beta, before.i_g_beta, x.i_s_beta, x.v_c_beta, x.i_g_beta, of)
    return energy_of(alpha, beta, of)


def _of_axis(i_s: Any, v_c: Any, i_g: Any, i_s_after: Any, v_c_after: Any, i_g_after: Any, of: BridgeFilter) -> Any:
    step_i, step_v, step_c = i_s_after - i_s, v_c_after - v_c, (i_s_after - i_g_after) - (i_s - i_g)
    # v_b − R_1 i_s − v says the slope of the current, in whose difference between both ends v_b is not contained.
    curved = (of.R_1 * step_i + (step_c * of.R_c + step_v)) * (of.T_s * of.T_s / 12.0) * (1.0 / of.L_1)
    charge = (i_s_after + i_s) * (0.5 * of.T_s) + curved
    flux = flux_of(v_c, v_c_after, step_v, step_c, of) + of.R_1 * charge
    return EnergyOfAxis(step_i, charge * (1.0 / of.T_s), flux, charge)


def flux_of(v_c: Any, v_c_after: Any, step_v: Any, step_c: Any, of: BridgeFilter) -> Any:
    """Integral of the node's voltage over a sample, Vs. What flows into the capacitor says the slope of its voltage."""
    curved = of.T_s * of.T_s / 12.0 * step_c * (1.0 / of.C)
    return (v_c_after + v_c) * (0.5 * of.T_s) - curved + of.R_c * of.C * step_v


def energy_of(alpha: EnergyOfAxis, beta: EnergyOfAxis, of: BridgeFilter) -> Any:
    """The energy in J of a sample from what both axes say of it: what L_1 takes, and the rest."""
    inductor = SPACE_VECTOR_POWER * (alpha.step_i * alpha.middle + beta.step_i * beta.middle) * of.L_1
    i_alpha, i_beta = alpha.charge * (1.0 / of.T_s), beta.charge * (1.0 / of.T_s)
    return inductor + SPACE_VECTOR_POWER * (alpha.flux * i_alpha + beta.flux * i_beta)


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


class KeptColumns:
    """SEEN_COLUMNS of every sample of runs side by side, while they are logged.

    Each column has memory of its own. In one piece they would be too large for memory that later runs get again
    (:func:`vsgdesign.execution.executors.keep_memory`).
    """

    def __init__(self, count: int, samples: int, build: Build) -> None:
        self._columns = {name: np.empty((count, samples)) for name in SEEN_COLUMNS}
        places: Sequence[int] = [LOG_COLUMNS.index(name) for name in SEEN_COLUMNS]
        width = build.lanes * build.vectors
        self._apart = TakenApart(places, list(self._columns.values()), width, build.target)

    def take(self, begin: int, rows: Array) -> None:
        """The rows (1, n, m, L) of a log, of samples ``begin`` to ``begin`` + n − 1."""
        self._apart.take(begin, rows[0])

    def of(self, lane: int) -> dict[str, Array]:
        """The columns of a run, (samples,) each."""
        return {name: column[lane] for name, column in self._columns.items()}
