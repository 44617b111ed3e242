"""A whole scenario: every controller of the study through all events, with its figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.frames import clarke_inverse, instantaneous_power
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.identification.interface import samples_itself
from vsgdesign.metrics import EventMetrics, EventWindow, measure_event
from vsgdesign.metrics.events import diverged_event
from vsgdesign.metrics.step_response import cycle_mean
from vsgdesign.metrics.survival import NO_REST, Survival, peaks_of
from vsgdesign.runtime.of_study import follows_measured
from vsgdesign.simulation.dc_beyond import told_of_blocked
from vsgdesign.simulation.dc_start import DcFigures, dc_figures, dc_series
from vsgdesign.simulation.estimated import EstimatedScheduler, EstimateLog
from vsgdesign.simulation.every_sample import (
    AtPcc,
    EverySample,
    SignalsAtPcc,
    first_resting,
    in_pu,
    memory_for,
    pcc_vectors,
    rows_apart,
    spacing_of_figures,
    without_steps,
)
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.outcome import (
    Divergence,
    LimitedEnd,
    Outcome,
    limited_end,
    limited_samples,
    outcome_of,
    unanswered,
)
from vsgdesign.simulation.rest import WHERE_TO_LOOK, Instability, Rest, instabilities, rests
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.scenario.checking import (
    deaf_in_words,
    expected_rests,
    knows_its_rests,
    other_bridges,
    refuse_impossible,
)
from vsgdesign.simulation.search import found_events, reclosed, waits_to_close
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of, silent_s_of
from vsgdesign.simulation.survival.verdicts import judge_scenario
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.simulation.twin import never_rests, steps_with_twin
from vsgdesign.study.parameters.controllers import cycles_of_mean
from vsgdesign.study.parameters.power_plant import one_converter
from vsgdesign.study.parameters.study import ControllerSpec, Event, Study

Array = NDArray[np.float64]

POWERS = ("P_pcc", "Q_pcc")
"""The signals that are judged."""


@dataclass(frozen=True, kw_only=True)
class ControllerResult:
    """One controller's run.

    All figures are those of every sample. ``simulation``, ``series`` and ``means`` have the rows that the study logs.
    """

    spec: ControllerSpec
    bridge: str
    gain_changes: tuple[GainChange, ...]
    simulation: Simulation
    derives: Callable[[], dict[str, Array]]
    """Computes ``series``."""
    means: dict[str, Array]
    """Of P_pcc and Q_pcc over :func:`mean_cycles`, W and var."""
    without: dict[float, dict[str, Array]]
    """The same of the run without each step that has a twin, by the time of the step, s."""
    events: tuple[EventMetrics, ...]
    outcome: Outcome
    """The outcome of the run."""
    rests: tuple[Rest, ...]
    """Where it comes to rest after each event, with the gains that it has there."""
    estimates: EstimateLog | None = None
    """The answers of the estimator, if the controller estimates the grid; else None."""
    distorted: bool = False
    """Whether the grid source contains more than its fundamental."""
    survival: Survival | None = None
    """The verdict on the events as one disturbance, where the study asks for it."""
    found: tuple[Event, ...] = ()
    """Events whose instants only its own run could tell: its breaker closes."""
    dc: DcFigures | None = None
    """What it asked of its dc link; None: an ideal one."""
    late_peak_pu: float | None = None
    """The largest length of the converter current's vector later than 5 ms after each event, over the rated peak; None
    without an event."""

    @cached_property
    def series(self) -> dict[str, Array]:
        """Names to arrays over ``series["t_s"]``, SI. They are computed when they are first read, because figures and
        verdicts need none of them."""
        return self.derives()

    @property
    def ripples(self) -> bool:
        """Whether P and Q ripple at rest, so that the curves of their means are drawn as well."""
        return self.bridge == "pwm" or self.distorted or samples_itself(self.spec.estimate)

    @property
    def moves(self) -> bool:
        """Whether the gains change all the time, because they follow an estimate or measured values."""
        return self.estimates is not None or follows_measured(self.spec) or self.spec.knowledge is not None


def mean_cycles(study: Study) -> int:
    """Nominal cycles over which the mean of P and Q is taken that is judged."""
    return cycles_of_mean(study.controllers)


def samples_per_mean(study: Study, t_s: Array) -> int:
    """Logged samples in these cycles."""
    if len(t_s) < 2:
        return 1
    return max(round(mean_cycles(study) * 2.0 * math.pi / study.converter.omega_n / (t_s[1] - t_s[0])), 1)


@dataclass(frozen=True)
class ScenarioResult:
    """All controllers of a study, on one timeline."""

    study: Study
    """With the events that the controllers' runs found, by name alone."""
    timeline: Timeline
    """Without these events."""
    controllers: tuple[ControllerResult, ...]
    instabilities: tuple[Instability, ...] = ()
    """Where the full-order model says that a controller is unstable."""
    ready: Ready = NOTHING
    """The gain tables and the network that the controllers ran with."""
    given: Study | None = None
    """The study as it was given, without events that the runs found; None: as ``study``."""
    left_out: tuple[str, ...] = ()
    """One sentence on each controller that was left out."""


