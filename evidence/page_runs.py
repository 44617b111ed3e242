"""Runs, figures and verdicts of a page without a server, in Chromium, against the strict loop and the explorer's judge.

Three converters, four ways in which gains come about, random cells of a lattice and random events of the explorer.
Every number that a strict run logs of every sample is compared bit by bit; overshoot, settling time, peak of the
current and the other figures by their difference, verdicts by their words. Then the page is dragged: from the move of
the mouse to the redrawn frame, and for how long the page hears nothing meanwhile.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evidence._random_studies import bare, table_of
from evidence._tables import leave, table
from tests.explore.browser.chromium import Page, chromium
from tests.explore.browser.explorer import COUNTER, SETTLED, drag_about
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.report.explore.live import NOTHING, emt_answer, simulated
from vsgdesign.report.explore.page_file import joined_modules, write_page
from vsgdesign.report.explore.scene import scene_of, study_of
from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.session import Session
from vsgdesign.study.parameters import load_study, study_from_text

CASES = {"5 kVA": "hoang2025_5kva", "12.5 kVA": "lab_12kva_lcl", "1 MVA": "utility_1mva_60hz"}
LATTICE = (8, 4)
RUNS, SEED = 300, 29
KINDS = ("step", "step", "step", "grid", "phase", "sag", "ramp", "voltage_set_point")
MOVES, OPENINGS, MAPS, PAUSE_S, PATIENCE_S = 60, 5, 8, 0.25, 55.0
STRUCTURES = Path(__file__).resolve().parents[1] / "studies" / "structures" / "study.toml"

STUDY = """
base = "case:{case}"
grid = {{ scr_basis = "impedance", scr = 5, x_over_r = 3 }}
power_loops = {{ structure = "angle_damped", P_droop = 0.05, Q_droop = 0.5 }}
converter = {{ current_limit_pu = 1.2, current_limiter = "projection" }}
simulation = {{ duration = 1.0, P_ref = {P_ref}, Q_ref = 0 }}
[[controllers]]
name = "fixed"
kind = "fixed"
[[controllers]]
name = "listed"
kind = "scheduled"
structure = "published"
[[controllers]]
name = "followed"
kind = "scheduled"
[[controllers]]
name = "table"
kind = "scheduled"
schedule = "table"
table = "table.json"
"""
"""One controller for each way in which gains come about."""
CONTROLLERS = ("fixed", "listed", "followed", "table")

ENGINE = """
const unpacked = Uint8Array.from(atob(STATIC.runs.data), (c) => c.charCodeAt(0));
const inflated = new Blob([unpacked]).stream().pipeThrough(new DecompressionStream("deflate"));
new Response(inflated).arrayBuffer().then((data) => {
  const engine = new module_engine_js.Engine(STATIC.runs.info, new Uint8Array(data));
  const judge = new module_verdict_js.Judge(engine);
  // A number for all bits of the log, and the row of figures with its verdict.
  window.judged = (k, key, event) => {
    const controller = engine.controller(k, key);
    if ([key, event.key].some((one) => one !== undefined && !engine.has(controller, one))) return null;
    const { rows, width, done, run } = engine.run(controller, key, event);
    const words = new Uint32Array(rows.buffer, rows.byteOffset, 2 * rows.length);
    let [one, other] = [0, 0];
    for (let j = 0; j < words.length; j += 1) {
      one = (Math.imul(one, 31) + words[j]) | 0;
      other = (other + Math.imul(words[j], 2 * j + 1)) | 0;
    }
    return { done, bits: [one >>> 0, other >>> 0], row: judge.judged(run) };
  };
}).catch((error) => { window.judged = String(error.stack); });
"""


def bits_of(log: np.ndarray) -> list[int]:
    """The number for all bits that the page gives."""
    words = np.ascontiguousarray(log).view(np.uint32).ravel()
    places = np.arange(len(words), dtype=np.uint32)
    one = np.uint32(0)
    powers = np.ones(len(words), dtype=np.uint32)
    np.multiply.accumulate(np.full(len(words) - 1, 31, dtype=np.uint32), out=powers[1:])
    with np.errstate(over="ignore"):
        one = np.sum(words * powers[::-1], dtype=np.uint32)
        other = np.sum(words * (2 * places + np.uint32(1)), dtype=np.uint32)
    return [int(one), int(other)]


def session_of(case: str, folder: Path) -> Session:
    """A converter with one controller for each way in which gains come about."""
    study = bare(case)
    table_of(study, "a", folder / "table.json")
    text = STUDY.format(case=case, P_ref=0.35 * study.converter.S_rated)
    study = study_from_text(text, folder=folder)
    return Session(study, Ready(tables=read_tables(study)))


def drawn_event(rng: np.random.Generator, scr: list[float], x_over_r: list[float]) -> dict[str, Any]:
    """An event of the explorer, as its state has it."""
    kind = str(rng.choice(KINDS))
    size = {"step": (-0.5, 0.5), "phase": (-60.0, 60.0), "sag": (0.05, 0.95), "ramp": (-2.0, 2.0)}
    low, high = size.get(kind, (-0.1, 0.1))
    return {
        "kind": kind,
        "size": 0.0 if kind == "grid" else round(float(rng.uniform(low, high)), 3),
        "signal": str(rng.choice(["P", "Q"])),
        "length_s": round(float(rng.uniform(0.05, 0.6)), 3),
        "to_scr": float(rng.choice(scr)),
        "to_x_over_r": float(rng.choice(x_over_r)),
    }


@dataclass
class Compared:
    """What was found."""

    runs: int = 0
    exact: Counter[str] = field(default_factory=Counter)
    near: Counter[str] = field(default_factory=Counter)
    words: int = 0
    others: list[str] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)
    worst: dict[str, float] = field(default_factory=dict)
    """Of all events but ramps."""
    worst_of_ramps: dict[str, float] = field(default_factory=dict)


def opened(page: Page, path: Path) -> tuple[list[float], list[float]]:
    """Opens a page's file and puts its engine where it can be asked. Returns its lattice."""
    page.goto(path.as_uri())
    page.wait("window.page && page.answers.emt")
    code = "".join(joined_modules(PAGE, name) for name in ("engine.js", "verdict.js")) + ENGINE
    page.evaluate(f"(0, eval)({json.dumps(code)})")
    page.wait("Boolean(window.judged)")
    lattice = page.evaluate("STATIC.info.lattice")
    return lattice["scr"], lattice["x_over_r"]


