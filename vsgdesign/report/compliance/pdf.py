"""The clause matrix on paper: the same verdicts, values and figures as the page, condensed to one row a test."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsgdesign import __version__
from vsgdesign.compliance.rows import FAIL, INFORMATIONAL, VERDICTS
from vsgdesign.report.compliance.answer import MOST_FAILING, counts_bar, failing_tests, headline, strip
from vsgdesign.report.compliance.arranged import Arranged, SuiteRows, Tested
from vsgdesign.report.compliance.figures import TestFigure
from vsgdesign.report.compliance.heat import LEGEND, maps_by_title
from vsgdesign.report.compliance.identity import identity_tables, sources_table, validity
from vsgdesign.report.compliance.verdicts import LOOKS, Counts
from vsgdesign.report.drawing.paper import HEIGHT, MARGIN, WIDTH, Sheet, save, text_width, wrapped
from vsgdesign.report.drawing.sketch import END, Sketch
from vsgdesign.report.quantities import typeset

MOST_FIGURES = 24
"""Figures of failing tests on paper."""

_LEAST_MAP = 0.62
"""Points for each px of a map, at least: its numbers have 6 pt."""

MOST_LINES = 6
"""Lines of a cell: a longer sentence is cut, and the JSON has it whole."""

_SIZE, _LEADING = 6.6, 8.4
_SCALE = 0.73
"""Points for each px of a sketch: three rows of figures fit on a sheet, and their words have 7 to 8 pt."""

_ROOM = WIDTH - 2.0 * MARGIN
_TOP, _BOTTOM = MARGIN + 14.0, HEIGHT - MARGIN - 6.0
_RULE, _HAIR, _DIM = "#1A1A1A", "#CFCFCF", "#444444"


@dataclass(frozen=True)
class Said:
    """A text of a cell with its colour."""

    text: str
    colour: str = "#1A1A1A"
    bold: bool = False


Cells = Sequence[Sequence[Said]]
"""The cells of a row: paragraphs of each."""


class Flow:
    """Puts blocks below each other, and begins a new sheet where there is no room."""

    def __init__(self) -> None:
        self.sheets: list[Sheet] = []
        self.sections: list[str] = []
        """What each sheet begins with, for its head line."""
        self.section = ""
        self.y = 0.0
        self.new_sheet()

    @property
    def sheet(self) -> Sheet:
        """The sheet that is being filled."""
        return self.sheets[-1]

    def new_sheet(self) -> None:
        """Begin a sheet."""
        self.sheets.append(Sheet())
        self.sections.append(self.section)
        self.y = _TOP

    def need(self, height: float) -> bool:
        """Begin a new sheet if so much does not fit; whether it did."""
        if self.y + height <= _BOTTOM:
            return False
        self.new_sheet()
        return True

    def heading(self, text: str, size: float = 11.0, below: float = 40.0) -> None:
        """A heading, with at least ``below`` pt of room for what follows."""
        self.need(size + 14.0 + below)
        self.y += size + 7.0
        self.sheet.text(MARGIN, self.y, typeset(text), size, bold=True)
        self.sheet.marks.append((typeset(text), self.y - 1.2 * size))
        self.y += 5.0

    def paragraph(self, text: str, size: float = 7.6, colour: str = "#1A1A1A", bullet: bool = False) -> None:
        """Text over the whole width."""
        indent = 9.0 if bullet else 0.0
        for k, line in enumerate(wrapped(typeset(text), size, _ROOM - indent)):
            self.need(1.35 * size)
            self.y += 1.35 * size
            if bullet and k == 0:
                self.sheet.text(MARGIN, self.y, "•", size, colour=colour)
            self.sheet.text(MARGIN + indent, self.y, line, size, colour=colour)
        self.y += 2.0

    def table(
        self, widths: Sequence[float], head: Sequence[str], rows: Sequence[Cells], most: int = MOST_LINES
    ) -> None:
        """A table whose head is repeated on every sheet. ``widths``: shares of the page's width."""
        total = sum(widths)
        columns = [_ROOM * width / total for width in widths]

        def draw_head() -> None:
            top = self.y
            lines = [wrapped(text, _SIZE, width - 6.0, bold=True) for text, width in zip(head, columns, strict=True)]
            self.sheet.line((MARGIN, top + 2.0), (MARGIN + _ROOM, top + 2.0), _RULE, 0.9)
            x = MARGIN
            for texts, width in zip(lines, columns, strict=True):
                for k, text in enumerate(texts):
                    self.sheet.text(x, top + 2.0 + _LEADING * (k + 1), text, _SIZE, bold=True)
                x += width
            self.y = top + 5.0 + _LEADING * max(len(texts) for texts in lines)
            self.sheet.line((MARGIN, self.y), (MARGIN + _ROOM, self.y), _RULE, 0.5)

        self.need(5.0 * _LEADING)
        draw_head()
        for cells in rows:
            self._row(columns, cells, draw_head, most)
        self.sheet.line((MARGIN, self.y), (MARGIN + _ROOM, self.y), _RULE, 0.9)
        self.y += 8.0

    def _row(self, columns: Sequence[float], cells: Cells, draw_head: Callable[[], None], most: int) -> None:
        set_out = [
            [(line, said) for said in cell for line in wrapped(typeset(said.text), _SIZE, room - 6.0, said.bold, most)]
            for cell, room in zip(cells, _spans(columns, len(cells)), strict=True)
        ]
        height = 3.0 + _LEADING * max(len(lines) for lines in set_out)
        if self.need(height):
            draw_head()
        x = MARGIN
        for lines, width in zip(set_out, _spans(columns, len(cells)), strict=True):
            for k, (line, said) in enumerate(lines):
                y = self.y + _LEADING * (k + 1)
                self.sheet.text(x, y, line, _SIZE, colour=said.colour, bold=said.bold)
            x += width
        self.y += height
        self.sheet.line((MARGIN, self.y), (MARGIN + _ROOM, self.y), _HAIR, 0.4)

    def sketches(self, title: str, caption: str, sketches: Sequence[Sketch], across: int) -> None:
        """Sketches side by side, so large that ``across`` of them fill the width, below a title."""
        size = 8.0
        lines = wrapped(typeset(caption), _SIZE, _ROOM, most=2) if caption else []
        for k in range(0, len(sketches), across):
            some = sketches[k : k + across]
            scale = min(_ROOM / across / max(one.width for one in some), _SCALE)
            height = scale * max(one.height for one in some)
            first = k == 0
            self.need(height + (size + 8.0 + _LEADING * len(lines) if first else 4.0))
            if first and title:
                self.y += size + 6.0
                self.sheet.text(MARGIN, self.y, typeset(title), size, bold=True)
            for line in lines if first else ():
                self.y += _LEADING
                self.sheet.text(MARGIN, self.y, line, _SIZE, colour=_DIM)
            self.y += 4.0
            for n, one in enumerate(some):
                self.sheet.sketch(one, MARGIN + n * _ROOM / across, self.y, scale)
            self.y += height


