"""The CIGRE MV network by hand from its tables, through two libraries, and branch flows of their load flows."""

from __future__ import annotations

import cmath
import importlib
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.networks import loaded
from vsgdesign.study.networks.model import S_BASE, Given, Network, check_network, part_of, with_sources
from vsgdesign.study.networks.pandapower_file import network_of_pandapower
from vsgdesign.study.networks.powsybl_file import network_of_powsybl, read_powsybl
from vsgdesign.study.networks.thevenin import admittance, column_at
from vsgdesign.verbs.pipeline.grid import Asked, grid_at

BUSES = range(1, 15)
S_SC, X_OVER_R = 5e9, 10.0
"""Of the 110 kV grid of the CIGRE network."""


@cache
def cigre() -> Any:
    """One for all tests, which read it alone."""
    return loaded.cigre()


@cache
def ours() -> Network:
    return network_of_pandapower(cigre(), "cigre.json")


def by_hand(out: str = "") -> dict[int, complex]:
    """Z in Ω at 20 kV of every bus from the tables of the network, by a dense inverse; ``out``: an element."""
    net = cigre()
    Y = np.zeros((15, 15), dtype=complex)
    ratio = 110.0 / 20.0  # everything is taken to 20 kV

    def add(i: int, j: int, y: complex) -> None:
        Y[i, i] += y
        Y[j, j] += y
        Y[i, j] -= y
        Y[j, i] -= y

    opened = {(int(one.element), int(one.bus)) for _, one in net.switch.iterrows() if one.et == "l" and not one.closed}
    for k, one in net.line.iterrows():
        if one["name"] == out:
            continue
        z = complex(one.r_ohm_per_km, one.x_ohm_per_km) * one.length_km
        y = 0.5j * 2.0 * math.pi * 50.0 * one.c_nf_per_km * 1e-9 * one.length_km
        ends = [int(one.from_bus), int(one.to_bus)]
        free = [end for end in ends if (int(k), end) in opened]
        if free:  # the cable hangs on its other end
            (held,) = set(ends) - set(free)
            Y[held, held] += y + 1.0 / (z + 1.0 / y)
        else:
            add(ends[0], ends[1], 1.0 / z)
            for end in ends:
                Y[end, end] += y
    for _, one in net.trafo.iterrows():
        if one["name"] == out:
            continue
        z = one.vk_percent / 100.0 * one.vn_lv_kv**2 / one.sn_mva
        r = one.vkr_percent / 100.0 * one.vn_lv_kv**2 / one.sn_mva
        add(int(one.hv_bus), int(one.lv_bus), 1.0 / complex(r, math.sqrt(z**2 - r**2)))
    source = 110e3**2 / S_SC / ratio**2
    Y[0, 0] += 1.0 / (source * complex(1.0, X_OVER_R) / math.hypot(1.0, X_OVER_R))
    connected = [k for k in range(15) if abs(Y[k, k]) > 0.0]
    return dict(zip(connected, np.diag(np.linalg.inv(Y[np.ix_(connected, connected)])), strict=True))


def of_network(network: Network, name: str) -> complex:
    found = part_of(network, network.bus(name))
    assert found is not None
    return column_at(*found)[found[1]] * 20e3**2 / S_BASE


def test_every_bus_is_that_by_hand() -> None:
    """Known as well: 199.7, 38.2 and 63.0 MVA at buses 1, 11 and 14, of which a standard makes up to 12 % more."""
    check_network(ours())
    hand = by_hand()
    for k in BUSES:
        assert of_network(ours(), f"Bus {k}") == pytest.approx(hand[k], rel=1e-9)
    for k, S_sc in ((1, 199.7e6), (11, 38.2e6), (14, 63.0e6)):
        assert 20e3**2 / abs(hand[k]) == pytest.approx(S_sc, rel=2e-3)


def test_every_outage_is_that_by_hand() -> None:
    found = grid_at(ours(), Asked(bus="Bus 8", S=5e6))
    lost = 0
    assert len(found.cases) == 1 + len(cigre().line) + len(cigre().trafo)
    for case in found.cases[1:]:
        if case.Z_pu is None:
            assert case.name in {f"without {name}" for name in ("Line 1-2", "Line 2-3", "Line 3-8", "Trafo 0-1")}
            lost += 1
        else:
            hand = by_hand(case.out[0])[8]
            assert case.Z_pu * found.Z_base == pytest.approx(hand, rel=1e-9)
            assert case.scr == pytest.approx(20e3**2 / abs(hand) / 5e6, rel=1e-9)
            assert case.x_over_r == pytest.approx(hand.imag / hand.real, rel=1e-9)
    assert lost == 4


