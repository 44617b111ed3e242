"""The numbers of runs of one kind side by side, found by their names, and the compiled loops that move them.

A run alone is a batch of one.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import LoopSpec, Program, StandingLoop, aligned_zeros
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.simulation.between_rows import BetweenRows, KeptColumns
from vsgdesign.simulation.circuit_program import CutSample, ProgramWriter
from vsgdesign.simulation.field_feed import probe_of, settings_of_study
from vsgdesign.simulation.loop import ALONE, Build, carrier_values, fed_names, loop_of, spans_of, spec_of
from vsgdesign.simulation.run_kind import Kind, names_of
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


class Numbers:
    """Numbers of a loop for G groups of L runs, of which the first ``count`` are used.

    A number is found by its name, those of a record by the record's (``put("refs.P_ref", values)``). Behind the numbers
    of the loop there are others that nothing but the program writes (``kept``).
    """

    def __init__(self, spec: LoopSpec, count: int, kept: Mapping[str, int] | None = None) -> None:
        """``kept``: how many numbers are kept under which name."""
        self.spec, self.count = spec, count
        self.spans = spans_of(spec.rows)
        self.place = {name: row for row, name in enumerate(spec.rows)}
        self.kept: dict[str, int] = {}
        at = len(spec.rows)
        for name, numbers in (kept or {}).items():
            self.kept[name], at = at, at + numbers
        self.rows: Array = aligned_zeros((-(-count // spec.width), at, spec.width))
        """(G, R, L)."""

    def __len__(self) -> int:
        return self.count

    def span(self, name: str) -> slice:
        """The rows of a record or of a number."""
        return self.spans[name]

    def lane(self, run: int) -> tuple[int, int]:
        """Group and place in the group of a run."""
        return divmod(run, self.spec.width)

    def view(self, name: str, run: int = 0) -> Array:
        """The numbers of a record of one run as an array that moves with it."""
        group, lane = self.lane(run)
        return self.rows[group, self.spans[name], lane]

    def set(self, name: str, record: Any, run: int = 0) -> None:
        """Sets the numbers of a record of one run."""
        self.view(name, run)[:] = flat_state(record) if name == "state" else record

    def get(self, row: int | str) -> Array:
        """A row of every run, (n,)."""
        place = self.place[row] if isinstance(row, str) else row
        return self.rows[:, place, :].reshape(-1)[: self.count].copy()

    def put(self, row: int | str, values: Any) -> None:
        """Sets a row of every run, (n,), or m rows that are beside each other, (m, n).

        Places that are left in the last group take what the last run has.
        """
        values = np.asarray(values, dtype=float)
        values = values[None] if values.ndim == 1 else values
        groups, _, width = self.rows.shape
        first = self.spans[row].start if isinstance(row, str) else row
        to = self.rows[:, first : first + len(values)]
        whole = self.count // width
        to[:whole] = values[:, : whole * width].reshape(len(values), whole, width).swapaxes(0, 1)
        if whole < groups:
            rest = values[:, whole * width :]
            to[whole, :, : rest.shape[1]], to[whole, :, rest.shape[1] :] = rest, rest[:, -1:]


Samples = NDArray[np.int64]

STANDS = 2.0
"""What a run has found by standing still before the interval in which the instant lies; 1: it has gone on."""

_NEVER = 2**62
"""A sample that no run reaches."""


@dataclass(eq=False)
class Log:
    """What a batch logs of its runs."""

    rows: Array
    """(G, slots, n, L)."""
    names: tuple[str, ...]
    """What its n columns are."""
    every: int = 1
    """It has every so-many-th sample of the run …"""
    begin: int = 0
    """… from this one on, a whole multiple of ``every``."""
    end: int | None = None
    """It ends before this sample; None: it never does."""
    into: Log | None = None
    """The log whose columns its first ones are, and which gets its rows as well, or every so-many-th of them."""
    again: bool = False
    """Whether the batch itself writes it anew whenever it is full."""

    @property
    def room(self) -> int:
        """For how many samples it has room."""
        return self.rows.shape[1] * self.every

    def hand_on(self, begin: int, end: int) -> None:
        """Its rows of samples ``begin`` to ``end`` − 1 are new: the log that it writes into gets them."""
        if (into := self.into) is None:
            return
        first, last = -(-begin // into.every), -(-end // into.every)
        at = range(first * into.every - self.begin, end - self.begin, into.every)
        rows = slice(at.start // self.every, at.stop // self.every + 1, into.every // self.every)
        into.rows[:, first:last] = self.rows[:, rows, : into.rows.shape[2]][:, : last - first]


class Batch(Numbers):
    """Runs of one kind: G groups of L, of which the first ``count`` are used."""

    def __init__(
        self,
        kind: Kind,
        study: Study,
        count: int,
        build: Build = ALONE,
        *,
        logged: tuple[str, ...] = (),
        kept: Mapping[str, int] | None = None,
        shared: Mapping[str, float] | None = None,
    ) -> None:
        """``kept``: how many numbers are kept under which name. ``shared``: numbers that are the same for all runs and
        not of the study."""
        self.kind, self.study, self.build = kind, study, build
        super().__init__(spec_of(kind, logged, build), count, kept)
        self._shared = dict(shared or {})
        self.uniform = self._uniform(self.spec.uniform)
        self.program: Program = ProgramWriter().program(len(self.rows), self.spec.width)
        self.rings: Array | None = None
        self.ring_length: Samples | None = None
        self.logs: tuple[Log, ...] = ()
        """In the order of time."""
        self.between: BetweenRows | None = None
        self.seen: KeptColumns | None = None
        """Both get every sample that is logged."""
        self._cyclic, self._cycle = carrier_values(kind.bridge.slopes)
        self.others: dict[tuple[int, int], Array] = {}
        """What is added to the source over the later pieces of a cut interval, (pieces − 1, states), by run and sample.
        """
        self._cut: dict[int, list[CutSample]] = {}
        self._borders: list[int] = [_NEVER]
        """Samples at which one call of a loop ends: a cut sample is a call of its own, and so is each log."""
        self._fed_by_sensors = len(fed_names(kind._replace(added=False)))
        self._standing: dict[tuple[bool, int], StandingLoop] = {}

    def _uniform(self, names: Sequence[str]) -> Array:
        return np.array([self._same_for_all[name] for name in names])

    @cached_property
    def _same_for_all(self) -> dict[str, float]:
        """The numbers that are the same for all runs, by their names."""
        study = self.study
        known = {"R_c": study.filter.R_c, "V_dc": study.converter.V_dc}
        records: dict[str, Any] = {"inner_gains": study.inner_gains, "circuit": study.circuit()}
        records["settings"] = study.controller_settings()
        if self.kind.field:
            records["field"] = settings_of_study(study)
            known |= {"V_rated_rms": study.converter.V_rated_rms, "allowed": float(probe_of(study).send)}
        for head, record in records.items():
            paths = names_of(type(record), head, self.kind.records)
            known |= dict(zip(paths, map(float, numbers_of(record)), strict=True))
        return known | self._shared

    # What is known beforehand.

    def follow(self, writer: ProgramWriter, cut: Sequence[CutSample] = ()) -> None:
        """What happens in the runs from their beginning on."""
        self.program = writer.program(len(self.rows), self.spec.width)
        self.cut_only(cut)

    def cut_only(self, cut: Sequence[CutSample]) -> None:
        """Events fall in the intervals of these samples alone."""
        self._cut = {}
        for one in cut:
            self._cut.setdefault(one.sample, []).append(one)
        self._divide()

    @property
    def cut(self) -> list[CutSample]:
        """The samples in whose intervals events fall."""
        return [one for some in self._cut.values() for one in some]

    def follow_anew(self, run: int, writer: ProgramWriter, cut: Sequence[CutSample], sample: int) -> None:
        """What happens in one run from a sample on, in place of what was known. What is due before this sample is put
        into its rows at once; the loop goes on with the next one."""
        group, lane = self.lane(run)
        old, new = self.program, writer.program(len(self.rows), self.spec.width)
        of_old = np.repeat(np.arange(len(old.done)), np.diff(old.first))
        kept = (of_old != group) | (old.lane != lane) | (old.at < sample)
        later = new.at >= sample
        moved = np.where(new.source >= 0, new.source + len(old.values), new.source)
        groups = np.concatenate([of_old[kept], np.full(int(later.sum()), group)])
        columns = {name: (getattr(old, name), getattr(new, name)) for name in ("at", "lane", "row", "count")}
        parts = {name: np.concatenate([a[kept], b[later]]) for name, (a, b) in columns.items()}
        order = np.lexsort((np.arange(len(groups)), parts["at"], groups))
        first = np.searchsorted(groups[order], np.arange(len(old.done) + 1)).astype(np.int64)
        source = np.concatenate([old.source[kept], moved[later]])[order]
        parts = {name: values[order] for name, values in parts.items()}
        due = np.bincount(groups[order][parts["at"] <= sample], minlength=len(old.done))
        values = np.concatenate([old.values, new.values])
        self.program = Program(first=first, source=source, values=values, done=first[:-1] + due, **parts)
        self._put_due(self.rows[group, :, lane], run, sample)
        self._cut = {at: [one for one in some if one.lane != run or at < sample] for at, some in self._cut.items()}
        for one in cut:
            if one.sample >= sample:
                self._cut.setdefault(one.sample, []).append(one)
        self._divide()

    def cut_at(self, run: int, sample: int) -> CutSample:
        """A sample of a run as its own loop is given it, whether events fall in its interval or not."""
        of_run = next((one for one in self._cut.get(sample, ()) if one.lane == run), None)
        slopes = self.kind.bridge.slopes
        if of_run is not None or not slopes:
            return of_run or CutSample(run, sample, ("",), {})
        place = sample % len(slopes)
        return CutSample(run, sample, (slopes[place],), {"part": self._cyclic[place]})

    def _put_due(self, now: Array, run: int, sample: int) -> None:
        """Puts what is due before a sample into the numbers of a run."""
        group, lane = self.lane(run)
        p, due = self.program, slice(self.program.first[group], self.program.first[group + 1])
        for r in np.flatnonzero((p.at[due] == sample) & (p.lane[due] == lane)) + due.start:
            row, count, source = p.row[r], p.count[r], p.source[r]
            values = p.values[source : source + count] if source >= 0 else now[-1 - source : -1 - source + count].copy()
            now[row : row + count] = values

    def log(self, *logs: Log) -> None:
        """What is logged from now on, one after the other."""
        self.logs = logs
        self._divide()

    def apart(self) -> Self:
        """A batch with the same numbers, at the same place of the same program, which goes its own way from here on and
        logs nothing."""
        other = copy(self)
        other.rows = aligned_zeros(self.rows.shape)
        other.rows[:] = self.rows
        other.program = replace(self.program, done=self.program.done.copy())
        other._standing, other.between, other.seen = {}, None, None
        other.log()
        return other

    def log_anew(self, begin: int) -> None:
        """The last log is written anew from its first row on, which is that of sample ``begin``."""
        self.logs[-1].begin = begin
        for (_, number), loop in self._standing.items():
            if number == len(self.logs) - 1:
                loop.log_from(begin)

    def _divide(self) -> None:
        borders = {log.begin for log in self.logs} | {log.end for log in self.logs if log.end is not None}
        borders |= {at for sample in self._cut for at in (sample, sample + 1)}
        self._borders = [*sorted(borders), _NEVER]
        self._standing.clear()

    # Samples.

    def advance(self, begin: int, end: int, fed: Array | None = None, groups: int | None = None) -> int:
        """Moves the runs of the first ``groups`` (None: all) through samples ``begin`` to ``end`` − 1, or fewer where a
        field estimator that is alone ends its cycle. Returns how many.

        ``fed`` (G, end − begin, n, L): what is given sample by sample (:func:`fed_names`); without the columns of the
        source where nothing is added to it, and None where nothing is fed at all.
        """
        at = begin
        while at < end:
            stop = min(end, self._borders[bisect_right(self._borders, at)])
            if self.logs and (log := self.logs[-1]).again:
                stop = min(stop, at + log.room - log.every)
                if stop - log.begin > log.room:
                    self.log_anew(at // log.every * log.every)
            here = None if fed is None else fed[:, at - begin : stop - begin]
            after = [(one, self.after_cut(one, here)) for one in self._cut.get(at, ())]
            done = self._call(at, stop, here, groups)
            for one, state in after:
                if not self.kind.seeks or self.found(one.lane) < STANDS:  # else it is computed anew
                    self.put_state(one.lane, state)
            at += done
            if done < stop - (at - done) or (after and self.spec.stop):
                break
        return at - begin

    def advance_with(
        self,
        program: Program,
        begin: int,
        end: int,
        *,
        first: int = 0,
        fed: Array | None = None,
        log: Array | None = None,
        together: bool = False,
    ) -> None:
        """Moves the runs of some groups, from ``first`` on as many as the program has, with another program than their
        own. ``log`` (groups, L, slots, n) gets what they log, each in the slots of its own samples. ``together``: none
        of them has to wait."""
        groups = slice(first, first + len(program.done))
        made = loop_of(self.kind._replace(added=self._adds(fed), together=together), self.spec.logged, self.build)
        given: dict[str, Any] = {"cyclic": self._cyclic, "cycle": self._cycle} if self.kind.bridge.slopes else {}
        if self.rings is not None and self.ring_length is not None:
            given |= {"rings": self.rings[groups], "ring_length": self.ring_length[groups]}
        if log is not None:
            given |= {"log": log, "every": 1}
        made.loop(begin, end, self.rows[groups], self.uniform, program=program, fed=fed, **given)

    def _adds(self, fed: Array | None) -> bool:
        """Whether what is fed has something that is added to the source."""
        return fed is not None and fed.shape[2] > self._fed_by_sensors

    def _call(self, begin: int, end: int, fed: Array | None, groups: int | None) -> int:
        number = next((k for k, log in enumerate(self.logs) if log.begin <= begin < (log.end or end)), -1)
        key = self._adds(fed), number
        if key not in self._standing:
            log = self.logs[number] if number >= 0 else None
            kind = self.kind._replace(added=key[0])
            made = loop_of(kind, self.spec.logged if log is None else log.names, self.build)
            given: dict[str, Any] = {"program": self.program}
            if self.rings is not None and self.ring_length is not None:
                given |= {"rings": self.rings, "ring_length": self.ring_length}
            if log is not None:
                given |= {"log": log.rows, "every": log.every, "log_begin": log.begin}
            self._standing[key] = made.loop.standing(
                self.rows,
                self.uniform,
                cyclic=self._cyclic if made.spec.cyclic else None,
                cycle=self._cycle if len(made.spec.bodies) > 1 else None,
                **given,
            )
        done = self._standing[key](begin, end, fed, groups)
        if number >= 0:
            log = self.logs[number]
            for taker in (self.between, self.seen):
                if taker is not None:
                    taker.take(begin, log.rows[:, begin - log.begin : begin + done - log.begin])
            log.hand_on(begin, begin + done)
        return done

    @property
    def any_found(self) -> bool:
        """Whether any run has found an instant in the last sample."""
        return bool(self.rows[:, self.place["seek.found"]].any())

    def found(self, run: int) -> float:
        """Whether a run has found an instant in the last sample, after which the loop has ended: 0, 1, or STANDS."""
        group, lane = self.lane(run)
        return float(self.rows[group, self.place["seek.found"], lane])

    def state(self, run: int) -> Array:
        """The numbers that a sample moves of one run."""
        group, lane = self.lane(run)
        return self.rows[group, : len(self.spec.state), lane].copy()

    def put_state(self, run: int, state: Array) -> None:
        """Sets the numbers that a sample moves of one run."""
        group, lane = self.lane(run)
        self.rows[group, : len(state), lane] = state

    def after_cut(self, one: CutSample, fed: Array | None, at: int | None = None, first: int = 0) -> Array:
        """The state of a run after a sample in whose interval events fall. ``at``: the sample of the loop, if it is
        not that of the run; ``first``: the group with which ``fed`` begins."""
        k, (group, lane) = one.sample, self.lane(one.lane)
        build = self.build._replace(lanes=1, vectors=1, quickly=True)  # it runs for one sample of one run
        own = loop_of(self.kind._replace(added=self._adds(fed), cut=one.slopes), (), build)
        now = self.rows[group, :, lane].copy()
        self._put_due(now, one.lane, k)
        rows = np.zeros((1, len(own.spec.rows), 1))
        for name, place in own.place.items():
            if name in self.place:
                rows[0, place] = now[self.place[name]]
        more = {f"piece_{k}.more": values for k, values in enumerate(self.others.get((one.lane, k), ()), 1)}
        for name, values in (one.values | more).items():
            if name in own.spans:
                begin = own.spans[name].start
                rows[0, begin : begin + len(values)] = values[:, None]
        if self.rings is not None and self.ring_length is not None:
            slot = (k if at is None else at) % int(self.ring_length[group])
            names = (name for name, _ in self.spec.rings)
            for name, value in zip(names, self.rings[group, slot, :, lane], strict=True):
                rows[0, own.place[name]] = value
        if self.kind.waits:  # it does not stand still in this sample
            rows[0, own.place["lock.closed"]] = 0.0
        given = None
        if fed is not None:
            given = np.ascontiguousarray(fed[group - first : group - first + 1, :1, :, lane : lane + 1])
        own.loop(k, k + 1, rows, self._uniform(own.spec.uniform), fed=given)
        return rows[0, : len(own.spec.state), 0]
