"""The stability report as one HTML file. It fetches nothing but the explorer that lies beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from vsgdesign.linear.stability.verdict import FAIL
from vsgdesign.report.drawing.figures import ExplorerFile, NamedFigure, WrittenFigure
from vsgdesign.report.drawing.quantities import DASH, plain_quantity
from vsgdesign.report.drawing.sketch import filled
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
    SOURCE,
    Block,
    Box,
    Contents,
    Heading,
    Live,
    Note,
    Page,
    Side,
    Span,
    Table,
    Where,
    drawings,
    opening,
    words,
)
from vsgdesign.report.page.converter import converter_table, filter_table, phase_jump_blocks, specs_table
from vsgdesign.report.page.html import text_file
from vsgdesign.report.page.network import network_block
from vsgdesign.report.stability import tables as made
from vsgdesign.report.stability.frequency import frequency_figures
from vsgdesign.report.stability.maps import map_figures
from vsgdesign.report.stability.modes import hover_json, mode_figures
from vsgdesign.report.stability.schedule import schedule_figures
from vsgdesign.report.stability.steps import step_figures
from vsgdesign.report.stability.verdict import gates_text, stability_answer, stability_headline, verdict_text
from vsgdesign.simulation.stability_result import (
    StabilityResult,
    frequency_file,
    map_file,
    maps_of,
    step_file,
)
from vsgdesign.study.parameters.study import Study

_MAP_CONTENT = {
    "reduced": "margins of the reduced model over SCR × X/R × (P, Q)",
    "full_order": "margins of the full-order model over SCR × X/R × (P, Q)",
    "stale": "margins over true SCR × SCR of the gains, full order",
    "estimate_error": "margins over SCR × X/R × error of R_g × error of L_g, full order",
}


def stability_figures(result: StabilityResult) -> Iterator[NamedFigure]:
    """One at a time, in the order of the report."""
    yield from map_figures(result)
    yield from schedule_figures(result)
    yield from mode_figures(result)
    yield from frequency_figures(result)
    yield from step_figures(result)


def stability_page(
    result: StabilityResult,
    figures: Sequence[WrittenFigure],
    explorer: ExplorerFile | None = None,
    jumps: dict[str, Any] | None = None,
) -> Page:
    """The page: the answer, the clause matrix, the model, margins over the grids, modes, loops and small steps.

    ``explorer`` is a page in the same folder, which this page shows in a frame. With None nothing is said of it.
    ``jumps`` is what current phase jumps make (``phase_jumps`` in results.json).
    """
    study, rest = result.study, figures[1:]
    blocks: list[Block | None] = [
        words(f"Parameters: {study.source}" if study.source else "", style=SOURCE),
        *opening(stability_headline(result), [stability_answer(result)], figures),
        Heading("In words"),
        Box([words(*verdict_text(result))]),
        _to_the_explorer(explorer),
        Contents(),
        Heading("Clause matrix", numbered=True),
        words(_ABOUT_CLAUSES),
        _clauses(result),
        *_identity(result),
        None if result.whole is None else network_block(result.whole),
        Heading("Margins over the grids", numbered=True),
        *drawings(rest, 3),
        *(made.worst_table(result, a) for a in result.assessments),
        made.differential_table(result),
        made.faults_table(result),
        Heading("Stale and wrong schedules", numbered=True),
        *_stale(result, rest),
        Heading("Modes", numbered=True),
        *drawings(rest, 5, otherwise="No eigenvalue could be drawn: no grid of the axes has a steady state."),
        *_modes(result),
        Heading("Loops and impedance over frequency", numbered=True),
        *drawings(rest, 6, otherwise=_NO_LOOPS),
        Heading("Time responses", numbered=True),
        words(_SMALL_STEPS),
        *drawings(rest, 7, otherwise="No small step was simulated, so there are no responses to show."),
        made.steps_table(result),
        *([Note(f"Not simulated: {'; '.join(missing)}.")] if (missing := unsimulated(result)) else []),
        *phase_jump_blocks(jumps, numbered=True),
        *_explorer(result, explorer),
        Heading("Files", numbered=True),
        words(_ABOUT_FILES),
        _files(result),
    ]
    named = ", SHA-256 of its resolved document "
    origin = ("Study ", Span(study.name, code=True), named, Span(study.hash, code=True))
    return Page(
        f"{study.title}: stability margins",
        [block for block in blocks if block is not None],
        (*origin, "."),
        style=text_file("stability.css"),
        script=filled(
            '<div id="readout" hidden></div>\n<script type="application/json" id="hover-data">{}</script>\n'
            "<script>\n{}</script>",
            Markup(hover_json(result)),
            Markup(text_file("readout.js")),
        ),
    )


def terminal_blocks(result: StabilityResult) -> list[Block]:
    """What a terminal prints: the answer, the worst cells over the maps, and the study's own grids in detail."""
    focus = [a for a in result.assessments if a.focus]
    found: list[Block | None] = [
        words(stability_headline(result), style=HEADLINE),
        words(f"{result.study.title}: worst cells over the maps (SCR on the {result.study.scr_basis} basis)"),
        *(made.worst_table(result, a) for a in result.assessments),
        made.differential_table(result),
        made.faults_table(result),
        *(replace(made.focus_table(a), left_out=frozenset({"at [Hz]", "DM [ms]"})) for a in focus),
        *(made.participation_table(a) for a in focus),
        words(*gates_text(result)),
    ]
    return [replace(block, on=Where.BOTH) for block in found if block is not None]


