"""Runs of a page without a server that are told beforehand: cases of a report, which begin on their own grid and do not
keep to the page's events.

Such a run is replayed. What its circuit, its source and its schedule put into the rows of its loop, and when, is
recorded here while the run is computed; the page puts the same numbers into the same loop. So a case may have events
within an interval, a late or wrong estimate and any schedule, and has the bits of ``simulate``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.codegen.llvm import LoopSpec
from vsgdesign.simulation.every_sample import with_every_sample
from vsgdesign.simulation.feeds import LateSchedule, feed_of
from vsgdesign.simulation.loop import log_names, spec_of
from vsgdesign.simulation.run import begin_together, program_of
from vsgdesign.simulation.run_asked import RunOf
from vsgdesign.simulation.run_state import RunState
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
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
