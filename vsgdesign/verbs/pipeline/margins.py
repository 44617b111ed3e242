"""From a study to its stability: power flow, maps, close looks, EMT evidence, clause matrix, report."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.artifacts import provenance, staged_folder, write_record
from vsgdesign.artifacts.definitions import damping_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.artifacts.time_series import write_table
from vsgdesign.design.study_design import FIELDS, StudyDesign, design_study
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.linear.stability.assessment import (
    VIEW_HEADER,
    ControllerAssessment,
    FocusCell,
    assess,
    map_header,
    map_rows,
    view_rows,
)
from vsgdesign.linear.stability.modes_of_units import DifferentialWorst, worst_differential
from vsgdesign.linear.stability.verdict import clause_matrix, left_out, worst_cases
from vsgdesign.metrics.margins import guaranteed_margins
from vsgdesign.report.drawing.figures import ExplorerFile
from vsgdesign.report.explore.lattice import QUICK_LATTICE
from vsgdesign.report.page.live import StaticPage
from vsgdesign.simulation.stability_result import (
    StabilityResult,
    StepEvidence,
    frequency_file,
    map_file,
    maps_of,
    step_evidence,
    step_file,
)
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.live_part import live_begun, told_apart, waited_for
from vsgdesign.verbs.pipeline.study_tables import study_tables

if TYPE_CHECKING:
    from vsgdesign.report.page.blocks import Block


VERB = "vsgdesign report"
EXPLORER_FILE = "explorer.html"


def assess_study(
    study: Study,
    ready: Ready | None = None,
    *,
    evidence: bool = True,
    several: bool = False,
    progress: Progress | None = None,
) -> StabilityResult:
    """Assesses every controller of a study; with ``evidence``, it also simulates small EMT steps at its stable grids.

    ``several``: the study is one of several equal units, whose differential mode is assessed, too. ``ready`` holds
    the gain tables that the study asks for. With None they are read or designed first.
    """
    tell = progress or silent
    if ready is None:
        ready = study_tables(study, progress=progress).ready
    begin = time.perf_counter()
    assessments = tuple(
        assess(study, spec, ready, lambda what, share: tell(f"assess {what}", share))
        for spec in study.controllers
        if spec in told_apart(study, ready)  # margins are those of the gains for a grid
    )
    apart = tuple(worst_differential(study, a.spec.name, a.full_order) for a in assessments) if several else ()
    timing = {"assess": time.perf_counter() - begin}
    begin = time.perf_counter()
    found: dict[tuple[str, str], tuple[StepEvidence, StepEvidence]] = {}
    if evidence:
        cells = [(a.spec.name, cell) for a in assessments for cell in a.focus if cell.full_order_table.stable[0]]
        for done, (name, cell) in enumerate(cells):
            tell("simulate small steps", done / len(cells))
            found[name, cell.label] = step_evidence(study, cell)
        tell("simulate small steps", 1.0)
        timing["evidence"] = time.perf_counter() - begin
    return StabilityResult(study, assessments, found, clause_matrix(study, assessments), timing, ready, apart)


def report_stability(
    study: Study,
    out: str | Path,
    *,
    pdf: bool = False,
    explorer: bool = True,
    workers: int | None = None,
    whole: Study | None = None,
    progress: Progress | None = None,
    show: Callable[[list[Block]], None] | None = None,
) -> dict[str, Any]:
    """Assesses a study and writes figures, CSV files, results.json and report.html to ``out``. ``whole``: the study
    with the plant of which ``study`` is one of several equal units.

    With ``pdf`` it also writes report.pdf. With ``explorer`` it also writes explorer.html, the page of ``vsgdesign
    explore --page``, which the report shows in a frame. Another process makes it while the figures are drawn, unless
    ``workers`` is 1 (None means one per core). ``show`` is given what a terminal prints of the result. Returns the
    content of results.json. The folder appears when everything is done. Raises the errors of :func:`assess_study` and
    ArtifactError.
    """
    tell = progress or silent
    with staged_folder(out, VERB, inputs=study.input_files) as folder:
        plant = None if whole is None else whole.plant
        several = plant is not None and len(plant.units) > 1
        result = replace(assess_study(study, several=several, progress=progress), whole=whole)
        document = _write(result, folder, pdf, explorer, workers, tell)
        if show is not None:
            from vsgdesign.report.stability.page import terminal_blocks

            show(terminal_blocks(result))
        return document


def write_stability(
    result: StabilityResult,
    out: str | Path,
    *,
    pdf: bool = False,
    explorer: bool = True,
    workers: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Writes the folder of :func:`report_stability` for an existing result. Raises ArtifactError."""
    with staged_folder(out, VERB, inputs=result.study.input_files) as folder:
        return _write(result, folder, pdf, explorer, workers, progress or silent)


