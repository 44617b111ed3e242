"""The verdict on a scenario as one disturbance, in words."""

from __future__ import annotations

from vsgdesign.metrics.survival import Survival
from vsgdesign.report.quantities import plain
from vsgdesign.simulation import ScenarioResult


def survival_text(result: ScenarioResult) -> str:
    """Which controllers survive the events, and how; empty where the study does not ask for it."""
    return " ".join(survival_sentence(c.spec.name, c.survival) for c in result.controllers if c.survival is not None)


def survival_sentence(name: str, verdict: Survival) -> str:
    """Whether a controller survives the events of its scenario, and its largest current."""
    if not verdict.judged:
        return f"{name} is not judged as one disturbance: {verdict.status}, {_ended(verdict.reason)}"
    said = f"{name} does not survive the events: {verdict.status}, {_ended(verdict.reason)}"
    if verdict.survived and verdict.recovery_s is not None:
        said = f"{name} survives the events and is at rest {plain(verdict.recovery_s)} s after the last one."
        if verdict.reason is not None:
            said = f"{said[:-1]}: {_ended(verdict.reason)}"
    if verdict.peak_pu is not None:
        said += f" Its largest current later than 5 ms after an event is {plain(verdict.peak_pu)} pu of the rated peak."
    return said


def _ended(reason: str | None) -> str:
    """A reason as the end of a sentence; some of them have several sentences and their own full stop."""
    return f"{(reason or 'no reason is known').removesuffix('.')}."
