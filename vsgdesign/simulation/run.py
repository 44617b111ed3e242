"""Runs one controller through a study's scenario: cuts time into stretches, lets the compiled loop run each."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer
from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.execution.interrupts import interrupts_come, interrupts_deferred
from vsgdesign.frames import rms_to_peak
from vsgdesign.identification import Probe
from vsgdesign.operating_point.sampled import SampledState
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.study import Study
from vsgdesign.runtime.floats import on_floats
from vsgdesign.simulation.background import Background
from vsgdesign.simulation.circuits import CircuitOfGrid, Circuits
from vsgdesign.simulation.connecting import Connecting
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.gains_of_run import ListedGains, OnlineGains
from vsgdesign.simulation.loop import LOG_COLUMNS, RunLoop, kind_of
from vsgdesign.simulation.online import OnlineScheduler
from vsgdesign.simulation.outcome import Divergence, outside
from vsgdesign.simulation.probing import HeldProbe, add_offset
from vsgdesign.simulation.run_log import RunLog
from vsgdesign.simulation.sensors import SensorsOfRun, sensors_of
from vsgdesign.simulation.starting import start_of
from vsgdesign.simulation.stretches import Sources, on_sample
from vsgdesign.simulation.timeline import Timeline, build_timeline

_NOTHING = nullcontext()
_gain_transfer = on_floats(gain_transfer)

_RAMP_STRETCH = 0.02
"""Longest stretch of a ramp with one centre frequency, s."""

_RAMP_DRIFT = 1e-4
"""Largest angle, rad, that a ramp may drift from its centre frequency within one period of a stretch. The source
model leaves out third-order terms of a period; against DOP853 that is 7e-11 of rated in the steepest test."""

_SHORT = 50_000
"""Samples. For as many it does not pay to compile the loop with effort: that takes 0.02 to 0.05 s longer and saves 0.02
microseconds a sample, or 0.2 with sensors. The bits are the same."""

_PROGRESS_STRETCH = 1.0
"""Longest stretch between two calls of ``progress``, s of simulated time."""

Progress = Callable[[float], None]
"""Called with the simulated time in s; may raise to stop the run."""


@dataclass(frozen=True)
class Simulation:
    """One finished run. ``log`` has a row per logged sample and LOG_COLUMNS as columns, SI, peak αβ."""

    t_s: NDArray[np.float64]
    log: NDArray[np.float64]
    circuit_log: NDArray[np.float64]
    """The circuit's states besides i_s, v_c and i_g in the same rows, SI, peak αβ: those of load and grid
    (:class:`vsgdesign.operating_point.network.NetworkStates`); no columns where nothing but a grid is connected."""
    controller_log: NDArray[np.float64]
    """All controller states at the first samples, as many as were asked for; else zero rows."""
    timeline: Timeline
    gain_changes: tuple[GainChange, ...]
    final_state: ControllerState
    final_plant: NDArray[np.float64]
    loop_seconds: float
    """Wall time inside the compiled loop."""
    divergence: Divergence | None = None
    """Where and why the run was broken off; logs end there. None: it went to its end."""

    def to_its_end(self) -> Simulation:
        """The run itself. Raises SimulationDivergedError where it was broken off: for what cannot use a part of it."""
        if self.divergence is not None:
            raise SimulationDivergedError(self.divergence.reason)
        return self

    def column(self, name: str) -> NDArray[np.float64]:
        """One logged quantity by name."""
        return self.log[:, LOG_COLUMNS.index(name)]


def simulate(
    study: Study,
    schedule: Sequence[GainChange] | OnlineScheduler | FieldScheduler,
    *,
    bridge: str | None = None,
    log_states: int = 0,
    probe: Probe | None = None,
    circuit: CircuitOfGrid | None = None,
    progress: Progress | None = None,
) -> Simulation:
    """Simulate a study with given gains over time (the first change at or before t = 0), or with a scheduler
    that is asked for them during the run: after each of its windows, or after each cycle of a field estimator.

    ``bridge`` overrides the study's ("averaged" or "pwm"); ``log_states`` keeps the controller's states at the
    first so many samples; ``probe`` is sent from t = 0 on, in place of one that the scheduler asks for, and not
    beside that of a field estimator; ``circuit`` replaces the study's circuit between bridge and source, and its axes
    may differ. Raises InfeasibleStudyError where the start has no steady state or a scheduler's or probe's period does
    not fit the sampling. A run whose states leave every sensible bound ends there and says so (``divergence``);
    SimulationDivergedError is raised where less than two rows of the log come before.
    """
    timeline = build_timeline(study)
    T_s = study.converter.T_s
    samples = round(study.simulation.duration / T_s)
    feed = _feed(schedule, study, timeline)
    if probe is not None and isinstance(schedule, FieldScheduler):
        raise InfeasibleStudyError(
            "probe: a field estimator sends its own in every sample and listens to that one alone. Leave probe out, or "
            "give a controller without a field estimator."
        )
    kept = round(study.simulation.log_interval / T_s)
    log_every = math.gcd(kept, feed.log_samples)  # a scheduler's samples are taken from the log
    pwm = (study.simulation.bridge if bridge is None else bridge) == "pwm"
    circuits = Circuits(study, timeline, circuit, switched=pwm)
    start = start_of(study, timeline, circuits, feed.first())
    like, x = start.controller, start.plant
    sensors = sensors_of(study, x, timeline.source_at(0.0).omega)
    loop = _loop(study, feed, circuits, start, sensors, x)
    log = RunLog(
        samples, log_every, min(log_states, samples), like, sensed=sensors is not None, more=circuits.states - 6
    )
    feed.sensed, feed.more = log.sensed, log.more
    sources = Sources(circuits, Background(circuits.of, rms_to_peak(study.converter.V_rated_rms), timeline), timeline)
    loop_seconds, divergence = 0.0, None
    gains, refs_so_far = feed.first(), _references(study, timeline, 0)
    state = loop.state(like)
    hold = feed.probe_hold if probe is None else probe.hold
    held = None if hold is None else HeldProbe(hold, study, samples)
    feed.held = held
    cuts = feed.cuts(samples) if held is None else feed.cuts(samples) | held.cuts(samples)
    connecting = Connecting(study, timeline, probes=hold is not None or isinstance(schedule, FieldScheduler))
    cuts |= connecting.cuts(samples)
    put: dict[str, object] = {}  # what the loop was given last
    interrupted = interrupts_come()
    for first, count in _stretches(study, timeline, cuts, samples):
        read, refs = state, _references(study, timeline, first)
        feed.limited_samples = int(loop.view("limited")[0])
        before, gains = gains, feed.update(first, gains, state, refs, log.rows, log_every)
        # With the references of the samples before: a step of them at this sample belongs to the new gains.
        state = _with_gains(state, refs_so_far, before, gains)
        refs_so_far = refs
        state = connecting.set_to_grid(first, state, gains, loop.view("x"))
        added = None
        if held is not None:
            held.ask(first, feed.wanted() if probe is None else probe)
            refs = held.references(first, refs)
            added = held.offset(first, state.V)
            state = add_offset(state, *added)
        if state is not read or first == 0:
            loop.put("state", state)
        _put_changed(loop, put, "refs", refs)
        noise = None if sensors is None else sensors.noise(first, count)
        stretch = sources.stretch(first, count, T_s, noise, study.converter.samples_per_carrier)
        begin = time.perf_counter()
        done, why = 0, None
        with interrupts_deferred() if interrupted else _NOTHING:
            while done < count and why is None:
                _put_changed(loop, put, "power_gains", gains)
                _put_changed(loop, put, "grid", feed.grid(first) or study.grid)
                done += stretch.run(loop, log, done)
                state = loop.state(like)
                why = outside(study, loop.view("x"), state)
                if why is None and feed.closed:
                    before, gains = gains, feed.conclude(first + done, gains, state)
                    state = _with_gains(state, refs, before, gains)
                    loop.put("state", state)
        loop_seconds += time.perf_counter() - begin
        if added is not None:
            state = add_offset(state, -added[0], -added[1])
            loop.put("state", state)
        if why is not None:
            good = log.good(study, first, first + done)
            diverged_s = good * log_every * T_s
            divergence = Divergence(diverged_s, f"the simulation diverged at {diverged_s:.4g} s: {why}")
            if good <= kept // log_every:
                raise SimulationDivergedError(divergence.reason)
            log.end(good)
            break
        if progress is not None:
            progress((first + count) * T_s)
    final = loop.state(like)
    if divergence is None:
        feed.limited_samples = int(loop.view("limited")[0])
        feed.finish(samples, gains, final, _references(study, timeline, samples), log.rows, log_every)
    rows = log.rows
    rows = rows if log_every == kept and rows.flags.c_contiguous else rows[:: kept // log_every].copy()
    t_s = np.arange(rows.shape[0]) * (kept * T_s)
    return Simulation(
        t_s=t_s,
        log=rows,
        circuit_log=log.more[:: kept // log_every].copy(),
        controller_log=log.states,
        timeline=timeline,
        gain_changes=tuple(feed.changes),
        final_state=final,
        final_plant=loop.view("x").copy(),
        loop_seconds=loop_seconds,
        divergence=divergence,
    )


def _loop(
    study: Study,
    feed: ListedGains | OnlineGains | FieldScheduler,
    circuits: Circuits,
    start: SampledState,
    sensors: SensorsOfRun | None,
    x: NDArray[np.float64],
) -> RunLoop:
    """The loop of a run with the numbers that do not change, at the start of the run."""
    c, settings = study.converter, study.controller_settings()
    field = feed.memory
    kind = kind_of(study, switched=circuits.switched, axes=circuits.axes)
    kind = kind._replace(sensors=sensors is not None, field=field is not None)
    loop = RunLoop(kind, quickly=round(study.simulation.duration / c.T_s) <= _SHORT)
    loop.put("x", x)
    loop.put("state", start.controller)
    loop.put("inner_gains", study.inner_gains)
    loop.put("settings", settings)
    loop.put("R_c", study.filter.R_c)
    if c.delay_samples > 0:
        loop.put("pending", np.array(start.pending))
    if circuits.switched:
        loop.put("V_dc", c.V_dc)
    if sensors is not None:
        loop.put("sensors", sensors.constants)
        loop.put("before", sensors.before)
    if field is not None:
        loop.put("field", field.settings)
        loop.put("V_rated_rms", field.V_rated_rms)
        loop.put("allowed", field.allowed)
        field.moves_in(loop.view("lock"))
    return loop


def _feed(
    schedule: Sequence[GainChange] | OnlineScheduler | FieldScheduler, study: Study, timeline: Timeline
) -> ListedGains | OnlineGains | FieldScheduler:
    if isinstance(schedule, FieldScheduler):
        return schedule.fresh()
    T_s = study.converter.T_s
    return ListedGains(schedule, T_s) if isinstance(schedule, Sequence) else OnlineGains(schedule, study, timeline)


def _with_gains(
    state: ControllerState, refs: References, before: PowerLoopGains, after: PowerLoopGains
) -> ControllerState:
    if after is before:
        return state
    return state._replace(omega_i=_gain_transfer(state.omega_i, refs, before, after))


def _put_changed(loop: RunLoop, put: dict[str, object], head: str, record: PowerLoopGains | References | Grid) -> None:
    """Gives the loop a record if it is another one than ``put`` has of it."""
    known = put.get(head)
    if known is not record and known != record:
        put[head] = record
        loop.put(head, GridEstimate(record.R_g, record.L_g) if isinstance(record, Grid) else record)


def _references(study: Study, timeline: Timeline, sample: int) -> References:
    return timeline.references_at(_time_of(sample, study.converter.T_s))


def _time_of(sample: int, T_s: float) -> float:
    """A sample's time, with the slack by which instants are taken to coincide with it."""
    return (sample + 1e-6) * T_s


