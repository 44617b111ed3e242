"""The page of a comparison: one HTML file, nothing fetched."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vsgdesign.design.comparison import Comparison
from vsgdesign.report.comparison.answer import comparison_answer, comparison_headline
from vsgdesign.report.comparison.tables import (
    promises_table,
    services_table,
    specification_table,
    tunings_table,
    verdicts,
)
from vsgdesign.report.figure_types import WrittenFigure
from vsgdesign.report.page.html import write_html


def write_comparison_page(comparison: Comparison, figures: Sequence[WrittenFigure], out_path: Path) -> Path:
    """Write the page, with the SVG text of the figures as it is in the files."""
    return write_html(
        out_path,
        "comparison.html.j2",
        figures,
        study=comparison.study,
        largest=figures[0].name if figures else "",
        headline=comparison_headline(comparison),
        summary=comparison_answer(comparison),
        verdicts=verdicts(comparison),
        specification=specification_table(comparison),
        promises=promises_table(comparison),
        services=services_table(comparison),
        tunings=tunings_table(comparison),
    )
