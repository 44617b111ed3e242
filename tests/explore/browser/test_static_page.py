"""The page without a server: one file that one opens from a disk, with the numbers of the explorer."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.explore.browser.chromium import Chromium, Page
from tests.explore.browser.explorer import COUNTER, SETTLED, TABLE, Explorer, ExplorerPage, explorer_of
from tests.explore.test_page_runs import session_in
from vsgdesign import __version__
from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.report.explore import page_file
from vsgdesign.report.explore.lattice import shown_in
from vsgdesign.report.explore.linear import OF_MODEL
from vsgdesign.report.explore.live import NOTHING as FIGURES
from vsgdesign.report.explore.live import SIGNALS, simulated
from vsgdesign.report.explore.maps import map_cells, map_figures, quick_figures, survived_cells
from vsgdesign.report.explore.page_file import joined_modules, page_of_session, write_page
from vsgdesign.report.explore.scene import scene_of, study_of
from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.session import Session
from vsgdesign.report.explore.state import State
from vsgdesign.simulation.every_sample import with_every_sample
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import simulate
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import study_from_text


def test_a_file_alone_shows_the_numbers_of_the_explorer(explorer: Explorer, browser: Chromium, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    size = write_page(explorer.session, path, lattice=(3, 2))
    assert size == path.stat().st_size <= page_file.LIMIT_BYTES
    page = browser.page()
    page.call("Page.addScriptToEvaluateOnNewDocument", source=COUNTER)
    page.goto(path.as_uri())
    page.wait(f"['linear', 'emt', 'map'].every((kind) => drawings[kind].length) && {SETTLED}")
    start = page.evaluate(TABLE)
    box, before = page.still("#map"), page.evaluate("drawings.linear.length")
    page.drag([box.at(across, 0.8) for across in (0.3, 0.5, 0.7, 0.9)])
    page.wait(f"drawings.linear.length > {before} && {SETTLED}")
    scr, ratio = page.evaluate("[STATIC.info.lattice.scr.at(-1), STATIC.info.lattice.x_over_r[0]]")
    assert page.evaluate("document.getElementById('where').textContent").split() == [
        "SCR", f"{scr:.2f}", "X/R", f"{ratio:.2f}",
    ]  # fmt: skip
    table = page.evaluate(TABLE)
    assert table != start
    state = explorer.state(scr=scr, x_over_r=ratio)
    stable = [one for one in explorer.header("linear", state)["controllers"] if one["stable"]]
    assert stable
    for one in stable:
        row = {name: text.replace("−", "-") for name, text in table[one["name"]].items()}
        assert row["Linear: ζ"] == f"{one['damping_all_modes']:.2f}"
        assert row["Margins: disk out"] == f"{one['disk_margin_output']:.2f}"
    assert [url for url in page.urls if url != path.as_uri() and not url.startswith(("data:", "blob:"))] == []
    assert list(page.faults) == []
    page.close()


def test_a_file_simulates_other_events_with_the_bits_of_the_package(browser: Chromium, tmp_path: Path) -> None:
    """Every number that a strict run logs of every sample, for each way in which gains come about, and held. A ramp is
    equal to ten digits: the source of a single run of the package is then computed by matrices. The study that the page
    saves is such a strict run.
    """
    session = session_in(tmp_path)
    path = tmp_path / "page.html"
    write_page(session, path, lattice=(3, 1))
    page = browser.page()
    page.goto(path.as_uri())
    page.wait("window.page && page.answers.emt")
    page.evaluate(f"(0, eval)({json.dumps(joined_modules(PAGE, 'engine.js') + ENGINE)})")
    page.wait("Boolean(window.engine)")
    lattice = page.evaluate("STATIC.info.lattice")
    scr, ratio, hold = lattice["scr"], lattice["x_over_r"][0], lattice["hold"]
    saved = {}
    for event, held in [*((event, None) for event in EVENTS), (EVENTS[3], hold)]:
        to = {"to_scr": scr[2], "to_x_over_r": ratio} if event["kind"] == "grid" else {}
        state = session.state({"scr": scr[1], "x_over_r": ratio, "event": event | to, "hold": held})
        scene = scene_of(session.study_of(state), session.ready, state)
        mark = ",h" if held else ""
        asked = event | {"jump": math.radians(event["size"])} | ({"key": f"2{mark}"} if to else {})
        for k in range(4):
            run = simulated(study_of(scene, session.ready, state, k).made_strict(), session.ready)
            log = np.ascontiguousarray(run.log)
            count, sum_of_bits, *most = page.evaluate(f"bits({k}, '1{mark}', {json.dumps(asked)})")
            assert count == len(log)
            np.testing.assert_allclose(most, np.abs(log).max(axis=0), rtol=1e-9)
            near = event["kind"] == "ramp"
            assert near or sum_of_bits == str(int(log.view(np.uint64).sum(dtype=np.uint64))), (event, k)
            if not near:  # as on a live map
                differ, numbers = page.evaluate(f"differing({k}, ['1{mark}', '2{mark}'], {json.dumps(asked)})")
                assert differ == 0
                assert numbers == 2 * log.size
            if not held:
                saved[event["kind"], k] = run
    for event in EVENTS[1:]:
        event |= {"to_scr": scr[2], "to_x_over_r": ratio, "length_s": 0.15}
        wish = json.dumps({"scr": scr[1], "x_over_r": ratio, "event": event, "hold": None})
        toml = page.evaluate(
            f"page.ask('save', 0, {{...page.store.state, ...{wish}}}).then((reply) => reply.answer.toml)"
        )
        study = study_from_text(toml, folder=tmp_path)
        assert str(tmp_path) not in toml  # it names no folder of this machine
        spec = study.controllers[0]
        own = with_every_sample(study.with_limit_of(spec))
        run = simulate(own, feed_of(own, spec, build_timeline(own), session.ready))
        k = [one.name for one in session.study.controllers].index(spec.name)
        np.testing.assert_allclose(run.log, saved[event["kind"], k].log, rtol=1e-9, atol=1e-6)
    assert list(page.faults) == []
    page.close()


EVENTS = (
    {"kind": "step", "size": 0.1, "signal": "P"},
    {"kind": "step", "size": -0.1, "signal": "Q"},
    {"kind": "voltage_set_point", "size": 0.03},
    {"kind": "sag", "size": 0.4, "length_s": 0.15},
    {"kind": "grid", "size": 0.0},
    {"kind": "phase", "size": 20.0},
    {"kind": "ramp", "size": -0.5, "length_s": 0.15},
)
ENGINE = """
const unpacked = Uint8Array.from(atob(STATIC.runs.data), (c) => c.charCodeAt(0));
const inflated = new Blob([unpacked]).stream().pipeThrough(new DecompressionStream("deflate"));
new Response(inflated).arrayBuffer().then((data) => {
  window.engine = new module_engine_js.Engine(STATIC.runs.info, new Uint8Array(data));
});
window.bits = (k, key, event) => {
  const { rows, width, done } = engine.run(engine.controller(k, key), key, event);
  const whole = new BigUint64Array(rows.buffer, rows.byteOffset, rows.length);
  const most = new Array(width).fill(0);
  let sum = 0n;
  for (let j = 0; j < done * width; j += 1) {
    sum += whole[j];
    most[j % width] = Math.max(most[j % width], Math.abs(rows[j]));
  }
  return [done, String(BigInt.asUintN(64, sum)), ...most];
};
// How many numbers of two runs in one loop differ from those of the same runs alone, and how many there are.
window.differing = (k, keys, event) => {
  const controller = engine.controller(k, keys[0]);
  const beside = engine.together(controller, keys, event);
  let [differ, count] = [0, 0];
  keys.forEach((key, lane) => {
    const { rows, width, done } = engine.run(controller, key, event);
    const { loop, done: ended } = beside[lane];
    if (ended !== done) differ += 1;
    const { floats } = loop.memory;
    for (let j = 0; j < done * width; j += 1) {
      if (!Object.is(rows[j], floats[loop.inLog(0, j)])) differ += 1;
      count += 1;
    }
  });
  return [differ, count];
};
"""


def test_a_file_shows_another_event(explorer: Explorer, browser: Chromium, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text(page_of_session(explorer.session, (2, 1)), encoding="utf-8")
    page = browser.page()
    page.call("Page.addScriptToEvaluateOnNewDocument", source=COUNTER)
    page.goto(path.as_uri())
    page.wait(f"['linear', 'emt', 'map'].every((kind) => drawings[kind].length) && {SETTLED}")
    before = page.evaluate("drawings.emt.length")
    page.evaluate(CHOOSE)
    page.wait(f"drawings.emt.length > {before} && {SETTLED}")
    state = explorer.session.state(page.evaluate("page.store.state"))
    answer = explorer.session.emt(explorer.session.study_of(state), state)
    assert answer is not None
    bands = "page.answers.emt.header.bands"
    assert page.evaluate(bands) == plain(answer.header["bands"])
    rows = page.evaluate("page.answers.emt.header.controllers")
    for k, (ours, theirs) in enumerate(zip(rows, answer.header["controllers"], strict=True)):
        assert (ours["status"], ours["verdict"]) == (theirs["status"], theirs["verdict"])
        for name in FIGURES:
            assert ours[name] == (None if theirs[name] is None else pytest.approx(theirs[name], abs=1e-9)), name
        for signal in SIGNALS:
            ends = page.evaluate(f"((v) => [Math.min(...v), Math.max(...v)])(page.answers.emt.arrays['{k}/{signal}'])")
            curve = answer.arrays[f"{k}/{signal}"]
            np.testing.assert_allclose(ends, [curve.min(), curve.max()], rtol=1e-6)
    page.evaluate("page.store.set({event: {...page.store.state.event, kind: 'step', size: -0.07}})")
    page.wait("page.answers.emt.header.controllers[0].recovery_s === null")
    state = explorer.session.state(page.evaluate("page.store.state"))
    stepped = explorer.session.emt(explorer.session.study_of(state), state)
    assert stepped is not None
    assert page.evaluate(bands) == plain(stepped.header["bands"])
    page.evaluate("page.store.set({event: {...page.store.state.event, kind: 'sag', size: 2}})")
    page.wait("document.body.textContent.includes('Size of the event must be a number between 0 and 0.95 pu.')")
    beyond = [url for url in page.urls if url != path.as_uri() and not url.startswith(("data:", "blob:"))]
    assert (beyond, list(page.faults)) == ([], [])
    page.close()


def test_a_title_is_no_markup_and_the_page_says_what_it_is(browser: Chromium, tmp_path: Path) -> None:
    title = """</script><script>window.done = 1</script><img src=x onerror='window.done = 1'>{}"""
    study = study_from_text(SMALL.format(title=json.dumps(title)))
    path = tmp_path / "page.html"
    path.write_text(page_of_session(Session(study, NOTHING), (2, 1)), encoding="utf-8")
    page = browser.page()
    page.goto(path.as_uri())
    page.wait("window.page && page.answers.emt && page.answers.map")
    page.evaluate(CHOOSE)
    page.wait("page.answers.emt.header.controllers[0].status === 'survived'")
    assert page.evaluate("document.getElementById('title').textContent") == title
    assert page.evaluate("[window.done === undefined, document.images.length]") == [True, 0]
    said = page.evaluate("document.getElementById('fields').textContent")
    bridge = page_file.OF_BRIDGE["averaged"]
    assert said.startswith(page_file.MADE.format(__version__, "study", study.hash[:12], "2 × 1", bridge))
    toml = page.evaluate("page.ask('save', 0, page.store.state).then((reply) => reply.answer.toml)")
    assert study_from_text(toml).title.startswith(title)
    assert list(page.faults) == []
    page.close()


SMALL = """
base = "case:hoang2025_5kva"
study = {{ title = {title} }}
grid = {{ scr = 4, x_over_r = 1 }}
simulation = {{ duration = "0.3 s", P_ref = "2 kW", Q_ref = "1 kvar" }}
[[controllers]]
name = "fixed"
kind = "fixed"
"""
CHOOSE = """(() => {
  const event = document.getElementById("event");
  event.value = "sag";
  event.dispatchEvent(new Event("change"));
})()"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Session, Path]:
    """A session with a controller for each way in which gains come about, and its page."""
    folder = tmp_path_factory.mktemp("made")
    session = session_in(folder)
    write_page(session, folder / "page.html", lattice=(6, 4))
    return session, folder / "page.html"


