"""Margins and their requirements for each controller: a table, and a sentence for the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.metrics.met import beside_limit
from vsgdesign.report.drawing.quantities import DASH, number, plain
from vsgdesign.report.page.blocks import Table
from vsgdesign.simulation.scenario.promises import TABLE, Kept

PROMISES = {
    "disk_margin": DEFINITIONS["disk_margin_output"].title,
    "gain_margin_db": "gain margin [dB]",
    "phase_margin_deg": "phase margin [°]",
    "M_s": "peak sensitivity M_s",
}


def promise_title(one: Kept) -> str:
    """What a promise is about: a table promises the damping of its power loops, a gate asks for that of all modes."""
    if one.name == "damping_ratio":
        return DEFINITIONS["damping_power_loops" if one.source == TABLE else "damping_all_modes"].title
    return PROMISES[one.name]


def promises_table(kept: Sequence[Kept]) -> Table | None:
    """Every margin that a controller was asked for, where the scenario rests, with ideal and with real inner loops."""
    rows, flagged = [], set()
    for index, one in enumerate(kept):
        sign = "≥" if one.at_least else "≤"
        results = [DASH] * 2 if one.excuse else ["met" if met else "missed" for met in (one.kept_ideal, one.kept)]
        if "missed" in results:
            flagged.add(index)
        rows.append(
            (
                one.controller,
                f"{plain(one.t_s, 5)} s",
                promise_title(one),
                one.source,
                one.excuse,
                f"{sign} {plain(one.limit)}",
                reached(one.ideal, one.limit, not one.kept_ideal),
                results[0],
                reached(one.full_order, one.limit, not one.kept),
                results[1],
            )
        )
    if not rows:
        return None
    head = (
        "Controller",
        "From",
        "Promise",
        "Asked by",
        "Not judged, as",
        "Limit",
        "Value",
        "Result",
        "Value",
        "Result",
    )
    groups = (("", 6), ("Ideal inner loops", 2), ("Real inner loops", 2))
    notes = (
        "At the operating point that holds from that instant on, with the gains that the controller has there. Ideal: "
        "the coupled model of the power loops. Real: the full-order model with inner loops, delay and sampling, which "
        "is the one that counts. With ideal inner loops all modes are those of the power loops.",
    )
    return Table("Margins against what was asked for", head, tuple(rows), 5, groups, notes, frozenset(flagged))


def promise_sentences(kept: Sequence[Kept]) -> list[str]:
    """One sentence for each controller that misses a required margin, naming the worst first; none if all are kept."""
    sentences = []
    for name in dict.fromkeys(one.controller for one in kept):
        judged = [one for one in kept if one.controller == name and not one.excuse]
        missed = [one for one in judged if not one.kept]
        if not missed:
            continue
        worst = min(missed, key=slack)
        sign = "at least" if worst.at_least else "at most"
        sentences.append(
            f"With the real inner loops {name} misses {len(missed)} of the {len(judged)} margins that it was asked "
            f"for, with ideal ones {sum(not one.kept_ideal for one in judged)}; worst from {plain(worst.t_s)} s on: "
            f"{promise_title(worst).partition(' [')[0]} {reached(worst.full_order, worst.limit, True)} (ideal "
            f"{reached(worst.ideal, worst.limit, not worst.kept_ideal)}) where {worst.source} "
            f"ask{'' if worst.source.endswith('gates') else 's'} for {sign} {plain(worst.limit)}."
        )
    return sentences


def slack(one: Kept) -> float:
    """How far a margin is within its limit, relative to it; negative beyond it. An unstable loop is the worst."""
    value = one.full_order
    if math.isnan(value):
        return -math.inf
    return (value - one.limit if one.at_least else one.limit - value) / abs(one.limit)


def reached(value: float, limit: float, missed: bool) -> str:
    """A margin as a text beside its limit: an unstable loop has none."""
    if math.isnan(value):
        return "unstable"
    return "∞" if math.isinf(value) else beside_limit(value, limit, missed, number, 3)
