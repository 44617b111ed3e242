"""The page of a verification: what a terminal prints of it, and one HTML file with links to the studies beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.verification_text import counted_of, headline, kept, promise_sentences
from vsgdesign.report.drawing.files import write_figure
from vsgdesign.report.figure_types import NamedFigure, WrittenFigure
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
    Block,
    Box,
    Heading,
    Page,
    Span,
    Table,
    Where,
    drawings,
    words,
)
from vsgdesign.report.page.html import print_html
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

SHOWN = 5
"""Worst cases that a terminal names. The page has all of them."""


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
    page = print_html(verification_page(document, figures), folder / "report.html")
    return [path for figure in figures for path in (figure.svg, figure.png)] + [page]


def verification_page(document: Mapping[str, Any], figures: Sequence[WrittenFigure] = ()) -> Page:
    """The page: the answer, the promises, the maps, the worst cases, and how all of this was found."""
    worst, draws = document["worst"], draws_table(document)
    left_out = Where.BOTH if document["judged"] < document["runs"] else Where.PAGE
    blocks: list[Block] = [
        words(
            (
                "Controller ",
                Span(document["controller"], code=True),
                ". Each case is a complete EMT simulation of converter, filter, controller and grid. Nothing in it is "
                "linearised.",
            )
        ),
        Box(
            (
                words(headline(document), style=HEADLINE, on=Where.BOTH),
                words(*promise_sentences(document), style=BULLETS, on=Where.BOTH),
            ),
            warning=not kept(document),
        ),
        Heading("Promises", numbered=True),
        replace(promises_table(document), on=Where.BOTH),
        *drawings(figures, 1),
        Heading("Over the grids", numbered=True),
        *drawings(figures, 2, otherwise="No case was judged, so there is no map."),
        Heading("The worst cases", numbered=True),
        *([_cases("The worst drawn cases", worst, document)] if worst else [words("No case was judged.")]),
        words(again_text(worst)),
        *_example(document),
        Heading("Found by searching: these do not count in the share", numbered=True),
        *_found(document),
        Heading("What was left out, and why", numbered=True),
        replace(left_out_table(document), on=left_out),
        words(
            "A case is left out before it is simulated if it asks for something that no controller could give: no "
            "steady state before or after the event, or a steady state beyond the limits. All shares are shares of "
            "the judged cases."
        ),
        Heading("How the cases were drawn", numbered=True),
        *([draws] if draws else []),
        words(
            f"Case k depends on the seed ({document['seed']}) and on k alone. It is the same with any number of "
            "workers, in any part of a divided run and after an interruption."
        ),
        Heading("Limits of validity", numbered=True),
        words(
            "A share is a share of the cases that were drawn as part 6 says. Another distribution of grids, powers or "
            "events has another share.",
            "The bound is exact for independent draws. It says nothing about one particular grid, and nothing about "
            "what was not drawn.",
            "The promises are kept by the simulated model. What the model leaves out, the page cannot know.",
            style=BULLETS,
        ),
        Heading("Cost", numbered=True),
        cost_table(document),
        words(_cost(document), on=Where.TERMINAL),
    ]
    origin = ("Study ", Span(document["study"], code=True), f", seed {document['seed']}.")
    return Page(f"{document['title']}: verification", blocks, origin)


def _cases(title: str, cases: Sequence[Mapping[str, Any]], document: Mapping[str, Any]) -> Table:
    return replace(cases_table(title, cases, document), on=Where.BOTH, most=SHOWN, left_out=frozenset({"Why"}))


def _example(document: Mapping[str, Any]) -> list[Block]:
    cases = document["worst"] or document["search"]["found"]
    if not cases:
        return []
    repeat = Span(f"vsgdesign simulate {cases[0]['study']}", code=True)
    said = "Each rank is a link to a study file. In the folder of this page, "
    return [words((said, repeat, " reproduces the first one."))]


def _found(document: Mapping[str, Any]) -> list[Block]:
    """What a search for bad cases found."""
    found, evaluations = document["search"]["found"], document["search"]["evaluations"]
    if not found:
        nothing = f"A search of {evaluations} further simulations found nothing worse than the drawn cases."
        return [words(nothing if evaluations else "No search was made.")]
    said = (
        f"A search looked for bad cases on purpose, in {evaluations} further simulations. It says how bad a case can "
        f"be, and nothing about how often it occurs. {again_text(found)}"
    )
    return [_cases("Found by searching: these do not count in the share", found, document), words(said.strip())]


def _cost(document: Mapping[str, Any]) -> str:
    """Runs, machine and seconds in one line."""
    count = document["workers"]
    seconds = ", ".join(f"{name.replace('_', ' ')} {value:.3g} s" for name, value in document["timing_s"].items())
    said = (
        f"{counted_of(document['runs'])} runs",
        f"seed {document['seed']}",
        document["instruction_set"] or "no runs",
    )
    return f"{', '.join(said)}, {count} {'worker' if count == 1 else 'workers'}: {seconds}"