def compare(
    page: Page, session: Session, lattice: tuple[list[float], list[float]], seed: list[int], found: Compared
) -> None:
    """One drawn run on the page and in this process."""
    rng = np.random.default_rng(seed)
    scr, x_over_r = lattice
    event, k = drawn_event(rng, scr, x_over_r), int(rng.integers(len(CONTROLLERS)))
    at = float(rng.choice(scr)), float(rng.choice(x_over_r))
    place = f"page.file.snap({{scr: {at[0]}, x_over_r: {at[1]}}}).cell"
    to = f"String(page.file.snap({{scr: {event['to_scr']}, x_over_r: {event['to_x_over_r']}}}).cell)"
    given = json.dumps(event | {"jump": math.radians(event["size"])})
    key = f", key: {to}" if event["kind"] == "grid" else ""
    ours = page.evaluate(f"judged({k}, String({place}), {{...{given}{key}}})")
    state = session.state({"scr": at[0], "x_over_r": at[1], "event": event})
    study = session.study_of(state)
    answer = emt_answer(study, session.ready, state, places=[k])
    if answer is None:
        raise RuntimeError("no answer")
    theirs = answer.header["controllers"][0]
    if ours is None:
        if theirs["status"] not in ("no operating point", "not simulated"):
            found.others.append(f"{event} of {CONTROLLERS[k]} on {at}: no run, but {theirs['status']}")
        return
    found.runs += 1
    found.statuses[theirs["status"]] += 1
    run = simulated(
        study_of(scene_of(study, session.ready, state), session.ready, state, k).made_strict(), session.ready
    )
    same, row = ours["done"] == len(run.log) and ours["bits"] == bits_of(run.log), ours["row"]
    (found.exact if same else found.near)[event["kind"]] += 1
    worst, said = (
        (found.worst_of_ramps if event["kind"] == "ramp" else found.worst),
        f"{event} of {CONTROLLERS[k]} on {at}",
    )
    if not same and event["kind"] != "ramp":
        found.others.append(f"{said}: other bits")
    if (row["status"], row["verdict"]) == (theirs["status"], theirs["verdict"]):
        found.words += 1
    else:
        both = (f"{one['status']}: {one['verdict']}" for one in (row, theirs))
        found.others.append(f"{said}: {' | '.join(both)}")
    for name in NOTHING:
        a, b = row[name], theirs[name]
        if a is not None and b is not None:
            worst[name] = max(worst.get(name, 0.0), abs(a - b))
        elif a is not b:
            found.others.append(f"{said}: {name} {a} | {b}")


def drags(page: Page, path: Path) -> dict[str, list[float]]:
    """ms from each move of the mouse to the frame with what was simulated for it, the times in which the page heard
    nothing, how long each of its tasks lasted and its processor time, and the times from the click on the file to the
    whole page and to its first simulated curves."""
    page.call("Page.addScriptToEvaluateOnNewDocument", source=COUNTER)
    opened: dict[str, list[float]] = {"shown": [], "simulated": []}
    for _ in range(OPENINGS):
        page.goto("about:blank")
        page.goto(path.as_uri())
        page.wait(f"['linear', 'emt', 'map'].every((kind) => drawings[kind].length) && {SETTLED}", timeout_s=PATIENCE_S)
        for name, kind in (("shown", "map"), ("simulated", "emt")):
            opened[name].append(page.evaluate(f"drawings.{kind}[0].at"))
    page.evaluate(HEARING)
    _dragged_once(page)
    found = {kind: page.evaluate(f"drawings.{kind}.map((one) => one.after)") for kind in ("linear", "emt")}
    found["silent"] = page.evaluate("silences")
    with page.tasks() as (lasted, busy):  # a drag of its own: the trace takes time of the two cores
        _dragged_once(page)
    return found | {"tasks": lasted, "busy": busy} | opened


