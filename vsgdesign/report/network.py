"""The page of a grid that was found in a network model: the answer, the plane of SCR and X/R, and over frequency."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from vsgdesign.errors import counted
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure
from vsgdesign.report.drawing.look import round_numbers
from vsgdesign.report.drawing.quantities import DASH, plain, plain_quantity
from vsgdesign.report.drawing.style import (
    COLOURS,
    COLUMN_IN,
    LIMITS_BAND,
    NOTE_COLOUR,
    REFERENCE,
    TEXT_PT,
    add_axes,
    look,
    new_figure,
)
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
    drawings,
    words,
)

_SHOWN = 10
"""Outages that a terminal names."""
_LOST = 5
"""Outages without a path that a sentence names."""
_WEAKER = 0.99
"""An outage counts as weaker where SCR is below this share of that with everything in."""
_NAMED = 3
"""Outages that the figure names: the weakest ones."""

LIMITS = (
    "The impedance comes from the Y matrix of the network at its nominal frequency: sources are short circuits behind "
    "their impedances and converters are open. No factor of a short-circuit standard is in it, and the operating point "
    "of the network is not.",
    "Over frequency a reactance grows with f and a capacitance falls with it. Resistances stay as they are, so that a "
    "resonance is damped more in the real network. A line is one π element: where it is long, a resonance above some "
    "hundred hertz is rough.",
    "The tables of vsgdesign know R and L in series. A resonance within the bandwidth of the inner loops is not there.",
)


def grid_sentences(document: Mapping[str, Any]) -> list[str]:
    """The answer: N, the outages, what is near, what is left out, and the first resonance."""
    n, known = document["cases"][0], [one for one in document["cases"] if one["scr"] is not None]
    voltage = f" ({plain_quantity(document['V_n_ll_rms'], 'V')})" if document["V_n_ll_rms"] else ""
    S_sc, S = (plain_quantity(value, "VA") for value in (n["S_sc"], document["S"]))
    said = [
        f"At {document['bus']}{voltage} the network has a short-circuit power of {S_sc} with everything in: SCR "
        f"{plain(n['scr'], 3)} and X/R {plain(n['x_over_r'], 3)} for {S}."
    ]
    outages = [one for one in known if one["out"]]
    if outages:
        weakest = min(outages, key=lambda one: one["scr"])
        (a, b), (c, d) = document["scr"], document["x_over_r"]
        said.append(
            f"Over {counted(len(outages), 'outage')} SCR is {plain(a, 3)} to {plain(b, 3)} and X/R {plain(c, 3)} to "
            f"{plain(d, 3)}; {_weakest(n, weakest)}."
        )
    lost = [one["name"] for one in document["cases"] if one["scr"] is None]
    if lost:
        more = f" and in {len(lost) - _LOST} more outages" if len(lost) > _LOST else ""
        said.append(f"No path leads to a source {', '.join(lost[:_LOST])}{more}; the box is without these.")
    said += [_near(document), _loads(document), _resonance(document)]
    if not document["f_n_given"]:
        f_n = plain_quantity(document["f_n"], "Hz")
        said.append(f"The file does not give the nominal frequency: it is taken as {f_n}.")
    return [sentence for sentence in said if sentence]


def _weakest(n: Mapping[str, Any], weakest: Mapping[str, Any]) -> str:
    if weakest["scr"] > _WEAKER * n["scr"]:
        return "none makes the bus weaker by 1 %"
    return f"the weakest case is {weakest['name']}"


def _near(document: Mapping[str, Any]) -> str:
    near, count = document["converters"], document["converters_in_all"]
    if not near:
        return f"None of {counted(count, 'converter')} in the network is near." if count else ""
    first, share = near[0], 100.0 * near[0]["share"]
    is_are = "converter is" if len(near) == 1 else "converters are"
    return (
        f"{len(near)} {is_are} near, of which {first['name']} at {first['bus']} sees {share:.0f} % of a change of the "
        "voltage here. A converter that finds its grid with a probe has to share the probe's lines with them."
    )


def _loads(document: Mapping[str, Any]) -> str:
    count = document["network"]["loads"]
    if not count:
        return ""
    is_are = "is" if count == 1 else "are"
    return f"{counted(count, 'load')} {'count as impedances' if document['loads'] else f'{is_are} left out'}."


def _resonance(document: Mapping[str, Any]) -> str:
    last = plain_quantity(document["last_hz"], "Hz")
    if not document["capacitance"]:
        return "Nothing in the network has a capacitance, so there is no resonance."
    if document["resonance_hz"] is None:
        return f"There is no parallel resonance up to {last}."
    return f"The first parallel resonance with everything in is at {plain_quantity(document['resonance_hz'], 'Hz', 3)}."


def grid_figures(document: Mapping[str, Any]) -> Iterator[NamedFigure]:
    """The plane of SCR and X/R, and the impedance over frequency where there are capacitances."""
    with look():
        yield _plane(document)
        if document["capacitance"]:
            yield _over_frequency(document)


def _plane(document: Mapping[str, Any]) -> NamedFigure:
    from matplotlib.patches import Rectangle

    left, right, bottom, top, height = 0.5, 0.12, 0.42, 0.3, 2.3
    figure = new_figure(COLUMN_IN, bottom + height + top)
    axes: Any = add_axes(figure, left, bottom, COLUMN_IN - left - right, height)
    known = [one for one in document["cases"] if one["scr"] is not None]
    outages = [one for one in known if one["out"]]
    n, nodes = known[0], document["nodes"]
    (a, *_, b), (c, *_, d) = nodes["scr"], nodes["x_over_r"]
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.add_patch(Rectangle((a, c), b - a, d - c, **LIMITS_BAND, label="box of the table"))
    axes.plot(
        [one["scr"] for one in outages],
        [one["x_over_r"] for one in outages],
        linestyle="",
        marker="o",
        markersize=3.5,
        markerfacecolor="none",
        color=COLOURS[0],
        label=f"outages ({len(outages)})",
    )
    axes.plot([n["scr"]], [n["x_over_r"]], linestyle="", marker="D", markersize=4.5, color=COLOURS[1], label="N")
    axes.set_xlim(*_around(a, b))
    axes.set_ylim(*_around(c, d))
    middle = math.sqrt(math.prod(axes.get_xlim()))
    for one in _far_apart(outages, document):
        right_of = one["scr"] < middle
        axes.annotate(
            one["name"],
            (one["scr"], one["x_over_r"]),
            (4.0 if right_of else -4.0, 4.0),
            textcoords="offset points",
            ha="left" if right_of else "right",
            fontsize=TEXT_PT - 1.0,
            color=NOTE_COLOUR,
        )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(_few_ticks(axis.get_view_interval()))
        axis.set_minor_locator(_no_ticks())
        axis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlabel(f"SCR for {plain_quantity(document['S'], 'VA')} [1]")
    axes.set_ylabel("X/R [1]")
    total = bottom + height + top
    figure.legend(ncols=3, loc="upper left", bbox_to_anchor=(left / COLUMN_IN, 1.0 - 0.06 / total))
    caption = (
        f"The grid at {document['bus']} with everything in (N) and in {counted(len(outages), 'outage')}, and the box "
        "of a table that holds all of them. The weakest outages are named."
    )
    return NamedFigure("grid_plane", "The grid over all outages", caption, figure, 1)


def _far_apart(outages: Sequence[Mapping[str, Any]], document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The weakest outages whose names do not stand on each other."""
    low, high = document["x_over_r"]
    span = max(math.log(high / low), 1e-9)
    chosen: list[Mapping[str, Any]] = []
    for one in sorted(outages, key=lambda one: one["scr"]):
        apart = all(abs(math.log(one["x_over_r"] / other["x_over_r"])) > 0.08 * span for other in chosen)
        if apart and len(chosen) < _NAMED and one["scr"] <= _WEAKER * document["cases"][0]["scr"]:
            chosen.append(one)
    return chosen


