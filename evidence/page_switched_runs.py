"""Runs of a page without a server whose bridge switches, in Chromium, against the strict loop of the study of each.

Three converters, four ways in which gains come about, random cells of a lattice and random events of the explorer, as
:mod:`evidence.page_runs` draws them. Every number that a strict run logs of every sample is compared bit by bit, and
the figures of the current by their difference.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from evidence._tables import leave, table
from evidence.page_runs import CASES, CONTROLLERS, LATTICE, bits_of, drawn_event, opened, session_of
from tests.explore.browser.chromium import Page, chromium
from vsgdesign.metrics.survival import loads_of
from vsgdesign.report.explore.events import event_s, study_of
from vsgdesign.report.explore.live import simulated
from vsgdesign.report.explore.page_file import write_page
from vsgdesign.report.explore.scene import scene_of
from vsgdesign.report.explore.session import SWITCHED, Session
from vsgdesign.simulation.survival.running import record_of

RUNS, SEED = 60, 129
FIGURES = ("peak_pu", "first_peak_pu", "limited_s")


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
    loads = loads_of(record_of(study.with_limit_of(study.controllers[0]), run), (event_s(study),), None)
    return {
        "event": event["kind"],
        "run": f"{event} of {CONTROLLERS[k]} on {at}",
        "same": ours["done"] == len(run.log) and ours["bits"] == bits_of(run.log),
        "status": ours["row"]["status"],
        "apart": {name: abs(ours["row"][name] - getattr(loads, name)) for name in FIGURES},
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
    calm = [one for one in found if one["event"] != "ramp"]
    worst = [[f"`{name}`", f"{max(one['apart'][name] for one in calm):.1e}"] for name in FIGURES]
    lines = [*table(["event", "runs", "equal to the bit"], rows), ""]
    lines += table(["figure, of all but ramps", "largest difference"], worst)
    leave(folder, "page_switched_runs", found, lines)
