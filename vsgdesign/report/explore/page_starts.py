"""The starts of a page without a server: every controller at rest on every grid, before its event; and runs that are
told beforehand, cases of a report, which begin on their own grid and do not keep to the page's events.

A controller's start on one grid is that of its strict run (:func:`at_rest`). On many grids at once only what differs
between them is computed, with the functions that the run itself uses: the numbers are the same bits.

A run that is told beforehand is replayed. What its circuit, its source and its schedule put into the rows of its loop,
and when, is recorded here while the run is computed; the page puts the same numbers into the same loop. So a case may
have events within an interval, a late or wrong estimate and any schedule, and has the bits of ``simulate``.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.codegen.llvm import LoopSpec
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import VsgDesignError
from vsgdesign.linear.operating_point.dc_rest import power_of_plant
from vsgdesign.linear.operating_point.many import Lanes, ManyStates, many_steady_states
from vsgdesign.linear.operating_point.many_rests import many_rests_with_measured_gains
from vsgdesign.linear.operating_point.plant import plant_steps
from vsgdesign.report.explore.saving import WithoutEvent, saved_without_event
from vsgdesign.report.explore.scene import Scene, joined_cells, references_of, scenes_of, study_of
from vsgdesign.report.explore.state import State
from vsgdesign.runtime.of_study import follows_measured, gain_law
from vsgdesign.simulation.batch import Batch
from vsgdesign.simulation.circuit_program import CircuitProgram, ProgramWriter
from vsgdesign.simulation.every_sample import with_every_sample
from vsgdesign.simulation.feeds import LateSchedule, feed_of
from vsgdesign.simulation.following import KnownGridScheduler
from vsgdesign.simulation.loop import log_names, spec_of
from vsgdesign.simulation.run import begin_together
from vsgdesign.simulation.run_asked import RunOf
from vsgdesign.simulation.run_kind import LARGEST_DEGREE
from vsgdesign.simulation.run_state import RunState, program_of
from vsgdesign.simulation.timeline import Segments, build_timeline
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


class Starts(NamedTuple):
    """A controller at rest on grids, before its event."""

    numbers: Array
    """(n, m): of each grid the rows of the loop, what the source adds per volt, the grid, and the state of the
    controller's scheduler; NaN where it has no start."""
    why: list[str | None]
    """Why it has none."""

    @property
    def there(self) -> NDArray[np.bool_]:
        """On which grids it has one."""
        return np.array([one is None for one in self.why], dtype=bool)


class CellStarts(NamedTuple):
    """All controllers on grids, and of each grid the study file of what is shown there, None where nothing can be
    saved."""

    starts: list[Starts]
    saves: list[WithoutEvent | None]


def starts_of(study: Study, ready: Ready, states: Sequence[State]) -> CellStarts:
    """The starts of the shown controllers in states that differ in their grid alone."""
    scenes = scenes_of(study, ready, states)
    saves: list[WithoutEvent | None] = []
    for scene, state in zip(scenes, states, strict=True):
        save = None
        with contextlib.suppress(VsgDesignError):
            save = saved_without_event(scene, ready, state)
        saves.append(save)
    return CellStarts([_starts(scenes, ready, states, k) for k in range(len(scenes[0].shown))], saves)


def joined(parts: Sequence[CellStarts]) -> CellStarts:
    """Grids one after another."""
    each = zip(*(part.starts for part in parts), strict=True)
    return CellStarts([_joined(own) for own in each], [save for part in parts for save in part.saves])


def _joined(parts: Sequence[Starts]) -> Starts:
    width = max(one.numbers.shape[1] for one in parts)
    whole = [one.numbers if one.numbers.shape[1] else np.full((len(one.why), width), np.nan) for one in parts]
    return Starts(np.concatenate(whole), [why for one in parts for why in one.why])


