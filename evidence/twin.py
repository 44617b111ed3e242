"""Steps in noise beside their twins, against the same steps without any noise, and with faults hidden behind them.

Random steps of studies/field on one grid each, at rest for 3 s before and watched for 8 s, in the grid of the study and
in one that does not wander, with an averaged bridge. The run without noise is told the true grid and has no sensors, no
background and no probe. ``VSGDESIGN_FIELD_SHARE=0.2`` measures a fifth of the steps. Hidden faults
are added to a response of second order with the noise of such runs, and with what they leave of it beside a twin.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._kept_runs import first_seed, kept_runs, share
from evidence._tables import leave, table
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.metrics import EndState, EventMetrics, EventWindow, measure_event
from vsgdesign.simulation.every_sample import signals_at_pcc, with_every_sample, without_steps
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.run import simulate
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.background import draw_background
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import Study

STUDY = Path(__file__).resolve().parents[1] / "studies" / "field" / "study.toml"
STEPS = {"still": 200, "wandering": 60}
"""Random steps in a grid that does not wander, and in one that wanders as measured."""

NEAR_S, FALSE_S = 0.15, 0.5
"""Distance from the run without noise that counts as the same, and from which on a step is falsely settled."""

STEP_S, WINDOW_S = 3.0, 8.0
WANDER = (
    *("frequency_wander", "frequency_deviation", "voltage_wander", "voltage_deviation"),
    *("phase_noise", "voltage_noise", "voltage_steps_per_minute"),
)
"""What of a background is 0 in a grid that does not wander."""

Array = NDArray[np.float64]


def drawn(kind: str, seed: int) -> tuple[Study, str]:
    """A step of P or Q by 150 W to 1 kW at random powers and grids, and its signal."""
    study, rng = load_study(STUDY), np.random.default_rng([seed, len(kind)])
    scr, x_over_r = float(np.exp(rng.uniform(np.log(2.0), np.log(20.0)))), float(rng.uniform(0.5, 3.0))
    P, Q, of_P = float(rng.uniform(1.2e3, 3e3)), float(rng.uniform(500.0, 1.2e3)), bool(rng.random() < 0.6)
    size = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(150.0), np.log(1000.0))))
    event = Event(STEP_S, "step", P_ref=P + size) if of_P else Event(STEP_S, "step", Q_ref=Q + size)
    background, sensors = study.background, study.sensors
    if background is None or sensors is None:
        raise ValueError(f"{STUDY}: the study must have a background and sensors to draw.")
    ranges = dict(background.ranges) | (dict.fromkeys(WANDER, (0.0, 0.0)) if kind == "still" else {})
    simulation = replace(study.simulation, bridge="averaged", duration=STEP_S + WINDOW_S, P_ref=P, Q_ref=Q)
    return replace(
        study,
        grid=Place(scr, x_over_r, "impedance").grid(study.converter),
        background=draw_background(ranges, seed, background.level),
        sensors=sensors.redrawn(seed),
        controllers=tuple(one for one in study.controllers if one.name == "FIELD"),
        events=(event,),
        simulation=simulation,
    ), "P_pcc" if of_P else "Q_pcc"


def judged(study: Study, signal: str) -> EventMetrics:
    """The step as ``simulate`` judges it."""
    (controller,) = run_scenario(study).controllers
    return next(event for event in controller.events if event.signal == signal)


def run_of(task: tuple[str, int]) -> dict[str, Any]:
    """One step: its figures beside a twin and without noise."""
    noisy, signal = drawn(*task)
    truth = replace(noisy.controllers[0], estimate="truth", update_period=0.02)
    simulation = replace(noisy.simulation, duration=1.0 + WINDOW_S)
    events = (replace(noisy.events[0], t_s=1.0),)
    clean = replace(
        noisy, background=None, sensors=None, controllers=(truth,), simulation=simulation, events=events,
        grid_source=_source(noisy),
    )  # fmt: skip
    ours, theirs = judged(noisy, signal), judged(clean, signal)
    if ours.noise is None:
        raise ValueError(f"{task}: the step has no twin.")
    found = {"kind": task[0], "seed": task[1], "signal": signal, "step": ours.noise.step, "share": ours.noise.share}
    for name, one in (("twin", ours), ("true", theirs)):
        found |= {f"{name}_s": one.cycle_mean.settling_time_s, f"{name}_pct": one.cycle_mean.overshoot_pct}
    return found


def _source(study: Study) -> Any:
    """The source without what moves it, at the frequency and the voltage that the background gives it."""
    source, background = study.grid_source, study.background
    if background is None:
        return source
    omega = source.omega_g + 2.0 * math.pi * background.frequency_offset
    return replace(source, V_g_rms=background.voltage_factor * source.V_g_rms, omega_g=omega)


def noise_of(scr: float, seed: int) -> tuple[Array, Array]:
    """Noise of P at rest, and what is left of it beside a twin, W, a row each millisecond over a minute."""
    study, _ = drawn("still", seed)
    (spec,) = study.controllers
    study = replace(study, grid=Place(scr, 1.0, "impedance").grid(study.converter), events=(
        Event(STEP_S, "step", P_ref=study.simulation.P_ref + 500.0),
    ), simulation=replace(study.simulation, duration=STEP_S + 65.0))  # fmt: skip
    own = with_every_sample(study.with_limit_of(spec))
    run = simulate(own, FieldScheduler(own, spec, NOTHING), twins=(STEP_S,))
    seen = signals_at_pcc(own, run)
    y_0 = without_steps(own, run, seen)[STEP_S].P_pcc
    every, first = round(1e-3 / own.converter.T_s), int(np.searchsorted(seen.t_s, STEP_S + 4.0))
    count = (len(y_0) - first) // every
    of_rest, of_left = (
        np.mean(one[first : first + count * every].reshape(count, every), axis=1) for one in (y_0, seen.P_pcc - y_0)
    )
    return of_rest - float(np.mean(of_rest)), of_left - float(np.mean(of_left))


DT, BEFORE, AFTER, SIZE = 1e-3, 1000, 10_000, 500.0
_T: Array = np.linspace(0.0, DT * (AFTER - 1), AFTER, dtype=np.float64)
HIDDEN: dict[str, Any] = {
    "nothing": 0.0 * _T,
    "slow mode, 4 % exp(−0.15 t)": 0.04 * np.exp(-0.15 * _T),
    "slow mode, 6 % exp(−0.15 t)": 0.06 * np.exp(-0.15 * _T),
    "ringing, 5 % exp(−0.1 t), 1.5 Hz": 0.05 * np.exp(-0.1 * _T) * np.sin(2.0 * math.pi * 1.5 * _T),
    "limit cycle, 4 %, 0.7 Hz": 0.04 * np.sin(2.0 * math.pi * 0.7 * _T),
    "limit cycle, 3 %, 2 Hz": 0.03 * np.sin(2.0 * math.pi * 2.0 * _T),
    "limit cycle, 3 %, 6 Hz": 0.03 * np.sin(2.0 * math.pi * 6.0 * _T),
    "drift, 1 % a second": 0.01 * _T,
    "step of 3 % after 4 s": 0.03 * (_T > 4.0),
}


def hidden(per_fault: int, seed: int) -> list[dict[str, Any]]:
    """Responses with each fault in the noise of SCR 8 and 20, judged with and without the noise."""
    rng, rows = np.random.default_rng(seed), []
    for scr in (8.0, 20.0):
        at_rest, left = noise_of(scr, seed + int(scr))
        for name, fault in HIDDEN.items():
            for _ in range(per_fault // 2):
                w, damping = rng.uniform(2.5, 9.0), rng.uniform(0.55, 0.999)
                w_d = w * math.sqrt(1.0 - damping**2)
                rise = 1.0 - np.exp(-damping * w * _T) * (np.cos(w_d * _T) + damping * w / w_d * np.sin(w_d * _T))
                first = rng.integers(0, len(left) - BEFORE - AFTER)
                common = 2000.0 + at_rest[first : first + BEFORE + AFTER]
                y = common.copy()
                y[BEFORE:] += SIZE * (rise + fault) + left[first + BEFORE : first + BEFORE + AFTER]
                clean = np.concatenate([np.zeros(BEFORE), SIZE * (rise + fault)])
                twin, true = _measure(y, common), _measure(clean, None)
                noise = twin.noise
                can = noise is not None and noise.judgeable
                row = {"scr": scr, "hidden": name, "judged": can}
                rows.append(
                    row | {"twin_s": twin.cycle_mean.settling_time_s, "true_s": true.cycle_mean.settling_time_s}
                )
    return rows


def _measure(y: Array, without: Array | None) -> EventMetrics:
    t_s = DT * np.arange(len(y), dtype=np.float64)
    window = EventWindow("step", BEFORE * DT, len(y) * DT, True)
    return measure_event(window, "P_pcc", t_s, y, 5e3, 40, EndState(None, math.inf), without)


def _inf(value: float | None) -> float:
    return math.inf if value is None else value


def main(folder: Path) -> None:
    tasks = [(kind, first_seed() + k) for kind, n in STEPS.items() for k in range(max(round(share() * n), 1))]
    rows = kept_runs(run_of, tasks, folder / "twin" / "runs.jsonl", "twin")
    faults, cells = hidden(max(round(share() * 30), 2), first_seed()), []
    for kind in STEPS:
        mine = [row for row in rows if row["kind"] == kind]
        can = [row for row in mine if row["share"] <= 0.02]
        off = np.array([_inf(row["twin_s"]) - row["true_s"] - 0.01 for row in can])  # a mean of two cycles, not of one
        over = np.array([row["twin_pct"] - row["true_pct"] for row in can])
        none = sum(row["twin_s"] is None for row in can)
        beyond = sum(row["twin_pct"] - row["true_pct"] > 100.0 * row["share"] for row in can)
        cells.append(
            (
                kind,
                f"{min(abs(row['step']) for row in mine):.0f} to {max(abs(row['step']) for row in mine):.0f}",
                f"{len(can)} of {len(mine)}",
                f"{100.0 * float(np.mean(np.abs(off) <= NEAR_S)):.1f} %",
                f"{off.min():+.2f} to {off.max():+.2f} s",
                f"{none}",
                f"{np.median(over):.1f}, {np.quantile(over, 0.95):.1f}; {beyond}",
            )
        )
    head = (
        *("grid", "steps [W, var]", "judged", f"within {NEAR_S:g} s of the run without noise", "error"),
        *("not settled", "overshoot too large [points]: median, 95 %; beyond ±"),
    )
    lines = [*table(head, cells), ""]
    cells = []
    for name in HIDDEN:
        mine = [row for row in faults if row["hidden"] == name]
        can = [row for row in mine if row["judged"]]
        false = sum(_inf(row["twin_s"]) < _inf(row["true_s"]) - FALSE_S for row in mine)
        late = [_inf(row["twin_s"]) - row["true_s"] for row in can if row["true_s"] is not None]
        shown = f"{np.median(late):+.2f}, {max(late):+.2f} s" if late else "–"
        cells.append((name, f"{len(can)} of {len(mine)}", f"{false}", shown))
    lines += table(("hidden in a step of 500 W", "judged", "falsely settled", "delay: median, largest"), cells)
    leave(folder, "twin", {"steps": rows, "hidden": faults}, lines)
