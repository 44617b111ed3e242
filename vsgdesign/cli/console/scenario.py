"""Tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table


def new_console() -> Console:
    """The terminal with its own width. Without a terminal (a pipe, a log), it is wide enough for every table."""
    console = Console()
    return console if console.is_terminal else Console(width=160)


def new_table(title: str, headings: Sequence[str], left: Sequence[str] = ()) -> Table:
    table = Table(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in headings:
        table.add_column(escape(heading), justify="left" if heading in left else "right", overflow="fold")
    return table
