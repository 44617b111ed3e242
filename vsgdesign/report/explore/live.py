"""The page's EMT: every shown controller through the same event from the same operating point, with its figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid import capacitor_node_voltage
from vsgdesign.errors import SimulationDivergedError, VsgDesignError
from vsgdesign.metrics.events import MEASURED, TOO_SHORT, EventMetrics
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.metrics.survival import loads_of
from vsgdesign.report.explore.dc_side import curves_of_dc, levels_of
from vsgdesign.report.explore.page_verdicts import SETTLED, asked_of, verdict
from vsgdesign.report.explore.scene import (
    LEAD_S,
    Scene,
    Shown,
    after_s,
    event_s,
    length_s,
    scene_of,
    study_of,
)
from vsgdesign.report.explore.state import State
from vsgdesign.report.explore.wire import Answer, emt_of_rows, never, thinned
from vsgdesign.simulation.every_sample import signals_at_pcc, with_every_sample
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.outcome import outcome_of
from vsgdesign.simulation.rest import Rest
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.scenario import measure_events, rest_at_limit
from vsgdesign.simulation.scenario.checking import expected_rests_of
from vsgdesign.simulation.survival.running import record_of
from vsgdesign.simulation.survival.verdicts import judge_scenario
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.study import Study

SIGNALS = ("P", "Q", "i_s_pu", "omega_hz", "v_pu")
"""Curves of each controller: P and Q at the control point in per unit of S_rated, the converter's current and the
voltage at the control point in per unit of the rated peak, and the converter's frequency in Hz."""

_NOT_SIMULATED = "not simulated"
_TOLD = "Its own estimator does not run here: it is told the grid with the errors and the silence that are set."


def emt_answer(
    study: Study,
    ready: Ready,
    state: State,
    stale: Callable[[], bool] = never,
    places: Collection[int] | None = None,
) -> Answer | None:
    """EMT of every shown controller through the state's event, with the figures of ``vsgdesign run`` and its verdict.

    ``study`` has the state's changes already. Times count from the event. None: a newer request made this one ``stale``
    meanwhile. A controller that cannot be simulated has words in place of curves; nothing is raised for it. ``places``:
    the shown controllers of a part of the answer (:func:`vsgdesign.report.explore.wire.joined_emt`), None for all.
    """
    scene = scene_of(study, ready, state)
    places = [k for k in range(len(scene.shown)) if places is None or k in places]
    runs: list[Simulated | dict[str, Any]] = []
    for k in places:
        if stale():
            return None
        runs.append(_run(scene, state, ready, k))
    rests = _rests([one for one in runs if isinstance(one, Simulated)], ready, state)
    rows: list[dict[str, Any]] = []
    arrays: dict[str, NDArray[np.float32]] = {}
    for k, one in zip(places, runs, strict=True):
        shown = scene.shown[k]
        row = one if isinstance(one, dict) else _figures(one, ready, state, next(rests))
        rows.append({"name": shown.name, **row, "note": told_note(shown)})
        if isinstance(one, Simulated) and row["status"] != _NOT_SIMULATED:
            curves = curves_of(one.study, one.run)
            arrays |= {f"{k}/{name}": values for name, values in curves.items()}
    return emt_of_rows(rows, bands(scene, ready, state), arrays)


def told_note(shown: Shown) -> str:
    """What has to be known of how a controller is simulated here."""
    return _TOLD if shown.spec.estimate != "truth" else ""


class Simulated(NamedTuple):
    """A run of one controller, with its study."""

    study: Study
    run: Simulation


def _run(scene: Scene, state: State, ready: Ready, k: int) -> Simulated | dict[str, Any]:
    """The run of the ``k``-th shown controller, or its row if there is none."""
    fault = scene.cells.faults[k]
    if fault is not None:
        return no_run("no operating point", fault)
    try:
        study = study_of(scene, ready, state, k)
        return Simulated(study, simulated(study, ready))
    except SimulationDivergedError as error:
        return no_run("diverged", str(error))
    except VsgDesignError as error:
        return no_run(_NOT_SIMULATED, str(error))


