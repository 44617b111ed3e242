"""The page of a compliance result: one HTML file, nothing fetched; links lead to the files beside it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from vsgdesign import __version__
from vsgdesign.compliance.evidence import MOST_FIGURES, figure_path
from vsgdesign.compliance.rows import FAIL, VERDICTS
from vsgdesign.report.compliance.answer import MOST_FAILING, counts_answer, failing_tests, headline, strips
from vsgdesign.report.compliance.arranged import Arranged, Group, arrange
from vsgdesign.report.compliance.drawn import Drawn, draw
from vsgdesign.report.compliance.figures import TestFigure, Traces, dashes_of
from vsgdesign.report.compliance.heat import LEGEND, maps_by_title
from vsgdesign.report.compliance.identity import identity_tables, sources_table, validity
from vsgdesign.report.compliance.verdicts import LOOKS
from vsgdesign.report.drawing.sketch import Sketch, svg, svg_file
from vsgdesign.report.page.html import environment

PAGE, PDF = "report.html", "report.pdf"

MOST_OPEN = 30
"""A group with more tests is closed at first, also if one of them fails."""


def write_page(folder: str | Path, document: Mapping[str, Any], traces: Traces) -> list[Path]:
    """Write ``report.html``, ``report.pdf`` and ``figures/`` into a folder (made if missing).

    ``document`` is results.json of the verb ``comply``, ``traces`` has the evidence by the field ``csv`` of the rows,
    and may read it when asked. Returns every file that was written.
    """
    from vsgdesign.report.compliance.pdf import write_pdf

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    arranged = arrange(document)
    drawn = draw(arranged, document, traces)
    files = _write_figures(folder, arranged, drawn)
    text = _html(document, arranged, drawn)
    (folder / PAGE).write_text(text, encoding="utf-8", newline="\n")
    return [*files, folder / PAGE, write_pdf(folder / PDF, document, arranged, drawn)]


def _write_figures(folder: Path, arranged: Arranged, drawn: Drawn) -> list[Path]:
    files = []
    for test in arranged.tests():
        figure = drawn.tests.get(test.anchor)
        if figure is None:
            continue
        path = folder / figure_path(test.suite, test.test)
        path.parent.mkdir(exist_ok=True)
        path.write_text(svg_file(figure.plots, figure.title, (figure.caption,)), encoding="utf-8", newline="\n")
        files.append(path)
    return files


def _html(document: Mapping[str, Any], arranged: Arranged, drawn: Drawn) -> str:
    failing = failing_tests(arranged)
    return (
        environment()
        .get_template("compliance.html.j2")
        .render(
            document=document,
            arranged=arranged,
            title=document["study"].get("title") or document["study"]["name"],
            headline=headline(arranged),
            fails=bool(failing),
            answer=counts_answer(arranged),
            strips=strips(arranged),
            failing=failing[:MOST_FAILING],
            more=max(len(failing) - MOST_FAILING, 0),
            keys=_keys(arranged),
            looks=LOOKS,
            verdicts=VERDICTS,
            overlays={key: _placed(figure) for key, figure in drawn.groups.items()},
            drawn=drawn,
            figure_of=lambda test: figure_path(test.suite, test.test) if test.anchor in drawn.tests else "",
            command=lambda row: explore_command(document, row),
            repeat=lambda row: f"vsgdesign simulate {shlex.quote(row['study'])}" if row.get("study") else "",
            maps=[
                (title, words, [(svg(one, "heat"), 0.85 * one.width) for one in sketches])
                for title, words, sketches in maps_by_title(document, drawn.maps)
            ],
            legend=LEGEND,
            identity=identity_tables(document),
            validity=validity(document),
            sources=sources_table(arranged.sources),
            left_out=left_out(arranged, drawn),
            counts_of=lambda group: _counts_words(arranged, group),
            most_open=MOST_OPEN,
            version=__version__,
            FAIL=FAIL,
        )
    )


def _placed(figure: TestFigure) -> tuple[Markup, str]:
    return Markup("\n").join(svg(one, "plot") for one in figure.plots), figure.caption


def explore_command(document: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    """The command that opens the explorer at the grid of a row; empty where the row has no state."""
    if not row.get("explore"):
        return ""
    file = document["study"].get("file") or f"{document['study']['name']}.toml"
    return f"vsgdesign explore {shlex.quote(file)} --state {shlex.quote(row['explore'])}"


def left_out(arranged: Arranged, drawn: Drawn) -> list[str]:
    """Sentences about what is not on the page, and where it is."""
    said = []
    outside = len(drawn.tests) - len(drawn.inside)
    if outside:
        said.append(
            f"The figures of {outside} failing tests are files in figures/ beside this page, linked in the matrix."
        )
    if drawn.beyond:
        said.append(
            f"{drawn.beyond} failing tests have no figure, because at most {MOST_FIGURES} are drawn. Their CSV files "
            "have the same curves."
        )
    if drawn.missing:
        said.append(f"The traces of {drawn.missing} runs are missing, so their curves are not drawn.")
    thinned = sum(len(group.tests) for group in arranged.groups()) - len(drawn.tests)
    if thinned:
        said.append(
            "Tests that no controller fails have no figure of their own: each group has one figure with some of its "
            "tests. The CSV files have every curve of every test."
        )
    said.append("Curves are thinned to the resolution of the figures; their extremes are kept.")
    return said


def _keys(arranged: Arranged) -> list[tuple[str, Markup]]:
    """A sample of each controller's line."""
    found = []
    for k, (name, colour) in enumerate(zip(arranged.controllers, arranged.colours, strict=True)):
        sketch = Sketch(28.0, 8.0, f"line of {name}")
        sketch.line((0.0, 4.0), (28.0, 4.0), colour, 2.0, tuple(0.8 * length for length in dashes_of(k)))
        found.append((name, svg(sketch, "key")))
    return found


def _counts_words(arranged: Arranged, group: Group) -> list[tuple[str, list[tuple[str, int]]]]:
    """For each controller its name, and the verdicts that occur in a group with their numbers."""
    return [
        (name, [(verdict, counts.of[verdict]) for verdict in VERDICTS if counts.of[verdict]])
        for name, counts in zip(arranged.controllers, group.counts, strict=True)
    ]
