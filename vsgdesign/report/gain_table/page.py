"""The page of a gain table: one HTML file, nothing fetched."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from vsgdesign.artifacts.definitions import ASKED
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.measured_errors import MeasuredErrors, shipped_errors
from vsgdesign.artifacts.table_text import (
    STEP_HEAD,
    between_text,
    causes_text,
    certificate_failed,
    certificate_sentence,
    error_text,
    link_text,
    missed_text,
    proof_sentences,
    step_rows,
    step_sentence,
)
from vsgdesign.artifacts.verification_text import table_verification
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.linear.stability.gain_table import TableCheck
from vsgdesign.linear.stability.table_claims import CARRIED, figure_of, limit_of
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure
from vsgdesign.report.drawing.quantities import DASH, number, plain, plain_quantity
from vsgdesign.report.gain_table.maps import (
    certificate_figure,
    constraint_figures,
    gain_surfaces,
    in_order,
    margin_figures,
    margin_keys,
    stale_figures,
)
from vsgdesign.report.gain_table.overview import ABOUT_STIFFNESS, stiffness_table, table_answer, table_headline
from vsgdesign.report.gain_table.words import (
    PROOF_CARRIED,
    flattened,
    inside_figure,
    inside_sentence,
    marked,
    specification_rows,
)
from vsgdesign.report.page.blocks import (
    BULLETS,
    Block,
    Box,
    Heading,
    Page,
    Side,
    Span,
    Table,
    drawings,
    opening,
    words,
)
from vsgdesign.report.page.live import StaticPage, try_it, way_to_it
from vsgdesign.runtime.guards import safe_place_text, settings_of
from vsgdesign.runtime.needed_sigma import needed_sigma_text

LAWS = {
    "poles": "poles: k_1, d_1 and k_2 are scheduled",
    "inertia": "inertia: H and ζ are scheduled, k_1 and d_1 follow from A",
}

CERTIFICATE_WORDS = {
    "certified": "Certified",
    "proof": "Proof",
    "controller": "Controller",
    "decay": "Decay at least [1/s]",
    "sampled": "Decay that the sampled points allow [1/s]",
    "largest": "Largest eigenvalue of the inequality [1/s]",
    "boxes": "Boxes on which it was proved",
    "checked": "Cells at which it was verified",
    "fresh": "Random points at which it was verified",
    "vertices": "Corners of the set of Jacobians",
    "gap.share": "Share of the region that is not proved on boxes",
    "gap.decay": "Decay of the slowest point in the gaps [1/s]",
    "gap.box": "Largest box that is left open",
    "P": "Lyapunov function P",
    "scale": "Scale of its states",
    "states": "Its states",
    "reason": "Reason",
    "static_limits.V_low": "Least V [pu]",
    "static_limits.V_high": "Largest V [pu]",
    "static_limits.power_transfer": "Power that the grid has to carry, over the apparent power [1]",
    "static_limits.current": "Largest current of the converter at rest [pu]",
    "static_limits.bridge_voltage": "Largest voltage of the bridge at rest [pu]",
    "eigenvalue.real": "Real part of the eigenvalue [1/s]",
    "eigenvalue.imag": "Imaginary part of the eigenvalue [rad/s]",
    "scr": "SCR of the unstable cell",
    "x_over_r": "X/R of the unstable cell",
    "error_R": "Error of R_g there",
    "error_L": "Error of L_g there",
    "trajectory.t_s": "Time of the response of the growing mode [s]",
    "trajectory.delta": "Angle in this response [rad]",
    "trajectory.omega_r": "Frequency in this response [rad/s]",
    "trajectory.V": "Voltage in this response [V]",
    "slowest.scr": "SCR of the slowest cell",
    "slowest.x_over_r": "X/R of the slowest cell",
    "slowest.P": "P of the slowest cell [W]",
    "slowest.Q": "Q of the slowest cell [var]",
    "slowest.error_R": "Error of R_g there",
    "slowest.error_L": "Error of L_g there",
    "slowest.decay": "Decay of the slowest cell [1/s]",
    "region.scr": "SCR",
    "region.x_over_r": "X/R",
    "region.P": "P [W]",
    "region.Q": "Q [var]",
    "region.error": "Error of R_g and of L_g",
    "region.error_Z": "Error over |Z|",
    "region.rate": "Speed of change of SCR and X/R [1/s]",
}
"""Rows of the certificate in words; any other name is printed as it is, with spaces."""


def table_figures(table: GainTable, measured: MeasuredErrors | None = None) -> Iterator[NamedFigure]:
    """One at a time, in the order of the page. ``measured`` has the errors of an estimator, if they are known."""
    yield from margin_figures(table)
    yield from gain_surfaces(table)
    yield from constraint_figures(table)
    certified = certificate_figure(table)
    if certified is not None:
        yield certified
    inside = inside_figure(table, measured)
    if inside is not None:
        yield inside
    yield from stale_figures(table)


def table_page(
    table: GainTable,
    figures: Sequence[WrittenFigure] = (),
    checked: TableCheck | None = None,
    live: StaticPage | None = None,
) -> Page:
    """The page: the answer, what the table is for, margins, gains, constraints, the proof, and stale schedules.
    ``checked``: what a check of its file found."""
    rest, asked = figures[1:], tuple((_heading(name), value) for name, value in specification_rows(table))
    specification = Table("Specification", ("Quantity", "Value"), asked, texts=2)
    margins, causes = margins_table(table), causes_table(table)
    made = open_table("Made with", table.provenance | table.inputs)
    verified = table_verification(table.verification)
    verified = verified if table.verification is None else marked(verified)
    faults = [_with_code(fault) for fault in (() if checked is None else checked.faults)]
    blocks: list[Block] = [
        *way_to_it(live),
        *opening(table_headline(table, checked), table_answer(table, checked), figures),
        *try_it(live, table.name),
        Heading("In words"),
        *([words(*faults, style=BULLETS)] if faults else []),
        Box([words(verdict_of(table))]),
        Heading("What it is for", numbered=True),
        Side((identity_table(table), *([specification] if specification.rows else []))),
        words(needed_sigma_text(table)),
        Heading("Margins", numbered=True),
        margins if margins.rows else words("The table has no margins."),
        *drawings(rest, 2),
        Heading("Gains", numbered=True),
        *drawings(rest, 3),
        Heading("Active constraints", numbered=True),
        *([causes, words(_ABOUT_CAUSES)] if causes.rows else []),
        stiffness_table(table),
        words(ABOUT_STIFFNESS),
        *drawings(rest, 4),
        Heading("Certificate and verification", numbered=True),
        words(proof_sentences(table), inside_sentence(table, shipped_errors())),
        *_certificate(table),
        *drawings(rest, 5),
        words(*verified[:1]),
        words(*verified[1:], style=BULLETS),
        Heading("Stale schedules", numbered=True),
        *drawings(rest, 6),
        Heading("Limits of validity", numbered=True),
        words(
            "The margins are those of the coupled reduced model, with ideal inner loops, a quasi-static network and "
            "small deviations. Limits of current and modulation do not act in this model. The full-order model and "
            "the EMT simulation are decisive.",
            "The promises hold within the validity box above. Outside the axes, the values at the edge of the table "
            "are used, and nothing is promised.",
            "Between the nodes the normalised parameters are interpolated, bilinear in SCR and R/X.",
            style=BULLETS,
        ),
        *([made] if made.rows else []),
    ]
    origin = ("Table ", Span(table.name, code=True), ", SHA-256 ", Span(table.sha256, code=True), ".")
    return Page(f"{table.name}: gain table", blocks, origin)


def _heading(words: str) -> str:
    """With a capital, unless it begins with a symbol: k_2 is not K_2."""
    return words if words[1:2] == "_" else words[:1].upper() + words[1:]


def _with_code(fault: str) -> tuple[str, ...]:
    """A fault of a file. It begins with the name of a field."""
    name, blank, rest = fault.partition(" ")
    return Span(name, code=True), blank + rest


_ABOUT_CAUSES = (
    "A relaxed cell was designed again without the sampling delay, with ideal inner loops, with an exact estimate and "
    "with half of the powers. The first of these that restores its requirements is its cause. If none does, the cause "
    'is "specification".'
)


def _certificate(table: GainTable) -> list[Block]:
    """The largest certified steps, and what the certificate says."""
    found = table.certificate
    if found is None:
        return []
    steps = steps_table(table)
    return [
        *([words(PROOF_CARRIED)] if found.certified else []),
        *([] if found.steps is None else [words(step_sentence(found.steps))]),
        *([] if steps is None else [steps]),
        open_table("Certificate", _without_steps(found.document), CERTIFICATE_WORDS),
    ]


def verdict_of(table: GainTable) -> str:
    """Counts of cells, the result of the proof and of a verification. A failed proof is reported first."""
    met, relaxed, outside = (int((table.status == status).sum()) for status in ("met", "relaxed", "outside"))
    total = table.status.size
    first = f"{met} of {total} cells keep every promise of the specification."
    if relaxed:
        why = f" ({causes_text(table.causes)})" if table.causes else ""
        first += f" In {relaxed} a promise is relaxed{why}; which one, its price and its cause are in part 4."
    if outside:
        first += (
            f" {outside} {'is' if outside == 1 else 'are'} outside: no operating point, or beyond the static limits."
        )
    if table.between is not None:
        look = between_text(table.between)
        first += f" {look[0].upper()}{look[1:]} ({CARRIED})."
    first += f" {link_text(table.between)}" if link_text(table.between) else ""
    proof = certificate_sentence(table.certificate)
    verified = "" if table.verification is None else f" {marked(table_verification(table.verification))[0]}"
    return (f"{proof} {first}" if certificate_failed(table.certificate) else f"{first} {proof}") + verified


def identity_table(table: GainTable) -> Table:
    """Structure, law, base and validity."""
    b, v = table.base, table.validity
    structure = STRUCTURES[table.structure]
    droops = [f"D_p = {number(table.D_p, 4)} W·s/rad"] if structure.P_droop else []
    droops += [f"D_q = {number(table.D_q, 4)} var/V"] if structure.Q_droop else []
    rows = (
        ("Structure", structure.label),
        ("Law", LAWS[table.law]),
        ("Study", table.study),
        ("Designed from", f"design hash {table.design_hash[:16]}…" if table.design_hash else "not kept"),
        (
            "Converter",
            f"{plain_quantity(b.S_rated, 'VA')}, {plain_quantity(b.V_rated_rms, 'V')} phase rms, "
            f"{plain(b.omega_n / (2.0 * math.pi))} Hz",
        ),
        (
            "Grid-side inductor",
            "none" if b.L_2 == b.R_2 == 0.0 else f"{plain_quantity(b.L_2, 'H')}, {plain_quantity(b.R_2, 'Ω')}",
        ),
        ("Lag of the power filters", f"P {_filter(b.tau_P)}, Q {_filter(b.tau_Q)}"),
        ("Droop", ", ".join(droops) or "D_p and D_q belong to the schedule"),
        ("Axes", f"{len(table.scr)} SCR ({b.scr_basis} basis) × {len(table.x_over_r)} X/R"),
        ("Design point", f"{plain_quantity(table.P_design, 'W')}, {plain_quantity(table.Q_design, 'var')}"),
        ("Valid for", f"SCR {_range(v.scr)}, X/R {_range(v.x_over_r)}"),
        ("", f"P {_range(v.P, 1e3)} kW, Q {_range(v.Q, 1e3)} kvar, V {_range(v.V_rms)} V"),
        ("", f"R and X known {error_text(v.error, v.error_Z)}"),
        ("Waits without estimates at", safe_place_text(settings_of(table))),
    )
    return Table("What it is for", ("Quantity", "Value"), rows, texts=2)


def margins_table(table: GainTable) -> Table:
    """The range of every margin over the cells, at the design point and at the worst of the box."""
    rows = []
    for name in in_order(table):
        figure, limit = figure_of(name), limit_of(table, name)
        asked = DASH if limit is None else f"{'≤' if figure.smaller_is_better else '≥'} {plain(limit)}"
        ranges = [_limits(table, key) for key in margin_keys(table, name)]
        rows.append((f"{figure.title} [{figure.unit}]", asked, *ranges[0], *ranges[1]))
    head = ("Margin", "Asked for", "least", "median", "largest", "least", "median", "largest")
    groups = (("", 2), ("design point", 3), (f"worst of the box ({CARRIED})", 3))
    return Table("Margins over the cells", head, tuple(rows), groups=groups)


def causes_table(table: GainTable) -> Table:
    """Why each relaxed cell is relaxed, and what it would keep without that cause."""
    names = (
        ("settling_time", "settles [s]"),
        ("overshoot", "overshoot [%]"),
        ("disk_margin", f"{ASKED['disk_margin']} [1]"),
        ("damping_ratio", f"{ASKED['damping_ratio']} [1]"),
        ("H", "H [s]"),
    )
    rows = []
    for cause in table.causes:
        keeps = cause["keeps"] or {}
        figures = [number(keeps.get(name)) if name != "overshoot" else _share(keeps.get(name)) for name, _ in names]
        missed = missed_text(cause["missed"])
        limit = DASH if not cause["limit"] else f"{cause['limit']}, {_share(cause['limit_use'])} %"
        rows.append((cause["cause"], plain(cause["scr"]), plain(cause["x_over_r"]), missed, limit, *figures))
    head = (
        "Cause",
        "SCR",
        "X/R",
        "instead of what was asked",
        "nearest static limit, use",
        *(title for _, title in names),
    )
    groups = (("", 5), ("without the cause it would keep", len(names)))
    return Table(f"Why cells are relaxed ({CARRIED})", head, tuple(rows), groups=groups)


def steps_table(table: GainTable) -> Table | None:
    """The largest steps for which no limit acts; None where the certificate has none."""
    found = None if table.certificate is None else table.certificate.steps
    if found is None or not found.rows:
        return None
    return Table("Largest certified steps, each alone", STEP_HEAD, tuple(step_rows(found)), texts=3)


def _without_steps(document: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in document.items() if name != "steps"}


def _share(value: float | None) -> str:
    return number(None if value is None else 100.0 * value)


def open_table(title: str, content: Mapping[str, Any], known: Mapping[str, str] = MappingProxyType({})) -> Table:
    """Names, in words where these are ``known``, and values of an open dictionary, one row each."""
    rows = tuple(
        (known.get(name, name.replace("_", " ").replace(".", ", ")), _entry(value))
        for name, value in flattened(content)
    )
    return Table(title, ("Name", "Value"), rows, texts=2)


def _entry(value: Any) -> str:
    if isinstance(value, list) and any(isinstance(item, list) for item in value):
        return "matrix, in the file"
    return ", ".join(_text(item) for item in value) if isinstance(value, list) else _text(value)


def _text(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: DASH}[value]
    return plain(float(value), 5) if isinstance(value, int | float) else _STATES.get(value, str(value))


_STATES = {"delta": "δ", "omega_r": "ω_r"}
"""States of a certificate as symbols."""


def _limits(table: GainTable, name: str) -> tuple[str, str, str]:
    values = table.figures.get(name, np.full(1, np.nan))
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return DASH, DASH, DASH
    return number(float(known.min())), number(float(np.median(known))), number(float(known.max()))


def _range(pair: tuple[float, float], factor: float = 1.0) -> str:
    return f"{plain(pair[0] / factor)} to {plain(pair[1] / factor)}"


def _filter(tau: float) -> str:
    return "unfiltered" if tau == 0.0 else plain_quantity(tau, "s")
