"""The page of a comparison: one HTML file, nothing fetched."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vsgdesign import __version__
from vsgdesign.design.comparison import Comparison
from vsgdesign.report.comparison_tables import (
    promises_table,
    services_table,
    specification_table,
    tunings_table,
    verdicts,
)
from vsgdesign.report.figure_types import WrittenFigure
from vsgdesign.report.page import environment, inline_svg


def write_comparison_page(comparison: Comparison, figures: Sequence[WrittenFigure], out_path: Path) -> Path:
    """Write the page, with the figures' SVG text as it lies on disk."""
    text = (
        environment()
        .get_template("comparison.html.j2")
        .render(
            study=comparison.study,
            version=__version__,
            verdicts=verdicts(comparison),
            specification=specification_table(comparison),
            promises=promises_table(comparison),
            services=services_table(comparison),
            tunings=tunings_table(comparison),
            figures=[(f, inline_svg(f.svg.read_text(encoding="utf-8"), f.name, f.title)) for f in figures],
        )
    )
    out_path.write_text(text, encoding="utf-8", newline="\n")
    return out_path
