"""Random plants of two to four units whose own field estimators drive them, on a dirty grid, with an event each.

Every case is a study that the product runs as it is (:func:`vsgdesign.simulation.units.scenario.run_plant`): a step of
one unit or of all, a jump of the grid, or the loss of a unit, ``EVENT_S`` after the start. A unit is judged as a
converter in the field is (:func:`vsgdesign.simulation.survival.cases.field_demand`), by its rest in the plant. Beside
it stand the share of the time in which an estimate is valid, and changes that are reported where nothing happens.
``VSGDESIGN_FIELD_SHARE=0.1`` runs a tenth of the cases; finished ones are found again.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from evidence._kept_runs import EVIDENCE_SEED, kept_runs, share
from evidence._tables import leave, table
from evidence.twin import WANDER
from vsgdesign.metrics.survival import judge_survival
from vsgdesign.simulation.survival.cases import demand_of, field_demand
from vsgdesign.simulation.survival.running import record_of
from vsgdesign.simulation.units.scenario import PlantController, run_plant
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.study import Study

STUDIES = Path(__file__).resolve().parents[1] / "studies"
PACKAGED = {"12.5 kVA": "case:lab_12kva_lcl", "5 kVA": "case:hoang2025_5kva", "1 MVA": "case:utility_1mva_60hz"}
CASES = PACKAGED | {
    "12.5 kVA of studies/plant": (STUDIES / "plant" / "study.toml").as_posix(),
    "5 kVA of studies/survival": (STUDIES / "survival" / "study.toml").as_posix(),
    "1 MVA of studies/survival, with X_t": (STUDIES / "survival" / "utility.toml").as_posix(),
}
"""Three packaged converters, and the same with inner loops that are designed."""

INNER = {
    "1 MVA of studies/survival, with X_t": 'inner_loops = { transient_reactance_pu = 0.3, transient_corner = "5.5 Hz" }'
}
"""What lies between the units and the design does not have yet, as in ``studies/plant``."""

DRAWS, DRAWS_OF_PACKAGED = 100, 30
LEARNT_S, EVENT_S, DURATION_S = 2.0, 4.0, 7.5
AFTER_S = 0.5
"""Later than this after an event an estimate should be valid."""

EVENTS = ("step of all", "step of one", "jump of the grid", "loss of a unit")

STUDY = """
base = "{case}"
converter = {{ current_limit_pu = 1.2, current_limiter = "projection" }}
power_loops = {{ structure = "angle_damped", settling_time = "1 s" }}
{inner}
grid = {{ scr = {scr}, x_over_r = {x_over_r} }}
plant = {{ units = {units}, reactance = {reactance}, resistance = {resistance} }}
simulation = {{ duration = {duration}, P_ref = "{P} W", Q_ref = "{Q} var" }}
controllers = [{{ name = "field", kind = "scheduled", estimate = "field" }}]

[background]
level = "measured"
seed = {seed}
{still}

[sensors]
level = "typical"
seed = {seed}

