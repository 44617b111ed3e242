"""The size verb: what it finds is enough, 5 % less is not, and both are what full simulations say."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vsgdesign as vd
from tests.cli.small_studies import failure
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns import sizing
from vsgdesign.campaigns.dc_profiles import Profile
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.report.sizing import sizing_sentences
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
    spec, link = study.controllers[0], sizing._link_of(study, sizing.Asked())
    profile = sizing.profile_of(study, spec, NOTHING, link)
    size = sizing.Size(p_max=6e3, p_charge_max=2e3, C=1.5e-3)
    run = sizing.SizedRun("", study, spec, profile)
    alone = sizing.LinkSearch(study, link, [run]).moved([size], profile)[0]
    assert alone is not None
    own = sizing.every_sample(study, replace(sizing.link_with(study, link, size), V_low=10.0))
    run = simulate(own, feed_of(own, spec, build_timeline(own), NOTHING), finds=spec)
    assert run.dc_log is not None
    lowest = run.dc_log[:, dc_columns(own).index("lowest")]
    assert np.ptp(lowest) > 5.0
    assert alone.lowest == pytest.approx(lowest[-1], abs=1e-4)


def test_a_test_that_rests_above_the_voltage_of_the_link_is_left_out(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = load_study(small)
    spec, link, V_dc = study.controllers[0], sizing._link_of(study, sizing.Asked()), study.converter.V_dc
    zero = np.zeros(3)

    def rests_at(share: float) -> Profile:
        return Profile(1e-4, zero, zero, share * V_dc, 3, 0.0)

    shares = iter((0.5, 0.999, 0.999))
    monkeypatch.setattr(sizing, "profile_of", lambda *_: rests_at(next(shares)))
    tests = (("low", study), ("high", study))
    runs, left_out = sizing._runs_of(study, spec, NOTHING, link, tests, sizing.silent)
    assert [run.name for run in runs] == ["low"]
    assert [name for name, _ in left_out] == ["high"]
    assert "2 % more than the bridge needs at rest" in left_out[0][1]
    with pytest.raises(InfeasibleStudyError, match="for any test: high: the link has to keep"):
        sizing._runs_of(study, spec, NOTHING, link, tests[1:], sizing.silent)


def test_the_runs_decide_that_are_lost_with_less(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One run of five has no rest below 5 W of charging, and is far from every limit above; the others are near one."""
    study = load_study(small)
    spec, link = study.controllers[0], sizing._link_of(study, sizing.Asked())
    profile = Profile(1e-4, np.zeros(3), np.zeros(3), 0.0, 3, 0.0)
    runs = [sizing.SizedRun(name, study, spec, profile) for name in ("a", "b", "c", "d", "charging")]

    class Search:
        def tightest(self, size: sizing.Size) -> list[sizing.SizedRun]:
            left = {"charging": 100.0 if size.p_charge_max >= 5.0 else -np.inf}
            return sorted(runs, key=lambda run: left.get(run.name, 1.0))

    def verdict(_: object, size: sizing.Size, of: sizing.SizedRun) -> sizing.Trial:
        return sizing.Trial(
            "", survived=of.name != "charging" or size.p_charge_max >= 5.0, why="", lowest_v=0.0, highest_v=0.0
        )

    monkeypatch.setattr(sizing._Full, "_verdict", verdict)
    search: Any = Search()
    size = sizing.Size(p_max=9.0, p_charge_max=5.1, C=1e-3)
    found = sizing._Full(study, NOTHING, link, runs).least("p_charge_max", size, search)
    assert 5.0 <= found.p_charge_max < 5.05


SUITE = """
title = "two"
[[tests]]
name = "jump"
scr = 6
x_over_r = 4
P_pu = 0.2
duration = "0.1 s"
events = [{ phase_jump = "-12 deg" }]
[[tests]]
name = "step"
scr = 6
x_over_r = 4
P_pu = 0.2
duration = "0.1 s"
events = [{ P_pu = 0.4 }]
"""


def test_a_suite_with_power_and_capacitor_that_are_kept(small: Path) -> None:
    """Both tests are survived with the energy that is found, and with 5 % less of it one of them is lost."""
    (small.parent / "two.toml").write_text(SUITE, encoding="utf-8")
    document = vd.size(small, suites=["two.toml"], keep={"capacitor": 2e-3, "power": 9e3}).to_dict()
    assert (document["tests"], document["left_out"]) == (["jump", "step"], [])
    assert (document["size"]["C"], document["size"]["p_max"]) == (2e-3, 9e3)
    assert document["kept"] == ["power", "capacitor"]
    assert [one["survived"] for one in document["trials"]] == [True, False]
    assert document["trials"][1]["why"].partition(":")[0] in ("jump", "step")