def run_scenario(
    study: Study,
    ready: Ready = NOTHING,
    *,
    bridge: str | None = None,
    progress: Callable[[str, float], None] | None = None,
    warn: Callable[[str], None] | None = None,
    late: Callable[[], Ready] | None = None,
) -> ScenarioResult:
    """Checks every rest and the full-order model there, then simulates every controller.

    ``late`` returns all of ``ready`` and what takes longer to make. It is called once, after all controllers that do
    not need it are simulated. The controllers whose table is not in ``ready`` follow then.

    ``progress`` is called with the controller's name and the simulated time in s, ``warn`` before the run with a
    sentence on every instability that it is going to show. Raises InfeasibleStudyError
    naming the instant from which on the scenario asks for what its grid cannot carry
    (:func:`vsgdesign.simulation.scenario.checking.refuse_impossible`), or a controller whose gain table or
    network is not in ``ready``; ArtifactError where the network does not fit.
    """
    one_converter(study, "this run")
    timeline = build_timeline(study)
    refuse_impossible(study, timeline, ready)
    waiting = [
        spec
        for spec in study.controllers
        if late is not None and spec.schedule == "table" and spec.name not in ready.tables
    ]
    first = [spec for spec in study.controllers if spec not in waiting]
    done, unstable = _run_controllers(study, first, ready, timeline, bridge, progress, warn)
    if late is not None:
        ready = late()
        more, also = _run_controllers(study, waiting, ready, timeline, bridge, progress, warn)
        done, unstable = done | more, unstable + also
    names = [spec.name for spec in study.controllers]
    unstable.sort(key=lambda one: names.index(one.controller))
    controllers = tuple(done[name] for name in names)
    told = _with_found(study, controllers)
    return ScenarioResult(told, timeline, controllers, tuple(unstable), ready, given=study)


def _with_found(study: Study, controllers: Sequence[ControllerResult]) -> Study:
    """The study with what the runs found among its events, so that pages tell and mark it. Circuits do not change by
    these: every run has its own."""
    told = [
        Event(event.t_s, event.name if len(controllers) == 1 else f"{one.spec.name}: {event.name}")
        for one in controllers
        for event in one.found
    ]
    return replace(study, events=tuple(sorted((*study.events, *told), key=lambda e: e.t_s))) if told else study


