"""What is known of a study before a simulation: its file, the grid at a bus of a network, its power flow and gains, and
its inner loops."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.files import plain
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.shown import Shown, frame_of, given_study

if TYPE_CHECKING:
    import pandas as pd

    from vsgdesign.design.study_design import StudyDesign
    from vsgdesign.report.drawing.figures import NamedFigure
    from vsgdesign.study.datasheet import Datasheet
    from vsgdesign.verbs.pipeline.grid import GridOfNetwork
    from vsgdesign.verbs.pipeline.inner import InnerAssessment


@dataclass(frozen=True)
class NewStudy(Shown):
    """The result of :func:`new`: the study's ``file``, and what was read and assumed."""

    file: Path
    datasheet: Datasheet

    @property
    def title(self) -> str:
        """The converter's title."""
        return self.datasheet.title

    def sentences(self) -> Sequence[str]:
        """What ``vsgdesign new`` prints."""
        from vsgdesign.verbs.pipeline.inputs import new_lines

        return new_lines(self.datasheet, self.file)

    def to_dict(self) -> dict[str, Any]:
        """What ``vsgdesign new --json`` prints."""
        from vsgdesign.verbs.pipeline.inputs import new_document

        return plain(new_document(self.datasheet, self.file))


def new(sheet: str | Path, out: str | Path = "study.toml", *, impedance: str | Path | None = None) -> NewStudy:
    """Writes the study of a datasheet (.csv or .toml). ``impedance``: the CSV file of the grid's impedance as it was
    measured over frequency. An existing file is left unchanged and raises ArtifactError; faults of the files raise
    StudyError."""
    from vsgdesign.verbs.pipeline.inputs import new_study

    return NewStudy(Path(out), new_study(sheet, out, impedance))


def validate(study_file: str | Path, *, deep: bool = False, out: str | Path | None = None) -> list[str]:
    """Checks a study and its files, and returns sentences: on its inner loops and, with ``deep``, what a run into the
    folder ``out`` would warn of. Raises StudyError with every fault, as ``vsgdesign validate`` prints them."""
    from vsgdesign.verbs.pipeline.checking import check_file

    _, inner_loops, said = check_file(study_file, deep, out)
    return [*([inner_loops] if inner_loops else []), *said]


@dataclass(frozen=True)
class Design(Shown):
    """The result of :func:`design_study`. ``found`` has the power flow and the gains as arrays."""

    found: StudyDesign

    @property
    def title(self) -> str:
        """The study's title."""
        return f"Design: {self.found.study.title}"

    def sentences(self) -> Sequence[str]:
        """Where each controller rests within its limits, and which gain table is missing."""
        from vsgdesign.report.stability.design import flow_headline

        return [*map(flow_headline, self.found.flows), *self.found.missing]

    def to_dict(self) -> dict[str, Any]:
        """What ``vsgdesign design --json`` prints."""
        return plain(self.found.document())

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.stability.design import flow_figures

        yield from flow_figures(self.found.study, self.found.flows)


def design_study(study: Study | str | Path, out: str | Path | None = None) -> Design:
    """Power flow, gains, margins, inertia and droop of a study's controllers, as ``vsgdesign design`` shows them.

    With ``out`` the folder of the verb is written, too. Raises InfeasibleStudyError and ArtifactError.
    """
    from vsgdesign.verbs.pipeline.margins import designed, report_design
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.study_tables import with_left_tables

    study = with_left_tables(as_unit(given_study(study, "design_study"), "design_study"))
    return Design(designed(study) if out is None else report_design(study, out))


@dataclass(frozen=True)
class InnerLoops(Shown):
    """The result of :func:`inner`. It is true where every requirement is kept on every grid."""

    assessment: InnerAssessment

    @property
    def title(self) -> str:
        """The study's title."""
        return f"Inner loops: {self.assessment.study.title}"

    def __bool__(self) -> bool:
        return self.assessment.kept

    def sentences(self) -> Sequence[str]:
        """The answer, what limits, and what would help, as on the page."""
        from vsgdesign.report.stability.inner import explanation, headline, what_for

        document = self.to_dict()
        return [headline(document), what_for(document), *explanation(document)]

    def to_dict(self) -> dict[str, Any]:
        """What ``vsgdesign inner --json`` prints."""
        from vsgdesign.verbs.pipeline.inner import inner_document

        return plain(inner_document(self.assessment))

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.stability.inner import inner_figures

        yield from inner_figures(self.assessment.score)


