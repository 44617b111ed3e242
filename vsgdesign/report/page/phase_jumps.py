"""What pages and terminals say of the current after jumps of the grid's phase, from results.json."""

from __future__ import annotations

from typing import Any

from vsgdesign.report.drawing.quantities import number, plain
from vsgdesign.report.page.blocks import Block, Heading, Table, Where, words

_HEAD = ("jump", "by hand", "95 %", "largest", "runs", "95 %", "largest", "runs")


def phase_jump_blocks(document: dict[str, Any] | None, *, numbered: bool = False) -> list[Block]:
    """Heading, answer and table; nothing where no controller limits its current."""
    if document is None:
        return []
    return [
        Heading("Current after a phase jump", numbered=numbered),
        words(*phase_jump_text(document), on=Where.BOTH),
        _table(document),
    ]


def phase_jump_text(document: dict[str, Any]) -> list[str]:
    """The peak against the limit, its cause, and what would lower it, each in one sentence."""
    limit, warned = document["limit_pu"], document["warned"]
    if warned is None:
        return [_no_warning(document)]
    peak, where = warned["p95_pu"], f"A phase jump of {plain(warned['angle_deg'])}° at SCR {plain(warned['scr'])}"
    if peak is None:
        return [f"{where} makes the simulation diverge in more than 5 % of the cases. The inner loops must be mended."]
    lines = [
        f"{where} makes a current of up to {number(peak)} pu in 95 % of the cases (largest "
        f"{number(warned['largest_pu'])} pu), where the limit is {plain(limit)} pu. A trip level below this would act."
    ]
    free = document["all_voltage_pu"]
    if free is not None and free < peak:
        lines.append(
            f"The bridge has {number(document['V_max_pu'])} pu of voltage, while grid and capacitor ring above it. "
            f"With three times the dc voltage the peak would be {number(free)} pu: the missing voltage makes "
            f"{number(peak - free)} pu of the peak, and the delay of the current loop makes the rest above the limit."
        )
    else:
        lines.append("The bridge has enough voltage. The current flows before the sampled current loop can act.")
    helps = [one for one in document["remedies"] if one["helps"]]
    idle = [one for one in document["remedies"] if one["told"] and not one["helps"]]
    untold = [one["change"] for one in document["remedies"] if not one["told"]]
    if helps:
        lines.append(f"What helps, with inner loops designed for it: {_listed(helps)}.")
    if idle:
        lines.append(f"Little is gained, or no more, with inner loops designed for it, by: {_listed(idle)}.")
    if untold:
        lines.append(
            f"Nothing is told of: {'; '.join(untold)}. A short search finds no inner loops that keep all that is asked "
            "of them there, and the current depends on their design. vsgdesign inner --remedies designs them fully."
        )
    return lines


def _no_warning(document: dict[str, Any]) -> str:
    most = [one["p95_pu"] for one in document["peaks"] if one["p95_pu"] is not None]
    if not most:
        return "No phase jump could be simulated: there is no operating point before or after any of them."
    largest, limit = document["peaks"][-1]["angle_deg"], plain(document["limit_pu"])
    return (
        f"After phase jumps of up to {plain(largest)}° the current stays near its limit of {limit} pu: in 95 % of the "
        f"cases it is at most {number(max(most))} pu."
    )


def _listed(remedies: list[dict[str, Any]]) -> str:
    return "; ".join(f"{one['change']} ({_left(one)})" for one in remedies)


def _left(remedy: dict[str, Any]) -> str:
    """The peak that a remedy leaves, and whether its inner loops keep what is asked of them."""
    said = "more than 5 % diverge" if remedy["p95_pu"] is None else f"{number(remedy['p95_pu'])} pu"
    return said if remedy["score"] >= 1.0 else f"{said}, with a score of the inner loops of {number(remedy['score'])}"


def _table(document: dict[str, Any]) -> Table:
    peaks, scrs = document["peaks"], sorted({one["scr"] for one in document["peaks"]})
    angles = sorted({one["angle_deg"] for one in peaks})
    of = {(one["angle_deg"], one["scr"]): one for one in peaks}
    rows = []
    for angle in angles:
        row = [f"{plain(angle)}°", number(of[angle, scrs[0]]["bound_pu"])]
        for scr in scrs:
            one = of[angle, scr]
            row += [number(one["p95_pu"]), number(one["largest_pu"]), str(one["runs"])]
        rows.append(tuple(row))
    notes = (
        "Currents in pu of the rated peak, from EMT with an averaged bridge. The jumps have both signs, X/R from 2 to "
        "20, SCR within 10 %, and powers of up to 0.9 pu. The power loops are those of the closed form and are told "
        "the grid 20 ms late. By hand: the limit, and what the voltage of the jump drives through the converter-side "
        "inductance until the bridge answers.",
    )
    groups = (("", 2), *((f"SCR {plain(scr)}", 3) for scr in scrs))
    return Table(
        "Largest converter currents after a phase jump", _HEAD, tuple(rows), groups=groups, notes=notes, on=Where.BOTH
    )