_ABOUT_CLAUSES = (
    "Rows with a blue edge are internal gates of vsgdesign. They are set in the study and do not come from a grid "
    "code. “Informational” does not mean “pass”: no limit of that source was applied. The confidence says whether the "
    "text was ",
    Span("read", italic=True),
    " in the source itself, taken from a ",
    Span("secondary", italic=True),
    " summary, or ",
    Span("recalled", italic=True),
    "; a recalled text must be checked before it is quoted.",
)
_NO_LOOPS = (
    "No grid of the scenario could be analysed in detail. There is therefore no perturbation plot, no Nichols plot, no "
    "admittance and no Nyquist plot."
)
_SMALL_STEPS = (
    "Only small steps of the references are simulated. Envelopes of grid-code tests (phase jumps, sags, frequency "
    "ramps) and peak currents are not assessed."
)
_ABOUT_FILES = (
    "The folder of this page also contains results.json with the verdicts, worst cells, modes and margins, figures/ "
    "with every figure as SVG and PNG, and the following CSV files. Each has one header line with units."
)


def _clauses(result: StabilityResult) -> Table:
    rows: list[tuple[str, ...]] = []
    for row in result.verdicts:
        link = link_of(result, row.evidence)
        rows.append(
            (
                row.controller,
                row.source,
                row.confidence or "ours",
                row.test,
                row.value or DASH,
                row.limit or DASH,
                Span(row.verdict, bold=True),
                Span(row.evidence, link=link or ""),
            )
        )
    head = ("Controller", "Source", "Confidence", "Test", "Value", "Limit", "Verdict", "Evidence")
    ours = frozenset(k for k, row in enumerate(result.verdicts) if not row.confidence)
    fails = frozenset(k for k, row in enumerate(result.verdicts) if row.verdict == FAIL)
    return Table("", head, tuple(rows), texts=8, flagged=fails, marked=ours, anchor="clauses")


def _identity(result: StabilityResult) -> list[Block]:
    """The model that was assessed, and what it leaves out."""
    no_errors = (
        "This report does not know the error of the linear models against EMT, because no small step was simulated."
    )
    return [
        Heading("Identity of the model", numbered=True),
        made.identity_table(result),
        Side((converter_table(result), filter_table(result))),
        specs_table(result, [a.spec for a in result.assessments]),
        made.error_table(result) or words(no_errors),
        Heading("Limits of validity", 3),
        words(*limits_of_validity(result), style=BULLETS),
    ]


def _stale(result: StabilityResult, figures: Sequence[WrittenFigure]) -> list[Block]:
    if any(a.spec.kind == "scheduled" for a in result.assessments):
        return drawings(figures, 4)
    empty = "This part is empty. No controller of the study is scheduled, so that no gains can be late or made from a "
    return [words(f"{empty}wrong estimate.")]


def _modes(result: StabilityResult) -> list[Block]:
    """Tables of the modes, and of what takes part in them."""
    focus = [a for a in result.assessments if a.focus]
    if not focus:
        none = (
            "No grid of the scenario could be analysed in detail, because none carries the power of the maps with "
            "gains for it. There are therefore no participation factors and no sensitivities."
        )
        return [made.between_table(result.assessments), words(none)]
    tables = [
        table for a in focus for table in (made.focus_table(a), made.participation_table(a), made.sensitivity_table(a))
    ]
    return [made.between_table(result.assessments), made.limit_table(result.assessments), *tables]


