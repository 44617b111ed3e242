"""The verdict, one paragraph for each controller, computed from numbers only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsgdesign.linear.model.full_order import PARAMETERS
from vsgdesign.linear.stability.assessment import ControllerAssessment
from vsgdesign.linear.stability.loci import Mode, ModeSensitivity, mode_sensitivities, modes
from vsgdesign.linear.stability.maps import MarginMap, full_order_cells
from vsgdesign.linear.stability.verdict import (
    FAIL,
    NOT_ASSESSED,
    NOTHING,
    OWN,
    PASS,
    Verdict,
    counted_rows,
    describe_cell,
)
from vsgdesign.report.drawing import spark
from vsgdesign.report.drawing.quantities import merged, number
from vsgdesign.report.page.blocks import MET, MISSED, UNKNOWN, Answer, Cell, Row, counted
from vsgdesign.report.stability.tables import complex_text, left_out_parts, state_symbol
from vsgdesign.simulation.stability_result import StabilityResult
from vsgdesign.study.parameters.study import Study

_MOVED = tuple(name for name in PARAMETERS if name not in ("omega_0", "omega_g", "V_n", "P_ref", "Q_ref", "V_g"))
"""Parameters of the design and of the circuit."""


@dataclass(frozen=True)
class WorstMode:
    """The mode that limits a map, its place, and its cause."""

    where: str
    mode: Mode
    sensitivities: tuple[ModeSensitivity, ...]


def worst_mode(study: Study, field: MarginMap) -> WorstMode | None:
    """The most unstable mode of a full-order map's cells within the converter's limits, or else the least damped one;
    None without any."""
    table = counted_rows(field)
    if len(table.stable) == 0:
        return None
    unstable = not bool(table.stable.all())
    k = int(np.argmax(table.spectral_abscissa) if unstable else np.argmin(table.least_damping))
    flat = int(field.analysed[field.counted][k])
    model = full_order_cells(study, field.cells.take(np.array([flat])))
    if len(model.index) == 0:
        return None
    found = modes(model.states, model.A[0], model.T_s)
    mode = found[0] if unstable else min((m for m in found if np.isfinite(m.s)), key=lambda m: m.damping)
    return WorstMode(describe_cell(field, flat), mode, mode_sensitivities(model, 0, mode.s, _MOVED))


def verdict_text(result: StabilityResult) -> list[str]:
    """Paragraphs: how many gates are met, what limits each controller, and what the verdict does not cover."""
    sentences = [_controller(result, a) for a in result.assessments]
    sentences.append(
        "A gate is a limit for a margin that this project or the study sets; no grid code asks for it. What grid codes "
        "and test frameworks ask for is listed as informational or as not assessed, never as a pass."
    )
    return sentences


def _controller(result: StabilityResult, a: ControllerAssessment) -> str:
    own = [row for row in result.verdicts if row.controller == a.spec.name and row.source == OWN]
    field, table = a.full_order, counted_rows(a.full_order)
    head = f"Controller {a.spec.name} ({a.spec.kind} gains) meets {_count(own)}"
    cells = len(field.faults)
    parts = left_out_parts(field)
    faulty = sum(bool(fault) and not beyond for fault, beyond in zip(field.faults, field.cells.outside, strict=True))
    if len(table.stable) == 0:
        reason = f", {_reason(field)}" if faulty else ""
        beyond = "".join(f"; {part}" for part in parts)
        return f"{head}: none of its {cells} cells could be analysed within the limits{reason}{beyond}."
    analysed = len(table.stable)
    parts += [f"{faulty} of {cells} could not be analysed"] if faulty else []
    part = f" ({'; '.join(parts)})" if parts else ""
    text = f"{head}: in the full-order model {int(table.stable.sum())} of {analysed} analysed cells are stable{part}"
    reduced = counted_rows(a.reduced)
    if len(reduced.stable) and reduced.stable.sum() != table.stable.sum():
        text += f", in the reduced one {int(reduced.stable.sum())} of {len(reduced.stable)}"
    worst = worst_mode(result.study, field)
    if worst is None:
        return f"{text}."
    mode = worst.mode
    kind = "an unstable mode" if mode.s.real >= 0.0 else f"a mode of damping ratio {number(mode.damping)}"
    frequency = (
        "without oscillation" if abs(mode.s.imag) < 1e-9 else f"at {number(abs(mode.s.imag) / (2.0 * math.pi))} Hz"
    )
    states = ", ".join(f"{state_symbol(state)} ({100.0 * share:.0f} %)" for state, share in mode.participation[:3])
    moved = ", ".join(s.parameter for s in worst.sensitivities[:3])
    return (
        f"{text}. Its worst cell is {worst.where}, limited by {kind} {frequency} (s = {complex_text(mode.s)} 1/s), in "
        f"which {states} take part most; of circuit and controller parameters {moved} move it most for the same "
        "relative change."
    )


def _count(own: Sequence[Verdict]) -> str:
    met = sum(row.verdict == PASS for row in own)
    return f"{met} of its {len(own)} gates"


def _reason(field: MarginMap) -> str:
    reasons = merged(fault for fault in field.faults if fault)
    return "; ".join(reasons) if len(reasons) <= 2 else f"{next(iter(reasons))}; and {len(reasons) - 1} other reasons"


_MODEL, _REDUCED = " (full order)", " (reduced)"
_TITLES = {
    "stable in every cell within the limits": "Stable",
    "2 % settling of P and Q steps": "Settling time",
}
"""Short headings of gates; any other has the name of its quantity."""


def gates_of(result: StabilityResult, name: str) -> list[Verdict]:
    """The internal gates of one controller, in the order of the clause matrix."""
    return [row for row in result.verdicts if row.controller == name and row.source == OWN]


def stability_headline(result: StabilityResult) -> str:
    """Which controllers meet all of their gates; of the first that does not, which gate it misses, and where, and the
    names of the others that it misses."""
    names = [a.spec.name for a in result.assessments]
    missed = {name: _missed(gates_of(result, name)) for name in names}
    good = [name for name in names if all(row.verdict == PASS for row in gates_of(result, name))]
    first = next((f" {name}: {text}" for name, text in missed.items() if text), "")
    if not good and not first:  # a gate that nothing could be held against is not missed
        return f"No gate of {' or '.join(names)} is missed, but {_not_assessed(result, names)}."
    if len(names) == 1:
        return f"{names[0]} {'meets' if good else 'does not meet'} all of its gates.{first}"
    if not good:
        return f"No controller meets all of its gates.{first}"
    if good == names:
        return "Every controller meets all of its gates."
    return f"All gates are met by {', '.join(good)} only.{first}"


def _missed(own: Sequence[Verdict]) -> str:
    """The first gate that is missed with its value, and the names of the others; empty where all are met."""
    texts, names = missed_gates(own), list(dict.fromkeys(_short(row.test) for row in own if row.verdict == FAIL))
    more = f" Also missed: {', '.join(names[1:])}." if names[1:] else ""
    return f"{texts[0]}.{more}" if texts else ""


def _not_assessed(result: StabilityResult, names: Sequence[str]) -> str:
    """How many gates have no verdict, and why."""
    own = [row for name in names for row in gates_of(result, name)]
    count = sum(row.verdict == NOT_ASSESSED for row in own)
    return f"{count} of {len(own)} could not be assessed" + (f": {NOTHING}" if count == len(own) else "")


def missed_gates(own: Sequence[Verdict]) -> list[str]:
    """Each gate that is missed: what it is about, its value with the cell, and its limit."""
    return [f"{row.test} is {row.value}, asked {row.limit}" for row in own if row.verdict == FAIL]


def gates_text(result: StabilityResult) -> list[str]:
    """How many gates of this project are met, each that is missed, and what the rows of other sources say."""
    ours = [row for row in result.verdicts if row.source == OWN]
    others = [row for row in result.verdicts if row.source != OWN]
    found = [f"gates (ours, no grid code): {_kinds(ours)}"]
    found += [
        f"  {name}: {text}"
        for name in dict.fromkeys(row.controller for row in ours)
        for text in missed_gates(gates_of(result, name))
    ]
    return [*found, f"grid codes and test frameworks: {_kinds(others)}"]


def _kinds(rows: Sequence[Verdict]) -> str:
    verdicts = [row.verdict for row in rows]
    return ", ".join(f"{verdicts.count(kind)} {kind}" for kind in dict.fromkeys(verdicts))


def stability_answer(result: StabilityResult) -> Answer:
    """One row a controller, one column for all gates and one for each gate of the model that counts."""
    of_controllers = {a.spec.name: gates_of(result, a.spec.name) for a in result.assessments}
    tests = [
        test for test in dict.fromkeys(row.test for own in of_controllers.values() for row in own) if _counts(test)
    ]
    rows = tuple(
        Row(name, (_all(own), *(_gate(own, test) for test in tests)), spark.key(index))
        for index, (name, own) in enumerate(of_controllers.items())
    )
    notes = (
        "Worst cells of the full-order model within the converter's limits; the settling time is that of the reduced "
        "model. A gate is a limit for a margin that this project or the study sets; no grid code asks for it. Those of "
        "the reduced model are in part 1.",
    )
    return Answer("Against the gates", ("All gates", *map(_title, tests)), rows, notes=notes)


def _counts(test: str) -> bool:
    """Whether a gate has a column: those of the full-order model, and those that the reduced one alone has."""
    return test.endswith(_MODEL) or test.startswith("2 % settling")


def _short(test: str) -> str:
    return test.removesuffix(_MODEL).removesuffix(_REDUCED).removesuffix(", worst cell")


def _title(test: str) -> str:
    short = _short(test)
    title = _TITLES.get(short, short)
    return title[0].upper() + title[1:]


def _all(own: Sequence[Verdict]) -> Cell:
    judged = [row.verdict == PASS for row in own if row.verdict in (PASS, FAIL)]
    left = len(own) - len(judged)
    if not judged:
        return Cell(UNKNOWN, "not assessed")
    return counted(judged, f"{left} of {len(own)} not assessed" if left else "")


def _gate(own: Sequence[Verdict], test: str) -> Cell:
    row = next((one for one in own if one.test == test), None)
    if row is None or row.verdict not in (PASS, FAIL):
        return Cell(UNKNOWN, "not assessed")
    value, _, where = row.value.partition(" at ")
    detail = f"{value}, asked {row.limit}{f'; at {where}' if where else ''}"
    return Cell(MET, "met", detail) if row.verdict == PASS else Cell(MISSED, "missed", detail)
