"""From a study, or a gain table and its study, to a controller in the form that another tool takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vsgdesign.artifacts.ready import Ready
from vsgdesign.execution.progress import Progress
from vsgdesign.export.unit import OnLine, Unit, controller_named, unit_of
from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:
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
    spec = controller_named(study, controller)
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
