"""What a scenario says and refuses before its first sample, without a simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.identification.registry import needs_network
from vsgdesign.simulation.expected_rests import expected_rests, refuse_impossible
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.outcome import unanswered
from vsgdesign.simulation.rest import WHERE_TO_LOOK, instabilities
from vsgdesign.simulation.run import check_run
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.study import ControllerSpec, Study

BRIDGES = {"averaged": "an averaged bridge", "pwm": "a switched bridge (PWM)"}
"""The bridge of a run in words."""


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
    return [
        *other_bridges(study, study.controllers, ready, bridge),
        *unstable,
        *([WHERE_TO_LOOK] if unstable else []),
        *deaf,
    ]


def other_bridges(study: Study, specs: Sequence[ControllerSpec], ready: Ready, bridge: str | None) -> list[str]:
    """One sentence on each of these controllers whose network was trained with another bridge than that of the run
    (None: that of the study). Weights that do not say their bridge are not told of."""
    used, trained = (
        bridge or study.simulation.bridge,
        None if ready.network is None else ready.network.recipe.get("bridge"),
    )
    if trained in (None, used):
        return []
    return [
        f"{spec.name}: its network was trained with {BRIDGES[trained]}, and this run has {BRIDGES[used]}. Samples of a "
        "switched voltage have a bias, so that its estimates may be wrong by more than the grid's impedance. Train it "
        f'with bridge = "{used}" in its recipe, or simulate with --bridge {trained}.'
        for spec in specs
        if needs_network(spec.estimate)
    ]


def deaf_in_words(spec: ControllerSpec, deaf: Mapping[float, str]) -> list[str]:
    """One sentence on each set point that a controller does not answer."""
    return [f"{spec.name}, from {t_s:g} s on: {text}." for t_s, text in deaf.items()]
