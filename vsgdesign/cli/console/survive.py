"""A survival measurement for a terminal."""

from __future__ import annotations

from typing import Any

from rich.markup import escape

from vsgdesign.cli.console.scenario import new_console, new_table

_SHOWN = 8
"""Lost cases of each controller that a terminal names."""


def survival_tables(document: dict[str, Any]) -> None:
    """One row for each controller, then the groups in which something was lost, and the first lost cases."""
    console = new_console()
    headings = (
        "controller",
        "survived",
        "stale for ever",
        "left out",
        "largest current [pu]",
        "first 5 ms [pu]",
        "recovery [s]",
        "worst [s]",
        "swing [rad]",
    )
    table = new_table(f"{document['title']}: limit {document['limit_pu']:g} pu", headings, left=("controller",))
    for name, one in document["variants"].items():
        near, ever, T = one["stale_to_1_s"], one["for_ever"], one["settling_time"]
        left = sum(figures["cases"] - figures["judged"] for figures in (near, ever))
        table.add_row(
            escape(name),
            _share(near),
            _share(ever),
            str(left),
            _number(near["peak_pu"]),
            _number(near["first_peak_pu"]),
            _number(near["recovery_median"], T),
            _number(near["recovery_worst"], T),
            _number(near["swing_rad"]),
        )
    console.print(table)
    for name, one in document["variants"].items():
        lost = [
            f"{group} {figures['judged'] - figures['survived']} of {figures['judged']}"
            for group, figures in one["groups"].items()
            if figures["survived"] < figures["judged"]
        ]
        if lost:
            console.print(escape(f"{name} loses: {', '.join(lost)}"), highlight=False)
        for case in one["lost"][:_SHOWN]:
            console.print(escape(f"  {case['case']}: {case['status']}: {case['reason']}"), highlight=False)
        if len(one["lost"]) > _SHOWN:
            console.print(f"  … and {len(one['lost']) - _SHOWN} more in cases.csv", highlight=False)


def _share(figures: dict[str, Any]) -> str:
    if not figures["judged"]:
        return "–"
    return f"{figures['survived']}/{figures['judged']} ({100.0 * figures['share']:.1f} %)"


def _number(value: float | None, factor: float = 1.0) -> str:
    return "–" if value is None else f"{factor * value:.3g}"
