"""Blocks as a PDF: below each other on numbered sheets, tables with their heads repeated, figures from their files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from vsgdesign import __version__
from vsgdesign.report.drawing.figures import WrittenFigure
from vsgdesign.report.drawing.flow import BAD, DIM, GOOD, INK, PAD, SIZE, Cells, Flow, Said, alone
from vsgdesign.report.drawing.paper import HEIGHT, WIDTH, png_size, save, text_width
from vsgdesign.report.drawing.quantities import typeset
from vsgdesign.report.drawing.sketch import Sketch
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
    MET,
    MISSED,
    NUMBERS,
    SOURCE,
    Answer,
    Block,
    Box,
    Cell,
    Figure,
    Heading,
    Live,
    Note,
    OnPaper,
    Page,
    Side,
    Sketches,
    Table,
    Where,
    Words,
    numbered,
    plain_text,
    printed,
)

_LEAST_MAP = 0.62
"""Points for each px of a map, at least."""


def print_pdf(page: Page, out_path: str | Path, wide: bool = False) -> Path:
    """Write a page on upright sheets, or on ``wide`` ones. Equal pages give equal bytes."""
    flow = _set(page, wide)
    flow.number(page.title, f"{plain_text(page.origin)} Made by vsgdesign {__version__}.".strip())
    return save(flow.sheets, out_path, page.title)


def sheets_of(page: Page) -> int:
    """How many upright sheets a page needs."""
    return len(_set(page, wide=False).sheets)


def _set(page: Page, wide: bool) -> Flow:
    flow = Flow(WIDTH, HEIGHT) if wide else Flow(HEIGHT, WIDTH)
    flow.heading(page.title, 15.0)
    blocks = printed(numbered(page.blocks), Where.PAGE)
    for block, following in zip(blocks, [*blocks[1:], None], strict=True):
        if isinstance(block, Heading):
            _heading(flow, block, _least(flow, following))
        else:
            _print(flow, block)
    return flow


def _print(flow: Flow, block: Block) -> None:
    if isinstance(block, Box | Side):
        warning = isinstance(block, Box) and block.warning
        for inner in printed(block.blocks, Where.PAGE):
            if isinstance(inner, Words) and inner.style == HEADLINE:
                flow.headline(map(plain_text, inner.lines), BAD if warning else GOOD)
            else:
                _print(flow, inner)
    elif isinstance(block, Live):
        for inner in block.instead:
            _print(flow, inner)
    elif type(block) in _PRINTERS:
        _PRINTERS[type(block)](flow, block)


def _heading(flow: Flow, block: Heading, below: float = 70.0) -> None:
    if block.level == 2:
        flow.section = block.text
    flow.heading(block.text, 12.0 if block.level == 2 else 9.5, below=below, listed=block.level == 2)


def _least(flow: Flow, block: Block | None) -> float:
    """Height that a heading keeps free below it, pt: a figure is not parted from it."""
    if isinstance(block, Figure) and isinstance(block.drawn, WrittenFigure):
        return min(png_size(block.drawn.png)[1], 0.6 * flow.height) + 40.0
    return 70.0


def _words(flow: Flow, block: Words) -> None:
    if block.style == HEADLINE:
        flow.headline(map(plain_text, block.lines))
        return
    for k, line in enumerate(block.lines, start=1):
        sign = {BULLETS: "•", NUMBERS: f"{k}."}.get(block.style, "")
        flow.paragraph(plain_text(line), colour=DIM if block.style == SOURCE else INK, sign=sign)


def _table(flow: Flow, table: Table) -> None:
    rows: list[Cells] = [[[Said(cell)] for cell in row] for row in table.rows]
    widths = _widths(flow, [table.head, *table.rows])
    first, more = 0, [0.0] * len(widths)
    for label, span in table.groups:  # what the words above some columns need more than these is room for the last one
        wanted = PAD + 0.1 + text_width(typeset(label), SIZE, bold=True)
        more[first + span - 1] = max(wanted - sum(widths[first : first + span]), 0.0)
        first += span
    share = min((flow.room - sum(widths)) / max(sum(more), 1e-9), 1.0)  # as far as there is any; the rest is wrapped
    widths = [width + share * wider for width, wider in zip(widths, more, strict=True)]
    flow.subtitle(table.title)
    flow.table(widths, table.head, alone(rows), most=99, groups=table.groups, texts=table.texts, flagged=table.flagged)
    _notes(flow, table.notes)


def _widths(flow: Flow, rows: Sequence[Sequence[str]]) -> list[float]:
    """Widths of columns, pt: what their texts need, where all have room; else what long texts share is the rest."""
    room = PAD + 0.1  # a hair more, so that a text that just fits is not broken
    columns = zip(*rows, strict=True)
    needed = [room + max(text_width(typeset(text), SIZE, k == 0) for k, text in enumerate(one)) for one in columns]
    if sum(needed) <= flow.room:
        return needed
    # The widest share what the narrow ones leave: a bound on all widths, found by filling up from the narrowest.
    bound, left = flow.room, flow.room
    for k, width in enumerate(sorted(needed)):
        bound = left / (len(needed) - k)
        if width > bound:
            break
        left -= width
    return [min(width, bound) for width in needed]


def _answer(flow: Flow, answer: Answer) -> None:
    rows: list[Cells] = [
        [[*_key(row.key), Said(row.name, bold=True)], *(_answered(cell) for cell in row.cells)] for row in answer.rows
    ]
    flow.subtitle(answer.title)
    columns = 1 + len(answer.head)
    flow.table(flow.shares([1.0] * columns), (answer.subject, *answer.head), alone(rows), texts=columns)
    _notes(flow, answer.notes)


def _key(key: Sketch | None) -> list[Said | Sketch]:
    return [] if key is None else [key]


def _answered(cell: Cell) -> list[Said | Sketch]:
    colour = {MET: GOOD, MISSED: BAD}.get(cell.mark, DIM)
    said = Said(f"{cell.sign} {cell.words}".strip(), colour, cell.mark == MISSED)
    return [*_key(cell.picture), said, *([Said(cell.detail, DIM)] if cell.detail else [])]


def _notes(flow: Flow, notes: Iterable[str]) -> None:
    for note in notes:
        flow.paragraph(note, 6.6, DIM)


def _figure(flow: Flow, block: Figure) -> None:
    drawn = block.drawn
    if isinstance(drawn, WrittenFigure):
        number = f"Figure {block.number}. " if block.number else ""
        flow.picture(drawn.png, f"{number}{drawn.title}.", drawn.caption)


def _across(flow: Flow, block: Sketches) -> int:
    """How many sketches stand side by side: their numbers keep 6 pt, other words 7."""
    return int(flow.room / (_LEAST_MAP * block.sketches[0].width)) if block.least else 3


_PRINTERS: dict[type[Block], Callable[[Flow, Any], None]] = {
    Heading: _heading,
    Words: _words,
    Note: lambda flow, block: flow.paragraph(plain_text(block.line), 6.6, DIM),
    Table: _table,
    Answer: _answer,
    Figure: _figure,
    Sketches: lambda flow, block: flow.sketches(block.title, block.caption, block.sketches, _across(flow, block)),
    OnPaper: lambda flow, block: block.draw(flow),
}
