"""The description of a gain table in words, which is the same in every place that shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

from vsgdesign.artifacts.certificate_record import CertificateCell, CertificateRecord, CertificateRegion
from vsgdesign.errors import counted

Document = Mapping[str, Any]


def certificate_sentence(certificate: CertificateRecord | None) -> str:
    """The sentence of a certificate: what it proves, or why there is none."""
    if certificate is None:
        return "There is no certificate: no proof was made for this table."
    over = _region(certificate.region)
    if not certificate.certified:
        return f"Not certified over {over}: {_defeat(certificate)}"
    what, speed = "one quadratic Lyapunov function decays", "whatever the speed of change"
    if math.isfinite(certificate.region.rate):
        what = "a quadratic Lyapunov function that follows the grid decays"
        speed = (
            f"while SCR and X/R change by no more than {_text(100.0 * certificate.region.rate, 3)} % per second each"
        )
    decay = certificate.decay
    at = "at a rate that the certificate does not state" if decay is None else f"at {_text(decay, 3)} 1/s or faster"
    return (
        f"{_proof(certificate)} Over {over}, within the static limits, {what} {at}, {speed} "
        "(power loops; ideal inner loops, no power filters)."
    )


def certificate_failed(certificate: CertificateRecord | None) -> bool:
    """Whether a proof was sought and not found: then the sentence about it comes first."""
    return certificate is not None and not certificate.certified


def certificate_summary(certificate: CertificateRecord | None) -> dict[str, Any]:
    """The same for scripts: ``certified`` (None: not sought), ``proof`` (``gap-free``, ``gridded``) and ``text``."""
    certified = None if certificate is None else certificate.certified
    proof = certificate.proof if certificate is not None and certified else None
    return {"certified": certified, "proof": proof, "text": certificate_sentence(certificate)}


def between_text(between: Document | None) -> str:
    """What a look between the nodes found (:func:`vsgdesign.design.between.between_document`)."""
    if between is None:
        return "The grids between the nodes were not looked at."
    return (
        f"between nodes: {between['points']} random grids, {between['outside']} outside the static limits, "
        f"{between['promised']} promised, {len(between['broken'])} broken"
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


def cause_text(cause: Document) -> str:
    """Why one cell is relaxed (:mod:`vsgdesign.design.causes`), and what it would keep otherwise."""
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
        f"disk margin {_found(keeps.get('disk_margin'))}, damping ratio {_found(keeps.get('damping_ratio'))}, "
        f"H {_found(keeps.get('H'))} s"
    )
    return f"{at}: a promise is given up ({missed}) because of {what}. {without} it would keep all: {figures}."


def missed_text(missed: Mapping[str, Any]) -> str:
    """Promises that are not kept, with what would have to be allowed."""
    return ", ".join(
        f"{name} {_found(value)}" if name != "inner_loops" else inner_loops_text(value)
        for name, value in missed.items()
    )


def inner_loops_text(fastest_rad_s: float | None) -> str:
    """How the inner loops fail: |s| of the unstable mode, None or NaN where there is no steady state."""
    if _is_number(fastest_rad_s) and math.isfinite(fastest_rad_s):
        return f"the inner loops or the filter are unstable at {_text(fastest_rad_s, 3)} rad/s"
    return "the inner loops find no steady state"


def causes_text(causes: Sequence[Document]) -> str:
    """How often each cause occurs, the most frequent first; empty where none is known."""
    kinds = [str(cause["cause"]) for cause in causes]
    counts = sorted({(-kinds.count(kind), kind) for kind in kinds})
    return ", ".join(f"{-count} by {kind}" for count, kind in counts)


def _found(value: Any) -> str:
    return _text(value, 3) if _is_number(value) and math.isfinite(value) else "∞"


def _percent(value: Any) -> str:
    return f"{100.0 * value:.1f} %" if _is_number(value) and math.isfinite(value) else "∞"


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


def error_text(error: float, error_Z: float) -> str:
    """How well R and X are known: "to ±20 %, or to ±6 % of |Z| where that is more" (:eq:`error-set`)."""
    own, any_way = (f"to ±{_text(100.0 * value, 3)} %" for value in (error, error_Z))
    if error_Z == 0.0:
        return "exactly" if error == 0.0 else own
    return f"{any_way} of |Z|" if error == 0.0 else f"{own}, or {any_way} of |Z| where that is more"


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _text(value: float, digits: int = 4) -> str:
    text = f"{value:.{digits}g}"
    if "e" in text and 1.0 <= abs(value) < 1e6:  # 11000, not 1.1e+04
        text = f"{float(text):.0f}"
    return text.replace("-", "−")
