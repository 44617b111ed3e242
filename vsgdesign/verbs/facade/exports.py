"""Functions that write a controller of a study in the form that another tool takes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable
    from vsgdesign.export import Exported, Unit
    from vsgdesign.verbs.facade.tables import DesignedTable

Variant = Literal["controller", "reference"]
"""The whole controller, with the bridge voltage as output, or its power loops alone, with V, θ and ω."""


def unit_given(study: Study, controller: str | None, table: DesignedTable | GainTable | None) -> Unit:
    """The controller that the arguments of a function of this room name."""
    from vsgdesign.verbs.facade.tables import DesignedTable
    from vsgdesign.verbs.pipeline.export import unit_of_study

    given = table.table if isinstance(table, DesignedTable) else table
    return unit_of_study(study, controller, table=given)


def export_fmu(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
    variant: Variant = "controller",
    fmi: Literal["3", "2"] = "3",
) -> Exported:
    """Writes a controller of a study, the last one if none is named, as NAME.fmu into the folder ``out``.

    ``table`` takes the place of the controller's gain table. ``fmi`` is the version of the standard. Raises
    ArtifactError for a folder with other files, and the errors of :func:`vsgdesign.export.unit_of`.
    """
    from vsgdesign.export import export_fmu as write

    return write(unit_given(study, controller, table), out, variant=variant, version=fmi, inputs=study.input_files)


def export_dll(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
    variant: Variant = "controller",
) -> Exported:
    """Writes a controller of a study as a library with the IEEE/CIGRE interface (TB 958) into the folder ``out``.

    The arguments and the errors are those of :func:`export_fmu`.
    """
    from vsgdesign.export import export_dll as write

    return write(unit_given(study, controller, table), out, variant=variant, inputs=study.input_files)


def export_simulink(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
    variant: Variant = "controller",
) -> Exported:
    """Writes a controller of a study for MATLAB, Simulink and Octave into the folder ``out``.

    The arguments and the errors are those of :func:`export_fmu`.
    """
    from vsgdesign.export import export_simulink as write

    return write(unit_given(study, controller, table), out, variant=variant, inputs=study.input_files)


def export_plecs(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
    variant: Variant = "controller",
) -> Exported:
    """Writes a controller of a study for PLECS into the folder ``out``.

    The arguments and the errors are those of :func:`export_fmu`.
    """
    from vsgdesign.export import export_plecs as write

    return write(unit_given(study, controller, table), out, variant=variant, inputs=study.input_files)


def export_modelica(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
    variant: Variant = "controller",
) -> Exported:
    """Writes a controller of a study for Modelica into the folder ``out``.

    The arguments and the errors are those of :func:`export_fmu`.
    """
    from vsgdesign.export import export_modelica as write

    return write(unit_given(study, controller, table), out, variant=variant, inputs=study.input_files)


def export_firmware(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
) -> Exported:
    """Writes a controller of a study as a bare-metal project for Cortex-M4F and M7 into the folder ``out``.

    The arguments and the errors are those of :func:`export_fmu`.
    """
    from vsgdesign.export import export_firmware as write

    return write(unit_given(study, controller, table), out, inputs=study.input_files)


def export_sunspec(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
) -> Exported:
    """Writes the values of a controller of a study as a map to SunSpec's models into the folder ``out``.

    The arguments and the errors are those of :func:`export_fmu`.
    """
    from vsgdesign.export import export_sunspec as write

    return write(unit_given(study, controller, table), out, inputs=study.input_files)


def export_all(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
) -> Exported:
    """Writes a controller of a study in every form, each in a folder of its own below ``out``.

    The arguments and the errors are those of :func:`export_fmu`.
    """
    from vsgdesign.export import export_all as write

    return write(unit_given(study, controller, table), out, inputs=study.input_files)
