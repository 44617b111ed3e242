"""The answer on top of a gain table's page: its cells, its proof, its random cases, and its worst margins."""

from __future__ import annotations

import numpy as np

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.table_text import certificate_failed
from vsgdesign.errors import counted
from vsgdesign.linear.stability.gain_table import TableCheck
from vsgdesign.linear.stability.table_claims import CARRIED, figure_of, limit_of
from vsgdesign.report.drawing.quantities import number, plain
from vsgdesign.report.gain_table.maps import in_order, margin_keys
from vsgdesign.report.page.blocks import FACT, MET, MISSED, OPEN, UNKNOWN, Answer, Cell, Row


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
