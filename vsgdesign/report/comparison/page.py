"""The page of a comparison: the answer, what each keeps, droop, inertia and EMT, and the fixed gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.design.comparison import Comparison, summary_of
from vsgdesign.report.comparison.tables import (
    error_of,
    label,
    promises_table,
    reached,
    services_table,
    share,
    specification_table,
    tunings_table,
    verdicts,
)
from vsgdesign.report.drawing import spark
from vsgdesign.report.drawing.figure_types import WrittenFigure
from vsgdesign.report.drawing.quantities import number, plain
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
    MET,
    MISSED,
    OPEN,
    Answer,
    Block,
    Box,
    Cell,
    Heading,
    Page,
    Row,
    Span,
    Where,
    drawings,
    opening,
    without_empty,
    words,
)


def comparison_page(comparison: Comparison, figures: Sequence[WrittenFigure] = ()) -> Page:
    """The page of a comparison."""
    study = comparison.study
    blocks: list[Block] = [
        *opening(comparison_headline(comparison), [comparison_answer(comparison)], figures),
        words(f"{study.title}: {comparison_headline(comparison)}", style=HEADLINE, on=Where.TERMINAL),
        words(_asked(comparison), on=Where.TERMINAL),
        Heading("In words"),
        Box([words(*verdicts(comparison), style=BULLETS, on=Where.BOTH)]),
        Heading("What is asked", numbered=True),
        specification_table(comparison),
        Heading("What is kept", numbered=True),
        replace(promises_table(comparison), on=Where.BOTH),
        *drawings(figures[1:]),
        Heading("Droop, inertia, EMT", numbered=True),
        replace(services_table(comparison), on=Where.BOTH),
        *_fixed_gains(comparison),
        Heading("Limits of validity", numbered=True),
        words(
            "A grid counts as kept if the full-order model keeps every requirement, with real inner loops, delay and "
            "sampling, for small deviations. The worst values, and the columns for ideal inner loops, come from the "
            "coupled reduced model. The EMT simulation is decisive.",
            "The shares count grids on the axes of the comparison, which are spaced evenly in the logarithm. They are "
            "not probabilities.",
            style=BULLETS,
        ),
    ]
    origin = ("Study ", Span(study.name, code=True), ", SHA-256 ", Span(study.hash, code=True), ".")
    return Page(f"{study.title}: comparison", blocks, origin)


def _asked(comparison: Comparison) -> str:
    """What is asked, in one line."""
    rows = [f"{name} {value}" for name, value in specification_table(comparison).rows]
    return f"{len(comparison.contenders[0].grids)} grids, worst over powers. Asked: {'; '.join(rows[:-1])}"


def _fixed_gains(comparison: Comparison) -> list[Block]:
    tunings = tunings_table(comparison)
    if tunings is None:
        return []
    said = (
        "The best fixed gains are the result of a seeded search over the whole box. Its cost is the worst relative "
        "violation of any requirement. No rate on any grid may exceed the largest rate of a table."
    )
    return [Heading("Fixed gains", numbered=True), tunings, words(said)]


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
        ("disk_margin", DEFINITIONS["disk_margin_output"].heading, f"≥ {plain(spec.disk_margin)}", 1.0, ""),
        ("damping_ratio", DEFINITIONS["damping_power_loops"].heading, f"≥ {plain(spec.damping_ratio)}", 1.0, ""),
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
        "Grids kept, wrong estimate",
        "Stable",
        *(title for _, title, *_ in columns),
        "EMT",
    )
    notes = (
        "Share of the grids on which everything is kept, and the number of grids on which a requirement is broken with "
        "an exact estimate, both with the real inner loops. The worst values are those with ideal inner loops, as in "
        f"part 2. A wrong estimate is off by {error_of(comparison)}.",
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
