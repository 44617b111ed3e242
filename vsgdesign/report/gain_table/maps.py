"""Maps of a gain table: its margins, its normalised parameters, its gains."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.linear.stability.table_claims import CARRIED, FIGURES, WORST, Figure, figure_of, is_carried, limit_of
from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.look import Cells, Scale, gate_scale
from vsgdesign.report.drawing.panels import MOST, Frame, Panel, Surface, map_figure, surface_figure, surface_scale
from vsgdesign.report.drawing.quantities import GAIN_UNITS, plain
from vsgdesign.report.stability.maps import gain_symbol, used_gains

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
