"""The sizes of the dc side, as the verb size finds them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.given import given_study
from vsgdesign.verbs.facade.shown import Shown

if TYPE_CHECKING:
    from vsgdesign.report.drawing.figure_types import NamedFigure


@dataclass(frozen=True)
class DcSide(Shown):
    """The result of :func:`size`. It is true where the full simulation confirms the sizes."""

    document: dict[str, Any]
    """The content of results.json."""
    folder: Path

    @property
    def title(self) -> str:
        """The study's title."""
        return f"The dc side: {self.document['title']}"

    def __bool__(self) -> bool:
        return bool(self.document["trials"][0]["survived"])

    def sentences(self) -> Sequence[str]:
        """The sizes, as on the page."""
        from vsgdesign.report.sizing import sizing_sentences

        return sizing_sentences(self.document)

    def to_dict(self) -> dict[str, Any]:
        """The content of results.json."""
        return self.document

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.sizing import sizing_figure

        yield sizing_figure(self.document)


def size(
    study: Study | str | Path,
    out: str | Path | None = None,
    *,
    controller: str | None = None,
    capacitor: float | None = None,
    source: str | None = None,
    keep: Mapping[str, float] | None = None,
    suites: Sequence[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> DcSide:
    """Finds the power, capacitor and energy that the dc side of a controller needs, as ``vsgdesign size`` does.

    The folder ``out`` (None: out/NAME-dc-side) gets the page and results.json. ``controller``: its name (None: the last
    one). ``capacitor``: the one with which the least power is found, F. ``source``: "converter" or "battery" (None:
    that of [dc], else "converter"). ``keep``: sizes that are given, such as {"power": 9e3}, also "capacitor" (F) and
    "energy" (J). ``suites``: names or files of
    grid-code tests in place of the study's events. Raises the errors of
    :func:`vsgdesign.verbs.pipeline.sizing.size_study`.
    """
    from vsgdesign.verbs.pipeline.one_unit import alone
    from vsgdesign.verbs.pipeline.sizing import WORK, size_study

    study = alone(given_study(study, "size"), "size")
    folder = Path("out") / f"{study.name}-{WORK}" if out is None else Path(out)
    document = size_study(
        study, folder, controller=controller, C=capacitor, source=source, keep=keep, suites=suites, progress=progress
    )
    return DcSide(document, folder)
