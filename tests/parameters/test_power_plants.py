"""The section [plant] and the lists of [network]: what they become, and every fault with its name."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.parameters.documents import build, case_document, faults_of
from vsgdesign.study.parameters.power_plant import Element, PowerPlant

UNIT = {"name": "one", "node": "pcc", "reactance": 0.05}


def study_document() -> dict[str, Any]:
    """The published case with an averaged bridge."""
    found = case_document()
    return found | {"simulation": found["simulation"] | {"bridge": "averaged"}}


def plant_of(document: dict[str, Any]) -> PowerPlant:
    found = build(document).plant
    assert found is not None
    return found


def network(**lists: list[dict[str, Any]]) -> dict[str, Any]:
    """A document with these lists, a node and a unit."""
    given = {"nodes": [{"name": "pcc"}], "units": [UNIT]} | lists
    return study_document() | {"network": given}


def faults(document: dict[str, Any]) -> str:
    return "\n".join(map(str, faults_of(document)))


def test_a_study_without_it_has_no_plant() -> None:
    assert build(study_document()).plant is None


def test_the_short_form() -> None:
    """Four units: the grid is that of four times the rating, and x_t is per unit of one unit."""
    alone, study = build(study_document()), build(study_document() | {"plant": {"units": 4, "reactance": 0.06}})
    plant = study.plant
    assert plant is not None
    assert study.grid.L_g == pytest.approx(alone.grid.L_g / 4.0, rel=1e-12)
    assert [unit.name for unit in plant.units] == ["unit1", "unit2", "unit3", "unit4"]
    assert plant.units[0].L * study.converter.omega_n == pytest.approx(0.06 * study.converter.Z_base, rel=1e-12)
    assert plant.equal
    spread = plant_of(study_document() | {"plant": {"units": 4, "sampling": "spread"}})
    assert spread.units[3].offset == pytest.approx(0.75 * study.converter.T_s)
    assert not spread.equal


def test_a_network_becomes_elements() -> None:
    document = network(
        nodes=[{"name": "pcc"}, {"name": "far"}],
        branches=[
            {"name": "cable", "from": "pcc", "to": "far", "R": 0.1, "L": 1e-3, "C": 2e-6},
            {"name": "step", "from": "pcc", "to": "far", "X_pu": 0.06, "S_rated": 20e3, "breaker": "open"},
        ],
        shunts=[{"name": "trap", "node": "far", "R": 1.0, "L": 1e-3, "C": 1e-5}],
        loads=[{"name": "heater", "node": "far", "P_pu": 0.5}],
    )
    plant, c = plant_of(document), build(document).converter
    found = {one.name: one for one in plant.elements}
    assert found["cable"] == Element("cable", "cable", "pcc", "far", 0.1, 1e-3)
    assert found["cable.far"] == Element("cable.far", "cable", "far", "", C=1e-6)
    assert found["step"].L * c.omega_n == pytest.approx(0.06 * 3.0 * c.V_rated_rms**2 / 20e3, rel=1e-12)
    assert found["trap"] == Element("trap", "trap", "far", "", 1.0, 1e-3, 1e-5)
    assert pytest.approx(2.0 * c.Z_base) == found["heater.R"].R
    assert plant.opened == {"step"}
    assert plant.names["heater"] == "element"
    assert plant.names["far"] == "node"


def test_a_case_of_a_unit() -> None:
    own = study_document() | {"filter": study_document()["filter"] | {"L_1": "3 mH"}}
    fixed = [
        {"name": "seen", "kind": "fixed"},
        {"name": "named", "kind": "fixed", "design_grid": {"scr": 4, "x_over_r": 3}},
    ]
    units = [UNIT, {"name": "other", "node": "pcc", "case": own}]
    plant = plant_of(network(units=units) | {"controllers": fixed})
    case = plant.unit("other").case
    assert case is not None
    assert pytest.approx(3e-3) == case.filter.L_1
    assert plant.unit("one").case is None
    assert [one.design_grid is None for one in case.controllers] == [True, False]  # None: what the unit sees


def test_everything_wrong_is_told_at_once_with_its_name() -> None:
    other = study_document() | {"converter": study_document()["converter"] | {"f_n": "60 Hz"}}
    found = faults(
        network(
            nodes=[{"name": "pcc"}, {"name": "b"}, {"name": "lost"}],
            branches=[{"name": "line", "from": "pcc", "to": "b"}, {"name": "loop", "from": "b", "to": "b", "R": 1.0}],
            sources=[{"name": "s1", "node": "b"}, {"name": "s2", "node": "b"}],
            loads=[{"name": "nothing", "node": "b"}],
            units=[
                {"name": "one", "node": "pcc", "reactance": -0.1},
                {"name": "far", "node": "bb"},
                {"name": "sixty", "node": "pcc", "case": other},
                {"name": "one", "node": "pcc"},
            ],
        )
    )
    for words in (
        'network.nodes[2].name = "lost": no branch leads from it to a unit or a source',
        "s1, s2 make a loop of sources at node b",
        "branch line has no impedance",
        "is the node at which it begins",
        "load nothing takes no power",
        'network.units["one"].reactance = -0.1: outside 0 to 10',
        'network.units["far"].node = "bb": is no node. Did you mean b?',
        "unit sixty is made for 60 Hz, and the network has 50 Hz",
        'name = "one": used twice',
    ):
        assert words in found, words


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"plant": {"units": 0}}, "plant.units = 0: must be a whole number from 1 to 32"),
        ({"plant": {"units": 2, "reactance": -0.01}}, "plant.reactance = -0.01: outside 0 to 10"),
        ({"plant": {"units": 2}, "network": {"units": [UNIT]}}, "plant: network.units describe a plant, too"),
        ({"network": {"units": [UNIT]}}, 'network.pcc = "pcc": is no node'),
        ({"network": {"nodes": [{"name": "pcc"}]}}, "network.units = 0: a plant has 1 to 32 units"),
    ],
)
def test_faults_of_a_plant(document: dict[str, Any], words: str) -> None:
    assert words in faults(study_document() | document)


def event(**fields: Any) -> str:
    """The faults of an event of a plant of two."""
    plant = {"plant": {"units": 2, "reactance": 0.06}, "events": [{"time": 1.0} | fields]}
    return faults(study_document() | plant)


def test_faults_of_its_events() -> None:
    assert 'element = "unit3": the plant has none of this name. Did you mean unit2?' in event(
        element="unit3", breaker="open"
    )
    assert "pcc is a node, which has no breaker that an event may change" in event(element="pcc", breaker="open")
    assert "unit1 is a unit, which has no fault that an event may change" in event(element="unit1", fault={"R": 1.0})
    assert "changes nothing" in event(element="unit1")
    source = {"name": "mill", "node": "pcc", "X_pu": 0.1}
    ramp = {"events": [{"time": 1.0, "f_g": "50.5 Hz", "over": 0.1}]}
    assert "the frequency is that of the sources mill, too" in faults(network(sources=[source]) | ramp)
    alone = study_document() | {"events": [{"time": 1.0, "element": "unit1", "breaker": "open"}]}
    assert "there is no plant" in faults(alone)


def test_an_event_names_its_element() -> None:
    plant = {"plant": {"units": 2}, "events": [{"time": 1.0, "element": "unit2", "breaker": "open"}]}
    (one,) = build(study_document() | plant).events
    assert (one.element, one.name) == ("unit2", "unit2: breaker opens")
    assert one.document(build(study_document()).converter)["element"] == "unit2"
    assert math.isclose(one.t_s, 1.0)


def test_inverters_and_loads_of_constant_power() -> None:
    document = network(
        inverters=[{"name": "pv", "node": "pcc", "S_rated": "2 kVA", "P_ref": "1 kW", "pll_bandwidth": "50 Hz"}],
        loads=[{"name": "drive", "node": "pcc", "kind": "constant_power", "P": "1 kW", "Q": "0.5 kvar"}],
    )
    plant, c = plant_of(document), build(document).converter
    pv, drive = plant.inverters
    assert (pv.name, pv.asked, drive.name) == ("pv", (1000.0, 0.0), "drive")
    assert drive.asked == pytest.approx((-1000.0, -500.0), rel=1e-12)
    assert drive.S_rated == pytest.approx(1.25 * math.hypot(1000.0, 500.0), rel=1e-12)
    assert pv.filter.L_1 * c.omega_n == pytest.approx(0.1 * 3.0 * c.V_rated_rms**2 / 2000.0, rel=1e-12)
    assert plant.elements == ()
    assert plant.names["pv"] == plant.names["drive"] == "inverter"


def test_what_is_wrong_with_inverters_is_told_with_their_names() -> None:
    found = faults(
        network(
            inverters=[
                {"name": "pv", "node": "pcc", "P_ref": "9 kW", "S_rated": "5 kVA"},
                {"name": "slow", "node": "pcc", "f_s": "10 Hz", "reactance": -0.1},
                {"name": "other", "node": "pcc", "kind": "grid_leading", "f_n": "60 Hz"},
                {"name": "one", "node": "nowhere"},
            ],
            loads=[
                {"name": "drive", "node": "pcc", "kind": "constant_power", "R_pu": 1.0},
                {"name": "heater", "node": "pcc", "P_pu": 0.1, "pll_bandwidth": "50 Hz"},
                {"name": "small", "node": "pcc", "kind": "constant_power", "P": "2 kW", "S_rated": "1 kVA"},
            ],
        )
        | {"events": [{"time": 1.0, "element": "pv", "V_ref_pu": 1.02}]}
    )
    for words in (
        'network.inverters["pv"].P_ref = "9000 W": P_ref and Q_ref are 1.8 times its rating',
        'network.inverters["slow"].f_s = "10 Hz"',
        'network.inverters["slow"].reactance = -0.1: outside 0 to 10',
        'network.inverters["other"].kind = "grid_leading": must be one of "grid_following"',
        'network.inverters["other"].f_n: unknown field',
        'network.inverters["one"].node = "nowhere": is no node',
        'name = "one": used twice',
        'network.loads["drive"].R_pu: a load of constant power has no impedance',
        'network.loads["heater"].pll_bandwidth = "50 Hz": is of a load that samples',
        'network.loads["small"].S_rated = "1000 VA": the load takes 2000 VA',
        "pv is an inverter, which has no V_ref_pu",
    ):
        assert words in found, words


def test_a_range_of_units() -> None:
    """The grid is that of all units. The table of a unit is made for what it sees with any number of them on line, and
    for the differential mode, which settles as the steps do."""
    asked = {"specification": {"scr": [1.5, 5.0, 20.0], "settling_time": 1.3}}
    alone, study = (
        build(study_document() | asked | {"plant": {"units": units, "reactance": 0.06}}) for units in (4, [1, 4])
    )
    plant, found, four = study.plant, study.specification, alone.specification
    assert plant is not None
    assert found is not None
    assert four is not None
    assert (len(plant.units), plant.least) == (4, 1)
    assert study.grid == alone.grid
    assert four.scr == (1.5, 5.0, 20.0)
    assert found.scr == pytest.approx((1.5, 5.0, 20.0, 40.0, 80.0))
    assert found.differential_decay == pytest.approx(3.9 / 1.3)
    given = asked["specification"] | {"differential_decay": 0.5}
    own = build(study_document() | {"specification": given, "plant": {"units": 2, "reactance": 0.06}})
    assert own.specification is not None
    assert own.specification.differential_decay == 0.5
    one = build(study_document() | asked | {"plant": {"units": 1, "reactance": 0.06}}).specification
    assert one is not None
    assert one.differential_decay == 0.0


@pytest.mark.parametrize("units", [[4, 1], [0, 4], [1, 2, 4], [1.5, 4], [1, 40], []])
def test_faults_of_a_range_of_units(units: list[Any]) -> None:
    words = f"plant.units = {units}: must be two whole numbers from 1 to 32 that increase. For example units = [1, 4]"
    assert words in faults(study_document() | {"plant": {"units": units}})


def test_a_source_of_a_plant_may_be_dirty() -> None:
    """Components, sags and a background are read; what a plant does not have is told with what to do."""
    plant = {"plant": {"units": 2, "reactance": 0.06}, "background": {"level": "dirty"}}
    events = {"events": [{"time": 1.0, "sag": {"type": "C", "V_pu": 0.7}}]}
    found = build(study_document() | plant | events)
    assert found.background is not None
    assert found.events[0].components


def estimating(units: list[dict[str, Any]] | int, **sections: Any) -> dict[str, Any]:
    """A document whose units have field estimators."""
    document = study_document() if isinstance(units, int) else network(units=units)
    document |= {"plant": {"units": units}} if isinstance(units, int) else {}
    return document | {"controllers": [{"name": "field", "kind": "scheduled", "estimate": "field"}]} | sections


def unit(name: str, **fields: Any) -> dict[str, Any]:
    return {"name": name, "node": "pcc", "reactance": 0.05} | fields


def test_every_unit_has_a_pair_of_lines() -> None:
    """The chosen ones, and the others in turn."""
    assert [one.pair for one in plant_of(estimating(4)).units] == [1, 2, 3, 4]
    chosen = [unit("a"), unit("b", pair=1), unit("c"), unit("d", pair=2)]
    assert [one.pair for one in plant_of(estimating(chosen)).units] == [3, 1, 4, 2]


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (
            estimating([unit("a", pair=2), unit("b"), unit("c", pair=2)]),
            "a and c send their probes on the same pair of lines",
        ),
        (estimating([unit("a", pair=5)]), 'network.units["a"].pair = 5: must be a whole number from 1 to 4'),
        (estimating(6), "4 pairs of lines for the probes of 6 units: unit5, unit6 would have none"),
        (estimating(2, estimator={"probe": {"pair": 2}}), "estimator.probe.pair = 2: each unit of a plant has a pair"),
    ],
)
def test_faults_of_pairs(document: dict[str, Any], words: str) -> None:
    assert words in faults(document)


def test_more_than_four_units_need_no_pairs_without_estimators() -> None:
    assert [one.pair for one in plant_of(study_document() | {"plant": {"units": 6}}).units] == [1, 2, 3, 4, 0, 0]
