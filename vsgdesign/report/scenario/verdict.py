"""The results in words: which targets are met or missed, by how much, and why the closed form misses them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.metrics import EventMetrics
from vsgdesign.metrics.beside_limit import beside_limit
from vsgdesign.metrics.events import DIVERGED, MEASURED, NOT_SETTLED, UNSTABLE
from vsgdesign.report.quantities import number, percent, plain
from vsgdesign.report.scenario.second_order import UncoupledResponse, settling_factor, uncoupled_P, uncoupled_Q
from vsgdesign.report.scenario.survived import survival_text
from vsgdesign.simulation import ControllerResult, OperatingPointRow, ScenarioResult
from vsgdesign.simulation.promises import CLOSED_FORM, Promises, not_promised, promises_of
from vsgdesign.simulation.scenario import samples_per_mean

_TIME_SLACK = 1.005
_OVERSHOOT_SLACK_PCT = 0.05
_MOST_LISTED = 6
_WEAK_COUPLING = 0.1
"""A |c| below this does not make a step overshoot by itself."""
_AT_REST = 0.02
"""Drift over the last cycle before a step, relative to the step, up to which the signal was at rest."""

RULE = (
    "Each controller is held to what it was asked for: a table to its specification, a closed form to its "
    "settling_time and to the overshoot of its own poles (none from ξ = 1 on, and none for the first-order Q loop), "
    "gains that are given to the study's gates, which limit the settling time and no overshoot. A target counts as met "
    "within 0.5 % of the settling time and 0.05 percentage points of the overshoot."
)


@dataclass(frozen=True, kw_only=True)
class StepOutcome:
    """One reference step of one controller against its target."""

    controller: ControllerResult
    metrics: EventMetrics
    window_s: float
    """Time to the next event."""
    row: OperatingPointRow | None
    """The operating point after the step, if there is one."""
    uncoupled: UncoupledResponse | None
    promises: Promises
    at_rest: bool
    """Whether the signal was at rest when the step came; otherwise its results mix two transients."""
    excuse: str = ""
    """Why a table promises nothing for this step; empty if it does."""

    @property
    def target_settling_time_s(self) -> float | None:
        """None: the controller was asked for none."""
        return self.promises.settling_time

    @property
    def target_overshoot_pct(self) -> float | None:
        """None: the controller was asked for none."""
        return self.promises.overshoot_pct if self.metrics.signal == "P_pcc" else self.promises.overshoot_Q_pct

    @property
    def settling_time_s(self) -> float | None:
        """On the instantaneous signal, or on its mean over whole cycles where ripple leaves any 2 % band."""
        return self._measured().settling_time_s

    @property
    def measured_overshoot_pct(self) -> float | None:
        """On the same signal as the settling time; None if there is no value."""
        return self._measured().overshoot_pct

    @property
    def overshoot_pct(self) -> float:
        """The same, zero where there is no figure."""
        return self.measured_overshoot_pct or 0.0

    @property
    def unstable(self) -> bool:
        """Whether the linear model is unstable where the step ends, or the simulation diverged. There is then nothing
        to measure, and both targets are missed.
        """
        return self.metrics.status in (UNSTABLE, DIVERGED)

    @property
    def settles(self) -> bool:
        """Whether the target settling time is met."""
        settled, target = self.settling_time_s, self.target_settling_time_s
        return target is None or (settled is not None and settled <= _TIME_SLACK * target)

    @property
    def stays_below(self) -> bool:
        """Whether the target overshoot is met."""
        target = self.target_overshoot_pct
        return not self.unstable and (target is None or self.overshoot_pct <= target + _OVERSHOOT_SLACK_PCT)

    @property
    def judged(self) -> bool:
        """Whether something was promised of this step, there was time enough to know (:eq:`window-needed`) and a steady
        state to come to."""
        if self.excuse or (self.target_settling_time_s is None and self.target_overshoot_pct is None):
            return False
        if self.metrics.status == NOT_SETTLED:
            return self.window_s >= (self.target_settling_time_s or 0.0)
        return self.metrics.status in (MEASURED, UNSTABLE, DIVERGED)

    @property
    def misses(self) -> bool:
        """Whether a target is missed that could have been met."""
        return self.judged and not (self.settles and self.stays_below)

    @property
    def settling_text(self) -> str:
        """The settling time in s beside its target; only where there is one."""
        settled = math.nan if self.settling_time_s is None else self.settling_time_s
        return beside_limit(settled, self.target_settling_time_s, not self.settles, number, 3)

    @property
    def overshoot_text(self) -> str:
        """The overshoot in per cent beside its target; a dash where there is none."""
        measured = self.measured_overshoot_pct
        if measured is None:
            return percent(None)
        return beside_limit(measured, self.target_overshoot_pct, not self.stays_below, percent, 1)

    @property
    def coupling(self) -> float | None:
        """c = BC/(AD) at the operating point after the step."""
        return None if self.row is None else coupling(self.row)

    def _measured(self):
        return self.metrics.cycle_mean if self.controller.ripples else self.metrics.raw


def coupling(row: OperatingPointRow) -> float | None:
    """c = BC/(AD): zero where P and Q do not act on each other. None where A or D is zero."""
    point = row.point
    if point is None:
        return None
    diagonal = point.A * point.D
    return point.B * point.C / diagonal if diagonal != 0.0 else None


def step_outcomes(result: ScenarioResult) -> list[StepOutcome]:
    """Every reference step of every controller."""
    starts = sorted({event.t_s for event in result.study.events})
    ends = dict(zip(starts, [*starts[1:], result.study.simulation.duration], strict=False))
    outcomes = []
    for controller in result.controllers:
        for metrics in controller.events:
            if metrics.kind == "step":
                rows = (row for row in result.operating_points if row.point is not None)
                row = next((row for row in rows if abs(row.t_s - metrics.t_s) < 1e-9), None)
                uncoupled = None if row is None else _uncoupled(controller, metrics, row, ends[metrics.t_s])
                promises = promises_of(result.study, controller.spec, result.ready)
                excuse = not_promised(result.ready.table(controller.spec), result.study, row)
                window = ends[metrics.t_s] - metrics.t_s
                at_rest = _was_at_rest(result, controller, metrics)
                outcomes.append(
                    StepOutcome(
                        controller=controller,
                        metrics=metrics,
                        window_s=window,
                        row=row,
                        uncoupled=uncoupled,
                        promises=promises,
                        at_rest=at_rest,
                        excuse=excuse,
                    )
                )
    return outcomes


def _was_at_rest(result: ScenarioResult, controller: ControllerResult, metrics: EventMetrics) -> bool:
    """Compares the last two means before a step."""
    t = controller.series["t_s"]
    cycle = samples_per_mean(result.study, t)
    begin = int(np.searchsorted(t, metrics.t_s - 0.5 * (t[1] - t[0])))
    if begin < 2 * cycle:
        return True
    y = controller.series[metrics.signal]
    drift = np.mean(y[begin - cycle : begin]) - np.mean(y[begin - 2 * cycle : begin - cycle])
    final = metrics.raw.final
    return bool(final is None or abs(drift) <= _AT_REST * abs(final - metrics.raw.initial))


def _uncoupled(
    controller: ControllerResult, metrics: EventMetrics, row: OperatingPointRow, end_s: float
) -> UncoupledResponse | None:
    # The paper's two loops are those of a structure that is designed without the coupling.
    point = row.point
    if not STRUCTURES[controller.spec.target.structure].uncoupled or point is None:
        return None
    # The gains at the end of the window: an event that also changes the grid is followed by new ones.
    gains = [change.gains for change in controller.gain_changes if change.t_s < end_s][-1]
    if metrics.signal == "P_pcc":
        positive = gains.K_ip * point.A > 0.0 and gains.D_p > 0.0
        return uncoupled_P(gains.K_ip, gains.D_p, point.A) if positive else None
    positive = gains.K_iq * (point.D + gains.D_q) > 0.0
    return uncoupled_Q(gains.K_iq, gains.D_q, point.D) if positive else None


def verdict(result: ScenarioResult, outcomes: Sequence[StepOutcome]) -> list[str]:
    """The paragraphs of the verdict: targets, then what else a reader must know."""
    if not outcomes:
        later = [event for event in result.study.events if event.t_s > 0.0]
        stepped = any(event.P_ref is not None or event.Q_ref is not None for event in later)
        reason = "No reference step moves its power measurably" if stepped else "No event steps a reference"
        no_step = f"{reason}, so there is no settling time or overshoot to hold to a target."
        return [text for text in (no_step, survival_text(result), _at_limit(result), _stress(result)) if text]
    paragraphs = [_summary(result, outcomes)]
    for controller in result.controllers:
        own = [outcome for outcome in outcomes if outcome.controller is controller]
        if own:
            paragraphs.append(_against_target(controller, own, _MOST_LISTED // min(len(result.controllers), 3)))
    return [text for text in (*paragraphs, survival_text(result), _at_limit(result), _stress(result)) if text]


def _at_limit(result: ScenarioResult) -> str:
    """Which controllers rest at their current limit in the end, and with which powers; empty if none does."""
    said = [
        f"{c.spec.name}: {str(c.outcome.reason).split('. ')[0]}."
        for c in result.controllers
        if c.outcome.status == "limited"
    ]
    return " ".join(["At the end:", *said]) if said else ""


def _summary(result: ScenarioResult, outcomes: Sequence[StepOutcome]) -> str:
    """One sentence with the main result."""
    judged = [outcome for outcome in outcomes if outcome.judged]
    names = [c.spec.name for c in result.controllers if any(outcome.controller is c for outcome in judged)]
    failed = {outcome.controller.spec.name for outcome in judged if outcome.misses}
    good = [name for name in names if name not in failed]
    if not names:
        return "No reference step can be held to its target."
    if len(names) == 1:
        return f"{names[0]} {'does not meet' if failed else 'meets'} its settling time and overshoot on every step."
    if not good:
        return "No controller meets its settling time and overshoot on every reference step."
    if not failed:
        return "Every controller meets its settling time and overshoot on every reference step."
    return f"Settling time and overshoot are met on every reference step by {', '.join(good)} only."


def _against_target(controller: ControllerResult, outcomes: Sequence[StepOutcome], most: int) -> str:
    promises = outcomes[0].promises
    judged = [outcome for outcome in outcomes if outcome.judged]
    limit, time = promises.overshoot_pct, promises.settling_time
    asked = [] if time is None else [f"within 2 % after {plain(time)} s"]
    if limit is not None:
        asked.append("no overshoot" if limit == 0.0 else f"at most {percent(limit)} % overshoot of P")
    text = f"{controller.spec.name} ({controller.spec.kind} gains; {promises.source}: {', '.join(asked) or 'no step'})"
    missed = [outcome for outcome in judged if outcome.misses]
    sentences = []
    if judged and not missed:
        sentences.append(f"{text} meets {'both' if len(asked) == 2 else 'it'} on {_steps(len(judged))}.")
    elif judged:
        settled = sum(outcome.settles for outcome in judged)
        below = sum(outcome.stays_below for outcome in judged)
        parts = [] if time is None else [f"settling time met on {settled}"]
        parts += [] if limit is None else [f"overshoot on {below}"]
        sentences.append(f"{text}: {' and '.join(parts)} of {_steps(len(judged))}.")
        missed.sort(key=lambda outcome: -1e9 if outcome.settling_time_s is None else -outcome.settling_time_s)
        shown = sorted(missed[:most], key=lambda outcome: (outcome.metrics.t_s, outcome.metrics.signal))
        more = f"; and {len(missed) - len(shown)} more, in the table below" if len(missed) > len(shown) else ""
        sentences.append("; ".join(_miss(outcome) for outcome in shown) + more + ".")
    excused = [outcome for outcome in outcomes if outcome.excuse]
    if excused:
        lead = "" if judged else f"{text}: "
        first = excused[0]
        sentences.append(f"{lead}Of {_steps(len(excused))} nothing is promised ({_step_name(first)}: {first.excuse}).")
    unknown = [outcome for outcome in outcomes if not outcome.judged and not outcome.excuse]
    if unknown and asked:
        lead = "" if judged or excused else f"{text}: "
        why = "; ".join(
            f"{_step_name(outcome)}, {str(outcome.metrics.reason).rstrip('.')}" for outcome in unknown[:most]
        )
        more = f"; and {len(unknown) - most} more, in the table below" if len(unknown) > most else ""
        sentences.append(f"{lead}{_steps(len(unknown))} cannot be judged, neither met nor missed: {why}{more}.")
    return " ".join(sentences)


def _steps(count: int) -> str:
    return "1 reference step" if count == 1 else f"{count} reference steps"


def _step_name(outcome: StepOutcome) -> str:
    return f"{outcome.metrics.name} at {plain(outcome.metrics.t_s)} s"


def _miss(outcome: StepOutcome) -> str:
    parts = []
    settled, target = outcome.settling_time_s, outcome.target_settling_time_s or 0.0
    if outcome.unstable:
        parts.append(outcome.metrics.reason or UNSTABLE)
    elif settled is None and not outcome.settles:
        parts.append(f"not settled within the {plain(outcome.window_s)} s observed")
    elif settled is not None and not outcome.settles:
        parts.append(f"settled after {outcome.settling_text} s ({number(settled - target, 2)} s late)")
    if not outcome.stays_below and not outcome.unstable:
        over = outcome.overshoot_pct
        allowed = outcome.target_overshoot_pct or 0.0
        beyond = f" ({number(over - allowed, 2)} too much)" if allowed else ""
        parts.append(f"{outcome.overshoot_text} % overshoot{beyond}")
    if not outcome.at_rest:
        parts.append("not at rest when the step came")
    return f"{_step_name(outcome)}: {', '.join(parts)}"


def _stress(result: ScenarioResult) -> str:
    """Currents and voltages that the converter must withstand."""
    converter = result.study.converter
    sentences = []
    currents = [
        (event.peak_current_pu, event, c)
        for c in result.controllers
        for event in c.events
        if event.peak_current_pu is not None
    ]
    limits_pu = {c.spec.name: result.study.with_limit_of(c.spec).converter.current_limit_pu for c in result.controllers}
    for limit_pu in dict.fromkeys(limits_pu.values()):  # the worst of the controllers with the same limit
        of_limit = [item for item in currents if limits_pu[item[2].spec.name] == limit_pu]
        if not of_limit:
            continue
        value, event, c = max(of_limit, key=lambda item: item[0])
        current = f"{number(value)} pu of the rated peak ({c.spec.name}, {event.name} at {plain(event.t_s)} s)"
        limit = f"the limit of its current reference is {plain(limit_pu)} pu" if limit_pu else "no current limit is set"
        start = "The largest current after an event is" if not sentences else "With another limit, it is"
        sentences.append(f"{start} {current}; {limit}.")
    points = [(row.t_s, row.point) for row in result.operating_points if row.point is not None]
    flagged = [(t_s, point) for t_s, point in points if not point.V_within_limits]
    total = len(points)
    limits = f"{plain(converter.V_min_pu)} to {plain(converter.V_max_pu)} pu"
    if flagged:
        since, far = max(flagged, key=lambda item: abs(item[1].V_rms / converter.V_rated_rms - 1.0))
        sentences.append(
            f"The voltage leaves its limits of {limits} at {len(flagged)} of {total} operating "
            f"point{'' if total == 1 else 's'}, by most at {number(far.V_rms / converter.V_rated_rms, 4)} pu "
            f"from {plain(since)} s on."
        )
    elif total:
        sentences.append(f"The voltage is within its limits of {limits} at every operating point.")
    return " ".join(sentences)


def explanation(outcomes: Sequence[StepOutcome]) -> list[str]:
    """Why closed-form gains miss their target, if they do, from the numbers of this scenario."""
    missed = [
        outcome
        for outcome in outcomes
        # A step into an earlier transient says nothing about the design.
        if outcome.controller.spec.gains is None
        and outcome.at_rest
        and outcome.misses
        and not outcome.unstable
        and STRUCTURES[outcome.controller.spec.target.structure].uncoupled
        and outcome.promises.source == CLOSED_FORM
    ]
    if not missed:
        return []
    return [text for text in (_rule(missed), _coupling(missed), _other_grid(missed)) if text]


def _rule(missed: Sequence[StepOutcome]) -> str:
    late = {
        outcome.controller.spec.name: outcome.controller.spec.target
        for outcome in missed
        if outcome.metrics.signal == "P_pcc" and not outcome.settles
    }
    times = []
    for name, target in late.items():
        factor = settling_factor(target.damping_ratio)
        omega_n = 4.0 / (target.damping_ratio * target.settling_time)
        if factor / omega_n > 1.02 * target.settling_time:
            times.append(
                f"{number(factor)}/ω_n = {number(factor / omega_n)} s for {name} (ξ = {plain(target.damping_ratio)}, "
                f"target {plain(target.settling_time)} s)"
            )
    if not times:
        return ""
    return (
        "The rule ω_n = 4/(ξ·T_s) takes 4/(ξ·ω_n) for the settling time, which is the 2 % rule of underdamped loops. "
        f"At the operating point of the design, and even without coupling, the P loop needs {'; '.join(times)}."
    )


def _coupling(missed: Sequence[StepOutcome]) -> str:
    known: list[tuple[float, StepOutcome]] = []
    for outcome in missed:
        c = outcome.coupling
        if c is not None and abs(c) >= _WEAK_COUPLING and outcome.uncoupled is not None and not outcome.stays_below:
            known.append((c, outcome))
    if not known:
        return ""
    values = [c for c, _ in known]
    low, high = number(min(values)), number(max(values))
    span = low if low == high else f"between {low} and {high}"
    _, worst = max(known, key=lambda item: item[1].overshoot_pct - (_predicted(item[1]) or 0.0))
    return (
        "The design takes P to depend on δ alone and Q on V alone; it ignores B = ∂P/∂V and C = ∂Q/∂δ. Their weight is "
        f"c = BC/(AD), zero without coupling, and here {span} at the operating points of the steps that overshoot. "
        f"Farthest apart: {worst.controller.spec.name}, {worst.metrics.name} at {plain(worst.metrics.t_s)} s "
        f"(c = {number(worst.coupling)}), where the uncoupled loop would overshoot {percent(_predicted(worst))} % "
        f"and the simulation shows {percent(worst.overshoot_pct)} %."
    )


def _predicted(outcome: StepOutcome) -> float | None:
    return None if outcome.uncoupled is None else outcome.uncoupled.overshoot_pct


def _other_grid(missed: Sequence[StepOutcome]) -> str:
    """Fixed gains on a grid for which they were not designed: their damping ratio."""
    parts = []
    for outcome in missed:
        uncoupled, target = outcome.uncoupled, outcome.controller.spec.target
        if outcome.controller.spec.kind == "fixed" and uncoupled is not None and uncoupled.damping_ratio is not None:
            ratio = uncoupled.damping_ratio
            if abs(ratio / target.damping_ratio - 1.0) > 0.2:
                parts.append(
                    f"{number(ratio, 2)} instead of {plain(target.damping_ratio)} ({outcome.controller.spec.name}, "
                    f"{outcome.metrics.name} at {plain(outcome.metrics.t_s)} s)"
                )
    if not parts:
        return ""
    return (
        "Fixed gains meet operating points for which they were not designed. The damping ratio of the uncoupled P "
        f"loop is {'; '.join(parts[:4])}."
    )
