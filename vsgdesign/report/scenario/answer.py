"""The answer on top of a scenario's page: each controller against its targets, its steps, its largest current."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from vsgdesign.artifacts.definitions import MORE_THAN_HARDWARE
from vsgdesign.campaigns.verification.counting import LIMIT_ROOM
from vsgdesign.metrics import EventMetrics
from vsgdesign.metrics.events import MEASURED, NOT_SETTLED
from vsgdesign.metrics.met import beside_limit
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.metrics.survival import Survival
from vsgdesign.report.drawing import spark
from vsgdesign.report.drawing.quantities import number, percent, plain
from vsgdesign.report.drawing.time_axis import Trace
from vsgdesign.report.page.blocks import FACT, MET, MISSED, OPEN, UNKNOWN, Answer, Cell, Row, counted, without_empty
from vsgdesign.report.scenario.estimate_tables import worst_errors
from vsgdesign.report.scenario.figures import interesting_time
from vsgdesign.report.scenario.outcomes import CANNOT, StepOutcome, notes_on_noise, promise_title, reached, slack
from vsgdesign.report.scenario.signals import Signal, power_signals
from vsgdesign.report.scenario.verdict import verdict
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult
from vsgdesign.simulation.scenario.judging import Judgement, Kept

MOST_STEPS = 6
"""As many steps are drawn side by side: those that most controllers miss, in order of time."""

_BEFORE, _AFTER_DUE = 0.06, 1.3
"""What is drawn before a step, as a share of what is drawn after it; how much of the time asked for at least."""


def scenario_headline(result: ScenarioResult, outcomes: Sequence[StepOutcome]) -> str:
    """One sentence: which controllers survive the events, where no reference step is judged; else the main result."""
    judged = [c for c in result.controllers if c.survival is not None and c.survival.judged]
    if not judged or any(outcome.judged for outcome in outcomes):
        return verdict(result, outcomes)[0]
    good = [c.spec.name for c in judged if c.survival is not None and c.survival.survived]
    if len(judged) == 1:
        return f"{judged[0].spec.name} {'survives' if good else 'does not survive'} the events."
    if not good:
        return "No controller survives the events."
    if len(good) == len(judged):
        return "Every controller survives the events."
    return f"{', '.join(good)} alone {'survives' if len(good) == 1 else 'survive'} the events."


def scenario_answer(
    result: ScenarioResult, outcomes: Sequence[StepOutcome], kept: Sequence[Kept], judged: Sequence[Judgement]
) -> Answer:
    """One row a controller, one column a target that any of them was asked for."""
    peaks = {c.spec.name: peak_pu(c) for c in result.controllers}
    limits = {c.spec.name: result.study.with_limit_of(c.spec).converter.current_limit_pu for c in result.controllers}
    largest = max([1.0, *(v for v in (*peaks.values(), *limits.values()) if v is not None and math.isfinite(v))])
    at_rest = [_stability(result, controller) for controller in result.controllers]
    if not any(cell.mark == MISSED for cell in at_rest):  # that all come to rest is nothing to say
        at_rest = [Cell(OPEN, "") for _ in at_rest]
    rows = []
    for index, controller in enumerate(result.controllers):
        name = controller.spec.name
        own = [outcome for outcome in outcomes if outcome.controller is controller]
        cells = (
            _settling(own),
            _overshoot(own),
            _margins([one for one in kept if one.controller == name]),
            at_rest[index],
            _survival(controller.survival),
            _estimate(next((one for one in judged if one.name == name), None)),
            _current(controller, limits[name], largest),
        )
        rows.append(Row(name, cells, spark.key(index)))
    head = ("Settling time", "Overshoot", "Margins", "Rest", "Survival", "Estimate", "Peak current")
    return without_empty(Answer("Against what was asked for", head, tuple(rows), notes=_notes(result, kept)))


def _notes(result: ScenarioResult, kept: Sequence[Kept]) -> tuple[str, ...]:
    notes = ["Each cell counts the verdicts of the tables below, and shows the worst."]
    if kept:
        notes.append("Margins are those of the full-order model, with the real inner loops.")
    if any(event.peak_current_pu is not None for c in result.controllers for event in c.events):
        notes.append(
            "Peak current: the largest length of the current vector at the point of common coupling after an event, "
            "over the rated peak."
        )
    if any(result.study.with_limit_of(c.spec).converter.current_limit_pu for c in result.controllers):
        notes.append(
            "The black line is the limit. It is kept if the converter's own current, from 5 ms after each event on, is "
            f"at most {plain(100.0 * LIMIT_ROOM - 100.0)} % above it."
        )
    return (" ".join(notes),)


def _settling(own: Sequence[StepOutcome]) -> Cell:
    asked = [one for one in own if one.settling_judged]
    if not asked:
        return _none(own)
    worst = max(asked, key=lambda one: _ratio(_time(one), one.target_settling_time_s or 0.0))
    limit = f"≤ {plain(worst.target_settling_time_s or 0.0)} s"
    return counted([one.settles for one in asked], f"{settling_words(worst)}, asked {limit}{_left(own, asked)}")


def _overshoot(own: Sequence[StepOutcome]) -> Cell:
    asked = [one for one in own if one.overshoot_judged]
    if not asked:
        return _none(own)
    worst = max(asked, key=_beyond)
    limit = f"≤ {percent(worst.target_overshoot_pct)} %"
    return counted([one.stays_below for one in asked], f"{overshoot_words(worst)}, asked {limit}{_left(own, asked)}")


def _left(own: Sequence[StepOutcome], judged: Sequence[StepOutcome]) -> str:
    """How many steps the count leaves out, if any."""
    left = len(own) - len(judged)
    return f"; {left} more not judged" if left else ""


def _none(own: Sequence[StepOutcome]) -> Cell:
    """Nothing is judged: because nothing was asked for, promised or known."""
    if not own or all(one.target_settling_time_s is None and one.target_overshoot_pct is None for one in own):
        return Cell(OPEN, "not asked for" if own else "no step")
    if all(one.excuse for one in own):
        return Cell(UNKNOWN, "not promised")
    return Cell(UNKNOWN, CANNOT if any(one.within_noise for one in own) else "not known")


def settling_words(outcome: StepOutcome) -> str:
    """Its settling time, or why there is none."""
    if outcome.metrics.status not in (MEASURED, NOT_SETTLED):
        return str(outcome.metrics.status)
    settled = outcome.settling_time_s
    return f"> {plain(outcome.window_s)} s" if settled is None else f"{outcome.settling_text} s"


def overshoot_words(outcome: StepOutcome) -> str:
    """Its overshoot, or why there is none."""
    if outcome.unstable:
        return str(outcome.metrics.status)
    return f"{outcome.overshoot_text} %"


def _time(outcome: StepOutcome) -> float:
    return math.inf if outcome.settling_time_s is None else outcome.settling_time_s


def _beyond(outcome: StepOutcome) -> float:
    """Overshoot beyond what is allowed, percentage points."""
    return math.inf if outcome.unstable else outcome.overshoot_pct - (outcome.target_overshoot_pct or 0.0)


def _ratio(value: float, limit: float) -> float:
    return value / limit if limit > 0.0 else math.inf


def _margins(own: Sequence[Kept]) -> Cell:
    judged = [one for one in own if not one.excuse]
    if not judged:
        return Cell(UNKNOWN, "not judged") if own else Cell(OPEN, "not asked for")
    worst = min(judged, key=slack)
    name, _, unit = promise_title(worst).partition(" [")
    unit = {"dB]": " dB", "°]": "°"}.get(unit, "")
    limit = f"{'≥' if worst.at_least else '≤'} {plain(worst.limit)}{unit}"
    value = reached(worst.full_order, worst.limit, not worst.kept)
    return counted([one.kept for one in judged], f"{name} {value}{unit if value[-1].isdigit() else ''}, asked {limit}")


def _stability(result: ScenarioResult, controller: ControllerResult) -> Cell:
    """Whether a controller has stable rests, and comes to the last one."""
    unstable = [one for one in result.instabilities if one.controller == controller.spec.name]
    status = controller.outcome.status
    if unstable:
        first = unstable[0]
        return Cell(MISSED, "unstable", f"from {plain(first.t_s)} s on ({first.event})")
    if status in ("diverged", "blocked", "not settled", "unstable", "limited"):
        at = "" if controller.outcome.t_s is None else f"at {plain(controller.outcome.t_s)} s"
        limits = " and ".join(controller.outcome.limits)
        return Cell(MISSED, f"at a limit: {limits}" if status == "limited" else status, at)
    if status == "settled":
        return Cell(MET, "settled")
    return Cell(UNKNOWN, "no steady state" if status == "infeasible" else "not known")


def _survival(verdict: Survival | None) -> Cell:
    if verdict is None:
        return Cell(OPEN, "not asked for")
    if not verdict.judged:
        return Cell(UNKNOWN, "not judged", verdict.reason or verdict.status)
    if not verdict.survived:
        return Cell(MISSED, "not survived", verdict.status)
    detail = "" if verdict.recovery_s is None else f"at rest after {plain(verdict.recovery_s)} s"
    if verdict.beyond_hardware and verdict.peak_pu is not None:
        beyond = f"{plain(verdict.peak_pu)} pu, {MORE_THAN_HARDWARE}"
        return Cell(FACT, "survived", f"{detail}; {beyond}".lstrip("; "))
    return Cell(MET, "survived", detail)


def _estimate(judged: Judgement | None) -> Cell:
    """Changes of the grid that an estimate found, and its error at rest. No target says how well it must do so."""
    if judged is None:
        return Cell(OPEN, "the true grid")
    errors = [abs(e) for rest in judged.rest for e in (rest.R_mean_pct, rest.L_mean_pct) if math.isfinite(e)]
    detail = f"mean error at rest up to {number(max(errors), 2)} %" if errors else "no error at rest is known"
    worst = max((error for error in worst_errors(judged) if error is not None), default=None)
    detail += "" if worst is None else f"; one answer {number(worst, 2)} %"
    if not judged.changes:
        return Cell(FACT, detail)
    found = sum(change.kept_windows is not None for change in judged.changes)
    count = len(judged.changes)
    words = f"{found} of {count} changes found" if count > 1 else "change found" if found else "change not found"
    return Cell(MET if found == count else MISSED, words, detail)


def peak_pu(controller: ControllerResult) -> float | None:
    """The largest current after any event, over the rated peak; None where no event has one."""
    found = [event.peak_current_pu for event in controller.events if event.peak_current_pu is not None]
    return max(found, default=None)


def late_peak_pu(controller: ControllerResult) -> float | None:
    """The largest current of the converter itself later than 5 ms after each event, over the rated peak.

    This is the current that a limit is held against. A verdict on survival counts the instants of its own disturbance.
    """
    if controller.survival is not None and controller.survival.peak_pu is not None:
        return controller.survival.peak_pu
    return controller.late_peak_pu


def _current(controller: ControllerResult, limit: float | None, largest: float) -> Cell:
    name, peak = controller.spec.name, peak_pu(controller)
    if peak is None:
        return Cell(OPEN, "no event")
    said = f"{number(peak)} pu"
    if not math.isfinite(peak):
        return Cell(FACT, said)
    if limit is None:
        return Cell(FACT, said, "no limit is set", spark.bar(peak, None, largest, f"{name}: {said}, no limit"))
    picture = spark.bar(peak, limit, largest, f"{name}: {said}, limit {plain(limit)} pu")
    late = late_peak_pu(controller)
    if late is None:
        return Cell(UNKNOWN, said, f"limit {plain(limit)} pu", picture)
    kept = late <= LIMIT_ROOM * limit
    return Cell(
        MET if kept else MISSED,
        "within the limit" if kept else "above the limit",
        f"{said}; converter {beside_limit(late, limit, not kept, number, 3)} pu after 5 ms; limit {plain(limit)} pu",
        picture,
    )


@dataclass(frozen=True)
class _Step:
    """One reference step of the scenario, with its outcome for each controller that has one."""

    t_s: float
    signal: str
    outcomes: dict[str, StepOutcome]

    @property
    def title(self) -> str:
        first = next(iter(self.outcomes.values()))
        return f"{first.metrics.name} at {plain(first.metrics.t_s, 5)} s"


def steps_answer(result: ScenarioResult, outcomes: Sequence[StepOutcome]) -> Answer | None:
    """A small picture of each step of each controller, with its figures; None where there is no step."""
    steps = [
        _Step(t_s, signal, {o.controller.spec.name: o for o in outcomes if (o.metrics.t_s, o.metrics.signal) == at})
        for at in dict.fromkeys((o.metrics.t_s, o.metrics.signal) for o in outcomes)
        for t_s, signal in [at]
    ]
    if not steps:
        return None
    worst = sorted(steps, key=lambda step: -sum(one.misses for one in step.outcomes.values()))
    shown = sorted(worst[:MOST_STEPS], key=lambda step: step.t_s)
    signals = {signal.metrics_name: signal for signal in power_signals(result)}
    pictures = [_pictures(result, step, signals[step.signal]) for step in shown]
    rows = tuple(
        Row(
            controller.spec.name,
            tuple(picture(index, controller.spec.name) for picture in pictures),
            spark.key(index),
        )
        for index, controller in enumerate(result.controllers)
    )
    left = len(steps) - len(shown)
    more = f" {left} more step{'s are' if left > 1 else ' is'} in the table below." if left else ""
    twins = any(one.noise is not None and one.noise.twin for one in outcomes)
    drawn = "What is judged after each step of a reference: power minus that of the same run without the step"
    said = (
        f"{drawn if twins else 'Power after each step of its reference'}, the mean over whole cycles; one scale in "
        "each column. Dashed: the value at which the response ends. Grey: the band of 2 % of the step. Dotted: the "
        "settling time that was asked for. Circle: settled within the band."
    )
    notes = (said + more, *notes_on_noise(one.metrics for one in outcomes))
    return Answer("Each step", tuple(step.title for step in shown), rows, notes=notes, pictures=True)


def _judged(controller: ControllerResult, step: _Step, trace: Trace, factor: float) -> Trace:
    """What is judged of a controller's power: beside a twin, its difference from the run without the step."""
    outcome, without = step.outcomes.get(controller.spec.name), controller.without.get(step.t_s)
    if outcome is None or outcome.noise is None or not outcome.noise.twin or without is None:
        return trace
    return replace(trace, mean=trace.mean - without[step.signal][: len(trace.mean)] / factor)