def _spans(columns: Sequence[float], count: int) -> list[float]:
    """Widths of a row's cells: the last cell of a shorter row takes the rest."""
    return [*columns[: count - 1], sum(columns[count - 1 :])]


def write_pdf(path: Path, document: Mapping[str, Any], arranged: Arranged, drawn: Any) -> Path:
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
    flow.table((4, 34, 12, 10, 40), sources.head, [[[Said(text)] for text in row] for row in sources.rows])
    _number(flow, title, document)
    return save(flow.sheets, path, title)


def _number(flow: Flow, title: str, document: Mapping[str, Any]) -> None:
    """Title, page numbers and the hash of the study on every sheet."""
    sheets = flow.sheets
    made = f"Made by vsgdesign {__version__}. Study {document['study']['name']}, SHA-256 {document['study']['hash']}"
    for k, (sheet, section) in enumerate(zip(sheets, flow.sections, strict=True), start=1):
        if k > 1:
            sheet.text(MARGIN, MARGIN, typeset(title), 7.0, colour=_DIM)
            sheet.text(WIDTH - MARGIN, MARGIN, typeset(section), 7.0, anchor=END, colour=_DIM)
        sheet.text(MARGIN, HEIGHT - MARGIN + 10.0, made, 6.0, colour=_DIM)
        sheet.text(WIDTH - MARGIN, HEIGHT - MARGIN + 10.0, f"page {k} of {len(sheets)}", 7.0, anchor=END)


