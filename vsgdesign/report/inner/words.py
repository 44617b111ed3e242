"""The requirements that inner loops keep, in words. The terminal and the page use the same text."""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.parameters.inner_loops import ENOUGH_SAMPLING
from vsgdesign.report.quantities import number, plain, plain_quantity

PROMISES: dict[str, tuple[str, str]] = {
    "damping": ("damping ratio of every mode", "1"),
    "decay": ("slowest decay", "1/s"),
    "disk": ("disk margin at the bridge", "1"),
    "sensors": ("relative error of all sensors at once", "1"),
    "noise": ("noise gain from the sensors to the bridge voltage", "1"),
    "tolerance": ("damping ratio with L_1 and C off by 20 %", "1"),
}
"""Name and unit of each promise."""

AT_MOST = frozenset({"noise"})
"""Requirements that are upper limits."""


def headline(document: dict[str, Any]) -> str:
    """The answer in one sentence."""
    grids = document["grids"]
    if document["kept"]:
        score = plain(document["score"], 3)
        return f"All requirements are kept on all {grids['of']} grids: the score is {score} of 1 asked."
    if grids["stable"] < grids["of"]:
        lost = grids["of"] - grids["stable"]
        return f"The inner loops are unstable on {lost} of {grids['of']} grids."
    check = document["full_order"]
    if check["stable"] < check["analysed"]:
        return (
            f"The inner loops alone are stable on all {grids['of']} grids, but with closed-form power loops the "
            f"full-order model is unstable in {check['analysed'] - check['stable']} of {check['analysed']} cells."
        )
    if document["score"] <= 0.0:
        return (
            f"The inner loops are stable on all {grids['of']} grids with the filter as given, but not everywhere "
            "with L_1 and C off by 20 %."
        )
    return (
        f"The inner loops are stable on all {grids['of']} grids, but not every requirement is kept: the score is "
        f"{plain(document['score'], 3)} of 1 asked."
    )


def explanation(document: dict[str, Any]) -> list[str]:
    """The limit and its place, the check with the power loops, and what would help, each in one sentence."""
    limiting, check, sampling = document["limiting"], document["full_order"], document["sampling"]
    name, unit = PROMISES[limiting["name"]]
    unit = "" if unit == "1" else f" {unit}"
    asked = "at most" if limiting["name"] in AT_MOST else "at least"
    lines = [
        f"The {name} limits: {number(limiting['value'])}{unit} at SCR {plain(limiting['scr'])}, X/R "
        f"{plain(limiting['x_over_r'])}, where {asked} {plain(limiting['target'])}{unit} is asked."
    ]
    lines.append(
        f"With closed-form power loops the full-order model is stable in {check['stable']} of {check['analysed']} "
        f"cells, with a damping ratio of {number(_or_nan(check['damping']))} or more "
        f"({check['cells'] - check['analysed']} further cells have no operating point)."
    )
    enough = "at or above" if sampling["ratio"] >= ENOUGH_SAMPLING else "below"
    lines.append(
        f"The controller samples at {plain_quantity(sampling['rate_hz'], 'Hz')}, {plain(sampling['ratio'], 3)} times "
        f"the highest resonance of filter and grid ({plain_quantity(sampling['highest_resonance_hz'], 'Hz')}). That is "
        f"{enough} {ENOUGH_SAMPLING}, from which on all requirements have usually been kept."
    )
    for one in document["alternatives"] or ():
        kept = "all promises are kept" if one["kept"] else f"the {PROMISES[one['limiting']['name']][0]} limits"
        lines.append(f"With {one['change']} the score would be {plain(one['score'], 3)}: {kept}.")
    return lines


def promise_rows(document: dict[str, Any]) -> list[tuple[str, ...]]:
    """Promise, unit, worst, asked, share, SCR, X/R of the worst."""
    rows = []
    for promise in document["promises"]:
        name, unit = PROMISES[promise["name"]]
        sign = "≤" if promise["name"] in AT_MOST else "≥"
        value, share, scr, x_over_r = (_or_nan(promise[key]) for key in ("value", "score", "scr", "x_over_r"))
        asked = f"{sign} {plain(promise['target'], 3)}"
        rows.append((name, unit, number(value), asked, number(share), plain(scr, 3), plain(x_over_r, 3)))
    return rows


PROMISE_HEAD = ("promise", "unit", "worst", "asked", "share", "at SCR", "at X/R")

GAIN_TEXTS: tuple[tuple[str, str, str], ...] = (
    ("K_pv", "A/V", "voltage loop, proportional"),
    ("K_iv", "A/(V·s)", "voltage loop, integral"),
    ("K_pc", "V/A", "current loop, proportional"),
    ("K_ic", "V/(A·s)", "current loop, integral"),
    ("K_ff", "1", "share of the grid current fed forward"),
    ("R_t", "ohm", "transient resistance"),
    ("X_t", "ohm", "transient reactance"),
    ("omega_t", "rad/s", "corner of the transient impedance"),
    ("kappa", "1", "share of a sampling period by which the current is predicted"),
)


GAIN_HEAD = ("gain", "what it is", "value", "unit")


def gain_rows(document: dict[str, Any]) -> list[tuple[str, ...]]:
    """Gain, meaning, value, unit."""
    return [
        (name.replace("omega_t", "ω_t").replace("kappa", "κ"), text, number(document["gains"][name], 5), unit)
        for name, unit, text in GAIN_TEXTS
    ]


def what_for(document: dict[str, Any]) -> str:
    """Where the gains come from, and for which grids."""
    request = document["request"]
    came = "designed" if document["designed"] else "given by the study, judged"
    return (
        f"Inner loops {came} for SCR {plain(request['scr'][0])} to {plain(request['scr'][1])} ({request['scr_basis']} "
        f"basis) and X/R {plain(request['x_over_r'][0])} to {plain(request['x_over_r'][1])}."
    )


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
