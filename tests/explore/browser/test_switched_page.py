"""A page without a server whose bridge switches: every bit of the strict run of the study that it saves, its figures
and its words."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from evidence.page_runs import bits_of, opened
from tests.explore.browser.chromium import Chromium
from tests.explore.test_page_runs import session_in
from vsgdesign.report.explore.live import NOTHING, emt_answer, simulated
from vsgdesign.report.explore.page_file import OF_BRIDGE, write_page
from vsgdesign.report.explore.page_runs import WORDS
from vsgdesign.report.explore.scene import scene_of, study_of
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
    """Every number of every sample is that of `simulate` with the study that the page saves, which is strict, and it is
    judged by the rest to which the bridge itself comes. A ramp is equal to ten digits, as with an averaged bridge."""
    session = session_in(tmp_path, "pwm")
    path = tmp_path / "page.html"
    write_page(session, path, lattice=(3, 1))
    page = browser.page()
    scr, (ratio,) = opened(page, path)
    names = [one.name for one in session.study.controllers]
    for event, name in RUNS:
        k, to = names.index(name), {"to_scr": scr[2], "to_x_over_r": ratio} if event["kind"] == "grid" else {}
        state = session.state({"scr": scr[1], "x_over_r": ratio, "event": event | to})
        own = study_of(scene_of(session.study_of(state), session.ready, state), session.ready, state, k)
        assert own.simulation.bridge == "pwm"
        log = simulated(own.made_strict(), session.ready).log
        asked = event | {"jump": math.radians(event["size"])} | ({"key": "2"} if to else {})
        ours = page.evaluate(f"judged({k}, '1', {json.dumps(asked)})")
        near = event["kind"] == "ramp"
        assert ours["done"] == len(log), (event, name)
        assert near or ours["bits"] == bits_of(log), (event, name)
        answer = emt_answer(session.study, session.ready, state, places=[k])
        assert answer is not None
        theirs, row = answer.header["controllers"][0], ours["row"]
        assert (row["status"], row["verdict"]) == (theirs["status"], theirs["verdict"])
        assert row["status"] in ("settled", "survived")
        expected = {figure: theirs[figure] for figure in NOTHING}
        assert {figure: row[figure] for figure in NOTHING} == pytest.approx(expected, abs=1e-6 if near else 1e-9)
    info, carrier = page.evaluate("[STATIC.info, STATIC.runs.info.carrier]")
    assert info["made"].endswith(OF_BRIDGE["pwm"])
    assert "survived" not in [one["name"] for one in info["figures"]]
    assert len(carrier["bodies"]) == session.study.converter.samples_per_carrier
    refused = page.evaluate("page.ask('map', 0, {...page.store.state, figure: 'survived'})")
    assert [one["text"] for one in refused["faults"]] == [WORDS["no_figure"]]
    toml = page.evaluate("page.ask('save', 0, page.store.state).then((reply) => reply.answer.toml)")
    saved = study_from_text(toml, folder=tmp_path).simulation
    assert (saved.bridge, saved.strict) == ("pwm", True)
    assert list(page.faults) == []
    page.close()
