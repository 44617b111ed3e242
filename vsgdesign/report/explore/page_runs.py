"""What a page without a server simulates with: the compiled loops, and the start of every controller on every grid.

A run on the page is that of ``simulate`` with the same study, sample by sample. All that takes a model or a matrix is
here: the rest before the event, the circuit over a sampling interval, the gains, the scheduler's state. The page only
puts these numbers into the loops (``page/engine.js``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.codegen.llvm import LoopSpec
from vsgdesign.codegen.llvm_loop import INTEGERS, POINTERS
from vsgdesign.codegen.wasm import wasm_module
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import References, gain_transfer
from vsgdesign.equations.sampled_path import source_response
from vsgdesign.equations.scheduler_data import SchedulerState
from vsgdesign.linear.model.compiled import block_of, model_names
from vsgdesign.linear.model.dc_link import LinkInModel
from vsgdesign.linear.model.full_order import INPUTS, OUTPUTS
from vsgdesign.linear.operating_point.full_order import FullOrderModel, link_in_model
from vsgdesign.linear.stability.loci import RANKED, quantity_of
from vsgdesign.report.explore.dc_side import page_of_dc
from vsgdesign.report.explore.lattice import Columns, Lattice, Texts
from vsgdesign.report.explore.live import NOTHING
from vsgdesign.report.explore.page_starts import AtRest, CellStarts, PageCase, at_rest, cases_document
from vsgdesign.report.explore.page_verdicts import (
    common_of_verdicts,
    function_spec,
    judged_with,
    one_sample,
    verdict_loops,
)
from vsgdesign.report.explore.saving import WithoutEvent
from vsgdesign.report.explore.scene import NAMES, STEP_NAME, Scene, after_s, event_s, scene_of, study_of
from vsgdesign.report.explore.state import LABELS, LENGTHS_S, SIZES, State, sizes_of_steps
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.runtime.updating import gain_lookup
from vsgdesign.simulation.batch import Batch
from vsgdesign.simulation.circuit_program import RAMP_DRIFT
from vsgdesign.simulation.following import KnownGridScheduler, refollowed, rescheduled
from vsgdesign.simulation.loop import ALONE, carrier_values, log_names, slopes_of, spec_of
from vsgdesign.simulation.run_kind import names_of
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

WORDS = {
    "no_event": "This file does not simulate this event; `vsgdesign explore` does.",
    "nearest": "The jump leads to SCR {}, X/R {}, the nearest grid of this file.",
    "range": "{} must be a number between {} and {} {}.",
    "labels": LABELS,
    "no_save": "Nothing can be saved on this grid: no controller has an operating point there.",
    "no_wasm": (
        "Nothing is simulated here, because this browser does not run WebAssembly or forbids it. The map is complete "
        "without it."
    ),
    "no_save_case": "Events of the map are saved here. `vsgdesign verify` writes its cases as study files.",
    "no_start": "This file has no start for it on this grid.",
    "no_figure": "This file has no such map; `vsgdesign explore` has.",
}
"""What the page says of its own runs."""
EVENTS = ("step", "grid", "phase", "sag", "ramp")
"""Events that the page simulates by itself."""


class PageRuns(NamedTuple):
    """What a page is given."""

    info: dict[str, Any]
    """The description."""
    data: bytes
    """What is behind it: the module, the columns of numbers, and the numbers of the cases."""


def page_runs(
    study: Study,
    ready: Ready,
    lattice: Lattice,
    cells: Mapping[bool, tuple[Sequence[State], CellStarts]],
    models: Mapping[tuple[bool, int], FullOrderModel],
    texts: Texts,
    cases: Sequence[PageCase] = (),
    *,
    quickly: bool = False,
) -> PageRuns:
    """What a page simulates with.

    ``study`` has the changes of the states. ``cells`` has the states of the grids and what :func:`starts_of` says of
    them, with gains that follow the grid (False) and with held ones (True): a controller whose gains are held is
    another one. ``models`` has its linear model by whether its gains are held and its place, with any of the grids.
    ``cases`` are runs of their own. ``quickly``: the loops are made in less time, and take an eighth longer.
    """
    loops = {"transfer": function_spec(gain_transfer, {}), "response": function_spec(source_response, {})}
    switched = study.simulation.bridge == "pwm"
    loops |= verdict_loops(guarded=study.protection is not None, switched=switched)
    columns = lattice.columns()
    info = _common(scene_of(study, ready, cells[False][0][0]), ready, cells[False][0][0])
    linear = _LinearLoops(loops)
    for held, (states, found) in cells.items():
        documents = []
        for k, own in enumerate(found.starts):
            document = {"why": columns.whole(texts.numbers(own.why)), "there": 0}
            if own.there.any():
                good = int(np.argmax(own.there))
                scene = scene_of(study, ready, states[good])
                described, of_start = _described(at_rest(study_of(scene, ready, states[good], k), ready), ready)
                document |= described | _named(of_start, loops)
                document["there"] = columns.whole(own.there)
                document["numbers"] = [columns.exact(values) for values in own.numbers.T]
                if (model := models.get((held, k))) is not None:
                    document["model"] = linear.document(model, of_start["loop"].rows, link_in_model(study))
            documents.append(document)
        info["held" if held else "controllers"] = documents
    grids = [Place(at.scr, at.x_over_r, study.scr_basis).grid(study.converter) for at in lattice.places]
    info["grids"] = [columns.exact([grid.R_g for grid in grids]), columns.exact([grid.L_g for grid in grids])]
    info["saves"] = {
        "held" if held else "follow": _saves(columns, texts, one.saves) for held, (_, one) in cells.items()
    }
    info |= page_of_dc(study, loops)
    info["cases"], behind = cases_document(cases, ready, loops, study.scr_basis, NOTHING)
    rare = [name for name, spec in loops.items() if quickly or _is_rare(spec)]
    module, packed = wasm_module(loops, rare), columns.packed()
    info |= {"places": {name: _places(spec) for name, spec in loops.items()}, "module": len(module)}
    info |= {"columns": columns.document(), "integers": INTEGERS, "pointers": POINTERS}
    info["behind"] = len(module) + len(packed)
    return PageRuns(info, module + packed + behind)


def _is_rare(spec: LoopSpec) -> bool:
    """Whether a loop is called for single samples: it is not that of a run, nor one over its log."""
    return not spec.fed and "x.i_s_alpha" not in spec.rows


class _LinearLoops:
    """Linear models among the loops of a module. Controllers with the same equations share theirs."""

    def __init__(self, loops: dict[str, LoopSpec]) -> None:
        self.loops = loops
        self.names: dict[int, int] = {}

    def document(self, model: FullOrderModel, rows: Sequence[str], link: LinkInModel | None) -> dict[str, Any]:
        """What the page reads of a controller's model: its loops, and which rows of a start give z and p. ``link``: the
        dc link in the model, whose parameters are the last ones."""
        known = len(self.names)
        number = self.names.setdefault(id(model.map), known)
        names = {"linear": f"linear_{number}", "period": f"period_{number}"}
        if number == known:
            z, p = model_names(model.map)
            for name, function, results in (
                (names["linear"], model.map.linear, "ABCD"), (names["period"], model.map.step, "zy"),
            ):  # fmt: skip
                outputs = [[f"{one}{k}" for k in range(function.numel_out(at))] for at, one in enumerate(results)]
                self.loops[name] = one_sample(block_of(function, (z, p), outputs))
        z, p = model_names(model.map)
        at = {name: k for k, name in enumerate(rows)}
        of_link = () if link is None else link.parameters
        named = [*p[: len(p) - len(of_link)], *of_link]
        return names | {
            "states": model.states,
            "quantities": {name: quantity_of(name) for name in model.states},
            "z": [at[_row_of_state(name)] for name in model.states],
            "p": model.p[0].tolist(),
            "of_start": {k: at[row] for k, name in enumerate(named) if (row := _row_of_parameter(name)) in at},
            "parameters": p,
            "ranked": [p.index(name) for name in RANKED],
            "inputs": INPUTS,
            "outputs": OUTPUTS,
        }


_ROW_OF_STATE = {
    **{
        f"{one}_{old}": f"x.{one}_{new}"
        for one in ("i_s", "v_c", "i_g")
        for old, new in (("d", "alpha"), ("q", "beta"))
    },
    "pending_d": "state.u_alpha",
    "pending_q": "state.u_beta",
    "delta": "state.theta",
    "v_dc": "dc.v",
    "p_dc": "dc.p",
}
"""The rows of a start that have another name than a state of the model, which is in the frame of the source."""


def _row_of_state(name: str) -> str:
    """The row of a start with a state of the model."""
    if name.startswith("dc_"):
        return f"dc.memory.{name.removeprefix('dc_')}"
    return _ROW_OF_STATE.get(name, f"state.{name.replace('limiter_', 'limiter.', 1)}")


def _row_of_parameter(name: str) -> str:
    """The row of a start with a parameter that is not the same on all grids and at every charge, but for the grid
    itself: its row has what the controller is told of it."""
    if name.startswith("memory."):
        return f"dc.{name}"
    return f"refs.{name}" if name in References._fields else f"power_gains.{name}"


def _saves(columns: Columns, texts: Texts, saves: Sequence[WithoutEvent | None]) -> dict[str, Any]:
    """The study files of all grids: of each its lines, and the references."""
    files = [[] if one is None else one.text.splitlines() for one in saves]
    most = max(len(lines) for lines in files)
    refs = np.array([(np.nan, np.nan) if one is None else one[2:] for one in saves])
    return {
        "lines": [columns.whole(texts.numbers(_line(lines, k) for lines in files)) for k in range(most)],
        "words": columns.whole(texts.numbers(None if one is None else one.words for one in saves)),
        "refs": [columns.exact(values) for values in refs.T],
    }


def _line(lines: Sequence[str], k: int) -> str | None:
    """A line of a file; an empty one is a space, and None is behind its end."""
    return (lines[k] or " ") if k < len(lines) else None


def _common(scene: Scene, ready: Ready, state: State) -> dict[str, Any]:
    """What all controllers share."""
    study, c = scene.study, scene.study.converter
    step, other = (replace(state, event=replace(state.event, kind=kind)) for kind in ("step", "phase"))
    set_points, sizes = _set_points(c), SIZES | sizes_of_steps()
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
        "carrier": _carrier(study),
        "judge": common_of_verdicts(study),
        "events": [*EVENTS, *set_points],
        "set_points": set_points,
        "limits": {
            "size": {kind: sizes[kind] for kind in sizes if kind in (*EVENTS, *set_points)},
            "length_s": LENGTHS_S,
        },
        "figures": list(NOTHING),
        "words": WORDS | {"names": NAMES, "file": f"{study.name}-explored.toml"},
    }


def _carrier(study: Study) -> dict[str, Any]:
    """Where the samples of a carrier's period lie on it, sample by sample, and which of a loop's bodies each has; of an
    averaged bridge nothing."""
    n = study.converter.samples_per_carrier if study.simulation.bridge == "pwm" else 0
    places, bodies = carrier_values(slopes_of(n))
    return {"places": places.ravel().tolist(), "bodies": bodies.tolist()}


def _set_points(c: Converter) -> dict[str, Any]:
    """Steps of set points besides P and Q: the row that they set, the value before them, what a size of 1 is, the field
    of a study file, what 1 is there, and the name of the event."""
    return {
        name: {
            "row": f"refs.{kind.quantity}",
            "start": step.start(c),
            "one": step.one(c),
            "field": kind.name,
            "unit": kind.one(c),
            "name": STEP_NAME.format(step.label, "{:+.3g}", step.unit),
        }
        for name, (kind, step) in EVENT_KINDS.explored.items()
        if kind.of_controller
    }


def _described(at: AtRest, ready: Ready) -> tuple[dict[str, Any], dict[str, LoopSpec]]:
    """What is the same of a controller on every grid, and its loops."""
    study, spec, kind = at.study, at.study.controllers[0], at.batch.kind
    ramped = kind._replace(ramped=True)
    loops = {"loop": spec_of(kind, log_names(kind)), "ramp": spec_of(ramped, log_names(ramped))}
    averaged = kind._replace(bridge=kind.bridge._replace(slopes=()))
    loops["averaged"] = spec_of(averaged, log_names(averaged))  # for the modes of a rest
    if not kind.bridge.slopes:  # for the map of verdicts
        loops["pair"] = spec_of(kind, log_names(kind), ALONE._replace(lanes=2))
    document: dict[str, Any] = {
        "uniform": at.batch.uniform.tolist(),
        "averaged_uniform": Batch(averaged, study, 1).uniform.tolist(),
        "ramp_uniform": Batch(ramped, study, 1).uniform.tolist(),
        "gains": "fixed" if spec.kind == "fixed" else "listed",
        "period_s": spec.update_period or study.converter.T_s,
    }
    if isinstance(at.feed, KnownGridScheduler):
        own, loops["update"] = _following(at.feed, study, spec)
        document |= own | {"period_s": at.feed.update_period}
    marks = _marks(study, document["period_s"], study.converter.T_s, updates="update" in loops)
    document["judge"] = judged_with(study, spec, ready)
    return document | {"marks": marks, "phasors": at.run.phasors(marks).ravel().tolist()}, loops


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


def _following(feed: KnownGridScheduler, study: Study, spec: ControllerSpec) -> tuple[dict[str, Any], LoopSpec]:
    """Gains that follow what is measured: what the page reads of them, and the loop of an update."""
    runtime = feed.runtime
    if runtime is None:
        lookup = gain_lookup(closed_form_schedule(study, spec.target), V_n_rms=study.converter.V_rated_rms)
        return {"gains": "followed"}, function_spec(refollowed, {"table": lookup.table, "law": lookup.functions})
    lookup, settings = runtime.lookup, runtime.settings
    update = function_spec(rescheduled, {"table": lookup.table, "law": lookup.functions})
    limits = [float(getattr(settings.limits, name.removeprefix("limits."))) for name in update.uniform]
    document = {"gains": "table", "limits": limits, "tick": settings.tick, "state": names_of(SchedulerState, "s")}
    return document, update


def _places(spec: LoopSpec) -> dict[str, Any]:
    return {
        "rows": spec.rows,
        "state": len(spec.state),
        "logged": spec.logged,
        "uniform": spec.uniform,
        "fed": len(spec.fed),
        "rings": len(spec.rings),
        "lanes": spec.width,
        "switched": bool(spec.cyclic),
    }
