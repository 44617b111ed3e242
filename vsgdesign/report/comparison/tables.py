"""Tables of a comparison, for the page."""

from __future__ import annotations

import math

from vsgdesign.artifacts.definitions import ASKED, DEFINITIONS
from vsgdesign.design.comparison import CLOSED_FORM, TABLE, Comparison, summary_of
from vsgdesign.metrics.met import beside_limit, most_overshoot, most_settling_time
from vsgdesign.report.drawing.quantities import DASH, GAIN_UNITS, number, plain, plain_quantity
from vsgdesign.report.page.blocks import FLAGGED, Table
from vsgdesign.report.stability.maps import used_gains
from vsgdesign.study.parameters.specification import UNBOUNDED_H

_ROUNDING = 1e-9
"""What an optimiser leaves beyond a limit that it has reached is no miss."""


def promises_table(comparison: Comparison) -> Table:
    """The share of the grids that each contender keeps, and the worst value of every quantity over all grids."""
    spec = comparison.specification
    rows, flagged = [], set()
    for k, compared in enumerate(comparison.contenders):
        s = summary_of(compared)
        exact, wrong = s["worst_exact"], s["worst_wrong"]
        rows.append(
            (
                label(s["name"]),
                s["structure"].replace("_", "-"),
                s["origin"],
                share(s["kept_exact"]),
                share(s["kept_wrong"]),
                share(s["shares"]["unstable"]),
                share(s["kept_exact_ideal"]),
                share(s["kept_wrong_ideal"]),
                *(reached(side["overshoot"], 100.0, spec.overshoot) for side in (exact, wrong)),
                *(reached(side["settling_time"], 1.0, spec.settling_time) for side in (exact, wrong)),
                *(reached(side["disk_margin"], 1.0, spec.disk_margin, at_least=True) for side in (exact, wrong)),
                *((span(s["inertia_s"]),) if bounds_inertia(comparison) else ()),
                breaks(s["broken"]),
            )
        )
        if s["kept_wrong"] < 1.0:
            flagged.add(k)
    inertia = ((inertia_asked(comparison), 1),) if bounds_inertia(comparison) else ()
    head = (
        "Gains",
        "Structure",
        "From",
        *("exact", "wrong", "unstable"),
        *("exact", "wrong"),
        *(("exact", "wrong") * 3),
        *("" for _ in inertia),
        "on grids",
    )
    groups = (
        ("", 3),
        ("grids kept [%]", 3),
        ("with ideal inner loops [%]", 2),
        (f"overshoot ≤ {plain(100.0 * spec.overshoot)} [%]", 2),
        (f"settling ≤ {plain(spec.settling_time)} [s]", 2),
        (f"{ASKED['disk_margin']} ≥ {plain(spec.disk_margin)}", 2),
        *inertia,
        ("breaks, exact estimate", 1),
    )
    notes = (
        "Kept: every promise, with the real inner loops, delay and sampling (full-order model) and with ideal ones. "
        f"Overshoot, settling and {ASKED['disk_margin']} are those with ideal inner loops. "
        f"Wrong: the estimate is off by {error_of(comparison)}. Worst over all grids, powers, and (wrong) estimates. "
        "∞: on some grid a loop is unstable or has no gains, "
        f"or a step does not settle. Fixed gains know no estimate. {FLAGGED} does not meet the specification "
        "everywhere.",
    )
    return Table("What each keeps", head, tuple(rows), texts=3, groups=groups, notes=notes, flagged=frozenset(flagged))


def services_table(comparison: Comparison) -> Table:
    """Droop and inertia over the grids, and steps in EMT."""
    spec, rows = comparison.specification, []
    for compared in comparison.contenders:
        s = summary_of(compared)
        emt, asked = s["emt"], s["droop_asked_W_per_Hz"]
        rows.append(
            (
                label(s["name"]),
                span(s["droop_W_per_Hz"], 1e3),
                DASH if asked is None else number(asked / 1e3),
                span(s["inertia_s"]),
                f"{emt['steps'] - emt['not_settled']} of {emt['steps']}" if emt["steps"] else DASH,
                reached(emt["overshoot"], 100.0, spec.overshoot),
                reached(emt["settling_time"], 1.0, spec.settling_time),
            )
        )
    head = ("Gains", "delivered", "asked", "H [s]", "settled", "overshoot [%]", "settling [s]")
    groups = (("", 1), ("P–f droop [kW/Hz]", 2), ("", 1), ("steps in EMT", 3))
    notes = (
        "Ranges over the grids. Without a droop of its own to ask for, a structure has the one that its damping needs. "
        "EMT: averaged bridge, real inner loops, exact impedance; the worst overshoot and settling of the steps that "
        "settle.",
    )
    return Table("Droop, inertia, EMT", head, tuple(rows), groups=groups, notes=notes)


def tunings_table(comparison: Comparison) -> Table | None:
    """Gains of the fixed contenders; None if there are none."""
    fixed = [c.contender for c in comparison.contenders if c.contender.gains is not None]
    if not fixed:
        return None
    used = {name for c in fixed if c.gains is not None for name in used_gains(c.gains)}
    names = [name for name in GAIN_UNITS if name in used]
    rows = tuple((label(c.name), *(number(float(getattr(c.gains, name)), 4) for name in names)) for c in fixed)
    return Table("Fixed gains", ("Gains", *(f"{name} [{GAIN_UNITS[name]}]" for name in names)), rows)


