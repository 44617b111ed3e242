"""The power flow of a design: where its controllers rest, what limits, and how much room is left."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.power_flow import PowerFlow
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.errors import counted
from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.look import Cells, Scale, gate_scale
from vsgdesign.report.drawing.panels import Frame, Panel, groups, map_figure
from vsgdesign.report.drawing.quantities import DASH, number, percent, plain
from vsgdesign.report.page.blocks import Table, Where
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_PANELS, _MOST = 3, 6
"""Maps side by side, and rows on a terminal: the weakest grids."""

_ON_PAGE = frozenset({"Within", "Beyond", "Used\n[%]", "P\n[kW]"})
"""Columns that a terminal of 80 has no room for. The headline counts, and P is P_ref at the nominal frequency."""

NOTE = (
    "P, Q and V are those at the filter's capacitor, with both droops. I flows through the converter-side inductor. "
    "The modulation index is the amplitude of the bridge's voltage over V_dc/2, without a zero sequence. Its margin is "
    "what is left of the largest voltage. The nearest limit is the static limit of which the rest uses most."
)


def flow_headline(flow: PowerFlow) -> str:
    """How many of the points are within the static limits, and what the others meet."""
    beyond = Counter(name for name, why in zip(flow.limit, flow.obstacle, strict=True) if why)
    count, within = len(flow.limit), int(flow.possible.sum())
    if not beyond:
        return f"{flow.controller} rests within the static limits on all {count} combinations of grid and powers."
    said = ", ".join(f"{name} on {many}" for name, many in beyond.most_common())
    return (
        f"{flow.controller} rests within the static limits on {within} of {count} combinations of grid and powers. "
        f"What limits the others: {said}."
    )


def flow_table(study: Study, flow: PowerFlow) -> Table:
    """For each SCR what limits how often, and the point within the limits that has the least room."""
    c, rows = study.converter, []
    for scr in flow.axes.scr:
        own = np.flatnonzero(flow.scr == scr)
        beyond = Counter(flow.limit[k] for k in own if flow.obstacle[k])
        within = own[flow.possible[own]]
        met = ", ".join(f"{name} {many}" for name, many in beyond.most_common()) or "none"
        shown = (plain(scr, 3), f"{len(within)}/{len(own)}", met)
        if not within.size:
            rows.append((*shown, *[DASH] * 11))
            continue
        k = int(within[np.argmax(flow.used[within])])
        rows.append(
            (
                *shown,
                plain(flow.x_over_r[k], 3),
                *(number(value[k] / 1e3) for value in (flow.P_ref, flow.Q_ref)),
                flow.limit[k],
                percent(100.0 * flow.used[k]),
                number(flow.modulation_index[k]),
                percent(100.0 * flow.modulation_margin[k]),
                number(flow.V_rms[k] / c.V_rated_rms),
                number(rms_to_peak(flow.I_rms[k]) / c.I_rated_pk),
                *(number(value[k] / 1e3) for value in (flow.P, flow.Q)),
            )
        )
    head = (
        *(
            "SCR",
            "Within",
            "Beyond",
            "X/R",
            "P_ref\n[kW]",
            "Q_ref\n[kvar]",
            "Nearest limit",
            "Used\n[%]",
            "Index",
            "Margin\n[%]",
        ),
        *("V\n[pu]", "I\n[pu]", "P\n[kW]", "Q\n[kvar]"),
    )
    grouped = (
        ("Static limits", 3),
        ("The point within them that has the least room", 5),
        ("Modulation", 2),
        ("Rest", 4),
    )
    title = f"Power flow of {flow.controller} (SCR on the {flow.axes.scr_basis} basis)"
    return Table(title, head, tuple(rows), 3, grouped, left_out=_ON_PAGE, most=_MOST, on=Where.BOTH)


def flow_figures(study: Study, flows: Sequence[PowerFlow]) -> Iterator[NamedFigure]:
    """The use of the nearest limit, the margin of the modulation and the current over SCR and X/R, each the worst of
    the powers."""
    c = study.converter
    limit = 1.0 if c.current_limit_pu is None else c.current_limit_pu
    used = gate_scale(40.0, 130.0, 100.0, (40.0, 60.0, 80.0, 130.0), larger_is_better=False)
    margin = gate_scale(-20.0, 40.0, 0.0, (-20.0, -10.0, 10.0, 20.0, 40.0))
    current = gate_scale(0.5 * limit, 1.5 * limit, limit, (0.5 * limit, 1.5 * limit), larger_is_better=False)
    for name, title, label, gate, scale, of in (
        ("limits", "Use of the nearest limit", "Largest use [%]", "the limit", used, lambda one: 100.0 * one.used),
        (
            "modulation",
            "Margin of the modulation index",
            "Least margin [%]",
            "no margin",
            margin,
            lambda one: 100.0 * one.modulation_margin,
        ),
        (
            "current",
            "Current at rest",
            "Largest current [pu]",
            "the limit" if c.current_limit_pu is not None else "rated",
            current,
            lambda one: rms_to_peak(one.I_rms) / c.I_rated_pk,
        ),
    ):
        for k, some in enumerate(groups(flows, _PANELS)):
            panels = [Panel(one.controller, _worst(one, of(one), scale)) for one in some]
            caption = (
                f"How to read: each cell is a grid, its colour the worst of its {one_word(flows[0])}. A dot: some of "
                f"them have no rest. Crosses: none has. The black line is {gate}."
            )
            frame = Frame(
                f"power_flow_{name}" if k == 0 else f"power_flow_{name}_{k + 1}",
                title,
                caption,
                f"SCR, {flows[0].axes.scr_basis} basis [1]",
                "X/R [1]",
                label,
                1,
                gate_label=gate,
                missing_label="no rest at any power",
            )
            yield map_figure(frame, [panels], scale)


def one_word(flow: PowerFlow) -> str:
    """How many combinations of powers each grid has."""
    return counted(flow.axes.shape[2], "combination") + " of P_ref and Q_ref"


def _worst(flow: PowerFlow, values: Array, scale: Scale) -> Cells:
    """Values over SCR × X/R, the worst of the powers that have a rest."""
    field = values.reshape(flow.axes.shape)
    known = ~np.isnan(field)
    filled = np.where(known, field, np.inf if scale.larger_is_better else -np.inf)
    worst = filled.min(axis=2) if scale.larger_is_better else filled.max(axis=2)
    some, nowhere = known.any(axis=2), np.zeros(field.shape[:2], dtype=bool)
    return Cells(
        x=np.array(flow.axes.scr),
        y=np.array(flow.axes.x_over_r),
        values=np.where(some, worst, np.nan),
        unstable=nowhere,
        missing=np.asarray(~some),
        partial=np.asarray(some & ~known.all(axis=2)),
    )
