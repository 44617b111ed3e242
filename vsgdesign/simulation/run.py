"""Simulates controllers through their studies' scenarios. A single run is a batch of one."""

from __future__ import annotations

import functools
import itertools
import math
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.errors import SimulationDivergedError, VsgDesignError
from vsgdesign.execution.signals import interrupts_deferred
from vsgdesign.identification import Probe
from vsgdesign.simulation.added_source import PROGRESS_STRETCH
from vsgdesign.simulation.batch import Batch, Log
from vsgdesign.simulation.between_rows import BetweenRows, KeptColumns
from vsgdesign.simulation.circuits import CircuitOfGrid, Circuits, KnownStarts, start_of
from vsgdesign.simulation.every_sample import BLOCK, EverySample, rings_of_taken
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.loop import (
    ALONE,
    LOG_COLUMNS,
    fed_names,
    kind_of,
    log_names,
    side_by_side,
)
from vsgdesign.simulation.online import OnlineScheduler
from vsgdesign.simulation.outcome import Divergence
from vsgdesign.simulation.run_asked import RunOf, Twin
from vsgdesign.simulation.run_kind import TAKEN_COLUMNS
from vsgdesign.simulation.run_state import RunState, program_of
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.simulation.twin import TwinRun, Twins
from vsgdesign.simulation.updates_together import UpdatesTogether, updates_of
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_SHORT = 50_000
"""Samples of all runs of a loop. For as many it does not pay to compile the loop with effort: that takes 0.02 to 0.05 s
longer and saves 0.02 microseconds a sample, or 0.2 with sensors. The bits are the same."""

_PART = 1024
"""So many rows of several runs are logged before the log is written anew: a part stays in the processor's memory."""

_LOGGED_TOGETHER = 1_600_000
"""So many samples at most do runs side by side log together: they take 0.1 GB, or 0.2 GB where all of each is kept."""

_SPELL_STRETCHES, _SPELL_SAMPLES = 32, 4096
"""Stretches and samples for which an interrupt may wait."""

Progress = Callable[[float], None]
"""Called with the simulated time in s; may raise to stop the run."""


@dataclass(frozen=True)
class Simulation:
    """One finished run. ``log`` has a row per logged sample and LOG_COLUMNS as columns, SI, peak αβ."""

    t_s: NDArray[np.float64]
    log: NDArray[np.float64]
    circuit_log: NDArray[np.float64]
    """The circuit's states besides i_s, v_c and i_g in the same rows, SI, peak αβ: those of load and grid
    (:class:`vsgdesign.linear.operating_point.network.NetworkStates`); no columns where nothing but a grid is
    connected."""
    controller_log: NDArray[np.float64]
    """All controller states at the first samples, as many as were asked for; else zero rows."""
    study: Study
    """As it ran: with the instants that only this run could tell among its events."""
    timeline: Timeline
    gain_changes: tuple[GainChange, ...]
    final_state: ControllerState
    final_plant: NDArray[np.float64]
    loop_seconds: float
    """Wall time inside the compiled loop."""
    divergence: Divergence | None = None
    """Where and why the run was broken off; logs end there. None: it went to its end."""
    dc_log: NDArray[np.float64] | None = None
    """The dc link in the rows of ``log``, with :func:`vsgdesign.simulation.dc_start.dc_columns`; None: it is ideal."""
    dc_end: NDArray[np.float64] | None = None
    """The same at the last sample of which figures are taken, which may come after the last row."""
    twins: tuple[Twin, ...] = ()
    """The run without a step beside it, for each step for which it was asked for."""
    between: NDArray[np.float64] | None = None
    """What rows say of the samples between them (:class:`vsgdesign.simulation.between_rows.Row`), where they were asked
    for: those of samples 0, every, 2·every, …"""
    seen: Mapping[str, NDArray[np.float64]] | None = None
    """Of every sample, (n,) each, what :data:`vsgdesign.simulation.loop.SEEN_COLUMNS` names, where a log with fewer
    rows was asked for; else None."""

    def to_its_end(self) -> Simulation:
        """The run itself. Raises SimulationDivergedError where it was broken off: for what cannot use a part of it."""
        if self.divergence is not None:
            raise SimulationDivergedError(self.divergence.reason)
        return self

    @property
    def interval(self) -> float:
        """Time between two rows of the log, s."""
        return float(self.t_s[1] - self.t_s[0])

    def column(self, name: str) -> NDArray[np.float64]:
        """One logged quantity by name."""
        return self.log[:, LOG_COLUMNS.index(name)]

    def each(self, name: str) -> NDArray[np.float64]:
        """One quantity at every sample, where these were kept beside a log with fewer rows; else as it is logged."""
        return self.column(name) if self.seen is None else self.seen[name]

    @cached_property
    def each_s(self) -> NDArray[np.float64]:
        """The instants of :meth:`each`, s."""
        if self.seen is None:
            return self.t_s
        return np.arange(len(self.seen["P"]), dtype=float) * self.study.converter.T_s

    def every(self, rows: int) -> Simulation:
        """The run with every so-many-th row of its log."""
        kept = {name: getattr(self, name)[::rows].copy() for name in ("t_s", "log", "circuit_log")}
        return replace(self, dc_log=None if self.dc_log is None else self.dc_log[::rows].copy(), **kept)


