"""The clause matrix on paper: the same verdicts, values and figures as in a browser, condensed to one row a test."""

from __future__ import annotations

from textwrap import shorten

from vsgdesign.compliance.rows import FAIL, IMPOSSIBLE, INFORMATIONAL, VERDICTS
from vsgdesign.report.compliance.answer import ABOUT_STRIPS, counts_bar, strip
from vsgdesign.report.compliance.arranged import Arranged, Reason, SuiteRows, Tested
from vsgdesign.report.compliance.drawn import Drawn
from vsgdesign.report.compliance.figures import TestFigure
from vsgdesign.report.compliance.matrix import Matrix
from vsgdesign.report.compliance.verdicts import LOOKS
from vsgdesign.report.drawing.flow import DIM, Cells, Flow, Said
from vsgdesign.report.drawing.paper import MARGIN, text_width

MOST_FIGURES = 24
"""Figures of failing tests on paper."""

MOST_LETTERS = 160
"""Of a reason why a test fails. The arithmetic of what is impossible is never cut."""


def draw_strips(flow: Flow, arranged: Arranged) -> None:
    """The shares of the verdicts of each controller, and its strip."""
    flow.need(24.0 * len(arranged.controllers) + 12.0)
    for k, name in enumerate(arranged.controllers):
        flow.sheet.text(MARGIN, flow.y + 11.0, name, 7.0)
        flow.sheet.sketch(counts_bar(arranged.counts[k], name), MARGIN + 90.0, flow.y + 3.0, 0.8)
        flow.sheet.sketch(strip(arranged, k), MARGIN + 200.0, flow.y, (flow.room - 200.0) / 960.0)
        flow.y += 17.0
    flow.paragraph(f"Left: shares of the verdicts, what fails is hatched. Right: {ABOUT_STRIPS}", 6.6, DIM)


def draw_matrix(flow: Flow, matrix: Matrix) -> None:
    """The tests of every suite, then the figures of groups and of failing tests."""
    for suite in matrix.arranged.suites:
        _suite(flow, matrix.arranged, suite)
    _figures(flow, matrix.arranged, matrix.drawn)


def _suite(flow: Flow, arranged: Arranged, suite: SuiteRows) -> None:
    flow.heading(suite.title, 9.5, below=90.0)
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
    flow.new_sheet()
    flow.heading("Figures of the matrix", 9.5, below=150.0, listed=False)
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
