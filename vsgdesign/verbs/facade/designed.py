"""What is known of a study before a simulation: its file, the grid at a bus of a network, its power flow and gains, its
inner loops, and its margins and linear model over its grids.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from vsgdesign.artifacts.files import plain
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.shown import Shown, dataset_of, frame_of, given_study, known_word

if TYPE_CHECKING:
    import control
    import pandas as pd
    import xarray as xr

    from vsgdesign.design.study_design import StudyDesign
    from vsgdesign.linear.stability.maps import MarginMap
    from vsgdesign.report.drawing.figures import NamedFigure
    from vsgdesign.simulation.stability_result import StabilityResult
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
    from vsgdesign.verbs.pipeline.inputs import check_file

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


MapKind = Literal["reduced", "full_order", "stale", "estimate_error"]


@dataclass(frozen=True)
class Margins(Shown):
    """Modes and margins of every controller on every grid. ``result`` holds the maps as arrays."""

    result: StabilityResult

    @property
    def title(self) -> str:
        """The study's title."""
        return f"Margins: {self.result.study.title}"

    def sentences(self) -> Sequence[str]:
        """The verdict of the stability report, with one paragraph for each controller."""
        from vsgdesign.report.stability.verdict import verdict_text

        return verdict_text(self.result)

    def to_dict(self) -> dict[str, Any]:
        """The content of results.json of the stability report."""
        from vsgdesign.verbs.pipeline.margins import stability_document

        return plain(stability_document(self.result))

    def frame(self, controller: str | None = None, kind: MapKind = "reduced") -> pd.DataFrame:
        """One row for each cell of a map of a controller (the first one, if none is named), as the CSV file of the
        map has them. Units are in its ``attrs``. Raises KeyError for a map that is not there. Needs the extra
        ``frames``."""
        from vsgdesign.linear.stability.assessment import map_header, map_rows

        name, field = self._map(controller, kind)
        about = {"controller": name, "kind": kind, "scr_basis": self.result.study.scr_basis}
        return frame_of(map_header(field), map_rows(field), **about)

    def dataset(self, controller: str | None = None, kind: MapKind = "reduced") -> xr.Dataset:
        """The same over ``scr``, ``x_over_r`` and ``P_Q``, the powers one after the other, which are variables P and Q.
        Stale schedules and wrong estimates have their axes in place of the powers. Needs the extra ``frames``."""
        _, field = self._map(controller, kind)
        return dataset_of(self.frame(controller, kind), dict(field.axes))

    def _map(self, controller: str | None, kind: str) -> tuple[str, MarginMap]:
        from vsgdesign.simulation.stability_result import maps_of

        known = {one.spec.name: maps_of(one) for one in self.result.assessments}
        name = next(iter(known)) if controller is None else controller
        for what, given, names in (("controller", name, known), ("map", kind, known.get(name, {}))):
            if given not in names:
                raise KeyError(f"no {what} is called {given!r}. There are: {', '.join(names)}.")
        return name, known[name][kind]

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.stability.page import stability_figures

        yield from stability_figures(self.result)


def margins(
    study: Study | str | Path, *, evidence: bool = False, progress: Callable[[str, float], None] | None = None
) -> Margins:
    """Computes modes and margins over the study's stability axes.

    With ``evidence`` it also simulates small steps in EMT, which takes longer. Of a plant of equal units the modes
    of the units against each other are added. Gain tables that the study asks for are
    read, taken from below ``out`` where an earlier command has left them, or designed first. Raises the errors of
    :func:`vsgdesign.verbs.pipeline.margins.assess_study`.
    """
    from vsgdesign.verbs.pipeline.margins import assess_study
    from vsgdesign.verbs.pipeline.one_unit import as_one_converter, as_unit
    from vsgdesign.verbs.pipeline.study_tables import with_left_tables

    study = given_study(study, "margins")
    unit, several = as_unit(study, "margins"), as_one_converter(study).plant is not None
    return Margins(assess_study(with_left_tables(unit), evidence=evidence, several=several, progress=progress))


_MODELS = ("reduced", "full")


def linear_model(
    study: Study | str | Path,
    controller: str | None = None,
    *,
    grid: Grid | Mapping[str, Any] | None = None,
    model: Literal["reduced", "full"] = "reduced",
    part: Literal["closed", "loop", "plant", "controller"] = "closed",
    P: float | str | None = None,
    Q: float | str | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> control.StateSpace:
    """The linear model of a controller (the last one, if none is named) at rest on a grid, for python-control.

    ``model="reduced"`` is continuous, with ideal inner loops; ``"full"`` is discrete, one step in a sampling period,
    with filter, inner loops and delay. ``part``: the closed loop; the loop broken at the measured powers, for negative
    feedback (``control.disk_margins``, ``control.nyquist_plot``); the plant from the commanded angle and voltage to the
    powers; or the power loops from the powers to angle and voltage, with their sign, so that loop = −plant·controller.
    Quantities are in SI, voltages are phase rms, and states, inputs and outputs have names.

    ``grid`` is ``vd.grid(...)`` or a Grid; None is that of the study. A controller with fixed gains keeps those of the
    study, a scheduled one has those for the grid. ``P`` and ``Q`` are the powers at rest in W and var, or texts with a
    unit; None stands for P_ref and Q_ref of the study. A gain table that no file and no earlier command has is designed
    once and kept below ``out``. Raises StudyError for a name or a grid that cannot be,
    and InfeasibleStudyError where there is no rest, there are no gains, or the study is of a plant that is more than
    equal units.
    """
    from vsgdesign.linear.stability.loops import PARTS, system_of
    from vsgdesign.linear.stability.maps import cells_under, full_order_cells, reduced_cells
    from vsgdesign.runtime.of_study import gain_law
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.study_tables import kept_tables

    known_word("model", model, _MODELS)
    known_word("part", part, PARTS)
    study = given_study(study, "linear_model")
    own = as_unit(study, "linear_model")
    spec = own.controller_named(controller)
    ready = kept_tables(replace(own, controllers=(spec,)), progress=progress).ready
    law = gain_law(own, spec, ready)
    changes: dict[str, Any] = {} if grid is None or isinstance(grid, Grid) else {"grid": grid}
    if powers := {name: value for name, value in (("P_ref", P), ("Q_ref", Q)) if value is not None}:
        changes["simulation"] = powers
    if changes:
        there = as_unit(study.with_changes(**changes), "linear_model")
        own = replace(own, grid=there.grid, grid_source=there.grid_source, simulation=there.simulation)
    own = replace(own, grid=grid if isinstance(grid, Grid) else own.grid).with_limit_of(spec)
    rest = own.simulation.P_ref, own.simulation.Q_ref
    cells = cells_under(own, law, own.grid.R_g, own.grid.L_g, *rest)
    if cells.faults[0] is None and model == "reduced":
        return system_of(reduced_cells(own, cells), part)
    fault = cells.faults[0]
    if fault is None:
        full = full_order_cells(own, cells)
        fault = full.faults[0]
        if fault is None:
            return system_of(full, part)
    place = own.grid.place(own.converter, own.scr_basis)
    raise InfeasibleStudyError(f"{spec.name} on SCR {place.scr:.3g}, X/R {place.x_over_r:.3g}: {fault.rstrip('.')}.")