def _run_controllers(
    study: Study,
    specs: Sequence[ControllerSpec],
    ready: Ready,
    timeline: Timeline,
    bridge: str | None,
    progress: Callable[[str, float], None] | None,
    warn: Callable[[str], None] | None,
) -> tuple[dict[str, ControllerResult], list[Instability]]:
    """Check controllers, then simulate them: their results by name, and where they are unstable."""
    own = [study.with_limit_of(spec) for spec in specs]
    feeds = [feed_of(one, spec, timeline, ready) for one, spec in zip(own, specs, strict=True)]
    expected = [_expected(one, timeline, spec, ready) for one, spec in zip(own, specs, strict=True)]
    unstable = [one for spec, found in zip(specs, expected, strict=True) for one in instabilities(study, spec, found)]
    if warn is not None:
        told = [one.message for one in unstable]
        for text in (*other_bridges(study, specs, ready, bridge), *told, *([WHERE_TO_LOOK] if told else ())):
            warn(text)
    results, unstable, memory = {}, list[Instability](), memory_for(study)
    for asked, spec, feed, found in zip(own, specs, feeds, expected, strict=True):
        report = None if progress is None else _reporter(progress, spec.name)
        probes = isinstance(feed, EstimatedScheduler) and feed.probe_hold is not None
        twins = steps_with_twin(asked, spec, probes=probes)
        spacing = spacing_of_figures(asked) * study.converter.T_s
        per_mean = samples_per_mean(study, np.array([0.0, spacing]))
        every_sample = EverySample(asked, timeline, per_mean, memory=memory)
        run = simulate(asked, feed, bridge=bridge, twins=twins, every_sample=every_sample, finds=spec, progress=report)
        own_study, ran = run.study, run.timeline
        if own_study.events != asked.events:
            found = expected_rests(own_study, ran, spec, ready)
        unstable += instabilities(study, spec, found)
        seen = every_sample.signals
        logged = replace(run, t_s=seen.t_s[:: rows_apart(own_study)].copy())
        at_limit = None if run.divergence else rest_at_limit(own_study, every_sample.end_of(run), seen)
        estimates = feed.log(ran) if isinstance(feed, EstimatedScheduler | FieldScheduler) else None
        used = bridge or study.simulation.bridge
        if estimates is not None or not knows_its_rests(own_study, spec, ran):  # the gains that it really had
            found = rests(own_study, ran, run.gain_changes)
        without = without_steps(own_study, run, seen)
        events = measure_events(
            own_study,
            seen,
            found,
            ripples=used == "pwm" or study.has_components,
            divergence=run.divergence,
            without=without,
            restless=never_rests(asked, spec, probes=probes),
        )
        deaf = unanswered(own_study, run.gain_changes)
        events = tuple(replace(one, reason=one.reason or deaf.get(one.t_s)) for one in events)
        if warn is not None:
            for text in deaf_in_words(spec, deaf):
                warn(text)
        survival, outcome = None, outcome_of(run.divergence, found, events, at_limit, study.converter.S_rated)
        if study.simulation.survival:
            survival = judge_scenario(own_study, spec, ready, every_sample.end_of(run), used, own_rest=True)
        told = None if outcome.status != "blocked" else told_if_blocked(own_study, spec, ready, used)
        if told is not None and warn is not None:
            warn(f"{spec.name}: {told}.")
        result = ControllerResult(
            spec=spec,
            bridge=used,
            gain_changes=run.gain_changes,
            simulation=logged,
            derives=partial(derive_series, study, logged),
            means=dict(zip(POWERS, every_sample.means, strict=True)),
            without={t_s: means_of(own_study, twin) for t_s, twin in without.items()},
            events=events,
            rests=found,
            outcome=outcome,
            estimates=estimates,
            distorted=study.has_components,
            survival=survival,
            found=found_events(study, own_study),
            dc=dc_figures(own_study, run.dc_end),
            late_peak_pu=_late_peak_pu(own_study, seen),
        )
        results[spec.name] = with_told(result, told)
    return results, unstable


def told_if_blocked(study: Study, spec: ControllerSpec, ready: Ready, bridge: str) -> str | None:
    """:func:`vsgdesign.simulation.dc_beyond.told_of_blocked` of the events of a study, which has the current limit of
    the controller. None without an event after the start. The runs go on for as long as a verdict takes."""
    asked = judged_as_one(study, spec, ready)
    if asked is None:
        return None

    def survives(one: Study) -> bool:
        (alone,) = run_scenario(one, ready, bridge=bridge).controllers
        return alone.survival is not None and alone.survival.survived

    def run(one: Study) -> Simulation:
        return simulate(one, feed_of(one, spec, build_timeline(one), ready), bridge=bridge, finds=spec)

    try:
        return told_of_blocked(asked, run, survives)
    except (InfeasibleStudyError, SimulationDivergedError):
        return None


def judged_as_one(study: Study, spec: ControllerSpec, ready: Ready) -> Study | None:
    """The study with one of its controllers, whose events are one disturbance and are followed for as long as its
    verdict takes; None without an event after the start."""
    if not any(event.t_s > 0.0 for event in study.events):
        return None
    demand = demand_of(study.converter, settling_time_of(spec, ready), silent_s=silent_s_of(spec))
    needed_s = max(event.t_s + event.over for event in study.events) + demand.needed_s + 2.0 * demand.cycle_s
    longer = replace(study.simulation, survival=True, duration=max(study.simulation.duration, needed_s))
    return replace(study, controllers=(spec,), simulation=longer)


