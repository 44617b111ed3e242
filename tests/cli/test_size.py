"""The size verb: what it finds is enough, 5 % less is not, and both are what full simulations say."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vsgdesign as vd
from tests.cli.small_studies import failure
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns import sizing
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import simulate
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import load_study

TEXT = """
base = "case:hoang2025_5kva"
[study]
name = "small"
[converter]
current_limit_pu = 1.2
[grid]
scr = 6
x_over_r = 4
[simulation]
duration = "0.3 s"
P_ref = "1 kW"
Q_ref = 0
[[controllers]]
name = "fixed"
kind = "fixed"
[[events]]
time = "0.05 s"
phase_jump = "-12 deg"
[[events]]
time = "0.17 s"
phase_jump = "14 deg"
[dc]
source = "converter"
C = "2 mF"
R_bleed = "40 kohm"
[dc.converter]
p_max = "9 kW"
tau = "8 ms"
"""


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sizing, "TRADE_OFF", (1.0, sizing.MORE_POWER))
    path = tmp_path / "small.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_sizes_are_enough_and_less_is_not(small: Path) -> None:
    found = vd.size(small)
    assert found
    document = json.loads((found.folder / "results.json").read_text(encoding="utf-8"))
    assert found.to_dict()["size"] == document["size"]
    assert found.pictures == ("dc_side",)
    assert "needs a source of" in found.sentences()[0]
    assert [one["survived"] for one in document["trials"]] == [True, False, False, False]
    size = document["size"]
    # By the run of the study itself, through another door.
    study = vd.load(str(small)).with_changes(
        dc={"V_low": document["least_v"] - 2e-3 * 800.0, "C": size["C"], "converter": {
            name: size[name] for name in ("p_max", "p_charge_max", "energy", "charge")
        }}
    )  # fmt: skip
    (controller,) = run_scenario(study).controllers
    assert controller.outcome.status != "blocked"
    assert controller.dc is not None
    assert controller.dc.lowest_v == pytest.approx(document["trials"][0]["lowest_v"], abs=1e-6)
    curve = [C for _, C in document["trade_off"] if C is not None]
    assert all(b <= a * 1.02 for a, b in itertools.pairwise(curve))
    page = (found.folder / "report.html").read_text(encoding="utf-8")
    assert "fixed needs a source of" in page
    assert "5 % less capacitor" in page


def test_the_equation_of_the_link_alone_is_that_of_the_whole_run(small: Path) -> None:
    study = load_study(small)
    spec, link = study.controllers[0], sizing._link_of(study, None)
    profile = sizing.profile_of(study, spec, NOTHING, link)
    size = sizing.Size(p_max=6e3, p_charge_max=2e3, C=1.5e-3)
    alone = sizing._Search(study, link, profile).moved([size])[0]
    assert alone is not None
    own = sizing._every_sample(study, replace(sizing.link_with(study, link, size), V_low=10.0))
    run = simulate(own, feed_of(own, spec, build_timeline(own), NOTHING), finds=spec)
    assert run.dc_log is not None
    lowest = run.dc_log[:, dc_columns(own).index("lowest")]
    assert np.ptp(lowest) > 5.0
    assert alone.lowest == pytest.approx(lowest[-1], abs=1e-4)


def test_what_it_refuses(small: Path) -> None:
    assert "--capacitor" in failure(2, "size", small, "--capacitor", "2 mH")
    assert "100 nF to 100 F" in failure(2, "size", small, "--capacitor", "1 kF")
    with pytest.raises(vd.VsgDesignError, match="capacitor = nan F: must be a capacitance"):
        vd.size(small, capacitor=float("nan"))
    assert "larger" in failure(1, "size", small, "--capacitor", "1 uF")
    small.write_text(TEXT.replace('"small"', '"small"\n[simulation.x]'), encoding="utf-8")
    assert "small.toml" in failure(2, "size", small)