def _starts(scenes: Sequence[Scene], ready: Ready, states: Sequence[State], k: int) -> Starts:
    why = _too_stiff(scenes, [scene.cells.faults[k] for scene in scenes])
    good = np.flatnonzero([one is None for one in why])
    rows = dict(_side_by_side(scenes, ready, states, k, good)) if len(good) > 1 else {}
    for j in good.tolist():
        if j not in rows:
            try:
                rows[j] = at_rest(study_of(scenes[j], ready, states[j], k), ready).numbers
            except VsgDesignError as error:
                why[j] = str(error)
    numbers = np.full((len(why), max((len(one) for one in rows.values()), default=0)), np.nan)
    for j, values in rows.items():
        numbers[j] = values
    return Starts(numbers, why)


TOO_STIFF = (
    "with this grid the filter is too stiff for a switched bridge on a page: its fastest mode dies out within a "
    "sampling period. `vsgdesign simulate --bridge pwm` runs it."
)


def _too_stiff(scenes: Sequence[Scene], why: list[str | None]) -> list[str | None]:
    """Why there is no start, with the grids whose responses to edges need a loop of another form."""
    study = scenes[0].study
    if study.simulation.bridge != "pwm":
        return why

    def stiff(R_g: Any, L_g: Any) -> bool:
        edge = plant_steps(study, R_g, L_g, study.converter.T_s, study.converter.omega_n, edges=True).edge
        return edge.shape[1] > LARGEST_DEGREE + 1 or not np.isfinite(edge).all()

    grids = [(scene.grid.R_g, scene.grid.L_g) for scene in scenes]
    R_g, L_g = np.array(grids).T
    if not stiff(R_g, L_g):
        return why
    return [TOO_STIFF if one is None and stiff(*grid) else one for one, grid in zip(why, grids, strict=True)]


def _side_by_side(
    scenes: Sequence[Scene], ready: Ready, states: Sequence[State], k: int, index: NDArray[np.intp]
) -> list[tuple[int, Array]]:
    """The numbers of a controller on some of the grids, with the place of each. A grid without a steady state is left
    out, and so are all grids of a gain table, whose schedulers have states of their own, and those of a controller that
    clamps its power."""
    first = int(index[0])
    study = _calm(study_of(scenes[first], ready, states[first], k))
    spec, cells = study.controllers[0], joined_cells([(scenes[j].cells, k) for j in index])
    clamps = study.dc is not None and study.dc.clamps
    if ready.table(spec) is not None or study.simulation.start == "cold" or clamps:
        return []
    timeline = build_timeline(study)
    source, nominal = timeline.source_at(0.0), timeline.references_at(0.0)
    lanes = Lanes(
        cells.R_g,
        cells.L_g,
        source.V_g_rms,
        source.omega,
        *references_of(study, cells),
        nominal.omega_0,
        nominal.V_n,
    )
    gains, good = cells.gains, np.ones(len(index), dtype=bool)
    if follows_measured(spec):
        law = gain_law(study, spec, ready)
        rests, gains = many_rests_with_measured_gains(study, lanes, lambda *measured: law(*lanes[:2], *measured))
        good = rests.fault == 0
    rests = many_steady_states(study, lanes, gains, source.phase)
    good &= rests.fault == 0
    if not good.any():
        return []
    at = int(index[good][0])
    like = at_rest(study_of(scenes[at], ready, states[at], k), ready)
    values = _numbers(like, lanes, gains, rests)
    return [(int(j), values[n]) for n, j in enumerate(index) if good[n]]


