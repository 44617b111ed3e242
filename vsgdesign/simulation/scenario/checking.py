"""What a scenario says and refuses before its first sample, without a simulation: its rests, from what each controller
will know, and whether it is possible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.identification.interface import needs_network
from vsgdesign.linear.operating_point.full_order import steady_cells
from vsgdesign.linear.operating_point.many import NO_POINT, Lanes
from vsgdesign.linear.operating_point.many_rests import (
    GainsOfMeasured,
    many_rests_with_measured_gains,
    rest_with_measured_gains,
)
from vsgdesign.runtime.of_study import follows_measured, gain_law
from vsgdesign.simulation.circuits import rest_at_start
from vsgdesign.simulation.feeds import feed_of, knowledge_of, told_at, told_of
from vsgdesign.simulation.gains import GainChange, gain_changes
from vsgdesign.simulation.outcome import unanswered
from vsgdesign.simulation.rest import WHERE_TO_LOOK, Rest, RestsAsked, alike, instabilities, parts_of, rests_of
from vsgdesign.simulation.run import check_run
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.network_fields import beyond_models
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]


def expected_rests(
    study: Study, timeline: Timeline, spec: ControllerSpec, ready: Ready = NOTHING, since_s: float = 0.0
) -> tuple[Rest, ...]:
    """:func:`rests` before a run: a controller that estimates the grid is given the gains of the true one, one that is
    told a wrong grid those of what it is told at the end of each part, one whose gains follow what it measures those of
    its own steady state.

    Empty where it has none on some grid of the scenario. Rests that begin before ``since_s`` are left out.
    """
    found = expected_rests_of([(study, timeline, spec)], ready, since_s)[0]
    if isinstance(found, InfeasibleStudyError):
        raise found
    return found


def expected_rests_of(
    several: Sequence[tuple[Study, Timeline, ControllerSpec]], ready: Ready = NOTHING, since_s: float = 0.0
) -> list[tuple[Rest, ...] | InfeasibleStudyError]:
    """:func:`expected_rests` of several controllers in less time than one after the other, with the error of each that
    has none."""
    found: list[tuple[Rest, ...] | InfeasibleStudyError] = [()] * len(several)
    asked: dict[int, RestsAsked] = {}
    own = [study.with_limit_of(spec) for study, _, spec in several]
    for k, changes in enumerate(_changes_of(own, several, ready, since_s)):
        if isinstance(changes, InfeasibleStudyError):
            found[k] = changes if several[k][2].estimate == "truth" else ()
        else:
            asked[k] = RestsAsked(own[k], several[k][1], changes)
    for k, rests_of_one in zip(asked, rests_of(list(asked.values()), since_s), strict=True):
        found[k] = rests_of_one
    return found


class _Measured(NamedTuple):
    """A part of a scenario in which gains follow what is measured: what is asked for its steady state."""

    study: Study
    t_s: float
    grid: Grid
    source: GridSource
    references: References
    gains_of: GainsOfMeasured


def _changes_of(
    own: Sequence[Study],
    several: Sequence[tuple[Study, Timeline, ControllerSpec]],
    ready: Ready,
    since_s: float,
) -> list[tuple[GainChange, ...] | InfeasibleStudyError]:
    """The gains of each controller in the steady states of its scenario, or the error of one that has none."""
    found: list[tuple[GainChange, ...] | InfeasibleStudyError] = [()] * len(several)
    measured: list[tuple[int, _Measured]] = []
    for k, (study, (_, timeline, spec)) in enumerate(zip(own, several, strict=True)):
        known = replace(spec, estimate="truth", update_period=ready.update_period(spec))
        try:
            if follows_measured(known) or knowledge_of(known, timeline) is not None:
                measured += [(k, part) for part in _measured_parts(study, timeline, known, ready, since_s)]
            else:
                found[k] = gain_changes(study, known, timeline)
        except InfeasibleStudyError as error:
            found[k] = error
    for (k, part), gains in zip(measured, _measured_gains([part for _, part in measured]), strict=True):
        before = found[k]
        if isinstance(before, InfeasibleStudyError):
            continue
        found[k] = gains if isinstance(gains, InfeasibleStudyError) else (*before, GainChange(part.t_s, gains))
    return found


def knows_its_rests(study: Study, spec: ControllerSpec, timeline: Timeline) -> bool:
    """Whether the gains at the end of each part of a scenario follow from what is told of the grid there. In a long
    silence they also depend on what came before."""
    knowledge = knowledge_of(spec, timeline)
    if knowledge is None:
        return True
    told = told_of(study, knowledge, timeline)
    ends = (*sorted({event.t_s for event in study.events if event.t_s > 0.0}), study.simulation.duration)
    return all(told_at(told, end_s - 1e-9)[1] for end_s in ends)


def _measured_parts(
    study: Study, timeline: Timeline, spec: ControllerSpec, ready: Ready, since_s: float
) -> list[_Measured]:
    law = gain_law(study, spec, ready)
    knowledge = knowledge_of(spec, timeline)
    told = None if knowledge is None else told_of(study, knowledge, timeline)
    instants = sorted({0.0, *(event.t_s for event in study.events)})
    instants = [t_s for t_s in instants if t_s >= since_s]
    found = []
    for t_s, end_s in zip(instants, [*instants[1:], study.simulation.duration], strict=True):
        grid, source = timeline.grid_at(t_s), timeline.source_at(end_s - 1e-9)
        known = grid if told is None else told_at(told, end_s - 1e-9)[0]

        def gains_of(P: float, Q: float, V_rms: float, known: Grid = known) -> PowerLoopGains:
            return PowerLoopGains(*(float(value) for value in law(known.R_g, known.L_g, P, Q, V_rms)))

        at_end = GridSource(source.V_g_rms, source.omega)
        held = replace(study, dc=timeline.link_at(t_s))
        found.append(_Measured(held, t_s, grid, at_end, timeline.references_at(t_s), gains_of))
    return found


def _measured_gains(parts: Sequence[_Measured]) -> list[PowerLoopGains | InfeasibleStudyError]:
    """The gains of the steady states, where they follow the measured P, Q and V; without a steady state those at the
    references, so that :func:`rests` says what is missing."""
    found: list[PowerLoopGains | InfeasibleStudyError] = [PowerLoopGains(0.0, 0.0, 0.0, 0.0)] * len(parts)
    for group in alike([part.study for part in parts]):
        some = [parts[k] for k in group]
        at = [Lanes.at(p.grid, p.source, p.references) for p in some]

        def of_many(P: Array, Q: Array, V: Array, some: Sequence[_Measured] = some) -> PowerLoopGains:
            of_each = zip(some, P.tolist(), Q.tolist(), V.tolist(), strict=True)
            return PowerLoopGains(*np.array([part.gains_of(*measured) for part, *measured in of_each]).T)

        states, gains = many_rests_with_measured_gains(some[0].study, Lanes(*np.array(at).T), of_many)
        for k, fault, row in zip(group, states.fault.tolist(), np.array(gains).T.tolist(), strict=True):
            found[k] = _at_references(parts[k]) if fault else PowerLoopGains(*row)
    return found


def _at_references(part: _Measured) -> PowerLoopGains | InfeasibleStudyError:
    refs = part.references
    gains = part.gains_of(refs.P_ref, refs.Q_ref, part.study.converter.V_rated_rms)
    if np.isfinite(gains).all():
        return gains
    try:
        return rest_with_measured_gains(part.study, part.grid, part.source, refs, part.gains_of)[1]
    except InfeasibleStudyError as error:
        return error


def refuse_impossible(study: Study, timeline: Timeline, ready: Ready = NOTHING) -> None:
    """Raises InfeasibleStudyError where a scenario is impossible, before any time is spent.

    A start at rest needs a steady state of every controller. An instant without an operating point is refused if no
    later event ends it, unless one of the controllers has an operating point there or rests at its current limit. While
    a load or a fault is connected or the breaker is open, nothing is refused, because no model knows the rest. A table
    that is still to be designed counts with the closed form of its structure, so that the answer is the same before and
    after the design.
    """
    own = [study.with_limit_of(spec) for spec in study.controllers]
    asked = [replace(spec, schedule="closed_form") if _to_design(spec) else spec for spec in study.controllers]
    changes = _changes_of(own, [(study, timeline, spec) for spec in asked], ready, 0.0)
    possible, reasons = False, list[str]()
    no_gains: list[InfeasibleStudyError] = []
    for one, spec, found in zip(own, study.controllers, changes, strict=True):
        if isinstance(found, InfeasibleStudyError):
            if spec.estimate == "truth" and not _to_design(spec):
                no_gains.append(found)
            else:  # they are not known before the run
                possible = True
            continue
        if study.simulation.start != "cold":
            rest_at_start(one, timeline, found[0].gains)
        reason = _why_never(RestsAsked(one, timeline, found))
        possible = possible or not reason or (one.limiter.rests and one.converter.current_limit_pu is not None)
        reasons.append(reason)
    if reasons and not possible:
        raise InfeasibleStudyError(reasons[0])
    if no_gains:
        raise no_gains[0]


def _to_design(spec: ControllerSpec) -> bool:
    """Whether a controller has a table that no file contains."""
    return spec.schedule == "table" and spec.table_file is None


def _why_never(asked: RestsAsked) -> str:
    """From when on a controller has no operating point until the end, and why; empty where it has one at the end, or
    where that is not known."""
    parts = parts_of(asked)
    states, faults = steady_cells(asked.study, [part.cell for part in parts])[2:]
    why = ""
    for k in reversed(range(len(parts))):
        known = parts[k].source.steady and beyond_models(asked.timeline.network_at(parts[k].t_s)) is None
        if states is None or not known or states.fault[k] != NO_POINT:
            break
        why = f"from {parts[k].t_s:g} s on: {faults[k]} No later event ends it."
    return why


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
