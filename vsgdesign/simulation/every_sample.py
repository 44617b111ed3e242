"""Figures come from every sample of a run, whatever its study logs: what they need of each is taken while the run goes
on, so that its log of every sample is written over again and again.

Among them are voltage and current at the PCC, in the rows of any log, with whatever is connected there at their
instants.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import Loop, LoopSpec, StandingLoop, compiled_loop, empty_rows, flat_block
from vsgdesign.equations.grid import FilterGrid, pcc_voltage
from vsgdesign.linear.operating_point.network import network_circuit
from vsgdesign.simulation.circuit_sample import PlantState
from vsgdesign.simulation.circuits import connection_at, states_of_timelines
from vsgdesign.simulation.outcome import RESTING_S
from vsgdesign.simulation.run_kind import RINGS_OF_TAKEN, TAKEN_COLUMNS
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.simulation.watched_sample import Sums, taken
from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:
    from vsgdesign.simulation.run import Simulation
    from vsgdesign.simulation.run_asked import Twin


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
        :func:`vsgdesign.equations.grid.pcc_voltage` has the voltage at the PCC: (n, 8) of their first columns.
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


MOST_SAMPLES = 20_000_000
"""A run of up to so many samples, 1000 s at 50 µs, has all of them looked at. What figures need of one takes 40 bytes:
48 MB a minute at 50 µs, 0.8 GB at most; where survival is judged, 120 bytes more. Of a longer run every n-th sample is
taken, so that no more come together."""

BLOCK = 8192
"""So many samples at least are logged before the log is written anew."""

_ROWS = 16_384
"""So many rows are worked on at a time: few enough for the cache, and so many that the calls of NumPy cost little."""


def spacing_of_figures(study: Study) -> int:
    """Every how many samples figures are taken: 1, or, of a run of more than MOST_SAMPLES, the least number that
    divides the spacing of its log and leaves no more rows than that."""
    T_s = study.converter.T_s
    logged, samples = round(study.simulation.log_interval / T_s), round(study.simulation.duration / T_s)
    enough = (n for n in range(1, logged) if logged % n == 0 and samples <= n * MOST_SAMPLES)
    return next(enough, logged)


def with_every_sample(study: Study) -> Study:
    """The study with the log from which its figures are taken."""
    interval = spacing_of_figures(study) * study.converter.T_s
    return replace(study, simulation=replace(study.simulation, log_interval=interval))


def rows_apart(study: Study) -> int:
    """How many samples of which figures are taken come to one that the study logs."""
    return round(study.simulation.log_interval / study.converter.T_s) // spacing_of_figures(study)


class SignalsAtPcc(NamedTuple):
    """What figures are taken from: time (s), powers at the PCC (W, var), and the squared lengths of the current's
    vector there and of that of the converter (A² peak), (n,) each."""

    t_s: Array
    P_pcc: Array
    Q_pcc: Array
    i_sq: Array
    i_s_sq: Array


def in_pu(study: Study, squared: float) -> float:
    """A current over the rated peak, from the square of its length, A² peak. The largest one comes from the largest
    square, to the bit, so that no sample needs a root."""
    return math.sqrt(squared) / study.converter.I_rated_pk


@functools.cache
def _loop() -> Loop:
    """:func:`vsgdesign.simulation.watched_sample.taken`, sample by sample, of rows of a log that does not have it."""
    block = flat_block(taken)
    return compiled_loop(
        LoopSpec(
            bodies=(block,),
            state=tuple((f"sums.{name}", f"sums_after.{name}") for name in Sums._fields),
            uniform=tuple(name for name in block.inputs if name.startswith("circuit.")),
            fed=(*(f"x.{name}" for name in PlantState._fields), "v_g_alpha", "v_g_beta"),
            rings=RINGS_OF_TAKEN,
            logged=TAKEN_COLUMNS,
            strict=True,
        ),
        quickly=True,
    )


def memory_for(study: Study, t_s: Array | None = None) -> SignalsAtPcc:
    """Room for the signals of a run, or of rows at given times, s."""
    if t_s is None:
        every, T_s = spacing_of_figures(study), study.converter.T_s
        t_s = np.arange(-(-round(study.simulation.duration / T_s) // every), dtype=np.float64)
        t_s *= every * T_s
    return SignalsAtPcc(t_s, *(np.empty(len(t_s)) for _ in range(4)))


def rings_of_taken(per_mean: int) -> tuple[Array, NDArray[np.int64]]:
    """The rings of a run of which figures are taken, and their length: the samples of a mean."""
    return np.zeros((1, per_mean, 2, 1)), np.array([per_mean])


class EverySample:
    """What figures need of every sample of a run, or of every n-th one (:func:`spacing_of_figures`). The run gives its
    log to it part by part."""

    def __init__(
        self,
        study: Study,
        timeline: Timeline,
        per_mean: int,
        t_s: Array | None = None,
        memory: SignalsAtPcc | None = None,
    ) -> None:
        """``study``: with its own log, and with the current limit of the controller. ``per_mean``: how many of these
        samples come to a mean of the powers. ``t_s``: of rows that are given at once; None: of a run's samples.
        ``memory``: that of a run of the same study (:func:`memory_for`), which is written over; None: its own."""
        self._study, rows = study, t_s is not None
        self.per_mean = per_mean
        """How many of these samples come to a mean of the powers."""
        self.follow(timeline)
        self.every = 1 if rows else spacing_of_figures(study)
        """Samples from one that is taken to the next."""
        self.length = 0
        """How many have been taken."""
        self._signals = memory or memory_for(study, t_s)
        t_s = self._signals.t_s
        self._apart = 1 if rows else rows_apart(study)
        self._kept_from = 0 if rows or study.simulation.survival else first_resting(t_s)
        self._means = np.empty((2, -(-len(t_s) // self._apart)))
        self._kept: list[tuple[Array, Array]] = []

    def follow(self, timeline: Timeline) -> None:
        """The run has another timeline from the rows on that have not been taken yet."""
        self._at_pcc = AtPcc(self._study, timeline)

    @property
    def fits_loop(self) -> bool:
        """Whether the loop of a run can take it: of every sample, with nothing but a grid connected."""
        return self.every == 1 and self._at_pcc.grid_alone

    def take(self, first: int, every: int, log: Array, more: Array, found: Array | None = None) -> None:
        """Rows of a log that begins at sample ``first`` and has every so-many-th one: (n, 15) of LOG_COLUMNS, and
        (n, m) of the circuit's other states. Those that have been taken before are passed over. ``found`` (n, 6): what
        the loop of the run has taken of them, TAKEN_COLUMNS; None: nothing."""
        new = slice((self.length * self.every - first) // every, None, self.every // every)
        log, more = log[new], more[new]
        if self.length + len(log) > self._kept_from:
            late = slice(max(self._kept_from - self.length, 0), None)
            self._kept.append((log[late].copy(), more[late].copy()))
        if found is not None:
            self._keep(found[new])
            return
        t_s = self._signals.t_s[self.length : self.length + len(log)]
        for x, circuit in self._at_pcc.parts(t_s, log, more, _ROWS):
            self._keep(self._taken(x, circuit))

    @cached_property
    def _own(self) -> tuple[Array, Array, StandingLoop]:
        """What is the same for all samples, the log of a loop, and this loop."""
        spec = _loop().spec
        uniform, log = np.array(self._study.circuit()), np.empty((1, _ROWS, len(spec.logged), 1))
        rings, lengths = rings_of_taken(self.per_mean)
        loop = _loop().standing(empty_rows(spec, 1), uniform, rings=rings, ring_length=lengths, log=log, every=1)
        return uniform, log, loop

    def _taken(self, x: Array, circuit: FilterGrid) -> Array:
        """TAKEN_COLUMNS of (n, 8), the first columns of a log, of samples with one circuit."""
        uniform, log, loop = self._own
        uniform[: len(circuit)] = circuit
        begin, end = self.length, self.length + len(x)
        loop.log_from(begin)
        x = x if x.strides[1] == x.itemsize else x.copy()
        loop(begin, end, x[None, :, :, None])
        return log[0, : end - begin, :, 0]

    def _keep(self, taken: Array) -> None:
        """(n, 6), TAKEN_COLUMNS of the next samples."""
        begin, end = self.length, self.length + len(taken)
        *found, sum_P, sum_Q = taken.T
        signals = self._signals
        for values, own in zip(signals[1:], found, strict=True):
            values[begin:end] = own
        logged = -begin % self._apart
        count: Array | int = self.per_mean
        if begin + logged < count:
            count = np.minimum(np.arange(begin + logged, end, self._apart) + 1, count)
        means = self._means[:, (begin + logged) // self._apart :]
        for values, first, total in zip(means, (signals.P_pcc[0], signals.Q_pcc[0]), (sum_P, sum_Q), strict=True):
            some = total[logged :: self._apart]
            mean = np.divide(some, count, out=values[: len(some)])
            mean += first
        self.length = end

    @property
    def signals(self) -> SignalsAtPcc:
        """What has been taken."""
        return SignalsAtPcc(*(values[: self.length] for values in self._signals))

    @property
    def means(self) -> Array:
        """(2, n): means of P_pcc and Q_pcc in the rows of the study's log, W and var."""
        return self._means[:, : -(-self.length // self._apart)]

    def end_of(self, run: Simulation) -> Simulation:
        """The end of the run with a row for each of these samples: the whole of it where survival is judged, else as
        much as decides whether it rests (:func:`first_resting`)."""
        log, more = (np.concatenate(parts) for parts in zip(*self._kept, strict=True))
        return replace(run, t_s=self.signals.t_s[-len(log) :], log=log, circuit_log=more)


def signals_at_pcc(study: Study, run: Simulation | Twin) -> SignalsAtPcc:
    """Powers and current at the PCC in all rows of the log of a run, or of its twin."""
    found = EverySample(study, run.timeline, 1, run.t_s)
    found.take(0, 1, run.log, run.circuit_log)
    return found.signals


def without_steps(study: Study, run: Simulation, seen: SignalsAtPcc) -> dict[float, SignalsAtPcc]:
    """What the powers of a run are without each of its steps that has a twin, by the time of the step, s: arrays as
    long as those of the run, ``seen``, and equal to them outside the twin."""
    found = {}
    for twin in run.twins:
        own = signals_at_pcc(study, twin)
        first = int(np.searchsorted(seen.t_s, own.t_s[0] - 0.5 * (seen.t_s[1] - seen.t_s[0]))) if len(own.t_s) else 0
        powers = {name: getattr(seen, name).copy() for name in ("P_pcc", "Q_pcc")}
        for name, values in powers.items():
            values[first : first + len(own.t_s)] = getattr(own, name)[: len(values) - first]
        found[twin.event_s] = seen._replace(**powers)
    return found


def first_resting(t_s: Array) -> int:
    """The first row of the end of a run in which it must rest, and one row before it, from which that one counts."""
    return max(int(np.searchsorted(t_s, t_s[-1] - RESTING_S)) - 1, 0)
