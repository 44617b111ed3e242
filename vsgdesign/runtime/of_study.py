"""The schedule of a study's controller: from its gain table where it has one, else in closed form."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from vsgdesign.artifacts.study_table import table_of
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.runtime.closed_form import closed_form_schedule
from vsgdesign.runtime.schedule import Schedule
from vsgdesign.runtime.table import table_schedule

if TYPE_CHECKING:  # reading study files is no part of what ships
    from vsgdesign.parameters.study import ControllerSpec, Study


def schedule_of(study: Study, spec: ControllerSpec, P: float | None = None, Q: float | None = None) -> Schedule:
    """The schedule; P and Q replace the design point. A table that the controller names as a file is read.

    Raises InfeasibleStudyError for a table that is not there yet, ArtifactError for a file that is no table of this
    converter.
    """
    if spec.schedule != "table":
        return closed_form_schedule(study, spec.target, P, Q)
    table = table_of(study, spec)
    if table is None:
        raise InfeasibleStudyError(
            f"controller {spec.name}: its gain table is not there. vsgdesign run builds it; vsgdesign table build "
            'keeps it, and table = "FILE.json" in the study uses it.'
        )
    schedule = table_schedule(table)
    return replace(schedule, P=schedule.P if P is None else P, Q=schedule.Q if Q is None else Q)
