"""Runs whose loops a host of WebAssembly executes: equal to the bit to those that this processor executes.

The loops are the strict ones, of one lane and of two, and so are the schedulers' equations. Everything around them is
the same program.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from evidence._random_studies import bare, drawn_study, table_of
from tests.codegen.wasm_host import wasm_loop
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.campaigns.verification.draws import FAMILIES, cases_of, uniforms_of
from vsgdesign.simulation import compiled_schedulers, loop
from vsgdesign.simulation.every_sample import with_every_sample
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.lanes.results import JUDGED
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Study, study_from_text

WITH_TABLE = """
base = "case:lab_12kva_lcl"
grid = { scr_basis = "impedance", scr = 5, x_over_r = 3 }
power_loops = { structure = "angle_damped", P_droop = 0.05, Q_droop = 0.5 }
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
simulation = { duration = 0.1, P_ref = 0, Q_ref = 0 }
controllers = [{ name = "a", kind = "scheduled", schedule = "table", table = "table.json" }]
"""

KEPT = loop.loop_of, compiled_schedulers._update, compiled_schedulers._beginning


@contextmanager
def another_host(lanes: int = 2) -> Iterator[None]:
    """Compiled loops go to WebAssembly; of runs side by side, a group has two vectors of ``lanes``."""
    with pytest.MonkeyPatch.context() as patch:
        for room in (loop, compiled_schedulers):
            patch.setattr(room, "compiled_loop", wasm_loop)
            patch.setattr(room, "best_lanes", lambda *_: lanes)
        for kept in KEPT:
            kept.cache_clear()
        yield
    for kept in KEPT:
        kept.cache_clear()


def run_of(study: Study) -> Simulation:
    """The run of the study's controller."""
    spec = study.controllers[0]
    own = with_every_sample(study.with_limit_of(spec))
    return simulate(own, feed_of(own, spec, build_timeline(own), Ready(tables=read_tables(study))))


@pytest.mark.parametrize("seed", [1, 2, 9])
def test_a_run_has_the_same_bits(seed: int, tmp_path: Path) -> None:
    """A converter, a controller and events that are drawn: with a table, with a closed form, with a switched bridge."""
    text = drawn_study(np.random.default_rng(seed), tmp_path, "drawn").replace("{log}", "log_interval = 0.001")
    study = study_from_text(text.replace("duration = 1.6", "duration = 0.6"), folder=tmp_path)
    ours = run_of(study)
    with another_host():
        theirs = run_of(study)
    np.testing.assert_array_equal(theirs.log, ours.log)
    assert theirs.final_state == ours.final_state
    assert theirs.gain_changes == ours.gain_changes


@pytest.mark.parametrize(("family", "lanes"), [("step", 2), ("grid", 2), ("phase", 1)])
def test_figures_and_verdicts_are_the_same(family: str, lanes: int, tmp_path: Path) -> None:
    """What is watched of a step and of a disturbance, what the scheduler of a table answers, and the verdicts."""
    table_of(bare("lab_12kva_lcl"), "a", tmp_path / "table.json")
    study = study_from_text(WITH_TABLE, folder=tmp_path)
    spec, ready = study.controllers[0], Ready(tables=read_tables(study))
    cases = cases_of(study, spec, uniforms_of(7, 0, 4), FAMILIES.index(family), ready)[0]
    ours = run_lanes(study, spec, ready, cases, strict=True)
    with another_host(lanes):
        theirs = run_lanes(study, spec, ready, cases, strict=True)
    assert (ours.status >= JUDGED).any()
    for name, values in vars(ours).items():
        np.testing.assert_array_equal(vars(theirs)[name], values, err_msg=name)
