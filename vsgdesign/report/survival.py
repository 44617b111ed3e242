"""A survival measurement as blocks for a terminal."""

from __future__ import annotations

from typing import Any

from vsgdesign.report.page.blocks import Block, Table, Where, words
from vsgdesign.report.quantities import DASH

_SHOWN = 8
"""Lost cases of each controller that a terminal names."""


def survival_blocks(document: dict[str, Any]) -> list[Block]:
    """One row for each controller, then the groups in which something was lost, and the first lost cases."""
    head = (
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
    title = f"{document['title']}: limit {document['limit_pu']:g} pu"
    rows = tuple(_row(name, one) for name, one in document["variants"].items())
    lines = [line for name, one in document["variants"].items() for line in _lost(name, one)]
    return [Table(title, head, rows, on=Where.TERMINAL), words(*lines, on=Where.TERMINAL)]


def _row(name: str, one: dict[str, Any]) -> tuple[str, ...]:
    near, ever, T = one["stale_to_1_s"], one["for_ever"], one["settling_time"]
    return (
        name,
        _share(near),
        _share(ever),
        str(sum(figures["cases"] - figures["judged"] for figures in (near, ever))),
        _number(near["peak_pu"]),
        _number(near["first_peak_pu"]),
        _number(near["recovery_median"], T),
        _number(near["recovery_worst"], T),
        _number(near["swing_rad"]),
    )


def _lost(name: str, one: dict[str, Any]) -> list[str]:
    lost = [
        f"{group} {figures['judged'] - figures['survived']} of {figures['judged']}"
        for group, figures in one["groups"].items()
        if figures["survived"] < figures["judged"]
    ]
    lines = [f"{name} loses: {', '.join(lost)}"] if lost else []
    lines += [f"  {case['case']}: {case['status']}: {case['reason']}" for case in one["lost"][:_SHOWN]]
    more = len(one["lost"]) - _SHOWN
    return [*lines, f"  … and {more} more in cases.csv"] if more > 0 else lines


def _share(figures: dict[str, Any]) -> str:
    if not figures["judged"]:
        return DASH
    return f"{figures['survived']}/{figures['judged']} ({100.0 * figures['share']:.1f} %)"


def _number(value: float | None, factor: float = 1.0) -> str:
    return DASH if value is None else f"{factor * value:.3g}"