def _rests(runs: Sequence[Simulated], ready: Ready, state: State) -> Iterator[Sequence[Rest] | VsgDesignError | None]:
    """Where each run comes to rest after a step; None after another event."""
    if state.event.kind != "step":
        return iter([None] * len(runs))
    since_s = min((event_s(one.study) for one in runs), default=0.0)
    several = [(one.study, one.run.timeline, one.study.controllers[0]) for one in runs]
    return iter(expected_rests_of(several, ready, since_s))


def _figures(
    one: Simulated, ready: Ready, state: State, rests: Sequence[Rest] | VsgDesignError | None
) -> dict[str, Any]:
    try:
        if isinstance(rests, VsgDesignError):
            raise rests
        return figures_of(one.study, ready, state, one.run, rests)
    except VsgDesignError as error:
        return no_run(_NOT_SIMULATED, str(error))


def simulated(study: Study, ready: Ready) -> Simulation:
    """The run of a study's only controller.

    Nothing is checked before: an event may lead to where there is no steady state, and the run shows what happens.
    """
    spec = study.controllers[0]
    own = with_every_sample(study.with_limit_of(spec))
    run = simulate(own, feed_of(own, spec, build_timeline(own), ready))
    # What follows reads it column by column.
    return replace(run, log=np.asfortranarray(run.log))


def curves_of(study: Study, run: Simulation) -> dict[str, NDArray[np.float32]]:
    """Time from the event (s), :data:`SIGNALS` and the signals of the dc link of a run: rows of its log, few enough to
    be drawn."""
    log, c = run.log, study.converter
    v = capacitor_node_voltage(log[:, 0:2], log[:, 2:4], log[:, 4:6], study.circuit())
    values = (
        run.column("P") / c.S_rated,
        run.column("Q") / c.S_rated,
        np.hypot(log[:, 0], log[:, 1]) / c.I_rated_pk,
        run.column("omega") / (2.0 * np.pi),
        np.hypot(v[:, 0], v[:, 1]) / rms_to_peak(c.V_rated_rms),
    )
    named = dict(zip(SIGNALS, values, strict=True)) | curves_of_dc(study, run)
    kept = thinned(list(named.values()))
    found = {"t": run.t_s - event_s(study)} | named
    return {name: series[kept].astype(np.float32) for name, series in found.items()}


def bands(scene: Scene, ready: Ready, state: State) -> list[dict[str, Any]]:
    """Bands and limits of the curves: current limits, levels of the dc link, and what the specification asks of a step.

    The band of a step lies around the value that its reference asks for. Where a droop moves the final value of Q,
    there is none.
    """
    end_s = length_s(state.event) + after_s(scene, ready, state)
    given = [one.study.converter.current_limit_pu for one in scene.shown]
    limits = sorted({limit for limit in given if limit is not None})
    found = [_band("i_s_pu", (-LEAD_S, end_s), None, limit, f"current limit {limit:.3g} pu") for limit in limits]
    found += [{"from_s": -LEAD_S, "to_s": end_s} | level for level in levels_of(scene.study)]
    asked, event = asked_of_steps(scene, state), state.event
    if asked is None or event.kind != "step" or event.size == 0.0 or event.signal not in asked["start"]:
        return found
    final, (within, beyond) = asked["start"][event.signal] + event.size, asked["labels"]
    width, most = abs(event.size) * asked["band"], final + event.size * asked["overshoot"]
    found.append(_band(event.signal, (asked["from_s"], end_s), final - width, final + width, within))
    low, high = (None, most) if event.size > 0.0 else (most, None)
    found.append(_band(event.signal, (0.0, end_s), low, high, beyond))
    return found


