"""Runs of a page without a server whose bridge switches, in Chromium, against the strict loop of the study of each.

Three converters, four ways in which gains come about, random cells of a lattice and random events of the explorer, as
:mod:`evidence.page_runs` draws them. Every number that a strict run logs of every sample is compared bit by bit; the
figures by their difference from those of ``simulate`` with the strict study, and the words by those of the explorer.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from evidence._tables import leave, table
from evidence.page_runs import CASES, CONTROLLERS, LATTICE, bits_of, drawn_event, opened, session_of
from tests.explore.browser.chromium import Page, chromium
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.metrics.survival import VERDICTS
from vsgdesign.report.explore.live import NOTHING, emt_answer, simulated
from vsgdesign.report.explore.page_file import write_page
from vsgdesign.report.explore.scene import scene_of, study_of
from vsgdesign.report.explore.session import SWITCHED, Session
from vsgdesign.report.explore.state import State
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters.study import Study

RUNS, SEED = 60, 129


def compare(
    page: Page, session: Session, lattice: tuple[list[float], list[float]], seed: list[int]
) -> dict[str, Any] | None:
    """One drawn run on the page and in this process; None where the controller has no rest."""
    rng = np.random.default_rng(seed)
    scr, x_over_r = lattice
    event, k = drawn_event(rng, scr, x_over_r), int(rng.integers(len(CONTROLLERS)))
    at = float(rng.choice(scr)), float(rng.choice(x_over_r))
    place = f"page.file.snap({{scr: {at[0]}, x_over_r: {at[1]}}}).cell"
    to = f"String(page.file.snap({{scr: {event['to_scr']}, x_over_r: {event['to_x_over_r']}}}).cell)"
    given = json.dumps(event | {"jump": math.radians(event["size"])})
    key = f", key: {to}" if event["kind"] == "grid" else ""
    ours = page.evaluate(f"judged({k}, String({place}), {{...{given}{key}}})")
    if ours is None:
        return None
    state = session.state({"scr": at[0], "x_over_r": at[1], "event": event})
    study = study_of(scene_of(session.study_of(state), session.ready, state), session.ready, state, k)
    if study.simulation.bridge != SWITCHED:
        raise RuntimeError("the run has no switched bridge")
    run = simulated(study.made_strict(), session.ready)
    answer = emt_answer(session.study, session.ready, state, places=[k])
    if answer is None:
        raise RuntimeError("no answer")
    explorer, row = answer.header["controllers"][0], ours["row"]
    theirs = explorer | of_simulate(study, session.ready, state)
    return {
        "event": event["kind"],
        "run": f"{event} of {CONTROLLERS[k]} on {at}",
        "same": ours["done"] == len(run.log) and ours["bits"] == bits_of(run.log),
        "said": [f"{one['status']}: {one['verdict']}" for one in (row, explorer)],
        "status": [row["status"], theirs["status"]],
        "figures": {name: (row[name], theirs[name]) for name in NOTHING},
    }


def of_simulate(study: Study, ready: Ready, state: State) -> dict[str, Any]:
    """What ``simulate`` says of the strict study, by the names of the explorer; nothing where there is no verdict."""
    try:
        (found,) = run_scenario(study.made_strict(), ready).controllers
    except InfeasibleStudyError:
        return {}
    survival = found.survival
    if survival is not None:
        names = "status", "recovery_s", "peak_pu", "first_peak_pu", "limited_s"
        swing = None if survival.swing_rad is None else math.degrees(survival.swing_rad)
        return {name: getattr(survival, name) for name in names} | {"swing_deg": swing}
    (step,) = (one for one in found.events if one.signal == f"{state.event.signal}_pcc")
    mean, share = step.cycle_mean, step.cycle_mean.overshoot_pct
    return {
        "status": found.outcome.status,
        "settling_s": mean.settling_time_s,
        "overshoot": None if share is None else share / 100.0,
        "needs_s": step.needs_s,
    }


def main(folder: Path, runs: int = RUNS) -> None:
    """60 runs."""
    found: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as place, chromium() as browser:
        for number, case in enumerate(CASES.values()):
            at = Path(place) / case
            at.mkdir()
            own = session_of(case, at)
            session = Session(own.study, own.ready, bridge=SWITCHED)
            write_page(session, at / "page.html", lattice=LATTICE)
            page = browser.page()
            lattice = opened(page, at / "page.html")
            seed = 0
            while len(found) < runs * (number + 1) // len(CASES):
                one = compare(page, session, lattice, [SEED, number, seed])
                found += [] if one is None else [one]
                seed += 1
            page.close()
    count, same = Counter(one["event"] for one in found), Counter(one["event"] for one in found if one["same"])
    rows = [[kind.replace("_", " "), str(count[kind]), str(same[kind])] for kind in sorted(count)]
    lines = [*table(["event", "runs", "equal to the bit"], rows), ""]
    lines += [*table(["figure", "largest difference", "of ramps"], list(_worst(found))), ""]
    words = sum(one["said"][0] == one["said"][1] for one in found)
    lines.append(f"Status and words of the verdict are equal in {words} of {len(found)} runs.")
    leave(folder, "page_switched_runs", found, lines)
    for one in found:
        missing = [name for name, both in one["figures"].items() if both.count(None) == 1]
        judged = one["status"][0] in VERDICTS and one["status"][0] != one["status"][1]
        if judged or missing or len({*one["said"]}) > 1 or not (one["same"] or one["event"] == "ramp"):
            print(one)


def _worst(found: list[dict[str, Any]]) -> Iterator[list[str]]:
    """The rows of figures and of their largest differences."""
    for name in NOTHING:
        apart: dict[bool, list[float]] = {False: [], True: []}
        for one in found:
            if None not in one["figures"][name]:
                a, b = one["figures"][name]
                apart[one["event"] == "ramp"].append(abs(a - b))
        if any(apart.values()):
            yield [f"`{name}`", *(f"{max(values):.1e}" if values else "–" for values in apart.values())]