def test_every_answer_is_that_of_the_server(browser: Chromium, made: tuple[Session, Path]) -> None:
    """Figures and words of random cells, the curves that the page draws of its compiled model, and what it says of the
    modes, for each way in which gains come about, and held."""
    session, path = made
    page = browser.page()
    page.goto(path.as_uri())
    page.wait("window.page && page.answers.emt")
    lattice = page.evaluate("STATIC.info.lattice")
    rng = np.random.default_rng(29)
    places = [(lattice["scr"][rng.integers(6)], lattice["x_over_r"][rng.integers(4)]) for _ in range(3)]
    known = 0
    for (scr, ratio), held, signal in zip(places, (None, lattice["hold"], None), "PPQ", strict=True):
        event = session.info()["defaults"]["event"] | {"signal": signal}
        state = session.state({"scr": scr, "x_over_r": ratio, "hold": held, "event": event})
        study = session.study_of(state)
        theirs, ours = session.linear(study, state, details=True), answer_of(page, "linear", state)
        details = answer_of(page, "modes", state)["header"]["controllers"]
        for k, one in enumerate(theirs.header["controllers"]):
            row = ours["header"]["controllers"][k]
            assert {name: row[name] for name in WORDS} == {name: one[name] for name in WORDS}
            for name in (*OF_MODEL, "droop_P", "droop_Q", "H_s"):
                assert (row[name] is None) == (one[name] is None), name
                assert row[name] is None or row[name] == pytest.approx(one[name], rel=2.0**-17), name
            if not one["modes"]:
                continue
            known += 1
            assert row["gains"] == pytest.approx(one["gains"], rel=2.0**-17)
            for name in CURVES:
                mine, its = np.array(ours["arrays"][f"{k}/{name}"], dtype=float), theirs.arrays[f"{k}/{name}"]
                # With the gains of the run: the voltage of a sampled rest differs from the power flow's by up to 5e-5.
                np.testing.assert_allclose(mine, its, rtol=1e-4, atol=1e-4 * np.ptp(its))
            assert len(row["modes"]) == len(one["modes"])
            for mine, described, its in zip(row["modes"], details[k]["modes"], one["modes"], strict=True):
                s = complex(its["re"], its["im"])
                assert abs(complex(mine["re"], mine["im"]) - s) < 5e-4 * abs(s)
                if sum(abs(complex(other["re"], other["im"]) - s) < 2e-3 * abs(s) for other in one["modes"]) > 1:
                    continue  # of modes that are the same, any mixture is as good
                assert described["re"] == pytest.approx(its["re"], rel=1e-6, abs=1e-4)
                assert [share for _, share in described["participation"]] == pytest.approx(
                    [share for _, share in its["participation"]], rel=1e-4, abs=1e-6
                )
                moved = dict(described["moved_by"])
                assert moved == pytest.approx(dict(its["moved_by"]), rel=2e-3, abs=1e-6 * abs(its["re"]))
    assert known >= 8
    for figure in [one["name"] for one in session.info()["figures"][:-1]]:
        state = session.state({"figure": figure, "map_of": "listed"})
        ours = answer_of(page, "map", state)
        one = next(one for one in shown_in(session.study_of(state), session.ready, state) if one.name == "listed")
        cells = map_cells(one, state, np.array(lattice["scr"]), np.array(lattice["x_over_r"]))
        theirs = quick_figures(one.study, cells, figure)
        scale = next(known.scale for known in map_figures(session.study) if known.name == figure)
        values = np.where(theirs.stable, scale * theirs.values, np.where(theirs.known, -np.inf, np.nan))
        mine = np.array(ours["arrays"]["values"], dtype=float)
        np.testing.assert_allclose(mine, values, rtol=2e-2, atol=1e-3)
    assert list(page.faults) == []
    page.close()


