"""What a page without a server simulates with: the compiled loops, and the start of every controller on every grid.

A run on the page is that of ``simulate`` with the same study, sample by sample. All that takes a model or a matrix is
here: the rest before the event, the circuit over a sampling interval, the gains, the scheduler's state. The page only
puts these numbers into the loops (``page/engine.js``).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.codegen.llvm import LoopSpec
from vsgdesign.codegen.llvm_loop import INTEGERS, POINTERS
from vsgdesign.codegen.records import numbers_of
from vsgdesign.codegen.wasm import wasm_module
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import gain_transfer
from vsgdesign.equations.sampled_path import source_response
from vsgdesign.equations.scheduler_data import SchedulerState
from vsgdesign.errors import VsgDesignError
from vsgdesign.linear.operating_point.plants import plant_steps
from vsgdesign.report.explore.events import NAMES, after_s, event_s, study_of
from vsgdesign.report.explore.live import NOTHING
from vsgdesign.report.explore.page_verdicts import common_of_verdicts, function_spec, judged_with, verdict_loops
from vsgdesign.report.explore.saving import WithoutEvent, saved_without_event
from vsgdesign.report.explore.scene import Scene, scene_of
from vsgdesign.report.explore.state import LABELS, LENGTHS_S, SIZES, State
from vsgdesign.runtime.closed_form import closed_form_schedule
from vsgdesign.runtime.lookup import gain_lookup
from vsgdesign.simulation.batch import Batch
from vsgdesign.simulation.bodies import names_of
from vsgdesign.simulation.circuit_program import RAMP_DRIFT
from vsgdesign.simulation.every_sample import with_every_sample
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.following import KnownGridScheduler
from vsgdesign.simulation.loop import log_names, spec_of
from vsgdesign.simulation.rescheduled import refollowed, rescheduled
from vsgdesign.simulation.run import begin_together, program_of
from vsgdesign.simulation.run_state import RunOf, RunState
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

WORDS = {
    "no_event": "This file does not simulate this event; `vsgdesign explore` does.",
    "nearest": "The jump leads to SCR {}, X/R {}, the nearest grid of this file.",
    "range": "{} must be a number between {} and {} {}.",
    "labels": LABELS,
    "no_save": "Nothing can be saved on this grid: no controller has an operating point there.",
    "no_start": "This file has no start for it on this grid.",
}
"""What the page says of its own runs."""
EVENTS = ("step", "grid", "phase", "sag", "ramp")
"""Events that the page simulates by itself."""


@dataclass(eq=False)
class _Controller:
    """What the page knows of one controller, and its starts."""

    document: dict[str, Any]
    starts: dict[str, Array] = field(default_factory=dict)
    """By grid: the rows of the loop, what the source adds per volt, the grid, and the scheduler's state."""
    why: dict[str, str] = field(default_factory=dict)
    """By grid: why there is no run."""

    def packed(self) -> tuple[dict[str, Any], Array]:
        """What the page reads, and its numbers: those of the first grid, then the columns that are not the same on all
        grids."""
        if not self.starts:
            return {"keys": [], "why": self.why}, np.zeros(0)
        matrix = np.array(list(self.starts.values()))
        same = (matrix == matrix[0]).all(axis=0)
        read = {"keys": list(self.starts), "why": self.why, "width": len(same)}
        read["varying"] = np.flatnonzero(~same).tolist()
        return self.document | read, np.concatenate([matrix[0], matrix[:, ~same].T.ravel()])


class PageRuns(NamedTuple):
    """What a page is given."""

    info: dict[str, Any]
    """The description."""
    data: bytes
    """What is behind it: the module, then all numbers (float64)."""
    saves: dict[str, WithoutEvent]
    """By grid: the study file of what is shown there; none where nothing can be saved."""