def test_the_same_network_through_pypowsybl(tmp_path: Path) -> None:
    """As a MATPOWER file, which has no short-circuit power: it is told, and every bus has the same impedance."""
    convert: Any = importlib.import_module("pandapower.converter.matpower.to_mpc")
    convert.to_mpc(cigre(), str(tmp_path / "cigre.mat"), init="flat")
    read = with_sources(read_powsybl(tmp_path / "cigre.mat"), Given(source=(S_SC, X_OVER_R)))
    check_network(read)
    for k in BUSES:
        assert of_network(read, f"BUS-{k + 1}") == pytest.approx(of_network(ours(), f"Bus {k}"), rel=1e-6)


def flows(network: Network, V: np.ndarray) -> Iterator[tuple[Any, complex, complex]]:
    """Powers into both ends of every branch in MVA, from the matrix of this branch alone."""
    for branch in network.branches:
        Y = admittance(replace(network, branches=(branch,), shunts=(), sources=())).tocsr()
        i, j = branch.ends
        into = Y[[i, j]] @ V
        yield branch, V[i] * np.conj(into[0]) * 100.0, V[j] * np.conj(into[1]) * 100.0


@pytest.mark.parametrize("make", ["create_ieee300", "create_micro_grid_be_network"])
def test_branches_carry_the_load_flow_of_pypowsybl(make: str) -> None:
    """Taps, phase shifters, magnetising, three windings, and lines between two nominal voltages."""
    pypowsybl: Any = importlib.import_module("pypowsybl")
    found = getattr(pypowsybl.network, make)()
    pypowsybl.loadflow.run_ac(found)
    network = network_of_powsybl(found, make)
    V = np.zeros(len(network.buses), dtype=complex)
    for k, (_, one) in enumerate(found.get_buses().iterrows()):
        V[k] = one.v_mag * 1e3 / network.buses[k].V_n_ll_rms * cmath.exp(1j * math.radians(one.v_angle))
    stars = np.arange(len(found.get_buses()), len(V))
    if len(stars):  # nothing is connected to a star but its legs
        Y = admittance(replace(network, sources=())).toarray()
        V[stars] = -np.linalg.solve(Y[np.ix_(stars, stars)], Y[np.ix_(stars, np.arange(stars[0]))] @ V[: stars[0]])
    tables = (found.get_lines(), found.get_2_windings_transformers(), found.get_3_windings_transformers())
    rows = {name: row for table in tables for index, row in table.iterrows() for name in (index, row["name"])}
    sides = dict[str, int]()
    seen = 0
    for branch, s_1, s_2 in flows(network, V):
        one = rows[branch.name]
        if branch.leg:
            sides[branch.name] = side = sides.get(branch.name, 0) + 1
            assert s_1 == pytest.approx(complex(one[f"p{side}"], one[f"q{side}"]), abs=0.02)
        else:
            assert s_1 == pytest.approx(complex(one.p1, one.q1), abs=0.02)
            assert s_2 == pytest.approx(complex(one.p2, one.q2), abs=0.02)
        seen += 1
    assert seen == len(network.branches) > 5


def test_branches_carry_the_load_flow_of_pandapower() -> None:
    """Taps, three windings, an impedance, open ends and joined busbars, from 0.4 to 380 kV."""
    pp = loaded.pandapower()
    net = pp.networks.example_multivoltage()
    net.xward.drop(net.xward.index, inplace=True)
    pp.runpp(net, calculate_voltage_angles=True, init="dc", tolerance_mva=1e-9, numba=False)
    network = network_of_pandapower(net, "multivoltage")
    places = {name: k for k, bus in enumerate(network.buses) for name in (bus.name, *bus.others)}
    V = np.full(len(network.buses), np.nan, dtype=complex)
    for index, one in net.res_bus.iterrows():
        if net.bus["name"][index] in places and one.vm_pu == one.vm_pu:
            V[places[net.bus["name"][index]]] = one.vm_pu * cmath.exp(1j * math.radians(one.va_degree))
    inside, known = np.flatnonzero(np.isnan(V)), np.flatnonzero(~np.isnan(V))
    Y = admittance(replace(network, sources=())).toarray()
    V[inside] = -np.linalg.solve(Y[np.ix_(inside, inside)], Y[np.ix_(inside, known)] @ V[known])
    expected = {
        **{net.line["name"][k]: complex(one.p_from_mw, one.q_from_mvar) for k, one in net.res_line.iterrows()},
        **{net.trafo["name"][k]: complex(one.p_hv_mw, one.q_hv_mvar) for k, one in net.res_trafo.iterrows()},
        **{net.trafo3w["name"][k]: complex(one.p_hv_mw, one.q_hv_mvar) for k, one in net.res_trafo3w.iterrows()},
        **{
            net.impedance["name"][k]: complex(one.p_from_mw, one.q_from_mvar) for k, one in net.res_impedance.iterrows()
        },
    }
    firsts: dict[str, complex] = {}
    for branch, s_1, _ in flows(network, V):
        firsts.setdefault(branch.name, s_1)  # of a star the leg of the highest voltage
    assert set(firsts) <= set(expected)
    assert len(firsts) > 15
    for name, s_1 in firsts.items():
        assert s_1 == pytest.approx(expected[name], abs=1e-6)
