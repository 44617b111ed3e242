"""The page of a comparison: the answer, what each keeps, droop, inertia and EMT, and the fixed gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

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
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
    Block,
    Box,
    Heading,
    Page,
    Span,
    Where,
    drawings,
    opening,
    words,
)


def comparison_page(comparison: Comparison, figures: Sequence[WrittenFigure] = ()) -> Page:
    """The page of a comparison."""
    study = comparison.study
    blocks: list[Block] = [
        *opening(comparison_headline(comparison), [comparison_answer(comparison)], figures),
        words(f"{study.title}: {comparison_headline(comparison)}", style=HEADLINE, on=Where.TERMINAL),
        words(_asked(comparison), on=Where.TERMINAL),
        Heading("In words"),
        Box([words(*verdicts(comparison), style=BULLETS, on=Where.BOTH)]),
        Heading("What is asked", numbered=True),
        specification_table(comparison),
        Heading("What is kept", numbered=True),
        replace(promises_table(comparison), on=Where.BOTH),
        *drawings(figures[1:]),
        Heading("Droop, inertia, EMT", numbered=True),
        replace(services_table(comparison), on=Where.BOTH),
        *_fixed_gains(comparison),
        Heading("Limits of validity", numbered=True),
        words(
            "A grid counts as kept if the full-order model keeps every requirement, with real inner loops, delay and "
            "sampling, for small deviations. The worst values, and the columns for ideal inner loops, come from the "
            "coupled reduced model. The EMT simulation is decisive.",
            "The shares count grids on the axes of the comparison, which are spaced evenly in the logarithm. They are "
            "not probabilities.",
            style=BULLETS,
        ),
    ]
    origin = ("Study ", Span(study.name, code=True), ", SHA-256 ", Span(study.hash, code=True), ".")
    return Page(f"{study.title}: comparison", blocks, origin)


def _asked(comparison: Comparison) -> str:
    """What is asked, in one line."""
    rows = [f"{name} {value}" for name, value in specification_table(comparison).rows]
    return f"{len(comparison.contenders[0].grids)} grids, worst over powers. Asked: {'; '.join(rows[:-1])}"


def _fixed_gains(comparison: Comparison) -> list[Block]:
    tunings = tunings_table(comparison)
    if tunings is None:
        return []
    said = (
        "The best fixed gains are the result of a seeded search over the whole box. Its cost is the worst relative "
        "violation of any requirement. No rate on any grid may exceed the largest rate of a table."
    )
    return [Heading("Fixed gains", numbered=True), tunings, words(said)]