def _to_the_explorer(explorer: ExplorerFile | None) -> Block | None:
    if explorer is None or not explorer.name:
        return None
    watch = " you can drag the grid yourself, and watch modes, margins and EMT responses."
    return words(("In ", Span("the explorer", link="#explorer"), watch))


def _explorer(result: StabilityResult, explorer: ExplorerFile | None) -> list[Block]:
    """The explorer in a frame, or why there is none."""
    if explorer is None:
        return []
    heading = Heading("Explorer", numbered=True, anchor="explorer")
    if not explorer.name:
        return [heading, words(f"There is no explorer. {explorer.why}")]
    link = quote(explorer.name)
    hold = " Tick “Hold the gains of this grid” to see why gains are scheduled."
    scheduled = any(a.spec.kind == "scheduled" for a in result.assessments)
    frame = '<div id="explorer"><iframe src="{}" title="Explorer: {}" loading="lazy"></iframe></div>'
    return [
        heading,
        words(
            (
                f"Drag the ring on the map to another grid, or click there.{hold if scheduled else ''} The powers and "
                "the event are those with which the study’s explorer begins. The explorer is the file ",
                Span(explorer.name, link=link),
                f" ({explorer.megabytes}) beside this page: if you send this page, send the file, too.",
            )
        ),
        Live(lambda: filled(frame, link, result.study.title)),
    ]


def _files(result: StabilityResult) -> Table:
    rows = tuple((Span(name, link=quote(name)), content) for name, content in csv_files(result))
    return Table("", ("File", "Content"), rows, texts=2, anchor="files")


def link_of(result: StabilityResult, evidence: str) -> str | None:
    """The link to an evidence file, relative to the report; None for evidence that is no file."""
    return quote(evidence) if any(evidence == name for name, _ in csv_files(result)) else None


def csv_files(result: StabilityResult) -> list[tuple[str, str]]:
    """Every CSV file beside the report: (name, content)."""
    found: list[tuple[str, str]] = []
    for a in result.assessments:
        name = a.spec.name
        found += [(map_file(name, kind), f"{name}: {_MAP_CONTENT[kind]}; gains, faults") for kind in maps_of(a)]
        found += [
            (
                frequency_file(name, cell.label),
                f"{name} at {cell.label}: L_P, L_Q, dq admittance, passivity index, generalised Nyquist and NFP",
            )
            for cell in a.focus
        ]
    for (name, label), pair in result.evidence.items():
        found += [
            (step_file(name, label, e.signal), f"{name} at {label}: small {e.signal} step, EMT and both linear models")
            for e in pair
        ]
    return found


def unsimulated(result: StabilityResult) -> list[str]:
    """Detailed cells without EMT results, and why."""
    found = []
    for a in result.assessments:
        for cell in a.focus:
            if (a.spec.name, cell.label) not in result.evidence:
                reason = (
                    "not asked for" if cell.full_order_table.stable[0] else "the full-order model is unstable there"
                )
                found.append(f"{a.spec.name} at {cell.label}: {reason}")
    return found


def limits_of_validity(result: StabilityResult) -> list[str]:
    """What the models leave out, as far as it matters for the numbers of this report."""
    study = result.study
    c = study.converter
    items = [
        "Margins are those of linear models at steady states: they hold for small deviations. Limits of current and of "
        "modulation do not act in them.",
        "The reduced model takes the inner loops for ideal and the network for quasi-static; it is of no use near or "
        "above the bandwidth of the inner loops. The full-order model has filter, network, inner loops, sampling every "
        f"{plain_quantity(c.T_s, 's')} and {'no' if c.delay_samples == 0 else c.delay_samples} sample of delay; its "
        "bridge is averaged over a sampling period.",
        "Frequencies end below half the sampling rate. Between the samples the admittance keeps only the component at "
        "the perturbation's own frequency.",
        f"The dc link is {_link(study)}; the grid is an ideal source behind one "
        "balanced R–L branch, and no other converter or load is near.",
        "Inductors do not saturate; capacitors and measurements are ideal.",
    ]
    if any(a.spec.kind == "scheduled" for a in result.assessments):
        items.append(
            "Scheduled gains are frozen at their value for each grid: stability while they change, and the dynamics of "
            "an estimator, are not part of these margins."
        )
    return items


def _link(study: Study) -> str:
    """What the dc link is in the models."""
    V_dc = plain_quantity(study.converter.V_dc, "V")
    if study.dc is None:
        return f"an ideal source of {V_dc}"
    return (
        "that of [dc] around its rest: its modes are among those of the full-order model, and the margins are those of "
        f"an ideal source of {V_dc}, because it does not act on the circuit below the limit of the bridge"
    )