@pytest.mark.parametrize("event", [{"kind": "phase", "size": 150.0}, {"kind": "step", "signal": "P", "size": 0.5}])
def test_a_live_map_is_that_of_the_package(
    browser: Chromium, made: tuple[Session, Path], event: dict[str, Any]
) -> None:
    """Whether a controller survives the event of the reader, on every grid of a coarse lattice, painted as it comes."""
    session, path = made
    page = browser.page()
    page.goto(path.as_uri())
    page.wait("window.page && page.answers.map")
    event = session.info()["defaults"]["event"] | event
    page.evaluate(f"page.store.set({{figure: 'survived', map_of: 'listed', event: {json.dumps(event)}}})")
    page.wait("page.answers.map.header.figure === 'survived' && page.answers.map.header.more === false")
    scr, ratio, mine = page.evaluate("['scr', 'x_over_r', 'values'].map((name) => [...page.answers.map.arrays[name]])")
    state = session.state({"map_of": "listed", "figure": "survived", "event": event})
    one = next(one for one in shown_in(session.study_of(state), session.ready, state) if one.name == "listed")
    known, good = survived_cells(one, session.ready, state, map_cells(one, state, np.array(scr), np.array(ratio)))
    assert [math.isnan(value) if value is not None else True for value in mine] == (~known).tolist()
    assert [value == 1.0 for value in mine] == (known & good).tolist()
    assert 0 < (known & good).sum() < known.sum()
    assert list(page.faults) == []
    page.close()


