"""The stability report as one HTML file. It fetches nothing but the explorer that lies beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from vsgdesign.report.figure_types import ExplorerFile, WrittenFigure
from vsgdesign.report.page.converter import converter_table, filter_table, specs_table
from vsgdesign.report.page.html import write_html
from vsgdesign.report.quantities import plain_quantity
from vsgdesign.report.stability import tables as made
from vsgdesign.report.stability.answer import stability_answer, stability_headline
from vsgdesign.report.stability.hover import hover_json
from vsgdesign.report.stability.verdict import verdict_text
from vsgdesign.simulation.stability_result import (
    StabilityResult,
    frequency_file,
    map_file,
    maps_of,
    step_file,
)

_MINUS = re.compile(r"(?<!\w)-(?=\d)")

_MAP_CONTENT = {
    "reduced": "margins of the reduced model over SCR × X/R × (P, Q)",
    "full_order": "margins of the full-order model over SCR × X/R × (P, Q)",
    "stale": "margins over true SCR × SCR of the gains, full order",
    "estimate_error": "margins over SCR × X/R × error of R_g × error of L_g, full order",
}


def write_stability_page(
    result: StabilityResult, figures: Sequence[WrittenFigure], out_path: Path, explorer: ExplorerFile | None = None
) -> Path:
    """Write the page of a stability assessment, with the figures' SVG text as it lies on disk.

    ``explorer`` is a page in the same folder, which this page shows in a frame. With None nothing is said of it.
    """
    from markupsafe import Markup

    study = result.study
    return write_html(
        out_path,
        "stability.html.j2",
        figures,
        study=study,
        largest=figures[0].name if figures else "",
        headline=stability_headline(result),
        summary=stability_answer(result),
        verdict=verdict_text(result),
        verdicts=[(row, _MINUS.sub("−", row.value), link_of(result, row.evidence)) for row in result.verdicts],
        identity=made.identity_table(result),
        setting=(converter_table(result), filter_table(result)),
        controllers=specs_table(result, [a.spec for a in result.assessments]),
        errors=made.error_table(result),
        limits=limits_of_validity(result),
        worst=[made.worst_table(result, a) for a in result.assessments],
        faults=made.faults_table(result),
        has_schedule=any(a.spec.kind == "scheduled" for a in result.assessments),
        focus=[a for a in result.assessments if a.focus],
        focus_tables=[
            (made.focus_table(a), made.participation_table(a), made.sensitivity_table(a))
            for a in result.assessments
            if a.focus
        ],
        between=made.between_table(result.assessments),
        x_over_r_limit=made.limit_table(result.assessments) if any(a.focus for a in result.assessments) else None,
        steps=made.steps_table(result),
        unsimulated=unsimulated(result),
        files=csv_files(result),
        explorer=explorer,
        quote=quote,
        hover=Markup(hover_json(result)),
    )


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
        f"The dc link is an ideal source of {plain_quantity(c.V_dc, 'V')}; the grid is an ideal source behind one "
        "balanced R–L branch, and no other converter or load is near.",
        "Inductors do not saturate; capacitors and measurements are ideal.",
    ]
    if any(a.spec.kind == "scheduled" for a in result.assessments):
        items.append(
            "Scheduled gains are frozen at their value for each grid: stability while they change, and the dynamics of "
            "an estimator, are not part of these margins."
        )
    return items
