"""The verb grid and ``vd.grid_of_network``: what they say, write and leave alone; resonance, sources and converters."""

from __future__ import annotations

import html
import json
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq

import vsgdesign as vd
from tests.cli.small_studies import call, failure, study_file
from tests.networks.loaded import cigre, pandapower
from vsgdesign.report.network import grid_sentences
from vsgdesign.study.networks.model import LINE, S_BASE, SLACK, Branch, Bus, Converter, Load, Network, Source
from vsgdesign.verbs.pipeline.grid import Asked, grid_at, grid_document


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The CIGRE network with its converters, meshed."""
    net = cigre("pv_wind")
    net.switch["closed"] = True
    path = tmp_path_factory.mktemp("network") / "meshed.json"
    pandapower().to_json(net, str(path))
    return path


def test_verb_and_function_say_the_same(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    study, base = tmp_path / "grid.toml", study_file(tmp_path, '[converter]\nS_rated = "5 MVA"\n')
    asked = ("grid", file, "--bus", "Bus 11", "--s", "5 MVA")
    result = call(*asked, "--out", study, "--base", base)
    assert (result.exit_code, result.stderr) == (0, "")
    found = vd.grid_of_network(file, "Bus 11", "5 MVA")
    said = " ".join(result.stdout.split())
    page = (tmp_path / "out" / "meshed-Bus_11" / "report.html").read_text(encoding="utf-8")
    shown = " ".join(html.unescape(re.sub(r"<[^>]*>", "", page)).replace("_", "").split())
    for sentence in found.sentences():
        assert sentence in said
        assert sentence.replace("_", "") in shown
    kept = json.loads((tmp_path / "out" / "meshed-Bus_11" / "results.json").read_text(encoding="utf-8"))
    ours = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert {name: kept[name] for name in ours} == ours
    rows = pd.read_csv(tmp_path / "out" / "meshed-Bus_11" / "cases.csv")
    np.testing.assert_allclose(rows["R [ohm]"], found.frame()["R"], rtol=1e-8)
    assert found.frame().attrs["units"]["S_sc"] == "VA"
    assert found.pictures == ("grid_plane", "grid_frequency")
    written = tomllib.loads(study.read_text(encoding="utf-8"))  # the docs read such a study and use it
    assert {name: written[name] for name in ("grid", "specification")} == found.sections()
    assert (written["base"], written["specification"]["scr_basis"]) == ("small.toml", "impedance")
    assert (written["specification"]["scr"][0], written["specification"]["x_over_r"][-1]) == pytest.approx(
        (found.scr[0], found.x_over_r[1]), rel=1e-5
    )
    assert written["grid"]["scr"] == pytest.approx(found.found.cases[0].scr, rel=1e-5)
    before = study.read_bytes()
    again = failure(2, *asked, "--out", study)
    assert "grid.toml" in again
    assert study.read_bytes() == before
    assert len(found.to_dict()["converters"]) == 9


def test_what_is_missing_and_what_is_wrong_in_words(file: Path, tmp_path: Path) -> None:
    assert "Give source-s and source-x-over-r together" in failure(
        2, "grid", file, "--bus", "Bus 1", "--s", "5 MVA", "--source-s", "1 GVA", "--report", tmp_path / "r"
    )
    assert call("grid", file, "--bus", "Bus 1", "--s", "5 MVA", "--source", "ext_grid").exit_code == 2
    asked = ("grid", file, "--bus", "Bus 1", "--s", "5 MVA", "--report", tmp_path / "r", "--out", tmp_path / "g.toml")
    assert 'S_rated = "5 kVA": SCR is asked for 5 MVA' in failure(2, *asked, "--base", "case:hoang2025_5kva")
    stiff = failure(1, *asked[:4], "--s", "5 kVA", *asked[6:])  # 200 MVA is SCR 40,000 for it
    assert re.search(r"SCR is .*e\+04 at Bus 1, and a study takes 0.05 to 10000", stiff)
    assert "no such file" in failure(2, *asked, "--base", "missing.toml")
    assert "no such case" in failure(2, *asked, "--base", "case:nothing")
    assert not (tmp_path / "r").exists()
    assert not (tmp_path / "g.toml").exists()


def small(b: float = 0.0, z: tuple[complex, complex] = (0.1j, 0.2j)) -> Network:
    """A source at bus a, a line with susceptance b to bus c, where a load and a converter are."""
    return Network(
        file="small",
        program="hand",
        buses=(Bus("a", 20e3), Bus("c", 20e3)),
        branches=(
            Branch(name="l", kind=LINE, ends=(0, 1), r=0.02, x=0.1, y_1=0.5j * b, y_2=0.5j * b),
            Branch(name="m", kind=LINE, ends=(0, 1), r=0.02, x=0.1),
        ),
        sources=(Source("grid", 0, SLACK, z),),
        converters=(Converter("pv", 0, 1e6), Converter("wind", 1, 2e6)),
        loads=(Load("town", 1, 0.3 + 0.1j),),
    )


def test_the_first_resonance_is_that_of_the_circuit() -> None:
    b, f_n = 0.08, 50.0
    found = grid_at(small(b), Asked(bus="c", S=10e6))

    def reactance(f_hz: float) -> float:
        """Of source and capacitance at a, two lines side by side, and capacitance at c."""
        h = f_hz / f_n
        at_a = 1.0 / (1.0 / (0.2j * h) + 0.5j * b * h)
        return (1.0 / (0.5j * b * h + 1.0 / (complex(0.01, 0.05 * h) + at_a))).imag

    assert found.resonance_hz == pytest.approx(brentq(reactance, 200.0, 500.0), abs=0.01)
    assert found.f_hz[-1] == 2000.0
    assert grid_at(small(0.0), Asked(bus="c", S=10e6)).resonance_hz is None


def test_an_outage_is_named_where_it_matters() -> None:
    """Beside a line of no importance to the bus, no outage is the weakest case of anything."""
    found = grid_at(small(z=(0.2j, 0.2j)), Asked(bus="a", S=10e6))
    assert "; none makes the bus weaker by 1 %." in grid_sentences(grid_document(found))[1]
    found = grid_at(small(z=(0.2j, 0.2j)), Asked(bus="c", S=10e6))
    assert "; the weakest case is without l." in grid_sentences(grid_document(found))[1]


def test_both_ends_of_a_source_are_in_the_box() -> None:
    found = grid_at(small(), Asked(bus="c", S=10e6))
    assert [case.name for case in found.cases[:2]] == ["N, weak sources", "N, strong sources"]
    lines = {1: complex(0.02, 0.1), 2: complex(0.01, 0.05)}
    for case in found.cases:
        z = (0.1j if case.strong else 0.2j) + lines[1 if case.out else 2]
        assert case.Z_pu == pytest.approx(z, rel=1e-12)
        assert case.scr == pytest.approx(S_BASE / abs(z) / 10e6, rel=1e-12)
    assert found.scr == (min(case.scr for case in found.cases), max(case.scr for case in found.cases))


def test_converters_and_loads() -> None:
    """At a the converter sees the divider of source and line; a load is a shunt at its rated voltage."""
    found = grid_at(small(), Asked(bus="c", S=10e6))
    z = 0.2j
    assert [(one.name, one.share) for one in found.near] == [
        ("wind", 1.0),
        ("pv", pytest.approx(abs(z / (z + complex(0.01, 0.05))), rel=1e-12)),
    ]
    loaded = grid_at(small(), Asked(bus="c", S=10e6, loads=True, outages="none")).cases[0]
    assert loaded.Z_pu == pytest.approx(1.0 / (0.3 - 0.1j + 1.0 / (z + complex(0.01, 0.05))), rel=1e-12)
    assert math.isclose(loaded.x_over_r, (loaded.Z_pu or 1j).imag / (loaded.Z_pu or 1j).real)
