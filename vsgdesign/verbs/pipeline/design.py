"""The page of a study before any dynamics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from vsgdesign.artifacts import provenance, staged_folder, write_record
from vsgdesign.artifacts.time_series import write_table
from vsgdesign.design.power_flow import FIELDS
from vsgdesign.design.study_design import StudyDesign, design_study
from vsgdesign.study.parameters.study import Study

VERB = "vsgdesign design"
FLOW_FILE = "power_flow.csv"
UNITS = {"P_ref": "W", "Q_ref": "var", "P": "W", "Q": "var", "V_rms": "V", "I_rms": "A"}


def designed(study: Study) -> StudyDesign:
    """The power flow and the gains, with what the dc side cannot do. Raises InfeasibleStudyError."""
    from vsgdesign.simulation.lanes.beforehand import told_beforehand

    found = design_study(study)
    return replace(found, missing=(*found.missing, *told_beforehand(study, found.ready)))


def report_design(study: Study, out: str | Path) -> StudyDesign:
    """Writes results.json, the power flow as CSV, figures and report.html to ``out``. Raises ArtifactError."""
    from vsgdesign.report.drawing.files import write_all
    from vsgdesign.report.page.html import print_html
    from vsgdesign.report.stability.design import design_page, flow_figures

    with staged_folder(out, VERB, inputs=study.input_files) as folder:
        found = designed(study)
        rows = [
            (flow.controller, *(getattr(flow, name)[k] for name in FIELDS))
            for flow in found.flows
            for k in range(len(flow.limit))
        ]
        header = ("controller", *(f"{name} [{UNITS[name]}]" if name in UNITS else name for name in FIELDS))
        write_table(folder / FLOW_FILE, header, rows)
        figures = write_all(flow_figures(study, found.flows), folder / "figures")
        print_html(design_page(found, figures, FLOW_FILE), folder / "report.html")
        write_record(folder, found.document() | {"study": study.identity, "provenance": provenance()}, VERB)
    return found
