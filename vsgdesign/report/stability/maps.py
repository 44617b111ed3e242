"""Heat maps over SCR and X/R: margins of every controller in both models, settling, gains."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import DEFINITIONS, damping_of
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.stability.assessment import ControllerAssessment
from vsgdesign.linear.stability.maps import MarginMap
from vsgdesign.linear.stability.margins import MarginTable
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.look import Cells, Scale, gate_scale
from vsgdesign.report.drawing.panels import MOST, Frame, Panel, Surface, groups, map_figure, surface_figure
from vsgdesign.report.drawing.quantities import GAIN_UNITS, merged, plain
from vsgdesign.report.drawing.time_axis import symbols
from vsgdesign.report.stability.tables import MODEL_NAMES
from vsgdesign.runtime.of_study import follows_measured
from vsgdesign.simulation.stability_result import StabilityResult
from vsgdesign.study.parameters.specification import Gates
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

CIRCLES = (
    "Circles: the steady state is outside the converter's limits of voltage or current, or the specification does not "
    "ask for the grid, so the cell is shown and counts for no worst case."
)

_MOST_COLUMNS = 3
PART = 3


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One column of the margin tables and how it is drawn."""

    name: str
    title: str
    label: str
    column: Callable[[MarginTable], Array]
    scale: Callable[[Gates], Scale]
    gate_text: Callable[[Gates], str] | None
    how: str
    larger_is_better: bool = True


def gain_margin_of(table: MarginTable) -> Array:
    """The smaller gain margin of the two loops, dB."""
    return np.minimum(table.loop_P.gain_margin_db, table.loop_Q.gain_margin_db)


def phase_margin_of(table: MarginTable) -> Array:
    """The smaller phase margin of the two loops, degrees."""
    return np.minimum(table.loop_P.phase_margin_deg, table.loop_Q.phase_margin_deg)


_OUTPUT = DEFINITIONS["disk_margin_output"]
DAMPING = Quantity(
    name="damping",
    title="Damping ratio",
    label="Damping ratio ζ [1]",
    column=lambda t: t.least_damping,
    scale=lambda g: gate_scale(0.0, 1.0, g.damping_ratio, (0.0, 0.1, 0.2, 0.5, 0.7, 1.0)),
    gate_text=lambda g: f"gate ζ = {plain(g.damping_ratio)}",
    how=f"the least damping ratio, −Re s/|s|: reduced, the {DEFINITIONS['damping_power_loops'].title}; full order, the "
    f"{DEFINITIONS['damping_all_modes'].title}",
)
DISK = Quantity(
    name="disk_margin",
    title=_OUTPUT.heading,
    label=f"{_OUTPUT.heading} α [1]",
    column=lambda t: t.disk_output.value,
    scale=lambda _: Scale(0.0, 2.0, ticks=(0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)),
    gate_text=None,
    how=f"the {_OUTPUT.title}: both loops at once, balanced, broken at the measured P and Q; α allows gain changes by "
    "(1 + α/2)/(1 − α/2) and phase changes by 2·atan(α/2) in both loops at once. It has no gate",
)
GAIN_MARGIN = Quantity(
    name="gain_margin",
    title="Gain margin",
    label="Gain margin, worse loop [dB]",
    column=gain_margin_of,
    scale=lambda g: gate_scale(0.0, 30.0, g.gain_margin_db, (0.0, 3.0, 10.0, 20.0, 30.0, 40.0, 60.0)),
    gate_text=lambda g: f"gate {plain(g.gain_margin_db)} dB",
    how="the smaller gain margin of the P and the Q loop, each with the other closed; a loop without phase crossing "
    "has an infinite one and takes the end's colour",
)
PHASE_MARGIN = Quantity(
    name="phase_margin",
    title="Phase margin",
    label="Phase margin, worse loop [°]",
    column=phase_margin_of,
    scale=lambda g: gate_scale(0.0, 90.0, g.phase_margin_deg, (0.0, 10.0, 20.0, 45.0, 60.0, 90.0, 120.0, 180.0)),
    gate_text=lambda g: f"gate {plain(g.phase_margin_deg)}°",
    how="the smaller phase margin of the P and the Q loop, each with the other closed",
)
M_S = Quantity(
    name="M_s",
    title="Peak sensitivity",
    label="Peak sensitivity $M_s$ [1]",
    column=lambda t: t.M_s.value,
    scale=lambda g: gate_scale(1.0, 10.0, g.M_s, (1.0, 1.5, 3.0, 5.0, 10.0, 20.0), larger_is_better=False, log=True),
    gate_text=lambda g: f"gate $M_s$ = {plain(g.M_s)}",
    how="the peak over frequency of the largest singular value of the sensitivity at the plant's output; small is good",
    larger_is_better=False,
)


def of_model(quantity: Quantity, model: str) -> Quantity:
    """A quantity as a figure of one model alone calls it."""
    if quantity is not DAMPING:
        return quantity
    of = DEFINITIONS[damping_of(model)]
    return replace(quantity, title=of.heading, label=f"{of.heading} ζ [1]", how=f"the {of.title}, −Re s/|s|")


