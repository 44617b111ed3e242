"""Blocks below each other on the sheets of a PDF: headings, paragraphs, tables with repeated heads, sketches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vsgdesign.report.drawing.paper import HEIGHT, MARGIN, WIDTH, Sheet, wrapped
from vsgdesign.report.drawing.sketch import Sketch
from vsgdesign.report.quantities import typeset

SIZE, LEADING = 6.6, 8.4
"""Size of the text of tables and distance of its lines, pt."""

ROOM = WIDTH - 2.0 * MARGIN
"""Width of what a sheet holds, pt."""

DIM = "#444444"
"""Colour of text that is less important."""

MOST_LINES = 6
"""Lines of a cell; what is longer is cut."""

_SCALE = 0.73
"""Points for each px of a sketch: three rows of figures fit on a sheet, and their words have 7 to 8 pt."""

_TOP, _BOTTOM = MARGIN + 14.0, HEIGHT - MARGIN - 6.0
_RULE, _HAIR = "#1A1A1A", "#CFCFCF"


@dataclass(frozen=True)
class Said:
    """A text of a cell with its colour."""

    text: str
    colour: str = "#1A1A1A"
    bold: bool = False


Cells = Sequence[Sequence[Said]]
"""The cells of a row: paragraphs of each."""

_Row = list[list[tuple[str, Said]]]


def _height(row: _Row) -> float:
    return 3.0 + LEADING * max(len(lines) for lines in row)


def alone(rows: Sequence[Cells]) -> list[list[Cells]]:
    """Every row as a block of its own."""
    return [[row] for row in rows]


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
        for k, line in enumerate(wrapped(typeset(text), size, ROOM - indent)):
            self.need(1.35 * size)
            self.y += 1.35 * size
            if bullet and k == 0:
                self.sheet.text(MARGIN, self.y, "•", size, colour=colour)
            self.sheet.text(MARGIN + indent, self.y, line, size, colour=colour)
        self.y += 2.0

    def table(
        self, widths: Sequence[float], head: Sequence[str], blocks: Sequence[Sequence[Cells]], most: int = MOST_LINES
    ) -> None:
        """A table whose head is repeated on every sheet. ``widths``: shares of the page's width.

        ``blocks``: rows that stay on one sheet.
        """
        total = sum(widths)
        columns = [ROOM * width / total for width in widths]

        def draw_head() -> None:
            top = self.y
            lines = [wrapped(text, SIZE, width - 6.0, bold=True) for text, width in zip(head, columns, strict=True)]
            self.sheet.line((MARGIN, top + 2.0), (MARGIN + ROOM, top + 2.0), _RULE, 0.9)
            x = MARGIN
            for texts, width in zip(lines, columns, strict=True):
                for k, text in enumerate(texts):
                    self.sheet.text(x, top + 2.0 + LEADING * (k + 1), text, SIZE, bold=True)
                x += width
            self.y = top + 5.0 + LEADING * max(len(texts) for texts in lines)
            self.sheet.line((MARGIN, self.y), (MARGIN + ROOM, self.y), _RULE, 0.5)

        self.need(5.0 * LEADING)
        draw_head()
        for block in blocks:
            rows = [self._set_out(columns, cells, most) for cells in block]
            if self.need(sum(_height(row) for row in rows)):
                draw_head()
            for row in rows:
                self._row(columns, row)
        self.sheet.line((MARGIN, self.y), (MARGIN + ROOM, self.y), _RULE, 0.9)
        self.y += 8.0

    def _set_out(self, columns: Sequence[float], cells: Cells, most: int) -> _Row:
        """The lines of each cell of a row, with what they are a part of."""
        return [
            [(line, said) for said in cell for line in wrapped(typeset(said.text), SIZE, room - 6.0, said.bold, most)]
            for cell, room in zip(cells, _spans(columns, len(cells)), strict=True)
        ]

    def _row(self, columns: Sequence[float], row: _Row) -> None:
        x = MARGIN
        for lines, width in zip(row, _spans(columns, len(row)), strict=True):
            for k, (line, said) in enumerate(lines):
                y = self.y + LEADING * (k + 1)
                self.sheet.text(x, y, line, SIZE, colour=said.colour, bold=said.bold)
            x += width
        self.y += _height(row)
        self.sheet.line((MARGIN, self.y), (MARGIN + ROOM, self.y), _HAIR, 0.4)

    def sketches(self, title: str, caption: str, sketches: Sequence[Sketch], across: int) -> None:
        """Sketches side by side, so large that ``across`` of them fill the width, below a title."""
        size = 8.0
        lines = wrapped(typeset(caption), SIZE, ROOM, most=2) if caption else []
        for k in range(0, len(sketches), across):
            some = sketches[k : k + across]
            scale = min(ROOM / across / max(one.width for one in some), _SCALE)
            height = scale * max(one.height for one in some)
            first = k == 0
            self.need(height + (size + 8.0 + LEADING * len(lines) if first else 4.0))
            if first and title:
                self.y += size + 6.0
                self.sheet.text(MARGIN, self.y, typeset(title), size, bold=True)
            for line in lines if first else ():
                self.y += LEADING
                self.sheet.text(MARGIN, self.y, line, SIZE, colour=DIM)
            self.y += 4.0
            for n, one in enumerate(some):
                self.sheet.sketch(one, MARGIN + n * ROOM / across, self.y, scale)
            self.y += height


def _spans(columns: Sequence[float], count: int) -> list[float]:
    """Widths of a row's cells: the last cell of a shorter row takes the rest."""
    return [*columns[: count - 1], sum(columns[count - 1 :])]