def with_told(found: ControllerResult, told: str | None) -> ControllerResult:
    """What became of a controller whose bridge has blocked, with what is told of it (:func:`told_if_blocked`)."""
    if told is None:
        return found
    outcome = replace(found.outcome, reason=f"{found.outcome.reason}; what is asked for is {told}")
    survival = None if found.survival is None else replace(found.survival, status=NO_REST, reason=told)
    return replace(found, outcome=outcome, survival=survival)


def _expected(study: Study, timeline: Timeline, spec: ControllerSpec, ready: Ready) -> tuple[Rest, ...]:
    """The rests of a run, as if a breaker that waits closed at once."""
    if any(map(waits_to_close, study.events)):
        study = reclosed(study, next(one.t_s for one in study.events if waits_to_close(one)))
        timeline = build_timeline(study)
    return expected_rests(study, timeline, spec, ready)


def _late_peak_pu(study: Study, seen: SignalsAtPcc) -> float | None:
    """The current that a limit is held against, as ``vsgdesign verify`` does it: no sampled loop can act at once, and
    the limiter does not see the current of the filter capacitor."""
    instants = sorted({event.t_s for event in study.events if 0.0 < event.t_s < seen.t_s[-1]})
    later = peaks_of(seen.t_s, seen.i_s_sq, instants)[1] if instants else None
    return None if later is None else in_pu(study, later)


def rest_at_limit(study: Study, run: Simulation, seen: SignalsAtPcc) -> LimitedEnd | None:
    """The end of a run in which limits act; None where none does. ``run`` has at least its end, with a row for each one
    of ``seen``."""
    last_s = max((event.t_s + event.over for event in study.events), default=0.0)
    end, whole = slice(first_resting(run.t_s), None), slice(first_resting(seen.t_s), None)
    acting = limited_samples(study, replace(run, t_s=run.t_s[end], log=run.log[end]))
    return limited_end(study, run.t_s[end], seen.P_pcc[whole], seen.Q_pcc[whole], acting, last_s)


def means_of(study: Study, seen: SignalsAtPcc) -> dict[str, Array]:
    """The means of the powers in the rows that a study logs."""
    every, samples = rows_apart(study), samples_per_mean(study, seen.t_s)
    return {name: cycle_mean(getattr(seen, name), samples)[::every] for name in POWERS}


def _reporter(progress: Callable[[str, float], None], name: str) -> Callable[[float], None]:
    return lambda t_s: progress(name, t_s)


def derive_series(
    study: Study, run: Simulation, at_pcc: tuple[Array, Array] | None = None, phase: Array | None = None
) -> dict[str, Array]:
    """Named quantities of a run from its log: phases, powers at the PCC, frame angle, grid, gains. ``at_pcc``: voltage
    and current there (V and A peak, (n, 2) each), and ``phase`` that of the source (rad), of a unit of a plant; None:
    those of the study's own circuit."""
    t_s, T_s = run.t_s, study.converter.T_s
    gains, grids = np.array([change.gains for change in run.gain_changes]), run.timeline.grids
    always = len(PowerLoopGains._fields) - len(PowerLoopGains._field_defaults)
    # The published structure has the first four gains only.
    held = [(name, gains[:, k]) for k, name in enumerate(PowerLoopGains._fields) if k < always or gains[:, k].any()]
    names = *AT_PCC, "omega", "V_rms", "delta", "R_g", "L_g", *(name for name, _ in held)
    # Not one array for several: the first touch of large pages took longer than that of small ones (a virtual machine).
    series = {"t_s": t_s} | {name: np.empty(len(t_s)) for name in names}
    if at_pcc is None:
        _put_at_pcc(study, run, [series[name] for name in AT_PCC])
    else:
        put_vectors([series[name] for name in AT_PCC], at_pcc[0].T, at_pcc[1].T)
    series["omega"][:], series["V_rms"][:] = run.column("omega"), run.column("V_rms")
    delta = np.subtract(
        run.column("theta"), run.timeline.source_phase(t_s) if phase is None else phase, out=series["delta"]
    )
    delta += math.pi
    np.mod(delta, 2.0 * math.pi, out=delta)
    delta -= math.pi
    index = _index(t_s, [t for t, _ in grids], T_s)
    for name in ("R_g", "L_g"):
        series[name][:] = np.array([getattr(grid, name) for _, grid in grids])[index]
    index = _index(t_s, [change.t_s for change in run.gain_changes], T_s)
    for name, values in held:
        series[name][:] = values[index]
    return series if run.dc_log is None else series | dc_series(study, run.dc_log)


