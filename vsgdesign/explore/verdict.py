"""What became of one controller in the page's EMT: figures of the run, and a verdict in plain words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from vsgdesign.artifacts.ready import Ready
from vsgdesign.explore.events import SHOWN_S, event_s
from vsgdesign.explore.state import State
from vsgdesign.metrics.beside_limit import beside_limit
from vsgdesign.metrics.events import DIVERGED, MEASURED, TOO_SHORT, EventMetrics
from vsgdesign.metrics.survival import LATCHED, NOT_AT_REST, SLIPPED, SURVIVED, loads_of
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.outcome import outcome_of
from vsgdesign.simulation.rest import Rest
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.scenario import measure_events, rest_at_limit, series_at_pcc
from vsgdesign.simulation.survival.running import record_of
from vsgdesign.simulation.survival.scenario import judge_scenario

SETTLED = "settled"

NOTHING: dict[str, Any] = dict.fromkeys(
    ("overshoot", "settling_s", "needs_s", "recovery_s", "peak_pu", "first_peak_pu", "limited_s", "swing_deg")
)
"""The figures of a controller that could not be simulated."""

_VERDICTS = {
    "not settled": "It does not come to rest.",
    "unstable": "The operating point after the step is unstable.",
    "no steady state": "There is no steady state after the step.",
    "no model": "No model knows the circuit after the step.",
    "limited": "It rests at its current limit.",
    DIVERGED: "It is lost: the run diverges.",
    SLIPPED: "It is lost: the angle slips by a turn.",
    LATCHED: "It is lost: it stays in its current limit.",
    NOT_AT_REST: "It is not at rest in time.",
    "no rest": "There is no steady state after the event.",
    "rest over limit": "The steady state after the event needs more current than the limiter leaves.",
}


def no_run(status: str, why: str) -> dict[str, Any]:
    """The row of a controller that could not be simulated."""
    return {**NOTHING, "status": status, "why": why, "verdict": why}


def figures_of(
    study: Study, ready: Ready, state: State, run: Simulation, rests: Sequence[Rest] | None
) -> dict[str, Any]:
    """The row of a controller that was simulated: figures in SI, status, the reason of a bad one, and the verdict.

    ``study`` is that of the run, with this controller alone. A step of a reference is judged by settling time and
    overshoot, everything else as a disturbance that is survived or not: as by ``vsgdesign run``. ``rests`` are those
    after a step (:func:`vsgdesign.simulation.rest.expected_rests`), None after anything else.
    """
    spec = study.controllers[0]
    own = study.with_limit_of(spec)
    found = NOTHING | (_of_disturbance(own, ready, run) if rests is None else _of_step(own, state, run, rests))
    if found["limited_s"] is None:
        loads = loads_of(record_of(own, run), (event_s(study),), None)
        found |= {"peak_pu": loads.peak_pu, "first_peak_pu": loads.first_peak_pu, "limited_s": loads.limited_s}
    return found | {"verdict": _verdict(found, study, state)}


def _of_disturbance(study: Study, ready: Ready, run: Simulation) -> dict[str, Any]:
    survival = judge_scenario(study, study.controllers[0], ready, run)
    found = {name: getattr(survival, name) for name in ("recovery_s", "peak_pu", "first_peak_pu", "limited_s")}
    if survival.swing_rad is not None:
        found["swing_deg"] = math.degrees(survival.swing_rad)
    return found | {"status": survival.status, "why": "" if survival.survived else survival.reason or ""}


def _of_step(study: Study, state: State, run: Simulation, rests: Sequence[Rest]) -> dict[str, Any]:
    """Settling time and overshoot of the signal whose reference is stepped."""
    series = series_at_pcc(study, run)
    signal = f"{state.event.signal}_pcc"
    events = measure_events(study, series, rests, ripples=False, divergence=run.divergence, signals=(signal,))
    outcome = outcome_of(run.divergence, rests, events, rest_at_limit(study, run, series))
    if outcome.status in ("limited", "diverged"):
        return {"status": outcome.status, "why": outcome.reason or ""}
    if not events:
        return {"status": "not known", "why": "the run is too short for any figure"}
    event = events[0]
    if event.status == TOO_SHORT:  # no fault: a slow response
        return {"status": TOO_SHORT, "why": "", "needs_s": event.needs_s}
    if event.status != MEASURED:
        return {"status": event.status, "why": event.reason or "", "overshoot": _share(event)}
    return {"status": SETTLED, "why": "", "overshoot": _share(event), "settling_s": event.raw.settling_time_s}


def _at_most(value: float, limit: float | None, decimals: int) -> str:
    """A value beside what the specification allows at most."""
    return beside_limit(value, limit, limit is not None and value > limit, lambda v, n: f"{v:.{n}f}", decimals)


def _share(event: EventMetrics) -> float | None:
    percent = event.raw.overshoot_pct
    return None if percent is None else percent / 100.0


def _verdict(found: dict[str, Any], study: Study, state: State) -> str:
    """One or two sentences on a run."""
    status = found["status"]
    if status == SETTLED and found["settling_s"] is not None:
        over = found["overshoot"]
        asked = study.specification if study.specification is not None and study.specification.settles else None
        late, too_much = (None, None) if asked is None else (asked.settling_time, 100.0 * asked.overshoot)
        beyond = ""
        if over is not None:
            beyond = " without overshoot" if over < 5e-4 else f" with {_at_most(100.0 * over, too_much, 1)} % overshoot"
        said = f"{state.event.signal} settles in {_at_most(found['settling_s'], late, 2)} s{beyond}."
    elif status == SURVIVED and found["recovery_s"] is not None:
        since = {"sag": "the end of the sag", "ramp": "the end of the ramp"}.get(state.event.kind, "the event")
        said = f"It survives and is back at rest {found['recovery_s']:.2f} s after {since}."
    elif status == TOO_SHORT:
        needs = math.ceil(100.0 * found["needs_s"]) / 100.0
        said = f"{state.event.signal} is not judged in {SHOWN_S:g} s: the slowest mode needs {needs:.2f} s."
    elif status in _VERDICTS:
        said = _VERDICTS[status]
        if found["why"].startswith("before"):
            said = said.replace("after the event", "before the event")
    else:
        return f"There is no verdict: {found['why'] or status}."
    if found["peak_pu"] is not None and status != DIVERGED:
        said += f" The current reaches {max(found['peak_pu'], found['first_peak_pu'] or 0.0):.2f} pu"
        limited = found["limited_s"] or 0.0
        said += "." if limited < 5e-4 else f", and its limiter acts for {limited:.3g} s."
    return said
