"""The description of a gain table in words, which is the same in every place that shows it: its cells, its certificate,
and the steps for which no limit acts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.artifacts.certificate_record import (
    CertificateCell,
    CertificateRecord,
    CertificateRegion,
    Pair,
    StepRow,
    StepStatement,
    no_room,
)
from vsgdesign.artifacts.definitions import ASKED, in_words
from vsgdesign.artifacts.design_inputs import study_differences
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.guarded_file import is_number
from vsgdesign.artifacts.verification_text import table_verification
from vsgdesign.errors import counted

if TYPE_CHECKING:  # reading a table reads no study files
    from vsgdesign.study.parameters.study import Study

Document = Mapping[str, Any]


def certificate_sentence(certificate: CertificateRecord | None) -> str:
    """The sentence of a certificate: what it proves, or why there is none; of a plant, also of its units against each
    other."""
    if certificate is None:
        return "There is no certificate: no proof was made for this table."
    if certificate.differential is None:
        return _one_sentence(certificate)
    return (
        f"{_one_sentence(certificate)} Units against each other, with the gains of these grids: "
        f"{_one_sentence(certificate.differential)}"
    )


def _one_sentence(certificate: CertificateRecord) -> str:
    over = _region(certificate.region)
    if not certificate.certified:
        return f"Not certified over {over}, within {_limits(certificate.region)}: {_defeat(certificate)}"
    what, speed = "one quadratic Lyapunov function decays", "whatever the speed of change"
    if math.isfinite(certificate.region.rate):
        what = "a quadratic Lyapunov function that follows the grid decays"
        speed = (
            f"while SCR and X/R change by no more than {_text(100.0 * certificate.region.rate, 3)} % per second each"
        )
    if certificate.places is not None:
        what = f"a quadratic Lyapunov function for each of {certificate.places} places of the grid decays"
        speed = "while the grid stays in a place, whatever estimate and powers do"
        if certificate.move is not None:
            factor, dwell_s = certificate.move
            speed += (
                f"; a move to another place multiplies its value by at most {_text(factor, 3)}, so it falls if moves "
                f"are {_text(dwell_s, 2)} s or more apart on average"
            )
    decay = certificate.decay
    at = "at a rate that the certificate does not state" if decay is None else f"at {_text(decay, 3)} 1/s or faster"
    return (
        f"{_proof(certificate)} Over {over}, within {_limits(certificate.region)}, {what} {at}, {speed} "
        "(power loops; ideal inner loops, no power filters)."
    )


MODEL = (
    "the sampled full-order model: filter, inner loops, power filters, transient impedance, delay and sampling, with "
    "an ideal dc link and without limits"
)
"""What a full-order proof is of, in every text."""


def share_text(share: float) -> str:
    """A share that is not rounded to all or nothing."""
    digits = 2
    while digits < 9 and 0.0 < share < 1.0 and round(100.0 * share, digits) in (0.0, 100.0):
        digits += 1
    return f"{100.0 * share:.{digits}f} %"


def full_order_sentence(found: Document | None) -> str:
    """What was proved of the sampled full-order loop, in a sentence with its model; empty where no proof was tried.
    Where it is that of equal units, one more sentence is about units against each other."""
    if found is None:
        return ""
    if "reason" in found:
        return f"The sampled full-order loop is not proved: {found['reason']}"
    apart = found.get("differential")
    other = "" if apart is None else f" Units against each other, with the gains of these grids: {_one_proof(apart)}"
    return _one_proof(found) + other


def full_order_complete(found: Document) -> bool:
    """Whether the whole region is proved, of units against each other as well."""
    apart = found.get("differential")
    return bool(found["certified"]) and (apart is None or full_order_complete(apart))


def _one_proof(found: Document) -> str:
    model = f"{MODEL} ({found['states']} states, inner gains {found['inner_hash']})"
    if found["decay"] == 0.0:
        return f"The sampled full-order loop is not stable everywhere: a mode grows. Model: {model}."
    what = f"every mode of the loop decays at {_text(found['decay'], 3)} 1/s or faster on grids that rest"
    if found["proved"] == 0.0:
        return f"Nothing is proved yet of {model}."
    if found["certified"]:
        return f"Proved of {model}: {what}, without a gap between the points."
    return f"Proved of {model} on {share_text(found['proved'])} of the region: {what}. The rest is not decided."


def proof_sentences(table: GainTable) -> str:
    """What is proved of a table: of the power loops, and of the sampled full-order loop if that was tried."""
    return " ".join(filter(None, [certificate_sentence(table.certificate), full_order_sentence(table.full_order)]))


def certificate_failed(certificate: CertificateRecord | None) -> bool:
    """Whether a proof was sought and not found: then the sentence about it comes first."""
    if certificate is None:
        return False
    return not certificate.certified or certificate_failed(certificate.differential)


def certificate_summary(certificate: CertificateRecord | None) -> dict[str, Any]:
    """The same for scripts: ``certified`` (None: not sought), ``proof`` (``gap-free``, ``gridded``) and ``text``."""
    certified = None if certificate is None else certificate.certified
    proof = certificate.proof if certificate is not None and certified else None
    return {"certified": certified, "proof": proof, "text": certificate_sentence(certificate)}


def full_order_summary(table: GainTable) -> dict[str, Any]:
    """The same of the full-order proof; nothing where none was tried."""
    found = table.full_order
    if found is None:
        return {}
    names = "certified", "proved", "decay", "inner_hash", "reason"
    known, apart = ({name: of[name] for name in names if name in of} for of in (found, found.get("differential", {})))
    return {"full_order": known | ({"differential": apart} if apart else {}) | {"text": full_order_sentence(found)}}


def between_text(between: Document | None) -> str:
    """What a look between the nodes found (:func:`vsgdesign.design.between.between_document`)."""
    if between is None:
        return "The grids between the nodes were not looked at."
    return (
        f"between nodes: {between['points']} random grids, {between['outside']} outside the static limits, "
        f"{between['promised']} promised, {len(between['broken'])} broken"
    )


def link_text(between: Document | None) -> str:
    """Over which charges of a battery on the dc link the promises hold; empty without one."""
    link = None if between is None else between.get("link")
    if not link:
        return ""
    charges = ", ".join(f"{100.0 * charge:.3g}" for charge in link["charges"][:-1])
    voltages = f" (v_dc from {link['v_dc'][0]:.4g} to {link['v_dc'][1]:.4g} V)" if link["v_dc"] else ""
    return (
        f"The nodes are judged with the battery at {charges} and {100.0 * link['charges'][-1]:.3g} % of its "
        f"charge{voltages}, where it can give or take the power."
    )


_CURES = {
    "delay": ("the sampling delay", "Without it, with the same inner gains,"),
    "inner loops": ("the inner loops", "With ideal ones"),
    "estimate error": ("the error of the estimate", "With an exact estimate"),
    "inner loops and estimate error": (
        "the inner loops together with the error of the estimate",
        "With ideal inner loops and an exact estimate",
    ),
    "static limit": ("the static limit", "With half of the powers"),
    "neighbours": ("the neighbouring designs, which limit how much it may differ from them", "Without them"),
}


CAUSES = (*_CURES, "interpolation", "specification")
"""What a build names as the cause of a relaxed cell."""


def cause_text(cause: Document) -> str:
    """Why one cell is relaxed (:mod:`vsgdesign.design.table`), and what it would keep otherwise."""
    at = f"SCR {_text(cause['scr'])}, X/R {_text(cause['x_over_r'])}"
    kind, missed = cause["cause"], missed_text(cause["missed"])
    if kind == "interpolation":
        return (
            f"{at}: the cell itself keeps every promise, but a grid between it and the cells around it does not "
            f"({missed}). Nodes closer together would help."
        )
    if kind == "specification":
        near = f" Of its {cause['limit']} it uses {_text(100.0 * cause['limit_use'], 3)} %." if cause["limit"] else ""
        return (
            f"{at}: it misses its promises ({missed}) even with ideal inner loops and an exact estimate, and with half "
            f"of the powers: the specification asks for more than this structure can reach.{near}"
        )
    what, without = _CURES.get(kind, (kind, "Without that"))
    if kind == "static limit":
        what += f" ({cause['limit']}, of which it uses {_text(100.0 * cause['limit_use'], 3)} %)"
    keeps = cause["keeps"] or {}
    figures = (
        f"P and Q settle in {_found(keeps.get('settling_time'))} s with {_percent(keeps.get('overshoot'))} overshoot, "
        f"{ASKED['disk_margin']} {_found(keeps.get('disk_margin'))}, "
        f"{ASKED['damping_ratio']} {_found(keeps.get('damping_ratio'))}, "
        f"H {_found(keeps.get('H'))} s"
    )
    return f"{at}: a promise is given up ({missed}) because of {what}. {without} it would keep all: {figures}."


def missed_text(missed: Mapping[str, Any]) -> str:
    """Promises that are not kept, with what would have to be allowed."""
    return ", ".join(
        f"{in_words(name)} {_found(value)}" if name != "inner_loops" else inner_loops_text(value)
        for name, value in missed.items()
    )


def inner_loops_text(fastest_rad_s: float | None) -> str:
    """How the inner loops fail: |s| of the unstable mode, None or NaN where there is no steady state."""
    if is_number(fastest_rad_s):
        return f"the inner loops or the filter are unstable at {_text(fastest_rad_s, 3)} rad/s"
    return "the inner loops find no steady state"


def causes_text(causes: Sequence[Document]) -> str:
    """How often each cause occurs, the most frequent first; empty where none is known."""
    kinds = [str(cause["cause"]) for cause in causes]
    counts = sorted({(-kinds.count(kind), kind) for kind in kinds})
    return ", ".join(f"{-count} by {kind}" for count, kind in counts)


def _found(value: Any) -> str:
    return _text(value, 3) if is_number(value) else "∞"


def _percent(value: Any) -> str:
    return f"{100.0 * value:.1f} %" if is_number(value) else "∞"


def status_text(counts: Mapping[str, int]) -> str:
    """Cells by status."""
    return ", ".join(f"{count} {status}" for status, count in counts.items())


def _proof(certificate: CertificateRecord) -> str:
    if certificate.proof == "gap-free":
        return "Certified, gap-free (every point of the region is proved)."
    if certificate.proof != "gridded":
        return "Certified; how it was proved is not said."
    share = certificate.gap_share
    boxes = "" if share is None else f"; {_text(100.0 * (1.0 - share), 3)} % of the region is proved on boxes"
    points = "points" if certificate.points is None else counted(certificate.points, "point")
    return f"Certified on a grid only, not gap-free (verified at {points}, not between them{boxes})."


def _defeat(certificate: CertificateRecord) -> str:
    cell = certificate.cell
    if cell is not None and cell.eigenvalue is not None:
        real, imag = cell.eigenvalue.real, abs(cell.eigenvalue.imag)
        swing = f" ± {_text(imag, 3)}j" if imag > 0.0 else ""
        grows = f", e-fold in {_text(1.0 / real, 2)} s" if real > 0.0 else ""
        return (
            f"the power loops are unstable at {_place(cell)}. The eigenvalue is {_text(real, 3)}{swing} 1/s: a "
            f"disturbance grows{grows}."
        )
    text = "the reason is not said." if certificate.reason is None else certificate.reason
    if cell is not None and cell.decay is not None:
        text += f" The slowest cell is {_place(cell)}: it decays at {_text(cell.decay, 3)} 1/s."
    return text


def _place(cell: CertificateCell) -> str:
    errors = (
        "with an exact estimate"
        if cell.error_R == cell.error_L == 0.0
        else f"with an estimate of R_g that is {_off(cell.error_R)} and of L_g that is {_off(cell.error_L)}"
    )
    return (
        f"SCR {_text(cell.scr)}, X/R {_text(cell.x_over_r)}, P {_text(cell.P / 1e3)} kW, "
        f"Q {_text(cell.Q / 1e3)} kvar, {errors}"
    )


def _off(error: float) -> str:
    return "exact" if error == 0.0 else f"{_text(100.0 * abs(error), 3)} % too {'large' if error > 0.0 else 'small'}"


def _region(region: CertificateRegion) -> str:
    parts = [
        f"{shown} {_text(pair[0] / scale)} to {_text(pair[1] / scale)}{unit}"
        for pair, shown, scale, unit in (
            (region.scr, "SCR", 1.0, ""),
            (region.x_over_r, "X/R", 1.0, ""),
            (region.P, "P", 1e3, " kW"),
            (region.Q, "Q", 1e3, " kvar"),
        )
        if pair is not None
    ]
    if region.error is not None:
        parts.append(f"R_g and L_g known {error_text(region.error, region.error_Z)}")
    return ", ".join(parts) if parts else "a region that the certificate does not state"


def _limits(region: CertificateRegion) -> str:
    """The static limits by name; those of a certificate of before are fewer than a design has."""
    *first, last = region.limit_names
    names = f"{', '.join(first)} and {last}" if first else last
    return f"the static limits of {names}" + ("" if region.limits is not None else " alone")


def error_text(error: float, error_Z: float) -> str:
    """How well R and X are known: "to ±20 %, or to ±6 % of |Z| where that is more" (:eq:`error-set`)."""
    own, any_way = (f"to ±{_text(100.0 * value, 3)} %" for value in (error, error_Z))
    if error_Z == 0.0:
        return "exactly" if error == 0.0 else own
    return f"{any_way} of |Z|" if error == 0.0 else f"{own}, or {any_way} of |Z| where that is more"


def _text(value: float, digits: int = 4) -> str:
    text = f"{value:.{digits}g}"
    if "e" in text and 1.0 <= abs(value) < 1e6:  # 11000, not 1.1e+04
        text = f"{float(text):.0f}"
    return text.replace("-", "−")


def table_summary(study: Study, table: GainTable) -> dict[str, Any]:
    """A table of a study in JSON's types: hashes, proof, look between the nodes, causes, cells by status."""
    statuses, counts = np.unique(table.status, return_counts=True)
    return {
        "sha256": table.sha256,
        "design_hash": table.design_hash,
        "certificate": certificate_summary(table.certificate),
        **full_order_summary(table),
        "between": table.between,
        "causes": table.causes,
        "verification": table.verification,
        "not_of_this_study": study_differences(table, study),
        "nodes": list(table.shape),
        "status": dict(zip(statuses.tolist(), counts.tolist(), strict=True)),
    }


