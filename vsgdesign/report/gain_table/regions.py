"""The limits of a gain table's promises: active constraints, their price, the certified region, stale schedules."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.artifacts.certificate_record import CertificateRecord
from vsgdesign.artifacts.definitions import in_words
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.linear.stability.gain_table import stale_margins
from vsgdesign.linear.stability.table_claims import CARRIED
from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.look import CROSS, Cells, Scale, draw_cells, edges, node_axes, shade
from vsgdesign.report.drawing.panels import Frame, Panel, map_figure, surface_scale
from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.drawing.style import COLOURS, PAGE_IN, add_axes, look, new_figure
from vsgdesign.report.gain_table.maps import scr_label, table_cells
from vsgdesign.report.stability.maps import DAMPING, DISK, of_model
from vsgdesign.study.parameters.stability import Gates

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONSTRAINTS, CERTIFICATE, STALE = 4, 5, 6
"""Parts of the page."""

_NONE = "no constraint active"
_FREE = "#F3F6F9"
_HATCH: dict[str, Any] = {"facecolor": "none", "edgecolor": "#FFFFFF", "hatch": "\\\\\\\\\\\\", "linewidth": 0.0}
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 3.4, 2.1, 0.5, 0.36, 0.08


def constraint_figures(table: GainTable) -> Iterator[NamedFigure]:
    """The active constraints and their price in each cell."""
    yield active_figure(table)
    if np.nanmax(np.abs(table.price)) > 0.0:
        caption = (
            "How to read: what the active constraint costs in each cell, in the unit of the design's objective "
            f"({CARRIED}). Crosses: outside."
        )
        frame = Frame(
            "table_price",
            "Price of the active constraint",
            caption,
            scr_label(table),
            "X/R [1]",
            "Price [objective's unit]",
            CONSTRAINTS,
        )
        known = table.price[np.isfinite(table.price)]
        yield map_figure(frame, [[Panel("", table_cells(table, table.price))]], surface_scale(known))


def _kind(active: str) -> str:
    """What limits a cell, without the value that would have to be allowed, because cells are coloured by kind."""
    return in_words(active.split(" → ")[0].split(":")[0]) or _NONE


@look()
def active_figure(table: GainTable) -> NamedFigure:
    """The active constraint of each cell, with relaxed cells hatched."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    words = np.vectorize(_kind, otypes=[object])(table.active).astype(str)
    kinds = sorted(set(words[table.valid].tolist()), key=lambda word: (word == _NONE, word))
    colours = [_FREE if word == _NONE else _lighter(COLOURS[k % len(COLOURS)]) for k, word in enumerate(kinds)]
    numbers = np.full(table.shape, np.nan)
    entries: list[tuple[Any, str]] = []
    for k, word in enumerate(kinds):
        cells = table.valid & (words == word)
        numbers[cells] = k
        entries.append((Patch(facecolor=colours[k], edgecolor="#999999", linewidth=0.4), f"{word} ({cells.sum()})"))
    figure, axes = _beside_legend()
    nowhere = np.zeros(table.shape, dtype=bool)
    cells = Cells(
        x=table.scr, y=table.x_over_r, values=numbers, unstable=nowhere, missing=~table.valid, partial=nowhere
    )
    draw_cells(axes, cells, Scale(-0.5, len(kinds) - 0.5, listed=colours), _WIDTH, _HEIGHT)
    relaxed = table.status == "relaxed"
    if relaxed.any():
        shade(axes, edges(table.scr), edges(table.x_over_r), relaxed, _HATCH)
        patch = Patch(facecolor="#9A9A9A", edgecolor="#FFFFFF", hatch="\\\\\\\\\\\\\\\\", linewidth=0.0)
        entries.append((patch, f"hatched: a promise was relaxed ({relaxed.sum()})"))
    if not table.valid.all():
        entries.append((Line2D([], [], **{**CROSS, "markersize": 4.0}), f"outside ({(~table.valid).sum()})"))
    _label(figure, axes, table, entries)
    caption = (
        "How to read: the colour says which constraint keeps the design of a cell from being better; in brackets the "
        f"number of cells. Constraints are {CARRIED}."
    )
    return NamedFigure("table_active", "Active constraints", caption, figure, CONSTRAINTS)


def certificate_figure(table: GainTable) -> NamedFigure | None:
    """The region of the certificate, or of a failed proof, with the table's nodes; None without a region."""
    certificate = table.certificate
    if certificate is None or certificate.region.scr is None or certificate.region.x_over_r is None:
        return None
    return _draw_certificate(table, certificate, certificate.region.scr, certificate.region.x_over_r)


