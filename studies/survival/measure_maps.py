"""Measures the survival maps and traces of the 5 kVA converter: python studies/survival/measure_maps.py [FOLDER]

Writes maps.json and trace.npz to the folder (out/survival). An interrupted measurement goes on where it was.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.compliance.maps import Mapped, clearing_times_of
from vsgdesign.campaigns.survival import run_many
from vsgdesign.simulation.survival import (
    CaseResult,
    CaseRun,
    GridKnowledge,
    GridState,
    Subject,
    SurvivalCase,
    trace_case,
)
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.event import Event
from vsgdesign.verbs.pipeline.survival import LIMITERS, subjects_of, variant_name

HERE = Path(__file__).resolve().parent
CONTROLLER = "angle_damped"

SCR = (1.2, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)
X_OVER_R = (0.3, 1.0, 3.0, 10.0)
POWERS = (-0.7, -0.35, 0.35, 0.7)
PHASES = tuple(float(value) for value in range(-180, 181, 15) if value)
DEPTHS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
LENGTHS_S = (0.02, 0.05, 0.1, 0.15, 0.25, 0.4, 0.6, 1.0, 1.5, 2.5)
LOADED = 0.5
"""P_ref of phase jumps and sags, pu; their grids have X/R 3."""

CLEARING_POWERS = (0.3, 0.8)
TRACED = {"scr": 1.5, "to": 20.0, "x_over_r": 3.0, "P_pu": 0.5}


def _case(
    group: str, scr: float, x_over_r: float, P_pu: float, changes: Sequence[Event], silent_s: float = 0.2
) -> SurvivalCase:
    return SurvivalCase(
        group=group,
        start=GridState(scr=scr, x_over_r=x_over_r, P_pu=P_pu, Q_pu=0.0),
        changes=tuple(changes),
        cleared_s=changes[-1].t_s,
        knowledge=GridKnowledge(silent_s=silent_s),
    )


def jump(scr: float, to: float, x_over_r: float, P_pu: float) -> SurvivalCase:
    """A jump of SCR that the schedule learns 0.2 s later."""
    return _case("jump", scr, x_over_r, P_pu, [Event.of_pu(0.0, scr=to, x_over_r=x_over_r)])


def phase(scr: float, degrees: float) -> SurvivalCase:
    """A jump of the grid's phase."""
    return _case("phase", scr, 3.0, LOADED, [Event.of_pu(0.0, phase_deg=degrees)])


def sag(scr: float, V_g_pu: float, length_s: float, P_pu: float = LOADED) -> SurvivalCase:
    """A sag of the grid's voltage."""
    begin, end = Event.of_pu(0.0, V_g_pu=V_g_pu), Event.of_pu(length_s, V_g_pu=1.0)
    return _case("sag", scr, 3.0, P_pu, [begin, end])


def all_cases() -> list[SurvivalCase]:
    """Every case of the maps."""
    jumps = [jump(a, b, x, P) for x in X_OVER_R for a in SCR for b in SCR if a != b for P in POWERS]
    phases = [phase(scr, degrees) for scr in SCR for degrees in PHASES]
    return [*jumps, *phases, *(sag(5.0, V, length) for V in DEPTHS for length in LENGTHS_S)]


def verdicts(results: Sequence[CaseResult]) -> dict[str, list[Any]]:
    """Verdicts by the name of their case: status, recovery in s, largest current in pu."""
    return {one.case.name: [one.verdict.status, one.verdict.recovery_s, one.verdict.peak_pu] for one in results}


def clearing_times(subject: Subject) -> list[dict[str, Any]]:
    """Critical clearing times of a fault that takes the whole voltage, on grids with X/R 3."""
    mapped = Mapped(study=subject.study, spec=subject.spec, ready=subject.ready)
    scr = np.array(SCR)
    found = []
    for P in CLEARING_POWERS:
        times, _ = clearing_times_of(mapped, scr, np.full(len(scr), 3.0), P)
        for place, longest_s, bounded in zip(SCR, times.longest_s, times.bounded, strict=True):
            known = float(longest_s) if np.isfinite(longest_s) else None
            found.append({"P_pu": P, "scr": place, "longest_s": known, "bounded": bool(bounded)})
    return found


def trace(subject: Subject) -> dict[str, Any]:
    """The signals of one jump."""
    run = trace_case(subject, jump(TRACED["scr"], TRACED["to"], TRACED["x_over_r"], TRACED["P_pu"]))
    if not isinstance(run, CaseRun):
        raise SystemExit(f"the traced jump has no run: {run.reason}")
    record, simulation = run.record, run.simulation
    return {
        "t_s": record.t_s,
        "i_s_pu": record.i_s_pu,
        "delta": np.unwrap(record.delta),
        "f_hz": simulation.column("omega") / (2.0 * np.pi),
        "P_pu": record.P / run.study.converter.S_rated,
        "limited": record.limited,
    }


def main(folder: Path) -> None:
    """Measure, and write the numbers."""
    study = load_study(HERE / "study.toml")
    subjects = subjects_of(study, Ready(), controllers=(CONTROLLER,))
    names = {limiter: variant_name(CONTROLLER, limiter) for limiter in LIMITERS}
    folder.mkdir(parents=True, exist_ok=True)
    results = run_many(subjects, all_cases(), folder / "maps.runs.jsonl")
    document = {
        limiter: {"cases": verdicts(results[name]), "clearing": clearing_times(subjects[name])}
        for limiter, name in names.items()
    }
    (folder / "maps.json").write_text(json.dumps(document, indent=1, ensure_ascii=False), encoding="utf-8")
    traces = {limiter: trace(subjects[name]) for limiter, name in names.items()}
    arrays = {f"{limiter}.{key}": values for limiter, one in traces.items() for key, values in one.items()}
    np.savez_compressed(folder / "trace.npz", **arrays)
    print(f"{len(all_cases())} cases for each of {', '.join(LIMITERS)}: {folder / 'maps.json'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("out") / "survival")