def page_runs(study: Study, ready: Ready, states: Iterable[tuple[str, State]]) -> PageRuns:
    """What a page is given for its grids.

    ``study`` has the changes of the states, which are the grids of the page with their keys: first those on which gains
    follow the grid, then those on which they are held. A controller whose gains are held is another one.
    """
    found: dict[bool, list[_Controller]] = {False: [], True: []}
    loops = {"transfer": function_spec(gain_transfer, {}), "response": function_spec(source_response, {})}
    loops |= verdict_loops()
    common: dict[str, Any] = {}
    saves: dict[str, WithoutEvent] = {}
    grids: dict[str, tuple[float, float]] = {}
    for key, state in states:
        scene = scene_of(study, ready, state)
        with contextlib.suppress(VsgDesignError):
            saves[key] = saved_without_event(scene, ready, state)
        grids[key] = scene.grid.R_g, scene.grid.L_g
        common = common or _common(scene, ready, state)
        held = found[state.hold is not None]
        held += [_Controller({}) for _ in scene.shown[len(held) :]]
        for k, one in enumerate(held):
            why = scene.cells.faults[k]
            if why is None:
                try:
                    document, own, one.starts[key] = _start(study_of(scene, ready, state, k), ready)
                    one.document = one.document or document | _named(own, loops)
                except VsgDesignError as error:
                    why = str(error)
            if why is not None:
                one.why[key] = why
    module = wasm_module(loops)
    packed = {held: [one.packed() for one in ones] for held, ones in found.items()}
    common |= {"places": {name: _places(spec) for name, spec in loops.items()}, "module": len(module)}
    common |= {"controllers": [one for one, _ in packed[False]], "held": [one for one, _ in packed[True]]}
    common["grids"] = {key: grid for key, grid in grids.items() if not key.endswith(",h")}
    numbers = [part.tobytes() for held in (False, True) for _, part in packed[held]]
    return PageRuns(common | {"integers": INTEGERS, "pointers": POINTERS}, b"".join([module, *numbers]), saves)


def _common(scene: Scene, ready: Ready, state: State) -> dict[str, Any]:
    """What all controllers share."""
    study, c = scene.study, scene.study.converter
    step, other = (replace(state, event=replace(state.event, kind=kind)) for kind in ("step", "phase"))
    return {
        "T_s": c.T_s,
        "log_interval": study.simulation.log_interval,
        "event_s": event_s(study),
        "after_step_s": after_s(scene, ready, step),
        "after_s": after_s(scene, ready, other),
        "S_rated": c.S_rated,
        "I_rated_pk": c.I_rated_pk,
        "V_rated_pk": rms_to_peak(c.V_rated_rms),
        "peak_per_rms": rms_to_peak(1.0),
        "V_rated_rms": c.V_rated_rms,
        "V_g_rms": study.grid_source.V_g_rms,
        "omega": study.grid_source.omega_g,
        "phase": build_timeline(study).source_at(0.0).phase,
        "circuit": {f"circuit.{name}": value for name, value in study.circuit()._asdict().items()},
        "drift": RAMP_DRIFT,
        "judge": common_of_verdicts(study),
        "events": EVENTS,
        "limits": {"size": {kind: SIZES[kind] for kind in EVENTS if kind in SIZES}, "length_s": LENGTHS_S},
        "figures": list(NOTHING),
        "words": WORDS | {"names": NAMES, "file": f"{study.name}-explored.toml"},
    }