QUANTITIES = (DAMPING, DISK, GAIN_MARGIN, PHASE_MARGIN, M_S)


def baseline_first(result: StabilityResult) -> list[tuple[int, ControllerAssessment]]:
    """(index, assessment), fixed gains before scheduled ones."""
    numbered = list(enumerate(result.assessments))
    return sorted(numbered, key=lambda item: item[1].spec.kind != "fixed")


def worst_over_powers(field: MarginMap, column: Array, larger_is_better: bool = True) -> Cells:
    """A column of a map over SCR × X/R, the worst over its operating points within the converter's limits.

    Where no operating point that can be analysed is within the limits, the worst of the others, marked so.
    """
    values, stable = field.field(column), field.stable
    known = ~np.isnan(stable)
    within = known & field.cells.inside.reshape(field.shape)
    missing = np.array(~np.any(known, axis=2))
    outside = np.array(~np.any(within, axis=2)) & ~missing
    counted = np.where(outside[..., None], known, within)
    unstable = np.any((stable == 0.0) & counted, axis=2)
    fill = np.inf if larger_is_better else -np.inf
    left = np.isnan(values) | ~counted
    filled = np.where(left, fill, values)
    worst = filled.min(axis=2) if larger_is_better else filled.max(axis=2)
    seen = np.any(~left, axis=2)
    partial = np.array(np.any(counted, axis=2) & ~np.all(counted, axis=2)) & ~outside
    shown = np.where(seen, worst, np.nan)
    return Cells(
        x=field.axes[0][1],
        y=field.axes[1][1],
        values=shown,
        unstable=unstable,
        missing=missing,
        partial=partial,
        outside=outside,
    )


def map_figures(result: StabilityResult) -> Iterator[NamedFigure]:
    """Part 3: every quantity, then settling, then the scheduled gains."""
    for quantity in QUANTITIES:
        yield from _quantity_figures(result, quantity)
    yield from _settling_figures(result)
    for index, a in baseline_first(result):
        if a.spec.kind == "scheduled":
            yield from _gain_figures(result, index, a)


def _name(base: str, part: int, count: int) -> str:
    return base if count == 1 else f"{base}_{part + 1}"


def _quantity_figures(result: StabilityResult, quantity: Quantity) -> Iterator[NamedFigure]:
    gates = result.study.stability.gates
    parts = groups(baseline_first(result), _MOST_COLUMNS)
    for k, part in enumerate(parts):
        rows = [
            [
                Panel(
                    f"{a.spec.name} ({a.spec.kind}), {MODEL_NAMES[field.model]}",
                    worst_over_powers(field, quantity.column(field.table), quantity.larger_is_better),
                    f"map.{index}.{field.model}",
                )
                for index, a in part
                for field in (pick(a),)
            ]
            for pick in (lambda a: a.reduced, lambda a: a.full_order)
        ]
        if len(part) == 1:
            rows = [[row[0] for row in rows]]
        gate = None if quantity.gate_text is None else quantity.gate_text(gates)
        caption = (
            f"How to read: each cell is a grid, its colour {quantity.how}. "
            f"{_sides(gate)}{_powers(result.study)}{_left_out(part)}"
        )
        frame = Frame(
            _name(f"map_{quantity.name}", k, len(parts)),
            quantity.title,
            caption,
            *axis_labels(result.study),
            quantity.label,
            PART,
            gate_label=gate,
        )
        yield map_figure(frame, rows, quantity.scale(gates))


def axis_labels(study: Study) -> tuple[str, str]:
    """Labels of the SCR and X/R axes."""
    return f"SCR, {study.scr_basis} basis [1]", "X/R [1]"


def _sides(gate: str | None) -> str:
    if gate is None:
        return ""
    gate = gate.replace("$M_s$", "M_s").replace("gate ", "", 1)
    return (
        f"Blue cells meet our gate ({gate}), orange ones miss it, and the black line runs between them; "
        "unstable cells have no margin. "
    )


def _powers(study: Study) -> str:
    s = study.stability
    count = len(s.P) * len(s.Q)
    if count == 1:
        return f"At P = {plain(s.P[0] / 1e3)} kW, Q = {plain(s.Q[0] / 1e3)} kvar."
    return (
        f"Each cell shows the worst of those of its {count} operating points (P, Q) that are within the converter's "
        "limits; it is unstable if one of them is."
    )


def _left_out(part: Sequence[tuple[int, ControllerAssessment]]) -> str:
    """Why cells are not analysed, in the words of the analysis; and what circles are."""
    reasons = merged(
        fault.partition(":")[0]
        for _, a in part
        for field in (a.reduced, a.full_order)
        for fault in field.faults
        if fault
    )
    text = f" Crosses: {'; '.join(reasons).rstrip('.')}." if reasons else ""
    if any(not field.cells.inside[field.analysed].all() for _, a in part for field in (a.reduced, a.full_order)):
        text += f" {CIRCLES}"
    return text


