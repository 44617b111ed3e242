"""A comparison for a terminal."""

from __future__ import annotations

import math
from typing import Any

from rich.markup import escape

from vsgdesign.cli.console.scenario import new_console, new_table
from vsgdesign.parameters.specification import UNBOUNDED_H


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
        f"overshoot ≤ {100.0 * spec['overshoot']:.3g} %, settling ≤ {spec['settling_time']:.3g} s, "
        f"disk margin ≥ {spec['disk_margin']:.3g}, damping ratio ≥ {spec['damping_ratio']:.3g}"
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
            escape(c["name"].replace("_", " ")),
            c["origin"],
            _share(c["kept_exact"]),
            _share(c["kept_wrong"]),
            _share(c["kept_exact_ideal"]),
            _share(c["kept_wrong_ideal"]),
            _share(c["shares"]["unstable"]),
            _pair(exact, wrong, "overshoot", 100.0),
            _pair(exact, wrong, "settling_time", 1.0),
            _pair(exact, wrong, "disk_margin", 1.0),
            _span(c["droop_W_per_Hz"], 1e3),
            _span(c["inertia_s"], 1.0),
            _number(emt["overshoot"], 100.0),
            _number(emt["settling_time"], 1.0),
            f"{emt['not_settled']} of {emt['steps']}" if emt["steps"] else "–",
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
            console.print(
                f"{escape(c['name'].replace('_', ' '))} violates, with the number of grids: {reasons}", highlight=False
            )


def _share(value: float) -> str:
    shown = min(max(100.0 * value, 1.0), 99.0) if 0.0 < value < 1.0 else 100.0 * value
    return f"{shown:.0f} %"


def _number(value: float, factor: float) -> str:
    if math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{factor * value:.3g}"


def _pair(exact: dict[str, float], wrong: dict[str, float], name: str, factor: float) -> str:
    return f"{_number(exact[name], factor)} / {_number(wrong[name], factor)}"


def _span(limits: tuple[float, float] | None, factor: float) -> str:
    if limits is None:
        return "–"
    low, high = (f"{value / factor:.3g}" for value in limits)
    return low if low == high else f"{low} … {high}"
