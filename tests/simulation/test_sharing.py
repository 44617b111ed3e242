"""Units of a plant without a source share its load by their droops, whatever their ratings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vsgdesign.simulation.units.scenario import PlantController, run_plant
from vsgdesign.study.parameters import load_study

RATINGS, DROOPS = {"large": 12.5e3, "small": 8e3}, {"large": 0.02, "small": 0.03}

SMALL = """
base = "case:lab_12kva_lcl"
converter = { S_rated = "8 kVA" }
power_loops = { structure = "angle_damped", P_droop = "3 %", Q_droop = "8 %", settling_time = "0.4 s" }
"""

ISLAND = """
base = "case:lab_12kva_lcl"
grid = { scr = 5, x_over_r = 4 }
power_loops = { structure = "angle_damped", P_droop = "2 %", Q_droop = "5 %", settling_time = "0.4 s" }
simulation = { duration = "3.6 s", P_ref = "6 kW", Q_ref = "1 kvar" }
controllers = [{ name = "vsg", kind = "fixed" }]

[network]
nodes = [{ name = "pcc" }]
loads = [
    { name = "works", node = "pcc", P = "7 kW", Q = "LOAD kvar" },
    { name = "kiln", node = "pcc", P = "2 kW", breaker = "open" },
]
units = [
    { name = "large", node = "pcc", reactance = 0.06 },
    { name = "small", node = "pcc", reactance = 0.08, case = "small.toml", P_ref = "2 kW", Q_ref = "0 var" },
]

[[events]]
time = "0.1 s"
element = "grid"
breaker = "open"

[[events]]
time = "1.6 s"
element = "kiln"
breaker = "closed"

[[events]]
time = "2.6 s"
element = "small"
breaker = "open"
"""


def run_of(folder: Path, load: str) -> PlantController:
    (folder / "small.toml").write_text(SMALL, encoding="utf-8")
    (folder / "island.toml").write_text(ISLAND.replace("LOAD", load), encoding="utf-8")
    return run_plant(load_study(folder / "island.toml")).controllers[0]


def test_unequal_units_share_a_load_as_their_droops_say(tmp_path: Path) -> None:
    """The load that both carry together, on the two lines P_ref + S (f_0 - f) / (droop f_0): where they cross."""
    found = run_of(tmp_path, "2")
    assert found.outcome.status == "settled"
    names = ("grid: breaker opens", "kiln: breaker closes", "small: breaker opens")
    assert tuple(dict.fromkeys(one.name for one in found.sharing)) == names
    slopes = {name: RATINGS[name] / DROOPS[name] for name in RATINGS}
    for event in names[:2]:
        own = {one.unit: one for one in found.sharing if one.name == event}
        asked = {"large": 6e3, "small": 2e3}
        down = (sum(one.P for one in own.values()) - sum(asked.values())) / sum(slopes.values())
        for unit, one in own.items():
            assert one.fault is None
            assert pytest.approx(asked[unit] + slopes[unit] * down, abs=0.01 * RATINGS[unit]) == one.P
            assert one.f_hz == pytest.approx(50.0 * (1.0 - down), abs=0.02)
            assert one.settled_s is not None
            assert 0.0 < one.settled_s < 1.0
    (last,) = (one for one in found.sharing if one.name == names[2])
    loads = sum(one.P for one in found.sharing if one.name == names[1])
    assert pytest.approx(loads, rel=0.03) == last.P
    assert found.rests[1].obstacle is not None
    assert np.isfinite([one.V_pu for one in found.sharing]).all()


def test_an_island_beyond_its_voltage_limits_is_not_settled(tmp_path: Path) -> None:
    found = run_of(tmp_path, "60")
    assert found.outcome.status == "not settled"
    assert any(one.fault is not None and "pu, outside of" in one.fault for one in found.sharing)


JOINS = """
[[events]]
time = "0.1 s"
element = "grid"
breaker = "open"

[[events]]
time = "0.5 s"
element = "small"
breaker = "closed"
synchro_check = { df = "1 Hz" }

[[events]]
time = "1.9 s"
element = "small"
P_ref = "2 kW"
"""


def test_a_unit_joins_an_island_when_it_is_in_phase(tmp_path: Path) -> None:
    """The unit runs at its own frequency, without a load, until both sides are within 10°: the node's voltage is
    that of the load, of which the other unit's current is known. From then on it shares."""
    island = ISLAND.partition("[[events]]")[0].replace(
        'P_ref = "2 kW", Q_ref', 'breaker = "open", P_ref = "4 kW", Q_ref'
    )
    (tmp_path / "small.toml").write_text(SMALL, encoding="utf-8")
    (tmp_path / "island.toml").write_text(island.replace("LOAD", "2") + JOINS, encoding="utf-8")
    found = run_plant(load_study(tmp_path / "island.toml")).controllers[0]
    assert found.outcome.status == "settled", found.outcome.reason
    (closing,) = [one for one in found.rests if "breaker closes at" in one.name]
    assert 0.5 < closing.t_s < 1.9
    large, small = (one.simulation for one in found.units)
    row = int(np.searchsorted(large.t_s, closing.t_s)) - 1
    v, i = (
        one.column(f"{name}_alpha") + 1j * one.column(f"{name}_beta") for one, name in ((small, "v_c"), (large, "i_g"))
    )
    before = np.abs(np.angle(v * np.conj(i * complex(7.0, 2.0))))[: row + 1]
    late = large.t_s[: row + 1] > 0.55
    assert before[row] < np.radians(10.5)
    assert before[late].max() > np.radians(20.0)
    assert {one.unit for one in found.sharing if one.name == "small: P_ref 2 kW"} == {"large", "small"}


def test_a_unit_that_never_comes_into_phase_says_so(tmp_path: Path) -> None:
    """With another frequency than the relay allows."""
    island = ISLAND.partition("[[events]]")[0].replace(
        'P_ref = "2 kW", Q_ref', 'breaker = "open", P_ref = "4 kW", Q_ref'
    )
    (tmp_path / "small.toml").write_text(SMALL, encoding="utf-8")
    text = island.replace("LOAD", "2").replace('"3.6 s"', '"1 s"') + JOINS.partition('[[events]]\ntime = "1.9 s"')[0]
    (tmp_path / "island.toml").write_text(text.replace('df = "1 Hz"', 'df = "0.05 Hz"'), encoding="utf-8")
    found = run_plant(load_study(tmp_path / "island.toml")).controllers[0]
    assert found.outcome.status == "not settled"
    assert "never closes" in (found.outcome.reason or "")
