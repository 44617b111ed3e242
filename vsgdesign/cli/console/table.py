"""Gain tables for a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape

from vsgdesign.artifacts.gain_table import COLUMNS, GainTable
from vsgdesign.cli.console.scenario import new_console, new_table
from vsgdesign.report.gain_table.words import heading
from vsgdesign.runtime.needed_sigma import needed_sigma_text, needed_sigmas
from vsgdesign.stability.gain_table import FIGURES, Compared, figure_of, largest_difference

COLUMN_UNITS = {"k_1": "1/s²", "d_1": "1/s", "k_2": "1/s", "H": "s", "zeta": "1"}
"""Units of the normalised columns in SI. Columns that are not listed here have none."""


def table_overview(table: GainTable) -> None:
    """What the table is for, then one grid of numbers for each column and margin that is not the same in every cell."""
    console = new_console()
    console.print("\n".join(escape(line) for line in heading(table)), highlight=False, soft_wrap=True)
    constant: list[str] = []
    for name in COLUMNS[table.law]:
        values = table.parameters[name]
        unit = COLUMN_UNITS.get(name, "1")
        if np.ptp(values) <= 1e-9 * np.abs(values).max():
            constant.append(f"{name} = {values[0, 0]:.4g}" + (f" {unit}" if unit != "1" else ""))
        else:
            _print_grid(console, table, f"{name} [{unit}]", values, ".4g")
    if constant:
        console.print(escape(f"the same in every cell: {', '.join(constant)}"), highlight=False)
    for name in _in_order(table.margins):
        figure = figure_of(name)
        form = ".3g" if figure.unit == "1" else ".2f"
        _print_grid(console, table, f"{figure.title} [{figure.unit}]", table.margins[name], form)
    words = np.where(table.active == "", table.status, np.char.add(np.char.add(table.status, ": "), table.active))
    if len(np.unique(words)) > 1:
        _print_grid(console, table, "status, active constraint", words, "")
    else:
        console.print(escape(f"every cell: {words[0, 0]}"), highlight=False)


def sigma_overview(table: GainTable) -> None:
    """How certain an estimate must be to be followed fully, as a sentence and in every cell."""
    console = new_console()
    console.print(escape(needed_sigma_text(table)), highlight=False, soft_wrap=True)
    title = "largest relative standard deviation of Z [%]"
    _print_grid(console, table, title, 100.0 * needed_sigmas(table), ".2f")


def comparison_tables(compared: Sequence[Compared], files: Sequence[str]) -> None:
    """The worst margins of every table, then the largest differences of the others from the first."""
    console = new_console()
    first = compared[0].table
    worst = new_table(
        f"worst over the {first.scr.size * first.x_over_r.size} grids of {files[0]}, nominal",
        ("table", "structure", "law", *(f"{figure.title} [{figure.unit}]" for figure in FIGURES.values())),
        left=("table", "structure", "law"),
    )
    for c, file in zip(compared, files, strict=True):
        cells = (f"{c.worst(name):.3g}" if math.isfinite(c.worst(name)) else "–" for name in FIGURES)
        worst.add_row(escape(file), c.table.structure, c.table.law, *cells)
    console.print(worst)
    for other, file in zip(compared[1:], files[1:], strict=True):
        table = new_table(
            f"{file}, less {files[0]}: largest differences", ("figure", "difference", "where"), left=("figure", "where")
        )
        for row in _differences(compared[0], other):
            where = f"SCR {row['scr']:g}, X/R {row['x_over_r']:g}"
            table.add_row(row["figure"], f"{row['difference']:+.3g}", where)
        console.print(table)


def comparison_document(compared: Sequence[Compared], files: Sequence[str]) -> dict[str, Any]:
    """The comparison in the form of the JSON output."""
    first = compared[0]
    return {
        "scr": first.table.scr.tolist(),
        "x_over_r": first.table.x_over_r.tolist(),
        "tables": [
            {
                "file": file,
                "name": c.table.name,
                "sha256": c.table.sha256,
                "worst": {name: c.worst(name) for name in FIGURES},
                "gains": {name: values.tolist() for name, values in c.gains._asdict().items()},
                "margins": {name: values.tolist() for name, values in c.margins.items()},
                "differences": list(_differences(first, c)) if c is not first else [],
            }
            for c, file in zip(compared, files, strict=True)
        ],
    }


def _differences(one: Compared, other: Compared) -> Iterator[dict[str, Any]]:
    for mine, its in ((one.gains._asdict(), other.gains._asdict()), (one.margins, other.margins)):
        for name in mine:
            found = largest_difference(mine, its, name)
            if found is not None:
                difference, i, j = found
                scr, ratio = float(one.table.scr[i]), float(one.table.x_over_r[j])
                yield {"figure": name, "difference": difference, "scr": scr, "x_over_r": ratio}


def _in_order(margins: Iterable[str]) -> list[str]:
    names = list(margins)
    known = [prefix + name for prefix in ("", "worst_") for name in FIGURES if prefix + name in names]
    return known + [name for name in names if name not in known]


def _print_grid(console: Console, table: GainTable, title: str, values: NDArray[Any], form: str) -> None:
    # Its own line, not the grid's title, which would be wrapped to the width of the numbers.
    console.print(escape(title), style="italic", highlight=False)
    grid = new_table("", (r"SCR \ X/R", *(f"{x:g}" for x in table.x_over_r)))
    for i, scr in enumerate(table.scr):
        grid.add_row(f"{scr:g}", *(_shown(value, form) for value in values[i].tolist()))
    console.print(grid)


def _shown(value: Any, form: str) -> str:
    if isinstance(value, str):
        return escape(value)
    return f"{value:{form}}" if math.isfinite(value) else "–"
