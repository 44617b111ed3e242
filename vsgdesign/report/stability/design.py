"""What is known of a study's controllers before a simulation: power flow with what limits it, design points, gains,
inertia and droop."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.study_design import PowerFlow
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.errors import counted
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure
from vsgdesign.report.drawing.look import Cells, Scale, gate_scale
from vsgdesign.report.drawing.panels import Frame, Panel, groups, map_figure
from vsgdesign.report.drawing.quantities import DASH, number, percent, plain
from vsgdesign.report.page.blocks import (
    HEADLINE,
    Block,
    Box,
    Heading,
    Page,
    Side,
    Span,
    Table,
    Where,
    drawings,
    words,
)
from vsgdesign.report.page.converter import converter_table, filter_table
from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:
    from vsgdesign.design import ClosedFormDesign
    from vsgdesign.design.study_design import StudyDesign


_PLACE = ("controller", "SCR", "X/R")
_POINT = (("V", "pu"), ("δ", "°"), ("A", "W/rad"), ("D", "var/V"), ("PM of P", "°"), ("PM of Q", "°"))
_FIRST = (("K_ip", "rad/(s²W)"), ("D_p", "W·s/rad"), ("K_iq", "V/(s·var)"), ("D_q", "var/V"))
_REST = (("K_pq", "rad/(s²var)"), ("K_qp", "V/(s·W)"), ("k_P", "rad/(s·W)"), ("k_Q", "rad/(s·var)"))
_SYSTEM = (
    ("H", "s"),
    ("P–f droop", "kW/Hz"),
    ("P–f droop", "% of f_n"),
    ("Q–V droop", "kvar/V"),
    ("Q–V droop", "% of V_n"),
)


def design_blocks(design: StudyDesign) -> list[Block]:
    """Power flow, design points, margins, gains, inertia and droop."""
    study, designs = design.study, design.designs
    found: list[Block] = []
    for flow in design.flows:
        found += [words(flow_headline(flow), on=Where.TERMINAL), flow_table(study, flow)]
    found.append(words(NOTE if design.flows else "", on=Where.BOTH))
    if designs:
        c, on = study.converter, Where.BOTH
        title = f"{study.title}: design points (SCR on the {study.scr_basis} basis)"
        beyond = f"! the design point needs a voltage outside {c.V_min_pu:g} to {c.V_max_pu:g} pu"
        inside = all(d.point.V_within_limits for d in designs)
        more = [(d, [f"{value:.4g}" for value in d.gains[4:]]) for d in designs if any(d.gains[4:])]
        found += [
            _table(study, title, _POINT, [(d, _point(study, d)) for d in designs]),
            words("" if inside else beyond, on=on),
            _table(study, "gains", _FIRST, [(d, [f"{value:.5g}" for value in d.gains[:4]]) for d in designs]),
            *([_table(study, "gains that only coupled structures have", _REST, more)] if more else []),
            _table(study, "inertia and droop", _SYSTEM, [(d, _system(study, d)) for d in designs]),
            words("Droop in %: the deviation that rated power answers.", on=on),
        ]
    told = [spec.name for spec in study.controllers if spec.estimate != "truth"]
    of_estimates = f"{', '.join(told)}: estimates the grid; shown with the gains of the true one." if told else ""
    return [*found, words(of_estimates, *design.missing, on=Where.BOTH)]


def design_page(design: StudyDesign, figures: Sequence[WrittenFigure], data: str) -> Page:
    """The page of a design; ``data`` is the file with every point of the power flow."""
    study = design.study
    blocks: list[Block] = [
        Box((words(*(flow_headline(flow) for flow in design.flows), style=HEADLINE),), anchor="answer"),
        *drawings(figures),
        words(("Every point of the power flow is in ", Span(data, link=data), ".")),
        *design_blocks(design),
        Heading("System"),
        Side((converter_table(design), filter_table(design))),
    ]
    origin = ("Study ", Span(study.name, code=True), ", SHA-256 ", Span(study.hash, code=True), ".")
    return Page(f"{study.title}: design", blocks, origin)


def _table(
    study: Study,
    title: str,
    columns: Sequence[tuple[str, str]],
    rows: Sequence[tuple[ClosedFormDesign, Sequence[str]]],
) -> Table:
    """Units stand below the names, so that the table fits in 80 columns."""
    head = (*_PLACE, *(f"{name}\n[{unit}]" for name, unit in columns))
    return Table(title, head, tuple((*_place(study, d), *cells) for d, cells in rows), on=Where.BOTH)


def _place(study: Study, d: ClosedFormDesign) -> tuple[str, str, str]:
    place = d.grid.place(study.converter, study.scr_basis)
    return d.controller, f"{place.scr:.3g}", f"{place.x_over_r:.3g}"


def _point(study: Study, d: ClosedFormDesign) -> list[str]:
    mark = "" if d.point.V_within_limits else "!"
    return [
        f"{d.point.V_rms / study.converter.V_rated_rms:.3f}{mark}",
        f"{math.degrees(d.point.delta):z.2f}",
        f"{d.point.A:.5g}",
        f"{d.point.D:.5g}",
        _angle(d.margins_P.phase_margin_deg),
        _angle(d.margins_Q.phase_margin_deg),
    ]


def _system(study: Study, d: ClosedFormDesign) -> list[str]:
    c = study.converter
    return [
        f"{d.inertia_s:.3g}",
        f"{d.droop_W_per_Hz / 1e3:.4g}",
        _share_of_rated(c.S_rated, d.gains.D_p * c.omega_n),
        f"{d.gains.D_q / 1e3:.4g}",
        _share_of_rated(c.S_rated, d.gains.D_q * c.V_rated_rms),
    ]


def _angle(value: float | None) -> str:
    return DASH if value is None else f"{value:.1f}"


def _share_of_rated(rated: float, stiffness: float) -> str:
    """The deviation in per cent that rated power corresponds to; none without droop."""
    if stiffness == 0.0:
        return "none"
    share = 100.0 * rated / stiffness
    return f"{share:.0f}" if share >= 1000.0 else f"{share:.3g}"


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