def simulate(
    study: Study,
    schedule: Sequence[GainChange] | OnlineScheduler | FieldScheduler,
    *,
    bridge: str | None = None,
    log_states: int = 0,
    probe: Probe | None = None,
    circuit: CircuitOfGrid | None = None,
    twins: Sequence[float] = (),
    every_sample: EverySample | None = None,
    finds: ControllerSpec | None = None,
    progress: Progress | None = None,
) -> Simulation:
    """Simulate a study with given gains over time (the first change at or before t = 0), or with a scheduler
    that is asked for them during the run: after each of its windows, or after each cycle of a field estimator.

    ``bridge`` overrides the study's ("averaged" or "pwm"); ``log_states`` keeps the controller's states at the
    first so many samples; ``probe`` is sent from t = 0 on, in place of one that the scheduler asks for, and not
    beside that of a field estimator; ``circuit`` replaces the study's circuit between bridge and source, and its axes
    may differ; ``twins``: the instants of steps beside which the run without them is wanted (:mod:`.twin`);
    ``every_sample`` gets every sample, whatever is logged.

    With ``finds``, the controller whose gains these are, the run finds the instants that only it can tell: each phase
    of a fault that is cleared is interrupted at a zero of its current (:eq:`fault-current`), and a breaker that waits
    closes when it may (:eq:`synchro-check`). They are events of the study that is returned. Without it, all events come
    at the instants that they give, and a breaker that waits stays open.

    Raises InfeasibleStudyError where the start has no steady state or a scheduler's or probe's period does
    not fit the sampling. A run whose states leave every sensible bound ends there and says so (``divergence``);
    SimulationDivergedError is raised where less than two rows of the log come before, or of ``every_sample``.
    """
    of = RunOf(study, schedule, log_states, probe, circuit, tuple(twins), every_sample, finds)
    return simulated(of, bridge=bridge, progress=progress)


def simulated(of: RunOf, *, bridge: str | None = None, progress: Progress | None = None) -> Simulation:
    """What is simulated, alone, as :func:`simulate` does it."""
    run = RunState(of)
    switched = (of.study.simulation.bridge if bridge is None else bridge) == "pwm"
    run_together([run], switched=switched, progress=progress)
    diverged = _diverged(run)
    if diverged is not None:
        raise diverged
    return simulation_of(run)


def simulated_together(asked: Sequence[RunOf]) -> Iterator[tuple[int, Simulation | VsgDesignError]]:
    """Runs of one controller of one converter, with an averaged bridge: each as :func:`simulated` gives it alone, to
    the same bits, or the error that it raises, with its place among those asked for. Those of one kind go side by side.
    The order is that in which they end."""
    groups: dict[Hashable, list[tuple[int, RunState]]] = {}
    for number, of in enumerate(asked):
        try:
            run = RunState(of)
        except VsgDesignError as error:
            yield number, error
        else:
            groups.setdefault(number if run.goes_alone else run.like, []).append((number, run))
    most, known = side_by_side(strict=True).lanes, KnownStarts()
    for group in groups.values():
        group.sort(key=lambda one: one[1].samples)  # a run waits for the longest of its group
        while group:
            count = next(n for n in range(min(most, len(group)), 0, -1) if _fits([run for _, run in group[:n]]))
            some, group[:] = group[:count], group[count:]
            yield from _of_group(some, known)


