"""The tables of the stability report, as texts ready to be set."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from vsgdesign.artifacts import provenance
from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.equations.frames import phase_to_ll
from vsgdesign.errors import share_percent
from vsgdesign.linear.stability.assessment import ControllerAssessment
from vsgdesign.linear.stability.maps import OUTSIDE, MarginMap
from vsgdesign.linear.stability.verdict import NO_LIMIT, NOTHING, left_out, worst_cases
from vsgdesign.metrics.events import TOO_SHORT
from vsgdesign.metrics.margins import guaranteed_margins
from vsgdesign.report.drawing.quantities import DASH, merged, number, percent, plain, plain_quantity
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.stability.steps import SOURCES, metrics_of
from vsgdesign.simulation.stability_result import StabilityResult

MODEL_NAMES = {"reduced": "reduced", "full_order": "full order"}
_MOST_SENSITIVITIES = 6


def identity_table(result: StabilityResult) -> Table:
    """What was assessed: names, hashes, versions, bases."""
    study, c = result.study, result.study.converter
    s = study.stability
    rows = [
        ("Study", study.name),
        ("SHA-256 of its resolved document", study.hash),
        *((f"Version of {name}", version) for name, version in provenance().items()),
        ("Base power S", plain_quantity(c.S_rated, "VA")),
        (
            "Base voltage V",
            f"{plain_quantity(c.V_rated_rms, 'V')} phase rms "
            f"({plain_quantity(phase_to_ll(c.V_rated_rms), 'V')} line to line)",
        ),
        ("Base angular frequency ω", f"{plain(c.omega_n, 5)} rad/s ({plain(c.omega_n / (2.0 * math.pi))} Hz)"),
        ("Base impedance Z = V²/S (line to line)", plain_quantity(c.Z_base, "Ω")),
        ("SCR basis", study.scr_basis),
        ("Operating points of the maps, P", ", ".join(plain_quantity(p, "W") for p in s.P)),
        ("Operating points of the maps, Q", ", ".join(plain_quantity(q, "var") for q in s.Q)),
        (
            "Map axes",
            f"SCR {plain(s.scr[0])} to {plain(s.scr[-1])} ({len(s.scr)} values), "
            f"X/R {plain(s.x_over_r[0])} to {plain(s.x_over_r[-1])} ({len(s.x_over_r)} values)",
        ),
        ("Estimate errors", ", ".join(f"{plain(100.0 * e)} %" for e in s.errors)),
    ]
    notes = ("At every operating point P and Q are exact at the control point, in spite of droop.",)
    return Table("Identity", ("Quantity", "Value"), tuple(rows), texts=2, notes=notes)


def error_table(result: StabilityResult) -> Table | None:
    """Linear predictions against EMT, per cell."""
    rows = []
    for (name, label), pair in result.evidence.items():
        figures = [percent_of(e.error(which)) for e in pair for which in ("full_order", "reduced")]
        rows.append((name, label, *figures))
    if not rows:
        return None
    notes = ("Largest distance from the averaged EMT simulation over the size of the step, small steps of rating.",)
    return Table(
        "Linear models against EMT, error [%]",
        ("Controller", "Grid", "full order", "reduced", "full order", "reduced"),
        tuple(rows),
        2,
        (("", 2), ("P step", 2), ("Q step", 2)),
        notes,
    )


def percent_of(share: float) -> str:
    """A share in per cent, two digits."""
    return number(100.0 * share, 2)


def worst_table(result: StabilityResult, a: ControllerAssessment) -> Table:
    """Worst cells of both maps."""
    rows, flagged = [], set()
    for field in (a.reduced, a.full_order):
        for worst in worst_cases(result.study, field):
            if worst.share_below > 0.0:
                flagged.add(len(rows))
            unstable = math.isnan(worst.value) and bool(worst.where)
            value = "unstable" if unstable else NO_LIMIT if math.isinf(worst.value) else _value(worst.value, worst.unit)
            share = "no gate" if math.isnan(worst.share_below) else share_percent(worst.share_below)
            where = worst.where or NOTHING
            rows.append((MODEL_NAMES[field.model], worst.quantity, where, value, share))
    head = ("Model", "Quantity", "Worst cell", "Value", "Cells that miss the gate")
    notes = (
        "Unstable cells count as the worst of all and as missing every gate; they have no margins. "
        f"{NO_LIMIT.capitalize()}: no gain, phase or delay makes a loop unstable, in any cell. "
        f"{left_out_text(a.full_order)}".strip(),
    )
    return Table(f"Worst cells of {a.spec.name}", head, tuple(rows), 3, notes=notes, flagged=frozenset(flagged))


def differential_table(result: StabilityResult) -> Table | None:
    """The units of a plant against each other, the worst cell of each controller."""
    if not result.differential:
        return None
    rows, flagged = [], set()
    for one in result.differential:
        if one.missing or not one.decay > 0.0:
            flagged.add(len(rows))
        hertz = NOTHING if math.isnan(one.s.imag) else number(abs(one.s.imag) / (2.0 * math.pi))
        asked = number(one.asked) if one.asked else "no limit"
        found = "no steady state" if math.isnan(one.s.real) else number(one.s.real)
        share = f"{one.missing} of {one.cells}" if one.asked else NOTHING
        rows.append((one.controller, one.where or NOTHING, found, hertz, asked, share))
    head = ("Controller", "Worst cell", "Mode [1/s]", "[Hz]", "Decay asked", "Cells that miss it")
    note = (
        "One unit on its own transformer and feeder, with the gains that it has in the plant: each of these modes is "
        "there once for every unit but one. All other tables are of the common mode, in which all units move alike, "
        "over the grids that one unit sees."
    )
    return Table("Units against each other", head, tuple(rows), 2, notes=(note,), flagged=frozenset(flagged))


def left_out_text(field: MarginMap) -> str:
    """How many cells of a map are not counted, and why; empty if all are counted."""
    parts = left_out_parts(field)
    return f"Not counted here: {' and '.join(parts)}." if parts else ""


def left_out_parts(field: MarginMap) -> list[str]:
    """Each reason why cells of a map are not counted, with their number."""
    beyond, not_asked = left_out(field)
    count, parts = len(field.faults), []
    if beyond:
        kinds = dict.fromkeys(reason.partition(" ")[0] for reason in beyond)
        limits = " or ".join({"V": "voltage"}.get(kind, kind) for kind in kinds)
        parts.append(f"{len(beyond)} of {count} cells outside the limits (the steady state breaks that of {limits})")
    if not_asked:
        parts.append(f"{not_asked} of {count} cells that the specification does not ask for")
    return parts


def _value(value: float, unit: str) -> str:
    if math.isinf(value):
        return "∞"
    text = number(value)
    return f"{text}{'' if unit == '°' else ' '}{unit}".strip()


def faults_table(result: StabilityResult) -> Table | None:
    """Why cells could not be analysed."""
    rows = []
    for a in result.assessments:
        for field in (a.reduced, a.full_order):
            counts = merged(fault for fault in field.faults if fault)
            rows += [(a.spec.name, MODEL_NAMES[field.model], reason, str(n)) for reason, n in counts.items()]
    if not rows:
        return None
    return Table("Cells that could not be analysed", ("Controller", "Model", "Reason", "Cells"), tuple(rows), 3)


def focus_table(a: ControllerAssessment) -> Table:
    """Margins of the close looks."""
    rows = []
    for cell in a.focus:
        for name, t in (("reduced", cell.reduced_table), ("full order", cell.full_order_table)):
            disk = float(t.disk_output.value[0])
            factor, phase = (float(x) for x in guaranteed_margins(np.array(disk)))
            rows.append(
                (
                    cell.label + (f", {OUTSIDE}" if cell.outside else ""),
                    name,
                    "yes" if t.stable[0] else "no",
                    number(float(t.least_damping[0])),
                    number(float(t.least_damped_rad_s[0]) / (2.0 * math.pi)),
                    number(disk),
                    _value(20.0 * math.log10(factor), ""),
                    number(phase),
                    number(float(t.disk_input.value[0])),
                    number(float(t.M_s.value[0])),
                    *(
                        _value(float(v[0]), "")
                        for loop in (t.loop_P, t.loop_Q)
                        for v in (loop.gain_margin_db, loop.phase_margin_deg, 1e3 * loop.delay_margin_s)
                    ),
                )
            )
    head = (
        "Grid",
        "Model",
        "Stable",
        "ζ",
        "at [Hz]",
        "α",
        "GM [dB]",
        "PM [°]",
        "α",
        "M_s",
        "GM [dB]",
        "PM [°]",
        "DM [ms]",
        "GM [dB]",
        "PM [°]",
        "DM [ms]",
    )
    output, input_ = (DEFINITIONS[name].heading for name in ("disk_margin_output", "disk_margin_input"))
    groups = (
        ("", 3),
        ("Damping ratio", 2),
        (f"{output}, guaranteed", 3),
        (input_, 1),
        ("", 1),
        ("P loop", 3),
        ("Q loop", 3),
    )
    notes = (
        f"ζ: reduced, the {DEFINITIONS['damping_power_loops'].title}; full order, the "
        f"{DEFINITIONS['damping_all_modes'].title}; at: |s| of this mode. "
        f"GM, PM, DM: gain, phase and delay margin of a loop with the other closed; ∞: no crossing; {DASH}: none, as "
        "the cell is unstable.",
    )
    return Table(f"Margins of {a.spec.name} at the study's grids", head, tuple(rows), 2, groups, notes)


def state_symbol(state: str) -> str:
    """A state of the full-order model as the field writes it."""
    return {"delta": "δ", "theta": "θ", "omega_i": "ω_i"}.get(state, state)


def participation_table(a: ControllerAssessment) -> Table:
    """The least stable mode of each close look and what takes part in it."""
    rows = []
    for cell in a.focus:
        mode = cell.modes[0]
        shares = ", ".join(f"{state_symbol(state)} {100.0 * share:.0f} %" for state, share in mode.participation)
        frequency = number(abs(mode.s.imag) / (2.0 * math.pi))
        rows.append((cell.label, shares, complex_text(mode.s), frequency, number(mode.damping)))
    head = ("Grid", "Participation", "s [1/s]", "Frequency [Hz]", "ζ")
    notes = ("States of the full-order model; shares of a mode sum to one over all states, the largest are shown.",)
    return Table(f"Least stable mode of {a.spec.name}", head, tuple(rows), 2, notes=notes)


def sensitivity_table(a: ControllerAssessment) -> Table:
    """The parameters that move the least stable mode of each detailed cell."""
    rows = []
    for cell in a.focus:
        for s in cell.sensitivities[:_MOST_SENSITIVITIES]:
            d = 0.01 * s.relative
            imaginary = abs(cell.modes[0].s.imag) > 1e-9
            rows.append(
                (cell.label, s.parameter, number(s.value, 4), signed(d.real), signed(d.imag) if imaginary else DASH)
            )
    head = ("Grid", "Parameter", "Value, SI", "Δ Re s [1/s]", "Δ Im s [rad/s]")
    notes = (
        "Movement of the mode for + 1 % of one parameter, first order, the steady state following; a positive Δ Re s "
        "makes it less stable. The largest six.",
    )
    return Table(f"What moves the least stable mode of {a.spec.name}", head, tuple(rows), 2, notes=notes)


def complex_text(s: complex) -> str:
    """A pole as text: a pair as a ± jb."""
    if not np.isfinite(s):
        return DASH
    if abs(s.imag) < 1e-9:
        return number(s.real)
    return f"{number(s.real)} ± {number(abs(s.imag))}j"


def signed(value: float) -> str:
    """A number with its sign."""
    return f"+{number(value)}" if value > 0.0 else number(value)


def between_table(assessments: Sequence[ControllerAssessment]) -> Table:
    """Random grids against the nodes of the full-order map at the same operating point."""
    rows = []
    for a in assessments:
        t = a.between
        full = a.full_order
        at_first = np.array([k % full.shape[2] == 0 for k in full.analysed], dtype=bool) & full.counted
        nodes = a.full_order.table
        map_stable, map_damping = nodes.stable[at_first], nodes.least_damping[at_first]
        worst, where = DASH, ""
        if len(t.stable):
            k = int(np.argmin(t.least_damping))
            worst = number(float(t.least_damping[k]))
            where = f"SCR {plain(float(a.between_grids[k, 0]), 3)}, X/R {plain(float(a.between_grids[k, 1]), 3)}"
        rows.append(
            (
                a.spec.name,
                where or "no grid within the limits could be analysed",
                str(len(t.stable)),
                f"{int(t.stable.sum())}",
                worst,
                str(len(map_stable)),
                str(int(map_stable.sum())),
                number(float(map_damping.min())) if len(map_damping) else DASH,
            )
        )
    zeta = DEFINITIONS["damping_all_modes"].heading
    head = ("Controller", "Worst random grid", *("Analysed", "Stable", zeta) * 2)
    groups = (("", 2), ("Random grids", 3), ("Nodes of the map", 3))
    notes = (
        "Full order, at the first operating point of the study, within the converter's limits. A random grid far worse "
        "than the worst node would mean that the map's axes are too coarse.",
    )
    return Table("Between the nodes of the maps", head, tuple(rows), 2, groups, notes)


def limit_table(assessments: Sequence[ControllerAssessment]) -> Table:
    """X/R below which the reduced model is unstable."""
    rows = []
    for a in assessments:
        for scr, limit in a.x_over_r_limit:
            rows.append((a.spec.name, number(scr), "none found from 0.05 to 20" if limit is None else number(limit)))
    head = ("Controller", "SCR", "Unstable below X/R")
    notes = ("Of the reduced model, by root finding; the full-order model has limits of its own, in the maps.",)
    return Table("Loss of stability as the grid becomes resistive", head, tuple(rows), notes=notes)


def steps_table(result: StabilityResult) -> Table | None:
    """Rise, settling and overshoot of the small steps."""
    rows = []
    for (name, label), pair in result.evidence.items():
        for e in pair:
            cells: list[str] = []
            for which, _ in SOURCES:
                m = metrics_of(e, which)
                if isinstance(m, str):
                    cells += [DASH, m, DASH]
                else:
                    cells += [number(m.rise_time_s), number(m.settling_time_s), percent(m.overshoot_pct)]
            rows.append((name, label, e.signal, *cells))
    if not rows:
        return None
    part = ("Rise [s]", "Settling [s]", "Overshoot [%]")
    groups = (("", 3), *((label, 3) for _, label in SOURCES))
    notes = (
        "Rise from 10 to 90 %, settling into ±2 %, each response against the steady state of its own model, EMT "
        f"against that of the full order. {DASH}: not reached within the simulated time. {TOO_SHORT.capitalize()}: the "
        "slowest mode may still bring it out of the band.",
    )
    return Table("Small steps", ("Controller", "Grid", "Step of", *part * 3), tuple(rows), 3, groups, notes)
