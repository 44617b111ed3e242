"""The page of a sized dc side, and what a terminal prints of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.quantities import DASH, number, plain_quantity, prefix_for
from vsgdesign.report.drawing.style import (
    LABEL_PT,
    NOTE_COLOUR,
    PAGE_IN,
    REFERENCE,
    TEXT_PT,
    add_axes,
    line_style,
    look,
    new_figure,
)
from vsgdesign.report.page.blocks import BULLETS, HEADLINE, Block, Box, Figure, Heading, Page, Span, Table, Where, words

LIMITS = (
    "The sizes are those of these runs: the study's events, in their order, with its duration, or each test of a suite "
    "by itself. Other events need other sizes, and where power flows at rest the energy grows with the duration.",
    "The order decides: first the least power with the given capacitor, then the least capacitor with 10 % more power, "
    "then the least energy. A size that is kept is not searched for. The figure shows what more power saves of the "
    "capacitor.",
    "The bridge is averaged and lossless. Losses of the stage and of the source, and the ripple of the switching "
    "frequency, are not in the sizes.",
)

NEXT_TO_NOTHING_PU = 0.01
"""Power of a source that covers no more than what a filter loses, pu."""

_LEFT, _RIGHT, _BOTTOM, _TOP, _GAP, _HEIGHT = 0.62, 0.12, 0.42, 0.24, 0.78, 2.1


def sizing_sentences(document: Mapping[str, Any]) -> list[str]:
    """The answer in words."""
    size, confirmed = document["size"], document["trials"][0]
    said = (
        f"{document['controller']} needs a {_KINDS[document['source']]} of {_w(size['p_max'])} that takes "
        f"{_w(size['p_charge_max'])}, a "
        f"capacitor of {plain_quantity(_up(size['C']), 'F')} and a usable energy of {_j(size['energy'])}."
    )
    if not confirmed["survived"]:
        return [f"No answer: the full simulation with the sizes that were found is lost: {confirmed['why']}.", said]
    of_tests = _of_tests(document)
    return [
        said,
        *_of_capacitor_alone(document),
        *of_tests,
        f"In the full simulation with these sizes the link stays between {number(confirmed['lowest_v'], 4)} and "
        f"{number(confirmed['highest_v'], 4)} V.",
    ]


def _of_capacitor_alone(document: Mapping[str, Any]) -> list[str]:
    """What a source of next to no power means."""
    if "power" in document["kept"] or document["size"]["p_max"] > NEXT_TO_NOTHING_PU * document["S_rated_w"]:
        return []
    moved = max(abs(document["smallest_p_w"]), abs(document["largest_p_w"]))
    return [
        "At rest the bridge takes next to nothing, and the least power is found first: the source gives the losses "
        f"alone, and the capacitor carries all that the events move, up to {_w(moved)}. For a smaller capacitor, give "
        "a power with --keep."
    ]


_KINDS = {"converter": "source", "battery": "battery"}


def _of_tests(document: Mapping[str, Any]) -> list[str]:
    """For which tests it is sized, and which are left out."""
    tests, left_out = document["tests"], document["left_out"]
    if not tests:
        return []
    said = [f"The sizes are those of {len(tests)} tests of {', '.join(document['suites'])}."]
    if left_out:
        count = f"{len(left_out)} tests are" if len(left_out) > 1 else "One test is"
        first, why = left_out[0]
        others = ", ".join(name for name, _ in left_out[1:3]) + (" and others" if len(left_out) > 3 else "")
        said.append(f"{count} left out. {first}: {why}" + (f" The others: {others}." if others else ""))
    return said


def sizing_page(document: Mapping[str, Any]) -> Page:
    """The page: the answer, the trade-off, the full simulations, the sums by hand."""
    lost = not document["trials"][0]["survived"]
    blocks: list[Block] = [
        Box((words(*sizing_sentences(document), style=HEADLINE), sizes_table(document)), warning=lost),
        Figure(sizing_figure(document)),
        Heading("Confirmed in full simulations"),
        trials_table(document),
        Heading("By hand"),
        hand_table(document),
        Heading("Limits of validity"),
        words(*LIMITS, style=BULLETS),
    ]
    origin = ("Study ", Span(document["study"], code=True), ".")
    return Page(f"{document['title']}: the dc side", blocks, origin)


def sizing_blocks(document: Mapping[str, Any]) -> list[Block]:
    """What a terminal prints."""
    return [words(*sizing_sentences(document), on=Where.TERMINAL), trials_table(document)]


def sizes_table(document: Mapping[str, Any]) -> Table:
    """A table for the supplier."""
    size, S = document["size"], document["S_rated_w"]
    rows = (
        ("Power that the source gives", _w(size["p_max"]), f"{number(size['p_max'] / S, 3)} of the rating"),
        ("Power that it takes", _w(size["p_charge_max"]), _share(size["p_charge_max"] / S)),
        (
            "Capacitor of the link",
            plain_quantity(_up(size["C"]), "F"),
            f"{number(500.0 * size['C'] * document['V_dc_v'] ** 2 / S, 3)} ms of the rating",
        ),
        ("Usable energy", _j(size["energy"]), f"{number(size['energy'] / S, 3)} s of the rating"),
        ("Of this at the start", f"{number(100.0 * size['charge'], 3)} %", ""),
        ("Least power", _w(document["least_power_w"]), f"with {plain_quantity(_up(document['C_given_f']), 'F')}"),
        (
            "The bridge takes",
            f"{_w(document['smallest_p_w'])} to {_w(document['largest_p_w'])}",
            "mean over a sampling period",
        ),
        ("Voltage that the link keeps", f"{number(document['least_v'], 4)} V", _short(document["short"])),
    )
    return Table("Sizes", ("What", "Value", "In other words"), rows, texts=3, on=Where.PAGE)


def _share(share: float) -> str:
    """A power in other words; none where nothing is taken."""
    return f"{number(share, 3)} of the rating" if share > 1e-9 else DASH


def _short(share: float) -> str:
    """What is said of the voltage, and of samples in which an ideal link has not enough."""
    kept = "2 % more than the bridge needs at rest, or V_low"
    return kept if share == 0.0 else f"{kept}; in {number(100.0 * share, 2)} % of the samples V_dc is not enough"


def trials_table(document: Mapping[str, Any]) -> Table:
    """The full simulations."""
    rows = tuple(
        (
            one["what"],
            "survived" if one["survived"] else "lost",
            DASH if one["lowest_v"] is None else number(one["lowest_v"], 4),
            DASH if one["highest_v"] is None else number(one["highest_v"], 4),
            one["why"] or DASH,
        )
        for one in document["trials"]
    )
    head = ("With", "Verdict", "Lowest [V]", "Highest [V]", "Why")
    return Table("Full simulations", head, rows, texts=2, on=Where.BOTH)


def hand_table(document: Mapping[str, Any]) -> Table:
    """Sums for comparison."""
    hand, size = document["by_hand"], document["size"]
    C = hand["C_f"]
    rows = (
        ("Largest change of the power within the lag of the stage", _w(hand["largest_change_w"]), DASH),
        (
            "Capacitor whose energy gives it for this lag",
            DASH if C is None else plain_quantity(_up(C), "F"),
            plain_quantity(_up(size["C"]), "F"),
        ),
    )
    note = (
        "By hand: C = 2 ΔP τ/(V_dc² − V²), where V is the voltage that the link keeps. The loop of the stage is left "
        "out."
    )
    return Table("Sums by hand", ("What", "By hand", "Sized"), rows, notes=(note,))


@look()
def sizing_figure(document: Mapping[str, Any]) -> NamedFigure:
    """The capacitor over the power, and the energy over time."""
    total = _BOTTOM + _HEIGHT + _TOP
    width = (PAGE_IN - _LEFT - _GAP - _RIGHT) / 2.0
    figure = new_figure(PAGE_IN, total)
    pairs = [(p, C) for p, C in document["trade_off"] if C is not None]
    size = document["size"]
    P, p_prefix = prefix_for(size["p_max"])
    F, c_prefix = _small_prefix(size["C"])
    left = add_axes(figure, _LEFT, _BOTTOM, width, _HEIGHT)
    left.plot([p / P for p, _ in pairs], [C / F for _, C in pairs], marker="o", markersize=3.0, **line_style(0))
    left.plot([size["p_max"] / P], [size["C"] / F], linestyle="", marker="s", markersize=5.0, color="#D55E00")
    left.annotate(
        "chosen",
        (size["p_max"] / P, size["C"] / F),
        (6, 6),
        textcoords="offset points",
        fontsize=TEXT_PT,
        color=NOTE_COLOUR,
    )
    left.set_ylim(bottom=0.0)
    left.set_xlabel(f"Power of the source [{p_prefix}W]", fontsize=LABEL_PT)
    left.set_ylabel(f"Least capacitor [{c_prefix}F]")
    left.set_title("More power saves capacitor")
    right = add_axes(figure, _LEFT + width + _GAP, _BOTTOM, width, _HEIGHT)
    times, given = np.array(document["energy_given"]).T
    J, j_prefix = prefix_for(max(float(np.abs(given).max()), 1e-9))
    right.plot(times, given / J, **line_style(0))
    for value in (float(given.max()), float(given.min())):
        right.axhline(value / J, **REFERENCE)
    right.set_xlabel("Time [s]")
    right.set_ylabel(f"Energy given by the source [{j_prefix}J]")
    right.set_title("The energy is the distance of the dashed lines")
    caption = (
        "Left: the least capacitor with which all events are survived, over the power of the source; the square is the "
        "chosen pair. Right: what the source has given since the start, with the chosen pair."
    )
    return NamedFigure("dc_side", "Power, capacitor and energy", caption, figure)


def _small_prefix(value: float) -> tuple[float, str]:
    """The factor and the prefix of a capacitor's axis."""
    return next(((f, p) for f, p in ((1.0, ""), (1e-3, "m"), (1e-6, "µ")) if value >= f), (1e-9, "n"))


def _w(value: float) -> str:
    return plain_quantity(_up(abs(value)) * (1.0 if value >= 0.0 else -1.0), "W") if abs(value) > 1e-9 else "0 W"


def _j(value: float) -> str:
    return plain_quantity(_up(value), "J")


def _up(value: float) -> float:
    """Three digits, rounded up: a size that is printed is enough."""
    if not math.isfinite(value) or value <= 0.0:
        return value
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / step - 1e-9) * step
