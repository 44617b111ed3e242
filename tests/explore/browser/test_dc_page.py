"""A page without a server of a study whose dc link has a source: every bit of the strict run of the same study, its
figures and its words, at the study's state of charge and at others."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evidence.page_runs import bits_of, opened
from tests.explore.browser.chromium import Chromium
from tests.explore.dc_studies import SOURCES, STUDY
from vsgdesign.artifacts.ready import NOTHING as NO_TABLES
from vsgdesign.report.explore.dc_side import WORDS as DC_WORDS
from vsgdesign.report.explore.live import NOTHING, emt_answer, simulated
from vsgdesign.report.explore.page_file import write_page
from vsgdesign.report.explore.scene import scene_of, study_of
from vsgdesign.report.explore.session import Session
from vsgdesign.study.parameters import study_from_text

STEP, SAG = {"kind": "step", "size": 0.1, "signal": "P"}, {"kind": "sag", "size": 0.4, "length_s": 0.15}
PHASE, RAMP = {"kind": "phase", "size": 20.0}, {"kind": "ramp", "size": -0.5, "length_s": 0.15}
RUNS: dict[str, tuple[tuple[dict[str, Any], int, str | None, str], ...]] = {
    "battery": (
        (STEP, 0, None, "settled"),
        (STEP, 1, "35 %", "settled"),
        (SAG, 0, "2 %", "survived"),
        ({"kind": "grid", "size": 0.0}, 1, None, "survived"),
        (RAMP, 1, "90 %", "survived"),
        (PHASE | {"size": 60.0}, 0, "100 %", "blocked"),
    ),
    "converter": (
        (STEP, 1, "80 %", "settled"),
        (PHASE, 0, None, "survived"),
        (STEP | {"size": 0.6}, 0, None, "blocked"),
    ),
    "photovoltaic": ((STEP, 0, None, "settled"), (PHASE | {"size": -20.0}, 1, None, "survived")),
    "clamped": ((STEP, 0, None, "settled"), (PHASE, 0, "35 %", "survived")),
}
"""Event, controller, state of charge, and what becomes of it."""


@pytest.mark.parametrize("source", SOURCES)
def test_a_dc_link_has_the_bits_of_the_package(browser: Chromium, tmp_path: Path, source: str) -> None:
    """Every number of every sample, of the link as well, is that of `simulate`; a ramp is equal to ten digits, as with
    an ideal link. The rest after an event is one that the source can give."""
    session = Session(study_from_text(STUDY.format(dc=SOURCES[source])), NO_TABLES)
    link = session.study.dc
    assert link is not None
    path = tmp_path / "page.html"
    write_page(session, path, lattice=(3, 1))
    page = browser.page()
    scr, (ratio,) = opened(page, path)
    for event, k, charge, expected in RUNS[source]:
        changes = {} if charge is None else {f"dc.{link.source}.charge": charge}
        to = {"to_scr": scr[2], "to_x_over_r": ratio} if event["kind"] == "grid" else {}
        state = session.state({"scr": scr[1], "x_over_r": ratio, "event": event | to, "changes": changes})
        own = session.study_of(state)
        run = simulated(study_of(scene_of(own, NO_TABLES, state), NO_TABLES, state, k).made_strict(), NO_TABLES)
        asked = event | {"jump": math.radians(event["size"])} | ({"key": "2"} if to else {})
        asked |= {} if charge is None else {"charge": float(charge.split()[0]) * 0.01}
        ours = page.evaluate(f"judged({k}, '1', {json.dumps(asked)})")
        near = event["kind"] == "ramp"
        assert run.dc_log is not None
        assert ours["done"] == len(run.log), (source, event)
        assert near or ours["bits"] == bits_of(np.hstack([run.log, run.dc_log])), (source, event)
        answer = emt_answer(own, NO_TABLES, state, places=[k])
        assert answer is not None
        theirs, row = answer.header["controllers"][0], ours["row"]
        assert (row["status"], row["verdict"]) == (theirs["status"], theirs["verdict"])
        assert row["status"] == expected
        figures = {figure: theirs[figure] for figure in NOTHING}
        assert {figure: row[figure] for figure in NOTHING} == pytest.approx(figures, abs=1e-6 if near else 1e-9)
    if source == "battery":
        saved = page.evaluate(SAVED)
        study = study_from_text(saved["toml"])
        assert study.dc is not None
        assert (study.dc.values["charge"], study.dc.V_high) == (35 * 0.01, link.V_high)
        told = page.evaluate(TOLD)
        assert told["verdict"] == told["why"] == DC_WORDS["no_charge"].replace("{:.3g}", "0")
    assert list(page.faults) == []
    page.close()


SAVED = """(() => {
  page.store.write("dc.battery.charge", "35 %");
  return page.ask("save", 0, page.store.state).then((reply) => reply.answer);
})()"""
TOLD = """(() => {
  page.store.write("dc.battery.charge", "0 %");
  return page.ask("emt", 0, page.store.state).then((reply) => reply.answer.header.controllers[0]);
})()"""
