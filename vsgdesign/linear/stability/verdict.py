"""The clause matrix: each quantity with its limit, the result, and the place of the evidence.

Limits of this project are labelled as such. Requirements of grid codes and test frameworks are listed with their
source and with our confidence in their wording, and they are never called a pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import DEFINITIONS, damping_of
from vsgdesign.linear.stability.assessment import ControllerAssessment
from vsgdesign.linear.stability.maps import NOT_ASKED, MarginMap
from vsgdesign.linear.stability.margins import MarginTable, rows_of
from vsgdesign.metrics.met import beside_limit, settling_met
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

OWN = "vsgdesign internal gate, no grid code"
PASS, FAIL, INFORMATIONAL, NOT_ASSESSED = "pass", "fail", "informational", "not assessed"
EVERY_CELL = "every cell"
"""Where a margin has no limit in any cell."""
NO_LIMIT = "no limit"
NOTHING = "no cell that is asked for could be analysed within the converter's limits"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One row of the clause matrix. ``confidence``: read, secondary or recalled source; empty for our own limits."""

    controller: str
    source: str
    confidence: str
    test: str
    value: str
    limit: str
    verdict: str
    evidence: str


@dataclass(frozen=True)
class WorstCase:
    """The worst cell of one quantity in a map; ``where`` names the cell and is empty if there is none.

    ``value`` is infinite where no cell has a limit: no gain, phase or delay makes a loop unstable in any of them.
    """

    quantity: str
    unit: str
    value: float
    where: str
    share_below: float
    """Share of the counted cells that do not meet the gate."""


def counted_rows(field: MarginMap) -> MarginTable:
    """The margins of a map's cells within the converter's limits."""
    return rows_of(field.table, np.flatnonzero(field.counted))


def left_out(field: MarginMap) -> tuple[list[str], int]:
    """Why cells of a map are not counted: one reason for each that exceeds a limit of the converter, and how many
    others the study's specification does not ask for."""
    reasons = [reason for reason in field.cells.outside if reason is not None]
    beyond = [reason for reason in reasons if not reason.startswith(NOT_ASKED)]
    return beyond, len(reasons) - len(beyond)


def describe_cell(field: MarginMap, flat: int) -> str:
    """A cell of a map in words."""
    parts = []
    for (name, values), index in zip(field.axes, np.unravel_index(flat, field.shape), strict=True):
        if name == "P, Q":
            parts.append(f"P {field.cells.P[flat] / 1e3:.4g} kW, Q {field.cells.Q[flat] / 1e3:.4g} kvar")
        else:
            parts.append(f"{name} {values[index]:.4g}")
    return ", ".join(parts)


def _margin(value: float, unit: str, gate: float, missed: bool) -> str:
    """A margin in words. An infinite one means that no gain, phase or delay makes the loop unstable."""
    if np.isnan(value):
        return "unstable"
    if np.isinf(value):
        return NO_LIMIT
    return f"{beside_limit(value, gate, missed, _digits, 3)} {unit}".strip().replace(" °", "°")


def _digits(value: float, digits: int) -> str:
    return f"{value:.{digits}g}"