def settling_cells(a: ControllerAssessment) -> Cells:
    """The longer 2 % settling time of the P and the Q step of the reduced model; infinite if not settled."""
    times = np.array(
        [
            max(np.inf if r is None or r.settling_time_s is None else r.settling_time_s for r in pair)
            for pair in zip(a.step_P, a.step_Q, strict=True)
        ]
    )
    return worst_over_powers(a.reduced, times, larger_is_better=False)


def _settling_figures(result: StabilityResult) -> Iterator[NamedFigure]:
    gates = result.study.stability.gates
    gate = gates.settling_time
    ticks = tuple(gate * f for f in (0.2, 0.5, 2.0, 5.0, 10.0))
    scale = gate_scale(0.2 * gate, 10.0 * gate, gate, ticks, larger_is_better=False, log=True)
    parts = groups(baseline_first(result), _MOST_COLUMNS)
    for k, part in enumerate(parts):
        panels = [
            Panel(f"{a.spec.name} ({a.spec.kind}), reduced", settling_cells(a), f"map.{index}.reduced")
            for index, a in part
        ]
        text = f"gate {plain(gate)} s"
        caption = (
            "How to read: each cell is a grid, its colour the longer of the 2 % settling times of a P and of a Q step, "
            f"each against its own final value, of the reduced model. {_sides(text)}{_powers(result.study)} Steps that "
            f"do not settle within 12 s take the end's colour.{_left_out(part)}"
        )
        frame = Frame(
            _name("map_settling", k, len(parts)),
            "Settling time",
            caption,
            *axis_labels(result.study),
            "Settling time [s]",
            PART,
            gate_label=text,
        )
        yield map_figure(frame, [panels], scale)


def _gain_figures(result: StabilityResult, index: int, a: ControllerAssessment) -> Iterator[NamedFigure]:
    fixed = [other for other in result.assessments if other.spec.kind == "fixed"]
    baseline = "; ".join(f"{other.spec.name}: {_fixed_gains(other)}" for other in fixed)
    more = f" The fixed gains, the same on every grid, are {baseline}." if baseline else ""
    yield from gain_figures(result, index, a, more)


def _fixed_gains(a: ControllerAssessment) -> str:
    gains = a.reduced.cells.gains._asdict()
    return ", ".join(
        f"{name} = {plain(float(gains[name][0]), 3)} {GAIN_UNITS[name]}" for name in used_gains(a.reduced.cells.gains)
    )


def used_gains(gains: PowerLoopGains) -> list[str]:
    """Names of the gains that are not zero everywhere; the published structure's four always."""
    defaults = gains._field_defaults
    return [name for name in gains._fields if name not in defaults or np.any(np.nan_to_num(getattr(gains, name)) != 0)]


def gain_symbol(name: str) -> str:
    """K_ip as a formula."""
    return f"${name[0]}_{{{name[2:]}}}$"


def gain_figures(result: StabilityResult, index: int, a: ControllerAssessment, baseline: str) -> Iterator[NamedFigure]:
    """A panel for every gain, four a figure; nothing where no grid has gains."""
    field = a.reduced
    gains = PowerLoopGains(*(np.reshape(value, field.shape)[:, :, 0] for value in field.cells.gains))
    if not np.isfinite(gains.K_ip).any():
        return
    reasons = dict.fromkeys(fault.partition(": ")[2] for fault in field.cells.faults if fault and "no gains" in fault)
    missing = " Crosses: no operating point, or no gains." if np.isnan(gains).any() else ""
    missing = f" Crosses: no gains, {'; '.join(reasons)}." if reasons else missing
    s = result.study.stability
    place = "They belong to the grid alone, whatever the operating point."
    if follows_measured(a.spec):
        place = (
            "They follow the measured P, Q and V and are shown in the steady state at "
            f"P = {plain(s.P[0] / 1e3)} kW, Q = {plain(s.Q[0] / 1e3)} kvar."
        )
    caption = (
        "How to read: the gains that the schedule gives each grid, one colour scale a gain, logarithmic where "
        f"all values are positive. {place}{missing}{baseline}"
    )
    surfaces = [
        Surface(
            symbols(f"{a.spec.name}: ") + gain_symbol(name),
            gain_symbol(name),
            GAIN_UNITS[name],
            getattr(gains, name),
            f"map.{index}.gains.{name}",
        )
        for name in used_gains(gains)
    ]
    for first in range(0, len(surfaces), MOST):
        name = f"map_gains_{index + 1}" + (f"_{first // MOST + 1}" if len(surfaces) > MOST else "")
        named = (name, f"Scheduled gains of {a.spec.name}", caption)
        label = f"SCR, {result.study.scr_basis} basis [1]"
        yield surface_figure(named, field.axes[0][1], field.axes[1][1], surfaces[first : first + MOST], label, PART)
