"""Margins of a study's controllers over its grids, with the maps of the stability report."""

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
    import pandas as pd
    import xarray as xr

    from vsgdesign.linear.stability.maps import MarginMap
    from vsgdesign.report.drawing.figure_types import NamedFigure
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
        from vsgdesign.verbs.facade.frames import frame_of

        name, field = self._map(controller, kind)
        about = {"controller": name, "kind": kind, "scr_basis": self.result.study.scr_basis}
        return frame_of(map_header(field), map_rows(field), **about)

    def dataset(self, controller: str | None = None, kind: MapKind = "reduced") -> xr.Dataset:
        """The same over ``scr``, ``x_over_r`` and ``P_Q``, the powers one after the other, which are variables P and Q.
        Stale schedules and wrong estimates have their axes in place of the powers. Needs the extra ``frames``."""
        from vsgdesign.verbs.facade.frames import dataset_of

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