def worst_cases(study: Study, field: MarginMap) -> tuple[WorstCase, ...]:
    """Smallest damping ratio, disk, gain, phase and delay margins and largest M_s over a map's cells within the limits.

    Unstable cells count as the worst of all, because they have no margin. Cells outside the converter's limits are
    not counted.
    """
    rows_in = np.flatnonzero(field.counted)
    table, gates = counted_rows(field), study.stability.gates
    damping = DEFINITIONS[damping_of(field.model)].title
    GM = np.minimum(table.loop_P.gain_margin_db, table.loop_Q.gain_margin_db)
    PM = np.minimum(table.loop_P.phase_margin_deg, table.loop_Q.phase_margin_deg)
    DM = np.minimum(table.loop_P.delay_margin_s, table.loop_Q.delay_margin_s)
    rows: list[tuple[str, str, Array, float, bool]] = [
        (damping, "", table.least_damping, gates.damping_ratio, True),
        (DEFINITIONS["disk_margin_output"].title, "", table.disk_output.value, np.nan, True),
        (DEFINITIONS["disk_margin_input"].title, "", table.disk_input.value, np.nan, True),
        ("gain margin", "dB", GM, gates.gain_margin_db, True),
        ("phase margin", "°", PM, gates.phase_margin_deg, True),
        ("delay margin", "s", DM, np.nan, True),
        ("peak sensitivity M_s", "", table.M_s.value, gates.M_s, False),
    ]
    found = []
    for quantity, unit, values, gate, larger_is_better in rows:
        if len(values) == 0:
            found.append(WorstCase(quantity, unit, float("nan"), "", 0.0))
            continue
        bad = np.where(table.stable | (quantity == damping), values, -np.inf if larger_is_better else np.inf)
        k = int(np.argmin(bad) if larger_is_better else np.argmax(bad))
        if not np.isfinite(bad[k]) and not table.stable[k]:
            k = int(np.argmax(table.spectral_abscissa))  # of the unstable cells the most unstable
        misses = bad < gate if larger_is_better else bad > gate
        value = float(bad[k]) if np.isfinite(bad[k]) or table.stable[k] else float("nan")
        share = float(np.mean(misses)) if np.isfinite(gate) else float("nan")
        where = EVERY_CELL if np.isinf(value) else describe_cell(field, int(field.analysed[rows_in[k]]))
        found.append(WorstCase(quantity, unit, value, where, share))
    return tuple(found)


def clause_matrix(study: Study, assessments: Sequence[ControllerAssessment]) -> tuple[Verdict, ...]:
    """All rows, controller by controller."""
    rows: list[Verdict] = []
    for a in assessments:
        rows += _own_gates(study, a) + _external(study, a)
    return tuple(rows)


def _own_gates(study: Study, a: ControllerAssessment) -> list[Verdict]:
    gates, name = study.stability.gates, a.spec.name
    rows = []
    for label, field in (("reduced", a.reduced), ("full order", a.full_order)):
        inside = counted_rows(field).stable
        analysed, stable = len(inside), int(inside.sum())
        evidence = f"map_{name}_{'reduced' if label == 'reduced' else 'full_order'}.csv"
        rows.append(
            Verdict(
                controller=name,
                source=OWN,
                confidence="",
                test=f"stable in every cell within the limits ({label})",
                value=f"{stable} of {analysed}",
                limit="all",
                verdict=NOT_ASSESSED if analysed == 0 else PASS if stable == analysed else FAIL,
                evidence=evidence,
            )
        )
        limits = {
            DEFINITIONS[damping_of(field.model)].title: (gates.damping_ratio, f"≥ {gates.damping_ratio:g}"),
            "gain margin": (gates.gain_margin_db, f"≥ {gates.gain_margin_db:g} dB"),
            "phase margin": (gates.phase_margin_deg, f"≥ {gates.phase_margin_deg:g}°"),
            "peak sensitivity M_s": (gates.M_s, f"≤ {gates.M_s:g}"),
        }
        for worst in worst_cases(study, field):
            if worst.quantity in limits:
                gate, limit = limits[worst.quantity]
                shown = _margin(worst.value, worst.unit, gate, worst.share_below > 0.0)
                verdict = FAIL if worst.share_below > 0.0 else PASS
                rows.append(
                    Verdict(
                        controller=name,
                        source=OWN,
                        confidence="",
                        test=f"{worst.quantity}, worst cell ({label})",
                        value=f"{shown} at {worst.where}" if analysed else NOTHING,
                        limit=limit,
                        verdict=verdict if analysed else NOT_ASSESSED,
                        evidence=evidence,
                    )
                )
    rows.append(_settling(study, a))
    return rows


