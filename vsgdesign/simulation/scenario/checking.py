"""What a scenario says and refuses before its first sample, without a simulation."""

from __future__ import annotations

from collections.abc import Mapping

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.simulation.expected_rests import expected_rests, refuse_impossible
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.outcome import unanswered
from vsgdesign.simulation.rest import WHERE_TO_LOOK, instabilities
from vsgdesign.simulation.run import check_run
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.study import ControllerSpec, Study


def check_scenario(study: Study, ready: Ready = NOTHING, *, bridge: str | None = None) -> list[str]:
    """Raises what :func:`vsgdesign.simulation.scenario.run_scenario` raises before it simulates, and returns what it
    warns of then: every controller's gains, rests, circuits and start.

    What only a run can tell is not known here: the zeros at which a fault is cleared, and when a breaker closes.
    """
    timeline = build_timeline(study)
    refuse_impossible(study, timeline, ready)
    unstable, deaf = [], []
    for spec in study.controllers:
        own = study.with_limit_of(spec)
        feed = feed_of(own, spec, timeline, ready)
        found = expected_rests(own, timeline, spec, ready)
        unstable += [one.message for one in instabilities(own, spec, found)]
        if found:
            changes = [GainChange(rest.t_s, rest.gains, rest.grid) for rest in found]
            deaf += deaf_in_words(spec, unanswered(own, changes))
        check_run(own, feed, bridge=bridge)
    return [*unstable, *([WHERE_TO_LOOK] if unstable else []), *deaf]


def deaf_in_words(spec: ControllerSpec, deaf: Mapping[float, str]) -> list[str]:
    """One sentence on each set point that a controller does not answer."""
    return [f"{spec.name}, from {t_s:g} s on: {text}." for t_s, text in deaf.items()]
