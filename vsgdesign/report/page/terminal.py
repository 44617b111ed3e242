"""Blocks on a terminal: their lines, their tables with as many columns as it has room for, and what differs between two
results, which has no page.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

from vsgdesign.errors import counted
from vsgdesign.report.drawing.quantities import DASH, typeset
from vsgdesign.report.page.blocks import (
    HEADLINE,
    NUMBERS,
    Answer,
    Block,
    Box,
    Cell,
    Heading,
    Line,
    Live,
    Note,
    Side,
    Table,
    Where,
    Words,
    plain_text,
    printed,
    words,
)

if TYPE_CHECKING:
    import rich.table
    from rich.console import Console

WIDTH = 160
"""Width without a terminal (a pipe, a log): every table has room."""


def new_console() -> Console:
    """The terminal with its own width, or a pipe with room for every table."""
    from rich.console import Console

    console = Console()
    return console if console.is_terminal else Console(width=WIDTH)


def print_terminal(blocks: Sequence[Block], console: Console | None = None) -> None:
    """Print those of the blocks that are meant for a terminal."""
    console = console or new_console()
    for block in printed(blocks, Where.TERMINAL):
        _print(console, block)


def _print(console: Console, block: Block, warning: bool = False) -> None:
    if isinstance(block, Box | Side):
        for inner in printed(block.blocks, Where.TERMINAL):
            _print(console, inner, isinstance(block, Box) and block.warning)
    elif isinstance(block, Words):
        style = ("bold red" if warning else "bold") if block.style == HEADLINE else ""
        for k, line in enumerate(block.lines, start=1):
            _say(console, f"{k}. {_text(line)}" if block.style == NUMBERS else _text(line), style)
    elif isinstance(block, Heading | Note):
        _say(console, _text(block.text if isinstance(block, Heading) else block.line), "italic")
    elif isinstance(block, Table):
        _table(console, block)
    elif isinstance(block, Answer):
        _table(console, as_table(block))
    elif isinstance(block, Live):
        print_terminal(block.instead, console)


def _say(console: Console, text: str, style: str = "") -> None:
    from rich.markup import escape

    console.print(escape(text), style=style or None, highlight=False, soft_wrap=True)


def _text(line: Line) -> str:
    return typeset(plain_text(line))


def as_table(answer: Answer) -> Table:
    """Answers as a table of texts: sign, words and the figure behind them."""
    rows = tuple((row.name, *map(_cell, row.cells)) for row in answer.rows)
    head = (answer.subject, *answer.head)
    return Table(answer.title, head, rows, texts=len(head), notes=answer.notes)


def _cell(cell: Cell) -> str:
    return " ".join(part for part in (cell.sign, cell.words, f"({cell.detail})" if cell.detail else "") if part)


def _table(console: Console, table: Table) -> None:
    """A table of the page. Where it flags rows, these have a star in a column of their own."""
    from rich.markup import escape

    stars = bool(table.flagged)
    columns = [k for k, name in enumerate(table.head) if name not in table.left_out]
    shown, heads = _new_table(), _heads(table)
    rows = table.rows if table.most is None else table.rows[: table.most]
    texts = [[typeset(heads[k]), *(_text(row[k]) for row in rows)] for k in columns]
    if stars:
        shown.add_column("")
    for k, width, text in zip(columns, _widths(texts, console.width - 3 * stars), texts, strict=True):
        side: Literal["left", "right"] = "left" if k < table.texts else "right"
        shown.add_column(escape(text[0]), justify=side, overflow="fold", width=width)
    for k, cells in enumerate(list(zip(*texts, strict=True))[1:]):
        shown.add_row(*(["*" if k in table.flagged else ""] if stars else []), *map(escape, cells))
    # A line of its own: as a title of a narrow table it would be broken.
    _say(console, typeset(table.title), "italic")
    console.print(shown)
    if len(rows) < len(table.rows):
        reasons = ", which also says why" if table.left_out else ""
        _say(console, f"… and {len(table.rows) - len(rows)} more on the page{reasons}")
    for note in table.notes:
        _say(console, _text(note))


def _widths(columns: Sequence[Sequence[str]], room: int) -> list[int | None]:
    """Widths of columns of texts, the widest made narrower until all have room, but no word of them broken; None for
    each where that is not possible, or not needed."""
    widths = [max(len(line) for text in column for line in text.split("\n")) for column in columns]
    words = [max((len(word) for text in column for word in text.split()), default=0) for column in columns]
    too_wide = sum(widths) + 2 * len(columns) - room
    if not 0 < too_wide <= sum(widths) - sum(words):
        return [None] * len(columns)
    for _ in range(too_wide):
        k = max((k for k, width in enumerate(widths) if width > words[k]), key=widths.__getitem__)
        widths[k] -= 1
    return list(widths)


def _heads(table: Table) -> list[str]:
    """The heads of the columns, below the label of their group where they mean nothing without it."""
    groups = [group for group in table.groups for _ in range(group[1])] or [("", 1)] * len(table.head)
    return [
        f"{label}\n{name}".strip() if label and (span == 1 or not name or table.head.count(name) > 1) else name
        for name, (label, span) in zip(table.head, groups, strict=True)
    ]


def _new_table() -> rich.table.Table:
    """An empty table in the look of all of them."""
    import rich.table
    from rich import box

    return rich.table.Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)


_LONGEST = 60
"""Letters of a value that a terminal shows."""

_MOST_FIGURES = 40
"""Changed figures that a terminal shows, the largest changes first."""


def diff_blocks(document: dict[str, Any]) -> list[Block]:
    """What changed between two results: inputs, verdicts, then figures with both values."""
    inputs, verdicts, figures = (document[name] for name in ("inputs", "verdicts", "figures"))
    marks = {True: "worse", False: "better"}
    by_size = sorted(figures, key=_relative_size, reverse=True)
    head = ("A", "B")
    return [
        words(diff_sentence(document), on=Where.TERMINAL),
        *_changed("inputs", inputs, head, lambda _: ()),
        *_changed("verdicts", verdicts, (*head, ""), lambda one: (marks[one["worse"]],)),
        *_changed("figures, the largest changes first", by_size, (*head, "change"), lambda one: (_change(one),)),
    ]


def diff_sentence(document: dict[str, Any]) -> str:
    """How much changed, and whether a verdict got worse."""
    counts = [(len(document[f"{word}s"]), word) for word in ("input", "verdict", "figure")]
    changed = ", ".join(counted(count, word) for count, word in counts if count)
    worse = f"{counted(document['worse'], 'verdict')} got worse" if document["worse"] else "No verdict got worse"
    return f"Changed: {changed}. {worse}." if changed else "Nothing changed."


def _changed(
    title: str,
    changes: Sequence[dict[str, Any]],
    head: tuple[str, ...],
    more: Callable[[dict[str, Any]], tuple[str, ...]],
) -> list[Block]:
    rows = tuple((" › ".join(one["place"]), _shown(one["a"]), _shown(one["b"]), *more(one)) for one in changes)
    rest = len(rows) - _MOST_FIGURES
    found: list[Block] = [Table(title, ("what", *head), rows[:_MOST_FIGURES], on=Where.TERMINAL)] if rows else []
    return [*found, words(f"… and {rest} more: --json gives all." if rest > 0 else "", on=Where.TERMINAL)]


def _shown(value: Any) -> str:
    if value is None:
        return DASH
    if isinstance(value, dict):
        return "there"
    if isinstance(value, float):
        return f"{value:.6g}"
    text = ", ".join(map(_shown, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _change(one: dict[str, Any]) -> str:
    size = _relative(one)
    return DASH if not math.isfinite(size) else f"{100.0 * size:+.3g} %"


def _relative_size(one: dict[str, Any]) -> float:
    return abs(_relative(one))


def _relative(one: dict[str, Any]) -> float:
    """(b - a)/|a|; infinite where one of them is no number, or a is zero."""
    a, b = one["a"], one["b"]
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (a, b))
    return (b - a) / abs(a) if numbers and a else math.inf