def _dragged_once(page: Page) -> None:
    drag_about(page, MOVES, PAUSE_S, empty="drawings.linear, drawings.emt, silences")
    page.mouse("mouseReleased", *page.box("#map").at())
    page.wait(SETTLED, timeout_s=PATIENCE_S)


def live_map(page: Page) -> dict[str, list[float]]:
    """ms from the wish of a live map to its first cells and to all of them, for phase jumps of several sizes."""
    found: dict[str, list[float]] = {"first cells": [], "whole map": []}
    for size in np.linspace(5.0, 40.0, MAPS):
        event = f"event: {{...page.store.state.event, kind: 'phase', size: {size}}}"
        page.evaluate(f"drawings.map.length = 0; page.store.set({{figure: 'survived', {event}}}); page.store.commit()")
        page.wait(f"drawings.map.length && !page.answers.map.header.more && {SETTLED}", timeout_s=PATIENCE_S)
        after = page.evaluate("drawings.map.map((one) => one.ms)")
        found["first cells"].append(after[0])
        found["whole map"].append(after[-1])
    return found


HEARING = """
window.silences = [];
let heard = performance.now();
const listen = () => {
  const now = performance.now();
  silences.push(now - heard);
  heard = now;
  setTimeout(listen, 4);
};
listen();
"""
"""An ear that takes no time of the page: between two of its calls 4 ms pass, and what the page is busy with. A page
that talks to itself without a pause takes a core from the workers."""


def tables(found: Compared) -> Iterator[str]:
    """The lines of what was found."""
    kinds = sorted({*found.exact, *found.near})
    rows = [
        [kind.replace("_", " "), str(found.exact[kind] + found.near[kind]), str(found.exact[kind])] for kind in kinds
    ]
    yield from table(["event", "runs", "equal to the bit"], rows)
    yield ""
    names = [name for name in NOTHING if name in found.worst or name in found.worst_of_ramps]
    both = [
        [f"{one[name]:.1e}" if name in one else "–" for one in (found.worst, found.worst_of_ramps)] for name in names
    ]
    head = ["figure", "largest difference", "of ramps"]
    yield from table(head, [[f"`{name}`", *values] for name, values in zip(names, both, strict=True)])
    yield ""
    yield f"Status and words of the verdict are equal in {found.words} of {found.runs} runs."


def dragged(drag: dict[str, list[float]]) -> Iterator[str]:
    """The lines of the drags, which depend on the machine and on what else it does."""
    p = {name: np.percentile(values, [50.0, 95.0, 100.0]) for name, values in drag.items() if values}
    names = {
        "linear": "from a move to the redrawn figures of the linear model",
        "emt": "from a move to the redrawn runs",
        "silent": "between two calls of the page's ear",
        "tasks": "a task of the page's thread",
        "busy": "its processor time",
        "shown": "from the opening of the file to its map",
        "simulated": "from the opening of the file to its first runs",
        "first cells": "from the wish of a live map to its first cells",
        "whole map": "from the wish of a live map to all of its cells",
    }
    rows = [[said, *(f"{value:.0f} ms" for value in p[name])] for name, said in names.items() if name in p]
    yield from table(["time", "median", "95 %", "longest"], rows)


def main(folder: Path, runs: int = RUNS) -> None:
    """300 runs, and the drags."""
    found = Compared()
    with tempfile.TemporaryDirectory() as place, chromium() as browser:
        for number, case in enumerate(CASES.values()):
            at = Path(place) / case
            at.mkdir()
            session = session_of(case, at)
            write_page(session, at / "page.html", lattice=LATTICE)
            page = browser.page()
            lattice = opened(page, at / "page.html")
            seed = 0
            while found.runs < runs * (number + 1) // len(CASES):
                compare(page, session, lattice, [SEED, number, seed], found)
                seed += 1
            page.close()
        leave(folder, "page_runs", vars(found), list(tables(found)))
        write_page(Session(load_study(STRUCTURES), Ready()), Path(place) / "drag.html", workers=None)
        page = browser.page()
        drag = drags(page, Path(place) / "drag.html") | live_map(page)
        page.close()
    leave(folder, "page_drags", drag)
    print("\n".join(dragged(drag)))
    for other in found.others:
        print(other)
