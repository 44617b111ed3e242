"""From a study, or a gain table and its study, to a controller in the form that another tool takes, or in QEMU
with the circuit of the study here (processor in the loop)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vsgdesign.artifacts import provenance, staged_folder, write_record
from vsgdesign.artifacts.ready import Ready
from vsgdesign.artifacts.time_series import write_table
from vsgdesign.execution.executors import Progress
from vsgdesign.export.processor import ProcessorRun, processor_in_the_loop
from vsgdesign.export.unit import OnLine, Unit, unit_of
from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vsgdesign.artifacts.gain_table import GainTable


def unit_of_study(
    study: Study,
    controller: str | None = None,
    *,
    table: GainTable | None = None,
    rate: float | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> Unit:
    """A controller of a study, the last one if none is named, as every wrapper takes it.

    ``table`` takes the place of the controller's gain table; without it the table is read, taken from where an earlier
    command has left it, or designed once and kept below ``out``. ``rate`` is the largest rate of change of SCR and R/X
    of the schedule, 1/s. Of a plant of equal units it is one of them. Raises the errors of
    :func:`vsgdesign.export.unit.unit_of`, and InfeasibleStudyError for any other plant.
    """
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.study_tables import kept_tables

    plant, study = study.plant, as_unit(study, "export")
    spec = study.controller_named(controller)
    changes = {} if rate is None else {"rate": rate}
    if table is None and spec.kind == "scheduled" and spec.schedule == "table":
        alone = replace(study, controllers=(spec,))
        table = kept_tables(alone, progress=progress, say=say).tables[spec.name]
    ready = Ready(tables={} if table is None else {spec.name: table})
    found = unit_of(study, spec.name, ready, **changes)
    if plant is None:
        return found
    return replace(found, on_line=OnLine(plant.least or len(plant.units), len(plant.units)))


def unit_of_files(
    study: Study,
    table_file: str | Path | None,
    controller: str | None = None,
    *,
    rate: float | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> Unit:
    """The same with the gain table of a file, which takes the place of that of the controller that has one."""
    from vsgdesign.verbs.pipeline.verify import with_table

    if table_file is not None:
        study, controller = with_table(study, table_file, controller)
    return unit_of_study(study, controller, rate=rate, progress=progress, say=say)


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
    own = study.with_limit_of(study.controller_named(unit.controller))

    def run() -> ProcessorRun:
        return processor_in_the_loop(unit, own, core=core, math=math, duration=duration, progress=progress)

    if out is None:
        return run()
    from vsgdesign.report.drawing.figures import write_all
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