def _numbers(like: AtRest, lanes: Lanes, gains: PowerLoopGains, rests: ManyStates) -> Array:
    """The numbers of n starts that differ from one in their grid, references, gains and rests, (n, m)."""
    study, batch, count = like.study, like.batch, len(rests)
    rows, at = np.tile(like.rows, (count, 1)), rests.controller

    def put(name: str, values: Any) -> None:
        if name in batch.spans:
            rows[:, batch.spans[name]] = np.stack([np.broadcast_to(one, count) for one in values], axis=1)

    put("x", rests.plant)
    put("state", (*at[:-1], *at.limiter))
    put("pending", rests.pending)
    put("refs", lanes.refs)
    put("power_gains", gains)
    put("grid", lanes[:2])
    if study.dc is not None:
        links = [
            study.dc.at_rest(p, study.converter, study.filter) for p in power_of_plant(study, rests.plant).tolist()
        ]
        put("dc", np.array([numbers_of(one) for one in links]).T)
    zeros, omega = np.zeros((count, 1)), np.full((count, 1), lanes.omega_g)
    of_source = np.full((count, 1), lanes.V_g_rms), zeros, omega, zeros, np.full((count, 1), like.phase)
    segments = Segments(zeros, lanes.R_g[:, None], lanes.L_g[:, None], *of_source, place=zeros.astype(np.int64))
    writer = ProgramWriter()
    CircuitProgram(study, batch.kind, batch.spans, writer, segments).write()
    program = writer.program(count, 1)
    for lane, (begin, end) in enumerate(zip(program.first, program.first[1:], strict=False)):
        for record in range(begin, end):
            row, number, value = program.row[record], program.count[record], program.source[record]
            rows[lane, row : row + number] = program.values[value : value + number]
    per_volt = plant_steps(study, lanes.R_g, lanes.L_g, study.converter.T_s, lanes.omega_g).source[:, 0]
    return np.column_stack([rows, per_volt.real, per_volt.imag, lanes.R_g, lanes.L_g])


class AtRest(NamedTuple):
    """A controller's run before its event, which is left out."""

    study: Study
    feed: Any
    run: RunState
    batch: Batch
    rows: Array
    """Those of the loop, as the first sample finds them."""

    @property
    def phase(self) -> float:
        """Of the source at the start, rad."""
        return self.run.timeline.source_at(0.0).phase

    @property
    def numbers(self) -> Array:
        """What the page begins with on this grid."""
        grid, T_s, feed = self.study.grid, self.study.converter.T_s, self.feed
        source = plant_steps(self.study, grid.R_g, grid.L_g, T_s, self.study.grid_source.omega_g).source[0, 0]
        own = feed.runtime if isinstance(feed, KnownGridScheduler) else None
        state = [] if own is None else numbers_of(own.present)
        parts = [self.rows, source.real, source.imag, [grid.R_g, grid.L_g], state]
        return np.concatenate([np.asarray(part, dtype=float) for part in parts])


def _calm(study: Study) -> Study:
    """The study of a page's run without its event, strict."""
    spec = study.controllers[0]
    return with_every_sample(replace(study.with_limit_of(spec), events=()).made_strict())


def at_rest(study: Study, ready: Ready) -> AtRest:
    """The strict run of a study with one controller, before its event."""
    calm, spec = _calm(study), study.controllers[0]
    feed = feed_of(calm, spec, build_timeline(calm), ready)
    run = RunState(RunOf(calm, feed))
    batch = begin_together([run], calm.simulation.bridge == "pwm")
    writer, _ = program_of([run])
    batch.follow(writer)
    run.before(0)
    rows, program = batch.rows[0, :, 0].copy(), batch.program
    for at, row, count, source in zip(program.at, program.row, program.count, program.source, strict=True):
        if at == 0:
            rows[row : row + count] = program.values[source : source + count]
    return AtRest(calm, feed, run, batch, rows[: len(spec_of(batch.kind, log_names(batch.kind)).rows)])


Told = tuple[tuple[float, Grid | None], ...]


@dataclass(frozen=True, kw_only=True)
class PageCase:
    """A case that a page shows: its study with one controller, and what the report says of it."""

    label: str
    study: Study
    status: str
    words: str
    figures: Mapping[str, float | None]
    """By the names of the explorer's figures, SI."""
    told: Told | None = None
    safe: Grid | None = None
    """What the schedule is told of the grid, and where it goes when this is stale, if not what the study says
    (:class:`vsgdesign.simulation.feeds.LateSchedule`)."""