def _write(
    result: StabilityResult, folder: Path, pdf: bool, explorer: bool, workers: int | None, tell: Progress
) -> dict[str, Any]:
    from vsgdesign.campaigns.phase_jumps import phase_jumps
    from vsgdesign.report.drawing.figures import write_all
    from vsgdesign.report.page.html import print_html
    from vsgdesign.report.stability.page import stability_figures, stability_page

    begin = time.perf_counter()
    begun = live_begun(result.study, result.ready, workers, QUICK_LATTICE) if explorer else nullcontext()
    with begun as explored:
        write_stability_tables(result, folder)
        tell("draw figures", 0.0)
        figures = write_all(stability_figures(result), folder / "figures")
        tell("draw figures", 1.0)
        explorer_file = None if explored is None else _written(waited_for(explored, tell), folder)
    found = phase_jumps(result.study)
    jumps = None if found is None else found.document()
    page = stability_page(result, figures, explorer_file, jumps)
    if pdf:
        from vsgdesign.report.page.pdf import print_pdf

        print_pdf(page, folder / "report.pdf")
    print_html(page, folder / "report.html")
    result.timing_s["report"] = time.perf_counter() - begin
    return write_record(folder, stability_document(result) | {"phase_jumps": jumps}, VERB)


def _written(page: StaticPage, folder: Path) -> ExplorerFile:
    """Writes the explorer. The report does without it where there is none."""
    if page.text is None:
        return ExplorerFile(why=page.why)
    return ExplorerFile(EXPLORER_FILE, (folder / EXPLORER_FILE).write_bytes(page.text.encode("utf-8")))


