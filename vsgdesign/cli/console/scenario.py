"""Tables for a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from vsgdesign.artifacts.table_summary import table_lines


def new_console() -> Console:
    """The terminal with its own width. Without a terminal (a pipe, a log), it is wide enough for every table."""
    console = Console()
    return console if console.is_terminal else Console(width=160)


def new_table(title: str, headings: Sequence[str], left: Sequence[str] = ()) -> Table:
    table = Table(title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in headings:
        table.add_column(escape(heading), justify="left" if heading in left else "right", overflow="fold")
    return table


_NO_TIME = {
    "measured": "not settled",
    "not settled": "not settled",
    "window too short": "too short",
    "unstable": "unstable",
    "no steady state": "no rest",
    "diverged": "diverged",
    "no model": "no model",
}
"""The word in place of a settling time, by the status of the event."""


def results_tables(results: dict[str, Any]) -> None:
    """The values of every reference step and disturbance of a run: on the raw signal, or on its mean over whole cycles
    if the grid source is distorted or a controller sends a probe."""
    headings = ("controller", "at", "event", "signal", "overshoot", "settles 2 %", "rise", "peak current")
    from vsgdesign.metrics import mean_in_words

    means = any(controller["distorted"] for controller in results["controllers"].values())
    means = means or results["mean_cycles"] > 1
    title = results["study"]["title"] + (f" ({mean_in_words(results['mean_cycles'])}s)" if means else "")
    table = new_table(title, headings, left=("controller", "event", "signal"))
    reasons: dict[str, list[str]] = {}
    for name, controller in results["controllers"].items():
        for event in controller["events"]:
            if event["reason"] is not None:
                who = f"{name}, {event['t_s']:g} s, {event['signal']}"
                reasons.setdefault(event["reason"], []).append(who)
            figures = event["cycle_mean"] if means else event
            if event["kind"] == "disturbance" and figures["settling_time_s"] == 0.0:
                continue  # the other signal never left its band: nothing to see
            table.add_row(
                name,
                f"{event['t_s']:g} s",
                escape(event["name"]),
                event["signal"],
                _cell(figures["overshoot_pct"], ".1f", " %"),
                _cell(figures["settling_time_s"], ".3f", " s", none=_NO_TIME[event["status"]]),
                _cell(figures["rise_time_s"], ".3f", " s"),
                _cell(event["peak_current_pu"], ".2f", " pu"),
            )
    console = new_console()
    for name, controller in results["controllers"].items():
        if controller["table"] is not None:
            lines = (escape(line) for line in table_lines(name, controller["table"]))
            console.print("\n".join(lines), highlight=False, soft_wrap=True)
    console.print(table if table.row_count else f"{escape(results['study']['title'])}: no event to measure")
    for reason, who in reasons.items():
        console.print(f"{escape('; '.join(who))}: {escape(reason)}", soft_wrap=True)
    for name, controller in results["controllers"].items():
        if controller.get("survival") is not None:
            from vsgdesign.metrics.survival import Survival
            from vsgdesign.report.scenario.survived import survival_sentence

            sentence = survival_sentence(name, Survival(**controller["survival"]))
            console.print(escape(sentence), highlight=False, soft_wrap=True)
        limit = (controller["estimate"] or {}).get("rate_limit")
        if limit and limit["held_s"]:
            from vsgdesign.report.scenario.estimate_tables import rate_limit_text

            console.print(escape(rate_limit_text(name, *limit.values())))


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
