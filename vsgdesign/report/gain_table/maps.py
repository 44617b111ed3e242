"""Maps of a gain table: its margins, its normalised parameters and gains; the limits of its promises, that is, active
constraints, their price, the certified region, and stale schedules."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import CertificateRecord
from vsgdesign.artifacts.definitions import in_words
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.linear.stability.gain_table import stale_margins
from vsgdesign.linear.stability.table_claims import CARRIED, FIGURES, WORST, Figure, figure_of, is_carried, limit_of
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.look import CROSS, Cells, Scale, draw_cells, edges, gate_scale, node_axes, shade
from vsgdesign.report.drawing.panels import MOST, Frame, Panel, Surface, map_figure, surface_figure, surface_scale
from vsgdesign.report.drawing.quantities import GAIN_UNITS, plain
from vsgdesign.report.drawing.style import COLOURS, PAGE_IN, add_axes, look, new_figure
from vsgdesign.report.stability.maps import DAMPING, DISK, gain_symbol, of_model, used_gains
from vsgdesign.study.parameters.specification import Gates

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing


Array = NDArray[np.float64]

MARGINS, GAINS = 2, 3
"""Parts of the page."""

SYMBOLS = {
    "k_1": "$k_1$",
    "d_1": "$d_1$",
    "k_2": "$k_2$",
    "H": "$H$",
    "zeta": "ζ",
    "q": "$q$",
    "share_P": r"$\lambda_P$",
    "share_Q": r"$\lambda_Q$",
}
UNITS = {"k_1": "1/s²", "d_1": "1/s", "k_2": "1/s", "H": "s"}


def scr_label(table: GainTable) -> str:
    """Label of the SCR axis."""
    return f"SCR, {table.base.scr_basis} basis [1]"


def table_cells(table: GainTable, values: Array) -> Cells:
    """Values of a table as cells. Cells without a number are crossed, and unstable ones are hatched."""
    decay = table.figures.get("decay_1_s")
    unstable = np.zeros(table.shape, dtype=bool) if decay is None else np.asarray(decay <= 0.0)
    missing = np.isnan(values) & ~unstable
    return Cells(
        x=table.scr,
        y=table.x_over_r,
        values=values,
        unstable=unstable,
        missing=missing,
        partial=np.zeros(table.shape, dtype=bool),
    )


def in_order(table: GainTable) -> list[str]:
    """Names of a table's margins without ``worst_``: the known ones first, then the others."""
    names = {name.removeprefix(WORST) for name in table.figures}
    return [name for name in FIGURES if name in names] + sorted(names - FIGURES.keys())


def margin_keys(table: GainTable, name: str) -> tuple[str, str]:
    """Under which names a table has a margin: at the design point, and at the worst point of the box.

    A margin that is taken over the whole box alone has no first name, and the table may store it with ``worst_`` or
    without.
    """
    worst = WORST + name
    if figure_of(name).at_design_point:
        return name, worst
    return "", worst if worst in table.figures else name


def margin_figures(table: GainTable) -> Iterator[NamedFigure]:
    """A figure for each margin at the design point, with the worst of the box beside it if it is known."""
    for name in in_order(table):
        kinds = zip(margin_keys(table, name), ("design point", "worst of the box"), strict=True)
        shown = [(key, kind) for key, kind in kinds if key in table.figures]
        cells = [table_cells(table, table.figures[key]) for key, _ in shown]
        known = np.concatenate([c.values[np.isfinite(c.values) & ~c.unstable] for c in cells])
        if len(known) == 0:
            continue
        figure, limit = figure_of(name), limit_of(table, name)
        scale = _margin_scale(known, limit, figure)
        asked = None
        if limit is not None:
            unit = "" if figure.unit == "1" else f" {figure.unit}"
            asked = f"asked for: {'at most' if figure.smaller_is_better else 'at least'} {plain(limit)}{unit}"
        panels = [
            Panel(f"{kind} ({CARRIED})" if is_carried(key) else kind, c)
            for (key, kind), c in zip(shown, cells, strict=True)
        ]
        sides = " Blue cells keep the requirement, and orange cells do not." if asked else ""
        caption = (
            "How to read: each cell is a node of the table, its colour what is stored for it."
            f"{sides} Design point: P = {plain(table.P_design / 1e3)} kW, Q = {plain(table.Q_design / 1e3)} kvar, "
            "exact grid. Crosses: outside."
        )
        label = f"{figure.title} [{figure.unit}]"
        frame = Frame(
            f"table_{_file_name(name)}",
            figure.title,
            caption,
            scr_label(table),
            "X/R [1]",
            label,
            MARGINS,
            gate_label=asked,
        )
        yield map_figure(frame, [panels], scale)