def _start(study: Study, ready: Ready) -> tuple[dict[str, Any], dict[str, LoopSpec], Array]:
    """A controller's run before its event: what is the same on every grid, its loops, and the numbers of this grid."""
    spec = study.controllers[0]
    calm = with_every_sample(replace(study.with_limit_of(spec), events=()))
    feed = feed_of(calm, spec, build_timeline(calm), ready)
    run = RunState(RunOf(calm, feed))
    batch = begin_together([run], False)
    writer, _ = program_of([run])
    batch.follow(writer)
    run.before(0)
    rows, program = batch.rows[0, :, 0].copy(), batch.program
    for at, row, count, source in zip(program.at, program.row, program.count, program.source, strict=True):
        if at == 0:
            rows[row : row + count] = program.values[source : source + count]
    ramped = batch.kind._replace(ramped=True)
    loops = {"loop": spec_of(batch.kind, log_names(batch.kind)), "ramp": spec_of(ramped, log_names(ramped))}
    document: dict[str, Any] = {
        "uniform": batch.uniform.tolist(),
        "ramp_uniform": Batch(ramped, calm, 1).uniform.tolist(),
        "gains": "fixed" if spec.kind == "fixed" else "listed",
        "period_s": spec.update_period or calm.converter.T_s,
    }
    state: list[float] = []
    if isinstance(feed, KnownGridScheduler):
        own, loops["update"], state = _following(feed, calm, spec)
        document |= own | {"period_s": feed.update_period}
    grid, T_s = calm.grid, calm.converter.T_s
    marks = _marks(study, document["period_s"], T_s, updates="update" in loops)
    document["judge"] = judged_with(calm, spec, ready)
    document |= {"marks": marks, "phasors": run.phasors(marks).ravel().tolist()}
    source = plant_steps(calm, grid.R_g, grid.L_g, T_s, calm.grid_source.omega_g).source[0, 0]
    parts = [rows[: len(loops["loop"].rows)], source.real, source.imag, [grid.R_g, grid.L_g], state]
    return document, loops, np.concatenate([np.asarray(part, dtype=float) for part in parts])


def _named(own: dict[str, LoopSpec], loops: dict[str, LoopSpec]) -> dict[str, str]:
    """The names of a controller's loops. Controllers of one kind share theirs."""
    found = {}
    for role, spec in own.items():
        same = (name for name, known in loops.items() if known is spec)
        found[role] = next(same, f"{role}_{len(loops)}")
        loops[found[role]] = spec
    return found


def _marks(study: Study, period_s: float, T_s: float, *, updates: bool) -> list[int]:
    """The samples at which a run of the page may put its source anew before anything has moved it: the event, every
    second, the updates of the gains, and the one that sees a jump of the grid."""
    begin_s = event_s(study)
    longest = round((begin_s + LENGTHS_S[1] + study.simulation.duration) / T_s)
    found = {round(begin_s / T_s), *range(0, longest, max(round(1.0 / T_s), 1))}
    if updates:
        found |= set(range(0, longest, round(period_s / T_s)))
    found.add(math.ceil((math.floor(begin_s / period_s + 1e-9) + 1) * period_s / T_s - 1e-6))
    return sorted(found)


def _following(
    feed: KnownGridScheduler, study: Study, spec: ControllerSpec
) -> tuple[dict[str, Any], LoopSpec, list[float]]:
    """Gains that follow what is measured: what the page reads of them, the loop of an update, and the state."""
    runtime = feed.runtime
    if runtime is None:
        lookup = gain_lookup(closed_form_schedule(study, spec.target), V_n_rms=study.converter.V_rated_rms)
        return {"gains": "followed"}, function_spec(refollowed, {"table": lookup.table, "law": lookup.functions}), []
    lookup, settings = runtime.lookup, runtime.settings
    update = function_spec(rescheduled, {"table": lookup.table, "law": lookup.functions})
    limits = [float(getattr(settings.limits, name.removeprefix("limits."))) for name in update.uniform]
    document = {"gains": "table", "limits": limits, "tick": settings.tick, "state": names_of(SchedulerState, "s")}
    return document, update, numbers_of(runtime.present)


def _places(spec: LoopSpec) -> dict[str, Any]:
    return {
        "rows": spec.rows,
        "state": len(spec.state),
        "logged": spec.logged,
        "uniform": spec.uniform,
        "fed": len(spec.fed),
        "rings": len(spec.rings),
    }