def table_lines(name: str, table: dict[str, Any]) -> Iterator[str]:
    """The same in words: what is proved (first where that failed), its cells, the look between its nodes, and where it
    was designed from something else than this study."""
    proof = table["certificate"]
    if proof["certified"] is False:
        yield f"{name}: {proof['text']}"
    yield f"{name}: gain table of {table['nodes'][0]} SCR × {table['nodes'][1]} X/R, {status_text(table['status'])}"
    if table["causes"]:
        yield f"why cells are relaxed: {causes_text(table['causes'])} (table show has each)"
    yield between_text(table["between"])
    if proof["certified"] is not False:
        yield proof["text"]
    if table.get("full_order"):
        yield table["full_order"]["text"]
    if table.get("verification") is not None:  # summaries of before have none
        yield from table_verification(table["verification"])
    if table["not_of_this_study"]:
        yield f"the table was not designed from this study: {'; '.join(table['not_of_this_study'])}"


STEP_HEAD = ("SCR", "P [kW]", "Q [kvar]", "P_ref [kW]", "Q_ref [kvar]", "phase [°]", "V_g [V]", "f_g [Hz]", "proof")


def step_sentence(found: StepStatement) -> str:
    """The limits that are meant, and what the numbers of the table are."""
    V = f"{_number(found.V_low_pu)} and {_number(found.V_high_pu)} pu"
    if found.current_pu is None:
        first = "The converter has no current limit, so no limit acts after any step."
        asked = f"V stays between {V}"
    else:
        kind = "soft limit" if found.soft else "limit"
        first = f'The current limiter "{found.limiter}" begins to act at {_number(found.current_pu)} pu, its {kind}'
        first += f", and it clips V at {V}." if found.clips_V else "."
        asked = "no limit acts"
    if found.reason is not None:
        return f"{first} No step is certified, because {found.reason}."
    decay = "" if found.decay is None else f" decays at {_number(found.decay)} 1/s or faster ({found.proof})"
    points = any(row.possible and row.proof != "gap-free" for row in found.rows)
    grade = ' A "gridded" row is verified at points, with a margin of 20 %, and not between them.' if points else ""
    return (
        f"{first} In the linear model with ideal inner loops, it is certified that {asked} after a step of the sizes "
        f"in the table, each alone, on a grid and to P and Q of the row. Their Lyapunov function{decay}.{grade}"
    )


