"""The proof of the sampled full-order loop in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vsgdesign.artifacts.certificate_record import CertificateCell
from vsgdesign.artifacts.table_text import MODEL, share_text
from vsgdesign.certificate import FullOrderProof, LeftPart, MovingProof
from vsgdesign.report.gain_table.words import CARRIED

if TYPE_CHECKING:  # its kernels are loaded by who checks
    from vsgdesign.certificate.recheck.verdict import ProofCheck

_REASONS = {
    "inner": "the inner loops alone decay more slowly, or not at all",
    "functions": "the inner loops are not enclosed well enough",
    "boxes": "the loop is not enclosed well enough",
    "time": "not looked at in the time that was given",
}

_SHOWN = 5


def full_order_text(found: FullOrderProof) -> str:
    """What is proved of the full-order model, and what is not; of several units, together and against each other."""
    if found.differential is None:
        return _text(found, f"{found.controller}: ")
    together = _text(found, f"{found.controller}, all units together: ")
    return f"{together}\n{_text(found.differential, f'{found.controller}, units against each other: ')}"


def _text(found: FullOrderProof, head: str) -> str:
    worst = f"{_where(found.slowest)}"
    if not (found.slowest.decay or 0.0) > 0.0:
        growth = -(found.slowest.decay or 0.0)
        return f"{head}Not stable: {worst}, the slowest mode grows at {growth:.3g} 1/s. Model: {MODEL}."
    if found.decay == 0.0:
        return f"{head}Not looked at, because the plant is not stable. Model: {MODEL}."
    inner = f"{found.states} states, inner gains {found.inner_hash}"
    circle = f"|z| = exp(−{found.decay:.4g} s⁻¹·T_s)"
    loop = f"every eigenvalue of the loop lies inside {circle}, without a gap between the points"
    region = found.region
    grids = f"SCR {region.scr[0]:.4g} to {region.scr[1]:.4g}, X/R {region.x_over_r[0]:.4g} to {region.x_over_r[1]:.4g}"
    P, Q = ([value / 1e3 for value in limits] for limits in (region.P, region.Q))
    powers = f"P {P[0]:.4g} to {P[1]:.4g} kW, Q {Q[0]:.4g} to {Q[1]:.4g} kvar"
    errors = f"errors of ±{100.0 * region.error:.4g} %"
    if region.error_Z:
        errors += f" or {100.0 * region.error_Z:.4g} % of |Z_g|"
    size = f"Proved on {found.boxes} boxes in {found.cells} cells of grids, with rounding enclosed."
    least = f"The least decay that a search found is {found.slowest.decay:.4g} 1/s, {worst}."
    model = f"Model: {MODEL} ({inner})."
    if not found.left:
        return f"{head}Proved. Over {grids}, {powers} and {errors}, {loop}.\n{size} {least}\n{model}"
    lines = [
        f"{head}Not proved everywhere. On {share_text(found.proved)} of {grids}, {powers} and {errors}, {loop}.",
        f"{size} {least}",
        "Not decided, the largest parts first:",
    ]
    return "\n".join([*lines, *_left_lines(found.left), model])


def _left_lines(left: Sequence[LeftPart]) -> list[str]:
    """The largest parts that are not proved, and how much the others are."""
    lines = []
    for part in left[:_SHOWN]:
        lines.append(
            f"  SCR {part.scr[0]:.4g} to {part.scr[1]:.4g}, X/R {part.x_over_r[0]:.4g} to {part.x_over_r[1]:.4g}, "
            f"P {part.P[0] / 1e3:.4g} to {part.P[1] / 1e3:.4g} kW, Q {part.Q[0] / 1e3:.4g} to {part.Q[1] / 1e3:.4g} "
            f"kvar: {share_text(part.share)}, {_REASONS[part.reason]}{_unknown(part)}"
        )
    if len(left) > _SHOWN:
        rest = sum(part.share for part in left[_SHOWN:])
        lines.append(f"  and {len(left) - _SHOWN} more: {share_text(rest)}")
    return lines


def moving_text(found: MovingProof) -> str:
    """What is proved while the gains change, what was looked at by points, and how long grids have to last; of several
    units, together and against each other."""
    head = f"{found.controller}, changing gains: "
    if found.differential is None:
        return _moving_text(found, head)
    alike = "All units have the gains of one estimate."
    together = _moving_text(found, f"{found.controller}, changing gains, all units together: {alike} ")
    apart = f"{found.controller}, changing gains, units against each other: "
    return f"{together}\n{_moving_text(found.differential, apart)}"


def _moving_text(found: MovingProof, head: str) -> str:
    grids = "on each grid with its P and Q one function falls under all gains of the estimates"
    if found.why_not is not None:
        lines = [f"{head}Nothing is proved between points: {found.why_not}."]
    elif found.decay is None:
        lines = [f"{head}Not proved anywhere."]
    else:
        part = "Proved everywhere" if found.complete else f"Proved on {share_text(found.proved)} of the region"
        rates = f"at {found.decay[0]:.3g} 1/s or more, at {found.decay[1]:.3g} 1/s on the fastest grids"
        lines = [f"{head}{part}: {grids}, {rates} ({found.boxes} boxes in {found.cells} cells)."]
    if found.left:
        lines += ["Not decided, the largest parts first:", *_left_lines(found.left)]
    sampled = found.sampled
    seen, of = sampled.lines
    whole = "" if seen == of else f", on {seen} of its {of} lines of one X/R, P and Q in the time that was given"
    held = sampled.places - len(sampled.without)
    lines.append(f"Sampled: {held} of {sampled.places} places of a lattice have such a function{whole}.")
    for cell in sampled.without:
        lines.append(
            f"  none found at SCR {cell.scr:.4g}, X/R {cell.x_over_r:.4g}, P {cell.P / 1e3:.4g} kW, "
            f"Q {cell.Q / 1e3:.4g} kvar (least decay {cell.decay:.3g} 1/s)"
        )
    if np.isfinite(sampled.near[0]):
        lines.append(
            f"Grids that take turns have to last {sampled.near[0]:.2g} s (median; at most {sampled.near[1]:.2g} s) "
            f"where their SCR differ by {100.0 * (sampled.ratio - 1.0):.0f} %, and {sampled.far[0]:.2g} s (at most "
            f"{sampled.far[1]:.2g} s) between any two SCR of the lattice. From neighbour to neighbour SCR may move by "
            f"{100.0 * np.log(sampled.ratio) / sampled.near[1]:.2g} % a second. Both are statements about places."
        )
    if isinstance(found.steps, str):
        lines.append(f"Steps after which no limit acts are not known: {found.steps.rstrip('.')}.")
    else:
        P, Q, phase, V_g, omega_g = found.steps.least
        lines.append(
            f"No limit acts after one step of P_ref by {P:.2g} pu, of Q_ref by {Q:.2g} pu, of the phase by "
            f"{np.degrees(phase):.2g}°, of V_g by {100.0 * V_g:.2g} % or of ω_g by {omega_g:.2g} rad/s: the least of "
            f"{found.steps.places} places of the lattice."
        )
    return "\n".join(lines)


def proof_check_text(path: str, found: ProofCheck) -> str:
    """What a second look at a proof found."""
    if found.faults:
        return f"{path}: refused\n" + "\n".join(f"  - {fault}" for fault in found.faults)
    if found.carried:
        return f"{path}: {CARRIED}: {', '.join(found.carried)}"
    text = _confirmed(path, found)
    return text if found.apart is None else f"{text}\n{_confirmed(f'{path}, units against each other', found.apart)}"


def _confirmed(path: str, found: ProofCheck) -> str:
    looked = found.looked
    if looked is None:
        return f"{path}: not looked at"
    boxes = f"all {looked.boxes}" if looked.boxes == looked.of else f"{looked.boxes} of {looked.of}"
    proved, volume = share_text(found.proved or 0.0), share_text(looked.share)
    return (
        f"{path}: confirmed. Boxes and arcs cover the region and the circle, {proved} of it as "
        f"proved.\nA second enclosure confirms {boxes} boxes ({volume} of the volume). The least decay "
        f"of another search is {found.decay:.4g} 1/s."
    )


def _unknown(part: LeftPart) -> str:
    """Where on the circle f is not known, and what a search found there."""
    text = ""
    if part.frequency is not None:
        text += f" between {part.frequency[0]:.3g} and {part.frequency[1]:.3g} rad/s"
    if part.least_decay is not None:
        text += f"; the least decay that a search found there is {part.least_decay:.3g} 1/s"
    return text


def _where(cell: CertificateCell) -> str:
    return (
        f"at SCR {cell.scr:.4g}, X/R {cell.x_over_r:.4g}, P {cell.P / 1e3:.4g} kW, Q {cell.Q / 1e3:.4g} kvar, with an "
        f"estimate of R_g that is off by {100.0 * cell.error_R:+.3g} % and of L_g by {100.0 * cell.error_L:+.3g} %"
    )
