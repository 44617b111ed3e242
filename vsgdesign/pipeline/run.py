"""The whole path: study in, folder of evidence out."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.artifacts import provenance, staged_folder, write_csv, write_json, write_npz, write_table_file
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.progress import Progress, silent
from vsgdesign.metrics import EventMetrics
from vsgdesign.parameters import Study
from vsgdesign.pipeline.table import with_tables
from vsgdesign.simulation import ControllerResult, OperatingPointRow, ScenarioResult, run_scenario


def run_study(
    study: Study, out: str | Path, *, bridge: str | None = None, report: bool = True, workers: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Simulate every controller and leave time series, results, figures and a report in ``out``.

    Gain tables that the study asks for are designed first, on ``workers`` processes (None: one per core), and lie
    beside the rest.
    Returns the content of results.json. The folder appears when everything is done; an error or an
    interruption leaves what was there before. Raises the errors of :func:`vsgdesign.simulation.run_scenario`
    and ArtifactError.
    """
    tell = progress or silent
    begin = time.perf_counter()
    timing: dict[str, float] = {}
    with staged_folder(out) as folder:
        study = with_tables(study, out, workers=workers, progress=progress)
        for spec in study.controllers:
            if spec.table is not None:
                write_table_file(spec.table, folder / f"{spec.name}.table.json")
                timing["tables"] = time.perf_counter() - begin
        begin = time.perf_counter()
        result = run_scenario(
            study, bridge=bridge, progress=lambda name, t_s: tell(f"simulate {name}", t_s / study.simulation.duration)
        )
        timing["simulate"] = time.perf_counter() - begin
        begin = time.perf_counter()
        for done, controller in enumerate(result.controllers):
            tell("write time series", done / len(result.controllers))
            write_npz(folder / f"{controller.spec.name}.npz", controller.series)
            write_csv(folder / f"{controller.spec.name}.csv", controller.series, study.simulation.csv_interval)
        tell("write time series", 1.0)
        timing["write"] = time.perf_counter() - begin
        if report:
            from vsgdesign.report import write_figures, write_report

            begin = time.perf_counter()
            tell("draw figures", 0.0)
            figures = write_figures(result, folder / "figures")
            tell("draw figures", 1.0)
            write_report(result, figures, folder / "report.html")
            timing["report"] = time.perf_counter() - begin
        document = results_document(result, timing)
        write_json(folder / "results.json", document)
    return document


def results_document(result: ScenarioResult, timing_s: dict[str, float]) -> dict[str, Any]:
    """results.json: what scripts and tests read. Later stages add keys and rename none."""
    study = result.study
    return {
        "schema": 1,
        "study": {"name": study.name, "title": study.title, "source": study.source, "hash": study.hash},
        "provenance": provenance(),
        "operating_points": [_operating_point(row) for row in result.operating_points],
        "gains": [
            {"controller": c.spec.name, "t_s": change.t_s, **change.gains.named()}
            for c in result.controllers
            for change in c.gain_changes
        ],
        "controllers": {c.spec.name: _controller(study, c) for c in result.controllers},
        "timing_s": timing_s,
    }


def _operating_point(row: OperatingPointRow) -> dict[str, Any]:
    return {"t_s": row.t_s, "R_g": row.grid.R_g, "L_g": row.grid.L_g, **asdict(row.point)}


def _controller(study: Study, controller: ControllerResult) -> dict[str, Any]:
    return {
        "kind": controller.spec.kind,
        "bridge": controller.bridge,
        "structure": controller.spec.target.structure,
        "schedule": controller.spec.schedule if controller.spec.kind == "scheduled" else None,
        "table": None if controller.spec.table is None else _table(controller.spec.table),
        "target": asdict(controller.spec.target),
        "gains": [{"t_s": change.t_s, **change.gains.named()} for change in controller.gain_changes],
        "events": [_event(event) for event in controller.events],
        "loop_s": controller.simulation.loop_seconds,
        "real_time_factor": study.simulation.duration / max(controller.simulation.loop_seconds, 1e-9),
    }


def _table(table: GainTable) -> dict[str, Any]:
    statuses, counts = np.unique(table.status, return_counts=True)
    return {
        "sha256": table.sha256,
        "nodes": list(table.shape),
        "status": dict(zip(statuses.tolist(), counts.tolist(), strict=True)),
    }


def _event(event: EventMetrics) -> dict[str, Any]:
    return {
        "name": event.name,
        "t_s": event.t_s,
        "signal": event.signal,
        "kind": event.kind,
        **asdict(event.raw),
        "peak_current_pu": event.peak_current_pu,
        "one_cycle_mean": asdict(event.one_cycle_mean),
    }
