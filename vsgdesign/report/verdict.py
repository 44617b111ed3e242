"""What the numbers say, in words: targets met or missed, by how much, and why the closed form misses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vsgdesign.metrics import EventMetrics
from vsgdesign.report.quantities import number, percent, plain
from vsgdesign.report.second_order import UncoupledResponse, overshoot_of, settling_factor, uncoupled_P, uncoupled_Q
from vsgdesign.simulation import ControllerResult, OperatingPointRow, ScenarioResult

_TIME_SLACK = 1.005
_OVERSHOOT_SLACK_PCT = 0.05
_MOST_LISTED = 6

RULE = (
    "A target counts as met within 0.5 % of the settling time and 0.05 percentage points of the overshoot. The target "
    "overshoot is that of the damping ratio asked for: none from ξ = 1 on, and none for the first-order Q loop."
)


@dataclass(frozen=True)
class StepOutcome:
    """One reference step of one controller against its target."""

    controller: ControllerResult
    metrics: EventMetrics
    window_s: float
    """Time to the next event."""
    row: OperatingPointRow | None
    """The operating point after the step, if there is one."""
    uncoupled: UncoupledResponse | None
    target_overshoot_pct: float

    @property
    def settling_time_s(self) -> float | None:
        """On the instantaneous signal; on the one-cycle mean with PWM, whose ripple leaves any 2 % band."""
        return self._measured().settling_time_s

    @property
    def overshoot_pct(self) -> float:
        """On the same signal as the settling time."""
        return self._measured().overshoot_pct or 0.0

    @property
    def settles(self) -> bool:
        """Whether the target settling time is met."""
        settled = self.settling_time_s
        return settled is not None and settled <= _TIME_SLACK * self.controller.spec.target.settling_time

    @property
    def stays_below(self) -> bool:
        """Whether the target overshoot is met."""
        return self.overshoot_pct <= self.target_overshoot_pct + _OVERSHOOT_SLACK_PCT

    @property
    def coupling(self) -> float | None:
        """c = BC/(AD) at the operating point after the step."""
        return None if self.row is None else coupling(self.row)

    def _measured(self):
        return self.metrics.raw if self.controller.bridge == "averaged" else self.metrics.one_cycle_mean


def coupling(row: OperatingPointRow) -> float | None:
    """c = BC/(AD): zero where P and Q do not act on each other. None where A or D is zero."""
    point = row.point
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
                row = next((row for row in result.operating_points if abs(row.t_s - metrics.t_s) < 1e-9), None)
                uncoupled = None if row is None else _uncoupled(controller, metrics, row, ends[metrics.t_s])
                damping = controller.spec.target.damping_ratio
                overshoot = overshoot_of(damping) if metrics.signal == "P_pcc" else 0.0
                window = ends[metrics.t_s] - metrics.t_s
                outcomes.append(StepOutcome(controller, metrics, window, row, uncoupled, overshoot))
    return outcomes


def _uncoupled(
    controller: ControllerResult, metrics: EventMetrics, row: OperatingPointRow, end_s: float
) -> UncoupledResponse | None:
    # The gains at the end of the window: an event that also changes the grid is followed by new ones.
    gains = [change.gains for change in controller.gain_changes if change.t_s < end_s][-1]
    if metrics.signal == "P_pcc":
        positive = gains.K_ip * row.point.A > 0.0 and gains.D_p > 0.0
        return uncoupled_P(gains.K_ip, gains.D_p, row.point.A) if positive else None
    positive = gains.K_iq * (row.point.D + gains.D_q) > 0.0
    return uncoupled_Q(gains.K_iq, gains.D_q, row.point.D) if positive else None


def verdict(result: ScenarioResult, outcomes: Sequence[StepOutcome]) -> list[str]:
    """The paragraphs of the verdict: targets, then what else a reader must know."""
    if not outcomes:
        no_step = "No event steps a reference, so there is no settling time or overshoot to hold to a target."
        return [text for text in (no_step, _stress(result)) if text]
    paragraphs = [_summary(result, outcomes)]
    for controller in result.controllers:
        own = [outcome for outcome in outcomes if outcome.controller is controller]
        if own:
            paragraphs.append(_against_target(controller, own))
    return [*paragraphs, _stress(result)]


def _summary(result: ScenarioResult, outcomes: Sequence[StepOutcome]) -> str:
    """One sentence that says it all."""
    failed = {outcome.controller.spec.name for outcome in outcomes if not (outcome.settles and outcome.stays_below)}
    names = [controller.spec.name for controller in result.controllers]
    good = [name for name in names if name not in failed]
    if len(names) == 1:
        return f"{names[0]} {'misses' if failed else 'meets'} its targets{' on some reference step' if failed else ''}."
    if not failed:
        return "Every controller meets its settling time and overshoot on every reference step."
    if not good:
        return "No controller meets its settling time and overshoot on every reference step."
    return (
        f"{', '.join(good)} meet{'s' if len(good) == 1 else ''} the targets on every reference step, the others do not."
    )


def _against_target(controller: ControllerResult, outcomes: Sequence[StepOutcome]) -> str:
    spec, count = controller.spec, len(outcomes)
    limit = overshoot_of(spec.target.damping_ratio)
    overshoot = "no overshoot" if limit == 0.0 else f"at most {percent(limit)} % overshoot of P"
    settled = sum(outcome.settles for outcome in outcomes)
    below = sum(outcome.stays_below for outcome in outcomes)
    steps = f"{count} reference step{'s' if count > 1 else ''}"
    text = (
        f"{spec.name} ({spec.kind} gains; target: within 2 % after {plain(spec.target.settling_time)} s, {overshoot}) "
    )
    if settled == below == count:
        return text + ("meets both on its reference step." if count == 1 else f"meets both on all {steps}.")
    text += f"meets its settling time on {settled or 'none'} and its overshoot on {below or 'none'} of {steps}. "
    missed = [outcome for outcome in outcomes if not (outcome.settles and outcome.stays_below)]
    missed.sort(key=lambda outcome: -1e9 if outcome.settling_time_s is None else -outcome.settling_time_s)
    shown = sorted(missed[:_MOST_LISTED], key=lambda outcome: (outcome.metrics.t_s, outcome.metrics.signal))
    text += "; ".join(_miss(outcome) for outcome in shown)
    if len(missed) > len(shown):
        text += f"; and {len(missed) - len(shown)} more, in the table below"
    return text + "."


def _miss(outcome: StepOutcome) -> str:
    parts = []
    settled, target = outcome.settling_time_s, outcome.controller.spec.target.settling_time
    if settled is None:
        parts.append(f"not settled within the {plain(outcome.window_s)} s to the next event")
    elif not outcome.settles:
        parts.append(f"settled after {number(settled)} s ({number(settled - target, 2)} s late)")
    if not outcome.stays_below:
        over = outcome.overshoot_pct
        beyond = (
            "" if outcome.target_overshoot_pct == 0.0 else f" ({percent(over - outcome.target_overshoot_pct)} too much)"
        )
        parts.append(f"{percent(over)} % overshoot{beyond}")
    return f"{outcome.metrics.name} at {plain(outcome.metrics.t_s)} s: {', '.join(parts)}"


def _stress(result: ScenarioResult) -> str:
    """Currents and voltages that the converter would have to stand."""
    converter = result.study.converter
    sentences = []
    worst = max(
        ((event.peak_current_pu, event, c) for c in result.controllers for event in c.events),
        key=lambda item: item[0], default=None,
    )  # fmt: skip
    if worst is not None:
        limit = (
            "no current limit is set"
            if converter.current_limit_pu is None
            else f"the limit of the current reference is {plain(converter.current_limit_pu)} pu"
        )
        sentences.append(
            f"The largest current after an event is {number(worst[0])} pu of the rated peak ({worst[2].spec.name}, "
            f"{worst[1].name} at {plain(worst[1].t_s)} s); {limit}."
        )
    flagged = [row for row in result.operating_points if not row.point.V_within_limits]
    total = len(result.operating_points)
    limits = f"{plain(converter.V_min_pu)} to {plain(converter.V_max_pu)} pu"
    if flagged:
        far = max(flagged, key=lambda row: abs(row.point.V_rms / converter.V_rated_rms - 1.0))
        sentences.append(
            f"The voltage leaves its limits of {limits} at {len(flagged)} of {total} operating "
            f"point{'' if total == 1 else 's'}, by most at {number(far.point.V_rms / converter.V_rated_rms, 4)} pu "
            f"from {plain(far.t_s)} s on."
        )
    elif total:
        sentences.append(f"The voltage is within its limits of {limits} at every operating point.")
    return " ".join(sentences)


def explanation(outcomes: Sequence[StepOutcome]) -> list[str]:
    """Why closed-form gains miss their target, where they do; from the numbers of this scenario only."""
    missed = [
        outcome
        for outcome in outcomes
        if outcome.controller.spec.gains is None and not (outcome.settles and outcome.stays_below)
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
        if c is not None and outcome.uncoupled is not None and not outcome.stays_below:
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
        f"Largest effect: {worst.controller.spec.name}, {worst.metrics.name} at {plain(worst.metrics.t_s)} s "
        f"(c = {number(worst.coupling)}), where the uncoupled loop would overshoot {percent(_predicted(worst))} % "
        f"and the simulation shows {percent(worst.overshoot_pct)} %."
    )


def _predicted(outcome: StepOutcome) -> float | None:
    return None if outcome.uncoupled is None else outcome.uncoupled.overshoot_pct


def _other_grid(missed: Sequence[StepOutcome]) -> str:
    """Fixed gains on a grid that they were not made for: the damping ratio tells."""
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
        "Fixed gains meet operating points that they were not made for: the damping ratio of the uncoupled P loop is "
        f"{'; '.join(parts[:4])}."
    )