def _stretches(study: Study, timeline: Timeline, gain_cuts: set[int], samples: int) -> Iterator[tuple[int, int]]:
    """(first sample, count) of every stretch. One whose interval an event cuts is a single sample long.

    What the controller is told (references, gains) takes effect at the first sample at or after its time.
    """
    T_s = study.converter.T_s
    cuts = {0, samples} | gain_cuts
    for t_s in timeline.plant_changes():
        k = on_sample(t_s, T_s)
        cuts |= {k} if k is not None else {math.floor(t_s / T_s), math.floor(t_s / T_s) + 1}
    for t_s, _ in timeline.references:
        cuts.add(math.ceil(t_s / T_s - 1e-6))
    steps = max(round(_PROGRESS_STRETCH / T_s), 1)
    cuts |= set(range(0, samples, steps))
    for segment, following in zip(timeline.sources, [*timeline.sources[1:], None], strict=True):
        if not segment.steady:
            end = samples if following is None else math.ceil(following.t_s / T_s)
            slope = max(abs(segment.omega_slope), 1e-12)
            ramp_steps = max(round(min(_RAMP_STRETCH, _RAMP_DRIFT / (slope * T_s)) / T_s), 1)
            cuts |= set(range(math.floor(segment.t_s / T_s), min(end, samples), ramp_steps))
    ordered = sorted(k for k in cuts if 0 <= k <= samples)
    for first, following in itertools.pairwise(ordered):
        yield first, following - first
