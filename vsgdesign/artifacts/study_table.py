"""The gain table that a controller of a study names as a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vsgdesign.artifacts.gain_table import GainTable, base_differences, base_of
from vsgdesign.artifacts.gain_table_file import read_table_file
from vsgdesign.errors import ArtifactError

if TYPE_CHECKING:
    from vsgdesign.parameters.study import ControllerSpec, Study


def table_of(study: Study, spec: ControllerSpec) -> GainTable | None:
    """The controller's table: the one that it has, or that of its file; None where it names none.

    Raises ArtifactError for a file that is no table, or is for another converter, filter or grid voltage.
    """
    if spec.schedule != "table" or spec.table is not None or spec.table_file is None:
        return spec.table
    table = read_table_file(spec.table_file)
    differences = base_differences(table.base, base_of(study, table.base.scr_basis), "the study")
    if differences:
        raise ArtifactError(
            f'controller {spec.name}: "{spec.table_file}" is a table of study {table.study}, made for another '
            f"converter, filter or grid voltage ({'; '.join(differences)}). Build one for this study: vsgdesign table "
            "build."
        )
    return table