def _settling(study: Study, a: ControllerAssessment) -> Verdict:
    limit = study.stability.gates.settling_time
    counted = a.reduced.counted
    analysed = bool(counted.any())
    late, slowest, where = 0, 0.0, ""
    for k, (p, q) in enumerate(zip(a.step_P, a.step_Q, strict=True)):
        if not counted[k]:
            continue
        times = [np.inf if r is None or r.settling_time_s is None else r.settling_time_s for r in (p, q)]
        late += not settling_met(max(times), limit)
        if max(times) > slowest:
            slowest, where = max(times), describe_cell(a.reduced, int(a.reduced.analysed[k]))
    shown = "not settled" if np.isinf(slowest) else f"{beside_limit(slowest, limit, late > 0, _digits, 3)} s"
    return Verdict(
        controller=a.spec.name,
        source=OWN,
        confidence="",
        test="2 % settling of P and Q steps, worst cell (reduced)",
        value=f"{shown} at {where}" if analysed else NOTHING,
        limit=f"≤ {limit:g} s",
        verdict=NOT_ASSESSED if not analysed else FAIL if late else PASS,
        evidence=f"map_{a.spec.name}_reduced.csv",
    )


_EXTERNAL = (
    (
        "AEMO grid-forming test framework, January 2024",
        "secondary",
        "SCR 20, 10, 3, 2, 1.5, 1.25",
        (20, 10, 3, 2, 1.5, 1.25),
    ),
    ("RTE DyCoV grid-forming templates", "read", "SCR 10 and 2", (10, 2)),
    ("ERCOT AGS-ESR", "secondary", "SCR 3", (3,)),
    ("Australian distribution, typical planning values", "secondary", "SCR 5 at X/R 10, SCR 3 at X/R 3", (5, 3)),
)
"""Grids of published tests: (source, confidence, text, SCR). Small-signal stability there is only informative,
because the tests themselves are time-domain tests, which this report does not run.
"""


def _external(study: Study, a: ControllerAssessment) -> list[Verdict]:
    rows = []
    full = a.full_order
    stable = np.where(full.cells.inside.reshape(full.shape), full.stable, np.nan)
    axis = np.array(study.stability.scr)
    for source, confidence, text, ratios in _EXTERNAL:
        nearest = [int(np.argmin(np.abs(np.log(axis / ratio)))) for ratio in ratios]
        covered = [k for k, ratio in zip(nearest, ratios, strict=True) if abs(axis[k] / ratio - 1.0) < 0.02]
        if len(covered) < len(ratios):
            missing = (f"{r:g}" for k, r in zip(nearest, ratios, strict=True) if k not in covered)
            value, verdict = f"SCR {', '.join(missing)} not on the map's axis", NOT_ASSESSED
        else:
            cells = stable[covered]
            value = f"small-signal stable in {int(np.nansum(cells))} of {int(np.isfinite(cells).sum())} cells over X/R "
            value += "that are within the limits and asked for"
            verdict = INFORMATIONAL
        rows.append(
            Verdict(
                controller=a.spec.name,
                source=source,
                confidence=confidence,
                test=f"grids of the test: {text}",
                value=value,
                limit="none published for margins",
                verdict=verdict,
                evidence=f"map_{a.spec.name}_full_order.csv",
            )
        )
    damping, all_modes = counted_rows(full).least_damping, DEFINITIONS["damping_all_modes"].title
    rows.append(
        Verdict(
            controller=a.spec.name,
            source="IEEE 2800-2022",
            confidence="recalled",
            test="damping ratio of controlled modes",
            value=f"{all_modes} {float(np.min(damping)):.3g} at least within the limits" if len(damping) else NOTHING,
            limit="≥ 0.3, to be checked",
            verdict=INFORMATIONAL if len(damping) else NOT_ASSESSED,
            evidence=f"map_{a.spec.name}_full_order.csv",
        )
    )
    rows.append(
        Verdict(
            controller=a.spec.name,
            source="FNN 2020; GB GC0137",
            confidence="secondary; recalled",
            test="phase jumps, sags, RoCoF in time domain",
            value="",
            limit="",
            verdict=NOT_ASSESSED,
            evidence="vsgdesign comply --suite fnn --suite gc0137 runs these tests",
        )
    )
    return rows
