"""Lanes of one kind, packed into groups: their rows, their program, and what they have watched at the end."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import Program, aligned_zeros
from vsgdesign.equations.controller_data import ControllerState
from vsgdesign.equations.power_loops import References
from vsgdesign.frames import rms_to_peak
from vsgdesign.metrics.events import late_rows
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.metrics.survival import END_S, FIRST_S, SurvivalDemand
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.bodies import DISTURBANCE, FALLING, MEAN_STEP, RISING
from vsgdesign.simulation.bodies import STEP as STEP_WATCHED
from vsgdesign.simulation.lanes.cases import ACTIVE, STEP, LaneCases
from vsgdesign.simulation.lanes.circuit_program import SAME_INSTANT, BrokenSample, CircuitProgram
from vsgdesign.simulation.lanes.program import ProgramWriter
from vsgdesign.simulation.lanes.rests import Rests, cycles_at_end
from vsgdesign.simulation.lanes.segments import START_PHASE, segments_of
from vsgdesign.simulation.lanes.uniform import listener_values, uniform_values
from vsgdesign.simulation.loop import KindLoop, carrier_values, kind_of, loop_of, side_by_side

Array = NDArray[np.float64]
Samples = NDArray[np.int64]

_SLACK = 1e-3
"""Share of a sample by which a row may lie before an event and is still after it: as the judge of survival has it."""


@dataclass(eq=False)
class Part:
    """Lanes of one kind. ``index`` says which case of the batch each of its n lanes is."""

    index: NDArray[np.intp]
    study: Study
    made: KindLoop
    rows: Array
    """(G, R, L): rows of the loop, and behind them what is kept for the end."""
    uniform: Array
    program: Program
    ends: Samples
    """Number of samples of each lane, (n,), in descending order."""
    demanded: dict[str, float]
    """Uniform numbers of what is demanded."""
    strict: bool
    target: str
    """The processor for which its loops are compiled."""
    cases: LaneCases
    """Those of these lanes."""
    cycle: int
    """Samples over which the means are taken."""
    cycle_at_end: Samples
    """Samples of a cycle of the grid at the end, (n,)."""
    kept: dict[str, int] = field(default_factory=dict)
    """First row of what is kept for the end."""
    rings: Array | None = None
    ring_length: Samples | None = None
    broken: list[BrokenSample] = field(default_factory=list)
    """In the order of their samples."""
    log: Array | None = None
    """(G, S, n, L): of a switched bridge, what its kind logs from sample ``log_begin`` on."""
    log_begin: int = 0

    def __len__(self) -> int:
        return len(self.index)

    @property
    def end(self) -> int:
        """The sample up to which the part has to run: one beyond its last, so that what is kept at an end is kept."""
        return int(self.ends[0]) + 1

    def run(self, begin: int, end: int) -> None:
        """Runs the samples from ``begin`` up to before ``end`` of every group that is not over."""
        end = min(end, self.end)
        due = self.broken[self._broken_before(begin) : self._broken_before(end)]
        for sample, together in itertools.groupby(due, key=lambda one: one.sample):
            self._run(begin, sample)
            after = [(one, self._after_broken(one)) for one in together]
            begin = sample + 1
            self._run(sample, begin)
            for one, state in after:
                group, lane = divmod(one.lane, self.made.spec.width)
                self.rows[group, : len(state), lane] = state
        self._run(begin, end)

    def _after_broken(self, one: BrokenSample) -> Array:
        """The state of a lane after a sample in whose interval an event falls."""
        width, k = self.made.spec.width, one.sample
        group, lane = divmod(one.lane, width)
        n = self.study.converter.samples_per_carrier
        kind = self.made.kind
        slope = RISING if (k % n) / n < 0.5 else FALLING
        kind = kind._replace(cut=True, bridge=kind.bridge._replace(slopes=(slope,)))
        own = loop_of(kind, (), side_by_side(strict=self.strict, target=self.target))
        now = self.rows[group, :, lane].copy()
        p, due = self.program, slice(self.program.first[group], self.program.first[group + 1])
        for r in np.flatnonzero((p.at[due] == k) & (p.lane[due] == lane)) + due.start:
            row, count, source = p.row[r], p.count[r], p.source[r]
            values = p.values[source : source + count] if source >= 0 else now[-1 - source : -1 - source + count].copy()
            now[row : row + count] = values
        rows = np.zeros((1, len(own.spec.rows), width))
        for name, place in own.place.items():
            if name in self.made.place:
                rows[0, place] = now[self.made.place[name]]
        for name, values in one.values.items():
            begin = own.place[name] if name in own.place else own.rows(name).start
            rows[0, begin : begin + len(values)] = values[:, None]
        if self.rings is not None and self.ring_length is not None:
            slot = k % int(self.ring_length[group])
            names = (name for name, _ in self.made.spec.rings)
            for name, value in zip(names, self.rings[group, slot, :, lane], strict=True):
                rows[0, own.place[name]] = value
        own.loop(k, k + 1, rows, uniform_values(own.spec, self.study, **self.demanded))
        return rows[0, : len(own.spec.state), 0]

    def _broken_before(self, sample: int) -> int:
        return bisect_left(self.broken, sample, key=lambda one: one.sample)

    def _run(self, begin: int, end: int) -> None:
        width, logging = self.made.spec.width, {}
        if self.log is not None and begin < self.log_begin < end:
            self._run(begin, self.log_begin)
            begin = self.log_begin
        active = -(-int((self.ends + 1 > begin).sum()) // width)
        if end <= begin or active == 0:
            return
        if self.log is not None and begin >= self.log_begin:
            logging = {"log": self.log[:active], "every": 1, "log_begin": self.log_begin}
        carrier = {}
        if self.made.spec.cyclic:
            cyclic, cycle = carrier_values(self.made.kind.bridge.slopes)
            carrier = {"cyclic": cyclic, "cycle": cycle}
        rings = {}
        if self.rings is not None and self.ring_length is not None:
            rings = {"rings": self.rings[:active], "ring_length": self.ring_length[:active]}
        program = replace(self.program, first=self.program.first[: active + 1], done=self.program.done[:active])
        self.made.loop(begin, end, self.rows[:active], self.uniform, program=program, **carrier, **rings, **logging)

    def get(self, row: int | str) -> Array:
        """A row of every lane, (n,)."""
        place = self.made.place[row] if isinstance(row, str) else row
        return self.rows[:, place, :].reshape(-1)[: len(self)].copy()

    def watched(self, name: str) -> Array:
        """What was watched up to the end of every lane, (n,)."""
        return self.get(self.kept["watch"] + self.made.place[f"watch.{name}"] - self.made.rows("watch").start)

    def put(self, row: int | str, values: Array) -> None:
        """Sets a row of every lane, (n,), or m rows that are beside each other, (m, n).

        Places that are left in the last group take what the last lane has.
        """
        values = np.asarray(values, dtype=float)
        values = values[None] if values.ndim == 1 else values
        groups, _, width = self.rows.shape
        first = self.made.place[row] if isinstance(row, str) else row
        to = self.rows[:, first : first + len(values)]
        whole = len(self) // width
        to[:whole] = values[:, : whole * width].reshape(len(values), whole, width).swapaxes(0, 1)
        if whole < groups:
            rest = values[:, whole * width :]
            to[whole, :, : rest.shape[1]], to[whole, :, rest.shape[1] :] = rest, rest[:, -1:]


def padded(values: Array, groups: int, width: int) -> Array:
    """(n,) values of lanes as (G, L), the last lane again in the places that are left."""
    full = np.empty(groups * width)
    full[: len(values)], full[len(values) :] = values, values[-1]
    return full.reshape(groups, width)


def at_or_after(t_s: Array, T_s: float, slack: float) -> Samples:
    """The first sample that lies at most ``slack`` samples before an instant; a very late one where there is none."""
    return np.ceil(np.minimum(t_s / T_s, 2.0**40) - slack).astype(np.int64)


def first_judged(cases: LaneCases, T_s: float) -> Samples:
    """The first sample that a settling time or a recovery counts, (n,): that of the step, or that of the clearing."""
    step = cases.kind == STEP
    return np.where(step, at_or_after(cases.events.t_s[:, 0], T_s, 0.5), at_or_after(cases.cleared_s, T_s, 1e-9))


def make_part(  # noqa: PLR0913 - everything that a part is made of
    study: Study,
    cases: LaneCases,
    index: NDArray[np.intp],
    rests: Rests,
    ends: Samples,
    demand: SurvivalDemand,
    *,
    step: bool,
    ramped: bool,
    bridge: str,
    strict: bool,
    listening: bool = False,
    target: str = "native",
) -> Part:
    """A part of the cases of one kind, which are ``cases`` with their ``rests`` and ends, and ``index`` in the batch.

    ``demand``: what is asked of a disturbance, with the cycle of these cases, or that over which the power of a step is
    judged where it ripples: where a field estimator is ``listening``, or with a switched bridge.
    """
    order = np.argsort(-ends, kind="stable")
    cases, index, rests, ends = cases.take(order), index[order], rests.take(order), ends[order]
    switched = bridge == "pwm"
    watch = (MEAN_STEP if listening or switched else STEP_WATCHED) if step else DISTURBANCE
    kind = kind_of(study, switched=switched)
    kind = kind._replace(ramped=ramped, watch=watch, field=listening, waits=listening)
    logged = (("watched.mean",) if step else ("watched.sum_P", "watched.sum_Q")) if switched else ()
    made = loop_of(kind, logged, side_by_side(strict=strict, target=target))
    c, T_s, width, n = study.converter, study.converter.T_s, made.spec.width, len(cases)
    groups = -(-n // width)
    watch = made.rows("watch")
    kept, at = {}, len(made.spec.rows)
    counts = {"watch": watch.stop - watch.start, "limited": 1, "late": 1, "initial": 1, "limited_at_end": 1}
    counts |= dict.fromkeys(("first", "least", "most"), cases.events.count)
    for name, count in counts.items():
        kept[name], at = at, at + count
    limit = c.I_rated_pk * (demand.i_max_pu if demand.i_max_pu is not None else 1e6)
    cycle = max(round(demand.cycle_s / T_s), 1)
    demanded = {
        "of__band": SETTLING_BAND if step else demand.band,
        "of__per_S": 1.0 / c.S_rated,
        "of__per_cycle": 1.0 / cycle,
        "load_of__limit_sq": limit * limit,
        **(listener_values(study) if listening else {}),
    }
    uniform = uniform_values(made.spec, study, **demanded)
    part = Part(
        index=index,
        study=study,
        made=made,
        rows=aligned_zeros((groups, at, width)),
        uniform=uniform,
        program=ProgramWriter().program(groups, width),
        ends=ends,
        demanded=demanded,
        strict=strict,
        target=target,
        kept=kept,
        cases=cases,
        cycle=cycle,
        cycle_at_end=np.zeros(n, dtype=np.int64),
    )
    segments, writer = segments_of(cases), ProgramWriter()
    part.cycle_at_end[:] = cycles_at_end(study, segments)
    if made.spec.logged:
        part.log_begin = int(first_judged(cases, T_s).min())
        part.log = aligned_zeros((groups, part.end - part.log_begin, len(made.spec.logged), width))
    _rest(part, cases, rests)
    circuit = CircuitProgram(study, made, writer, segments, ramped)
    circuit.write()
    part.broken = sorted(circuit.broken, key=lambda one: one.sample)
    _references(part, writer, cases)
    (_watch_step if step else _watch_disturbance)(part, writer, cases, rests)
    lanes = np.arange(n)
    writer.copy(lanes, ends, kept["watch"], watch.stop - watch.start, watch.start)
    writer.copy(lanes, ends, kept["limited_at_end"], 1, made.place["limited"])
    _means(part, cases, rests, cycle)
    part.program = writer.program(groups, width)
    return part


def _means(part: Part, cases: LaneCases, rests: Rests, cycle: int) -> None:
    """What is judged by its mean over a cycle has been at rest for one."""
    ringed = [name for name, _ in part.made.spec.rings]
    if not ringed:
        return
    P_or_Q = np.where(cases.signal == ACTIVE, rests.P_start, rests.Q_start)
    present = {"P_ago": rests.P_start, "Q_ago": rests.Q_start, "power_ago": P_or_Q}
    sums = {"P_ago": "watch.sum_P", "Q_ago": "watch.sum_Q", "power_ago": "watch.sum"}
    groups, _, width = part.rows.shape
    part.rings = aligned_zeros((groups, cycle, len(ringed), width))
    part.ring_length = np.full(groups, cycle, dtype=np.int64)
    for k, name in enumerate(ringed):
        part.rings[:, :, k] = padded(present[name], groups, width)[:, None]
        part.put(sums[name], cycle * present[name])
    if "watch.mean" in part.made.place:
        part.put("watch.mean", P_or_Q)


def _rest(part: Part, cases: LaneCases, rests: Rests) -> None:
    """The lanes at rest."""
    start, place = rests.start, part.made.place
    for name, values in _flat(start.controller):
        part.put(f"state.{name}", values)
    for row, values in enumerate(start.plant):
        part.put(part.made.rows("x").start + row, values)
    if part.made.kind.bridge.delayed:
        for row, values in enumerate(start.pending):
            part.put(part.made.rows("pending").start + row, values)
    part.put("source.cosine", np.full(len(part), math.cos(START_PHASE)))
    part.put("source.sine", np.full(len(part), math.sin(START_PHASE)))
    if "watch.entry.last_out" in place:
        part.put("watch.entry.last_out", np.full(len(part), -1.0))
    nominal = part.study.converter.references()
    for name, value in zip(References._fields, (cases.P_ref, cases.Q_ref, nominal.omega_0, nominal.V_n), strict=True):
        if f"refs.{name}" in place:
            part.put(f"refs.{name}", np.broadcast_to(value, len(part)))
    part.put("V_g", rms_to_peak(cases.V_g_rms))
    for name in ("R_g", "L_g"):
        if f"circuit.{name}" in place:
            part.put(f"circuit.{name}", getattr(cases, name))


def _flat(state: ControllerState) -> list[tuple[str, Array]]:
    found = [(name, values) for name, values in state._asdict().items() if name != "limiter"]
    return found + [(f"limiter.{name}", values) for name, values in state.limiter._asdict().items()]


def _references(part: Part, writer: ProgramWriter, cases: LaneCases) -> None:
    """Changes of the references: in force at the first sample at or after their time."""
    events, T_s = cases.events, part.study.converter.T_s
    for k in range(events.count):
        for name in References._fields:
            some = np.flatnonzero(np.isfinite(getattr(events, name)[:, k]) & np.isfinite(events.t_s[:, k]))
            if some.size:
                at = at_or_after(events.t_s[some, k], T_s, SAME_INSTANT)
                writer.put(some, at, part.made.place[f"refs.{name}"], getattr(events, name)[some, k])


def _load(part: Part, writer: ProgramWriter, lanes: NDArray[np.intp], t_s: Array, at: Samples, first: bool) -> None:
    """The current counts from an event on, apart in its first 5 ms."""
    place, T_s = part.made.place, part.study.converter.T_s
    if first:
        writer.put(lanes, at, place["load_of.after"], np.ones(len(lanes)))
        writer.copy(lanes, at + 1, part.kept["limited"], 1, place["limited"])
    writer.put(lanes, at, place["load_of.first"], np.ones(len(lanes)))
    # The end of the 5 ms of one event must not end those of the next.
    writer.put(lanes, at_or_after(t_s + FIRST_S, T_s, 0.5), place["load_of.first"], np.zeros(len(lanes)))


def _watch_step(part: Part, writer: ProgramWriter, cases: LaneCases, rests: Rests) -> None:
    """A step is watched from its event on."""
    place, T_s = part.made.place, part.study.converter.T_s
    active = cases.signal == ACTIVE
    initial = np.where(active, rests.P_start, rests.Q_start)
    part.put("of.initial", initial)
    final = np.where(active, rests.P_end, rests.Q_end)
    if "of.final" in place:
        part.put("of.final", final)
    else:
        part.put("of.per_step", 1.0 / (final - initial))
    part.put("of.of_P", active.astype(float))
    part.put("of.of_Q", (~active).astype(float))
    lanes, t_s = np.arange(len(cases)), cases.events.t_s[:, 0]
    at = at_or_after(t_s, T_s, 0.5)
    if part.log is None:
        _entry_anew(part, writer, lanes, at)
        writer.put(lanes, at, place["watch.most"], np.zeros(len(lanes)))
        if "watch.mean" in place:
            writer.copy(lanes, at, place["of.initial"], 1, place["watch.mean"])
    else:
        writer.copy(lanes, at, part.kept["initial"], 1, place["watch.mean"])
        late = part.ends - late_rows(part.ends - at, part.cycle_at_end)
        writer.put(lanes, late, place["watch.late"], np.zeros(len(lanes)))
    _load(part, writer, lanes, t_s, at, first=True)


def _entry_anew(part: Part, writer: ProgramWriter, lanes: NDArray[np.intp], at: Samples) -> None:
    writer.put(lanes, at, part.made.rows("watch.entry").start, np.tile([-1.0, 0.0, 0.0, 0.0], (len(lanes), 1)))


def _watch_disturbance(part: Part, writer: ProgramWriter, cases: LaneCases, rests: Rests) -> None:
    """A disturbance is watched from its first event on, its recovery from its end on, and the angle after each."""
    place, kept, T_s, events = part.made.place, part.kept, part.study.converter.T_s, cases.events
    part.put("of.P_rest", rests.P_end)
    part.put("of.Q_rest", rests.Q_end)
    part.put("watch.delta", rests.delta_start)
    least = place["watch.least"]
    for k in range(events.count):
        lanes = np.flatnonzero(np.isfinite(events.t_s[:, k]))
        t_s = events.t_s[lanes, k]
        at = at_or_after(t_s, T_s, _SLACK)
        writer.copy(lanes, at, kept["first"] + k, 1, place["watch.delta"])
        if k > 0:
            writer.copy(lanes, at, kept["least"] + k - 1, 1, least)
            writer.copy(lanes, at, kept["most"] + k - 1, 1, least + 1)
        writer.put(lanes, at, least, np.tile([np.inf, -np.inf], (len(lanes), 1)))
        _load(part, writer, lanes, t_s, at, first=k == 0)
    everyone = np.arange(len(cases))
    if part.log is None:
        _entry_anew(part, writer, everyone, first_judged(cases, T_s))
    late = part.ends - np.int64(math.floor(END_S / T_s + 1e-6))
    writer.copy(everyone, late, kept["late"], 1, place["limited"])
