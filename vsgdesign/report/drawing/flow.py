"""Blocks below each other on the sheets of a PDF: headings, paragraphs, tables with repeated heads, sketches."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vsgdesign.report.drawing.paper import HEIGHT, MARGIN, WIDTH, Picture, Sheet, png_size, wrapped
from vsgdesign.report.drawing.quantities import typeset
from vsgdesign.report.drawing.sketch import END, START, Sketch

SIZE, LEADING = 6.6, 8.4
"""Size of the text of tables and distance of its lines, pt."""

INK, DIM, GOOD, BAD = "#1A1A1A", "#444444", "#00577F", "#A33B00"
"""Colours of text: its own, of what is less important, of what is met and of what is missed."""

MOST_LINES = 6
"""Lines of a cell of a table of many rows; what is longer is cut."""

_SCALE = 0.73
"""Points for each px of a sketch: three rows of figures fit on a sheet, and their words have 7 to 8 pt."""

_RULE, _HAIR, _FLAG = "#1A1A1A", "#CFCFCF", "#FBEFE6"
PAD = 6.0
"""Between two columns, pt."""


@dataclass(frozen=True)
class Said:
    """A text of a cell with its colour."""

    text: str
    colour: str = INK
    bold: bool = False


Cells = Sequence[Sequence[Said | Sketch]]
"""The cells of a row: the paragraphs and sketches of each."""


@dataclass(frozen=True)
class _Row:
    """A row that is set out: what stands in each cell, with its distance from the top of the row."""

    cells: list[list[tuple[float, str | Sketch, Said]]]
    height: float
    flagged: bool = False


def alone(rows: Sequence[Cells]) -> list[list[Cells]]:
    """Every row as a block of its own."""
    return [[row] for row in rows]


class Flow:
    """Puts blocks below each other, and begins a new sheet where there is no room."""

    def __init__(self, width: float = WIDTH, height: float = HEIGHT) -> None:
        self.width, self.height = width, height
        self.sheets: list[Sheet] = []
        self.sections: list[str] = []
        """What each sheet begins with, for its head line."""
        self.section = ""
        self.y = 0.0
        self.new_sheet()

    @property
    def room(self) -> float:
        """Width of what a sheet holds, pt."""
        return self.width - 2.0 * MARGIN

    @property
    def sheet(self) -> Sheet:
        """The sheet that is being filled."""
        return self.sheets[-1]

    @property
    def _bottom(self) -> float:
        return self.height - MARGIN - 6.0

    def new_sheet(self) -> None:
        """Begin a sheet."""
        self.sheets.append(Sheet(width=self.width, height=self.height))
        self.sections.append(self.section)
        self.y = MARGIN + 14.0

    def need(self, height: float) -> bool:
        """Begin a new sheet if so much height is not left on this one; returns whether it did."""
        if self.y + height <= self._bottom:
            return False
        self.new_sheet()
        return True

    def number(self, title: str, made: str) -> None:
        """Title, section and number at every sheet but the first, and what it was made from below all of them."""
        count, lower, right = len(self.sheets), self.height - MARGIN + 10.0, self.width - MARGIN
        for k, (sheet, section) in enumerate(zip(self.sheets, self.sections, strict=True), start=1):
            if k > 1:
                sheet.text(MARGIN, MARGIN, typeset(title), 7.0, colour=DIM)
                sheet.text(right, MARGIN, typeset(section), 7.0, anchor=END, colour=DIM)
            sheet.text(MARGIN, lower, wrapped(made, 6.0, self.room - 60.0, most=1)[0], 6.0, colour=DIM)
            sheet.text(right, lower, f"page {k} of {count}", 7.0, anchor=END)

    def heading(self, text: str, size: float = 11.0, below: float = 40.0, listed: bool = True) -> None:
        """A heading that has at least ``below`` pt of room under it, and perhaps an entry in the list of contents."""
        if self.y > MARGIN + 15.0:
            self.need(2.2 * size + below)
        self.y += 1.5 * size
        for line in wrapped(typeset(text), size, self.room, bold=True):
            self.sheet.text(MARGIN, self.y, line, size, bold=True)
            self.y += 1.25 * size
        if listed:
            self.sheet.marks.append((typeset(text), self.y - 2.45 * size))
        self.y += 5.0 - 1.25 * size

    def headline(self, lines: Iterable[str], colour: str = INK) -> None:
        """The answer, in large letters."""
        for text in lines:
            for line in wrapped(typeset(text), 13.0, self.room, bold=True):
                self.y += 18.0
                self.sheet.text(MARGIN, self.y, line, 13.0, bold=True, colour=colour)
        self.y += 8.0

    def subtitle(self, text: str) -> None:
        """The title of a table or of sketches."""
        if text:
            self.need(60.0)
            self.y += 14.0
            self.sheet.text(MARGIN, self.y, typeset(text), 8.0, bold=True)
            self.y += 2.0

    def paragraph(self, text: str, size: float = 7.6, colour: str = INK, sign: str = "") -> None:
        """Text over the whole width, behind the ``sign`` of an item."""
        indent = 9.0 if sign else 0.0
        for k, line in enumerate(wrapped(typeset(text), size, self.room - indent)):
            self.need(1.35 * size)
            self.y += 1.35 * size
            if sign and k == 0:
                self.sheet.text(MARGIN, self.y, sign, size, colour=colour)
            self.sheet.text(MARGIN + indent, self.y, line, size, colour=colour)
        self.y += 3.0

    def shares(self, shares: Sequence[float]) -> list[float]:
        """Widths of columns that fill a sheet, pt."""
        return [self.room * share / sum(shares) for share in shares]

    def table(
        self,
        columns: Sequence[float],
        head: Sequence[str],
        blocks: Sequence[Sequence[Cells]],
        most: int = MOST_LINES,
        groups: Sequence[tuple[str, int]] = (),
        texts: int = 99,
        flagged: frozenset[int] = frozenset(),
    ) -> None:
        """A table whose head is repeated on every sheet. ``columns``: their widths, pt.

        ``blocks``: rows that stay on one sheet. Columns from number ``texts`` on are set flush right.
        """
        names = [[Said(text, bold=True)] for text in head]
        top = self._set_out(columns, names, 99)
        self.need(top.height + (6.0 if groups else 4.0) * LEADING)
        self._head(columns, groups, top, texts)
        count = 0
        for block in blocks:
            rows = [self._set_out(columns, cells, most) for cells in block]
            if self.need(sum(row.height for row in rows)):
                self._head(columns, groups, top, texts)
            for row in rows:
                self._row(columns, replace(row, flagged=count in flagged), texts)
                count += 1
        self._rule(columns, 0.9)
        self.y += 8.0

    def _head(self, columns: Sequence[float], groups: Sequence[tuple[str, int]], row: _Row, texts: int) -> None:
        self.y += 2.0
        self._rule(columns, 0.9)
        if groups:
            self._groups(columns, groups)
        self._cells(columns, row, texts)
        self._rule(columns, 0.5)

    def _groups(self, columns: Sequence[float], groups: Sequence[tuple[str, int]]) -> None:
        """The words above some columns, which end on one line."""
        x, first, placed = MARGIN, 0, []
        for label, span in groups:
            width = sum(columns[first : first + span])
            if label:
                placed.append((x, width, wrapped(typeset(label), SIZE, width - PAD, bold=True, most=3)))
            x, first = x + width, first + span
        bottom = self.y + LEADING * max((len(lines) for _, _, lines in placed), default=1)
        for x, width, lines in placed:
            for k, line in enumerate(reversed(lines)):
                self.sheet.text(x, bottom - k * LEADING, line, SIZE, bold=True)
            self.sheet.line((x, bottom + 1.5), (x + width - PAD, bottom + 1.5), _HAIR, 0.4)
        self.y = bottom + 2.0

    def _rule(self, columns: Sequence[float], width: float, colour: str = _RULE) -> None:
        self.sheet.line((MARGIN, self.y), (MARGIN + sum(columns), self.y), colour, width)

    def _set_out(self, columns: Sequence[float], cells: Cells, most: int) -> _Row:
        """The lines of each cell of a row, with what they are a part of."""
        found, height = [], 0.0
        for cell, room in zip(cells, _spans(columns, len(cells)), strict=True):
            y, placed = 0.0, []
            for one in cell:
                if isinstance(one, Sketch):
                    placed.append((y + 2.0, one, Said("")))
                    y += 2.0 + one.height * _sketch_scale(one, room)
                    continue
                for line in wrapped(typeset(one.text), SIZE, room - PAD, one.bold, most):
                    y += LEADING
                    placed.append((y, line, one))
            found.append(placed)
            height = max(height, y)
        return _Row(found, height + 3.0)

    def _row(self, columns: Sequence[float], row: _Row, texts: int) -> None:
        if row.flagged:
            self.sheet.box(MARGIN, self.y, sum(columns), row.height, _FLAG)
        self._cells(columns, row, texts)
        self._rule(columns, 0.4, _HAIR)

    def _cells(self, columns: Sequence[float], row: _Row, texts: int) -> None:
        x = MARGIN
        for k, (placed, width) in enumerate(zip(row.cells, _spans(columns, len(row.cells)), strict=True)):
            for y, one, said in placed:
                if isinstance(one, Sketch):
                    self.sheet.sketch(one, x, self.y + y, _sketch_scale(one, width))
                    continue
                place = (x + width - PAD, END) if k >= texts else (x, START)
                self.sheet.text(place[0], self.y + y, one, SIZE, colour=said.colour, bold=said.bold, anchor=place[1])
            x += width
        self.y += row.height

    def picture(self, file: Path, title: str, caption: str) -> None:
        """A picture of a file at its own size, or as large as it fits, with title and caption on the same sheet."""
        lines = wrapped(typeset(f"{title} {caption}"), SIZE, self.room)
        width, height = png_size(file)
        most = self._bottom - MARGIN - 20.0 - LEADING * len(lines)
        scale = min(1.0, self.room / width, most / height)
        self.need(scale * height + LEADING * len(lines) + 8.0)
        self.sheet.parts.append(Picture(file, MARGIN, self.y + 4.0, scale * width, scale * height))
        self.y += scale * height + 6.0
        for k, line in enumerate(lines):
            self.y += LEADING
            self.sheet.text(MARGIN, self.y, line, SIZE, colour=INK if k == 0 else DIM)
        self.y += 8.0

    def sketches(self, title: str, caption: str, sketches: Sequence[Sketch], across: int) -> None:
        """Sketches side by side, so large that ``across`` of them fill the width, below a title."""
        size = 8.0
        lines = wrapped(typeset(caption), SIZE, self.room, most=2) if caption else []
        for k in range(0, len(sketches), across):
            some = sketches[k : k + across]
            scale = min(self.room / across / max(one.width for one in some), _SCALE)
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
                self.sheet.sketch(one, MARGIN + n * self.room / across, self.y, scale)
            self.y += height


def _sketch_scale(sketch: Sketch, room: float) -> float:
    return min(_SCALE, (room - PAD) / sketch.width)


def _spans(columns: Sequence[float], count: int) -> list[float]:
    """Widths of a row's cells: the last cell of a shorter row takes the rest."""
    return [*columns[: count - 1], sum(columns[count - 1 :])]
