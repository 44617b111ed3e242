"""Runs a plant: all units in one lane of one loop, with what is known beforehand as records."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import compiled_loop, empty_rows
from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.equations.frames import peak_to_rms, rated_current_rms, rms_to_peak
from vsgdesign.equations.grid_following import SetPoints
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import References
from vsgdesign.errors import SimulationDivergedError
from vsgdesign.linear.operating_point.circuit_of_units import UnitsCircuit, circuit_of_units, wiring_of
from vsgdesign.linear.operating_point.flow_of_units import clock_of_study
from vsgdesign.linear.operating_point.sampled import cold_start
from vsgdesign.simulation.added_source import SensorsOfRun, sensors_of
from vsgdesign.simulation.circuit_program import ProgramWriter
from vsgdesign.simulation.dc_start import blocked, dc_changed, rows_before_block
from vsgdesign.simulation.field_observer import goes_on
from vsgdesign.simulation.gains import GainChange, with_gains
from vsgdesign.simulation.loop import LOG_COLUMNS, kind_of, spans_of
from vsgdesign.simulation.outcome import BOUND_PU, Divergence, outside
from vsgdesign.simulation.run_kind import Kind
from vsgdesign.simulation.units.added import AddedToPlant, adds, put_sensors, with_noise
from vsgdesign.simulation.units.body import (
    AXES,
    OtherKind,
    PlantKind,
    body_numbers,
    cyclic_values,
    link_names,
    log_names,
    spec_of_plant,
)
from vsgdesign.simulation.units.program import PlantProgram, cross, switched
from vsgdesign.simulation.units.start import StartOfPlant, uniform_of
from vsgdesign.simulation.units.timeline import PlantTimeline, blocks, plant_timeline
from vsgdesign.simulation.units.windows import Schedule, Tape, UnitGains
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_STRETCH = 4096
"""Periods of the clock between two looks at whether the run has diverged."""


@dataclass(frozen=True, kw_only=True)
class UnitRun:
    """One unit's part of a run: LOG_COLUMNS at every instant that is logged, SI, peak αβ."""

    name: str
    study: Study
    """The unit as one converter, with its events."""
    gain_changes: tuple[GainChange, ...]
    log: Array
    terminals: Array
    """(n, 2): the voltage at its terminals, behind L_2, α and β, V peak."""
    final_state: ControllerState
    dc_log: Array | None = None
    """Its dc link in the rows of ``log``, with :func:`vsgdesign.simulation.dc_start.dc_columns`; None: it is ideal."""

    def column(self, name: str) -> Array:
        """One logged quantity by name."""
        return self.log[:, LOG_COLUMNS.index(name)]


@dataclass(frozen=True, kw_only=True)
class InverterRun:
    """One inverter's part of a run: as of a unit, with the voltage that its controller takes for its capacitor's (rms)
    as ``V_rms``, its angle as ``theta``, and 1 in ``limited_samples`` where its current reference is at its limit."""

    name: str
    log: Array
    terminals: Array
    asked: tuple[tuple[float, SetPoints], ...]

    def column(self, name: str) -> Array:
        """One logged quantity by name."""
        return self.log[:, LOG_COLUMNS.index(name)]


@dataclass(frozen=True, kw_only=True)
class PlantRun:
    """A finished run of a plant."""

    study: Study
    timeline: PlantTimeline
    t_s: Array
    units: tuple[UnitRun, ...]
    circuit_log: Array
    """The circuit's other states, α and β in turn, as ``names`` says."""
    names: tuple[str, ...]
    loop_seconds: float
    """Wall time inside the compiled loop."""
    divergence: Divergence | None = None
    inverters: tuple[InverterRun, ...] = ()

    def unit(self, name: str) -> UnitRun:
        """The part of a unit."""
        return next(one for one in self.units if one.name == name)