AT_PCC = (*(f"{name}_pcc_{phase}" for name in "vi" for phase in "abc"), "P_pcc", "Q_pcc")

_ROWS = 4096
"""So many rows are worked on at a time, because they fit into the processor's cache."""


def _put_at_pcc(study: Study, run: Simulation, series: Sequence[Array]) -> None:
    """Phases and powers at the PCC, in the order of AT_PCC."""
    done = 0
    for rows, circuit in AtPcc(study, run.timeline).parts(run.t_s, run.log, run.circuit_log, _ROWS):
        v, i = (vectors.T for vectors in pcc_vectors(np.asfortranarray(rows), circuit))
        put_vectors([values[done : done + len(rows)] for values in series], v, i)
        done += len(rows)


def put_vectors(series: Sequence[Array], v: Array, i: Array) -> None:
    """Of a voltage and a current, (2, n) each."""
    found = *clarke_inverse(*v), *clarke_inverse(*i), *instantaneous_power(*v, *i)
    for values, own in zip(series, found, strict=True):
        values[:] = own


def _index(t_s: Array, starts: list[float], T_s: float) -> NDArray[np.intp]:
    """Which of several successive values holds at each sample, with the simulator's slack on coincidence."""
    begins = np.searchsorted(t_s, np.array(starts) - 1e-6 * T_s)
    return np.repeat(np.arange(-1, len(starts)), np.diff(begins, prepend=0, append=len(t_s)))


def measure_events(
    study: Study,
    seen: SignalsAtPcc,
    found: Sequence[Rest],
    *,
    ripples: bool,
    divergence: Divergence | None = None,
    signals: Sequence[str] = POWERS,
    without: Mapping[float, SignalsAtPcc] | None = None,
    restless: bool = False,
) -> tuple[EventMetrics, ...]:
    """Figures of ``signals``, P_pcc and Q_pcc, after every instant with an event, up to the next one.

    ``seen``: of every sample. ``found``: where each stretch comes to rest (:func:`vsgdesign.simulation.rest.rests`).
    An event at t = 0 is where a steady start begins, not a change that anything responds to. ``ripples``: whether P
    and Q ripple at rest. ``without``: the powers without the steps that have a twin, which are judged beside it.
    ``restless``: whether P and Q never rest.
    """
    t_s = seen.t_s
    if not study.events or len(t_s) < 2:
        return ()
    per_mean = samples_per_mean(study, t_s)
    interval = float(t_s[1] - t_s[0])
    metrics = []

    def largest_pu(rows: slice) -> float:
        return in_pu(study, float(seen.i_sq[rows].max()))

    for rest in found:
        events = [event for event in study.events if event.t_s == rest.t_s]
        if not events or (rest.t_s == 0.0 and study.simulation.start == "steady_state"):
            continue
        for signal in signals:
            field = {"P_pcc": "P_ref", "Q_pcc": "Q_ref"}[signal]
            stepped = any(getattr(event, field) is not None for event in events)
            window = EventWindow(rest.name, rest.t_s, rest.end_s, stepped)
            if divergence is not None and rest.end_s > divergence.t_s:
                metrics.append(diverged_event(window, signal, divergence.reason))
                continue
            end = rest.end_state(signal, ripples, interval)
            if rest.end_s - rest.t_s > 4.0 * interval:
                y, rating = getattr(seen, signal), study.converter.S_rated
                twin = None if without is None or rest.t_s not in without else getattr(without[rest.t_s], signal)
                metrics.append(
                    measure_event(window, signal, t_s, y, rating, per_mean, end, twin, restless, largest_pu=largest_pu)
                )
    return tuple(metrics)
