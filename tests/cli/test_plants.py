"""``vsgdesign simulate`` with a plant, and the verbs that refuse one."""

from __future__ import annotations

import json
from pathlib import Path

import comtrade
import numpy as np
import pytest
from click.testing import CliRunner

import vsgdesign as vd
from tests.simulation.test_plants import STUDY, plant_of
from vsgdesign.report.drawing.quantities import number
from vsgdesign.report.drawing.sketch import Stroke, Words
from vsgdesign.report.page.network import network_sketch
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.study.parameters.loading import study_from_document
from vsgdesign.study.parameters.power_plant import with_path
from vsgdesign.verbs.cli.program import main
from vsgdesign.verbs.pipeline import comparison
from vsgdesign.verbs.pipeline.one_unit import as_one_converter

PLANT = "[plant]\nunits = 2\nreactance = 0.06\nresistance = 0.01\n"
LOSS = '[[events]]\ntime = "20 ms"\nelement = "unit2"\nbreaker = "open"\n'


def study_file(folder: Path, sections: str) -> Path:
    path = folder / "two.toml"
    text = STUDY.replace('duration = "20 ms"', 'duration = "60 ms"').replace('start = "cold"\n', "")
    path.write_text(text + sections, encoding="utf-8")
    return path


def test_a_plant_leaves_its_units(tmp_path: Path) -> None:
    """One unit is lost: its power ends, and the other one sees half of the grid's impedance."""
    file = study_file(tmp_path, PLANT + LOSS)
    done = CliRunner().invoke(main, ["simulate", str(file), "--out", str(tmp_path / "out"), "--comtrade", "cff"])
    assert done.exit_code == 0, done.output
    assert "modes of the whole plant at rest" in done.output
    found = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    assert set(found["units"]) == {"unit1", "unit2"}
    assert set(found["units"]["unit1"]) == {"operating_points", "gains", "promises", "controllers"}
    rests = found["controllers"]["fixed"]["rests"]
    assert [one["on_line"] for one in rests] == [["unit1", "unit2"], ["unit1"]]
    assert rests[0]["split"]["differential"]
    assert rests[1]["split"] is None
    assert found["units"]["unit2"]["operating_points"][1]["reason"] == "the breaker of unit2 is open"
    with np.load(tmp_path / "out" / "fixed.unit2.npz") as series:
        assert series["P_pcc"][0] == pytest.approx(2000.0, rel=0.02)
        assert abs(series["P_pcc"][-1]) < 1e-6
        record = comtrade.load(str(tmp_path / "out" / "fixed.unit2.cff"), use_numpy_arrays=True)
        power = record.analog[record.analog_channel_ids.index("P_pcc")]
        np.testing.assert_array_equal(power.astype(np.float32), series["P_pcc"])
        assert record.trigger_time == pytest.approx(0.02, abs=1e-9)
    with np.load(tmp_path / "out" / "fixed.unit1.npz") as kept:
        assert kept["L_g"][-1] < kept["L_g"][0]