def _fits(runs: Sequence[RunState]) -> bool:
    """Whether the logs of runs side by side do not take too much memory."""
    return len(runs) == 1 or len(runs) * max(run.samples for run in runs) <= _LOGGED_TOGETHER


def _of_group(
    group: list[tuple[int, RunState]], known: KnownStarts
) -> Iterator[tuple[int, Simulation | VsgDesignError]]:
    try:
        run_together([run for _, run in group], switched=False, known=known)
    except VsgDesignError as error:
        if len(group) == 1:
            yield group[0][0], error
            return
        lost = {number: fault for number, run in group if (fault := _fault_of_start(run)) is not None}
        yield from lost.items()
        rest = [(number, RunState(run.of)) for number, run in group if number not in lost]
        for some in [rest] if lost else [[one] for one in rest]:  # where none is found, something else is in the way
            if some:
                yield from _of_group(some, known)
        return
    for number, run in group:
        yield number, _diverged(run) or simulation_of(run)
    for _, run in group:
        run.let_go()


def _fault_of_start(run: RunState) -> VsgDesignError | None:
    """Why a run cannot begin; None: it can."""
    try:
        start_of(run.study, run.timeline, _circuits_of([run], switched=False), run.feed.first())
    except VsgDesignError as error:
        return error
    return None


def _diverged(run: RunState) -> SimulationDivergedError | None:
    """The error of a run that diverged before there was anything to see."""
    return SimulationDivergedError(run.divergence.reason) if run.too_short and run.divergence is not None else None


def check_run(
    study: Study, schedule: Sequence[GainChange] | OnlineScheduler | FieldScheduler, *, bridge: str | None = None
) -> None:
    """Prepares a run up to its first sample. Raises what :func:`simulate` raises until then."""
    run = RunState(RunOf(study, schedule))
    switched = (study.simulation.bridge if bridge is None else bridge) == "pwm"
    begin_together([run], switched)
    program_of([run])


def run_together(
    runs: Sequence[RunState],
    *,
    switched: bool,
    progress: Progress | None = None,
    known: KnownStarts | None = None,
) -> None:
    """Takes runs of one kind to their ends, side by side: in groups of as many as a register holds, because the loop of
    a group ends where one of its runs has found an instant. More than one have no field estimators. ``known``: starts
    of this controller that are known, which get those of these runs: many tests begin on the same grid at the same
    powers."""
    if len(runs) > (most := side_by_side(strict=True).lanes):
        for some in (runs[k : k + most] for k in range(0, len(runs), most)):
            run_together(some, switched=switched, progress=progress, known=known)
        return
    batch = begin_together(runs, switched, known)
    batch.follow(*program_of(runs))
    twins, updates, begin = Twins(runs[0], batch), updates_of(runs, batch), 0
    while begin >= 0:  # from the instants that are found on, the runs have other events
        begin = _spells(runs, batch, twins, updates, begin, progress)
    if updates is not None:
        updates.hand_over()
    for run in runs:
        if run.divergence is None:
            run.finish()
        else:
            run.give_up()
    runs[0].twins = twins.finish()


def _spells(
    runs: Sequence[RunState],
    batch: Batch,
    twins: Twins,
    updates: UpdatesTogether | None,
    begin: int,
    progress: Progress | None,
) -> int:
    """Takes the runs from a sample on to their ends, or to the sample before which one of them has found an instant.
    Returns this sample; -1 at their ends."""
    due: dict[int, list[RunState]] = {}
    for run in runs:
        for mark in run.own_stops:
            due.setdefault(mark, []).append(run)
    if updates is not None:
        updates.hear()
        due = {mark: [] for mark in updates.marks(max(due))} | due
    with interrupts_deferred() as deliver:
        for some in _in_spells(sorted({begin, *(mark for mark in due if mark >= begin)})):
            for first, following in some:
                if updates is not None:
                    updates.make(first)
                done, changed = _through(runs, due, batch, twins, first, following)
                if changed:
                    return done
            deliver()
            if all(run.divergence is not None for run in runs):
                break
            if progress is not None:
                progress(some[-1][1] * runs[0].T_s)
    return -1


