"""A gain table, its proof, and how often an estimate is inside its error set, in sentences. The terminal, the page and
the notebook use the same text.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from vsgdesign.artifacts.definitions import ASKED, in_words
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.measured_errors import MeasuredErrors, shipped_errors
from vsgdesign.artifacts.table_text import (
    between_text,
    cause_text,
    causes_text,
    certificate_failed,
    certificate_sentence,
    error_text,
    full_order_sentence,
    inner_loops_text,
    link_text,
    status_text,
    step_lines,
)
from vsgdesign.artifacts.verification_text import table_verification
from vsgdesign.certificate import Certificate, Counterexample, Places
from vsgdesign.certificate.swing import SwingStatement
from vsgdesign.certificate.swing.statement import EMPTY, RETURNS
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import counted
from vsgdesign.linear.stability.gain_table import TableCheck
from vsgdesign.linear.stability.safe_place import SETTLED, InsideSet, inside_set
from vsgdesign.linear.stability.table_claims import CARRIED
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.quantities import plain
from vsgdesign.runtime.guards import safe_place_text, settings_of
from vsgdesign.runtime.needed_sigma import needed_sigma_text
from vsgdesign.study.parameters.specification import UNBOUNDED_H


def heading(table: GainTable) -> Iterator[str]:
    """Lines that describe the table, its purpose and its proof. A failed proof is the first line."""
    if certificate_failed(table.certificate):
        yield certificate_sentence(table.certificate)
    base, v = table.base, table.validity
    yield f"{table.name}: {table.structure}, law {table.law}, for study {table.study}"
    yield (
        f"{len(table.scr)} SCR ({base.scr_basis} basis) × {len(table.x_over_r)} X/R: {status_of(table)}. "
        f"{base.S_rated / 1e3:g} kVA, {base.V_rated_rms:g} V phase, {base.omega_n / (2.0 * math.pi):g} Hz; "
        f"gains shown at {table.P_design / 1e3:g} kW, {table.Q_design / 1e3:g} kvar"
    )
    structure = STRUCTURES[table.structure]
    droops = [f"D_p = {table.D_p:.4g} W·s/rad"] if structure.P_droop else []
    droops += [f"D_q = {table.D_q:.4g} var/V"] if structure.Q_droop else []
    if droops:
        yield f"droop: {', '.join(droops)}"
    yield (
        f"valid for SCR {v.scr[0]:g} to {v.scr[1]:g}, X/R {v.x_over_r[0]:g} to {v.x_over_r[1]:g}, "
        f"P {v.P[0] / 1e3:g} to {v.P[1] / 1e3:g} kW, Q {v.Q[0] / 1e3:g} to {v.Q[1] / 1e3:g} kvar, "
        f"V {v.V_rms[0]:.4g} to {v.V_rms[1]:.4g} V, R and X known {error_text(v.error, v.error_Z)}"
    )
    yield f"without estimates the schedule waits at {safe_place_text(settings_of(table))}"
    yield needed_sigma_text(table)
    yield inside_sentence(table, shipped_errors())
    if table.specification:
        yield "specification: " + "; ".join(f"{name} {value}" for name, value in specification_rows(table))
    yield from marked(_why(table.causes))
    if table.between is not None:
        yield from marked([between_text(table.between)])
    if not certificate_failed(table.certificate):
        yield certificate_sentence(table.certificate)
    if table.full_order is not None:
        yield full_order_sentence(table.full_order)
    if table.certificate is not None and table.certificate.steps is not None:
        yield from step_lines(table.certificate.steps)
    if table.certificate is not None and table.certificate.certified:
        yield PROOF_CARRIED
    verified = table_verification(table.verification)
    yield from verified if table.verification is None else marked(verified)
    if table.design_hash:
        yield f"design hash {table.design_hash}"
    yield f"sha256 {table.sha256}"


PROOF_CARRIED = (
    f"What the certificate says is verified at points by vsgdesign table check; between them it is {CARRIED}."
)
"""What is said beside a certificate that was read from a file."""


def marked(lines: Sequence[str]) -> list[str]:
    """Lines about what a file states and no check computes again: the first says so."""
    return [f"{line} ({CARRIED})" if k == 0 else line for k, line in enumerate(lines)]


_SPECIFIED = {
    "aim": ("aim", ""),
    "settling_time": ("2 % settling of P and Q ≤", "s"),
    "overshoot": ("overshoot ≤", "%"),
    "disk_margin": (f"{ASKED['disk_margin']} ≥", ""),
    "damping_ratio": (f"{ASKED['damping_ratio']} ≥", ""),
    "H": ("inertia constant held at", "s"),
    "H_min": ("inertia constant ≥", "s"),
    "H_max": ("inertia constant ≤", "s"),
    "bandwidth_max": ("k_2 and d_1 ≤", "1/s"),
    "differential_decay": (f"{ASKED['differential_decay']} ≥", "1/s"),
    "scr": ("SCR of the first nodes", ""),
    "scr_basis": ("basis of SCR", ""),
    "x_over_r": ("X/R of the first nodes", ""),
    "box.P": ("P", "kW"),
    "box.Q": ("Q", "kvar"),
    "box.V_g_rms": ("voltage of the source, phase rms", "V"),
    "box.omega_g": ("frequency of the grid", "Hz"),
    "box.error_R": ("error of R_g ±", "%"),
    "box.error_X": ("error of L_g ±", "%"),
    "box.error_Z": ("or of |Z| ±", "%"),
}
"""Words and unit of what a specification says, in their order."""
_SCALES = {"%": 100.0, "kW": 1e-3, "kvar": 1e-3, "Hz": 0.5 / math.pi}
_NOT_ASKED = {"H": None, "differential_decay": 0.0, "H_min": 0.0, "H_max": UNBOUNDED_H, "box.error_Z": 0.0}


def specification_rows(table: GainTable) -> list[tuple[str, str]]:
    """What a table was designed to keep, in words and values. What is not asked for is left out."""
    given = dict(flattened(table.specification))
    rows = []
    for name, (words, unit) in _SPECIFIED.items():
        if name in given and not (name in _NOT_ASKED and given[name] == _NOT_ASKED[name]):
            value = given[name]
            values = value if isinstance(value, list | tuple) else [value]
            shown = (_value(one, _SCALES.get(unit, 1.0)) for one in values)
            rows.append((words, f"{', '.join(shown)} {unit}".strip()))
    others = [name for name in given if name not in _SPECIFIED and not name.startswith("box.")]
    return rows + [(name.replace("_", " "), _value(given[name])) for name in others]


def flattened(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The entries of an open dictionary; those of one inside it have its name and a dot before theirs."""
    for name, value in content.items():
        if isinstance(value, dict):
            yield from flattened(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _value(value: Any, scale: float = 1.0) -> str:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return f"{scale * value:.4g}" if number else str(value)


def certificate_text(found: Certificate | Places | Counterexample) -> str:
    """The result of the proof, or the cell for which it fails, and how it was verified."""
    text = f"{found.controller}: {certificate_sentence(found.as_record())}"
    if isinstance(found, Counterexample):
        return text
    steps = "" if found.steps is None else "\n" + "\n".join(step_lines(found.steps))
    document = found.as_document()
    text += f"\n{_verified(document)}"
    if (other := document.get("differential")) is not None and other["certified"]:
        text += f"\nUnits against each other: {_verified(other)}"
    return text + steps


def _verified(document: Mapping[str, Any]) -> str:
    """How a certificate was verified."""
    count = document["boxes"]
    boxes = f"Proved on {count} {'box' if count == 1 else 'boxes'}. " if count else ""
    gap_free = document["proof"] == "gap-free"
    spare = "" if gap_free else f", the slowest of which has {document['gap']['decay']:.2g} 1/s to spare"
    return (
        f"{boxes}Verified at {document['checked']} cells and {document['fresh']} fresh random points{spare}; "
        f"{document['vertices']} vertices decide."
    )


def swing_text(found: SwingStatement) -> str:
    """The large-signal statement: on how many parts of the map it is proved, and the first place at which it is not."""
    count, whole = found.count(RETURNS), len(found.parts) - found.count(EMPTY)
    degrees, frequency = math.degrees(found.start.angle), found.start.speed / (2.0 * math.pi)
    text = (
        f"Large signal: from any angle up to ±{degrees:.0f}° and ±{frequency:g} Hz, the angle is proved to return to "
        f"its rest on {count} of {whole} parts of the range of SCR and X/R, with V and the gains of the true grid "
        "held, a quasi-static network, an ideal current loop and no filters."
    )
    rest = [part for part in found.parts if part.grade not in (RETURNS, EMPTY)]
    if not rest:
        return text
    shown = next((part for part in rest if part.at is not None), rest[0])
    scr, ratio = (_range([getattr(part, name) for part in rest]) for name in ("scr", "x_over_r"))
    text += f"\nNot proved within SCR {scr}, X/R {ratio}"
    if shown.at is None:
        return f"{text}: {_SWING_CONDITIONS[shown.undecided]} with the given number of boxes."
    at = shown.at
    where = f"SCR {_short(at.scr)}, X/R {_short(at.x_over_r)}, P {_short(at.P / 1e3)} kW, Q {_short(at.Q / 1e3)} kvar"
    angle = "" if at.delta is None else f" (at {math.degrees(at.delta):.0f}°)"
    return f"{text}: at {where}, {_SWING_FAILURES[at.condition]}{angle}."


_SWING_CONDITIONS = {
    "gains": "it is open whether the gains keep their signs",
    "rest": "it is open whether an unstable rest lies within the current limit",
    "edge": "it is open whether the pull holds the angle back near 180°",
    "falling": "it is open whether the energy falls wherever the limit acts",
}
"""What was not decided about a part of the map."""

_SWING_FAILURES = {
    "gains": "the gains do not keep the signs that the proof needs (K_ip > 0, k_P ≥ 0, k_P D_p < 1)",
    "rest": "an unstable rest lies within the current limit, and the angle does not return from beyond it",
    "falling": "the energy rises while the limit acts",
}
"""What fails at a point."""


def _range(pairs: Sequence[tuple[float, float]]) -> str:
    return f"{_short(min(low for low, _ in pairs))} to {_short(max(high for _, high in pairs))}"


def built_text(document: dict[str, Any], shown: int = 8) -> str:
    """The result of a build: cells, added nodes, and requirements that are not kept, at the nodes and between them."""
    table, cells, between = document["table"], document["cells"], document["between"]
    head = f"{document['file']}: {table['name']}, {len(table['scr'])} SCR × {len(table['x_over_r'])} X/R"
    proof = document["certificate"]
    lines = [] if proof["certified"] is not False else [f"{table['name']}: {proof['text']}"]
    lines.append(f"{head}: {status_text(cells)}")
    if added := document["added"]:
        lines.append("nodes added between: " + ", ".join(f"{node['axis']} {node['value']:g}" for node in added))
    lines += _first(document["relaxed"], "would_be_feasible_with", "not as specified; feasible with", shown)
    broken = between["broken"]
    lines += _why(document["causes"], shown)
    lines.append(between_text(between))
    lines += [link_text(between)] if link_text(between) else []
    lines += _first(broken, "reached", "breaks its promise with", shown)
    if proof["certified"] is not False:
        lines.append(proof["text"])
    lines += table_verification(document.get("verification"))
    lines.append(f"sha256 {table['sha256']}")
    return "\n".join(lines)


def _why(causes: Sequence[dict[str, Any]], shown: int = 8) -> list[str]:
    """The causes of relaxed cells, a line each."""
    if not causes:
        return []
    more = [f"  and {len(causes) - shown} more (--json has all)"] if len(causes) > shown else []
    return [f"why cells are relaxed: {causes_text(causes)}", *(f"  {cause_text(c)}" for c in causes[:shown]), *more]


def _first(places: Sequence[dict[str, Any]], key: str, says: str, shown: int) -> list[str]:
    lines = []
    for place in places[:shown]:
        where = f"  SCR {place['scr']:.4g}, X/R {place['x_over_r']:.4g}"
        if place.get("inner_loops_fail"):
            lines.append(f"{where}: {inner_loops_text(place['inner_loops_rad_s'])}")
            continue
        values = ", ".join(f"{in_words(name)} {_limit(value)}" for name, value in place[key].items())
        lines.append(f"{where}: {says} {values}")
    return lines if len(places) <= shown else [*lines, f"  and {len(places) - shown} more (--json has all)"]


def _limit(value: float | None) -> str:
    return "∞" if value is None or math.isinf(value) else f"{value:.3g}"


def check_text(path: str, table: GainTable, outcome: TableCheck) -> str:
    """The result of a check, in lines."""
    if outcome.faults:
        return f"{path}: {counted(len(outcome.faults), 'fault')}\n" + "\n".join(
            f"  - {fault}" for fault in outcome.faults
        )
    answer = "good" if outcome.good else "no fault was found in what can be checked"
    lines = [f"{path}: {answer}. {table.name}, {counted(outcome.cells, 'cell')} analysed anew: {status_of(table)}"]
    shown = ", ".join(f"{name} {value:.2g}" for name, value in outcome.largest.items())
    if shown:
        lines.append(f"largest differences of stored margins: {shown}")
    if outcome.carried:
        lines.append(f"{CARRIED}: {', '.join(outcome.carried)}")
    return "\n".join(lines)


def status_of(table: GainTable) -> str:
    """How many cells have which status."""
    return status_text({status: int((table.status == status).sum()) for status in ("met", "relaxed", "outside")})


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, list):
        return "[" + ", ".join(_short(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_short(v)}" for k, v in value.items()) + "}"
    return str(value)


