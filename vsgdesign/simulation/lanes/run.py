"""Runs a batch of cases: rests, parts of one kind, gains that follow, and the verdicts.

It is what :func:`vsgdesign.simulation.run.simulate` and the judges do with one case after the other, for thousands side
by side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.signals import interrupts_deferred
from vsgdesign.linear.operating_point.many import DC_ENERGY
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.metrics.survival import END_S, LATCHED_SHARE, SurvivalDemand
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.dc_beyond import energy_beyond, stiff
from vsgdesign.simulation.field_feed import probe_of
from vsgdesign.simulation.lanes.cases import DISTURBANCE, STEP, LaneCases, segments_of
from vsgdesign.simulation.lanes.learning import Listeners, before_learning, samples_of_mean
from vsgdesign.simulation.lanes.own_rest import judge_steps, pieces, recovered
from vsgdesign.simulation.lanes.part import PROTECTION_COLUMNS, Part, Watched, make_part
from vsgdesign.simulation.lanes.rests import Rests, ends_of, rests_of
from vsgdesign.simulation.lanes.results import (
    BLOCKED,
    DIVERGED,
    JUDGED,
    LATCHED,
    NOT_AT_REST,
    OVER_LIMIT,
    SLIPPED,
    TRIPPED,
    LaneResults,
    LastEntry,
    Swings,
    swings_of,
)
from vsgdesign.simulation.lanes.telling import OfTrueGrid, Telling, learns, telling
from vsgdesign.simulation.outcome import BOUND_PU
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of, settling_times_asked
from vsgdesign.simulation.survival.running import trip_of
from vsgdesign.simulation.timeline import Segments
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]


def run_lanes(
    study: Study,
    spec: ControllerSpec,
    ready: Ready,
    cases: LaneCases,
    *,
    bridge: str = "averaged",
    strict: bool = False,
) -> LaneResults:
    """Runs every case with a controller of the study, and judges it.

    Events of a case are at least 5 ms apart. ``strict``: every operation rounds by itself, so that the results are the
    same bits on every machine. Cases without a background and sensors of their own have those of the study. Raises
    InfeasibleStudyError where the study cannot be run in a batch: a record that is too short, or events that change its
    voltage; a switched bridge whose intervals do not lie on one slope of the carrier. Load, fault and breaker change at
    the instants that the cases give, as :func:`vsgdesign.simulation.run.simulate` has it.
    """
    own, cases = study.with_limit_of(spec), cases.in_study(study)
    _refuse(own, cases, bridge)
    beside = bool(_with_twin(own, cases, learns(spec)).any())
    own_rest = beside or bridge == "pwm" or cases.around.distort(study)
    guarded = own.protection is not None and bool((cases.kind == DISTURBANCE).any())
    if not (own_rest or guarded) or len(cases) == 0:
        return _run_together(own, spec, ready, cases, bridge, strict)
    results = LaneResults.of_none(len(cases))
    demand = demand_of(own.converter, settling_time_of(spec, ready))
    ends, _ = ends_of(own, cases, segments_of(cases), demand, bridge)
    for some in pieces(ends, cases, own.converter.T_s, own_rest=own_rest, guarded=guarded, beside=beside):
        results.fill(some, _run_together(own, spec, ready, cases.take(some), bridge, strict))
    return results


def _run_together(
    own: Study, spec: ControllerSpec, ready: Ready, cases: LaneCases, bridge: str, strict: bool
) -> LaneResults:
    """Runs cases side by side. ``own`` is the study with the current limit of the controller."""
    results = LaneResults.of_none(len(cases))
    if len(cases) == 0:
        return results
    demand = demand_of(own.converter, settling_time_of(spec, ready))
    if not learns(spec):
        told = telling(own, spec, ready, cases)
        return run_told(own, told, cases, demand, bridge, strict=strict or cases.around.act)
    segments = segments_of(cases)
    rests, _ = rests_of(own, cases, segments, OfTrueGrid(gain_law(own, spec, ready), cases), demand, results)
    rests, learning = before_learning(own, spec, ready, cases, rests, results)
    good = np.flatnonzero(results.status == JUDGED)
    # A last bit may decide what an estimator decides: it runs as alone.
    for part in parts_of(own, cases, segments, rests, demand, good, bridge, strict=True, listening=True):
        Listeners(own, spec, part, learning.take(part.index[part.mains])).run()
        judge_part(part, rests, demand, results)
    _tell_of_source(
        own, results, lambda study, some: _run_together(study, spec, ready, cases.take(some), bridge, strict)
    )
    return results


def run_told(
    study: Study, told: Telling, cases: LaneCases, demand: SurvivalDemand, bridge: str = "averaged", *, strict: bool
) -> LaneResults:
    """Runs cases side by side whose controllers are told their grids, and judges them.

    ``study`` has the current limit of the controller. ``demand``: of a disturbance; its limit decides which rests are
    asked for. ``strict``: as in :func:`run_lanes`.
    """
    results, segments = LaneResults.of_none(len(cases)), segments_of(cases)
    # What is told has a state, and serves one run: what blocks is run once more.
    kept = told if study.dc is None else told.take(np.arange(len(cases)))
    rests, gains = rests_of(study, cases, segments, told, demand, results)
    good = np.flatnonzero(results.status == JUDGED)
    run = parts_of(study, cases, segments, rests, demand, good, bridge, strict)
    if run:
        drive(run, told, gains)
    for part in run:
        judge_part(part, rests, demand, results)

    def again(study: Study, some: NDArray[np.intp]) -> LaneResults:
        return run_told(study, kept.take(some), cases.take(some), demand, bridge, strict=strict)

    _tell_of_source(study, results, again)
    return results


def _tell_of_source(
    study: Study, results: LaneResults, again: Callable[[Study, NDArray[np.intp]], LaneResults]
) -> None:
    """A bridge that blocked is no verdict on the converter where its source could do no more, and where the same case
    is survived on a stiff link. ``again``: runs some of the cases in another study."""
    beyond = np.flatnonzero(np.isfinite(results.dc_beyond_j))
    larger = stiff(study)
    if beyond.size and larger is not study:
        survived = again(larger, beyond).status == JUDGED
        results.status[beyond[survived]], results.fault[beyond[survived]] = OVER_LIMIT, DC_ENERGY
        results.dc_beyond_j[beyond[~survived]] = np.nan


def _refuse(study: Study, cases: LaneCases, bridge: str) -> None:
    given = np.isfinite([cases.events.V_g_rms, cases.events.omega_g]).any() or cases.events.phase_jump.any()
    if study.replay is not None and given:
        raise InfeasibleStudyError(
            "the source of a batch of runs is a record, [replay]: give cases whose events leave the source alone."
        )
    if bridge == "pwm" and study.converter.samples_per_carrier % 2:
        raise InfeasibleStudyError(
            f"a batch of runs with a switched bridge needs an even number of samples in a carrier period, not "
            f'{study.converter.samples_per_carrier}. Use bridge = "averaged".'
        )


def _with_twin(study: Study, cases: LaneCases, listening: bool) -> NDArray[np.bool_]:
    """Which cases are steps that are judged beside their twins (:func:`vsgdesign.simulation.twin.steps_with_twin`).
    ``listening``: a field estimator does, with the probe of the study."""
    restless = cases.around.restless(len(cases)) | (listening and probe_of(study).send)
    return (cases.kind == STEP) & restless


def parts_of(
    study: Study,
    cases: LaneCases,
    segments: Segments,
    rests: Rests,
    demand: SurvivalDemand,
    good: NDArray[np.intp],
    bridge: str,
    strict: bool,
    *,
    listening: bool = False,
    target: str = "native",
) -> list[Part]:
    """The cases in parts of one kind, of one cycle and with or without ramps. ``listening``: a field estimator does.
    ``target``: the processor for which the loops are compiled (:func:`vsgdesign.codegen.llvm.compiled_loop`).

    A step is judged by the mean of its power over a nominal cycle, or over the samples of :func:`samples_of_mean` where
    a field estimator listens.
    """
    T_s = study.converter.T_s
    nominal = max(round(2.0 * math.pi / study.converter.omega_n / T_s), 1)
    ends, cycle = ends_of(study, cases, segments, demand, bridge)
    if study.replay is not None:
        needed = float(ends.max(initial=0)) * T_s
        study.replay.check_usable(needed, study.converter)
    parts = []
    ramped = cases.ramped
    judged_over = np.where(cases.kind == STEP, samples_of_mean(study) if listening else nominal, cycle)
    beside = _with_twin(study, cases, listening)
    keys = np.stack([cases.kind == DISTURBANCE, ramped, judged_over, beside], axis=1).astype(np.int64)
    for key in np.unique(keys[good], axis=0):
        index = good[(keys[good] == key).all(axis=1)]
        own = replace(demand, cycle_s=int(key[2]) * T_s)
        part = make_part(
            study,
            cases.take(index),
            index,
            rests.take(index),
            ends[index],
            own,
            step=not key[0],
            ramped=bool(key[1]),
            bridge=bridge,
            strict=strict,
            listening=listening,
            beside=bool(key[3]),
            target=target,
        )
        parts.append(part)
    return parts


def drive(parts: Sequence[Watched], told: Telling, gains: PowerLoopGains, *, stop_at: int | None = None) -> None:
    """Runs every part to its end, or up to before the sample ``stop_at``; the gains follow what the scheduler says."""
    end = max(part.end for part in parts) if stop_at is None else stop_at
    every, changes = told.update_samples, told.changes
    cuts = {0, end}
    if every:
        cuts |= set(range(0, end, every))
    cuts |= {int(sample) for sample in np.unique(changes.sample) if sample < end}
    _put_gains(parts, gains)
    R_g, L_g = (np.array(value, dtype=float) for value in told.estimate())
    _put_estimate(parts, R_g, L_g)
    counted = np.zeros(len(gains.K_ip))
    ordered = sorted(cuts)
    for begin, following in zip(ordered, [*ordered[1:], end], strict=True):
        if begin > 0 and every and begin % every == 0:
            measured, limited = _measured(parts, len(counted))
            answer = told.update(begin, *measured, limited - counted)
            counted = limited
            if answer is not None:
                gains = _transferred(parts, gains, answer)
                _put_estimate(parts, *told.estimate())
        elif begin > 0 and (now := np.flatnonzero(changes.sample == begin)).size:
            columns = [np.array(np.broadcast_to(value, counted.shape), dtype=float) for value in gains]
            for column, values in zip(columns, changes.gains, strict=True):
                column[changes.lane[now]] = values[now]
            gains = _transferred(parts, gains, PowerLoopGains(*columns))
            R_g[changes.lane[now]], L_g[changes.lane[now]] = changes.R_g[now], changes.L_g[now]
            _put_estimate(parts, R_g, L_g)
        with interrupts_deferred():
            for part in parts:
                part.run(begin, following)


def _measured(parts: Sequence[Watched], count: int) -> tuple[tuple[Array, Array, Array], Array]:
    """P_f, Q_f and V of every case, and how many samples it has limited its current in so far."""
    found = np.zeros((4, count))
    for part in parts:
        for row, name in enumerate(("state.P_f", "state.Q_f", "state.V", "limited")):
            found[row, part.index[part.mains]] = part.get(name)[part.mains]
    return (found[0], found[1], found[2]), found[3]


def _transferred(parts: Sequence[Watched], old: PowerLoopGains, new: PowerLoopGains) -> PowerLoopGains:
    """Puts new gains into force; the frequency at which the integrator would rest stays (:eq:`gain-transfer`)."""
    before, after = _stacked(old), _stacked(new)
    for part in parts:
        one, other = before[:, part.index], after[:, part.index]
        if np.array_equal(one, other):
            continue
        refs = References(*(part.get(f"refs.{name}") for name in References._fields))
        if "clamp.cut" in part.place:  # what the power loops have followed
            refs = refs._replace(P_ref=refs.P_ref + part.get("clamp.cut"))
        moved = gain_transfer(part.get("state.omega_i"), refs, PowerLoopGains(*one), PowerLoopGains(*other))
        part.put("state.omega_i", moved)
        part.put(part.span("power_gains").start, other)
    return new


def _stacked(gains: PowerLoopGains) -> Array:
    """Every gain of every case, (8, N)."""
    return np.stack(np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in gains)))


def _put_gains(parts: Sequence[Watched], gains: PowerLoopGains) -> None:
    for part in parts:
        part.put(part.span("power_gains").start, _stacked(gains)[:, part.index])


def _put_estimate(parts: Sequence[Watched], R_g: Array, L_g: Array) -> None:
    for part in parts:
        if "grid.R_g" in part.place:
            part.put("grid.R_g", np.stack([R_g[part.index], L_g[part.index]]))


def judge_part(part: Watched, rests: Rests, demand: SurvivalDemand, results: LaneResults) -> None:
    """The verdicts of a part."""
    kept, place, T_s = part.kept, part.place, part.study.converter.T_s
    watched = part.watched
    I_rated = part.study.converter.I_rated_pk
    count = len(part)
    found = LaneResults.of_none(count)
    found.status[:] = JUDGED
    found.noise[part.cases.kind == STEP] = 0.0
    found.first_peak_pu[:] = np.sqrt(watched("load.first_sq")) / I_rated
    found.peak_pu[:] = np.sqrt(watched("load.later_sq")) / I_rated
    found.above_s[:] = watched("load.above") * T_s
    limited = part.get(kept["limited_at_end"])
    found.limited_s[:] = (limited - part.get(kept["limited"])) * T_s
    if "watch.delta" in place:
        _judge_disturbance(part, rests, demand, limited, found)
    elif part.means is not None:
        judge_steps(part, found)
    else:
        found.settling_s[:] = _entry(part).time(SETTLING_BAND, T_s, part.cases.events.t_s[:, 0])
        found.overshoot[:] = np.maximum(watched("most") - 1.0, 0.0)
    numbers = np.stack([limited, watched("load.later_sq"), part.get("state.omega_i"), part.get("state.V")])
    bad = ~np.isfinite(numbers).all(axis=0) | (np.maximum(found.first_peak_pu, found.peak_pu) > BOUND_PU)
    found.status[bad] = DIVERGED
    kind = part.cases.kind[bad]
    found.settling_s[bad] = np.where(kind == STEP, np.inf, np.nan)
    found.recovery_s[bad] = np.where(kind == STEP, np.nan, np.inf)
    if part.guarded:
        _trip(part, found)
    if part.study.dc is not None:
        _block(part, part.study.dc, found)
    results.fill(part.index[part.mains], found.take(part.mains))


def _block(part: Watched, link: DcLink, found: LaneResults) -> None:
    """The runs whose dc link left its limits before their ends are lost, whatever else became of them."""
    lowest, highest = (part.get(part.kept[f"dc_{name}"]) for name in ("lowest", "highest"))
    gone = (lowest < link.V_low) | (highest > link.V_high)
    found.status[gone] = BLOCKED
    step = part.cases.kind[gone] == STEP
    found.settling_s[gone], found.recovery_s[gone] = np.where(step, np.inf, np.nan), np.where(step, np.nan, np.inf)
    at = None if part.outside is None or not gone.any() else part.outside.at(gone)
    if at is not None:
        found.dc_beyond_j[gone] = energy_beyond(link, at, lowest[gone], highest[gone])


def _trip(part: Watched, found: LaneResults) -> None:
    """Trips the runs that survive otherwise, as that of one run is tripped
    (:func:`vsgdesign.simulation.survival.running.trip_of`)."""
    T_s = part.study.converter.T_s
    for lanes, log in part.logged(slice(-PROTECTION_COLUMNS, None)):
        for k in np.flatnonzero(found.status[lanes] == JUDGED):
            lane = lanes.start + int(k)
            omega, *v = log[: part.ends[lane], :, k].T
            t_s = T_s * np.arange(len(omega), dtype=float)
            if trip_of(part.study, t_s, omega, np.hypot(*v), part.cases.events.t_s[lane, 0]) is not None:
                found.status[lane] = TRIPPED


def _entry(part: Watched) -> LastEntry:
    return LastEntry(*(part.watched(f"entry.{name}") for name in LastEntry._fields))


def _judge_disturbance(part: Watched, rests: Rests, demand: SurvivalDemand, limited: Array, found: LaneResults) -> None:
    kept, T_s, cases, events = part.kept, part.study.converter.T_s, part.cases, part.cases.events
    used = np.isfinite(events.t_s)
    last, least, most = (part.watched(name) for name in ("delta", "least", "most"))
    columns = {
        name: np.stack([part.get(kept[name] + k) for k in range(events.count)], axis=1) for name in Swings._fields
    }
    final = used.sum(axis=1) - 1
    rows = np.arange(len(part))
    columns["least"][rows, final], columns["most"][rows, final] = least, most
    swing, slipped = swings_of(Swings(**columns), used, last, rests.delta_end[part.index])
    found.swing_rad[:] = swing
    if part.means is None:
        found.recovery_s[:] = _entry(part).time(demand.band, T_s, cases.cleared_s)
    else:
        found.recovery_s[:] = recovered(part, rests, demand)
    found.limited_at_end[:] = (limited - part.get(kept["late"])) / math.floor(END_S / T_s + 1e-6)
    times = settling_times_asked(cases.silent_s, demand.settling_time)
    deadline = times * demand.settling_time + demand.grace_s
    lost = np.isinf(found.recovery_s)
    found.status[lost | (found.recovery_s > deadline)] = NOT_AT_REST
    found.status[lost & (found.limited_at_end > LATCHED_SHARE)] = LATCHED
    found.status[slipped] = SLIPPED
