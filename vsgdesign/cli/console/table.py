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
from vsgdesign.artifacts.table_text import (
    between_text,
    cause_text,
    causes_text,
    certificate_failed,
    certificate_sentence,
    inner_loops_text,
    status_text,
)
from vsgdesign.cli.console.scenario import new_console, new_table
from vsgdesign.errors import counted
from vsgdesign.stability.gain_table import FIGURES, Compared, TableCheck, figure_of, largest_difference

COLUMN_UNITS = {"k_1": "1/s²", "d_1": "1/s", "k_2": "1/s", "H": "s", "zeta": "1"}
"""Units of the normalised columns in SI; those that are not here have none."""


def table_overview(table: GainTable) -> None:
    """What the table is for, then one grid of numbers for each column and margin that is not the same everywhere."""
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


def heading(table: GainTable) -> Iterator[str]:
    """Lines that say what the table is, for what, and what was proved; a proof that failed is the first line."""
    if certificate_failed(table.certificate):
        yield certificate_sentence(table.certificate)
    base, v = table.base, table.validity
    counts = status_text({s: int((table.status == s).sum()) for s in ("met", "relaxed", "outside")})
    yield f"{table.name}: {table.structure}, law {table.law}, for study {table.study}"
    yield (
        f"{len(table.scr)} SCR ({base.scr_basis} basis) × {len(table.x_over_r)} X/R: {counts}. "
        f"{base.S_rated / 1e3:g} kVA, {base.V_rated_rms:g} V phase, {base.omega_n / (2.0 * math.pi):g} Hz; "
        f"gains shown at {table.P_design / 1e3:g} kW, {table.Q_design / 1e3:g} kvar"
    )
    if table.structure != "published":
        droop = f"D_p = {table.D_p:.4g} W·s/rad, " if table.structure == "angle_damped" else ""
        yield f"droop: {droop}D_q = {table.D_q:.4g} var/V"
    yield (
        f"valid for SCR {v.scr[0]:g} to {v.scr[1]:g}, X/R {v.x_over_r[0]:g} to {v.x_over_r[1]:g}, "
        f"P {v.P[0] / 1e3:g} to {v.P[1] / 1e3:g} kW, Q {v.Q[0] / 1e3:g} to {v.Q[1] / 1e3:g} kvar, "
        f"V {v.V_rms[0]:.4g} to {v.V_rms[1]:.4g} V, R and X known to ±{100.0 * v.error:g} %"
    )
    if table.specification:
        yield "specification: " + ", ".join(f"{k} = {_short(v)}" for k, v in table.specification.items())
    yield from _why(table.causes)
    if table.between is not None:
        yield between_text(table.between)
    if not certificate_failed(table.certificate):
        yield certificate_sentence(table.certificate)
    if table.design_hash:
        yield f"design hash {table.design_hash}"
    yield f"sha256 {table.sha256}"


def built_text(document: dict[str, Any], shown: int = 8) -> str:
    """What a build made: cells, nodes added, promises not kept and at what they would be, at nodes and between."""
    table, cells, between = document["table"], document["cells"], document["between"]
    head = f"{document['file']}: {table['name']}, {len(table['scr'])} SCR × {len(table['x_over_r'])} X/R"
    proof = document["certificate"]
    lines = [] if proof["certified"] is not False else [f"{table['name']}: {proof['text']}"]
    lines.append(f"{head}: {status_text(cells)}")
    if added := document["added"]:
        lines.append("nodes added between: " + ", ".join(f"{node['axis']} {node['value']:g}" for node in added))
    lines += _first(document["relaxed"], "would_be_feasible_with", "not as specified, feasible with", shown)
    broken = between["broken"]
    lines += _why(document["causes"], shown)
    lines.append(between_text(between))
    lines += _first(broken, "reached", "breaks its promise with", shown)
    if proof["certified"] is not False:
        lines.append(proof["text"])
    lines.append(f"sha256 {table['sha256']}")
    return "\n".join(lines)


def _why(causes: Sequence[dict[str, Any]], shown: int = 8) -> list[str]:
    """The causes of relaxed cells, a line each."""
    if not causes:
        return []
    more = [f"  and {len(causes) - shown} more (--json has all)"] if len(causes) > shown else []
    return [f"why cells are relaxed: {causes_text(causes)}", *(f"  {cause_text(c)}" for c in causes[:shown]), *more]


def _first(places: Sequence[dict[str, Any]], key: str, says: str, shown: int) -> list[str]:
    lines = []
    for place in places[:shown]:
        where = f"  SCR {place['scr']:.4g}, X/R {place['x_over_r']:.4g}"
        if place.get("inner_loops_fail"):
            lines.append(f"{where}: {inner_loops_text(place['inner_loops_rad_s'])}")
            continue
        values = ", ".join(f"{name} {_limit(value)}" for name, value in place[key].items())
        lines.append(f"{where}: {says} {values}")
    return lines if len(places) <= shown else [*lines, f"  and {len(places) - shown} more (--json has all)"]


def _limit(value: float | None) -> str:
    return "∞" if value is None or math.isinf(value) else f"{value:.3g}"


def check_text(path: str, table: GainTable, outcome: TableCheck) -> str:
    """What a check found, a line each."""
    shown = ", ".join(f"{name} {value:.2g}" for name, value in outcome.largest.items())
    if not outcome.good:
        return f"{path}: {counted(len(outcome.faults), 'fault')}\n" + "\n".join(
            f"  - {fault}" for fault in outcome.faults
        )
    lines = [f"{path}: good. {table.name}, {counted(outcome.cells, 'cell')} analysed anew"]
    if shown:
        lines.append(f"largest differences of stored margins: {shown}")
    if outcome.unknown:
        lines.append(f"carried, not recomputed: {', '.join(outcome.unknown)}")
    return "\n".join(lines)


def comparison_tables(compared: Sequence[Compared], files: Sequence[str]) -> None:
    """Worst margins of every table, then where the others differ most from the first."""
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
    """The comparison as JSON has it."""
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


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, list):
        return "[" + ", ".join(_short(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_short(v)}" for k, v in value.items()) + "}"
    return str(value)
