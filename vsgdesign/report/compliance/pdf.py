"""The clause matrix on paper: the same verdicts, values and figures as the page, condensed to one row a test."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from textwrap import shorten
from typing import Any

from vsgdesign import __version__
from vsgdesign.compliance.rows import FAIL, IMPOSSIBLE, INFORMATIONAL, PASS, VERDICTS
from vsgdesign.report.compliance.answer import MOST_FAILING, counts_answer, counts_bar, failing_tests, headline, strip
from vsgdesign.report.compliance.arranged import Arranged, Reason, SuiteRows, Tested
from vsgdesign.report.compliance.drawn import Drawn
from vsgdesign.report.compliance.figures import TestFigure
from vsgdesign.report.compliance.heat import LEGEND, maps_by_title
from vsgdesign.report.compliance.identity import identity_tables, sources_table, validity
from vsgdesign.report.compliance.verdicts import LOOKS
from vsgdesign.report.drawing.flow import DIM, LEADING, Cells, Flow, Said, alone
from vsgdesign.report.drawing.paper import MARGIN, save, text_width
from vsgdesign.report.page.blocks import MET, MISSED, Cell, plain_text

MOST_FIGURES = 24
"""Figures of failing tests on paper."""

_LEAST_MAP = 0.62
"""Points for each px of a map, at least: its numbers have 6 pt."""

MOST_LETTERS = 160
"""Of a reason why a test fails. The arithmetic of what is impossible is never cut."""


def write_pdf(path: Path, document: Mapping[str, Any], arranged: Arranged, drawn: Drawn) -> Path:
    """Write the PDF: answer, model, matrix, figures, maps and sources. ``drawn`` has the figures of the page."""
    flow = Flow()
    title = f"{document['study'].get('title') or document['study']['name']}: clause matrix"
    _answer(flow, title, arranged)
    _model(flow, document)
    flow.section = "clause matrix"
    flow.new_sheet()
    for suite in arranged.suites:
        _matrix(flow, arranged, suite)
    _figures(flow, arranged, drawn)
    _maps(flow, document, drawn)
    flow.section = "sources"
    flow.heading("Sources", below=60.0)
    sources = sources_table(arranged.sources)
    flow.table(
        flow.shares((4, 34, 12, 10, 40)),
        sources.head,
        alone([[[Said(plain_text(text))] for text in row] for row in sources.rows]),
    )
    study = document["study"]
    flow.number(title, f"Made by vsgdesign {__version__}. Study {study['name']}, SHA-256 {study['hash']}")
    return save(flow.sheets, path, title)


def _answer(flow: Flow, title: str, arranged: Arranged) -> None:
    flow.heading(title, 16.0)
    flow.headline([headline(arranged)])
    answer = counts_answer(arranged)
    rows: list[Cells] = [
        [[Said(row.name, bold=True)], *([_counted(cell), Said(cell.detail, DIM)] for cell in row.cells)]
        for row in answer.rows
    ]
    flow.table(
        flow.shares((34, *[66.0 / len(answer.head)] * len(answer.head))), (answer.subject, *answer.head), alone(rows)
    )
    meaning = "; ".join(f"{LOOKS[verdict].sign} {verdict}: {LOOKS[verdict].says}" for verdict in VERDICTS)
    flow.paragraph(meaning + ".", 6.6, DIM)
    flow.need(24.0 * len(arranged.controllers) + 12.0)
    for k, name in enumerate(arranged.controllers):
        flow.sheet.text(MARGIN, flow.y + 11.0, name, 7.0)
        flow.sheet.sketch(counts_bar(arranged.counts[k], name), MARGIN + 90.0, flow.y + 3.0, 0.8)
        flow.sheet.sketch(strip(arranged, k), MARGIN + 200.0, flow.y, (flow.room - 200.0) / 960.0)
        flow.y += 17.0
    flow.paragraph(
        "Left: shares of the verdicts, what fails is hatched. Right: every test in the order of the matrix. A stroke "
        "over the whole height fails, a high one passes or is impossible, a low one was not judged.",
        6.6,
        DIM,
    )
    failing = failing_tests(arranged)
    if failing:
        flow.heading(f"What fails: {len(failing)} tests" if len(failing) > 1 else "What fails: one test", 9.0)
        shown = failing[:MOST_FAILING]
        rows = [
            [
                [Said(f"✗ {one.test}", LOOKS[FAIL].colour, True)],
                [Said(one.network)],
                [Said(one.who or arranged.controllers[0])],
                [Said(one.why)],
            ]
            for one in shown
        ]
        flow.table(flow.shares((30, 12, 18, 40)), ("Test", "Grid, power", "Controllers", "Why"), alone(rows), most=2)
        if len(failing) > len(shown):
            flow.paragraph(f"{len(failing) - len(shown)} more tests fail; the matrix has all of them.")


def _counted(cell: Cell) -> Said:
    """Counts as on the page, in the colour of the verdict."""
    colour = {MET: LOOKS[PASS].colour, MISSED: LOOKS[FAIL].colour}.get(cell.mark, DIM)
    return Said(f"{cell.sign} {cell.words}", colour, cell.mark == MISSED)


def _model(flow: Flow, document: Mapping[str, Any]) -> None:
    flow.section = "the model that was tested"
    flow.new_sheet()
    flow.heading("The model that was tested")
    for table in identity_tables(document):
        flow.need(30.0 + LEADING * len(table.rows))
        flow.subtitle(table.title)
        rows = [[[Said(plain_text(text))] for text in row] for row in table.rows]
        flow.table(flow.shares((30, 70)), table.head, alone(rows))
    flow.heading("Limits of validity")
    for sentence in validity(document):
        flow.paragraph(sentence, sign="•")


def _matrix(flow: Flow, arranged: Arranged, suite: SuiteRows) -> None:
    flow.section = suite.title
    flow.heading(f"Clause matrix: {suite.title}", below=90.0)
    if suite.source:
        source = suite.source
        named = ", ".join(part for part in (source["document"], source["edition"]) if part)
        flow.paragraph(f"{named}; confidence: {source['confidence']}. {source.get('note', '')}", 6.6, DIM)
    if suite.about:
        flow.paragraph(suite.about)
    count = len(arranged.controllers)
    widths = (26, 20, *[max(45.0 / count, 11.0)] * count, 12)
    head = ("Test and network", "Asked", *arranged.controllers, "Source")
    blocks: list[list[Cells]] = []
    for group in suite.groups:
        said = ", ".join(
            f"{name}: {counts.words()}"
            for name, counts in zip(arranged.controllers, group.counts, strict=True)
            if counts.total
        )
        title: Cells = [[Said(group.name, bold=True)], [Said(said, DIM)]]
        of_tests = [_test_rows(arranged, test) for test in group.tests]
        blocks += [[title, *of_tests[0]], *of_tests[1:]]
    flow.table(flow.shares(widths), head, blocks)


def _test_rows(arranged: Arranged, test: Tested) -> list[Cells]:
    asked = [line for line in test.lines if any(v is not None and v.verdict != INFORMATIONAL for v in line.values)]
    shown = asked or list(test.lines)
    source = arranged.sources[test.reference - 1]
    cells: list[list[Said]] = [
        [Said(test.test, bold=True), Said(test.network, DIM)],
        [Said(line.label if line.asked == "not asked for" else f"{line.label}: {line.asked}") for line in shown]
        or [Said("–")],
    ]
    for k, row in enumerate(test.rows):
        if row is None:
            cells.append([Said("not run", DIM)])
            continue
        look = LOOKS[row["verdict"]]
        values = [value.words for line in shown if (value := line.values[k]) is not None]
        cells.append(
            [Said(f"{look.sign} {row['verdict']}", look.colour, row["verdict"] == FAIL), Said("; ".join(values))]
        )
    known = ", ".join(part for part in (source["edition"], source["confidence"]) if part)
    cells.append([Said(f"[{test.reference}] {known}", DIM)])
    rows: list[Cells] = [[[one for one in cell if one.text] or [Said("")] for cell in cells]]
    for verdict in VERDICTS:
        reasons = [reason for reason in test.reasons if reason.verdict == verdict]
        if reasons:
            said = "; ".join(f"{', '.join(one.controllers)}: {_short(one)}" for one in reasons)
            rows.append([[Said("")], [Said(f"{LOOKS[verdict].sign} {verdict}, {said}", LOOKS[verdict].colour)]])
    return rows


def _short(reason: Reason) -> str:
    whole = reason.verdict == IMPOSSIBLE
    return reason.text if whole else shorten(reason.text, MOST_LETTERS, placeholder=" …")


def _figures(flow: Flow, arranged: Arranged, drawn: Drawn) -> None:
    if not drawn.groups and not drawn.tests:
        return
    flow.section = "figures"
    flow.new_sheet()
    flow.heading("Figures", below=150.0)
    x = MARGIN
    for name, colour in zip(arranged.controllers, arranged.colours, strict=True):
        flow.sheet.line((x, flow.y + 8.0), (x + 20.0, flow.y + 8.0), colour, 1.6)
        flow.sheet.text(x + 24.0, flow.y + 10.5, name, 7.0)
        x += 44.0 + text_width(name, 7.0)
    flow.y += 16.0
    titles = {suite.name: suite.title for suite in arranged.suites}
    for (suite, _), figure in drawn.groups.items():
        flow.sketches(f"{titles[suite]}: {figure.title}", figure.caption, figure.plots, 3)
    figures: list[TestFigure] = list(drawn.tests.values())
    for figure in figures[:MOST_FIGURES]:
        flow.sketches(f"✗ {figure.title}", figure.caption, figure.plots, 3)
    left = len(figures) - MOST_FIGURES + drawn.beyond
    if left > 0:
        flow.paragraph(f"{left} more failing tests have their figures or CSV files beside this document.")


def _maps(flow: Flow, document: Mapping[str, Any], drawn: Drawn) -> None:
    """Maps of one kind side by side, one for each controller."""
    if not drawn.maps:
        return
    flow.section = "survival maps"
    flow.new_sheet()
    flow.heading("Survival maps", below=200.0)
    flow.paragraph(LEGEND, colour=DIM)
    for title, words, sketches in maps_by_title(document, drawn.maps):
        flow.sketches(title, words, sketches, int(flow.room / (_LEAST_MAP * sketches[0].width)))
