"""The grid at a bus of a network model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.verbs.facade.shown import Shown

if TYPE_CHECKING:
    import pandas as pd

    from vsgdesign.report.drawing.figure_types import NamedFigure
    from vsgdesign.verbs.pipeline.grid import GridOfNetwork

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
        from vsgdesign.verbs.facade.frames import frame_of

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
    from vsgdesign.verbs.pipeline.grid_asked import asked_of

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