def _through(
    runs: Sequence[RunState], due: dict[int, list[RunState]], batch: Batch, twins: Twins, first: int, following: int
) -> tuple[int, bool]:
    """Takes the runs through a stretch, with whatever is ``due`` before and after it. Returns the sample before which
    they are, and whether one of them has found an instant there."""
    twin = twins.begin(first)
    if runs[0].of.every_sample is not None:
        runs[0].log.make_room(first, following)
    for run in due.get(first, ()):
        run.before(first)
    if twin is not None:
        twin.before(first)
    fed = _fed(runs, batch, first, following - first)
    clock = time.perf_counter()
    done, changed = _advance(runs, batch, first, following, fed, twin)
    runs[0].loop_seconds += time.perf_counter() - clock
    for run in [one for one in runs if done in one.own_stops] if changed else due[following]:
        run.after(done)
    if twin is not None:
        twin.after(done)
        twins.cut(done if changed else None)
    return done, changed


def _in_spells(marks: list[int]) -> Iterator[list[tuple[int, int]]]:
    """The stretches between marks, several together as long as they take some milliseconds: so long an interrupt
    waits."""
    spell: list[tuple[int, int]] = []
    for first, following in itertools.pairwise(marks):
        spell.append((first, following))
        if len(spell) == _SPELL_STRETCHES or following - spell[0][0] >= _SPELL_SAMPLES:
            yield spell
            spell = []
    if spell:
        yield spell


def simulation_of(run: RunState) -> Simulation:
    """A run that is over, as a result."""
    rows, every = run.log.rows, run.kept // run.log_every
    in_place = rows.flags.c_contiguous or rows[:, 0].flags.c_contiguous
    rows = rows if every == 1 and in_place else rows[::every].copy()
    t_s = np.arange(len(rows), dtype=float) * (run.kept * run.T_s)
    if run.log.seen is not None:  # to the last bit the instants of these samples
        t_s = np.arange(0, len(rows) * run.kept, run.kept, dtype=float) * run.T_s
    return Simulation(
        t_s=t_s,
        log=rows,
        circuit_log=run.log.more[::every].copy(),
        dc_log=None if run.study.dc is None else run.log.dc[::every].copy(),
        dc_end=None if run.study.dc is None else run.log.dc_end,
        controller_log=run.log.states,
        study=run.study,
        timeline=run.timeline,
        gain_changes=tuple(run.feed.changes),
        final_state=run.final_state,
        final_plant=run.final_plant,
        loop_seconds=run.loop_seconds,
        divergence=run.divergence,
        twins=run.twins,
        between=run.between,
        seen=run.log.seen,
    )


def begin_together(runs: Sequence[RunState], switched: bool, known: KnownStarts | None = None) -> Batch:
    """The runs at their starts."""
    study, first = runs[0].study, runs[0]
    circuits = _circuits_of(runs, switched=switched)
    memory = first.feed.memory
    sensors = study.sensors is not None and study.sensors.act
    seeks = tuple(dict.fromkeys(what for run in runs for what in run.search.seeks))
    kind = kind_of(study, switched=switched, axes=circuits.axes)
    seen = first.of.every_sample
    taken = seen is not None and seen.fits_loop and first.of.circuit is None and not seeks
    kind = kind._replace(sensors=sensors, field=memory is not None, seeks=seeks, taken=taken)
    samples = max(run.samples for run in runs)
    build = ALONE if len(runs) == 1 else side_by_side(strict=True)._replace(vectors=1)
    build = build._replace(quickly=samples * len(runs) <= _SHORT)
    shared = {} if memory is None else {"allowed": memory.allowed}
    batch = Batch(kind, study, len(runs), build, logged=log_names(kind), shared=shared)
    if seen is not None and taken:
        batch.rings, batch.ring_length = rings_of_taken(seen.per_mean)
    every = math.gcd(*(run.log_every for run in runs))
    batch.log(*_logs(batch, samples, every, first.of))
    if first.of.rows is not None and first.of.rows.thin:
        batch.seen = KeptColumns(len(batch), samples, batch.build)
    if first.of.rows is not None:
        batch.between = BetweenRows(study, first.of.rows, samples, batch.build.lanes, batch.build.vectors)
    for number, run in enumerate(runs):
        start = start_of(run.study, run.timeline, circuits, run.feed.first(), known)
        run.begin(batch, number, start, circuits)
    return batch