WORDS = ("name", "structure", "colour", "schedule", "stable", "why", "outside", "note")
CURVES = ("bode_w", "bode_mag_db", "bode_phase_deg", "bode_Q_mag_db", "bode_Q_phase_deg", "step_t", "step_full")


def answer_of(page: Page, kind: str, state: State) -> dict[str, Any]:
    """What the page answers to a state."""
    # JSON has no words for what is not finite.
    numbers = "[...values].map((v) => (Number.isFinite(v) ? v : String(v).replace('Infinity', 'inf')))"
    plain = f"Object.fromEntries(Object.entries(answer.arrays).map(([name, values]) => [name, {numbers}]))"
    asked = f"page.ask({json.dumps(kind)}, 0, {json.dumps(state.document())})"
    return page.evaluate(f"{asked}.then(({{ answer }}) => ({{ header: answer.header, arrays: {plain} }}))")


def test_a_converter_that_nobody_tuned_for(browser: Chromium, tmp_path: Path) -> None:
    """1 MVA, 690 V, 60 Hz, an LCL filter and one sample of delay."""
    study = tmp_path / "study.toml"
    study.write_text(STUDY, encoding="utf-8")
    with explorer_of(study) as other:
        page = browser.page()
        opened = ExplorerPage(page, other.address)
        assert list(opened.table()) == ["fixed_50Hz-gains", "scheduled"]
        page.drag([opened.place(across, 0.5).point for across in (0.3, 0.5, 0.7)])
        opened.settle()
        assert other.complaints == []
        assert list(page.faults) == []
        page.close()


STUDY = """
base = "case:utility_1mva_60hz"
grid = { scr = 3, x_over_r = 6 }
simulation = { duration = "3 s", P_ref = "400 kW", Q_ref = "0 var" }

[study]
name = "unseen"

[[controllers]]
name = "fixed_50Hz-gains"
kind = "fixed"

[[controllers]]
name = "scheduled"
kind = "scheduled"
structure = "angle_damped"
"""
