"""What became of every reference step and of every promised margin: the targets that they had, what they did, and
whether it was kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.equations.placing import OVERSHOOT_PCT, overshoot_of, settling_factor
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.metrics import EventMetrics, StepNoise
from vsgdesign.metrics.events import DIVERGED, MEASURED, NOT_SETTLED, SIGMAS, UNSTABLE
from vsgdesign.metrics.met import RULE as MET_WITHIN
from vsgdesign.metrics.met import beside_limit, overshoot_met, settling_met
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.report.drawing.quantities import DASH, number, percent, plain, quantity
from vsgdesign.report.page.blocks import Table
from vsgdesign.simulation.rest import Rest
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult
from vsgdesign.simulation.scenario.judging import TABLE, Kept, Promises, given_up, not_promised, promises_of
from vsgdesign.study.parameters.study import Study

_AT_REST = 0.02
"""Drift over the last cycle before a step, relative to the step, up to which the signal was at rest."""

RULE = (
    "Each controller is held to what it was asked for: a table to its specification; a closed form to settling_time "
    f"and to {OVERSHOOT_PCT:g} % of overshoot, or to that of poles that the study gives where it is more; a "
    "closed form of the published structure to the overshoot of its ξ (none from ξ = 1 on, and none for the Q loop); "
    "gains that are given to the study's gates, which limit the settling time and no overshoot. A target counts as met "
    f"{MET_WITHIN}."
)


CANNOT = "cannot be judged"
"""What is said of a figure that is neither met nor missed, because the noise is beyond the band."""

BESIDE = (
    "Steps are judged on the difference from the same run without the step: the same grid, noise, probe and gains. "
    "“Rests in” is what the power does without any step, and ± is what noise may do to the overshoot."
)
"""Below the figures of steps that have a twin."""

ALONE = (
    "A change of the grid has no such run beside it. “Rests in” is what the power then does in the second half of the "
    f"window. Where {plain(SIGMAS)} times this is more than the band of 2 % of the rating, the settling time cannot be "
    "judged, and the band would have to be as large."
)
"""Below the figures of events that have no twin, in a run that never rests."""


def notes_on_noise(events: Iterable[EventMetrics]) -> list[str]:
    """What stands below the figures of events in noise."""
    twins = {event.noise.twin for event in events if event.noise is not None}
    return [BESIDE] * (True in twins) + [ALONE] * (False in twins)


@dataclass(frozen=True, kw_only=True)
class StepOutcome:
    """One reference step of one controller against its target."""

    controller: ControllerResult
    metrics: EventMetrics
    window_s: float
    """Time to the next event."""
    rest: Rest | None
    """Where the controller rests after the step, if it does."""
    uncoupled: UncoupledResponse | None
    promises: Promises
    at_rest: bool
    """Whether the signal was at rest when the step came; otherwise its results mix two transients."""
    excuse: str = ""
    """Why a table promises nothing for this step; empty if it does."""
    given_up: str = ""
    """Where and why its table has given up a promise that this step misses; empty where it has not."""

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
        """Of the mean over whole cycles."""
        return self.metrics.cycle_mean.settling_time_s

    @property
    def measured_overshoot_pct(self) -> float | None:
        """Of the same signal as the settling time; None if there is no value."""
        return self.metrics.cycle_mean.overshoot_pct

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
        return target is None or settling_met(settled, target)

    @property
    def stays_below(self) -> bool:
        """Whether the target overshoot is met."""
        target = self.target_overshoot_pct
        noise = 0.0 if self.noise is None else self.noise.share
        met = target is None or overshoot_met(self.overshoot_pct / 100.0, target / 100.0, noise)
        return not self.unstable and met

    @property
    def noise(self) -> StepNoise | None:
        """What noise does to the figures; None where the step was judged alone."""
        return self.metrics.noise

    @property
    def size(self) -> float:
        """Of the step, W or var; 0 where it is not known."""
        final = self.metrics.raw.final
        return 0.0 if final is None else abs(final - self.metrics.raw.initial)

    @property
    def within_noise(self) -> bool:
        """Whether the noise may leave the band by itself. A settling time that meets its target stands, because noise
        makes it late and not early; nothing else can be judged."""
        return self.noise is not None and not self.noise.judgeable

    @property
    def settling_judged(self) -> bool:
        """Whether the settling time is met or missed."""
        return self._known and self.target_settling_time_s is not None and (self.settles or not self.within_noise)

    @property
    def overshoot_judged(self) -> bool:
        """Whether the overshoot is met or missed."""
        return self._known and self.target_overshoot_pct is not None and not self.within_noise

    @property
    def judged(self) -> bool:
        """Whether all that was asked of this step is met or missed."""
        settling = self.settling_judged or self.target_settling_time_s is None
        return self._known and settling and (self.overshoot_judged or self.target_overshoot_pct is None)

    @property
    def why_not_judged(self) -> str:
        """Why a step that was promised something cannot be judged."""
        if self._known and self.noise is not None:
            unit = "W" if self.metrics.signal == "P_pcc" else "var"
            least = quantity(self.noise.least_step, unit)
            return f"its noise is beyond the band: with this noise, a step of at least {least} can be judged"
        return str(self.metrics.reason).rstrip(".")

    @property
    def _known(self) -> bool:
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
        late, beyond = not self.settles, not self.stays_below
        return (self.settling_judged and late) or (self.overshoot_judged and beyond)

    @property
    def settling_text(self) -> str:
        """The settling time in s beside its target; only where there is one."""
        settled = math.nan if self.settling_time_s is None else self.settling_time_s
        return beside_limit(settled, self.target_settling_time_s, not self.settles, number, 3)

    @property
    def overshoot_text(self) -> str:
        """The overshoot in per cent beside its target, with its uncertainty; a dash where there is none."""
        measured = self.measured_overshoot_pct
        if measured is None:
            return percent(None)
        text = beside_limit(measured, self.target_overshoot_pct, not self.stays_below, percent, 1)
        return f"{text}{uncertainty(self.metrics)}"

    @property
    def rest_text(self) -> str:
        """In what noise the power rests, in words; empty where the step was judged alone."""
        text = rest_noise(self.metrics)
        return "" if text == DASH else f"rests in {text} rms"

    @property
    def coupling(self) -> float | None:
        """c = BC/(AD) at the rest after the step."""
        return None if self.rest is None else coupling(self.rest)


def uncertainty(metrics: EventMetrics) -> str:
    """What noise may do to the overshoot of a step, in percentage points, to stand behind it."""
    noise = metrics.noise if metrics.kind == "step" else None
    return "" if noise is None else f" ± {percent(100.0 * noise.share)}"


def rest_noise(metrics: EventMetrics) -> str:
    """Rms of the noise in which the power rests anyway, with its unit; a dash where there is none."""
    unit = "W" if metrics.signal == "P_pcc" else "var"
    return DASH if metrics.noise is None else quantity(metrics.noise.rest, unit)


def coupling(rest: Rest) -> float | None:
    """c = BC/(AD): zero where P and Q do not act on each other. None without a rest, and where A or D is zero."""
    point = rest.point
    if point is None:
        return None
    diagonal = point.A * point.D
    return point.B * point.C / diagonal if diagonal != 0.0 else None


def ends_of_stretches(study: Study) -> dict[float, float]:
    """By the instant of each event the end of the stretch that it begins, s: the next event, or the end of the run."""
    starts = sorted({event.t_s for event in study.events})
    return dict(zip(starts, [*starts[1:], study.simulation.duration], strict=False))


def step_outcomes(result: ScenarioResult) -> list[StepOutcome]:
    """Every reference step of every controller."""
    ends, outcomes = ends_of_stretches(result.study), []
    for controller in result.controllers:
        for metrics in controller.events:
            if metrics.kind == "step":
                rests = (rest for rest in controller.rests if rest.point is not None)
                rest = next((rest for rest in rests if rest.t_s == metrics.t_s), None)
                uncoupled = None if rest is None else _uncoupled(controller, metrics, rest)
                promises = promises_of(result.study, controller.spec, result.ready)
                excuse = not_promised(result.ready.table(controller.spec), result.study, rest)
                window = ends[metrics.t_s] - metrics.t_s
                step = StepOutcome(
                    controller=controller,
                    metrics=metrics,
                    window_s=window,
                    rest=rest,
                    uncoupled=uncoupled,
                    promises=promises,
                    at_rest=_was_at_rest(metrics),
                    excuse=excuse,
                )
                outcomes.append(replace(step, given_up=_given_up(result, step)))
    return outcomes


def _given_up(result: ScenarioResult, step: StepOutcome) -> str:
    """Of a step whose every miss is one that its table has announced."""
    if not step.misses or step.unstable:
        return ""
    missed = {"settling_time": not step.settles, "overshoot": not step.stays_below}
    table = result.ready.table(step.controller.spec)
    said = [given_up(table, result.study, step.rest, name) for name, is_missed in missed.items() if is_missed]
    return "; ".join(said) if all(said) else ""


def _was_at_rest(metrics: EventMetrics) -> bool:
    final = metrics.raw.final
    return final is None or abs(metrics.drift) <= _AT_REST * abs(final - metrics.raw.initial)


def _uncoupled(controller: ControllerResult, metrics: EventMetrics, rest: Rest) -> UncoupledResponse | None:
    # The paper's two loops are those of a structure that is designed without the coupling.
    point, gains = rest.point, rest.gains
    if not STRUCTURES[controller.spec.target.structure].uncoupled or point is None:
        return None
    if metrics.signal == "P_pcc":
        positive = gains.K_ip * point.A > 0.0 and gains.D_p > 0.0
        return uncoupled_P(gains.K_ip, gains.D_p, point.A) if positive else None
    positive = gains.K_iq * (point.D + gains.D_q) > 0.0
    return uncoupled_Q(gains.K_iq, gains.D_q, point.D) if positive else None


@dataclass(frozen=True)
class UncoupledResponse:
    """A step of reference in a loop without coupling. ``damping_ratio`` is None for a first-order loop."""

    omega_n: float
    """Natural angular frequency (first order: the pole), rad/s."""
    damping_ratio: float | None
    settling_time_s: float
    overshoot_pct: float


def uncoupled_P(K_ip: float, D_p: float, A: float) -> UncoupledResponse:
    """The P loop s² + K_ip·D_p s + K_ip·A."""
    omega_n = math.sqrt(K_ip * A)
    damping_ratio = 0.5 * K_ip * D_p / omega_n
    return UncoupledResponse(
        omega_n, damping_ratio, settling_factor(damping_ratio) / omega_n, overshoot_of(damping_ratio)
    )


def uncoupled_Q(K_iq: float, D_q: float, D: float) -> UncoupledResponse:
    """The Q loop s + K_iq·(D + D_q)."""
    rate = K_iq * (D + D_q)
    return UncoupledResponse(rate, None, math.log(1.0 / SETTLING_BAND) / rate, 0.0)


PROMISES = {
    "disk_margin": DEFINITIONS["disk_margin_output"].title,
    "gain_margin_db": "gain margin [dB]",
    "phase_margin_deg": "phase margin [°]",
    "M_s": "peak sensitivity M_s",
}


def promise_title(one: Kept) -> str:
    """What a promise is about: a table promises the damping of its power loops, a gate asks for that of all modes."""
    if one.name == "damping_ratio":
        return DEFINITIONS["damping_power_loops" if one.source == TABLE else "damping_all_modes"].title
    return PROMISES[one.name]


def promises_table(kept: Sequence[Kept]) -> Table | None:
    """Every margin that a controller was asked for, where the scenario rests, with ideal and with real inner loops."""
    rows, flagged = [], set()
    for index, one in enumerate(kept):
        sign = "≥" if one.at_least else "≤"
        results = [DASH] * 2 if one.excuse else ["met" if met else "missed" for met in (one.kept_ideal, one.kept)]
        if "missed" in results:
            flagged.add(index)
        rows.append(
            (
                one.controller,
                f"{plain(one.t_s, 5)} s",
                promise_title(one),
                one.source,
                one.excuse,
                f"{sign} {plain(one.limit)}",
                reached(one.ideal, one.limit, not one.kept_ideal),
                results[0],
                reached(one.full_order, one.limit, not one.kept),
                results[1],
            )
        )
    if not rows:
        return None
    head = (
        "Controller",
        "From",
        "Promise",
        "Asked by",
        "Not judged, as",
        "Limit",
        "Value",
        "Result",
        "Value",
        "Result",
    )
    groups = (("", 6), ("Ideal inner loops", 2), ("Real inner loops", 2))
    notes = (
        "At the operating point that holds from that instant on, with the gains that the controller has there. Ideal: "
        "the coupled model of the power loops. Real: the full-order model with inner loops, delay and sampling, which "
        "is the one that counts. With ideal inner loops all modes are those of the power loops.",
    )
    return Table("Margins against what was asked for", head, tuple(rows), 5, groups, notes, frozenset(flagged))


def promise_sentences(kept: Sequence[Kept]) -> list[str]:
    """One sentence for each controller that misses a required margin, naming the worst first; none if all are kept."""
    sentences = []
    for name in dict.fromkeys(one.controller for one in kept):
        judged = [one for one in kept if one.controller == name and not one.excuse]
        missed = [one for one in judged if not one.kept]
        if not missed:
            continue
        worst = min(missed, key=slack)
        sign = "at least" if worst.at_least else "at most"
        sentences.append(
            f"With the real inner loops {name} misses {len(missed)} of the {len(judged)} margins that it was asked "
            f"for, with ideal ones {sum(not one.kept_ideal for one in judged)}; worst from {plain(worst.t_s)} s on: "
            f"{promise_title(worst).partition(' [')[0]} {reached(worst.full_order, worst.limit, True)} (ideal "
            f"{reached(worst.ideal, worst.limit, not worst.kept_ideal)}) where {worst.source} "
            f"ask{'' if worst.source.endswith('gates') else 's'} for {sign} {plain(worst.limit)}."
        )
    return sentences


def slack(one: Kept) -> float:
    """How far a margin is within its limit, relative to it; negative beyond it. An unstable loop is the worst."""
    value = one.full_order
    if math.isnan(value):
        return -math.inf
    return (value - one.limit if one.at_least else one.limit - value) / abs(one.limit)


def reached(value: float, limit: float, missed: bool) -> str:
    """A margin as a text beside its limit: an unstable loop has none."""
    if math.isnan(value):
        return "unstable"
    return "∞" if math.isinf(value) else beside_limit(value, limit, missed, number, 3)