PART = 5
"""Of the page: the certificate's."""

_ASKED_PCT = 95.0


def inside_sentence(table: GainTable, measured: MeasuredErrors | None) -> str:
    """How often the estimate that was measured is inside the table's error set, at rest and after a jump; or why that
    is not known."""
    v = table.validity
    proved = table.certificate is not None and not certificate_failed(table.certificate)
    name = "certified set" if proved else "set that the table was designed for"
    if v.error == v.error_Z == 0.0:
        return "The table was designed for an exact estimate: no estimate is inside its error set."
    if measured is None:
        return f"How often an estimate is inside the {name} is not known: no errors were measured."
    found = inside_set(table, measured)
    of = f"the estimator {measured.estimator} ({counted(measured.runs, 'run')}: {measured.background})"
    if found.worst is None:
        return f"How often the estimate is inside the {name} is not known: {of} was not measured on its grids."
    i, j = found.worst
    at = f"SCR {plain(float(table.scr[i]))}, X/R {plain(float(table.x_over_r[j]))}"
    text = (
        f"The estimate is inside the {name} (R and X known {error_text(v.error, v.error_Z)}) at least "
        f"{_percent(found.shares[i, j])} of the time at rest (worst node: {at}, "
        f"{counted(int(found.answers[i, j]), 'answer')}){_since(found)}. Measured with {of}."
    )
    missing = int((table.valid & ~np.isfinite(found.shares)).sum())
    if missing:
        text += f" At {counted(missing, 'node')} nothing was measured: there it is not known."
    return text


