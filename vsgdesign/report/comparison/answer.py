"""The answer on top of a comparison's page: each contender against the specification."""

from __future__ import annotations

from typing import Any

from vsgdesign.design.comparison import Comparison, summary_of
from vsgdesign.report.comparison.tables import error_of, label, reached, share
from vsgdesign.report.drawing import spark
from vsgdesign.report.page.blocks import MET, MISSED, OPEN, Answer, Cell, Row, without_empty
from vsgdesign.report.quantities import number, plain


def comparison_headline(comparison: Comparison) -> str:
    """Who keeps the specification on every grid."""
    summaries = [summary_of(compared) for compared in comparison.contenders]
    robust = [label(s["name"]) for s in summaries if s["kept_wrong"] == 1.0]
    exact = [label(s["name"]) for s in summaries if s["kept_exact"] == 1.0]
    if robust:
        return f"On every grid, with the estimate exact or wrong, the specification is met by {', '.join(robust)}."
    if exact:
        return f"On every grid, but with an exact estimate only, the specification is met by {', '.join(exact)}."
    return "Nothing that is compared meets the specification on every grid."


def comparison_answer(comparison: Comparison) -> Answer:
    """One row for each contender: grids kept, then each requirement."""
    spec = comparison.specification
    columns = (
        ("overshoot", "Overshoot", f"≤ {plain(100.0 * spec.overshoot)} %", 100.0, " %"),
        ("settling_time", "Settling time", f"≤ {plain(spec.settling_time)} s", 1.0, " s"),
        ("disk_margin", "Disk margin", f"≥ {plain(spec.disk_margin)}", 1.0, ""),
        ("damping_ratio", "Damping ratio", f"≥ {plain(spec.damping_ratio)}", 1.0, ""),
    )
    rows = []
    for compared in comparison.contenders:
        s, grids = summary_of(compared), len(compared.grids)
        cells = [_kept(s, "kept_exact"), _kept(s, "kept_wrong"), _broken(s, "unstable", grids, "")]
        for name, _, asked, factor, unit in columns:
            value = s["worst_exact"][name]
            worst = reached(value, factor, getattr(spec, name), at_least=asked.startswith("≥"))
            cells.append(_broken(s, name, grids, f"{worst}{unit if worst[-1].isdigit() else ''}, asked {asked}"))
        rows.append(Row(label(s["name"]), (*cells, _emt(s["emt"]))))
    head = (
        "Grids kept, exact estimate",
        f"Grids kept, {error_of(comparison)}",
        "Stable",
        *(title for _, title, *_ in columns),
        "EMT",
    )
    notes = (
        "Share of the grids on which everything is kept, and the number of grids on which a requirement is broken with "
        "an exact estimate, both with the real inner loops. The worst values are those with ideal inner loops, as in "
        "part 2.",
    )
    return without_empty(Answer("Against the specification", head, tuple(rows), "Gains", notes))


def _kept(s: dict[str, Any], key: str) -> Cell:
    words = f"{share(s[key])} %"
    mark = MET if s[key] == 1.0 else MISSED
    return Cell(mark, words, "", spark.bar(s[key], None, 1.0, f"{label(s['name'])}: {words} of the grids"))


def _broken(s: dict[str, Any], name: str, grids: int, detail: str) -> Cell:
    count = s["broken"].get(name, 0)
    if not grids:
        return Cell(OPEN, "no grid")
    return Cell(MISSED, f"missed on {count}", detail) if count else Cell(MET, "met", detail)


def _emt(emt: dict[str, Any]) -> Cell:
    if not emt["steps"]:
        return Cell(OPEN, "no step")
    settled = emt["steps"] - emt["not_settled"]
    detail = f"worst {number(100.0 * emt['overshoot'])} %, {number(emt['settling_time'])} s" if settled else ""
    return Cell(MISSED if emt["not_settled"] else MET, f"{settled} of {emt['steps']} settled", detail)
