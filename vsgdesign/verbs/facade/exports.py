"""Functions that write a controller of a study in the form that another tool takes, or run it in QEMU."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from vsgdesign.artifacts.files import plain
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.shown import Shown, given_study

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable
    from vsgdesign.export import Exported, Unit
    from vsgdesign.export.processor import ProcessorRun
    from vsgdesign.report.drawing.figures import NamedFigure
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


@dataclass(frozen=True)
class ProcessorResult(Shown):
    """A controller that ran in QEMU and on this machine. ``result`` holds both series and the instructions."""

    result: ProcessorRun

    @property
    def title(self) -> str:
        """The controller and its study."""
        return f"Processor in the loop: {self.result.unit.controller} of {self.result.study.title}"

    def sentences(self) -> Sequence[str]:
        """Whether both are equal to the bit, and the instructions of a sample."""
        from vsgdesign.report.processor import processor_sentences

        return processor_sentences(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The content of results.json of ``vsgdesign pil``."""
        found: dict[str, Any] = plain(self.result.document())
        return found

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.processor import processor_figures

        yield from processor_figures(self.result)


def pil(
    study: Study | str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
    core: Literal["m4", "m7"] = "m4",
    math: Literal["printed", "library"] = "printed",
    duration: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> ProcessorResult:
    """Runs the exported firmware of a controller, the last one if none is named, in QEMU with the circuit of its study.

    ``core`` is a Cortex-M4F or a Cortex-M7. ``math``: sine, cosine and angle as printed into the export, with which the
    bits are those of this machine, or those of each C library. ``duration`` (s) replaces that of the study. ``table``
    takes the place of the controller's gain table. Raises ArtifactError where QEMU or a compiler is missing, and the
    errors of :func:`vsgdesign.export.unit_of`.
    """
    from vsgdesign.verbs.facade.exports import unit_given
    from vsgdesign.verbs.pipeline.export import run_processor
    from vsgdesign.verbs.pipeline.one_unit import as_unit

    given = given_study(study, "pil")
    unit = unit_given(given, controller, table)
    alone = as_unit(given, "pil")
    return ProcessorResult(run_processor(unit, alone, core=core, math=math, duration=duration, progress=progress))