def test_a_step_of_a_plant_settles(tmp_path: Path) -> None:
    """A step of a set point of one unit beside another one and an inverter is measured, and the run has an outcome."""
    network = """[[network.nodes]]
name = "pcc"
[[network.units]]
name = "one"
node = "pcc"
reactance = 0.06
[[network.units]]
name = "two"
node = "pcc"
reactance = 0.08
[[network.inverters]]
name = "pv"
node = "pcc"
S_rated = "2 kVA"
P_ref = "1 kW"
[[events]]
time = "0.5 s"
element = "one"
P_ref = "2.5 kW"
"""
    file = study_file(tmp_path, network)
    file.write_text(
        file.read_text(encoding="utf-8").replace('duration = "60 ms"', 'duration = "4 s"'), encoding="utf-8"
    )
    done = CliRunner().invoke(main, ["simulate", str(file), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "fixed: inverters at the end of the run" in done.output
    found = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    assert found["controllers"]["fixed"]["outcome"]["status"] == "settled"
    (rest, after) = found["controllers"]["fixed"]["rests"]
    assert after["inverters"]["pv"]["P_pcc"] == pytest.approx(1000.0, rel=0.01)
    assert rest["on_line"] == ["one", "two", "pv"]
    with np.load(tmp_path / "out" / "fixed.pv.npz") as series:
        assert series["P_pcc"][-1] == pytest.approx(1000.0, rel=0.01)
        assert {"omega", "V_rms", "delta", "v_pcc_a"} <= set(series)


def test_validate_finds_what_a_run_would_say(tmp_path: Path) -> None:
    """A plant that is unstable between its units, and one that cannot start."""
    unstable = PLANT.replace("0.06", "0.0") + "[power_loops]\nsettling_time = 0.2\n"
    done = CliRunner().invoke(main, ["validate", "--deep", str(study_file(tmp_path, unstable))])
    assert done.exit_code == 0, done.output
    assert "the units against each other" in done.output
    heavy = study_file(tmp_path, PLANT)
    heavy.write_text(heavy.read_text(encoding="utf-8").replace("scr = 3", "scr = 0.3"), encoding="utf-8")
    done = CliRunner().invoke(main, ["validate", "--deep", str(heavy)])
    assert done.exit_code != 0
    assert "no operating point" in done.output


def test_one_unit_is_one_converter(tmp_path: Path) -> None:
    """With today's keys and files."""
    file = study_file(tmp_path, PLANT.replace("units = 2", "units = 1"))
    done = CliRunner().invoke(main, ["simulate", str(file), "--out", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.output
    assert "units" not in json.loads(done.stdout)
    assert (tmp_path / "out" / "fixed.npz").exists()


def test_a_load_is_behind_the_reactance_of_one_unit(tmp_path: Path) -> None:
    """With a load at the node, one unit is not one converter with a load at its terminals."""
    plant = PLANT.replace("units = 2", "units = 1") + '[network]\nload = { P = "2 kW" }\n'
    study = load_study(study_file(tmp_path, plant))
    assert as_one_converter(study) is study
    alone = load_study(study_file(tmp_path, PLANT.replace("units = 2", "units = 1")))
    found = as_one_converter(alone)
    assert found.plant is None
    assert found.grid == alone.grid
    assert found.filter.L_2 > alone.filter.L_2
    assert found.origin is not None
    again = study_from_document(found.origin.document, found.origin)  # as the cases of comply and verify are made
    for name in ("plant", "filter", "grid", "dc", "simulation", "controllers", "events"):
        assert getattr(again, name) == getattr(found, name)


def test_the_gains_of_equal_units_are_compared_on_the_grids_that_one_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Study] = []
    monkeypatch.setattr(comparison, "report_comparison", lambda study, *_, **__: given.append(study) or {})
    monkeypatch.setattr(comparison, "compare_study", lambda study, *_, **__: given.append(study))
    file = study_file(tmp_path, PLANT + '[specification]\nscr = [3, 9]\nx_over_r = [2, 5]\nP = ["2 kW"]\n')
    done = CliRunner().invoke(main, ["compare", str(file), "--json"])
    assert done.exit_code == 0, done.output
    vd.compare(file)
    whole = load_study(file)
    for one in given:
        assert one.plant is None
        assert one.filter == with_path(whole.filter, plant_of(whole).units[0])
        assert one.grid.L_g == pytest.approx(2.0 * whole.grid.L_g, rel=1e-12)
        assert one.controllers[0].design_grid == one.grid
    assert len(given) == 2


@pytest.mark.parametrize("verb", ["size"])
def test_other_verbs_refuse_a_plant(tmp_path: Path, verb: str) -> None:
    done = CliRunner().invoke(main, [verb, str(study_file(tmp_path, PLANT)), "--out", str(tmp_path / "out")])
    assert done.exit_code != 0
    assert f"vsgdesign {verb} knows one converter on a grid, and this study has a plant of 2" in done.output


def test_a_run_of_a_plant_has_a_page(tmp_path: Path) -> None:
    """The answer, the network, the figures, both impedances, and margins of both modes."""
    axes = "[stability]\nscr = [3.0]\nx_over_r = [2.0]\nP = [2000.0]\nQ = [500.0]\n"
    file = study_file(tmp_path, PLANT + LOSS + axes)
    done = CliRunner().invoke(main, ["run", str(file), "--out", str(tmp_path / "out"), "--workers", "1"])
    assert done.exit_code == 0, done.output
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for said in (
        "The two impedances of a unit",
        "All units move together",
        "Units against each other",
        ">unit2, 2 kW<",
    ):
        assert said in page
    assert (tmp_path / "out" / "figures" / "units_fixed.svg").exists()
    found = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    (apart,) = found["margins"]["differential"]
    assert apart["real"] < 0.0
    slowest = -max(rest["modes"][0]["real"] for rest in found["controllers"]["fixed"]["rests"])
    assert slowest > 0.0, "this plant is stable, and a decay is then positive on the page"
    assert "fixed: whether it settles is not known; the slowest" in page
    assert f"the slowest decay of all rests is {number(slowest)} 1/s" in page
    assert f"the slowest mode decays with {number(slowest)} 1/s" in page
    report = ["report", str(file), "--out", str(tmp_path / "margins")]
    done = CliRunner().invoke(main, report)
    assert done.exit_code == 0, done.output
    page = (tmp_path / "margins" / "report.html").read_text(encoding="utf-8")
    assert "Units against each other" in page
    assert ">unit2, 2 kW<" in page


def test_the_drawing_of_a_network_has_everything(tmp_path: Path) -> None:
    """Every name once, the ring that a branch closes, and what begins open as a broken line."""
    network = """[[network.nodes]]
name = "pcc"
[[network.nodes]]
name = "far"
[[network.branches]]
name = "cable"
from = "pcc"
to = "far"
X_pu = 0.02
B_pu = 0.05
[[network.branches]]
name = "tie"
from = "pcc"
to = "far"
X_pu = 0.1
breaker = "open"
[[network.units]]
name = "one"
node = "far"
reactance = 0.06
[[network.loads]]
name = "works"
node = "pcc"
P = "1 kW"
[[network.inverters]]
name = "pv"
node = "far"
S_rated = "2 kVA"
P_ref = "1 kW"
"""
    sketch = network_sketch(load_study(study_file(tmp_path, network)))
    texts = [one.text for one in sketch.parts if isinstance(one, Words)]
    for name in ("pcc", "far", "one", "works", "pv", "grid", "cable", "tie"):
        assert sum(text.partition(",")[0].partition(" ")[0] == name for text in texts) == 1, name
    assert sum(bool(one.dashes) for one in sketch.parts if isinstance(one, Stroke)) == 1
    assert all(
        0.0 <= one.x <= sketch.width and 0.0 <= one.y <= sketch.height for one in sketch.parts if isinstance(one, Words)
    )


def test_what_random_cases_of_a_plant_cannot_have(tmp_path: Path) -> None:
    """Everything at once; and what only a plant has is refused for one converter."""
    more = '[verification.ramp]\nweight = 1.0\n[sensors]\nlevel = "typical"\n'
    done = CliRunner().invoke(main, ["verify", str(study_file(tmp_path, PLANT + more)), "--bridge", "pwm"])
    assert done.exit_code != 0
    for said in ("no frequency ramps", "exact sensors"):
        assert said in done.output
    done = CliRunner().invoke(main, ["verify", str(study_file(tmp_path, "[verification]\nunits_apart = 0.2\n"))])
    assert done.exit_code != 0
    assert "verification.units_apart: the study has no plant" in done.output


def test_margins_of_a_plant_have_both_modes(tmp_path: Path) -> None:
    """The units against each other, by the model of the whole plant: the worst cell at the study's own grid is its
    differential mode there."""
    file = study_file(tmp_path, PLANT)
    text = file.read_text(encoding="utf-8") + "[stability]\nscr = [3.0, 6.0]\nx_over_r = [2.0, 4.0]\nP = [2000.0]\n"
    file.write_text(text + "Q = [500.0]\n", encoding="utf-8")
    done = CliRunner().invoke(main, ["margins", str(file)])
    assert done.exit_code == 0, done.output
    assert "Units against each other" in done.output
    found = json.loads(CliRunner().invoke(main, ["margins", str(file), "--json"]).stdout)["differential"]
    assert [one["controller"] for one in found] == ["fixed"]
    done = CliRunner().invoke(main, ["simulate", str(file), "--out", str(tmp_path / "out"), "--json"])
    slowest = json.loads(done.stdout)["controllers"]["fixed"]["rests"][0]["split"]["differential"][0]
    # The droops leave the rest of the run a little beside the powers of the map.
    assert found[0]["real"] == pytest.approx(slowest["real"], rel=0.02)


def test_verbs_that_know_equal_units_alone_say_so(tmp_path: Path) -> None:
    file = study_file(tmp_path, PLANT + 'sampling = "spread"\n')
    for verb in ("margins", "certify", "design"):
        done = CliRunner().invoke(main, [verb, str(file)])
        assert done.exit_code != 0
        assert f"vsgdesign {verb} knows equal units at one node that sample together" in done.output
    loaded = study_file(tmp_path, PLANT + '[network]\nload = { P = "2 kW" }\n')
    done = CliRunner().invoke(main, ["table", "build", str(loaded), "--out", str(tmp_path / "t.json")])
    assert done.exit_code != 0
    assert "vsgdesign table build knows the units of a plant and their grid alone" in done.output
