"""What is wrong with a network is told with the name of its element; what a file does not have is asked for by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import vsgdesign as vd
from tests.cli.small_studies import as_json
from tests.networks.loaded import cigre, pandapower
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.study.networks.model import check_network
from vsgdesign.study.networks.pandapower_file import network_of_pandapower


def file_of(folder: Path, change: Callable[[Any], Any]) -> Path:
    net = cigre()
    change(net)
    path = folder / "net.json"
    pandapower().to_json(net, str(path))
    return path


def put(table: str, row: int, column: str, value: Any) -> Callable[[Any], Any]:
    def change(net: Any) -> None:
        net[table][column] = net[table][column].astype(object) if isinstance(value, str) else net[table][column]
        net[table].loc[row, column] = value

    return change


def opened(*lines: int) -> Callable[[Any], Any]:
    def change(net: Any) -> None:
        net.line.loc[list(lines), "in_service"] = False

    return change


REFUSED = {
    "an island": (opened(0), r"island = Bus 2, Bus 3.*: no path leads from here to a source"),
    "a negative reactance": (put("line", 3, "x_ohm_per_km", -0.7), r"line Line 4-5 = .*: its reactance is negative"),
    "a negative resistance": (put("line", 3, "r_ohm_per_km", -0.7), r"line Line 4-5 = .*: its resistance is negative"),
    "a share in place of per cent": (
        put("trafo", 0, "vk_percent", 0.2),
        r"transformer Trafo 0-1 = 0.2 %: its short-circ",
    ),
    "less than its resistance": (
        put("trafo", 0, "vk_percent", 0.12),
        r"transformer Trafo 0-1: its impedance is not a n",
    ),
    "a reactance in pu": (put("line", 1, "x_ohm_per_km", 1e-6), r"line Line 2-3 = .* Ω: √\(X/B\) is not between"),
    "a voltage in V": (put("bus", 5, "vn_kv", 20000.0), r"bus Bus 5 = 2e\+07 V: is not between"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_fault_has_the_name_of_its_element(what: str) -> None:
    change, message = REFUSED[what]
    net = cigre()
    change(net)
    with pytest.raises(StudyError, match=message):
        check_network(network_of_pandapower(net, "net.json"))


def test_all_faults_at_once(tmp_path: Path) -> None:
    def change(net: Any) -> None:
        for name in ("an island", "a negative reactance", "a voltage in V"):
            REFUSED[name][0](net)

    with pytest.raises(StudyError) as caught:
        vd.grid_of_network(file_of(tmp_path, change), "Bus 11", "5 MVA")
    assert {"island", "line Line 4-5", "bus Bus 5"} <= {fault.field for fault in caught.value.faults}
    with pytest.raises(StudyError) as caught:
        vd.grid_of_network(tmp_path / "net.json", "Bus 11", "5 MW", source=(0.0, "10 V"), frequency=-50.0)
    assert {fault.field for fault in caught.value.faults} == {"s", "source-s", "source-x-over-r", "frequency"}


def without_data(net: Any) -> None:
    net.ext_grid[["s_sc_max_mva", "s_sc_min_mva"]] = float("nan")
    pandapower().create_gen(net, 5, 1.0, name="hydro", sn_mva=2.0)
    pandapower().create_gen(net, 0, 1.0, name="second", sn_mva=0.1)


def test_what_the_file_does_not_have_is_asked_for(tmp_path: Path) -> None:
    path = file_of(tmp_path, without_data)
    with pytest.raises(StudyError) as caught:
        vd.grid_of_network(path, "Bus 11", "5 MVA")
    assert [fault.field for fault in caught.value.faults] == ["slack ext_grid 0", "machine hydro", "machine second"]
    assert [bool(fault.advice) for fault in caught.value.faults] == [True, True, False]  # once is enough
    assert "--source-s and --source-x-over-r" in str(caught.value)
    assert "--machine-x" in str(caught.value)
    given = {"source": ("5 GVA", 10.0), "machine": (0.2, 20.0)}
    whole = vd.grid_of_network(path, "Bus 11", "5 MVA", outages="none", **given)
    # 2 MVA behind 0.2 pu is 10 MVA
    named = {"ext_grid 0": ("5 GVA", 10.0), "hydro": ("10 MVA", 20.0), "second": None}
    by_name = vd.grid_of_network(path, "Bus 11", "5 MVA", outages="none", sources=named)
    assert whole.scr == pytest.approx(by_name.scr, rel=2e-3)  # 0.2 pu is X alone
    (tmp_path / "sources.csv").write_text("ext_grid 0, 5 GVA, 10\nhydro, 10 MVA, 20\nsecond, none\n", encoding="utf-8")
    asked = ("--bus", "Bus 11", "--s", "5 MVA", "--outages", "none", "--report", tmp_path / "report")
    document = as_json("grid", path, *asked, "--source", tmp_path / "sources.csv")
    assert document["scr"] == list(by_name.scr)
    nothing = {"hydro": None, "second": None}
    alone = vd.grid_of_network(path, "Bus 11", "5 MVA", outages="none", source=("5 GVA", 10.0), sources=nothing)
    assert alone.scr[0] < 0.98 * whole.scr[0]
    with pytest.raises(StudyError, match=r'source = "hydra": unknown.*Did you mean hydro'):
        vd.grid_of_network(path, "Bus 11", "5 MVA", sources={"hydra": None}, **given)


def test_a_machine_without_a_rating_is_not_helped_by_its_reactance(tmp_path: Path) -> None:
    """That is said at once, and not after the reactance is given."""

    def without_rating(net: Any) -> None:
        pandapower().create_gen(net, 5, 1.0, name="hydro")

    path = file_of(tmp_path, without_rating)
    given: tuple[dict[str, Any], ...] = ({}, {"machine": (0.2, 20.0)})
    for machine in given:
        with pytest.raises(StudyError) as caught:
            vd.grid_of_network(path, "Bus 11", "5 MVA", source=("5 GVA", 10.0), **machine)
        (fault,) = caught.value.faults
        assert fault.problem.endswith("nor its rating")
        assert fault.advice.startswith('--source "hydro = ')


def test_elements_of_one_name_are_told_apart() -> None:
    """Both would be out at once. Their names get the place in the file behind them, and buses have theirs as well."""
    net = cigre()
    net.line.loc[[12, 13], "name"] = "tie"
    net.bus.loc[[3, 4], "name"] = "busbar"
    network = network_of_pandapower(net, "net.json")
    assert {"tie (line 12)", "tie (line 13)", "Line 1-2"} <= set(network.elements)
    assert len(network.elements) == len(net.line) + len(net.trafo)
    assert network.bus("bus 4") == 4
    with pytest.raises(StudyError, match=r'bus = "busbar": 2 buses have this name. Their other names: bus 3; bus 4'):
        network.bus("busbar")


def test_names_that_are_not_there(tmp_path: Path) -> None:
    path = file_of(tmp_path, lambda _: None)
    with pytest.raises(StudyError, match='bus = "Bus 111": unknown'):
        vd.grid_of_network(path, "Bus 111", "5 MVA")
    outages = tmp_path / "outages.txt"
    outages.write_text("# two at once\nLine 13-14; Line 14-8\nLine 77\n", encoding="utf-8")
    with pytest.raises(StudyError, match='outages = "Line 77": unknown'):
        vd.grid_of_network(path, "Bus 11", "5 MVA", outages=outages)
    outages.write_text("# two at once\nLine 13-14; Line 14-8\n", encoding="utf-8")
    found = vd.grid_of_network(path, "Bus 11", "5 MVA", outages=outages)
    assert [case.name for case in found.found.cases] == ["N", "without Line 13-14 and Line 14-8"]
    with pytest.raises(StudyError, match=r"outages = .*cannot be read"):
        vd.grid_of_network(path, "Bus 11", "5 MVA", outages="n-2")


def test_a_bus_that_is_not_there_is_told() -> None:
    net = cigre()
    net.line.loc[3, "to_bus"] = 99
    with pytest.raises(StudyError, match="network: pandapower makes no matrix of it"):
        network_of_pandapower(net, "net.json")


def test_files_that_are_no_network(tmp_path: Path) -> None:
    for name, text in (("a.json", "{}"), ("b.json", "no JSON"), ("c.xiidm", "<xml/>")):
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(StudyError, match=r"no network of pandapower|cannot read it"):
            vd.grid_of_network(tmp_path / name, "Bus 1", "5 MVA")
    with pytest.raises(StudyError, match="no such file"):
        vd.grid_of_network(tmp_path / "nothing.json", "Bus 1", "5 MVA")


def test_elements_that_are_not_known_are_told(tmp_path: Path) -> None:
    def change(net: Any) -> None:
        pandapower().create_dcline(net, 3, 9, 1.0, 0.0, 0.0, 1.0, 1.0, name="link")

    with pytest.raises(StudyError, match="dcline = link: is not known here"):
        vd.grid_of_network(file_of(tmp_path, change), "Bus 11", "5 MVA")


@pytest.mark.parametrize(("library", "file"), [("pandapower", "a.json"), ("pypowsybl", "a.raw")])
def test_a_library_that_is_not_there(library: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / file).write_text("", encoding="utf-8")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == library else object())
    with pytest.raises(InfeasibleStudyError, match=rf'read by {library}, .* pip install "vsgdesign\[networks\]"'):
        vd.grid_of_network(tmp_path / file, "Bus 1", "5 MVA")