def simulate_plant(
    study: Study,
    schedules: Sequence[Schedule],
    *,
    timeline: PlantTimeline | None = None,
    log_interval: float | None = None,
    progress: Callable[[float], None] | None = None,
    tape: Tape | None = None,
) -> PlantRun:
    """Simulates the plant of a study; each unit has its gains over time, or a field estimator that drives them.
    ``timeline``: that of the study, with the current limits of the controllers; None: without limits of their own.
    ``log_interval``: in place of the study's, s. ``tape``: where it is written down what the estimators do, or of
    which it is played.

    Raises InfeasibleStudyError where the start has no steady state, and SimulationDivergedError where the run leaves
    every sensible bound before two rows are logged.
    """
    logged = (
        study
        if log_interval is None
        else replace(study, simulation=replace(study.simulation, log_interval=log_interval))
    )
    return _Run(logged, timeline or plant_timeline(study), schedules, tape).run(progress)


def check_start(study: Study, schedules: Sequence[Schedule], timeline: PlantTimeline) -> None:
    """Prepares a run up to its first sample. Raises what :func:`simulate_plant` raises until then."""
    _Run(study, timeline, schedules)


class _Run:
    """A run that is under way."""

    def __init__(
        self, study: Study, timeline: PlantTimeline, schedules: Sequence[Schedule], tape: Tape | None = None
    ) -> None:
        self.study, self.timeline, self.schedules, self.tape = study, timeline, schedules, tape
        self.clock = clock_of_study(study)
        self.wiring = wiring_of(study)
        self.given = tuple(map(UnitGains, schedules))
        memories = [one.memory for one in self.given]
        kinds = tuple(_kind(one, memory is not None) for one, memory in zip(timeline.units, memories, strict=True))
        sampling = tuple(one.units for one in self.clock.instants)
        self.per_period = len(sampling)
        turns = 1 if self.clock.equal_gaps else len(sampling)
        others = tuple(OtherKind(one.kind, one.delay_samples > 0) for one in timeline.plant.inverters)
        self.common = timeline.plant.common_estimate and all(memory is not None for memory in memories)
        added = adds(timeline)
        moved = (
            any(one.dc is not None for one in kinds) and len({one.topology.connected for one in timeline.segments}) > 1
        )
        self.kind = PlantKind(
            units=kinds,
            states=timeline.names,
            sources=1 + len(timeline.plant.sources),
            sampling=sampling,
            turns=turns,
            others=others,
            added=added,
            common=self.common,
            switched=moved and not added,
        )
        if study.simulation.bridge == "pwm" and timeline.units:
            self.kind = switched(self.kind, [(timeline, self.wiring)], self.clock)
        spec = spec_of_plant(self.kind)
        self.loop, self.rows, self.spans = compiled_loop(spec), empty_rows(spec, 1), spans_of(spec.rows)
        self.uniform = uniform_of(timeline, kinds, memories, spec.uniform)
        self.program = PlantProgram(self.kind, self.wiring, timeline.segments, self.clock)
        self.added = AddedToPlant(study, timeline, self.wiring, self.clock) if self.kind.added else None
        self.log_periods = max(round(study.simulation.log_interval / self.clock.period), 1)
        self.periods = int(np.floor(study.simulation.duration / self.clock.period + 1e-6))
        self._gains = [one.first for one in self.given]
        self._like = [cold_start(one).controller for one in timeline.units]
        widths = [len(link_names(self.kind, k)) for k in range(len(kinds))]
        ends = len(log_names(self.kind)) - sum(widths) + np.cumsum(widths)
        self._links = [slice(end - width, end) for end, width in zip(ends.tolist(), widths, strict=True)]
        """Columns of the log with the dc link of each unit."""
        self.sensors: list[SensorsOfRun | None] = [None] * len(kinds)
        self._start()

    def _at(self, name: str) -> Array:
        return self.rows[0, self.spans[name], 0]

    def _start(self) -> None:
        """The state at t = 0, the records, and what stays."""
        StartOfPlant(self._at, self.kind, self.study, self.timeline, self._gains).put()
        for k, given in enumerate(self.given):
            self._put_gains(k, given.known[0])
            if given.memory is not None and (k == 0 or not self.common):
                given.memory.moves_in(self._at(f"u{k}.lock"))
            axes = [self._at(f"{axis}.{name}") for name in self.kind.states[3 * k : 3 * k + 3] for axis in AXES]
            self.sensors[k] = sensors_of(
                self.timeline.units[k], np.concatenate(axes), self.timeline.segments[0].source.omega
            )
            put_sensors(self._at, k, self.sensors[k])
        writer = ProgramWriter()
        self.program.write(writer, self.spans[self.kind.matrix[0]].start, self.spans["V_g"].start)
        for segment in self.timeline.segments if self.common else ():
            at = 0 if segment.t_s == 0.0 else self.program.sample_from(segment.t_s)
            there = [one.name not in segment.topology.opened for one in self.timeline.plant.units]
            for k, one in enumerate(there):
                writer.put([0], [at], self.spans[f"share.{k}"].start, np.array([[one / max(sum(there), 1)]]))
        for k, timeline in enumerate(self.timeline.timelines):
            for t_s, refs in timeline.references:
                at = 0 if t_s == 0.0 else self.program.sample_from(t_s, k)
                writer.put([0], [at], self.spans[f"u{k}.refs"].start, np.array([refs]))
            self._put_sources(writer, k)
        for j, own in enumerate(self.timeline.asked):
            k = len(self.timeline.units) + j
            for t_s, asked in own:
                at = 0 if t_s == 0.0 else self.program.sample_from(t_s, k)
                writer.put([0], [at], self.spans[f"u{k}.asked"].start, np.array([asked]))
        self.records = writer.program(1, 1)
        self._phase(0)

    def _put_sources(self, writer: ProgramWriter, k: int) -> None:
        """What events make of a unit's dc link: where they switch the circuit in an interval before a sample, and what
        of the source they change. That changes at a sample, which still moves the link as it
        was before: with the next instant the loop has it, and a clamp sees it at the next sample."""
        study, timeline = self.timeline.units[k], self.timeline.timelines[k]
        for at in self.program.switched(k) if k in self.kind.linked else ():
            writer.put([0, 0], [at, at + 1], self.spans[f"u{k}.switched"].start, np.array([1.0, 0.0]))
        for event in study.events:
            if event.of_dc and (link := timeline.link_at(event.t_s)) is not None:
                at = self.program.sample_from(event.t_s, k) + 1
                for name, values in dc_changed(study, link, event.of_dc):
                    writer.put([0], [at], self.spans[f"u{k}.{name}"].start, values[None])

    def _put_gains(self, k: int, change: GainChange) -> None:
        self._at(f"u{k}.power_gains")[:] = change.gains
        if f"u{k}.grid" in self.spans:
            grid = change.grid or self.timeline.units[k].grid
            self._at(f"u{k}.grid")[:] = GridEstimate(grid.R_g, grid.L_g)

    def _phase(self, k: int) -> None:
        """The exact phasors of the sources before a sample of the loop, which are those of the instant before it."""
        t_s = self.program.time(max(k - 1, 0))
        angle = self.timeline.segment_at(t_s + 1e-6 * self.clock.period).moved.at(t_s).phase
        angles = [angle, *(angle + one.phase for one in self.timeline.plant.sources)]
        for s, own in enumerate(angles):
            c, q = np.cos(own), np.sin(own)
            self._at(f"alpha.source{s}")[:] = c, q
            self._at(f"beta.source{s}")[:] = q, -c

    def run(self, progress: Callable[[float], None] | None) -> PlantRun:
        """Takes the run to its end."""
        every = self.log_periods * self.per_period
        names, end = log_names(self.kind), self.periods * self.per_period
        log = np.empty((1, -(-end // every), len(names), 1))
        changes, asked = self._changes(end), self._asked(end)
        cuts = {0, end, *changes, *asked, *range(0, end, _STRETCH * self.per_period)}
        cuts |= {one for one in self.program.cut if one < end}
        marks, seconds, divergence = sorted(cuts), 0.0, None
        cycle = np.array(body_numbers(self.kind), dtype=np.int64) if len(self.loop.spec.bodies) > 1 else None
        cyclic = cyclic_values(self.kind) if self.kind.gaps else None
        for begin, after in itertools.pairwise(marks):
            for unit, change in changes.get(begin, ()):
                self._change(unit, change)
            for unit, t_s in asked.get(begin, ()):
                self._ask(unit, t_s)
            self._phase(begin)
            if begin in self.program.cut:
                cross(self._at, self.kind, self.program, self.timeline.units, begin)
            clock, done, fed = time.perf_counter(), begin, self._fed(begin, after)
            while done < after:
                rest = None if fed is None else fed[:, done - begin :]
                done += self.loop(
                    done, after, self.rows, self.uniform,
                    log=log, every=every, program=self.records, cycle=cycle, cyclic=cyclic, fed=rest,
                )  # fmt: skip
                self._conclude(done)
            seconds += time.perf_counter() - clock
            divergence = self._lost(log[0, :, :, 0], begin, after, every)
            if divergence is not None:
                log = log[:, : int(divergence.t_s / self.clock.period + 1e-6) // self.log_periods]
                break
            if progress is not None:
                progress(self.program.time(after))
        if log.shape[1] < 2 and divergence is not None:
            raise SimulationDivergedError(divergence.reason)
        return self._result(log[0, :, :, 0], seconds, divergence)

    def _changes(self, end: int) -> dict[int, list[tuple[int, GainChange]]]:
        """The later changes of gains, by the sample of the loop before which they come."""
        found: dict[int, list[tuple[int, GainChange]]] = {}
        for k, given in enumerate(self.given):
            for change in given.known[1:]:
                at = self.program.sample_from(change.t_s, k)
                if at < end:
                    found.setdefault(at, []).append((k, change))
        return found

    def _asked(self, end: int) -> dict[int, list[tuple[int, float]]]:
        """The ends of windows, by the sample of the loop before which they come."""
        found: dict[int, list[tuple[int, float]]] = {}
        for k, given in enumerate(self.given):
            for t_s in given.ends(self.study.simulation.duration):
                at = self.program.sample_from(t_s, k)
                if at < end:
                    found.setdefault(at, []).append((k, t_s))
        return found

    def _ask(self, k: int, t_s: float) -> None:
        """The gains that a unit's schedule gives for what the unit measures."""
        state, limited = self._state(k), int(self._at(f"u{k}.limited")[0])
        change = self.given[k].answer(t_s, (state.P_f, state.Q_f, state.V), limited, self._gains[k])
        if change is not None:
            self._change(k, change)

    def _change(self, k: int, change: GainChange) -> None:
        """Other gains for a unit; its frequency stays (:eq:`gain-transfer`)."""
        state = self._state(k)
        refs = References(*self._at(f"u{k}.refs").tolist())
        if f"u{k}.clamp.cut" in self.spans:  # those that the power loops have followed
            refs = refs._replace(P_ref=refs.P_ref + float(self._at(f"u{k}.clamp.cut")[0]))
        moved = with_gains(state, refs, self._gains[k], change.gains)
        self._gains[k] = change.gains
        self._at(f"u{k}.state")[:] = flat_state(moved)
        self._put_gains(k, change)

    def _conclude(self, done: int) -> None:
        """Ends the cycles of field estimators that end before a sample of the loop."""
        if self.tape is not None and self.tape.plays:
            self._play(self.tape, done)
            return
        t_s, first = self.program.time(done), self.given[0].field if self.given else None
        shared = first.concluded() if self.common and first is not None and first.closed else None
        for k, given in enumerate(self.given):
            if given.field is not None and (given.field.closed or shared is not None):
                sample = round(t_s / self.timeline.units[k].converter.T_s)
                change = given.concluded(t_s, sample, self._gains[k], self._state(k), shared)
                if change is not None:
                    self._change(k, change)
                if self.tape is not None:
                    self.tape.add(done, k, self._at(lock) if (lock := f"u{k}.lock") in self.spans else None, change)

    def _play(self, tape: Tape, done: int) -> None:
        """The cycles end as those of the run did of which the tape is, with the same gains."""
        for k, lock, change in tape.at(done):
            if lock is not None:
                goes_on(self._at(f"u{k}.lock"), lock)
            if change is not None:
                if change.gains != self._gains[k]:
                    self.given[k].changes.append(change)
                self._change(k, change)
        if any(given.field is not None and given.field.closed for given in self.given):
            raise RuntimeError("a cycle of a field estimator has ended that did not end in the run of the tape.")

    def _fed(self, begin: int, end: int) -> Array | None:
        """What is fed over a stretch, (1, samples of the loop, n, 1); None: nothing."""
        more = None if self.added is None else self.added.fed(begin, end)
        return with_noise(more, self.sensors, self.clock, begin, end)

    def _state(self, k: int) -> ControllerState:
        like = self._like[k]
        numbers, count = self._at(f"u{k}.state").tolist(), len(like) - 1
        return ControllerState(*numbers[:count], limiter=type(like.limiter)(*numbers[count:]))

    def _lost(self, log: Array, begin: int, end: int, every: int) -> Divergence | None:
        """What has ended the run between two samples of the loop."""
        if (why := self._outside()) is not None:
            t_s = self.program.time(begin)
            return Divergence(t_s, f"the simulation diverged after {t_s:.4g} s: {why}")
        (first, last), found = (-(-one // every) for one in (begin, end)), None
        for k, (unit, study) in enumerate(zip(self.timeline.plant.units, self.timeline.units, strict=True)):
            if study.dc is None or unit.name in self.timeline.blocked:
                continue
            limits = (float(self._at(f"u{k}.dc.{name}")[0]) for name in ("lowest", "highest"))
            if (why := blocked(study.dc, *limits)) is None:
                continue
            row = first + rows_before_block(study, log[first:last, self._links[k]])
            t_s = self.program.time(row * every)
            if found is None or t_s < found.t_s:
                said = f"{blocks(unit.name)} after {t_s:.4g} s: {why}"
                found = Divergence(t_s, said, blocked=True, unit=unit.name)
        return found

    def _outside(self) -> str | None:
        """What has diverged, with the name of the unit."""
        for k, unit in enumerate(self.timeline.plant.units):
            own = [self._at(f"{axis}.{name}")[0] for name in self.kind.states[3 * k : 3 * k + 3] for axis in AXES]
            why = outside(self.timeline.units[k], np.array(own), self._state(k))
            if why is not None:
                return f"unit {unit.name}: {why}"
        for k, one in enumerate(self.timeline.plant.inverters, len(self.timeline.units)):
            own = [self._at(f"{axis}.{name}")[0] for name in self.kind.states[3 * k : 3 * k + 3] for axis in AXES]
            rated = rms_to_peak(rated_current_rms(one.S_rated, one.V_rated_rms)), rms_to_peak(one.V_rated_rms)
            bounds = BOUND_PU * np.array([rated[0]] * 2 + [rated[1]] * 2 + [rated[0]] * 2)
            if not (np.abs(own) <= bounds).all():
                return f"inverter {one.name}: a current or a voltage is beyond {BOUND_PU:g} times its rated value"
        return None

    def _result(self, log: Array, seconds: float, divergence: Divergence | None) -> PlantRun:
        t_s: Array = np.arange(len(log), dtype=np.float64) * (self.log_periods * self.clock.period)
        width, units = len(LOG_COLUMNS), len(self.timeline.units)
        terminals = self._terminals(t_s, log)
        found = tuple(
            UnitRun(
                name=unit.name,
                study=self.timeline.units[k],
                gain_changes=tuple(self.given[k].changes),
                log=log[:, width * k : width * (k + 1)],
                terminals=terminals[:, k],
                final_state=self._state(k),
                dc_log=None if self.kind.units[k].dc is None else log[:, self._links[k]],
            )
            for k, unit in enumerate(self.timeline.plant.units)
        )
        return PlantRun(
            study=self.study,
            timeline=self.timeline,
            t_s=t_s,
            units=found,
            inverters=tuple(
                InverterRun(
                    name=one.name,
                    log=_in_rms(log[:, width * k : width * (k + 1)]),
                    terminals=terminals[:, k],
                    asked=self.timeline.asked[k - units],
                )
                for k, one in enumerate(self.timeline.plant.inverters, units)
            ),
            circuit_log=self._of_circuit(log),
            names=self.kind.states[3 * self.kind.converters :],
            loop_seconds=seconds,
            divergence=divergence,
        )

    def _of_circuit(self, log: Array) -> Array:
        """The circuit's states that belong to no converter."""
        return log[:, len(LOG_COLUMNS) * self.kind.converters : self._links[0].start if self._links else None]

    def _terminals(self, t_s: Array, log: Array) -> Array:
        """(n, converters, 2): the voltages at the terminals of the converters (:eq:`plant-terminal`)."""
        width, units, first = len(LOG_COLUMNS), self.kind.converters, len(LOG_COLUMNS) * self.kind.converters
        states = [width * k + 2 * m for k in range(units) for m in range(3)]
        states += range(first, first + 2 * (len(self.kind.states) - 3 * units), 2)
        v_g = LOG_COLUMNS.index("v_g_alpha")  # with its components
        columns = np.array([*states, v_g])[:, None] + np.arange(2)  # of both axes
        given = log[:, columns.ravel()]
        found = np.empty((len(t_s), units, 2))
        starts = [one.t_s for one in self.timeline.segments]
        index = np.maximum(np.searchsorted(starts, t_s + 1e-9 * self.clock.period, side="right") - 1, 0)
        for j in np.unique(index).tolist():
            begin, end = np.searchsorted(index, [j, j + 1]).tolist()
            rows, segment = slice(begin, end), self.timeline.segments[j]
            circuit: UnitsCircuit = circuit_of_units(self.wiring, segment.topology, self.kind.states)
            per_state, per_source = circuit.terminals
            weights = np.zeros((*columns.shape, units, 2))
            for axis in range(2):
                weights[:, axis, :, axis] = np.column_stack([per_state, per_source[:, 0]]).T
            found[rows] = (given[rows] @ weights.reshape(given.shape[1], -1)).reshape(-1, units, 2)
            phase = segment.source.phase + segment.source.omega * (t_s[rows] - segment.t_s)
            for one, own in zip(self.timeline.plant.sources, per_source[:, 1:].T, strict=True):
                turned = np.column_stack([np.cos(phase + one.phase), np.sin(phase + one.phase)])
                found[rows] += own[:, None] * (rms_to_peak(one.V_rms) * turned)[:, None, :]
        return found


def _in_rms(log: Array) -> Array:
    """The log of an inverter with its voltage in V rms, as of a unit."""
    found = log.copy()
    found[:, LOG_COLUMNS.index("V_rms")] = peak_to_rms(found[:, LOG_COLUMNS.index("V_rms")])
    return found


def _kind(study: Study, listens: bool) -> Kind:
    sensors = study.sensors is not None and study.sensors.act
    return kind_of(study, switched=False)._replace(sensors=sensors, field=listens)


__all__ = ["InverterRun", "PlantRun", "UnitRun", "simulate_plant"]
