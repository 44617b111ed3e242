"""What a page is made of: blocks, which four printers set as HTML, on a terminal, as a PDF and in a notebook.

A result has one function that makes its page. A text, a number or a figure stands in it once, so that the printers
cannot disagree. A section is added there and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Flag, auto
from typing import TYPE_CHECKING, Self

from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure

if TYPE_CHECKING:
    from markupsafe import Markup

    from vsgdesign.report.drawing.flow import Flow
    from vsgdesign.report.drawing.sketch import Sketch


class Where(Flag):
    """The printers of a block: the page (HTML and PDF), the terminal, or both."""

    PAGE = auto()
    TERMINAL = auto()
    BOTH = PAGE | TERMINAL


class Span(str):
    """A text with a look of its own: code, bold, italic, or a link (a file beside the page, or ``#id``)."""

    code: bool
    bold: bool
    italic: bool
    link: str

    def __new__(cls, text: str, code: bool = False, bold: bool = False, italic: bool = False, link: str = "") -> Self:
        """A text for everyone who does not ask for its look."""
        span = super().__new__(cls, text)
        span.code, span.bold, span.italic, span.link = code, bold, italic, link
        return span


Line = str | tuple[str, ...]
"""A line of text, or its parts. A plain text is typeset: its symbols get subscripts, its negative numbers a minus."""


def plain_text(line: Line) -> str:
    """A line without its looks."""
    return line if isinstance(line, str) else "".join(line)


@dataclass(frozen=True, kw_only=True)
class Block:
    """What all blocks share: the printers that print them."""

    on: Where = Where.PAGE


@dataclass(frozen=True)
class Heading(Block):
    """A heading. A numbered one begins a part of the page, with its own number and the anchor ``part-N``."""

    text: str
    level: int = 2
    numbered: bool = False
    anchor: str = ""


PARAGRAPHS, BULLETS, NUMBERS = "paragraphs", "bullets", "numbers"
HEADLINE, SOURCE = "headline", "source"


@dataclass(frozen=True)
class Words(Block):
    """Lines of text: paragraphs, items with bullets or numbers, the ``headline`` or the ``source`` of a page."""

    lines: Sequence[Line]
    style: str = PARAGRAPHS


def words(*lines: Line, style: str = PARAGRAPHS, on: Where = Where.PAGE) -> Words:
    """A block of these lines; empty ones are left out."""
    return Words(tuple(line for line in lines if line), style, on=on)


@dataclass(frozen=True)
class Note(Block):
    """A remark in small print."""

    line: Line


@dataclass(frozen=True)
class Table(Block):
    """A table: head, rows of texts (as long as the head), notes below. ``texts`` columns are set flush left."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    texts: int = 1
    groups: tuple[tuple[str, int], ...] = ()
    """A row above the head: (label, how many columns)."""
    notes: tuple[str, ...] = ()
    flagged: frozenset[int] = field(default_factory=frozenset)
    """Rows that deserve attention."""
    links: tuple[str, ...] = ()
    """Where the first cell of each row leads, relative to the page; empty: no row has a link."""
    marked: frozenset[int] = field(default_factory=frozenset)
    """Rows with a mark at their edge, of which the words beside the table say the meaning."""
    anchor: str = ""
    row_anchor: str = ""
    """Rows can be linked to as ``ANCHOR-1`` and so on; empty: they cannot."""
    most: int | None = None
    """Rows that a terminal prints; None: all."""
    left_out: frozenset[str] = field(default_factory=frozenset)
    """Heads of the columns that a terminal leaves out: sentences, which a narrow column would break into ten lines."""

    @property
    def small(self) -> bool:
        """Whether it has so many columns that its letters are small."""
        return len(self.head) > 6


FLAGGED = "A coloured row (on a terminal one with a star)"
"""A flagged row in the words of a note."""

MET, MISSED, UNKNOWN, OPEN, FACT = "met", "missed", "unknown", "open", "fact"
"""Marks of a cell: a target that is met, one that is missed, one that was asked for and cannot be judged, nothing that
was asked for, and a figure that has no target. Each has its colour and, because colours alone are not enough, its sign
and its words."""

SIGNS = {MET: "✓", MISSED: "✗", UNKNOWN: "?", OPEN: "–", FACT: ""}


@dataclass(frozen=True)
class Cell:
    """One answer: its mark, the words beside it, the figure behind it, and perhaps a small picture."""

    mark: str
    words: str
    detail: str = ""
    picture: Sketch | None = None

    @property
    def sign(self) -> str:
        """The sign in front of the words."""
        return SIGNS[self.mark]


@dataclass(frozen=True)
class Row:
    """The answers for one subject. ``key`` is a sample of its curve, where the page's figures have one."""

    name: str
    cells: tuple[Cell, ...]
    key: Sketch | None = None


@dataclass(frozen=True)
class Answer(Block):
    """Rows of answers under one head (as long as the cells of a row), with notes below."""

    title: str
    head: tuple[str, ...]
    rows: tuple[Row, ...]
    subject: str = "Controller"
    notes: tuple[str, ...] = ()
    pictures: bool = False
    """Whether each cell is a picture with its words below, in one line."""


def counted(met: Sequence[bool], detail: str, otherwise: str = "not asked for") -> Cell:
    """A cell of several verdicts on the same target: ``met[k]`` for each that was judged, ``otherwise`` for none."""
    if not met:
        return Cell(OPEN, otherwise, detail)
    good = sum(met)
    if good == len(met):
        return Cell(MET, f"met {good} of {good}" if good > 1 else "met", detail)
    bad = len(met) - good
    return Cell(MISSED, f"missed {bad} of {len(met)}" if len(met) > 1 else "missed", detail)


def without_empty(answer: Answer) -> Answer:
    """The same without the columns in which no row has an answer: what nobody asked for is not worth a column."""
    used = [k for k in range(len(answer.head)) if any(row.cells[k].mark != OPEN for row in answer.rows)]
    rows = tuple(replace(row, cells=tuple(row.cells[k] for k in used)) for row in answer.rows)
    return replace(answer, head=tuple(answer.head[k] for k in used), rows=rows)


@dataclass(frozen=True)
class Figure(Block):
    """A figure with its title and caption: written to files, or drawn for a notebook. Pages number theirs."""

    drawn: WrittenFigure | NamedFigure
    number: int = 0
    """Its number on the page, from 1 on; 0: it stands alone."""


def drawings(
    drawn: Sequence[WrittenFigure], part: int | None = None, *, without: str = "", otherwise: str = ""
) -> list[Block]:
    """The figures of a part of a page (None: all) but the one with the name ``without``; words where there is none."""
    found: list[Block] = [Figure(one) for one in drawn if part in (None, one.part) and one.name != without]
    return found or ([words(otherwise)] if otherwise else [])


def opening(
    headline: Line, answers: Sequence[Answer], drawn: Sequence[WrittenFigure], largest: str = ""
) -> list[Block]:
    """The answer on top of a page, and below it the figure with the name ``largest``; without a name the first one."""
    first = [one for one in drawn if one.name == largest] if largest else list(drawn[:1])
    return [Box((words(headline, style=HEADLINE), *answers), anchor="answer"), *drawings(first)]


def answered(headline: Line, *answers: Answer) -> list[Block]:
    """The answer of a page on a terminal."""
    return [words(headline, style=HEADLINE, on=Where.TERMINAL), *(replace(one, on=Where.TERMINAL) for one in answers)]


@dataclass(frozen=True)
class Sketches(Block):
    """Sketches side by side, with a title and a caption."""

    title: str
    caption: str
    sketches: Sequence[Sketch]
    kind: str = "plot"
    """Class of the sketches in HTML."""
    least: float = 0.0
    """Share of its size below which a sketch is not made smaller: a narrow page scrolls. 0: it fills the page."""


@dataclass(frozen=True)
class Box(Block):
    """What a page says first: blocks in a frame, in the colour of a warning where something is wrong."""

    blocks: Sequence[Block]
    warning: bool = False
    anchor: str = ""


@dataclass(frozen=True)
class Side(Block):
    """Blocks side by side, where a page is wide enough."""

    blocks: Sequence[Block]


@dataclass(frozen=True)
class Contents(Block):
    """Links to the numbered parts of the page."""


@dataclass(frozen=True)
class Live(Block):
    """What lives in a browser alone: HTML of its own, made for its page. Other printers print ``instead``, its figure
    or its table."""

    html: Callable[[], Markup]
    instead: Sequence[Block] = ()


@dataclass(frozen=True)
class OnPaper(Block):
    """What stands on paper in place of a live component, where no other block fits."""

    draw: Callable[[Flow], None]


@dataclass(frozen=True)
class Page:
    """A page: its title, its blocks and what it was made from. ``style`` and ``script`` belong to its live blocks."""

    title: str
    blocks: Sequence[Block]
    origin: Line = ""
    style: str = ""
    script: str = ""
    """HTML behind the page."""


def inside(block: Block) -> Sequence[Block]:
    """The blocks of a block of blocks."""
    return block.blocks if isinstance(block, Box | Side) else ()


def printed(blocks: Sequence[Block], where: Where) -> list[Block]:
    """The blocks of one printer. A block of blocks is one of them where any of its own is."""
    return [block for block in blocks if (printed(inside(block), where) if inside(block) else where in block.on)]


def numbered(blocks: Sequence[Block]) -> list[Block]:
    """The same blocks with numbers, from 1 on: of the parts in their headings, of the figures beside them."""
    count = {Heading: 0, Figure: 0}

    def one(block: Block) -> Block:
        if isinstance(block, Box | Side):
            return replace(block, blocks=[one(inner) for inner in block.blocks])
        if isinstance(block, Figure):
            count[Figure] += 1
            return replace(block, number=count[Figure])
        if isinstance(block, Heading) and block.numbered:
            count[Heading] += 1
            number = count[Heading]
            return replace(block, text=f"{number}. {block.text}", anchor=block.anchor or f"part-{number}")
        return block

    return [one(block) for block in blocks]
