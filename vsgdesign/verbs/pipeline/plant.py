"""A study with a plant to a folder of results: time series of every unit, and results.json."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts import provenance, room_for, staged_folder, write_record
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.linear.stability.loci import Mode
from vsgdesign.linear.stability.modes_of_units import PlantMode
from vsgdesign.simulation.scenario import ScenarioResult
from vsgdesign.simulation.units.scenario import PlantController, PlantRest, PlantResult, run_plant
from vsgdesign.simulation.units.timeline import plant_timeline
from vsgdesign.study.parameters import Study
from vsgdesign.verbs.pipeline.making import Made, made, nothing_to_make
from vsgdesign.verbs.pipeline.results import results_document
from vsgdesign.verbs.pipeline.run import export_tables, write_series
from vsgdesign.verbs.pipeline.study_tables import study_tables, with_left_tables

_OF_UNIT = ("operating_points", "gains", "promises", "controllers")
"""What results.json has of each unit, as of one converter."""


def run_plant_study(
    study: Study,
    out: str | Path,
    *,
    report: bool = False,
    workers: int | None = None,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
    say: Callable[[str], None] | None = None,
    comtrade: str | None = None,
) -> tuple[PlantResult, dict[str, Any]]:
    """Simulates every controller of a study in all units of its plant, and writes ``CONTROLLER.NAME.npz`` of each unit
    and inverter, the same as CSV and, in the form ``comtrade`` if one is given, as COMTRADE, and results.json to
    ``out``, which appears when everything is done. With ``report`` also figures, report.html, margins of both modes
    where the units are equal, and the gain tables with their C; tables that are designed are kept cell by cell, so that
    the same call continues after an interruption. Returns the result and the content of results.json. Raises
    InfeasibleStudyError and ArtifactError."""
    tell, verb = progress or silent, "vsgdesign run" if report else "vsgdesign simulate"
    with (
        room_for(out, verb, inputs=study.input_files),
        _made(study, out, report=report, workers=workers, progress=progress, say=say) as have,
        staged_folder(out, verb, inputs=study.input_files) as folder,
    ):
        begin, timing = time.perf_counter(), have.timing_s
        ready = have.ready if have.late is None else have.late()
        duration = study.simulation.duration
        result = run_plant(study, ready, warn=warn, progress=lambda name, t_s: tell(f"simulate {name}", t_s / duration))
        timing["simulate"] = time.perf_counter() - begin
        for controller in result.controllers:
            name = controller.spec.name
            for unit, one in zip(controller.timeline.plant.units, controller.units, strict=True):
                write_series(study, folder, f"{name}.{unit.name}", one.series, one.estimates, comtrade)
            for inverter, series in controller.inverters:
                write_series(study, folder, f"{name}.{inverter}", series, comtrade=comtrade)
        more = _report(result, folder, have.verified(), tell, warn) if report else {}
        document = plant_document(result, timing) | more
        return result, write_record(folder, document, verb)


@contextmanager
def _made(
    study: Study,
    out: str | Path,
    *,
    report: bool,
    workers: int | None,
    progress: Progress | None,
    say: Callable[[str], None] | None,
) -> Iterator[Made]:
    """The tables of a plant. For a report those of equal units are designed as those of one converter are
    (:func:`vsgdesign.verbs.pipeline.making.made`)."""
    designed = any(one.schedule == "table" and one.table_file is None for one in study.controllers)
    if report and designed and study.plant is not None and study.plant.equal:
        own = replace(plant_timeline(study).units[0], name=study.name)
        with made(own, out, workers=workers, progress=progress, say=say) as have:
            yield have
        return
    yield nothing_to_make(plant_tables(study, progress=progress, say=say))


def _report(
    result: PlantResult, folder: Path, ready: Ready, tell: Progress, warn: Callable[[str], None] | None
) -> dict[str, Any]:
    """Figures, page, tables and their C. Returns what results.json has of the margins."""
    from vsgdesign.report.drawing.figures import write_all
    from vsgdesign.report.page.html import print_html
    from vsgdesign.report.plant import plant_figures, plant_page
    from vsgdesign.verbs.pipeline.margins import assess_study, stability_document

    study, margins = result.study, None
    first = result.controllers[0].timeline
    if ready.tables:
        export_tables(first.units[0], ready, folder, warn=warn)
    if first.plant.equal and not first.plant.elements and not first.plant.sources and study.network.plain:
        own = replace(first.units[0], name=study.name)
        margins = assess_study(own, ready, evidence=False, several=len(first.plant.units) > 1, progress=tell)
    tell("draw figures", 0.0)
    figures = write_all(plant_figures(result), folder / "figures")
    print_html(plant_page(result, figures, margins), folder / "report.html")
    tell("draw figures", 1.0)
    if margins is None:
        return {}
    document = stability_document(margins)
    return {"margins": {name: document[name] for name in ("controllers", "differential", "axes") if name in document}}


def plant_tables(study: Study, *, progress: Progress | None = None, say: Callable[[str], None] | None = None) -> Ready:
    """The gain tables of a plant. Those that it names must be made for every unit behind its transformer and feeder. Of
    equal units others are taken from below ``out`` or designed, as for one converter. Raises InfeasibleStudyError for
    units that differ and leave a table to be designed, and ArtifactError."""
    units = plant_timeline(study).units
    named, *_ = [read_tables(one) for one in units]
    designed = [one.name for one in study.controllers if one.schedule == "table" and one.table_file is None]
    if not designed:
        return Ready(tables=named)
    if study.plant is None or not study.plant.equal:
        raise InfeasibleStudyError(
            f"controller {designed[0]}: no table is designed for a plant whose units differ. "
            'Give its table = "FILE.json".'
        )
    own = with_left_tables(replace(units[0], name=study.name), say=say)
    return Ready(tables=study_tables(own, progress=progress, say=say).tables)


def plant_document(result: PlantResult, timing_s: dict[str, float]) -> dict[str, Any]:
    """results.json of a plant: ``units.NAME`` has for each unit what a study of one converter has."""
    study = result.study
    units = () if study.plant is None else study.plant.units
    of_units = {unit.name: _unit(result, k, timing_s) for k, unit in enumerate(units)}
    return {
        "schema": 1,
        "study": study.identity,
        "provenance": provenance(),
        "controllers": {one.spec.name: _controller(study, one) for one in result.controllers},
        "units": of_units,
        "timing_s": timing_s,
    }


def _unit(result: PlantResult, k: int, timing_s: dict[str, float]) -> dict[str, Any]:
    first = result.controllers[0]
    of_unit = ScenarioResult(
        study=first.timeline.units[k],
        timeline=first.timeline.timelines[k],
        controllers=tuple(one.units[k] for one in result.controllers),
        ready=result.ready,
    )
    document = results_document(of_unit, timing_s)
    return {name: document[name] for name in _OF_UNIT}


def _controller(study: Study, one: PlantController) -> dict[str, Any]:
    return {
        "kind": one.spec.kind,
        "outcome": asdict(one.outcome),
        "rests": [_rest(rest) for rest in one.rests],
        **({"sharing": [asdict(own) for own in one.sharing]} if one.sharing else {}),
        "loop_s": one.loop_seconds,
        "real_time_factor": study.simulation.duration / max(one.loop_seconds, 1e-9),
    }


def _rest(rest: PlantRest) -> dict[str, Any]:
    split = None
    if rest.split is not None:
        split = {name: [_mode(mode) for mode in getattr(rest.split, name)] for name in ("common", "differential")}
    return {
        "t_s": rest.t_s,
        "end_s": rest.end_s,
        "name": rest.name,
        "on_line": list(rest.on_line),
        "reason": rest.obstacle,
        "modes": [_mode(mode) | {"units": dict(mode.units)} for mode in rest.modes],
        "split": split,
        "inverters": {
            one.name: {"P_pcc": one.P_pcc, "Q_pcc": one.Q_pcc, "V_rms": one.V_rms, "I_pu": one.I_pu}
            for one in rest.inverters
        },
    }


def _mode(mode: Mode | PlantMode) -> dict[str, float]:
    return {"real": mode.s.real, "imag": mode.s.imag, "damping_ratio": mode.damping}
