"""Strict runs: no sine of the source and no logarithm of a schedule comes from a library."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from evidence._random_studies import bare, table_of
from tests.simulation.test_another_host import WITH_TABLE
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.codegen.vector_math import PLAIN
from vsgdesign.simulation import added_source, circuit_program, compiled_schedulers
from vsgdesign.simulation.every_sample import with_every_sample
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Study, study_from_text

EVENTS = """
events = [
    { time = 0.02, phase_jump = "20 deg" },
    { time = 0.04, V_g_pu = 0.6 },
    { time = 0.06, grid = { scr = 2.5, x_over_r = 2 } },
]
"""


def run_of(study: Study, ready: Ready) -> Simulation:
    spec = study.controllers[0]
    own = with_every_sample(study.with_limit_of(spec))
    return simulate(own, feed_of(own, spec, build_timeline(own), ready))


def test_a_strict_run_takes_no_functions_of_a_library(tmp_path: Path, monkeypatch) -> None:
    """It is the run of the study to twelve digits, says so in the study file, and its directions and the place of its
    table are those of the restricted language."""
    table_of(bare("lab_12kva_lcl"), "a", tmp_path / "table.json")
    study = study_from_text(WITH_TABLE.replace("duration = 0.1", "duration = 0.2") + EVENTS, folder=tmp_path)
    strict = study_from_text(
        (WITH_TABLE.replace("duration = 0.1", "duration = 0.2, strict = true") + EVENTS), folder=tmp_path
    )
    assert strict.simulation == study.made_strict().simulation
    ready = Ready(tables=read_tables(study))
    plain, found = run_of(study, ready), run_of(strict, ready)
    np.testing.assert_allclose(found.log, plain.log, rtol=1e-9, atol=1e-6)
    assert not np.array_equal(found.log, plain.log)  # last bits of the library
    asked: list[float] = []

    def told(angles: list[float], *, strict: bool) -> np.ndarray:
        assert strict
        asked.extend(angles)
        return np.array([(float(PLAIN["cos"](angle)), float(PLAIN["sin"](angle))) for angle in angles]).reshape(-1, 2)

    for room in (added_source, circuit_program):
        monkeypatch.setattr(room, "directions", told)
    again = run_of(strict, ready)
    np.testing.assert_array_equal(again.log, found.log)
    assert again.gain_changes == found.gain_changes
    assert len(asked) > 5


def test_directions() -> None:
    angles = [0.0, 1.0, -2.5, 400.0]
    expected = [(math.cos(angle), math.sin(angle)) for angle in angles]
    np.testing.assert_array_equal(compiled_schedulers.directions(angles, strict=False), expected)
    np.testing.assert_allclose(compiled_schedulers.directions(angles, strict=True), expected, rtol=0.0, atol=2e-16)