[[events]]
time = {event}
{happens}
"""

RATING = """
base = "{case}"
grid = {{ scr = 5, x_over_r = 4 }}
simulation = {{ duration = 12, P_ref = "0 W", Q_ref = "0 var" }}
controllers = [{{ name = "fixed", kind = "fixed" }}]
"""


def drawn(case: str, seed: int) -> tuple[Study, str]:
    """A case and what happens in it."""
    rng = np.random.default_rng([EVIDENCE_SEED, seed, list(CASES).index(case)])
    units, event = int(rng.integers(2, 5)), EVENTS[int(rng.integers(len(EVENTS)))]
    scr, x_over_r = 2.5 * (12.0 / 2.5) ** rng.random(), 2.0 * 4.0 ** rng.random()
    reactance = 0.04 + 0.04 * rng.random()
    P, Q, to = rng.uniform(-0.5, 0.5), rng.uniform(-0.15, 0.15), rng.uniform(-0.15, 0.15)
    S = study_from_text(RATING.format(case=CASES[case])).converter.S_rated
    who = f'element = "unit{int(rng.integers(units)) + 1}"\n'
    happens = {
        "step of all": f'P_ref = "{(P + to) * S} W"',
        "step of one": f'{who}P_ref = "{(P + to) * S} W"',
        "jump of the grid": f"grid = {{ scr = {2.5 * (12.0 / 2.5) ** rng.random()}, x_over_r = {x_over_r} }}",
        "loss of a unit": f'{who}breaker = "open"',
    }[event]
    text = STUDY.format(
        case=CASES[case], scr=scr, x_over_r=x_over_r, units=units, reactance=reactance, resistance=0.12 * reactance,
        duration=DURATION_S, P=P * S, Q=Q * S, seed=seed, event=EVENT_S, happens=happens, still=still(),
        inner=INNER.get(case, ""),
    )  # fmt: skip
    return study_from_text(text), f"{units} units, SCR {scr:.3g}, X/R {x_over_r:.3g}, x_t {reactance:.3f} pu, {event}"


def still() -> str:
    """Nothing of the background wanders: no power is at rest in it for long."""
    return "\n".join(f"{name} = 0" for name in WANDER)


def one_case(task: tuple[str, int]) -> dict[str, Any]:
    """What became of a case."""
    case, seed = task
    study, words = drawn(case, seed)
    try:
        found = run_plant(study).controllers[0]
    except Exception as error:  # noqa: BLE001 - a case without a start is counted with its reason
        return {"case": case, "seed": seed, "words": words, "status": "no start", "reason": str(error)}
    return {"case": case, "seed": seed, "words": words, **judged(study, found)}


def judged(study: Study, found: PlantController) -> dict[str, Any]:
    """The verdict of the worst unit, and what the estimators said."""
    statuses, reasons, valid, changes, rest_s = [], [], [], 0, 0.0
    c, last = study.converter, found.rests[-1]
    for k, unit in enumerate(found.units):
        if found.timeline.plant.units[k].name not in last.on_line:
            continue
        grid = found.timeline.timelines[k].grid_at(DURATION_S)
        scr = grid.place(c, "impedance").scr
        demand = replace(demand_of(c, 1.0), **field_demand(scr, c.omega_n))
        if last.expected[k].obstacle is not None:
            statuses.append("no rest")
            reasons.append(last.expected[k].obstacle or "")
            continue
        record = record_of(unit.simulation.study, unit.simulation)
        verdict = judge_survival(record, [EVENT_S], EVENT_S, last.expected[k], demand)
        statuses.append(verdict.status)
        reasons.append("" if verdict.survived else verdict.reason or "")
        log = unit.estimates
        if log is None or log.cycles is None:
            continue
        valid.append(log.cycles.valid[log.t_s > EVENT_S + AFTER_S].mean())
        rows = (log.t_s > LEARNT_S) & (log.t_s < EVENT_S)
        changes += int(log.cycles.changed[rows].sum())
        rest_s += EVENT_S - LEARNT_S
    worst = next((one for one in statuses if one != "survived"), "survived")
    mode = last.modes[0].s if last.modes else complex("nan")
    return {
        "status": worst,
        "reason": next((one for one in reasons if one), ""),
        "slowest": float(mode.real),
        "hertz": float(abs(mode.imag) / (2.0 * np.pi)),
        "valid": float(np.mean(valid)) if valid else float("nan"),
        "false_changes": changes,
        "rest_s": rest_s,
    }


def main(folder: Path) -> None:
    counts = {case: max(round(share() * (DRAWS_OF_PACKAGED if case in PACKAGED else DRAWS)), 1) for case in CASES}
    tasks = [(case, seed) for seed in range(max(counts.values())) for case in CASES if seed < counts[case]]
    rows = kept_runs(one_case, tasks, folder / "plant_cases.jsonl", "plant_cases")
    cells, bad = [], []
    for case in CASES:
        own = [one for one in rows if one["case"] == case]
        asked = [one for one in own if one["status"] not in ("no start", "no rest", "rest over limit")]
        grow = [one for one in asked if one["slowest"] > 0.0]
        lost = [one for one in asked if one["status"] != "survived" or one in grow]
        valid = [one["valid"] for one in asked if np.isfinite(one["valid"])]
        rest_s = sum(one["rest_s"] for one in asked)
        cells.append(
            (
                case,
                f"{len(asked)} of {len(own)}",
                f"{sum(one['status'] == 'survived' for one in asked)}",
                f"{len(grow)}",
                f"{100.0 * float(np.mean(valid)):.1f} %" if valid else "–",
                f"{sum(one['false_changes'] for one in asked)} in {rest_s / 60.0:.1f} min",
            )
        )
        for one in lost:
            mode = f"mode {one['slowest']:+.2f} 1/s at {one['hertz']:.0f} Hz"
            words = f"- {case}: {one['words']}: {one['status']}; {mode}. {one['reason']}"
            bad.append(words.rstrip())
    why = Counter(one["status"] for one in rows if one["status"] in ("no start", "no rest", "rest over limit"))
    valid_from = "valid from 0.5 s after the event on"
    head = ("converter", "cases with a rest", "at rest in time", "a mode grows", valid_from, "false changes")
    said = f"Not asked: {dict(why)}." if why else ""
    said = [said, ""] if said else []
    leave(folder, "plant_cases", rows, [*said, *table(head, cells), *([""] if bad else []), *bad])