def test_a_battery(small: Path) -> None:
    """The study on the battery that was found is not blocked, and 5 % less of its current is too little."""
    short = TEXT.replace("0.3 s", "0.15 s").replace('[[events]]\ntime = "0.17 s"\nphase_jump = "14 deg"\n', "")
    small.write_text(short.partition("[dc]")[0], encoding="utf-8")
    document = vd.size(small, source="battery", keep={"capacitor": 1e-3}).to_dict()
    assert [one["survived"] for one in document["trials"][:2]] == [True, False]
    size, study = document["size"], load_study(small)
    V, S = study.converter.V_dc, study.converter.S_rated
    battery = {"R_i": 0.05 * V * V / S, "i_charge_max": size["p_charge_max"] / V, "charge": size["charge"]}
    battery["capacity_Ah"] = size["energy"] / (3600.0 * V)
    section = {"source": "battery", "C": size["C"], "V_low": document["least_v"] - 2e-3 * V}
    for share, blocks in ((1.0, False), (0.95 * document["least_power_w"] / size["p_max"], True)):
        own = battery | {"i_max": share * size["p_max"] / V}
        try:
            (one,) = run_scenario(study.with_changes(dc=section | {"battery": own})).controllers
            blocked = one.outcome.status == "blocked"
        except vd.VsgDesignError as error:
            blocked = "limits are" in str(error)
        assert blocked == blocks


def test_what_it_refuses(small: Path) -> None:
    assert "--capacitor" in failure(2, "size", small, "--capacitor", "2 mH")
    assert "100 nF to 100 F" in failure(2, "size", small, "--capacitor", "1 kF")
    with pytest.raises(vd.VsgDesignError, match="capacitor = nan F: must be a capacitance"):
        vd.size(small, capacitor=float("nan"))
    assert "larger" in failure(1, "size", small, "--capacitor", "1 uF")
    assert "power=…" in failure(2, "size", small, "--keep", "speed=1 W")
    assert "must be positive" in failure(2, "size", small, "--keep", "power=-1 W")
    assert failure(2, "size", small, "--keep", "capacitor=0").count("keep = ") == 1
    own = (
        TEXT.partition("[dc]")[0]
        + "[dc]\nsource = 'battery'\nC = '1 mF'\n[dc.battery]\ni_max = 9\ncapacity_Ah = 9\nR_i = 1\n"
    )
    small.write_text(own, encoding="utf-8")
    assert "no battery follows" in failure(1, "size", small, "--keep", "power=100 W")
    small.write_text(TEXT, encoding="utf-8")
    with pytest.raises(vd.VsgDesignError, match="photovoltaic: is not sized"):
        vd.size(small, source="photovoltaic")
    with pytest.raises(vd.VsgDesignError, match="nothing is left to size"):
        vd.size(small, keep={"power": 1e4, "capacitor": 1e-3, "energy": 1e3})
    small.write_text(TEXT.replace('"small"', '"small"\n[simulation.x]'), encoding="utf-8")
    assert "small.toml" in failure(2, "size", small)


def test_a_source_of_the_losses_alone_is_explained() -> None:
    """With P_ref = 0 and a capacitor that carries the events, the answer says what 31.7 W mean."""
    size = {"p_max": 31.7, "p_charge_max": 1e-7, "C": 0.2, "energy": 3e-5}
    document: dict[str, Any] = {"size": size, "trials": [{"survived": True, "lowest_v": 749.0, "highest_v": 1040.0}]}
    document |= {"controller": "closed", "source": "battery", "tests": [], "left_out": [], "suites": [], "kept": []}
    document |= {"S_rated_w": 4e5, "smallest_p_w": -1.2e5, "largest_p_w": 4.8e5}
    assert "the capacitor carries all that the events move, up to 480 kW." in sizing_sentences(document)[1]
    assert len(sizing_sentences(document | {"kept": ["power"]})) == 2
    assert len(sizing_sentences(document | {"size": size | {"p_max": 4.1e3}})) == 2
