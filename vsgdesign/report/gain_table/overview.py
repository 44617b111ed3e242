"""What a terminal prints of gain tables: one grid of numbers for each column and margin, comparisons, and
how close its rests are to the largest power that each grid carries."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import in_words
from vsgdesign.artifacts.gain_table import COLUMNS, GainTable
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import POWER_MARGIN, jacobian_from_powers, operating_point
from vsgdesign.linear.stability.gain_table import Compared, largest_difference
from vsgdesign.linear.stability.table_claims import CARRIED, FIGURES, figure_of, is_carried
from vsgdesign.report.drawing.quantities import DASH, number, plain
from vsgdesign.report.gain_table.words import heading
from vsgdesign.report.page.blocks import Block, Table, Where, words
from vsgdesign.runtime.needed_sigma import needed_sigma_text, needed_sigmas

COLUMN_UNITS = {"k_1": "1/s²", "d_1": "1/s", "k_2": "1/s", "H": "s", "zeta": "1"}
"""Units of the normalised columns in SI. Columns that are not listed here have none."""


def table_blocks(table: GainTable) -> list[Block]:
    """What the table is for, then one grid of numbers for each column and margin that is not the same in every cell."""
    found: list[Block] = [words(*heading(table), on=Where.TERMINAL)]
    constant: list[str] = []
    for name in COLUMNS[table.law]:
        values = table.parameters[name]
        unit = COLUMN_UNITS.get(name, "1")
        if np.ptp(values) <= 1e-9 * np.abs(values).max():
            constant.append(f"{name} = {values[0, 0]:.4g}" + (f" {unit}" if unit != "1" else ""))
        else:
            found.append(_grid(table, f"{name} [{unit}]", values, ".4g"))
    if constant:
        found.append(words(f"the same in every cell: {', '.join(constant)}", on=Where.TERMINAL))
    for name in _in_order(table.figures):
        figure = figure_of(name)
        form = ".3g" if figure.unit == "1" else ".2f"
        mark = f" ({CARRIED})" if is_carried(name) else ""
        found.append(_grid(table, f"{figure.title} [{figure.unit}]{mark}", table.figures[name], form))
    active = np.vectorize(in_words, otypes=[str])(table.active)
    status = np.where(active == "", table.status, np.char.add(np.char.add(table.status, ": "), active))
    if len(np.unique(status)) > 1:
        found.append(_grid(table, f"status, active constraint (the constraint: {CARRIED})", status, ""))
    else:
        found.append(words(f"every cell: {status[0, 0]}", on=Where.TERMINAL))
    return found


def sigma_blocks(table: GainTable) -> list[Block]:
    """How certain an estimate must be to be followed fully, as a sentence and in every cell."""
    title = "largest relative standard deviation of Z [%]"
    sentence = words(needed_sigma_text(table), on=Where.TERMINAL)
    return [sentence, _grid(table, title, 100.0 * needed_sigmas(table), ".2f")]


def comparison_blocks(compared: Sequence[Compared], files: Sequence[str]) -> list[Block]:
    """The worst margins of every table, then the largest differences of the others from the first."""
    first = compared[0].table
    rows = [
        (file, c.table.structure, c.table.law, *(_shown(c.worst(name), ".3g") for name in FIGURES))
        for c, file in zip(compared, files, strict=True)
    ]
    head = ("table", "structure", "law", *(f"{figure.title} [{figure.unit}]" for figure in FIGURES.values()))
    title = f"worst over the {first.scr.size * first.x_over_r.size} grids of {files[0]}, nominal"
    found: list[Block] = [Table(title, head, tuple(rows), texts=3, on=Where.TERMINAL)]
    for other, file in zip(compared[1:], files[1:], strict=True):
        differences = tuple(
            (row["figure"], f"SCR {row['scr']:g}, X/R {row['x_over_r']:g}", f"{row['difference']:+.3g}")
            for row in _differences(compared[0], other)
        )
        title = f"{file}, less {files[0]}: largest differences"
        found.append(Table(title, ("figure", "where", "difference"), differences, texts=2, on=Where.TERMINAL))
    return found


def comparison_lines(compared: Sequence[Compared], files: Sequence[str]) -> list[str]:
    """The same in sentences: the worst margins of each table, then where the others differ most from the first."""
    worst, *others = (block for block in comparison_blocks(compared, files) if isinstance(block, Table))
    lines = [
        f"{row[0]} ({', '.join(row[1:3])}), {worst.title}: "
        + ", ".join(f"{name} {value}" for name, value in zip(worst.head[3:], row[3:], strict=True))
        + "."
        for row in worst.rows
    ]
    for table in others:
        said = "; ".join(f"{figure} by {difference} at {where}" for figure, where, difference in table.rows)
        lines.append(f"{table.title}: {said or 'none'}.")
    return lines


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


def _grid(table: GainTable, title: str, values: NDArray[Any], form: str) -> Table:
    rows = tuple(
        (f"{scr:g}", *(_shown(value, form) for value in values[i].tolist())) for i, scr in enumerate(table.scr)
    )
    return Table(title, (r"SCR \ X/R", *(f"{x:g}" for x in table.x_over_r)), rows, texts=0, on=Where.TERMINAL)


def _shown(value: Any, form: str) -> str:
    if isinstance(value, str):
        return value
    return f"{value:{form}}" if math.isfinite(value) else DASH


Array = NDArray[np.float64]

ABOUT_STIFFNESS = (
    "dP/dδ over 3VV_g/|Z| is sin(δ + α), where α is the angle of the impedance: 1 at the stiffest rest, 0 at the "
    "largest power that the grid carries or gives. The static limits do not contain it. Where it is small, a "
    "disturbance takes the angle beyond the largest power, and only a limiter with a way back leads it home."
)


def stiffness_table(table: GainTable) -> Table:
    """At the design point of each node, and in brackets the least over the corners of the table's powers."""
    at_design, least = stiffness(table)
    rows = tuple(
        (plain(scr), *(_cell(*pair) for pair in zip(design, worst, strict=True)))
        for scr, design, worst in zip(table.scr, at_design, least, strict=True)
    )
    head = ("SCR", *(f"X/R {plain(x_over_r)}" for x_over_r in table.x_over_r))
    return Table("dP/dδ at the rest, over 3VV_g/|Z|: at the design point (least over the powers)", head, rows)


