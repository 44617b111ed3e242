"""A comparison for a terminal: the numbers of its page."""

from __future__ import annotations

from typing import Any

from rich.markup import escape

from vsgdesign.cli.console.scenario import new_console, new_table
from vsgdesign.parameters.specification import UNBOUNDED_H
from vsgdesign.report.comparison.tables import label, reached, share, span
from vsgdesign.report.quantities import DASH, plain


def comparison_table(document: dict[str, Any]) -> None:
    """One row for each contender: share of grids kept, worst values (exact / wrong estimate), droop, inertia, EMT."""
    spec = document["specification"]
    box = spec["box"]
    error = f"±{100.0 * max(box['error_R'], box['error_X']):.3g} %"
    if box["error_Z"]:
        error += f" or ±{100.0 * box['error_Z']:.3g} % of |Z|"
    grids = len(document["contenders"][0]["grids"])
    headings = (
        "gains",
        "from",
        "kept",
        error,
        "ideal",
        error,
        "unstable",
        "overshoot [%]",
        "settling [s]",
        "disk margin",
        "droop [kW/Hz]",
        "H [s]",
        "EMT [%]",
        "EMT [s]",
        "EMT fails",
    )
    asked = (
        f"overshoot ≤ {plain(100.0 * spec['overshoot'])} %, settling ≤ {plain(spec['settling_time'])} s, "
        f"disk margin ≥ {plain(spec['disk_margin'])}, damping ratio ≥ {plain(spec['damping_ratio'])}"
    )
    if spec["H_min"] > 0.0 or spec["H_max"] < UNBOUNDED_H:
        asked += (
            f", H {spec['H_min']:g} to {spec['H_max']:g} s"
            if spec["H_max"] < UNBOUNDED_H
            else (f", H ≥ {spec['H_min']:g} s")
        )
    table = new_table(f"{document['study']['title']}: {asked}", headings, left=("gains", "from"))
    for c in document["contenders"]:
        exact, wrong, emt = c["worst_exact"], c["worst_wrong"], c["emt"]
        table.add_row(
            escape(label(c["name"])),
            c["origin"],
            *(f"{share(c[name])} %" for name in ("kept_exact", "kept_wrong", "kept_exact_ideal", "kept_wrong_ideal")),
            f"{share(c['shares']['unstable'])} %",
            _pair(exact, wrong, "overshoot", 100.0, spec),
            _pair(exact, wrong, "settling_time", 1.0, spec),
            _pair(exact, wrong, "disk_margin", 1.0, spec, at_least=True),
            span(c["droop_W_per_Hz"], 1e3),
            span(c["inertia_s"]),
            reached(emt["overshoot"], 100.0, spec["overshoot"]),
            reached(emt["settling_time"], 1.0, spec["settling_time"]),
            f"{emt['not_settled']} of {emt['steps']}" if emt["steps"] else DASH,
        )
    console = new_console()
    console.print(table)
    console.print(
        f"{grids} grids, worst over powers; exact / wrong estimate; ∞: unstable, without gains, or not settled. "
        "EMT: worst of what settles. kept: with the real inner loops (full order); ideal: with ideal ones, as "
        "overshoot, settling and disk margin are.",
        highlight=False,
    )
    for c in document["contenders"]:
        if c["broken"]:
            reasons = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in c["broken"].items())
            console.print(f"{escape(label(c['name']))} violates, with the number of grids: {reasons}", highlight=False)


def _pair(
    exact: dict[str, float],
    wrong: dict[str, float],
    name: str,
    factor: float,
    spec: dict[str, Any],
    *,
    at_least: bool = False,
) -> str:
    """The worst value with an exact estimate / with a wrong one, each with the digits that its verdict needs."""
    return " / ".join(reached(side[name], factor, spec[name], at_least=at_least) for side in (exact, wrong))
