"""Margins of a study's controllers over its grids, with the maps of the stability report, and its
linear model as a system of python-control."""

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

    from vsgdesign.linear.stability.maps import MarginMap
    from vsgdesign.report.drawing.figures import NamedFigure
    from vsgdesign.simulation.stability_result import StabilityResult


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
    from vsgdesign.linear.stability.cells import cells_under, full_order_cells, reduced_cells
    from vsgdesign.linear.stability.systems import PARTS, system_of
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
