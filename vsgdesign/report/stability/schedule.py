"""The effect of a wrong or late schedule: true SCR and SCR of the gains, and margins over estimate errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.linear.stability.assessment import ControllerAssessment
from vsgdesign.linear.stability.maps import MarginMap
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.look import Cells
from vsgdesign.report.drawing.panels import Frame, Panel, map_figure
from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.drawing.style import PAGE_IN, add_axes, line_style, look, new_figure
from vsgdesign.report.drawing.time_axis import symbols
from vsgdesign.report.stability.maps import CIRCLES, DAMPING, DISK, Quantity, axis_labels, of_model
from vsgdesign.simulation.stability_result import StabilityResult
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

PART = 4
_MOST_PANELS = 8
_MOST_LINES = 6
_DAMPING = of_model(DAMPING, "full_order")


def schedule_figures(result: StabilityResult) -> Iterator[NamedFigure]:
    """Stale gains, then estimate errors, of every scheduled controller."""
    for index, a in enumerate(result.assessments):
        if a.stale is not None:
            for quantity in (_DAMPING, DISK):
                yield _stale_figure(result, index, a, a.stale, quantity)
        if a.estimate_error is not None:
            yield _error_figure(result, index, a, a.estimate_error)
            yield _box_figure(result, index, a, a.estimate_error)


def plane(field: MarginMap, values: Array, pick: tuple[Any, ...], axes: tuple[int, int], log: bool) -> Cells:
    """Two axes of a map as cells."""
    stable = field.stable[pick]
    spread = field.field(values)[pick]
    missing = np.isnan(stable)
    x, y = (field.axes[k][1] for k in axes)
    outside = ~field.cells.inside.reshape(field.shape)[pick]
    return Cells(
        x=x,
        y=y,
        values=spread,
        unstable=stable == 0.0,
        missing=missing,
        partial=np.zeros(missing.shape, dtype=bool),
        x_log=log,
        y_log=log,
        outside=outside,
    )


def _circles(field: MarginMap) -> str:
    return "" if field.cells.inside[field.analysed].all() else f" {CIRCLES}"


def place_of_design(study: Study) -> str:
    """The operating point of the maps that have one only."""
    s = study.stability
    first = ", the first of the study's" if len(s.P) * len(s.Q) > 1 else ""
    return f"P = {plain(s.P[0] / 1e3)} kW, Q = {plain(s.Q[0] / 1e3)} kvar{first}"


def _study_ratio(study: Study) -> str:
    return plain(study.grid.x_over_r(study.converter.omega_n), 3)


def _stale_figure(
    result: StabilityResult, index: int, a: ControllerAssessment, field: MarginMap, quantity: Quantity
) -> NamedFigure:
    study = result.study
    gates = study.stability.gates
    cells = plane(field, quantity.column(field.table), (), (0, 1), log=True)
    gate = None if quantity.gate_text is None else quantity.gate_text(gates)
    caption = (
        f"How to read: the grid has the SCR of the horizontal axis, but the gains are still those for the SCR of the "
        f"vertical one; on the diagonal they fit. Above the diagonal the grid has become weaker than the schedule "
        f"knows, below it stronger. Colour: {quantity.how}. Full order, X/R {_study_ratio(study)} for both, at "
        f"{place_of_design(study)}. After a jump of the grid the loop is in such a cell until the estimate follows."
        f"{_circles(field)}"
    )
    frame = Frame(
        f"stale_{quantity.name}_{index + 1}",
        f"Stale schedule of {a.spec.name}: {quantity.title.lower()}",
        caption,
        f"True {axis_labels(study)[0]}",
        "SCR that the gains are for [1]",
        quantity.label,
        PART,
        0.92,
        gate,
    )
    panel = Panel(f"{a.spec.name}, gains made for another grid", cells, f"map.{index}.stale")
    return map_figure(frame, [[panel]], quantity.scale(gates))


def _error_figure(result: StabilityResult, index: int, a: ControllerAssessment, field: MarginMap) -> NamedFigure:
    study = result.study
    scr = field.axes[0][1]
    shown = _spread(len(scr), _MOST_PANELS)
    per_row = 4 if len(shown) > 3 else len(shown)
    damping = _DAMPING.column(field.table)
    panels = [
        Panel(
            f"SCR {plain(float(scr[k]), 3)}",
            plane(field, damping, (k, 0), (2, 3), log=False),
            f"map.{index}.estimate_error.{k}",
        )
        for k in shown
    ]
    rows = [panels[first : first + per_row] for first in range(0, len(panels), per_row)]
    left_out = len(scr) - len(shown)
    more = f" {left_out} SCR between them are in the CSV file only." if left_out else ""
    gates = study.stability.gates
    caption = (
        f"How to read: one panel a true SCR, at X/R {_study_ratio(study)} and {place_of_design(study)}. The schedule "
        "is fed a resistance and an inductance that are wrong by the per cents on the axes; zero is the true grid. "
        f"Colour: {_DAMPING.how}. Blue cells meet our gate.{more}{_circles(field)}"
    )
    frame = Frame(
        f"estimate_error_{index + 1}",
        f"{_DAMPING.title} with {a.spec.name} against errors of its grid estimate",
        caption,
        "Error of $R_g$ [%]",
        "Error of $L_g$ [%]",
        _DAMPING.label,
        PART,
        0.95,
        _DAMPING.gate_text(gates) if _DAMPING.gate_text else None,
    )
    return map_figure(frame, rows, _DAMPING.scale(gates))


def _spread(count: int, most: int) -> list[int]:
    """At most so many indices, ends included."""
    if count <= most:
        return list(range(count))
    return sorted({round(float(k)) for k in np.linspace(0, count - 1, most)})


def worst_over_boxes(field: MarginMap, column: Array) -> tuple[Array, Array]:
    """(sizes, worst (SCR, size)): the least value where both errors are within ±size.

    Zero where a cell of the box is unstable; NaN where one cannot be analysed.
    """
    e = np.abs(field.axes[2][1])
    sizes = np.unique(e)
    values = np.where(field.stable == 0.0, 0.0, field.field(column))[:, 0]
    worst = [[values[k][np.ix_(e <= size, e <= size)].min() for size in sizes] for k in range(values.shape[0])]
    return sizes, np.maximum(np.array(worst), 0.0)


def _star(field: MarginMap, row: int) -> str:
    return "" if field.cells.inside.reshape(field.shape)[row].all() else " *"


@look()
def _box_figure(result: StabilityResult, index: int, a: ControllerAssessment, field: MarginMap) -> NamedFigure:
    from matplotlib.lines import Line2D

    study = result.study
    left, right, bottom, height, between = 0.5, 1.15, 0.36, 1.75, 0.6
    width = (PAGE_IN - left - right - between) / 2.0
    figure = new_figure(PAGE_IN, bottom + height + 0.22)
    shown = _spread(len(field.axes[0][1]), _MOST_LINES)
    lines: Sequence[Any] = ()
    gates: list[Any] = []
    for k, quantity in enumerate((_DAMPING, DISK)):
        axes = add_axes(figure, left + k * (width + between), bottom, width, height)
        sizes, worst = worst_over_boxes(field, quantity.column(field.table))
        for j, row in enumerate(shown):
            axes.plot(
                100.0 * sizes,
                worst[row],
                marker="o",
                markersize=2.4,
                label=f"SCR {plain(float(field.axes[0][1][row]), 3)}{_star(field, row)}",
                **line_style(j),
            )
        gate = quantity.scale(study.stability.gates).gate
        if gate is not None and quantity.gate_text is not None:
            axes.axhline(gate, color="#000000", linewidth=1.1, zorder=2)
            gates = [Line2D([], [], color="#000000", linewidth=1.1, label=quantity.gate_text(study.stability.gates))]
        axes.set_ylim(bottom=0.0)
        axes.set_ylim(top=max(axes.get_ylim()[1], 1.15 * (gate or 0.0), 0.1))
        axes.set_xlabel("Half-width of the box of errors of $R_g$ and $L_g$ [%]")
        axes.set_ylabel(quantity.label)
        axes.set_title(symbols(f"{a.spec.name}, full order"))
        lines = axes.get_lines()[: len(shown)]
    figure.legend(
        handles=[*lines, *gates],
        loc="upper left",
        bbox_to_anchor=((PAGE_IN - right + 0.12) / PAGE_IN, 1.0 - 0.22 / (bottom + height + 0.22)),
    )
    caption = (
        "How to read: the worst value over all pairs of errors within ± the half-width on the horizontal axis, one "
        f"line a true SCR, at X/R {_study_ratio(study)} and {place_of_design(study)}. Zero: a cell of the box is "
        "unstable. No line where a cell of the box cannot be analysed."
        + ("" if field.cells.inside.all() else " A star: outside the converter's limits of voltage or current.")
    )
    title = f"Margins of {a.spec.name} against the size of the estimate error"
    return NamedFigure(f"error_box_{index + 1}", title, caption, figure, PART)
