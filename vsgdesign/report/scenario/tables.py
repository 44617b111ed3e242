"""The tables of the report, as texts ready to be set."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from vsgdesign.metrics import EventMetrics, ResponseMetrics, mean_in_words
from vsgdesign.metrics.events import MEASURED, NO_STEADY_STATE, NOT_SETTLED, TOO_SHORT
from vsgdesign.report.drawing.quantities import DASH, GAIN_UNITS, number, percent, plain, prefix_for, quantity
from vsgdesign.report.page.blocks import Table, Where
from vsgdesign.report.page.converter import grid_label, specs_table
from vsgdesign.report.scenario.bode_figures import distinct_grids, loops_on_grids
from vsgdesign.report.scenario.outcomes import (
    CANNOT,
    RULE,
    StepOutcome,
    UncoupledResponse,
    coupling,
    ends_of_stretches,
    notes_on_noise,
    rest_noise,
    uncertainty,
)
from vsgdesign.simulation.gains import settled_changes
from vsgdesign.simulation.rest import Rest
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult, mean_cycles


def controllers_table(result: ScenarioResult) -> Table:
    """What each controller is and aims at."""
    return specs_table(result, [controller.spec for controller in result.controllers])


def events_table(result: ScenarioResult) -> Table:
    """The events by number."""
    rows = tuple((str(n + 1), f"{plain(e.t_s, 5)} s", e.name) for n, e in enumerate(result.study.events))
    return Table("Events", ("No.", "Time", "Event"), rows, texts=3)


def rests_table(result: ScenarioResult) -> Table:
    """Where the controllers rest after each event, those that rest alike in one row; voltage outside its limits in
    words."""
    flagged: set[tuple[str, ...]] = set()
    every = [(controller.spec.name, rest) for controller in result.controllers for rest in controller.rests]
    powers = [abs(rest.point.P) for _, rest in every if rest.point is not None]
    p_factor, p_prefix = prefix_for(max(powers, default=1.0))
    names: dict[tuple[str, ...], list[str]] = {}
    told: dict[str, list[str]] = {}
    for name, rest in sorted(every, key=lambda one: one[1].t_s):
        cells = _rest_cells(result, rest, p_factor)
        names.setdefault(cells, []).append(name)
        if rest.point is None:
            told.setdefault(f"from {plain(rest.t_s, 5)} s on: {rest.obstacle}", []).append(name)
        elif not rest.point.V_within_limits:
            flagged.add(cells)
    reasons = [f"{', '.join(of)}, {reason}" for reason, of in told.items()]
    head = (
        "From [s]",
        "Grid",
        "Controller",
        "R_g [Ω]",
        "L_g [mH]",
        f"P [{p_prefix}W]",
        f"Q [{p_prefix}var]",
        "V [V]",
        "V [pu]",
        "V limits",
        "δ [°]",
        "A [W/rad]",
        "B [W/V]",
        "C [var/rad]",
        "D [var/V]",
        "c",
    )
    notes = (
        "With both droops, the limits and the gains of each controller. A = ∂P/∂δ, B = ∂P/∂V, C = ∂Q/∂δ, D = ∂Q/∂V, "
        f"c = BC/(AD); V in phase rms at the filter capacitor. SCR on the {result.study.scr_basis} basis.",
        *reasons,
    )
    count = len(result.controllers)
    rows = [(*cells[:2], "all" if len(of) == count > 1 else ", ".join(of), *cells[2:]) for cells, of in names.items()]
    places = frozenset(k for k, cells in enumerate(names) if cells in flagged)
    return Table("Where the controllers rest", head, tuple(rows), texts=3, notes=notes, flagged=places)


def _rest_cells(result: ScenarioResult, rest: Rest, p_factor: float) -> tuple[str, ...]:
    c, point = result.study.converter, rest.point
    where = (plain(rest.t_s, 5), grid_label(result, rest.grid), number(rest.grid.R_g), number(rest.grid.L_g * 1e3))
    if point is None:
        return (*where, *[DASH] * 4, "no rest" if rest.modelled else "not known", *[DASH] * 6)
    low, high = c.V_limits_rms
    words = "within"
    if not point.V_within_limits:
        words = f"above {plain(c.V_max_pu)} pu" if point.V_rms > high else f"below {plain(c.V_min_pu)} pu"
        words = words if not low <= point.V_rms <= high else "outside"
    return (
        *where,
        number(point.P / p_factor),
        number(point.Q / p_factor),
        number(point.V_rms, 4),
        number(point.V_rms / c.V_rated_rms),
        words,
        number(math.degrees(point.delta)),
        number(point.A),
        number(point.B),
        number(point.C),
        number(point.D),
        number(coupling(rest)),
    )


def gains_table(result: ScenarioResult, controller: ControllerResult) -> Table:
    """A controller's gains over time; of gains that follow an estimate or what is measured, which never stand still,
    those that hold before an event."""
    changes, notes = controller.gain_changes, ()
    if controller.moves:
        instants = [event.t_s for event in result.study.events]
        changes = settled_changes(changes, instants, result.study.simulation.duration)
        notes = (
            f"{len(changes)} of {len(controller.gain_changes)} changes: the first, and those that hold when an event "
            "comes and at the end.",
        )
    used = [name for name in GAIN_UNITS if any(name in change.gains.named() for change in changes)]
    rows = tuple(
        (plain(change.t_s, 6), *(number(getattr(change.gains, name), 4) for name in used)) for change in changes
    )
    head = ("From [s]", *(f"{name} [{GAIN_UNITS[name]}]" for name in used))
    return Table(f"Gains of {controller.spec.name}", head, rows, notes=notes)


DC_HEAD = (
    "dc link",
    "Voltage [V]",
    "Spare [V]",
    "Power of the bridge [kW]",
    "Energy [kJ]",
    "Charge at the end [%]",
)
"""Of what is said of a dc link."""

DC_NOTE = (
    "Every sample counts. The spare voltage is what the link has more than the bridge needs, at least. Powers are "
    "means over a sampling period, and the energy is what the source has given up to the end."
)


def dc_row(controller: ControllerResult) -> tuple[str, ...] | None:
    """What a controller asked of its dc link, as DC_HEAD says; None where it is ideal."""
    if (asked := controller.dc) is None:
        return None
    charge = asked.end.get("dc_charge")
    return (
        "blocks" if controller.outcome.status == "blocked" else "within its limits",
        f"{number(asked.lowest_v, 4)} … {number(asked.highest_v, 4)}",
        number(asked.spare_v, 3),
        f"{plain_kilo(asked.least_p_w)} … {plain_kilo(asked.most_p_w)}",
        plain_kilo(asked.given_j),
        DASH if charge is None else number(round(100.0 * charge, 4) + 0.0, 4),  # an empty source is not −0
    )


def dc_cut(name: str, controller: ControllerResult) -> list[str]:
    """A sentence on what the controller had to leave of what was asked for; none where it left nothing."""
    words = "" if controller.dc is None else controller.dc.cut_words
    return [f"{name} is judged against what the source can give: {words}."] if words else []


def dc_table(result: ScenarioResult, on: Where = Where.PAGE) -> Table | None:
    """What each controller asked of its dc link; None where it is ideal."""
    link = result.study.dc
    if link is None:
        return None
    rows = [(one.spec.name, *row) for one in result.controllers if (row := dc_row(one)) is not None]
    limits = f"The bridge blocks below {quantity(link.V_low, 'V')} and above {quantity(link.V_high, 'V')}."
    notes = (f"{DC_NOTE} {limits}", *(said for one in result.controllers for said in dc_cut(one.spec.name, one)))
    title = f"The dc link: {link.source}, {quantity(link.C, 'F')}"
    return Table(title, ("Controller", *DC_HEAD), tuple(rows), notes=notes, texts=2, on=on)


def plain_kilo(value: float) -> str:
    """In thousands, without a sign of a zero."""
    return number(0.0 if abs(value) < 0.5 else value / 1e3, 4)


def margins_table(result: ScenarioResult) -> Table:
    """Crossover and margins of each open P loop on each grid."""
    rows = []
    grids = [grid_label(result, grid) for grid in distinct_grids(result)]
    for controller in result.controllers:
        if controller.estimates is not None:
            continue  # as with the truth, as far as the estimate is right
        loops = {loop.label: loop for loop in loops_on_grids(result, controller)}
        for label in grids:
            loop = loops.get(label)
            margins = None if loop is None else loop.margins
            rows.append(
                (
                    controller.spec.name,
                    label,
                    number(None if margins is None else margins.crossover_rad_s),
                    DASH if margins is None else percent(margins.phase_margin_deg),
                    DASH
                    if margins is None or margins.delay_margin_s is None
                    else quantity(margins.delay_margin_s, "s"),
                )
            )
    head = ("Controller", "Grid", "Crossover [rad/s]", "Phase margin [°]", "Delay margin")
    notes = (
        "Of the P loop alone, without coupling, at the operating point of the design. Margins of one loop say nothing "
        f"about the coupled system. {DASH}: this grid does not carry the power of the design, or the loop has no "
        "crossover.",
    )
    return Table("Margins of the open active-power loop", head, tuple(rows), texts=2, notes=notes)


def targets_table(outcomes: Sequence[StepOutcome]) -> Table:
    """Each reference step with its target, and the response of the uncoupled loop where a structure has one."""
    rows, flagged = [], set()
    noisy = any(outcome.noise is not None for outcome in outcomes)
    alone = any(outcome.uncoupled is not None for outcome in outcomes)
    for index, outcome in enumerate(outcomes):
        if outcome.misses:
            flagged.add(index)
        rows.append(
            (
                outcome.controller.spec.name,
                f"{outcome.metrics.name} at {plain(outcome.metrics.t_s, 5)} s",
                _asked(outcome.target_settling_time_s, plain),
                _settled(outcome.metrics, outcome.settling_time_s, outcome.window_s, outcome.settling_text),
                _met(outcome, outcome.settles, outcome.settling_judged),
                _asked(outcome.target_overshoot_pct, percent),
                outcome.overshoot_text,
                _met(outcome, outcome.stays_below, outcome.overshoot_judged),
                *([rest_noise(outcome.metrics)] if noisy else []),
                *(_uncoupled(outcome.uncoupled) if alone else ()),
                number(outcome.coupling),
            )
        )
    head = (
        "Controller",
        "Step",
        "Target",
        "Measured",
        "Result",
        "Target",
        "Measured",
        "Result",
        *(["Rests in, rms"] if noisy else []),
        *(("ω_n [rad/s]", "ξ", "Settling [s]", "Overshoot [%]") if alone else ()),
        "c",
    )
    first = (("", 2), ("Settling time [s]", 3), ("Overshoot [%]", 3), *([("", 1)] if noisy else []))
    groups = (*first, *([("The same loop without coupling", 4)] if alone else []), ("", 1))
    notes = (
        f"{RULE} {DASH} instead of a target: none was asked for. > T: not settled within the T observed.",
        *notes_on_noise(outcome.metrics for outcome in outcomes),
        *_reasons([outcome.metrics for outcome in outcomes], [outcome.controller.spec.name for outcome in outcomes]),
        *([_WITHOUT_COUPLING] if alone else []),
        "c = BC/(AD) at the operating point after the step: 0 where P and Q do not act on each other.",
    )
    return Table("Reference steps against their targets", head, tuple(rows), 2, groups, notes, frozenset(flagged))


_WITHOUT_COUPLING = (
    "Without coupling: ω_n = √(K_ip·A) and ξ = K_ip·D_p/(2ω_n) for P; for Q a first-order pole K_iq·(D + D_q) and "
    f"no ξ ({DASH}); with A and D at the operating point after the step."
)


def _uncoupled(loop: UncoupledResponse | None) -> tuple[str, ...]:
    if loop is None:
        return (DASH,) * 4
    first = (number(value) for value in (loop.omega_n, loop.damping_ratio, loop.settling_time_s))
    return (*first, percent(loop.overshoot_pct))


def _asked(value: float | None, form: Callable[[float], str]) -> str:
    return DASH if value is None else form(value)


def _met(outcome: StepOutcome, met: bool, judged: bool) -> str:
    if not judged:
        return "not promised" if outcome.excuse else CANNOT if outcome.within_noise else "not known"
    return "met" if met else "missed"


def metrics_table(result: ScenarioResult, controller: ControllerResult) -> Table:
    """Figures of every event of one controller, on the mean over whole cycles, which is judged, and on the
    instantaneous signal."""
    ends = ends_of_stretches(result.study)
    largest = max((abs(event.raw.peak_deviation or 0.0) for event in controller.events), default=1.0)
    factor, prefix = prefix_for(largest)
    rows, noisy = [], any(event.noise is not None for event in controller.events)
    for event in controller.events:
        window = ends[event.t_s] - event.t_s
        rows.append(
            (
                f"{plain(event.t_s, 5)} s",
                event.name,
                _signal(event),
                *_figures(event, event.cycle_mean, window, factor),
                *_figures(event, event.raw, window, factor),
                number(event.peak_current_pu),
                *([rest_noise(event)] if noisy else []),
            )
        )
    part = ("Overshoot [%]", "Settling [s]", "Rise [s]", f"Peak deviation [{prefix}W, {prefix}var]", "ITAE [s²]")
    last = ("Peak current [pu]", *(["Rests in, rms"] if noisy else []))
    head, mean = ("Time", "Event", "Signal", *part, *part, *last), mean_in_words(mean_cycles(result.study))
    groups = (("", 3), (mean.capitalize(), 5), ("Instantaneous", 5), ("", len(last)))
    notes = (*notes_on_noise(controller.events), *_reasons(controller.events))
    return Table(f"Events of {controller.spec.name}", head, tuple(rows), texts=3, groups=groups, notes=notes)


def responses_table(result: ScenarioResult) -> Table:
    """The figures of every step and disturbance for a terminal: of the mean over whole cycles."""
    title = f"{result.study.title} ({mean_in_words(mean_cycles(result.study))}s)"
    named = [(one.spec.name, event) for one in result.controllers for event in one.events]
    return replace(responses(title, "controller", named), on=Where.TERMINAL)


def responses(title: str, of: str, named: Sequence[tuple[str, EventMetrics]]) -> Table:
    """The figures of events, each with the name of what it is an event of; ``of`` says what that is."""
    rows: list[tuple[str, ...]] = []
    reasons: dict[str, list[str]] = {}
    noisy = any(event.noise is not None for _, event in named)
    for name, event in named:
        if event.reason is not None and not event.lost_in_noise:  # a note says it of all
            reasons.setdefault(event.reason, []).append(f"{name}, {event.t_s:g} s, {event.signal}")
        figures = event.cycle_mean
        if event.kind == "disturbance" and figures.settling_time_s == 0.0:
            continue  # the other signal never left its band: nothing to see
        rest = [rest_noise(event)] if noisy else []
        rows.append((name, f"{plain(event.t_s, 5)} s", event.name, event.signal, *_short(event, figures), *rest))
    more = ["rests in, rms"] if noisy else []
    head = (of, "at", "event", "signal", "overshoot", "settles 2 %", "rise", "peak current", *more)
    notes = tuple(f"{'; '.join(who)}: {reason}" for reason, who in reasons.items())
    return Table(title, head, tuple(rows), texts=4, notes=(*notes, *notes_on_noise(event for _, event in named)))


_NO_TIME = {MEASURED: "not settled", TOO_SHORT: "too short", NO_STEADY_STATE: "no rest"}
"""Short words in place of a settling time, by the status of the event."""


def _short(event: EventMetrics, figures: ResponseMetrics) -> tuple[str, ...]:
    """The figures of an event with their units."""
    none = CANNOT if event.lost_in_noise else _NO_TIME.get(event.status, event.status)
    return (
        _with_unit(percent(figures.overshoot_pct), f"{uncertainty(event)} %"),
        none if figures.settling_time_s is None else f"{number(figures.settling_time_s)} s",
        _with_unit(number(figures.rise_time_s), " s"),
        _with_unit(number(event.peak_current_pu), " pu"),
    )


def _with_unit(text: str, unit: str) -> str:
    return text if text == DASH else text + unit


METRICS_NOTES = (
    f"{DASH}: the figure has no meaning there: overshoot and rise time belong to a step of the signal's own "
    "reference, and a response that does not reach 90 % of its step has no rise time; a window that is too short, or "
    "has no stable end, has no figures. > T: still outside its band when the next event came after T. Bands of the "
    "settling time: 2 % of the step; for a disturbance 2 % of the rated power. The value that a response ends at is "
    "the computed steady state, droops included; with a switched bridge, or a grid source with more than its "
    "fundamental, it is the mean of the window's last whole cycles. Peak deviation: from that value. "
    "ITAE: ∫ t·|error| dt, the error relative to the step, or to the rated power for a disturbance. Peak current: "
    "largest length of the current "
    "vector over the rated peak.",
)
"""What the dashes and the columns of the metrics tables mean."""


def _signal(event: EventMetrics) -> str:
    return ("P" if event.signal == "P_pcc" else "Q") + (", step" if event.kind == "step" else "")


def _figures(event: EventMetrics, metrics: ResponseMetrics, window_s: float, factor: float) -> tuple[str, ...]:
    peak, beside = metrics.peak_deviation, uncertainty(event) if metrics is event.cycle_mean else ""
    return (
        f"{percent(metrics.overshoot_pct)}{beside}",
        _settled(event, metrics.settling_time_s, window_s),
        number(metrics.rise_time_s),
        number(None if peak is None else peak / factor),
        number(metrics.itae_s2),
    )


def _settled(event: EventMetrics, settling_time_s: float | None, window_s: float, text: str = "") -> str:
    if event.status not in (MEASURED, NOT_SETTLED):
        return event.status
    if event.lost_in_noise:
        return CANNOT
    return f"> {plain(window_s)}" if settling_time_s is None else text or number(settling_time_s)


def _reasons(events: Sequence[EventMetrics], names: Sequence[str] = ()) -> list[str]:
    """Why events have no results, each reason once."""
    found: dict[str, None] = {}
    for k, event in enumerate(events):
        if event.reason is not None and not event.lost_in_noise:  # a note says it of all
            who = f"{names[k]}, " if names else ""
            signal = "P" if event.signal == "P_pcc" else "Q"
            found[f"{who}{event.name} at {plain(event.t_s, 5)} s, {signal}: {event.reason.rstrip('.')}."] = None
    return list(found)
