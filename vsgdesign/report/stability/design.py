"""What is known of a study's controllers before a simulation: power flow, design points, gains, inertia and droop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from vsgdesign.report.drawing.figure_types import WrittenFigure
from vsgdesign.report.drawing.quantities import DASH
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
from vsgdesign.report.stability.power_flow import NOTE, flow_headline, flow_table

if TYPE_CHECKING:
    from vsgdesign.design import ClosedFormDesign
    from vsgdesign.design.study_design import StudyDesign
    from vsgdesign.study.parameters import Study


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
        f"{math.degrees(d.point.delta):.2f}",
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
