"""A page without a server whose bridge switches: every bit of the strict run of the study that it saves."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from tests.explore.browser.chromium import Chromium
from tests.explore.browser.test_static_page import ENGINE
from tests.explore.test_page_runs import session_in
from vsgdesign.report.explore.events import study_of
from vsgdesign.report.explore.live import simulated
from vsgdesign.report.explore.page_file import OF_BRIDGE, joined_modules, write_page
from vsgdesign.report.explore.page_runs import WORDS
from vsgdesign.report.explore.scene import scene_of
from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.words import TEMPLATES
from vsgdesign.study.parameters import study_from_text

RUNS = (
    ({"kind": "step", "size": 0.1, "signal": "P"}, "fixed"),
    ({"kind": "voltage_set_point", "size": 0.03}, "table"),
    ({"kind": "sag", "size": 0.4, "length_s": 0.15}, "listed"),
    ({"kind": "grid", "size": 0.0}, "followed"),
    ({"kind": "grid", "size": 0.0}, "listed"),
    ({"kind": "phase", "size": 20.0}, "table"),
    ({"kind": "ramp", "size": -0.5, "length_s": 0.15}, "followed"),
)


def test_a_switched_bridge_has_the_bits_of_the_package(browser: Chromium, tmp_path: Path) -> None:
    """Every number of every sample is that of `simulate` with the study that the page saves, which is strict. A ramp is
    equal to ten digits, as with an averaged bridge."""
    session = session_in(tmp_path, "pwm")
    path = tmp_path / "page.html"
    write_page(session, path, lattice=(3, 1))
    page = browser.page()
    page.goto(path.as_uri())
    page.wait("window.page && page.answers.emt")
    page.evaluate(f"(0, eval)({json.dumps(joined_modules(PAGE, 'engine.js') + ENGINE)})")
    page.wait("Boolean(window.engine)")
    lattice = page.evaluate("STATIC.info.lattice")
    scr, ratio = lattice["scr"], lattice["x_over_r"][0]
    names = [one.name for one in session.study.controllers]
    for event, name in RUNS:
        k, to = names.index(name), {"to_scr": scr[2], "to_x_over_r": ratio} if event["kind"] == "grid" else {}
        state = session.state({"scr": scr[1], "x_over_r": ratio, "event": event | to})
        own = study_of(scene_of(session.study_of(state), session.ready, state), session.ready, state, k)
        assert own.simulation.bridge == "pwm"
        log = np.ascontiguousarray(simulated(own.made_strict(), session.ready).log)
        asked = event | {"jump": math.radians(event["size"])} | ({"key": "2"} if to else {})
        count, sum_of_bits, *most = page.evaluate(f"bits({k}, '1', {json.dumps(asked)})")
        assert count == len(log), (event, name)
        np.testing.assert_allclose(most, np.abs(log).max(axis=0), rtol=1e-9)
        near = event["kind"] == "ramp"
        assert near or sum_of_bits == str(int(log.view(np.uint64).sum(dtype=np.uint64))), (event, name)
    info, carrier = page.evaluate("[STATIC.info, STATIC.runs.info.carrier]")
    assert info["made"].endswith(OF_BRIDGE["pwm"])
    assert "survived" not in [one["name"] for one in info["figures"]]
    assert len(carrier["bodies"]) == session.study.converter.samples_per_carrier
    rows = page.evaluate("page.answers.emt.header.controllers.map(({status, why, peak_pu}) => [status, why, peak_pu])")
    assert [one[:2] for one in rows] == [["not known", TEMPLATES["switched"]]] * len(names)
    assert all(0.3 < one[2] < 1.5 for one in rows)
    refused = page.evaluate("page.ask('map', 0, {...page.store.state, figure: 'survived'})")
    assert [one["text"] for one in refused["faults"]] == [WORDS["no_figure"]]
    toml = page.evaluate("page.ask('save', 0, page.store.state).then((reply) => reply.answer.toml)")
    saved = study_from_text(toml, folder=tmp_path).simulation
    assert (saved.bridge, saved.strict) == ("pwm", True)
    assert list(page.faults) == []
    page.close()