def step_rows(found: StepStatement) -> list[tuple[str, ...]]:
    """The rows of STEP_HEAD as text."""
    return [_row(row, found) for row in found.rows]


def step_lines(found: StepStatement) -> list[str]:
    """The sentence and the table for a terminal."""
    rows = [STEP_HEAD, *step_rows(found)] if found.rows else []
    widths = [max(len(row[k]) for row in rows if len(row) > k) for k in range(len(STEP_HEAD))] if rows else []
    lines = []
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=False)]
        lines.append("  " + "  ".join(cells).rstrip())
    return [step_sentence(found), *lines]


def _row(row: StepRow, found: StepStatement) -> tuple[str, ...]:
    place = (_range(row.scr), _range(row.P, 1e3), _range(row.Q, 1e3))
    steps = (row.P_ref, row.Q_ref, row.phase, row.V_g, row.omega_g)
    if any(step is None for step in steps):
        return (*place, *("none",) * len(steps), _why_none(row, found))
    scales = (1e3, 1e3, math.pi / 180.0, 1.0, 2.0 * math.pi)
    return (*place, *(_down((step or 0.0) / scale) for step, scale in zip(steps, scales, strict=True)), row.proof)


def _why_none(row: StepRow, found: StepStatement) -> str:
    if row.rest_current_pu is None:
        return "no operating point"
    if no_room(row.rest_current_pu, found.current_pu):
        return f"current at rest up to {_number(row.rest_current_pu)} pu"
    return "V at rest reaches its limit"


def _range(pair: Pair, scale: float = 1.0) -> str:
    low, high = (value / scale for value in pair)
    if low == high:
        return _number(low)
    return f"±{_number(high)}" if low == -high else f"{_number(low)} to {_number(high)}"


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}g}".replace("-", "−")


def _down(value: float) -> str:
    """Three digits, rounded down: what is shown is certified, too."""
    if value <= 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{math.floor(value / unit * (1.0 + 1e-12)) * unit:.3g}"