@look()
def _draw_certificate(
    table: GainTable, certificate: CertificateRecord, scr: tuple[float, float], x_over_r: tuple[float, float]
) -> NamedFigure:
    from matplotlib.patches import Rectangle

    figure, axes = _beside_legend()
    node_axes(axes, table.scr, table.x_over_r, _WIDTH, _HEIGHT)
    failed, decay = not certificate.certified, certificate.decay
    proved = "certified" if decay is None else f"certified: decay ≥ {plain(decay, 3)} 1/s"
    shade = {"facecolor": "#CFE3F1", "edgecolor": COLOURS[0], "linewidth": 1.2, "zorder": 1}
    if failed:
        proved, shade = "not certified", {**shade, "facecolor": "none", "edgecolor": COLOURS[1], "hatch": "//"}
    entries: list[tuple[Any, str]] = []
    v = table.validity
    for low, high, style, text in (
        (scr, x_over_r, shade, proved),
        (
            v.scr,
            v.x_over_r,
            {"facecolor": "none", "edgecolor": "#222222", "linestyle": (0, (4, 2)), "zorder": 2},
            "validity box of the table",
        ),
    ):
        patch = Rectangle((low[0], high[0]), low[1] - low[0], high[1] - high[0], **style)
        axes.add_patch(patch)
        entries.append((patch, text))
    for status, style in (
        ("met", {"marker": "o", "color": COLOURS[2]}),
        ("relaxed", {"marker": "s", "color": COLOURS[1]}),
        ("outside", {"marker": "x", "color": "#8A8A8A"}),
    ):
        nodes = np.argwhere(table.status == status)
        if len(nodes):
            (line,) = axes.plot(
                table.scr[nodes[:, 0]], table.x_over_r[nodes[:, 1]], linestyle="", markersize=3.0, zorder=3, **style
            )
            entries.append((line, f"node, {status} ({len(nodes)})"))
    if (cell := certificate.cell) is not None:
        (mark,) = axes.plot([cell.scr], [cell.x_over_r], "*", markersize=11.0, color=COLOURS[1], zorder=4)
        entries.append((mark, "counterexample: unstable" if cell.is_unstable else "slowest cell"))
    _label(figure, axes, table, entries)
    if failed:
        caption = (
            "How to read: for the hatched region, with the certificate's powers and errors of the estimate, no proof "
            "was found. Dots are the nodes of the table; the star is the grid that the sentence above names."
        )
        return NamedFigure("table_certificate", "Region without a proof", caption, figure, CERTIFICATE)
    caption = (
        "How to read: one Lyapunov function holds for every grid of the shaded region, within the certificate's powers "
        "and errors of the estimate. Dots are the nodes of the table; the certificate is about the interpolated gains."
    )
    return NamedFigure("table_certificate", "Certified region", caption, figure, CERTIFICATE)


def stale_figures(table: GainTable) -> Iterator[NamedFigure]:
    """Damping ratio and disk margin with gains for another SCR, at a low, a medium and a high X/R."""
    if len(table.scr) < 2:
        return
    columns = sorted({0, len(table.x_over_r) // 2, len(table.x_over_r) - 1})
    nowhere = np.zeros((len(table.scr),) * 2, dtype=bool)
    for quantity, name in ((of_model(DAMPING, "reduced"), "damping_power_loops"), (DISK, "disk_margin_output")):
        panels = []
        for column in columns:
            ratio = float(table.x_over_r[column])
            values = stale_margins(table, ratio, name)
            stable = stale_margins(table, ratio, "decay_1_s")
            unstable, missing = np.asarray(stable <= 0.0), np.isnan(stable)
            cells = Cells(x=table.scr, y=table.scr, values=values, unstable=unstable, missing=missing, partial=nowhere)
            panels.append(Panel(f"X/R {plain(ratio, 3)}", cells))
        gates = Gates()
        caption = (
            "How to read: the grid has the SCR of the horizontal axis, the gains are still those for the SCR of the "
            "vertical one; on the diagonal they fit. Above it the grid has become weaker than the schedule knows, "
            f"below it stronger. Colour: {quantity.how}. Reduced model at the design point. After a jump of the grid "
            "the loop is in such a cell until the estimate follows."
        )
        frame = Frame(
            f"table_stale_{quantity.name}",
            f"Stale schedule: {quantity.title.lower()}",
            caption,
            f"True {scr_label(table)}",
            "SCR that the gains are for [1]",
            quantity.label,
            STALE,
            0.92,
            None if quantity.gate_text is None else quantity.gate_text(gates),
        )
        yield map_figure(frame, [panels], quantity.scale(gates))


def _beside_legend() -> tuple[Figure, Any]:
    """A figure with one map on the left and room for a legend on the right; and the axes of the map."""
    figure = new_figure(PAGE_IN, _BOTTOM + _HEIGHT + _TOP)
    return figure, add_axes(figure, _LEFT, _BOTTOM, _WIDTH, _HEIGHT)


def _label(figure: Figure, axes: Any, table: GainTable, entries: list[tuple[Any, str]]) -> None:
    axes.set_xlabel(scr_label(table))
    axes.set_ylabel("X/R [1]")
    figure.legend(
        *zip(*entries, strict=True),
        loc="upper left",
        handleheight=1.1,
        labelspacing=0.5,
        bbox_to_anchor=((_LEFT + _WIDTH + 0.2) / PAGE_IN, (_BOTTOM + _HEIGHT) / (_BOTTOM + _HEIGHT + _TOP)),
    )


def _lighter(colour: str) -> tuple[float, float, float]:
    from matplotlib.colors import to_rgb

    red, green, blue = (0.35 + 0.65 * part for part in to_rgb(colour))
    return red, green, blue