class Recorded(NamedTuple):
    """What the loop of a run is given."""

    spec: LoopSpec
    uniform: Array
    rows: Array
    """Before the first sample."""
    puts: Array
    """(n, 3): before which sample which row gets which value, in this order."""
    samples: int


def recorded(case: PageCase, ready: Ready) -> Recorded:
    """The run of a case with an averaged bridge, as its loop is given it.

    Raises InfeasibleStudyError where the start has no steady state, ValueError for a study that cannot be replayed.
    """
    study, spec = case.study, case.study.controllers[0]
    if not can_be_replayed(study):
        raise ValueError(f"{study.name} cannot be replayed.")
    own = with_every_sample(study.with_limit_of(spec))
    if case.told is not None and spec.kind == "scheduled":
        feed: Any = LateSchedule(own, spec, case.told, ready, safe=case.safe)
    else:
        feed = feed_of(own, spec, build_timeline(own), ready)
    run = RunState(RunOf(own, feed))
    batch = begin_together([run], False)
    writer, cut = program_of([run])
    batch.follow(writer, cut)
    made, now = spec_of(batch.kind, log_names(batch.kind)), batch.rows[0, :, 0]
    program, k = batch.program, 0
    start, puts, marks = now.copy(), list[tuple[int, int, float]](), run.stops(run.marks())
    before = start
    for first, following in itertools.pairwise(marks):
        run.log.make_room(first, following)
        run.before(first)
        changed = np.flatnonzero(now.view(np.uint64) != before.view(np.uint64))
        puts += [(first, int(row), float(now[row])) for row in changed]
        mirror = now.copy()
        while k < len(program.at) and program.at[k] < following:
            row, count, source = int(program.row[k]), int(program.count[k]), int(program.source[k])
            values = program.values[source : source + count] if source >= 0 else mirror[-1 - source :][:count].copy()
            mirror[row : row + count] = values
            puts += [(int(program.at[k]), row + j, float(value)) for j, value in enumerate(values)]
            k += 1
        batch.advance(first, following)
        before = now.copy()
        run.after(following)
        if run.divergence is not None:
            break
    puts.sort(key=lambda put: put[0])
    rows, samples = start[: len(made.rows)], min(marks[-1], run.ended)
    return Recorded(made, batch.uniform, rows, np.array(puts, dtype=float).reshape(-1, 3), samples)


def can_be_replayed(study: Study) -> bool:
    """Whether nothing is given to the loop of a run sample by sample: no disturbed grid, no sensors, no estimator, no
    ramp of the source."""
    if any(event.over for event in study.events):
        return False
    calm = study.background is None and study.sensors is None and study.replay is None and study.network.plain
    return calm and not study.has_components and all(spec.estimate == "truth" for spec in study.controllers)


def cases_document(
    cases: Sequence[PageCase],
    ready: Ready,
    loops: MutableMapping[str, LoopSpec],
    basis: str,
    nothing: Mapping[str, Any],
) -> tuple[list[dict[str, Any]], bytes]:
    """What the page reads of its cases, and their numbers (float64). Their loops join ``loops``; ``basis`` is that of
    the page's SCR, and ``nothing`` has a row without figures."""
    documents, numbers = [], []
    for one in cases:
        found, study = recorded(one, ready), one.study
        name = next((name for name, spec in loops.items() if spec is found.spec), f"case_{len(loops)}")
        loops[name] = found.spec
        place = study.grid.place(study.converter, basis)
        documents.append(
            {
                "label": one.label,
                "controller": study.controllers[0].name,
                "loop": name,
                "uniform": found.uniform.tolist(),
                "samples": found.samples,
                "puts": len(found.puts),
                "event_s": min((event.t_s for event in study.events), default=0.0),
                "scr": place.scr,
                "x_over_r": place.x_over_r,
                "row": {**nothing, **one.figures, "status": one.status, "why": "", "verdict": one.words},
            }
        )
        numbers += [found.rows, *found.puts.T]
    return documents, np.concatenate([np.zeros(0), *numbers]).astype("<f8").tobytes()
