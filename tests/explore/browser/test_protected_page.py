"""A page without a server of a study with a protection: its verdicts are those of the explorer."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tests.explore.browser.chromium import Chromium
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.report.explore.live import emt_answer
from vsgdesign.report.explore.page_file import joined_modules, write_page
from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.session import Session
from vsgdesign.study.parameters import study_from_text

STUDY = """
base = "case:lab_12kva_lcl"
grid = {{ scr_basis = "impedance", scr = 5, x_over_r = 3 }}
simulation = {{ duration = 1.0, P_ref = "4 kW", Q_ref = 0 }}
power_loops = {{ structure = "angle_damped", P_droop = 0.05, Q_droop = 0.5 }}
survival = {{ protection = {{ {} }} }}
[[controllers]]
name = "followed"
kind = "scheduled"
"""
EVENTS = (
    {"kind": "sag", "size": 0.4, "length_s": 0.15},
    {"kind": "sag", "size": 0.4, "length_s": 0.4},
    {"kind": "phase", "size": 30.0},
    {"kind": "ramp", "size": -0.6, "length_s": 0.3},
    {"kind": "voltage_set_point", "size": 0.08},
)
LIMITS = {
    "V_low_pu = 0.9, V_low_time = 0.15, V_high_pu = 1.035, V_high_time = 1.0": ["sag of 0.4 s", "voltage_set_point"],
    "rocof = 1.2, rocof_window = 0.1": ["sag of 0.15 s", "sag of 0.4 s", "phase", "ramp of 0.3 s"],
}
"""Limits, and the events that trip it."""
ENGINE = """
const unpacked = Uint8Array.from(atob(STATIC.runs.data), (c) => c.charCodeAt(0));
const inflated = new Blob([unpacked]).stream().pipeThrough(new DecompressionStream("deflate"));
new Response(inflated).arrayBuffer().then((data) => {
  const engine = new module_engine_js.Engine(STATIC.runs.info, new Uint8Array(data));
  const judge = new module_verdict_js.Judge(engine);
  window.judged = (key, event) => judge.judged(engine.run(engine.controller(0, key), key, event).run);
});
"""


@pytest.mark.parametrize("limits", LIMITS)
def test_a_protection_trips_as_in_the_explorer(browser: Chromium, tmp_path: Path, limits: str) -> None:
    session = Session(study_from_text(STUDY.format(limits)), NOTHING)
    path = tmp_path / "page.html"
    write_page(session, path, lattice=(2, 1))
    page = browser.page()
    page.goto(path.as_uri())
    page.wait("window.page && page.answers.emt")
    code = "".join(joined_modules(PAGE, name) for name in ("engine.js", "verdict.js")) + ENGINE
    page.evaluate(f"(0, eval)({json.dumps(code)})")
    page.wait("Boolean(window.judged)")
    found = []
    for event in EVENTS:
        state = session.state({"scr": 5.0, "x_over_r": 3.0, "event": event})
        answer = emt_answer(session.study_of(state), NOTHING, state)
        assert answer is not None
        theirs = answer.header["controllers"][0]
        key = "String(page.file.snap({scr: 5, x_over_r: 3}).cell)"
        ours = page.evaluate(f"judged({key}, {json.dumps(event | {'jump': math.radians(event['size'])})})")
        assert (ours["status"], ours["verdict"]) == (theirs["status"], theirs["verdict"])
        assert ours["peak_pu"] == pytest.approx(theirs["peak_pu"], abs=1e-9 if event["kind"] != "ramp" else 1e-4)
        assert ours["status"] in ("survived", "tripped")
        length = f" of {event['length_s']} s" if "length_s" in event else ""
        found += [f"{event['kind']}{length}"] if ours["status"] == "tripped" else []
    assert found == LIMITS[limits]
    toml = page.evaluate("page.ask('save', 0, page.store.state).then((reply) => reply.answer.toml)")
    assert study_from_text(toml).protection == session.study.protection
    assert list(page.faults) == []
    page.close()