def write_stability_tables(result: StabilityResult, folder: Path) -> None:
    """Every map, frequency view and response of a result as CSV."""
    for a in result.assessments:
        name = a.spec.name
        for kind, field in maps_of(a).items():
            write_table(folder / map_file(name, kind), map_header(field), map_rows(field))
        for cell in a.focus:
            write_table(folder / frequency_file(name, cell.label), VIEW_HEADER, view_rows(cell))
    for (name, label), responses in result.evidence.items():
        for e in responses:
            columns = (e.t_s, e.emt, e.full_order, e.reduced)
            unit = "W" if e.signal == "P" else "var"
            header = ("t [s]", *(f"{kind} [{unit}]" for kind in ("emt", "full_order", "reduced")))
            step = max(len(e.t_s) // 3000, 1)
            rows = zip(*(column[::step].tolist() for column in columns), strict=True)
            write_table(folder / step_file(name, label, e.signal), header, rows)


def stability_document(result: StabilityResult) -> dict[str, Any]:
    """results.json of a stability report: identity, gates, verdicts, worst cases and close looks."""
    study = result.study
    return {
        "schema": 1,
        "study": study.identity,
        "provenance": provenance(),
        "gates": asdict(study.stability.gates),
        "axes": {key: value for key, value in asdict(study.stability).items() if key != "gates"},
        "scr_basis": study.scr_basis,
        "verdicts": [asdict(row) for row in result.verdicts],
        "controllers": {a.spec.name: _controller(result, a) for a in result.assessments},
        **({"differential": [_differential(one) for one in result.differential]} if result.differential else {}),
        "timing_s": result.timing_s,
    }


def _differential(one: DifferentialWorst) -> dict[str, Any]:
    found = {name: getattr(one, name) for name in ("controller", "cells", "where", "asked", "missing")}
    return found | {"real": one.s.real, "imag": one.s.imag}


def _controller(result: StabilityResult, a: ControllerAssessment) -> dict[str, Any]:
    study = result.study
    return {
        "kind": a.spec.kind,
        "worst": {
            "reduced": [asdict(w) for w in worst_cases(study, a.reduced)],
            "full_order": [asdict(w) for w in worst_cases(study, a.full_order)],
        },
        "outside_the_limits": {
            name: {"cells": len(field.faults), "outside": len(beyond), "not_asked": not_asked}
            for name, field in (("reduced", a.reduced), ("full_order", a.full_order))
            for beyond, not_asked in (left_out(field),)
        },
        "between_nodes": {
            "grids": len(a.between.stable),
            "stable": int(a.between.stable.sum()),
            "damping_all_modes": float(np.min(a.between.least_damping)) if len(a.between.stable) else None,
        },
        "x_over_r_limit": [{"scr": scr, "x_over_r": limit} for scr, limit in a.x_over_r_limit],
        "cells": [_focus(result, a.spec.name, cell) for cell in a.focus],
    }


def _focus(result: StabilityResult, name: str, cell: FocusCell) -> dict[str, Any]:
    evidence = result.evidence.get((name, cell.label))
    return {
        "label": cell.label,
        "R_g": cell.grid.R_g,
        "L_g": cell.grid.L_g,
        "P": cell.P,
        "Q": cell.Q,
        "outside_the_limits": cell.outside,
        "gains": cell.gains.named(),
        "margins": {
            model: _margins(model, table)
            for model, table in (("reduced", cell.reduced_table), ("full_order", cell.full_order_table))
        },
        "modes": [
            {
                "real": m.s.real,
                "imag": m.s.imag,
                "damping": m.damping,
                "participation": [{"state": state, "share": share} for state, share in m.participation],
            }
            for m in cell.modes
        ],
        "sensitivities": [
            {"parameter": s.parameter, "value": s.value, "ds_dp_real": s.ds_dp.real, "ds_dp_imag": s.ds_dp.imag}
            for s in cell.sensitivities
        ],
        "linear_against_emt": None
        if evidence is None
        else {e.signal: {"full_order": e.error("full_order"), "reduced": e.error("reduced")} for e in evidence},
    }


def _margins(model: str, table: Any) -> dict[str, Any]:
    gain, phase = guaranteed_margins(table.disk_output.value)
    loops = {
        loop: {field: float(getattr(margins, field)[0]) for field in margins.__dataclass_fields__}
        for loop, margins in (("P", table.loop_P), ("Q", table.loop_Q))
    }
    return {
        "stable": bool(table.stable[0]),
        "spectral_abscissa": float(table.spectral_abscissa[0]),
        damping_of(model): float(table.least_damping[0]),
        "disk_margin_output": float(table.disk_output.value[0]),
        "disk_margin_output_rad_s": float(table.disk_output.omega[0]),
        "disk_margin_input": float(table.disk_input.value[0]),
        "guaranteed_gain_factor": float(gain[0]),
        "guaranteed_phase_deg": float(phase[0]),
        "M_s": float(table.M_s.value[0]),
        "M_s_rad_s": float(table.M_s.omega[0]),
        "loops": loops,
    }


DESIGN = "vsgdesign design"
FLOW_FILE = "power_flow.csv"
_FLOW_UNITS = {"P_ref": "W", "Q_ref": "var", "P": "W", "Q": "var", "V_rms": "V", "I_rms": "A"}


def designed(study: Study) -> StudyDesign:
    """The power flow and the gains, with what the dc side cannot do. Raises InfeasibleStudyError."""
    from vsgdesign.simulation.lanes.beforehand import told_beforehand

    found = design_study(study)
    return replace(found, missing=(*found.missing, *told_beforehand(study, found.ready)))


def report_design(study: Study, out: str | Path) -> StudyDesign:
    """Writes results.json, the power flow as CSV, figures and report.html to ``out``. Raises ArtifactError."""
    from vsgdesign.report.drawing.figures import write_all
    from vsgdesign.report.page.html import print_html
    from vsgdesign.report.stability.design import design_page, flow_figures

    with staged_folder(out, DESIGN, inputs=study.input_files) as folder:
        found = designed(study)
        rows = [
            (flow.controller, *(getattr(flow, name)[k] for name in FIELDS))
            for flow in found.flows
            for k in range(len(flow.limit))
        ]
        header = (
            "controller",
            *(f"{name} [{_FLOW_UNITS[name]}]" if name in _FLOW_UNITS else name for name in FIELDS),
        )
        write_table(folder / FLOW_FILE, header, rows)
        figures = write_all(flow_figures(study, found.flows), folder / "figures")
        print_html(design_page(found, figures, FLOW_FILE), folder / "report.html")
        write_record(folder, found.document() | {"study": study.identity, "provenance": provenance()}, DESIGN)
    return found
