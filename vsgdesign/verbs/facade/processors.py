"""A controller of a study in QEMU, with the circuit of the study: processor in the loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from vsgdesign.artifacts.files import plain
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.given import given_study
from vsgdesign.verbs.facade.shown import Shown

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable
    from vsgdesign.export.processor import ProcessorRun
    from vsgdesign.report.drawing.figure_types import NamedFigure
    from vsgdesign.verbs.facade.tables import DesignedTable


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
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.pil import run_processor

    given = given_study(study, "pil")
    unit = unit_given(given, controller, table)
    alone = as_unit(given, "pil")
    return ProcessorResult(run_processor(unit, alone, core=core, math=math, duration=duration, progress=progress))
