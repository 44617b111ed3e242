"""A verification for a terminal: the sentences and the tables of its page."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.markup import escape

from vsgdesign.artifacts.verification_text import counted_of, headline, kept, promise_sentences
from vsgdesign.cli.console.scenario import new_console, new_table
from vsgdesign.report.page.table import Table
from vsgdesign.report.quantities import typeset
from vsgdesign.report.verification.tables import cases_table, left_out_table, promises_table

SHOWN = 5
"""Worst cases that a terminal names. The page has all of them."""


def verification_tables(document: dict[str, Any]) -> None:
    """The answer, the promises, the worst cases, what a search found and what was left out."""
    console = new_console()
    style = "bold" if kept(document) else "bold red"
    console.print(escape(headline(document)), style=style, highlight=False, soft_wrap=True)
    for sentence in promise_sentences(document):
        console.print(escape(typeset(sentence)), highlight=False, soft_wrap=True)
    _print(console, promises_table(document))
    worst, found = document["worst"], document["search"]["found"]
    if worst:
        _print(console, _cases("The worst drawn cases", worst, document))
    if len(worst) > SHOWN:
        console.print(f"… and {len(worst) - SHOWN} more on the page, which also says why", highlight=False)
    if found:
        title = "Found by searching: these do not count in the share"
        _print(console, _cases(title, found, document))
    if document["judged"] < document["runs"]:
        _print(console, left_out_table(document))
    console.print(escape(_cost(document)), highlight=False, soft_wrap=True)


def _cases(title: str, cases: list[dict[str, Any]], document: dict[str, Any]) -> Table:
    """The first cases without their reasons: a sentence in a narrow column would take ten lines."""
    return cases_table(title, [case | {"why": ""} for case in cases[:SHOWN]], document)


def _cost(document: dict[str, Any]) -> str:
    """Runs, machine and seconds in one line."""
    count = document["workers"]
    seconds = ", ".join(f"{name.replace('_', ' ')} {value:.3g} s" for name, value in document["timing_s"].items())
    said = [
        f"{counted_of(document['runs'])} runs",
        f"seed {document['seed']}",
        document["instruction_set"] or "no runs",
    ]
    return f"{', '.join(said)}, {count} {'worker' if count == 1 else 'workers'}: {seconds}"


def _print(console: Console, table: Table) -> None:
    """A table of the page; rows that deserve attention have a star."""
    shown = new_table(table.title, ("", *table.head), left=("", *table.head[: table.texts]))
    for k, row in enumerate(table.rows):
        shown.add_row("*" if k in table.flagged else "", *(escape(typeset(cell)) for cell in row))
    console.print(shown)
    for note in table.notes:
        console.print(escape(typeset(note)), highlight=False, soft_wrap=True)