def specification_table(comparison: Comparison) -> Table:
    """The requirements and their range."""
    spec, box = comparison.specification, comparison.specification.box
    rows = (
        ("Overshoot", f"≤ {plain(100.0 * spec.overshoot)} %"),
        ("2 % settling", f"≤ {plain_quantity(spec.settling_time, 's')}"),
        (DEFINITIONS["disk_margin_output"].heading, f"≥ {plain(spec.disk_margin)}"),
        (DEFINITIONS["damping_power_loops"].heading, f"≥ {plain(spec.damping_ratio)}"),
        *((("Inertia constant H", inertia_asked(comparison).partition(" ")[2]),) if bounds_inertia(comparison) else ()),
        ("SCR", f"{plain(comparison.scr[0])} to {plain(comparison.scr[-1])} ({spec.scr_basis} basis)"),
        ("X/R", f"{plain(comparison.x_over_r[0])} to {plain(comparison.x_over_r[-1])}"),
        ("P", f"{plain_quantity(min(box.P), 'W')} to {plain_quantity(max(box.P), 'W')}"),
        ("Q", f"{plain_quantity(min(box.Q), 'var')} to {plain_quantity(max(box.Q), 'var')}"),
        ("Estimate", _known(comparison)),
        ("Grids", f"{len(comparison.contenders[0].grids)} compared, {len(comparison.outside)} outside the limits"),
    )
    return Table("What is asked", ("Quantity", "Value"), rows, texts=2)


def verdicts(comparison: Comparison) -> list[str]:
    """One sentence for each contender: whether it meets the specification and, if not, where."""
    return [verdict_of(comparison, k) for k in range(len(comparison.contenders))]


def verdict_of(comparison: Comparison, k: int) -> str:
    """The sentence of one contender."""
    s = summary_of(comparison.contenders[k])
    name, error = label(s["name"]), error_of(comparison)
    reasons = breaks(s["broken"])
    if s["kept_wrong"] == 1.0:
        return f"{name} meets the specification on every grid, also with the estimate wrong by {error}."
    if s["kept_exact"] == 1.0:
        return (
            f"{name} meets the specification on every grid with an exact estimate, on {share(s['kept_wrong'])} % of "
            f"them with {error} of error."
        )
    text = f"{name} does not meet the specification: it does on {share(s['kept_exact'])} % of the grids"
    if s["origin"] in (CLOSED_FORM, TABLE):
        text += f" with an exact estimate and on {share(s['kept_wrong'])} % with {error} of error"
    unstable = s["shares"]["unstable"]
    text += f"; on {share(unstable)} % it is unstable or has no gains" if unstable > 0.0 else ""
    if s["kept_exact_ideal"] > s["kept_exact"]:
        text += f". With ideal inner loops it would on {share(s['kept_exact_ideal'])} %"
    return f"{text}. Grids that break a promise: {reasons}."


def bounds_inertia(comparison: Comparison) -> bool:
    """Whether the specification limits H."""
    return comparison.specification.H_min > 0.0 or comparison.specification.H_max < UNBOUNDED_H


def inertia_asked(comparison: Comparison) -> str:
    """H from 2 to 8 s, as it is asked for."""
    spec = comparison.specification
    if spec.H_max >= UNBOUNDED_H:
        return f"H ≥ {plain(spec.H_min)} s"
    return f"H ≤ {plain(spec.H_max)} s" if spec.H_min <= 0.0 else f"H {plain(spec.H_min)} to {plain(spec.H_max)} s"


BREAKS = {
    "unstable": "unstable",
    "overshoot": "overshoot",
    "settling_time": "settling",
    "disk_margin": ASKED["disk_margin"],
    "damping_ratio": ASKED["damping_ratio"],
    "H_min": "H too small",
    "H_max": "H too large",
}


def breaks(counts: dict[str, int]) -> str:
    """Requirements by the number of grids on which they are violated."""
    return ", ".join(f"{BREAKS[name]} {count}" for name, count in counts.items()) or DASH


def label(name: str) -> str:
    """The name of a contender for a reader."""
    return name.replace("_", " ")


def _known(comparison: Comparison) -> str:
    box = comparison.specification.box
    own = f"R within ±{plain(100.0 * box.error_R)} %, X within ±{plain(100.0 * box.error_X)} %"
    return own + _or_of_Z(comparison)


def _or_of_Z(comparison: Comparison) -> str:
    """The part of the error set that is relative to |Z|, empty without one."""
    error_Z = comparison.specification.box.error_Z
    return f" or ±{plain(100.0 * error_Z)} % of |Z|" if error_Z else ""


def error_of(comparison: Comparison) -> str:
    """The estimate's error, ±20 %."""
    box = comparison.specification.box
    return f"±{plain(100.0 * max(box.error_R, box.error_X))} %" + _or_of_Z(comparison)


def share(value: float) -> str:
    """Per cent of the grids; 100 only for all of them, and 0 only for none."""
    return f"{min(max(100.0 * value, 1.0), 99.0):.0f}" if 0.0 < value < 1.0 else f"{100.0 * value:.0f}"


def reached(value: float, factor: float, limit: float, *, at_least: bool = False) -> str:
    """A number beside its limit, or ∞. ``factor`` is the shown number over both. What may be too large is a settling
    time (s) or an overshoot, which is shown in per cent."""
    most = most_settling_time(limit) if factor == 1.0 else most_overshoot(limit)
    missed = value < (1.0 - _ROUNDING) * limit if at_least else value > most
    return "∞" if math.isinf(value) else beside_limit(factor * value, factor * limit, missed, number, 3)


def span(limits: tuple[float, float] | None, factor: float = 1.0) -> str:
    """A range, or one number if both ends are equal."""
    if limits is None:
        return DASH
    low, high = (number(value / factor) for value in limits)
    return low if low == high else f"{low} to {high}"