def inner(
    study: Study | str | Path,
    out: str | Path | None = None,
    *,
    what_if: bool = True,
    remedies: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> InnerLoops:
    """What the inner loops of a study keep, and what limits them, as ``vsgdesign inner`` shows it.

    With ``out`` the folder of the verb is written, too. ``what_if``: whether what sampling, delay and L_2 would improve
    is computed; ``remedies``: whether the inner loops of other hardware are designed fully. Raises ArtifactError.
    """
    from vsgdesign.verbs.pipeline.inner import assess_inner_loops, report_inner_loops
    from vsgdesign.verbs.pipeline.one_unit import as_one_converter

    study = as_one_converter(given_study(study, "inner"))
    if out is None:
        return InnerLoops(assess_inner_loops(study, what_if=what_if, remedies=remedies, progress=progress))
    return InnerLoops(report_inner_loops(study, out, what_if=what_if, remedies=remedies, progress=progress))


Quantity = float | str
"""A number in SI, or a text with a unit."""


@dataclass(frozen=True)
class NetworkGrid(Shown):
    """The result of :func:`grid_of_network`. ``found`` has every case with its impedance."""

    found: GridOfNetwork

    @property
    def title(self) -> str:
        """The bus and its network."""
        return f"Grid at {self.found.bus} of {self.found.network.file}"

    @property
    def scr(self) -> tuple[float, float]:
        """The smallest and the largest SCR, on the impedance."""
        return self.found.scr

    @property
    def x_over_r(self) -> tuple[float, float]:
        """The smallest and the largest X/R."""
        return self.found.x_over_r

    def sections(self) -> dict[str, Any]:
        """The sections ``grid`` and ``specification`` of a study: ``study.with_changes(**found.sections())``."""
        import tomllib

        from vsgdesign.verbs.pipeline.grid import grid_study_text

        return tomllib.loads(grid_study_text(self.found))

    def sentences(self) -> Sequence[str]:
        """The answer, as on the page of ``vsgdesign grid``."""
        from vsgdesign.report.network import grid_sentences

        return grid_sentences(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """What ``vsgdesign grid --json`` prints."""
        from vsgdesign.verbs.pipeline.grid import grid_document

        return grid_document(self.found)

    def frame(self) -> pd.DataFrame:
        """One row for each case; units are in its ``attrs``. Needs the extra ``frames``."""
        keys = ("name", "R", "X", "S_sc", "scr", "x_over_r")
        header = ("case", "R [ohm]", "X [ohm]", "S_sc [VA]", "SCR", "X/R")
        rows = [[one[key] for key in keys] for one in self.to_dict()["cases"]]
        return frame_of(header, rows, bus=self.found.bus, S=self.found.asked.S)

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.network import grid_figures

        yield from grid_figures(self.to_dict())


def grid_of_network(
    network: str | Path,
    bus: str,
    S: Quantity,
    *,
    outages: str | Path = "n-1",
    source: tuple[Quantity, Quantity] | None = None,
    machine: tuple[float, float] | None = None,
    sources: Mapping[str, tuple[Quantity, Quantity] | None] | None = None,
    loads: bool = False,
    frequency: Quantity | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> NetworkGrid:
    """SCR and X/R at a bus of a network file for a converter of ``S`` VA, with everything in and in every outage.

    ``network`` is a file of pandapower (.json), or one that pypowsybl reads. ``outages``: "n-1", "none" or a file.
    ``source``: short-circuit power and X/R behind each slack bus; ``machine``: sub-transient reactance in pu of its
    rating and X/R of each machine of which the file has none; ``sources``: short-circuit power and X/R by name, None
    takes a source out. ``loads``: whether loads count as impedances. Nothing is written. Needs the extra ``networks``.
    Raises StudyError, which names each source that the file does not describe, and InfeasibleStudyError.
    """
    from vsgdesign.verbs.pipeline.grid import grid_of_network as found
    from vsgdesign.verbs.pipeline.inputs import asked_of

    none = None, None
    asked = asked_of(
        bus=bus,
        S=S,
        outages=str(outages),
        source=source or none,
        machine=machine or none,
        named=sources,
        loads=loads,
        frequency=frequency,
    )
    return NetworkGrid(found(network, asked, progress=progress))