def _circuits_of(runs: Sequence[RunState], *, switched: bool) -> Circuits:
    """The circuits that runs meet, and may meet."""
    study, timelines = runs[0].study, [run.timeline for run in runs]
    possible = [one for run in runs for one in run.search.possible(run.timeline)]
    edged = kind_of(study, switched=switched).edged
    return Circuits(study, timelines, runs[0].of.circuit, switched=edged, possible=possible)


def _logs(batch: Batch, samples: int, every: int, of: RunOf) -> list[Log]:
    """The log of the runs, and before it that of their controllers' states at the first samples. Of a run of which
    every sample is given to something, it is filled from one that is written anew whenever it is full."""
    groups, _, width = batch.rows.shape
    names, states = log_names(batch.kind), min(of.log_states, samples)
    thin = of.rows is not None and of.rows.thin
    if len(batch) > 1 or thin:
        # Each column of each run in one piece: they are looked at one after the other.
        columns = np.empty((groups, width, len(names), -(-samples // every)))
        part = np.empty((groups, _PART, len(names), width))
        into = Log(columns.transpose(0, 3, 2, 1), names, every)
        return [Log(part, names, 1 if thin else every, into=into, again=True)]
    main = Log(np.empty((groups, -(-samples // every), len(names), width)), names, every)
    if of.every_sample is not None:
        spacing = math.gcd(of.every_sample.every, every)
        # The samples of a stretch come together.
        room = min(max(BLOCK, round(PROGRESS_STRETCH / batch.study.converter.T_s)), samples) // spacing + 1
        names = (*names, *TAKEN_COLUMNS) if batch.kind.taken else names
        return [Log(np.empty((groups, room, len(names), width)), names, spacing, into=main)]
    if not states:
        return [main]
    more = log_names(batch.kind, states_logged=True)
    return [Log(np.empty((groups, states, len(more), width)), more, end=states, into=main), main]


def _fed(runs: Sequence[RunState], batch: Batch, first: int, count: int, *, anew: bool = False) -> Array | None:
    """What the runs are given over a stretch, (G, count, n, L), or over a sample that is computed anew; None:
    nothing."""
    if not any(run.is_fed for run in runs):
        return None
    found = [run.fed(first, count, anew=anew) for run in runs]
    added = any(rows is not None for rows, _, _ in found)
    if not added and not batch.kind.sensors:
        return None
    batch.others = {(number, first): others for number, (_, others, _) in enumerate(found) if others is not None}
    names = fed_names(batch.kind._replace(added=added))
    groups, _, width = batch.rows.shape
    fed = np.zeros((groups, count, len(names), width))
    for number, (rows, _, noise) in enumerate(found):
        group, lane = batch.lane(number)
        if rows is not None:
            fed[group, :, : rows.shape[1], lane] = rows
        if noise is not None:
            fed[group, :, len(names) - noise.shape[1] :, lane] = noise
    return fed


def _advance(
    runs: Sequence[RunState], batch: Batch, first: int, end: int, fed: Array | None, twin: TwinRun | None = None
) -> tuple[int, bool]:
    """Moves the runs through a stretch, and a twin behind the only one. Returns the sample before which they are, and
    whether one of them has found an instant there, from which on it has other events. A field estimator's cycles may
    end anywhere within it, and a run that has diverged there goes no further."""
    done, changed = first, False
    while done < end and not changed:
        rest = None if fed is None else fed[:, done - first :]
        begun, done = done, done + batch.advance(done, end, rest)
        if twin is not None and not twin.lost:
            twin.follow(begun, done, rest)
        if batch.kind.seeks and (batch.any_found or any(run.looks_at(done - 1) for run in runs)):
            given = functools.partial(_fed, runs, batch, done - 1, 1, anew=True)
            found = [run.look(done - 1, given) for run in runs]
            changed = any(found)
        if batch.kind.field and not runs[0].conclude(done):
            break
        if batch.kind.field and twin is not None and not twin.lost:
            twin.conclude(done)
    return done, changed