def _answer(flow: Flow, title: str, arranged: Arranged) -> None:
    flow.heading(title, 16.0)
    for line in wrapped(typeset(headline(arranged)), 13.0, _ROOM, bold=True):
        flow.y += 18.0
        flow.sheet.text(MARGIN, flow.y, line, 13.0, bold=True)
    flow.y += 10.0
    rows: list[Cells] = []
    groups: list[tuple[str, Sequence[Counts]]] = [(suite.title, suite.counts) for suite in arranged.suites]
    if len(groups) > 1:
        groups.insert(0, ("All suites", arranged.counts))
    for name, counts in groups:
        for k, (controller, one) in enumerate(zip(arranged.controllers, counts, strict=True)):
            cells = [[Said(name if k == 0 else "", bold=True)], [Said(controller)]]
            for verdict in VERDICTS:
                count, shown = one.of[verdict], LOOKS[verdict]
                said = Said(f"{shown.sign} {count}", shown.colour, verdict == FAIL) if count else Said("0", "#777777")
                cells.append([said])
            rows.append(cells)
    flow.table((34, 20, 9, 9, 12, 12, 12), ("Suite", "Controller", *VERDICTS), rows)
    meaning = "; ".join(f"{LOOKS[verdict].sign} {verdict}: {LOOKS[verdict].says}" for verdict in VERDICTS)
    flow.paragraph(meaning + ".", 6.6, _DIM)
    flow.need(24.0 * len(arranged.controllers) + 12.0)
    for k, name in enumerate(arranged.controllers):
        flow.sheet.text(MARGIN, flow.y + 11.0, name, 7.0)
        flow.sheet.sketch(counts_bar(arranged.counts[k], name), MARGIN + 90.0, flow.y + 3.0, 0.8)
        flow.sheet.sketch(strip(arranged, k), MARGIN + 200.0, flow.y, (_ROOM - 200.0) / 960.0)
        flow.y += 17.0
    flow.paragraph(
        "Left: shares of the verdicts, what fails is hatched. Right: every test in the order of the matrix. A stroke "
        "over the whole height fails, a high one passes or is impossible, a low one was not judged.",
        6.6,
        _DIM,
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
        flow.table((30, 12, 18, 40), ("Test", "Besides", "Controllers", "Why"), rows, most=2)
        if len(failing) > len(shown):
            flow.paragraph(f"{len(failing) - len(shown)} more tests fail; the matrix has all of them.")


def _model(flow: Flow, document: Mapping[str, Any]) -> None:
    flow.section = "the model that was tested"
    flow.new_sheet()
    flow.heading("The model that was tested")
    for table in identity_tables(document):
        flow.need(30.0 + _LEADING * len(table.rows))
        flow.y += 12.0
        flow.sheet.text(MARGIN, flow.y, table.title, 8.0, bold=True)
        flow.y += 2.0
        rows = [[[Said(text)] for text in row] for row in table.rows]
        flow.table((30, 70), table.head, rows)
    flow.heading("Limits of validity")
    for sentence in validity(document):
        flow.paragraph(sentence, bullet=True)


def _matrix(flow: Flow, arranged: Arranged, suite: SuiteRows) -> None:
    flow.section = suite.title
    flow.heading(f"Clause matrix: {suite.title}", below=90.0)
    if suite.source:
        source = suite.source
        flow.paragraph(
            f"{source['document']}, {source['edition']}; confidence: {source['confidence']}. {source.get('note', '')}",
            6.6,
            _DIM,
        )
    if suite.about:
        flow.paragraph(suite.about)
    count = len(arranged.controllers)
    widths = (26, 20, *[max(45.0 / count, 11.0)] * count, 12)
    head = ("Test and network", "Asked", *arranged.controllers, "Source")
    rows: list[Cells] = []
    for group in suite.groups:
        said = ", ".join(
            f"{name}: {counts.words()}"
            for name, counts in zip(arranged.controllers, group.counts, strict=True)
            if counts.total
        )
        rows.append([[Said(group.name, bold=True)], [Said(said, _DIM)]])
        for test in group.tests:
            rows += _test_rows(arranged, test)
    flow.table(widths, head, rows)


def _test_rows(arranged: Arranged, test: Tested) -> list[Cells]:
    asked = [line for line in test.lines if any(v is not None and v.verdict != INFORMATIONAL for v in line.values)]
    shown = asked or list(test.lines)
    source = arranged.sources[test.reference - 1]
    cells: list[list[Said]] = [
        [Said(test.test, bold=True), Said(test.network, _DIM)],
        [Said(line.label if line.asked == "not asked for" else f"{line.label}: {line.asked}") for line in shown]
        or [Said("–")],
    ]
    for k, row in enumerate(test.rows):
        if row is None:
            cells.append([Said("not run", _DIM)])
            continue
        look = LOOKS[row["verdict"]]
        values = [value.words for line in shown if (value := line.values[k]) is not None]
        cells.append(
            [Said(f"{look.sign} {row['verdict']}", look.colour, row["verdict"] == FAIL), Said("; ".join(values))]
        )
    cells.append([Said(f"[{test.reference}] {source['edition']}, {source['confidence']}", _DIM)])
    rows: list[Cells] = [[[one for one in cell if one.text] or [Said("")] for cell in cells]]
    for verdict in VERDICTS:
        reasons = [reason for reason in test.reasons if reason.verdict == verdict]
        if reasons:
            said = "; ".join(f"{', '.join(one.controllers)}: {one.text}" for one in reasons)
            rows.append([[Said("")], [Said(f"{LOOKS[verdict].sign} {verdict}, {said}", LOOKS[verdict].colour)]])
    return rows


def _figures(flow: Flow, arranged: Arranged, drawn: Any) -> None:
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


def _maps(flow: Flow, document: Mapping[str, Any], drawn: Any) -> None:
    """Maps of one kind side by side, one for each controller."""
    if not drawn.maps:
        return
    flow.section = "survival maps"
    flow.new_sheet()
    flow.heading("Survival maps", below=200.0)
    flow.paragraph(LEGEND, colour=_DIM)
    for title, words, sketches in maps_by_title(document, drawn.maps):
        flow.sketches(title, words, sketches, int(_ROOM / (_LEAST_MAP * sketches[0].width)))
