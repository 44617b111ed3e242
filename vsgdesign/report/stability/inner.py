"""The page of inner loops: the answer, maps of the requirements, the gains, and what would improve them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.errors import counted
from vsgdesign.metrics.met import MARGIN_ROOM, score_met
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure
from vsgdesign.report.drawing.quantities import number, plain, plain_quantity
from vsgdesign.report.page.blocks import (
    BULLETS,
    FLAGGED,
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
from vsgdesign.report.page.converter import phase_jump_blocks
from vsgdesign.study.parameters.inner_loops import ENOUGH_SAMPLING

_SHOWN = 7
"""The grids of each axis on the map of the terminal."""

if TYPE_CHECKING:
    from vsgdesign.design.inner import InnerScore


def inner_figures(score: InnerScore) -> Iterator[NamedFigure]:
    """The score over SCR × X/R, then each requirement."""
    yield _map(
        score,
        "inner_score",
        "Score over the grids",
        score.t_map,
        1.0,
        False,
        "score [1]",
        "The score of a grid is the smallest share of its target that any requirement reaches there.",
        0,
    )
    for name, values, target in zip(PROMISES, score.maps, score.targets, strict=True):
        title, unit = PROMISES[name]
        yield _map(
            score,
            f"inner_{name}",
            title[0].upper() + title[1:],
            np.asarray(values),
            float(target),
            name in AT_MOST,
            f"{title} [{unit}]",
            "",
            1,
        )


def _map(
    score: InnerScore,
    name: str,
    title: str,
    values: np.ndarray,
    target: float,
    at_most: bool,
    bar: str,
    says: str,
    part: int,
) -> NamedFigure:
    from vsgdesign.report.drawing.look import Cells, gate_scale, round_numbers
    from vsgdesign.report.drawing.panels import Frame, Panel, map_figure

    unstable = ~score.stable
    missing = np.isnan(values) & ~unstable
    nowhere = np.zeros(values.T.shape, dtype=bool)
    cells = Cells(
        x=np.array(score.x_over_r),
        y=np.array(score.scr),
        values=values.T,
        unstable=unstable.T,
        missing=missing.T,
        partial=nowhere,
    )
    near = (values < target) != at_most  # on the worse side, and drawn on the limit where it counts as reached
    values = np.where(near & (abs(values / target - 1.0) <= MARGIN_ROOM), target, values)
    known = values[np.isfinite(values) & ~unstable]
    high = float(known.max()) if len(known) else 2.0 * target
    low = min(0.0, float(known.min())) if len(known) else 0.0
    decade = 10.0 ** np.floor(np.log10(target))
    ticks = round_numbers(0.09 * decade, 60.0 * decade)
    scale = gate_scale(low, max(high, 1.2 * target), target, (0.0, *ticks), larger_is_better=not at_most)
    asked = f"asked for: {'at most' if at_most else 'at least'} {plain(target)}"
    caption = (
        f"{says} Each cell is a grid of the box; blue cells keep the requirement, and orange cells do not."
    ).strip()
    frame = Frame(
        name, title, caption, "X/R [1]", f"SCR, {score.basis} basis [1]", bar, part, aspect=0.75, gate_label=asked
    )
    return map_figure(frame, [[Panel("", cells)]], scale)


def inner_tables(document: dict[str, Any], on: Where = Where.PAGE) -> tuple[Table, Table]:
    """Requirements and gains, from results.json."""
    missed = frozenset(k for k, one in enumerate(document["promises"]) if not score_met(one["score"]))
    promises = Table(
        "What the inner loops keep, at the worst grid",
        PROMISE_HEAD,
        tuple(promise_rows(document)),
        texts=2,
        flagged=missed,
        notes=(f"{FLAGGED} is not kept on every grid. The share is the worst value divided by the target.",),
        on=on,
    )
    title = "Gains of the inner loops, SI, dq components peak"
    return promises, Table(title, GAIN_HEAD, tuple(gain_rows(document)), texts=2, on=on)


def inner_page(document: dict[str, Any], figures: Sequence[WrittenFigure] = (), file: str | None = None) -> Page:
    """The page: the answer, what is kept and where, the gains, and each requirement over the grids.

    ``document`` is results.json of the verb ``inner``. ``file`` is where a verb keeps gains that it designed, for the
    terminal.
    """
    study = document["study"]
    promises, gains = inner_tables(document, Where.BOTH)
    kept_in = f" They are kept in {file}." if file else ""
    blocks: list[Block] = [
        Box(
            (
                words((Span(headline(document), bold=True), f" {what_for(document)}")),
                words(*explanation(document), style=BULLETS),
            )
        ),
        words(
            f"{study['title']}: {headline(document)}",
            what_for(document) + kept_in,
            *explanation(document),
            on=Where.TERMINAL,
        ),
        Heading("What is kept, and where", numbered=True),
        promises,
        *drawings(figures, 0),
        Heading("Gains", numbered=True),
        gains,
        _score_table(document),
        Heading("With cables, capacitors and other passive networks", numbered=True),
        words(*passivity_sentences(document["passivity"]), style=BULLETS, on=Where.BOTH),
        *phase_jump_blocks(document["phase_jumps"], numbered=True),
        Heading("Each promise over the grids", numbered=True),
        *drawings(figures, 1),
        Heading("Limits of validity", numbered=True),
        words(
            "The power loops are held still: their angle and voltage are constant. The check with power loops in the "
            "verdict uses the full-order model.",
            "The results are for small deviations without any limit, an averaged bridge, and a balanced grid of R and "
            "L. The EMT simulation is decisive.",
            "The targets are those of this project, not of a grid code.",
            style=BULLETS,
        ),
    ]
    origin = ("Study ", Span(study["name"], code=True), ", SHA-256 ", Span(study["hash"], code=True), ".")
    return Page(f"{study['title']}: inner loops", blocks, origin)


def passivity_sentences(found: dict[str, Any]) -> list[str]:
    """The band, what it does not say, the worst capacitance, and a warning."""
    end = plain_quantity(found["to_hz"], "Hz")
    if found["from_hz"] is None:
        band = (
            f"At the end of the scan, {end}, the output admittance is not passive at every operating point. So no band "
            "is named in which the converter cannot feed an oscillation."
        )
    else:
        begin = plain_quantity(found["from_hz"], "Hz")
        band = (
            f"Between {begin} and {end} in the frame of the source, the output admittance is passive at all "
            f"{found['cells']} operating points that were scanned. There the converter cannot feed an oscillation of a "
            "passive network, such as cables, capacitors, transformers and loads of constant impedance."
        )
    limits = (
        "This is a scan and no proof. Below the band, the power loops decide. Above 0.35 of the sampling frequency, "
        "components of the sampled bridge that the scan leaves out are no longer small."
    )
    lines, worst = [band, limits], found["worst"]
    if worst is not None:
        grows = "grows" if worst["real"] > 0.0 else "decays"
        lines.append(
            f"Of the capacitances from 0.0003 to 0.5 pu at the PCC, {plain(worst['C_pu'], 2)} pu is the worst, behind "
            f"{plain(worst['series_pu'], 2)} pu of reactance at SCR {plain(worst['scr'], 3)} and X/R "
            f"{plain(worst['x_over_r'], 3)}: an oscillation, which the samples show at "
            f"{plain_quantity(worst['hertz'], 'Hz')}, {grows} with {plain(abs(worst['real']), 3)} 1/s."
        )
    if found["warns"]:
        lines.append(
            f"The filter has {plain(found['series_pu'], 2)} pu of reactance between its capacitor and the PCC. With "
            "less than 0.02 pu, a capacitance near it can oscillate with that of the filter near half of the sampling "
            "frequency. Put a transformer or an inductor of 0.02 pu or more between them, or damp the capacitor with "
            "R_c."
        )
    return lines


def _score_table(document: dict[str, Any]) -> Table:
    """The score on about seven grids of each axis, for a terminal."""
    scr, x_over_r, score = (document["map"][name] for name in ("scr", "x_over_r", "score"))
    rows, columns = _some(len(scr)), _some(len(x_over_r))
    head = ("SCR \\ X/R", *(plain(x_over_r[j], 3) for j in columns))
    texts = tuple((plain(scr[i], 3), *(number(score[i][j], 2) for j in columns)) for i in reversed(rows))
    return Table("Score over the grids (1 is asked)", head, texts, texts=0, on=Where.TERMINAL)


def _some(count: int) -> list[int]:
    """About seven indices from the first to the last."""
    step = max((count - 1) // (_SHOWN - 1), 1)
    return sorted({*range(0, count, step), count - 1})


PROMISES: dict[str, tuple[str, str]] = {
    "damping": (DEFINITIONS["damping_inner_loops"].title, "1"),
    "decay": ("slowest decay", "1/s"),
    "disk": (DEFINITIONS["disk_margin_bridge"].title, "1"),
    "sensors": ("relative error of all sensors at once", "1"),
    "noise": ("noise gain from the sensors to the bridge voltage", "1"),
    "tolerance": (f"{DEFINITIONS['damping_inner_loops'].title} with L_1 and C off by 20 %", "1"),
}
"""Name and unit of each promise."""

NAMES = PROMISES | {
    "damping_apart": (f"{PROMISES['damping'][0]}, units against each other", "1"),
    "decay_apart": ("slowest decay of the units against each other, with closed-form power loops", "1/s"),
}
"""The same with what units of a plant keep between them."""

AT_MOST = frozenset({"noise"})
"""Requirements that are upper limits."""


def headline(document: dict[str, Any]) -> str:
    """The answer in one sentence."""
    grids = document["grids"]
    if document["kept"]:
        score = plain(document["score"], 3)
        return f"The inner loops keep all requirements on all {grids['of']} grids: the score is {score} of 1 asked."
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
    name, unit = NAMES[limiting["name"]]
    unit = "" if unit == "1" else f" {unit}"
    asked = "at most" if limiting["name"] in AT_MOST else "at least"
    anywhere = limiting["name"] == "damping_apart"
    place = "on any grid" if anywhere else f"at SCR {plain(limiting['scr'])}, X/R {plain(limiting['x_over_r'])}"
    lines = [
        f"The {name} limits: {number(limiting['value'])}{unit} {place}, where {asked} "
        f"{plain(limiting['target'])}{unit} is asked."
    ]
    aside = check["cells"] - check["analysed"]
    have = "has" if aside == 1 else "have"
    others = f" ({counted(aside, 'further cell')} {have} no operating point)" if aside else ""
    lines.append(
        f"With closed-form power loops the full-order model is stable in {check['stable']} of {check['analysed']} "
        f"cells, with a {DEFINITIONS['damping_all_modes'].title} of {number(_or_nan(check['damping']))} or more"
        f"{others}."
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
        name, unit = NAMES[promise["name"]]
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
