"""The output of ``vsgdesign design``: narrow tables in which every column has its heading and unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from vsgdesign.cli.console.scenario import new_console

if TYPE_CHECKING:
    from vsgdesign.design import ClosedFormDesign
    from vsgdesign.parameters import Study

_PLACE = ("controller", "SCR", "X/R")
_FIRST = (("K_ip", "rad/(s²W)"), ("D_p", "W·s/rad"), ("K_iq", "V/(s·var)"), ("D_q", "var/V"))
_REST = (("K_pq", "rad/(s²var)"), ("K_qp", "V/(s·W)"), ("k_P", "rad/(s·W)"), ("k_Q", "rad/(s·var)"))


def design_tables(
    study: Study, designs: Sequence[ClosedFormDesign], missing: Sequence[str] = (), console: Console | None = None
) -> None:
    """Print design points, margins, gains, inertia and droop; ``missing``: sentences on controllers without gains."""
    console = console or new_console()
    points = _table(
        f"{study.title}: design points (SCR on the {study.scr_basis} basis)",
        (("V", "pu"), ("δ", "°"), ("A", "W/rad"), ("D", "var/V"), ("PM of P", "°"), ("PM of Q", "°")),
    )
    gains, more = _table("gains", _FIRST), _table("gains that only coupled structures have", _REST)
    system = _table(
        "inertia and droop",
        (
            ("H", "s"),
            ("P–f droop", "kW/Hz"),
            ("P–f droop", "% of f_n"),
            ("Q–V droop", "kvar/V"),
            ("Q–V droop", "% of V_n"),
        ),
    )
    c = study.converter
    for d in designs:
        place = d.grid.place(study.converter, study.scr_basis)
        where = (d.controller, f"{place.scr:.3g}", f"{place.x_over_r:.3g}")
        mark = "" if d.point.V_within_limits else "!"
        points.add_row(
            *where,
            f"{d.point.V_rms / c.V_rated_rms:.3f}{mark}",
            f"{math.degrees(d.point.delta):.2f}",
            f"{d.point.A:.5g}",
            f"{d.point.D:.5g}",
            _angle(d.margins_P.phase_margin_deg),
            _angle(d.margins_Q.phase_margin_deg),
        )
        gains.add_row(*where, *(f"{value:.5g}" for value in d.gains[:4]))
        if any(d.gains[4:]):
            more.add_row(*where, *(f"{value:.4g}" for value in d.gains[4:]))
        system.add_row(
            *where,
            f"{d.inertia_s:.3g}",
            f"{d.droop_W_per_Hz / 1e3:.4g}",
            _share(c.S_rated, d.gains.D_p * c.omega_n),
            f"{d.gains.D_q / 1e3:.4g}",
            _share(c.S_rated, d.gains.D_q * c.V_rated_rms),
        )
    if designs:
        console.print(points)
        if not all(d.point.V_within_limits for d in designs):
            console.print(f"! the design point needs a voltage outside {c.V_min_pu:g} to {c.V_max_pu:g} pu\n")
        console.print(gains)
        if more.row_count:
            console.print(more)
        console.print(system)
        console.print("Droop in %: the deviation that rated power answers.")
    told = [spec.name for spec in study.controllers if spec.estimate != "truth"]
    if told:
        console.print(escape(f"{', '.join(told)}: estimates the grid; shown with the gains of the true one."))
    for sentence in missing:
        console.print(escape(sentence), soft_wrap=True)


def _table(title: str, columns: Sequence[tuple[str, str]]) -> Table:
    """Put the units below the names, so that the table fits in 80 columns."""
    table = Table(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for name in _PLACE:
        table.add_column(name, justify="left" if name == "controller" else "right", overflow="fold")
    for name, unit in columns:
        table.add_column(escape(f"{name}\n[{unit}]"), justify="right", overflow="fold")
    return table


def _angle(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def _share(rated: float, stiffness: float) -> str:
    """The deviation in per cent that rated power corresponds to; none without droop."""
    if stiffness == 0.0:
        return "none"
    share = 100.0 * rated / stiffness
    return f"{share:.0f}" if share >= 1000.0 else f"{share:.3g}"
