"""The page of a verification: one HTML file, nothing fetched; links lead to the study files beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.verification_text import headline, kept, promise_sentences
from vsgdesign.report.drawing.files import write_figure
from vsgdesign.report.figure_types import NamedFigure
from vsgdesign.report.page.html import write_html
from vsgdesign.report.verification.maps import map_figures
from vsgdesign.report.verification.promises import promises_figure
from vsgdesign.report.verification.tables import (
    again_text,
    cases_table,
    cost_table,
    draws_table,
    left_out_table,
    promises_table,
)


def verification_figures(document: Mapping[str, Any]) -> Iterator[NamedFigure]:
    """One at a time, in the order of the page."""
    promises = promises_figure(document)
    if promises is not None:
        yield promises
    yield from map_figures(document)


def write_verification_page(document: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write ``figures/`` and ``report.html`` into an existing folder; returns every file that was written."""
    (folder / "figures").mkdir(exist_ok=True)
    figures = [write_figure(figure, folder / "figures") for figure in verification_figures(document)]
    worst, found = document["worst"], document["search"]["found"]
    page = write_html(
        folder / "report.html",
        "verification.html.j2",
        figures,
        document=document,
        headline=headline(document),
        kept=kept(document),
        sentences=promise_sentences(document),
        promises=promises_table(document),
        worst=cases_table("The worst drawn cases", worst, document) if worst else None,
        found=cases_table("Found by searching", found, document) if found else None,
        again=[again_text(worst), again_text(found)],
        left_out=left_out_table(document),
        draws=draws_table(document),
        cost=cost_table(document),
        example=(worst or found or [{"study": None}])[0]["study"],
    )
    return [path for figure in figures for path in (figure.svg, figure.png)] + [page]
