"""A clause matrix for a terminal: one line for each suite and controller, then the rows that fail, and why."""

from __future__ import annotations

from typing import Any

from rich.markup import escape

from vsgdesign.cli.console.scenario import new_console, new_table

SHOWN = 10
"""Failing rows of a suite that a terminal names. The page has all of them."""

_COUNTS = (("pass", "pass"), ("fail", "fail"), ("informational", "informational"))
_LEFT = (("not_applicable", "not applicable"), ("impossible", "impossible"))


def compliance_lines(document: dict[str, Any]) -> None:
    """The answer for each suite and controller, the failing rows with their reasons, and what could not be tested."""
    console = new_console()
    named = ("suite", "controller")
    head = (*named, *(label for _, label in (*_COUNTS, *_LEFT)), "survived")
    table = new_table(f"Grid-code tests of {document['study']['name']}", head, left=named)
    for one in document["summary"]:
        counts = [str(one[name]) for name, _ in (*_COUNTS, *_LEFT)]
        table.add_row(escape(one["suite"]), escape(one["controller"]), *counts, f"{one['survived']} of {one['judged']}")
    console.print(table)
    for one in document["suites"]:
        failing = [row for row in document["rows"] if row["suite"] == one["name"] and row["verdict"] == "fail"]
        for row in failing[:SHOWN]:
            where = f"{row['suite']}, {row['test']}, {row['controller']}"
            console.print(f"[bold]fail[/bold] {escape(where)}: {escape(row['why'])}", highlight=False, soft_wrap=True)
        if len(failing) > SHOWN:
            console.print(f"… and {len(failing) - SHOWN} more of {one['name']} on the page", highlight=False)
    for note in document["notes"]:
        console.print(escape(note), highlight=False, soft_wrap=True)
    timing = ", ".join(f"{name} {value:.3g} s" for name, value in document["timing_s"].items())
    console.print(f"{len(document['rows']):,} rows: {timing}", highlight=False, soft_wrap=True)
