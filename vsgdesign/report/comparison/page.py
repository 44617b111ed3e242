"""The page of a comparison: the answer, on which grids each contender keeps its promises, droop, inertia and EMT, and
the fixed gains."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.artifacts.definitions import ASKED, DEFINITIONS
from vsgdesign.design.comparison import STATES, Compared, Comparison, summary_of
from vsgdesign.report.comparison.tables import (
    bounds_inertia,
    error_of,
    inertia_asked,
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
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure
from vsgdesign.report.drawing.look import NO_POINT
from vsgdesign.report.drawing.quantities import number, plain
from vsgdesign.report.drawing.style import COLUMN_IN, TEXT_PT, add_axes, look, new_figure
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


LOOKS: dict[str, dict[str, Any]] = {
    "kept": {"facecolor": "#0072B2"},
    "kept_exact": {"facecolor": "#9AD0F0"},
    "broken": {"facecolor": "#F3D9A4"},
    "unstable": {"facecolor": "#8C3A00", "edgecolor": "#F6E3D5", "hatch": "//////"},
}
"""Dark and light blue, light and dark orange. All eyes can tell them apart, and the hatched one also in grey print."""

_ROW = 3
_LEFT, _RIGHT, _TOP, _BETWEEN_X, _BETWEEN_Y = 0.4, 0.04, 0.27, 0.1, 0.31
_AXIS, _LEGEND_ROW = 0.34, 0.155


def comparison_figures(comparison: Comparison) -> Iterator[NamedFigure]:
    """A map of the grids on which the requirements are kept, with one small panel for each contender."""
    yield _promises(comparison)


@look()
def _promises(comparison: Comparison) -> NamedFigure:
    from matplotlib.patches import Patch

    rows = math.ceil(len(comparison.contenders) / _ROW)
    width = (COLUMN_IN - _LEFT - _RIGHT - (_ROW - 1) * _BETWEEN_X) / _ROW
    height = 0.85 * width
    names = (
        "kept, wrong estimate too",
        "kept, exact estimate only",
        "not kept",
        "unstable, or no gains",
    )
    entries = [Patch(linewidth=0.0, **LOOKS[state]) for state in STATES]
    if comparison.outside:
        entries.append(Patch(**NO_POINT))
        names = (*names, "nothing is asked")
    below = _AXIS + _LEGEND_ROW * math.ceil(len(entries) / 2) + 0.06
    total = below + rows * height + (rows - 1) * _BETWEEN_Y + _TOP
    figure = new_figure(COLUMN_IN, total)
    for k, compared in enumerate(comparison.contenders):
        row, column = divmod(k, _ROW)
        place = (_LEFT + column * (width + _BETWEEN_X), below + (rows - 1 - row) * (height + _BETWEEN_Y))
        axes = add_axes(figure, *place, width, height)
        _panel(axes, comparison, compared)
        lowest = k + _ROW >= len(comparison.contenders)
        axes.tick_params(labelbottom=lowest, labelleft=column == 0)
        if lowest:
            axes.set_xlabel("X/R")
        if column == 0:
            axes.set_ylabel("SCR")
    figure.legend(
        entries,
        names,
        ncols=2,
        loc="lower left",
        bbox_to_anchor=(_LEFT / COLUMN_IN, 0.02 / total),
        handleheight=1.0,
        handlelength=1.4,
        columnspacing=1.0,
    )
    spec = comparison.specification
    caption = (
        f"Each cell is a grid, with the worst of its powers: overshoot ≤ {plain(100.0 * spec.overshoot)} %, settling ≤ "
        f"{plain(spec.settling_time)} s, {ASKED['disk_margin']} ≥ {plain(spec.disk_margin)}, "
        f"{ASKED['damping_ratio']} ≥ {plain(spec.damping_ratio)}{_inertia(comparison)}, kept with the real "
        "inner loops (full-order model) and with ideal ones. Percentages: grids kept with the estimate exact, and "
        f"wrong by {error_of(comparison)}."
    )
    return NamedFigure("promises", "Grids on which the requirements are kept", caption, figure)


def _inertia(comparison: Comparison) -> str:
    return f", {inertia_asked(comparison)}" if bounds_inertia(comparison) else ""


def _panel(axes: Any, comparison: Comparison, compared: Compared) -> None:
    """The cells of one contender. The axes count nodes, so that every grid has the same space."""
    from matplotlib.patches import Rectangle

    states = {(grid.scr, grid.x_over_r): grid.state for grid in compared.grids}
    for i, scr in enumerate(comparison.scr):
        for j, ratio in enumerate(comparison.x_over_r):
            style = LOOKS[states[scr, ratio]] if (scr, ratio) in states else NO_POINT
            axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, linewidth=0.0, **style))
    axes.set_xlim(-0.5, len(comparison.x_over_r) - 0.5)
    axes.set_ylim(-0.5, len(comparison.scr) - 0.5)
    axes.grid(False)
    for set_ticks, values in ((axes.set_xticks, comparison.x_over_r), (axes.set_yticks, comparison.scr)):
        last = len(values) - 1
        at = np.unique(np.linspace(0, last, 3 if last < 6 else 4).round().astype(int))
        set_ticks(at, [plain(values[k], 2) for k in at])
    axes.set_title(label(compared.contender.name), pad=9.0)
    axes.text(
        0.0,
        1.025,
        f"{share(compared.share('kept', 'kept_exact'))} %, {share(compared.share('kept'))} %",
        transform=axes.transAxes,
        fontsize=TEXT_PT - 1.0,
        color="#444444",
        va="bottom",
    )
