"""Quality of the estimates in a scenario: errors, delays, and the response compared with that for the true grid."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from vsgdesign.artifacts.ready import Ready
from vsgdesign.linear.stability.safe_place import inside_run
from vsgdesign.metrics.answers import ChangeSeen, RestError, changes_seen, errors_at_rest, rows_at_rest
from vsgdesign.simulation.estimated import EstimateLog
from vsgdesign.simulation.scenario.controllers import ControllerResult, ScenarioResult


@dataclass(frozen=True, kw_only=True)
class StepAgainstTruth:
    """One reference step of a controller with the estimate, and of the same controller with the truth."""

    t_s: float
    name: str
    signal: str
    settling_time_s: float | None
    settling_time_truth_s: float | None
    overshoot_pct: float | None
    overshoot_truth_pct: float | None


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """One controller that estimates."""

    name: str
    log: EstimateLog
    statuses: dict[str, int]
    rest: tuple[RestError, ...]
    changes: tuple[ChangeSeen, ...]
    with_the_truth: str | None
    """The controller that differs by knowing the truth alone, and by when it is told, if the study has one."""
    steps: tuple[StepAgainstTruth, ...]
    inside: tuple[float, float] | None = None
    """Shares of the answers, at rest and of all, that are inside the error set of the controller's table; None without
    a table, or with one that was designed for an exact estimate."""

    @property
    def rate_limit(self) -> tuple[float, float, float] | None:
        """Where the rate limit (1/s) of a table's scheduler held gains back: limit, for how long, of how long (s)."""
        log = self.log
        if log.rate is None or not log.limited.any():
            return None
        return log.rate, log.period * float(log.limited.sum()), log.period * len(log.limited)


def judge_estimates(result: ScenarioResult) -> tuple[Judgement, ...]:
    """The judgements of all controllers of a scenario that estimate the grid, in order."""
    study, timeline = result.study, result.timeline
    instants = sorted({event.t_s for event in study.events})
    changes = timeline.truth_changes()
    end_s = study.simulation.duration
    found = []
    for controller in result.controllers:
        log = controller.estimates
        if log is None:
            continue
        table = result.ready.table(controller.spec)
        inside = None
        if table is not None and (table.validity.error or table.validity.error_Z):
            rest = rows_at_rest(log.t_s, instants, end_s)
            inside = inside_run(table, (log.R_g, log.L_g), (log.R_g_hat, log.L_g_hat), rest)
        rows = (log.t_s, log.R_g, log.L_g, log.R_g_hat, log.L_g_hat)
        truth = same_with_truth(result, controller)
        found.append(
            Judgement(
                name=controller.spec.name,
                log=log,
                statuses=dict(Counter(log.status)),
                rest=errors_at_rest(*rows, instants, end_s),
                changes=changes_seen(*rows, log.period, changes, instants, end_s),
                with_the_truth=None if truth is None else truth.spec.name,
                steps=() if truth is None else _against(controller, truth),
                inside=inside,
            )
        )
    return tuple(found)


def same_with_truth(result: ScenarioResult, controller: ControllerResult) -> ControllerResult | None:
    """The controller that differs by knowing the truth alone, and by when it is told; None if the study has none."""
    return next(
        (other for other in result.controllers if _knows_the_truth_alone(controller, other, result.ready)), None
    )


def _knows_the_truth_alone(controller: ControllerResult, other: ControllerResult, ready: Ready) -> bool:
    changes = {"name": other.spec.name, "estimate": "truth", "update_period": other.spec.update_period}
    alike = replace(controller.spec, **changes) == other.spec
    return other.estimates is None and alike and ready.table(controller.spec) == ready.table(other.spec)


def _against(controller: ControllerResult, truth: ControllerResult) -> tuple[StepAgainstTruth, ...]:
    steps = []
    for ours in controller.events:
        # A step together with the clearing of a fault comes at an instant of each run.
        alike = [one for one in truth.events if (one.kind, one.signal) == (ours.kind, ours.signal)]
        if ours.kind == "step" and alike:
            theirs = min(alike, key=lambda one: abs(one.t_s - ours.t_s))
            a, b = (e.cycle_mean for e in (ours, theirs))
            steps.append(
                StepAgainstTruth(
                    t_s=ours.t_s,
                    name=ours.name,
                    signal=ours.signal,
                    settling_time_s=a.settling_time_s,
                    settling_time_truth_s=b.settling_time_s,
                    overshoot_pct=a.overshoot_pct,
                    overshoot_truth_pct=b.overshoot_pct,
                )
            )
    return tuple(steps)