def _ends_at(metrics: EventMetrics) -> float | None:
    """Where the drawn curve of a step ends."""
    return metrics.noise.step if metrics.noise is not None and metrics.noise.twin else metrics.raw.final


def _pictures(result: ScenarioResult, step: _Step, signal: Signal) -> Callable[[int, str], Cell]:
    """Draws the cell of one controller (its index and name) in the column of a step."""
    factor, outcomes = signal.si_factor, step.outcomes.values()
    available = next(iter(outcomes)).window_s
    event = next(event for event in result.study.events if event.t_s == step.t_s)
    needed = [_AFTER_DUE * (one.target_settling_time_s or 0.0) for one in outcomes]
    span = min(max(interesting_time(result, event, step.t_s + available), *needed), available)
    window = (step.t_s - _BEFORE * span, step.t_s + span)
    traces = [
        trace.between(*window)
        for trace in (
            _judged(controller, step, trace, factor)
            for controller, trace in zip(result.controllers, signal.traces, strict=True)
        )
    ]
    curves = [trace.mean for trace in traces]
    # Controllers with droop end apart: each is drawn about its own end, or about its last value, all on one scale.
    finals = {name: _ends_at(one.metrics) for name, one in step.outcomes.items()}
    for index, controller in enumerate(result.controllers):
        final, curve = finals.get(controller.spec.name), curves[index]
        curves[index] = curve - (final / factor if final is not None else curve[-1:].sum())
    whole = [curve for curve, trace in zip(curves, traces, strict=True) if not trace.broken]
    levels = spark.levels_of(whole, [0.0])

    def cell(index: int, name: str) -> Cell:
        outcome = step.outcomes.get(name)
        if outcome is None:
            return Cell(OPEN, "no figures")
        due, settled = outcome.target_settling_time_s, outcome.settling_time_s
        words = f"{settling_words(outcome)}"
        if not outcome.unstable and outcome.measured_overshoot_pct is not None:
            words += f", {overshoot_words(outcome)}"
        words += f"; {outcome.rest_text}" if outcome.rest_text else ""
        mark = MISSED if outcome.misses else MET if outcome.judged else UNKNOWN
        why = "not promised" if outcome.excuse else CANNOT if outcome.within_noise else "not judged"
        verdict = {MET: "met", MISSED: "missed"}.get(mark, why)
        picture = spark.step(
            traces[index].t,
            curves[index],
            window,
            levels,
            index,
            f"{name}, {step.title}: {words}, {verdict}",
            None if finals[name] is None else 0.0,
            None if due is None else step.t_s + due,
            None if settled is None else step.t_s + settled,
            SETTLING_BAND * outcome.size / factor,
        )
        return Cell(mark, verdict, words, picture)

    return cell