def _margin_scale(known: Array, limit: float | None, figure: Figure) -> Scale:
    if limit is None:
        return surface_scale(known)
    low, high = min(0.0, float(known.min())), float(known.max())
    if figure.is_time:
        low = min(float(known.min()), 0.5 * limit)
    decades = range(int(np.floor(np.log10(limit))) - 1, int(np.floor(np.log10(limit))) + 3)
    ticks = [m * 10.0**d for d in decades for m in (1.0, 2.0, 5.0, 1.5, 3.0, 7.0, 1.2, 0.8, 4.0, 6.0)]
    return gate_scale(low, max(high, 1.2 * limit), limit, (0.0, *ticks), larger_is_better=not figure.smaller_is_better)


def gain_surfaces(table: GainTable) -> Iterator[NamedFigure]:
    """Normalised parameters that vary, then the SI gains at the design point that do."""
    parameters = table.parameters
    surfaces = [
        Surface(SYMBOLS[name], SYMBOLS[name], UNITS.get(name, "1"), values) for name, values in parameters.items()
    ]
    caption = (
        "How to read: what the schedule says of each grid; between the nodes it is interpolated in SCR and R/X. "
        "Cells outside have the numbers of their nearest designed neighbour."
    )
    yield from _in_fours(table, "table_parameters", "Normalised parameters", caption, surfaces, list(parameters))
    caption = (
        "How to read: the gains that follow from the normalised parameters at the design point on the exact grid, one "
        "colour scale a gain, logarithmic where all values are positive. At other powers the controller takes the "
        "Jacobian anew. Crosses: outside."
    )
    used = used_gains(table.gains)
    surfaces = [Surface(gain_symbol(n), gain_symbol(n), GAIN_UNITS[n], getattr(table.gains, n)) for n in used]
    yield from _in_fours(table, "table_gains", "Gains at the design point", caption, surfaces, used)


def varies(values: Array) -> bool:
    """Whether a quantity is not the same in every cell that has it."""
    known = values[np.isfinite(values)]
    return len(known) > 0 and bool(np.ptp(known) > 1e-9 * np.abs(known).max())


def _in_fours(
    table: GainTable, name: str, title: str, caption: str, surfaces: list[Surface], names: list[str]
) -> Iterator[NamedFigure]:
    drawn = [surface for surface in surfaces if varies(surface.values)]
    same = [
        f"{n} = {plain(float(np.nanmax(s.values)))}" for n, s in zip(names, surfaces, strict=True) if s not in drawn
    ]
    rest = f" The same in every cell: {', '.join(same)}." if same else ""
    for first in range(0, len(drawn), MOST):
        suffix = f"_{first // MOST + 1}" if len(drawn) > MOST else ""
        part = drawn[first : first + MOST]
        yield surface_figure(
            (name + suffix, title, caption + rest), table.scr, table.x_over_r, part, scr_label(table), GAINS
        )


def _file_name(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)


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


def _beside_legend() -> tuple[Drawing, Any]:
    """A figure with one map on the left and room for a legend on the right; and the axes of the map."""
    figure = new_figure(PAGE_IN, _BOTTOM + _HEIGHT + _TOP)
    return figure, add_axes(figure, _LEFT, _BOTTOM, _WIDTH, _HEIGHT)


def _label(figure: Drawing, axes: Any, table: GainTable, entries: list[tuple[Any, str]]) -> None:
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
