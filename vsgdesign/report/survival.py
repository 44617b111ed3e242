"""The page of a survival measurement, and what a terminal prints of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vsgdesign.artifacts.definitions import MORE_THAN_HARDWARE
from vsgdesign.errors import counted, share_percent
from vsgdesign.metrics.survival import HARDWARE_PU
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.panels import counts_figure
from vsgdesign.report.drawing.quantities import DASH, plain
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
    Block,
    Box,
    Heading,
    Page,
    Span,
    Table,
    Where,
    words,
)
from vsgdesign.report.page.converter import dc_link_text
from vsgdesign.report.page.live import StaticPage, linked_to_case, try_it, way_to_it

_SHOWN = 8
"""Lost cases of each controller that a terminal names."""
_ON_PAGE = 100
"""Lost cases of each controller that the page names; cases.csv has all of them."""
LIMITS = (
    "The systematic disturbances are a fixed set, so that their share is no probability; vsgdesign verify bounds one.",
    "A disturbance without a rest within the current limit, before or after it, is left out: nothing could survive it.",
    "Devices are ideal.",
)


def survival_blocks(document: Mapping[str, Any]) -> list[Block]:
    """What a terminal prints: one row for each controller, the groups in which something was lost, the first cases."""
    lines = [line for name, one in document["variants"].items() for line in (*_lost(name, one), *_beyond(name, one))]
    same = 'The same verdict on random disturbances, with a bound: vsgdesign verify, in its rows "Survival".'
    return [_overview(document), words(*lines, same, on=Where.TERMINAL)]


def survival_figure(document: Mapping[str, Any]) -> NamedFigure:
    """The groups of disturbances by controller, as a picture: survived of judged."""
    variants = document["variants"]
    names = list(dict.fromkeys(group for one in variants.values() for group in one["groups"]))
    nothing = {"survived": 0, "judged": 0}
    rows = {
        name: [
            (figures["survived"], figures["judged"])
            for figures in (one["groups"].get(name, nothing) for one in variants.values())
        ]
        for name in names
    }
    caption = "Disturbances that are survived, of those that were judged. Framed: something was lost."
    return counts_figure("survival", "Survived of those that were judged", caption, rows, list(variants))


def survival_page(document: Mapping[str, Any], live: StaticPage | None = None) -> Page:
    """The page: the answer, every controller, the live part, the groups, and every lost case with its reason."""
    variants = document["variants"]
    beyond = [line for name, one in variants.items() for line in _beyond(name, one)]
    lost = any(one["lost"] for one in variants.values())
    blocks: list[Block] = [
        words(_simulated(document)),
        *way_to_it(live),
        Box((words(*map(_headline, variants, variants.values()), style=HEADLINE), _overview(document)), warning=lost),
        *try_it(live, document["title"]),
        Heading("Groups of disturbances"),
        _groups(variants),
        Heading("What was lost"),
        *[block for name, one in variants.items() for block in _lost_table(name, one, live)],
        *([] if lost else [words("Nothing was lost.")]),
        *([Heading("More current than hardware carries"), words(*beyond)] if beyond else []),
        Heading("Limits of validity"),
        words(
            *LIMITS,
            dc_link_text(document.get("dc_source")),
            f"The bridge is {_BRIDGES[document['bridge']]}.",
            style=BULLETS,
        ),
        words(("Every case is a row of ", Span("cases.csv", link="cases.csv"), ".")),
    ]
    origin = ("Study ", Span(document["study"], code=True), f", seed {document['seed']}.")
    return Page(f"{document['title']}: survival", blocks, origin)


def survival_sentences(document: Mapping[str, Any]) -> list[str]:
    """What the page says first: how much each controller survives, and with which currents."""
    variants = document["variants"]
    return [*map(_headline, variants, variants.values()), *(line for one in variants.items() for line in _beyond(*one))]


def _simulated(document: Mapping[str, Any]) -> str:
    """What a disturbance is."""
    if "units" not in document:
        return "Each disturbance is a complete EMT simulation of converter, filter, controller and grid."
    units = counted(document["units"], "unit")
    return (
        f"Each disturbance is a complete EMT simulation of the grid and of {units} at one node, each with its filter "
        "and its controller. Short-circuit ratios are on the rating of the plant. The plant survives where every unit "
        "does that is on line at the end, and a current is the largest one of any unit."
    )


_BRIDGES = {"averaged": "averaged over a sampling period", "pwm": "switched"}


def _headline(name: str, one: Mapping[str, Any]) -> str:
    survived, judged = (sum(one[part][key] for part in ("stale_to_1_s", "for_ever")) for key in ("survived", "judged"))
    if not judged:
        return f"{name}: no disturbance was judged."
    if survived == judged:
        return f"{name} survives all of {counted(judged, 'disturbance')}."
    said = f"{name} survives {survived} of {counted(judged, 'disturbance')} and loses {judged - survived}."
    return " ".join((said, *_outside(one)))


def _outside(one: Mapping[str, Any]) -> list[str]:
    """How many of the lost cases have a grid for which the gain table is not made."""
    outside = sum(case.get("outside_table", False) for case in one["lost"])
    if not outside:
        return []
    scr, x_over_r = (f"{plain(low)} to {plain(high)}" for low, high in (one["table"]["scr"], one["table"]["x_over_r"]))
    count = "All" if outside == len(one["lost"]) else f"{outside}"
    return [f"{count} of these begin or end on a grid outside of its table (SCR {scr}, X/R {x_over_r})."]


def _overview(document: Mapping[str, Any]) -> Table:
    """One row for each controller."""
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
    return Table(title, head, rows, on=Where.BOTH)


def _groups(variants: Mapping[str, Any]) -> Table:
    names = list(dict.fromkeys(group for one in variants.values() for group in one["groups"]))
    nothing = {"judged": 0}
    rows = [(name, *(_share(one["groups"].get(name, nothing)) for one in variants.values())) for name in names]
    return Table("Survived of those that were judged", ("Group", *variants), tuple(rows))


def lost_label(controller: str, group: str, case: str) -> str:
    """What a lost case is called on the page that simulates."""
    return f"{controller}: {group}, {case}"


def _lost_table(name: str, one: Mapping[str, Any], live: StaticPage | None) -> list[Block]:
    lost = one["lost"]
    if not lost:
        return []
    rows = tuple(
        (
            case["group"],
            linked_to_case(case["case"], live, lost_label(name, case["group"], case["case"])),
            case["status"],
            case["reason"],
        )
        for case in lost[:_ON_PAGE]
    )
    more = len(lost) - len(rows)
    notes = (f"{counted(more, 'more case')} of {name}: see cases.csv.",) if more else ()
    return [Table(f"Lost by {name}", ("Group", "Disturbance", "How", "Why"), rows, texts=4, notes=notes)]


def _row(name: str, one: Mapping[str, Any]) -> tuple[str, ...]:
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


def _lost(name: str, one: Mapping[str, Any]) -> list[str]:
    lost = [
        f"{group} {figures['judged'] - figures['survived']} of {figures['judged']}"
        for group, figures in one["groups"].items()
        if figures["survived"] < figures["judged"]
    ]
    lines = [". ".join((f"{name} loses: {', '.join(lost)}", *_outside(one)))] if lost else []
    lines += [f"  {case['case']}: {case['status']}: {case['reason']}" for case in one["lost"][:_SHOWN]]
    more = len(one["lost"]) - _SHOWN
    return [*lines, f"  … and {more} more in cases.csv"] if more > 0 else lines


def _beyond(name: str, one: Mapping[str, Any]) -> list[str]:
    """What is survived with currents that hardware does not carry."""
    beyond = one["beyond_hardware"]
    if not beyond:
        return []
    return [
        f"{name} survives, but above {plain(HARDWARE_PU)} pu, {MORE_THAN_HARDWARE}: {counted(len(beyond), 'case')}, up "
        f"to {beyond[0]['peak_pu']:.3g} pu ({beyond[0]['case']})"
    ]


def _share(figures: Mapping[str, Any]) -> str:
    if not figures["judged"]:
        return DASH
    return f"{figures['survived']}/{figures['judged']} ({share_percent(figures['share'])})"


def _number(value: float | None, factor: float = 1.0) -> str:
    return DASH if value is None else f"{factor * value:.3g}"
