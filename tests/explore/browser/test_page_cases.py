"""Cases of a report on the page that simulates: replayed with every bit of ``simulate``, until the reader moves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.explore.browser.chromium import Chromium
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.report.explore.live import simulated
from vsgdesign.report.explore.page_file import joined_modules, page_of_session
from vsgdesign.report.explore.page_starts import PageCase, can_be_replayed, recorded
from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.session import Session
from vsgdesign.report.page.blocks import Page, Table, words
from vsgdesign.report.page.html import print_html
from vsgdesign.report.page.live import StaticPage, linked_to_case, try_it
from vsgdesign.simulation.every_sample import with_every_sample
from vsgdesign.simulation.feeds import LateSchedule
from vsgdesign.simulation.run import simulate
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.grid import Grid

BASE = """
base = "case:lab_12kva_lcl"
study = { name = "cases" }
grid = { scr = 3.217, x_over_r = 4.1, V_g_pu = 1.013, f_g = 50.02 }
simulation = { duration = "0.6 s", P_ref = "4 kW", Q_ref = "0.3 kvar", bridge = "averaged" }
[converter]
current_limit_pu = 1.2
current_limiter = "projection"
[[controllers]]
name = "damped"
kind = "scheduled"
structure = "angle_damped"
"""
WRONG = 'knowledge = { error_R = 0.13, error_X = -0.17, silent = "70 ms" }\n'
EVENTS = """
[[events]]
time = 0.10003217
phase_jump = 0.6
[[events]]
time = 0.25003217
grid = { scr = 9.3, x_over_r = 1.7 }
"""
"""Within the intervals of the controller, which samples every 50 µs."""
ENGINE = """
(async () => {
  const packed = Uint8Array.from(atob(STATIC.runs.data), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const data = new Uint8Array(await new Response(stream).arrayBuffer());
  const engine = new module_engine_js.Engine(STATIC.runs.info, data);
  return STATIC.runs.info.cases.map((_, number) => {
    const { rows, width, done, loop } = engine.replay(number);
    const whole = new BigUint64Array(rows.slice().buffer);
    const places = ["x.i_s_alpha", "said.P", "said.omega"].map((name) => engine.info.places[loop].logged.indexOf(name));
    let sum = 0n;
    for (let j = 0; j < done; j += 1) for (const at of places) sum += whole[j * width + at];
    return [done, String(BigInt.asUintN(64, sum))];
  });
})()"""


@pytest.fixture(scope="module")
def cases() -> list[PageCase]:
    """One with an estimate that is late and wrong, and one with gains for a grid that is told twice."""
    first, second = study_from_text(BASE + WRONG + EVENTS), study_from_text(BASE + EVENTS)
    told = ((0.0, Grid(1.0, 0.01)), (0.25003217, None), (0.31, Grid(0.5, 0.002)))
    said = {"status": "slipped", "words": "It slips </td><script>done()</script>.", "figures": {"peak_pu": 1.23}}
    return [
        PageCase(label="1: <b>lost</b>", study=first, **said),
        PageCase(label="2", study=second, told=told, **said),
    ]


def test_a_case_is_replayed_to_the_bit_until_something_is_moved(
    browser: Chromium, cases: list[PageCase], tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    path.write_text(page_of_session(Session(study_from_text(BASE), NOTHING), (3, 2), cases=cases), encoding="utf-8")
    page = browser.page()
    page.goto(path.as_uri())
    page.wait("window.page && page.answers.emt && page.answers.map")
    shown = page.evaluate("page.answers.emt.header.controllers")
    assert [(one["name"], one["status"], one["peak_pu"]) for one in shown] == [("damped", "slipped", 1.23)]
    page.wait(f"document.getElementById('table').textContent.includes({json.dumps(cases[0].words)})")
    assert page.evaluate("[...document.getElementById('case').options].map((one) => one.textContent)")[:2] == [
        "1: <b>lost</b>", "2",
    ]  # fmt: skip
    page.evaluate(
        f"(0, eval)({json.dumps(joined_modules(PAGE, 'engine.js') + ';window.module_engine_js = module_engine_js')})"
    )
    for case, (count, sum_of_bits) in zip(cases, page.evaluate(ENGINE), strict=True):
        if case.told is None:
            run = simulated(case.study, NOTHING)
        else:
            own, spec = with_every_sample(case.study), case.study.controllers[0]
            run = simulate(own, LateSchedule(own, spec, case.told, NOTHING))
        log = np.column_stack([run.log[:, 0], run.column("P"), run.column("omega")])
        assert (count, sum_of_bits) == (len(log), str(int(log.view(np.uint64).sum(dtype=np.uint64))))
    page.evaluate("page.store.set({scr: STATIC.info.lattice.scr[0]}); page.store.commit()")
    page.wait("page.answers.emt.header.controllers[0].status !== 'slipped'")
    assert page.evaluate("[page.store.state.case, document.getElementById('case').value]") == [None, ""]
    page.click("#undo")
    page.wait("page.answers.emt.header.controllers[0].status === 'slipped'")
    assert list(page.faults) == []
    page.close()


def test_a_row_of_a_report_leads_to_its_case(browser: Chromium, cases: list[PageCase], tmp_path: Path) -> None:
    """Also if the part is opened by this, and again after the reader has moved."""
    text = page_of_session(Session(study_from_text(BASE), NOTHING), (2, 1), cases=cases)
    live = StaticPage(text, cases=tuple(one.label for one in cases))
    rows = tuple((linked_to_case("slips", live, label),) for label in (cases[1].label, "another"))
    blocks = [Table("Lost", ("Case",), rows), *(words("A line.") for _ in range(200)), *try_it(live, "cases")]
    page = browser.page()
    page.goto(print_html(Page("Lost", blocks), tmp_path / "report.html").as_uri())
    page.wait("document.readyState === 'complete'")
    assert page.evaluate("[...document.querySelectorAll('td a')].map((one) => one.hash)") == ["#try-it-2"]
    page.click("td a")
    inside = "document.querySelector('.live iframe')?.contentWindow"
    chosen = f"{inside}?.page?.store.state.case === 1 && {inside}.page.answers.emt"
    page.wait(chosen)
    assert page.evaluate("document.querySelector('.live').getBoundingClientRect().top") < 800
    page.evaluate(f"{inside}.page.store.set({{scr: {inside}.STATIC.info.lattice.scr[0]}})")
    page.wait(f"{inside}.page.store.state.case === null")
    page.evaluate("document.querySelector('td a').click()")
    page.wait(chosen)
    assert list(page.faults) == []
    page.close()


def test_what_a_loop_is_given_sample_by_sample_is_not_replayed(cases: list[PageCase]) -> None:
    study = study_from_text(BASE + EVENTS + "[[events]]\ntime = 0.3\nf_g = 49.5\nover = 0.1\n")
    assert can_be_replayed(cases[0].study)
    assert not can_be_replayed(study)
    with pytest.raises(ValueError, match="cannot be replayed"):
        recorded(PageCase(label="", study=study, status="", words="", figures={}), NOTHING)