def _since(found: InsideSet) -> str:
    if not found.since:
        return ""
    jumps = f"of {counted(found.jumps, 'jump')} of the grid"
    if found.settled_s is None:
        last, share = found.since[-1]
        return f"; after {plain(last)} s it is inside for {_percent(share)} {jumps}"
    return f", and from {plain(found.settled_s, 2)} s after a jump ({plain(100.0 * SETTLED)} % {jumps})"


def _percent(share: float) -> str:
    """Rounded down: a share that is not whole is not called so."""
    return f"{plain(np.floor(1000.0 * share + 1e-9) / 10.0)} %"


def inside_figure(table: GainTable, measured: MeasuredErrors | None) -> NamedFigure | None:
    """A map of the share of the time at rest; None where nothing was measured on the table's grids."""
    # Matplotlib is loaded for the map alone: the sentence is part of what every verb about a table prints.
    from vsgdesign.report.drawing.look import Cells, Scale
    from vsgdesign.report.drawing.panels import Frame, Panel, map_figure
    from vsgdesign.report.gain_table.maps import scr_label

    if measured is None or (table.validity.error == table.validity.error_Z == 0.0):
        return None
    found = inside_set(table, measured)
    if found.worst is None:
        return None
    values = 100.0 * found.shares
    nowhere = np.zeros(table.shape, dtype=np.bool_)
    cells = Cells(
        x=table.scr, y=table.x_over_r, values=values, unstable=nowhere, missing=np.isnan(values), partial=nowhere
    )
    low = min(float(np.nanmin(values)), 90.0)
    scale = Scale(low, 100.0, _ASKED_PCT, True, False, (0.0, 20.0, 40.0, 60.0, 80.0, 90.0, 95.0, 98.0, 100.0))
    caption = (
        "How to read: the share of the time at rest for which the measured estimate of a grid is inside the error set "
        f"of the table, R and X known {error_text(table.validity.error, table.validity.error_Z)}. A node has the worst "
        "of the ranges of grids that it lies in. Crosses: nothing was measured there."
    )
    frame = Frame(
        "table_inside",
        "How often the estimate is inside the error set",
        caption,
        scr_label(table),
        "X/R [1]",
        "Inside at rest [% of the time]",
        PART,
        gate_label=f"at least {_ASKED_PCT:g} % of the time",
        missing_label="not known: not measured",
    )
    return map_figure(frame, [[Panel("", cells)]], scale)
