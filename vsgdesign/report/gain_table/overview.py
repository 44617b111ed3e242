"""The answer on top of a gain table's page, and what a terminal prints of tables: a grid of numbers for each column
and margin, and comparisons."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import in_words
from vsgdesign.artifacts.gain_table import COLUMNS, GainTable
from vsgdesign.artifacts.table_text import certificate_failed
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import POWER_MARGIN, jacobian_from_powers, operating_point
from vsgdesign.errors import counted
from vsgdesign.linear.stability.gain_table import Compared, TableCheck, largest_difference
from vsgdesign.linear.stability.table_claims import CARRIED, FIGURES, figure_of, is_carried, limit_of
from vsgdesign.report.drawing.quantities import DASH, number, plain
from vsgdesign.report.gain_table.maps import in_order, margin_keys
from vsgdesign.report.gain_table.words import heading
from vsgdesign.report.page.blocks import FACT, MET, MISSED, OPEN, UNKNOWN, Answer, Block, Cell, Row, Table, Where, words
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


def table_headline(table: GainTable, checked: TableCheck | None = None) -> str:
    """How many cells keep the specification, and whether the table is proved. Faults of the file come first."""
    if checked is not None and checked.faults:
        return f"The file contradicts itself: {counted(len(checked.faults), 'fault')} in words below."
    met, total = int((table.status == "met").sum()), table.status.size
    kept = f"{'All' if met == total else f'{met} of'} {total} cells keep every promise of the specification"
    if certificate_failed(table.certificate):
        return f"Not certified: a proof was tried and failed. {kept}."
    proved = "no proof was made" if table.certificate is None else "the table is certified"
    return f"{kept}, and {proved}."


def table_answer(table: GainTable, checked: TableCheck | None = None) -> list[Answer]:
    """The verdicts on the table, and the worst value of each promised margin."""
    verdicts = (
        *(() if checked is None else (("File", _file(checked)),)),
        ("Cells", _cells(table)),
        ("Between the nodes", _between(table)),
        ("Proof", _proof(table)),
        ("Random cases in EMT", _verified(table)),
    )
    found = [
        Answer("The table", tuple(name for name, _ in verdicts), (_row(table, [c for _, c in verdicts]),), "Table")
    ]
    margins = _margins(table)
    if margins:
        head, cells = tuple(title for title, _ in margins), [cell for _, cell in margins]
        note = (
            f"At the worst powers and estimate of the box where these are stored ({CARRIED}), otherwise at the design "
            "point."
        )
        found.append(Answer("Worst margins over all cells", head, (_row(table, cells),), "Table", (note,)))
    return found


def _row(table: GainTable, cells: list[Cell]) -> Row:
    return Row(table.name, tuple(cells))


def _file(checked: TableCheck) -> Cell:
    if checked.faults:
        return Cell(MISSED, counted(len(checked.faults), "fault"), "in words below")
    return Cell(
        MET if checked.good else OPEN, "no fault found", "" if checked.good else "not everything can be checked"
    )


def _cells(table: GainTable) -> Cell:
    counts = {status: int((table.status == status).sum()) for status in ("met", "relaxed", "outside")}
    detail = ", ".join(f"{count} {status}" for status, count in counts.items() if count and status != "met")
    words = f"{counts['met']} of {table.status.size} met"
    # A cell outside has no operating point or is beyond the static limits: nothing can be promised there.
    return Cell(MISSED if counts["relaxed"] else MET, words, detail)


def _between(table: GainTable) -> Cell:
    look = table.between
    if look is None:
        return Cell(OPEN, "not looked at")
    broken, promised = len(look["broken"]), look["promised"]
    if not promised:
        return Cell(OPEN, "nothing is promised")
    words = f"{broken} of {promised} broken" if broken else f"kept on all {promised}"
    return Cell(MISSED if broken else MET, words, f"{look['points']} random grids ({CARRIED})")


def _proof(table: GainTable) -> Cell:
    found = table.certificate
    if found is None:
        return Cell(OPEN, "none made")
    if certificate_failed(found):
        return Cell(MISSED, "failed", "where and why: in part 5")
    decay = "" if found.decay is None else f"decay {number(found.decay)} 1/s or faster"
    apart = found.differential
    if apart is not None and apart.decay is not None:
        decay += f", {number(apart.decay)} 1/s between units"
    proof = found.proof if apart is None or apart.proof == found.proof else f"{found.proof} and {apart.proof}"
    return Cell(MET, f"certified, {proof}", decay)


def _verified(table: GainTable) -> Cell:
    record = table.verification
    if record is None:
        return Cell(OPEN, "not verified")
    broken = [promise["broken"] for family in record["families"].values() for promise in family["promises"].values()]
    judged = [promise["judged"] for family in record["families"].values() for promise in family["promises"].values()]
    if not any(judged):
        return Cell(UNKNOWN, "no case was judged")
    missed = sum(count > 0 for count in broken)
    words = f"{missed} of {len(broken)} promises broken" if missed else f"all {len(broken)} promises kept"
    return Cell(MISSED if missed else MET, words, f"how often: in part 5 ({CARRIED})")


def _margins(table: GainTable) -> list[tuple[str, Cell]]:
    """Heading and cell of each margin that the specification limits."""
    found = []
    for name in in_order(table):
        limit = limit_of(table, name)
        if limit is None:
            continue
        figure = figure_of(name)
        nominal, worst = (np.asarray(table.figures.get(key, np.nan)) for key in margin_keys(table, name))
        values = worst if np.isfinite(worst).any() else nominal
        known = values[np.isfinite(values)]
        if not known.size:
            continue
        value = float(known.max() if figure.smaller_is_better else known.min())
        unit = "" if figure.unit == "1" else f" {figure.unit}"
        asked = f"asked {'≤' if figure.smaller_is_better else '≥'} {plain(limit)}{unit}"
        found.append((figure.title, Cell(FACT, f"{number(value)}{unit}", asked)))
    return found
