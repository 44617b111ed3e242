"""Inner loops for a terminal."""

from __future__ import annotations

from typing import Any

from rich.markup import escape

from vsgdesign.cli.console.scenario import new_console, new_table
from vsgdesign.report.inner.words import (
    GAIN_HEAD,
    PROMISE_HEAD,
    explanation,
    gain_rows,
    headline,
    promise_rows,
    what_for,
)
from vsgdesign.report.quantities import number, plain

_SHOWN = 7
"""The grids of each axis on the map of the terminal."""


def inner_tables(document: dict[str, Any], file: str | None) -> None:
    """The answer first, then requirements, gains, the score over the grids, and what would improve it."""
    console = new_console()
    console.print(escape(f"{document['study']['title']}: {headline(document)}"), highlight=False)
    kept_in = f" They are kept in {file}." if file else ""
    console.print(escape(what_for(document) + kept_in), highlight=False)
    for line in explanation(document):
        console.print(escape(line), highlight=False)
    promises = new_table("What is kept, at the worst grid", PROMISE_HEAD, left=("promise",))
    for row in promise_rows(document):
        promises.add_row(*map(escape, row))
    console.print(promises)
    gains = new_table("Gains, SI, dq components peak", GAIN_HEAD, left=("gain", "what it is", "unit"))
    for row in gain_rows(document):
        gains.add_row(*map(escape, row))
    console.print(gains)
    console.print(_map(document))


def _map(document: dict[str, Any]) -> Any:
    scr, x_over_r, score = (document["map"][name] for name in ("scr", "x_over_r", "score"))
    rows, columns = _some(len(scr)), _some(len(x_over_r))
    table = new_table("Score over the grids (1 is asked)", ("SCR \\ X/R", *(plain(x_over_r[j], 3) for j in columns)))
    for i in reversed(rows):
        table.add_row(plain(scr[i], 3), *(number(score[i][j], 2) for j in columns))
    return table


def _some(count: int) -> list[int]:
    """About seven indices from the first to the last."""
    step = max((count - 1) // (_SHOWN - 1), 1)
    return sorted({*range(0, count, step), count - 1})