def asked_of_steps(scene: Scene, state: State) -> dict[str, Any] | None:
    """What the bands of a step of any size are made of: P and Q before it in per unit, of Q only where no droop moves
    its final value. None where the study asks for nothing."""
    asked = asked_of(scene.study)
    if asked is None:
        return None
    settling_s, overshoot = asked
    moves = np.any(np.asarray(scene.cells.gains.D_q))
    return {
        "start": {"P": state.P_pu} | ({} if moves else {"Q": state.Q_pu}),
        "from_s": settling_s,
        "overshoot": overshoot,
        "band": SETTLING_BAND,
        "labels": (f"within 2 % from {settling_s:.3g} s", f"overshoot of {100.0 * overshoot:.3g} %"),
    }


def _band(
    signal: str, over_s: tuple[float, float], low: float | None, high: float | None, label: str
) -> dict[str, Any]:
    return {"signal": signal, "from_s": over_s[0], "to_s": over_s[1], "low": low, "high": high, "label": label}


NOTHING: dict[str, Any] = dict.fromkeys(
    ("overshoot", "settling_s", "needs_s", "recovery_s", "peak_pu", "first_peak_pu", "limited_s", "swing_deg")
)
"""The figures of a controller that could not be simulated."""


def no_run(status: str, why: str) -> dict[str, Any]:
    """The row of a controller that could not be simulated."""
    return {**NOTHING, "status": status, "why": why, "verdict": why}


def figures_of(
    study: Study, ready: Ready, state: State, run: Simulation, rests: Sequence[Rest] | None
) -> dict[str, Any]:
    """The row of a controller that was simulated: figures in SI, status, the reason of a bad one, and the verdict.

    ``study`` is that of the run, with this controller alone. A step of a reference is judged by settling time and
    overshoot, everything else as a disturbance that is survived or not: as by ``vsgdesign run``. ``rests`` are those
    after a step (:func:`vsgdesign.simulation.scenario.checking.expected_rests`), None after anything else.
    """
    spec = study.controllers[0]
    own = study.with_limit_of(spec)
    found = NOTHING | (_of_disturbance(own, ready, run) if rests is None else _of_step(own, state, run, rests))
    if found["limited_s"] is None:
        loads = loads_of(record_of(own, run), (event_s(study),), None)
        found |= {"peak_pu": loads.peak_pu, "first_peak_pu": loads.first_peak_pu, "limited_s": loads.limited_s}
    return found | {"verdict": verdict(found, asked_of(study), state.event.kind, state.event.signal, event_s(study))}


def _of_disturbance(study: Study, ready: Ready, run: Simulation) -> dict[str, Any]:
    survival = judge_scenario(study, study.controllers[0], ready, run, study.simulation.bridge)
    found = {name: getattr(survival, name) for name in ("recovery_s", "peak_pu", "first_peak_pu", "limited_s")}
    if survival.swing_rad is not None:
        found["swing_deg"] = math.degrees(survival.swing_rad)
    return found | {"status": survival.status, "why": "" if survival.survived else survival.reason or ""}


def _of_step(study: Study, state: State, run: Simulation, rests: Sequence[Rest]) -> dict[str, Any]:
    """Settling time and overshoot of the signal whose reference is stepped."""
    seen = signals_at_pcc(study, run)
    signal = f"{state.event.signal}_pcc"
    switched = study.simulation.bridge == "pwm"
    events = measure_events(study, seen, rests, ripples=switched, divergence=run.divergence, signals=(signal,))
    outcome = outcome_of(run.divergence, rests, events, rest_at_limit(study, run, seen), study.converter.S_rated)
    if outcome.limits or outcome.status in ("diverged", "blocked"):
        return {"status": outcome.status, "why": outcome.reason or ""}
    if not events:
        return {"status": "not known", "why": "the run is too short for any figure"}
    event = events[0]
    if event.status == TOO_SHORT:  # no fault: a slow response
        return {"status": TOO_SHORT, "why": "", "needs_s": event.needs_s}
    if event.status != MEASURED:
        return {"status": event.status, "why": event.reason or "", "overshoot": _share(event)}
    return {"status": SETTLED, "why": "", "overshoot": _share(event), "settling_s": event.cycle_mean.settling_time_s}


def _share(event: EventMetrics) -> float | None:
    percent = event.cycle_mean.overshoot_pct
    return None if percent is None else percent / 100.0