def _around(low: float, high: float) -> tuple[float, float]:
    room = max((high / low) ** 0.15, 1.15)
    return low / room, high * room


def _few_ticks(interval: tuple[float, float]) -> Any:
    from matplotlib.ticker import FixedLocator

    low, high = sorted(interval)
    steps = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
    ticks = round_numbers(low, high, steps)
    coarse = [one for one in ticks if f"{one:.0e}"[0] in "125" and f"{one:e}"[1:4] == ".00"]
    return FixedLocator(coarse if len(coarse) >= 3 else ticks[:: max(1, len(ticks) // 6)])


def _no_ticks() -> Any:
    from matplotlib.ticker import NullLocator

    return NullLocator()


def _over_frequency(document: Mapping[str, Any]) -> NamedFigure:
    left, right, bottom, top, height = 0.55, 0.2, 0.4, 0.12, 1.7
    figure = new_figure(COLUMN_IN, bottom + height + top)
    axes: Any = add_axes(figure, left, bottom, COLUMN_IN - left - right, height)
    found = document["impedance"]
    f_hz = found["f_hz"]
    sizes = [math.hypot(R, X) for R, X in zip(found["R"], found["X"], strict=True)]
    n = document["cases"][0]
    L = n["X"] / document["f_n"]
    axes.semilogy(f_hz, sizes, color=COLOURS[0], label="network")
    axes.semilogy(f_hz, [math.hypot(n["R"], L * f) for f in f_hz], **REFERENCE, label="R and L of the table")
    if document["resonance_hz"] is not None:
        axes.axvline(document["resonance_hz"], color=COLOURS[1], linewidth=0.7)
    axes.set_xlim(0.0, document["last_hz"])
    axes.set_xlabel("Frequency [Hz]")
    axes.set_ylabel("|Z| [Ω]")
    axes.legend(loc="upper left", borderaxespad=0.6)
    caption = f"The impedance at {document['bus']} with everything in, and R and L in series as the table knows them. "
    caption += "The vertical line is the first parallel resonance." if document["resonance_hz"] is not None else ""
    return NamedFigure("grid_frequency", "Impedance over frequency", caption.strip(), figure, 2)


def grid_page(document: Mapping[str, Any], figures: Sequence[WrittenFigure] = ()) -> Page:
    """The page, of which a terminal prints the answer, the outages and what is near."""
    first, *others = grid_sentences(document)
    blocks: list[Block] = [
        Box(
            (
                words(first, style=HEADLINE, on=Where.BOTH),
                words(*others, style=BULLETS, on=Where.BOTH),
            ),
            anchor="answer",
        ),
        *drawings(figures, 1),
        _cases(document),
        _sources(document),
        *([_converters(document)] if document["converters"] else []),
        *([Heading("Over frequency"), *drawings(figures, 2)] if document["capacitance"] else []),
        Heading("Limits of validity"),
        words(*LIMITS, style=BULLETS),
        words(("Every case is a row of ", Span("cases.csv", link="cases.csv"), ".")),
    ]
    origin = ("Network ", Span(document["network"]["file"], code=True), f", read by {document['network']['program']}.")
    return Page(f"Grid at {document['bus']}", blocks, origin)


def _cases(document: Mapping[str, Any]) -> Table:
    n, *others = document["cases"]
    others.sort(key=lambda one: math.inf if one["scr"] is None else one["scr"])
    rows = tuple(
        (
            one["name"],
            *(DASH if one[key] is None else plain(one[key], 4) for key in ("R", "X")),
            DASH if one["S_sc"] is None else plain(one["S_sc"] / 1e6, 4),
            *(DASH if one[key] is None else plain(one[key], 3) for key in ("scr", "x_over_r")),
        )
        for one in (n, *others)
    )
    head = ("case", "R [Ω]", "X [Ω]", "S_sc [MVA]", "SCR", "X/R")
    return Table("N, then the weakest outages", head, rows, on=Where.BOTH, most=_SHOWN)


def _sources(document: Mapping[str, Any]) -> Table:
    rows = tuple(
        (
            one["name"],
            one["kind"],
            one["bus"],
            plain(one["S_sc_min"] / 1e6, 4),
            plain(one["S_sc_max"] / 1e6, 4),
            DASH if one["x_over_r_min"] is None else plain(one["x_over_r_min"], 3),
        )
        for one in document["sources"]
    )
    head = ("source", "kind", "bus", "least S_sc [MVA]", "largest S_sc [MVA]", "X/R")
    return Table("Sources behind their impedances", head, rows, texts=3)


def _converters(document: Mapping[str, Any]) -> Table:
    rows = tuple(
        (
            one["name"],
            one["bus"],
            DASH if one["S"] is None else plain(one["S"] / 1e6, 3),
            f"{100.0 * one['share']:.0f} %",
        )
        for one in document["converters"]
    )
    head = ("converter", "bus", "S [MVA]", "of a change of the voltage")
    return Table("Converters nearby", head, rows, texts=2, on=Where.BOTH, most=_SHOWN)
