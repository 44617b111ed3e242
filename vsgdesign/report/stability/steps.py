"""Small steps in EMT over what the linear models predict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.events import TOO_SHORT, UNSTABLE, time_needed
from vsgdesign.metrics.step_response import SETTLING_BAND, ResponseMetrics, settling_time, step_response
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.panels import groups
from vsgdesign.report.drawing.quantities import plain_quantity, prefix_for
from vsgdesign.report.drawing.style import BAND, COLOURS, PAGE_IN, add_axes, look, new_figure
from vsgdesign.report.drawing.time_axis import extreme_indices, symbols, time_unit
from vsgdesign.simulation.stability_result import StabilityResult, StepEvidence

Array = NDArray[np.float64]

PART = 7
_MOST_COLUMNS = 4
SOURCES = (("emt", "EMT, averaged bridge"), ("full_order", "full order"), ("reduced", "reduced"))
STYLES: dict[str, dict[str, Any]] = {
    "emt": {"color": "#9A9A9A", "linewidth": 2.4, "linestyle": "-", "zorder": 2},
    "full_order": {"color": COLOURS[0], "linewidth": 1.0, "linestyle": "-", "zorder": 3},
    "reduced": {"color": COLOURS[1], "linewidth": 1.0, "linestyle": (0, (4, 1.4)), "zorder": 4},
}


def step_figures(result: StabilityResult) -> Iterator[NamedFigure]:
    """P and Q steps of every controller, four grids a figure at most."""
    for index, a in enumerate(result.assessments):
        pairs = [result.evidence[a.spec.name, c.label] for c in a.focus if (a.spec.name, c.label) in result.evidence]
        parts = groups(pairs, _MOST_COLUMNS)
        for k, part in enumerate(parts):
            name = f"steps_{index + 1}" if len(parts) == 1 else f"steps_{index + 1}_{k + 1}"
            yield _figure(result, a.spec.name, part, name)


def metrics_of(evidence: StepEvidence, which: str) -> ResponseMetrics | str:
    """Rise, settling and overshoot of one of SOURCES against its own end, or in two words why there are none."""
    y, final, decay = getattr(evidence, which), evidence.final[which], evidence.decay[which]
    if not decay > 0.0:
        return UNSTABLE
    if abs(final) < 0.05 * abs(evidence.step):
        return "no step"
    if time_needed(evidence.t_s, np.abs(y / final - 1.0), decay) > evidence.t_s[-1]:
        return TOO_SHORT
    return step_response(evidence.t_s, y, 0.0, final, SETTLING_BAND)


def _shown_time(part: Sequence[tuple[StepEvidence, StepEvidence]]) -> float:
    """Until the slowest EMT response has settled, and half as long again."""
    longest = 0.0
    for evidence in (e for pair in part for e in pair):
        error = np.abs(evidence.emt - evidence.final["emt"]) / abs(evidence.step)
        settled = settling_time(evidence.t_s, error, SETTLING_BAND)
        longest = max(longest, float(evidence.t_s[-1]) if settled is None else settled)
    end = float(part[0][0].t_s[-1])
    return min(max(1.5 * longest, 0.05 * end), end)


@look()
def _figure(
    result: StabilityResult, controller: str, part: Sequence[tuple[StepEvidence, StepEvidence]], name: str
) -> NamedFigure:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    left, right, bottom, between, gap, panel = 0.55, 0.1, 0.36, 0.16, 0.34, 1.3
    width = min((PAGE_IN - left - right - between * (len(part) - 1)) / len(part), 3.2)
    total = max(left + len(part) * width + (len(part) - 1) * between + right, 4.9)
    below = bottom + 0.22
    height = below + 2.0 * panel + gap + 0.22
    figure = new_figure(total, height)
    end = _shown_time(part)
    unit = time_unit(end)
    factor, prefix = prefix_for(1.2 * abs(part[0][0].step))
    for row in (0, 1):
        in_row = []
        for column, pair in enumerate(part):
            evidence = pair[row]
            axes = add_axes(figure, left + column * (width + between), below + (1 - row) * (panel + gap), width, panel)
            final = evidence.final["emt"] / factor
            half = SETTLING_BAND * abs(evidence.step) / factor
            axes.axhspan(final - half, final + half, **BAND)
            seen = evidence.t_s <= end
            for which, _ in SOURCES:
                y = getattr(evidence, which)[seen] / factor
                picks = extreme_indices(y, round(70.0 * width))
                axes.plot(evidence.t_s[seen][picks] / unit.seconds, y[picks], **STYLES[which])
            axes.set_xlim(0.0, end / unit.seconds)
            axes.set_title(evidence.label)
            axes.annotate(
                f"error: full order {_percent(evidence, 'full_order')}\nreduced {_percent(evidence, 'reduced')}",
                (1.0, 0.0),
                xycoords="axes fraction",
                xytext=(-3.0, 3.0),
                textcoords="offset points",
                ha="right",
                va="bottom",
                linespacing=1.15,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8},
                zorder=6,
            )
            if column == 0:
                axes.set_ylabel(f"Δ{evidence.signal} [{prefix}{'W' if evidence.signal == 'P' else 'var'}]")
            else:
                axes.tick_params(axis="y", labelleft=False)
            if row == 1:
                axes.set_xlabel(f"Time after step [{unit.symbol}]")
            else:
                axes.tick_params(axis="x", labelbottom=False)
            in_row.append(axes)
        lows, highs = zip(*(one.get_ylim() for one in in_row), strict=True)
        for one in in_row:
            one.set_ylim(min(lows), max(highs))
    handles: list[Any] = [Line2D([], [], label=label, **STYLES[which]) for which, label in SOURCES]
    handles.append(Patch(label="±2 % of the step", **{**BAND, "zorder": 1}))
    figure.legend(handles=handles, ncols=4, loc="lower left", bbox_to_anchor=(left / total, 0.04 / height))
    step = plain_quantity(abs(part[0][0].step), "VA")
    caption = (
        f"How to read: answer of P (top) and Q (bottom) to a step of its own reference by {step} "
        f"({100.0 * abs(part[0][0].step) / result.study.converter.S_rated:.2g} % of rating), small enough to be "
        "linear. Where the lines lie upon the broad grey one, the model predicts the simulation. The error in a panel "
        "is the largest distance over the size of the step, over the whole simulated time. Band: ±2 % of the step "
        "about the computed steady state."
    )
    return NamedFigure(name, f"Small steps of {symbols(controller)}", caption, figure, PART)


def _percent(evidence: StepEvidence, which: str) -> str:
    return f"{100.0 * evidence.error(which):.2g} %"
