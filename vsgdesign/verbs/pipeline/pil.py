"""From a study to a controller that runs in QEMU with the circuit of the study here: processor in the loop."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vsgdesign.artifacts import provenance, staged_folder, write_record
from vsgdesign.artifacts.time_series import write_table
from vsgdesign.execution.progress import Progress
from vsgdesign.export.processor import ProcessorRun, processor_in_the_loop
from vsgdesign.export.unit import Unit, controller_named
from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:
    from collections.abc import Sequence

VERB = "vsgdesign pil"


def run_processor(
    unit: Unit,
    study: Study,
    *,
    core: str = "m4",
    math: str = "printed",
    duration: float | None = None,
    out: str | Path | None = None,
    inputs: Sequence[str | Path] = (),
    progress: Progress | None = None,
) -> ProcessorRun:
    """Runs the controller of a study in QEMU, and writes results.json, series.csv, figures and report.html to the
    folder ``out`` if one is given. Raises the errors of :func:`vsgdesign.export.processor.processor_in_the_loop`."""
    own = study.with_limit_of(controller_named(study, unit.controller))

    def run() -> ProcessorRun:
        return processor_in_the_loop(unit, own, core=core, math=math, duration=duration, progress=progress)

    if out is None:
        return run()
    from vsgdesign.report.drawing.files import write_all
    from vsgdesign.report.page.html import print_html
    from vsgdesign.report.processor import processor_figures, processor_page

    with staged_folder(out, VERB, inputs=tuple(inputs)) as folder:
        found = run()
        document = found.document()
        drawn = write_all(processor_figures(found), folder / "figures")
        print_html(processor_page(document, drawn), folder / "report.html")
        write_table(folder / "series.csv", *_rows(found))
        write_record(folder, document | {"provenance": provenance()}, VERB)
    return found


def _rows(found: ProcessorRun) -> tuple[tuple[str, ...], list[list[float]]]:
    figures = ("P [pu]", "Q [pu]", "omega [pu]", "i_s_alpha [pu]", "i_s_beta [pu]")
    header = ("t [s]", *(f"{name} {where}" for where in ("in QEMU", "here") for name in figures), "instructions [1]")
    t_s = np.arange(len(found.instructions)) * found.unit.T_s
    rows = np.column_stack([t_s, found.target.figures, found.host.figures, found.instructions])
    return header, rows.tolist()