def stiffness(table: GainTable) -> tuple[Array, Array]:
    """dP/dδ over 3VV_g/|Z| at the exact grid of each node, (n, m) each: at the design point, and the least at the
    corners of the powers for which the table is valid, as far as V is valid there and the grid carries them. NaN where
    there is no such rest."""
    corners = [(P, Q) for P in table.validity.P for Q in table.validity.Q]
    with np.errstate(invalid="ignore"):
        found = np.array([_at_powers(table, P, Q) for P, Q in corners])
        known = np.isfinite(found).any(axis=0)
        least = np.where(known, np.nanmin(np.where(known, found, 0.0), axis=0), np.nan)
        return _at_powers(table, table.P_design, table.Q_design), least


def _at_powers(table: GainTable, P: float, Q: float) -> Array:
    base = table.base
    Z_base = PHASES * base.V_rated_rms**2 / base.S_rated
    R_g, L_g = SCR_BASES[base.scr_basis].grid(table.scr[:, None], table.x_over_r[None, :], Z_base, base.omega_n)
    R, X = base.R_2 + R_g, base.omega_n * (base.L_2 + L_g)
    V, _ = operating_point(P, Q, base.V_g_rms, R, X)
    Z = np.hypot(R, X)
    low, high = table.validity.V_rms
    sound = (low <= V) & (high >= V) & (POWER_MARGIN * np.hypot(P, Q) * Z <= PHASES * V * V)
    A = jacobian_from_powers(P, Q, V, R, X)[0]
    return np.where(sound, A * Z / (PHASES * V * base.V_g_rms), np.nan)


def _cell(design: float, least: float) -> str:
    if not np.isfinite(design):
        return DASH
    return f"{number(design, 2)} ({number(least, 2) if np.isfinite(least) else DASH})"
