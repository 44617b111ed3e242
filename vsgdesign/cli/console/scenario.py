"""Tables for a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table


def new_console() -> Console:
    """The terminal with its own width. Without a terminal (a pipe, a log), it is wide enough for every table."""
    console = Console()
    return console if console.is_terminal else Console(width=160)


def new_table(title: str, headings: Sequence[str], left: Sequence[str] = ()) -> Table:
    table = Table(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in headings:
        table.add_column(escape(heading), justify="left" if heading in left else "right", overflow="fold")
    return table


def stability_tables(document: dict[str, Any]) -> None:
    """The worst cells over the maps, and the details of every controller."""
    console = new_console()
    worst = new_table(
        f"{document['study']['title']}: worst cells over the maps (SCR on the {document['scr_basis']} basis)",
        ("controller", "model", "quantity", "value", "misses gate", "where"),
        left=("controller", "model", "quantity", "where"),
    )
    close = new_table(
        "at the study's grids, full order",
        ("controller", "grid", "least stable mode", "damping", "disk margin", "GM P", "PM P", "GM Q", "PM Q", "M_s"),
        left=("controller", "grid"),
    )
    for name, controller in document["controllers"].items():
        for model, rows in controller["worst"].items():
            for row in rows:
                missing = row["value"] is None or math.isnan(row["value"])
                share = row["share_below"]
                worst.add_row(
                    name,
                    model,
                    row["quantity"],
                    "unstable" if missing and row["where"] else _cell(row["value"], ".3g", f" {row['unit']}".rstrip()),
                    "–" if share is None or math.isnan(share) else f"{100.0 * share:.0f} %",
                    row["where"],
                )
        for cell in controller["cells"]:
            mode, margins = cell["modes"][0], cell["margins"]["full_order"]
            loops = margins["loops"]
            close.add_row(
                name,
                cell["label"] + (" !" if cell["outside_the_limits"] else ""),
                f"{mode['real']:.3g} ± {abs(mode['imag']):.3g}j",
                f"{margins['least_damping']:.3f}",
                _finite(margins["disk_margin_output"], ".2f", ""),
                _finite(loops["P"]["gain_margin_db"], ".1f", " dB"),
                _finite(loops["P"]["phase_margin_deg"], ".1f", "°"),
                _finite(loops["Q"]["gain_margin_db"], ".1f", " dB"),
                _finite(loops["Q"]["phase_margin_deg"], ".1f", "°"),
                _finite(margins["M_s"], ".2f", ""),
            )
    console.print(worst)
    for name, controller in document["controllers"].items():
        counts = [f"{one['outside']} of {one['cells']}" for one in controller["outside_the_limits"].values()]
        if any(one["outside"] for one in controller["outside_the_limits"].values()):
            shown = " and ".join(dict.fromkeys(counts))
            console.print(
                f"{escape(name)}: {shown} cells are outside the converter's limits of voltage or current and count for "
                "nothing above"
            )
    console.print(close)
    for name, controller in document["controllers"].items():
        for cell in controller["cells"]:
            if cell["outside_the_limits"]:
                console.print(f"! {escape(name)}, {cell['label']}: outside the limits, {cell['outside_the_limits']}")
    verdicts = [row["verdict"] for row in document["verdicts"]]
    counts = ", ".join(f"{verdicts.count(kind)} {kind}" for kind in dict.fromkeys(verdicts))
    console.print(f"gates (ours, no grid code): {counts}")


def _finite(value: float | None, form: str, unit: str) -> str:
    """A number, ∞ if there is no crossing, and a dash if there is no value."""
    if value is None or math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{value:{form}}{unit}"


def _cell(value: float | None, form: str, unit: str, none: str = "–") -> str:
    return none if value is None else f"{value:{form}}{unit}"
