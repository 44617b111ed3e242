"""The interpolated schedule: exact at nodes, continuous, within its neighbours, held beyond the edges."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from tests.examples import examples
from tests.gain_tables import PUBLISHED_BASE, table
from vsgdesign.artifacts import GainTable, write_table_file
from vsgdesign.equations.power_flow import jacobian_from_powers, operating_point
from vsgdesign.errors import NoOperatingPointError
from vsgdesign.runtime import ClosedFormSchedule, table_schedule
from vsgdesign.runtime.table import table_grids

OMEGA = PUBLISHED_BASE.omega_n
Z_BASE = 3.0 * 110.0**2 / 5e3
SCR, RATIO = np.array([1.5, 2.0, 5.0, 20.0]), np.array([0.3, 1.0, 3.0, 10.0, 20.0])


def random_table(seed: int = 0, **changes: Any) -> GainTable:
    rng = np.random.default_rng(seed)
    columns = {name: rng.uniform(1.0, 9.0, (4, 5)) for name in ("k_1", "d_1", "k_2", "q", "share_P", "share_Q")}
    return table(scr=SCR, x_over_r=RATIO, parameters=columns, **changes)


TABLE = random_table()
SCHEDULE = table_schedule(TABLE)


def grid(scr: float, x_over_r: float) -> tuple[float, float]:
    """R_g and L_g from |Z| and its angle: no formula of the library."""
    Z = Z_BASE / scr * np.exp(1j * np.arctan(x_over_r))
    return Z.real, Z.imag / OMEGA


def test_exact_at_the_nodes() -> None:
    found = SCHEDULE.normalised(*table_grids(TABLE))
    for values, name in zip(found, TABLE.columns, strict=True):
        # The way to a node from its R_g and L_g has a few roundings; the columns differ by up to 9 per cell.
        np.testing.assert_allclose(values, TABLE.parameters[name], rtol=1e-13)


def test_gains_at_the_nodes_are_those_of_the_file() -> None:
    found = SCHEDULE.gains_over(*table_grids(TABLE))
    for values, stored in zip(found, TABLE.gains, strict=True):
        np.testing.assert_allclose(values, stored, rtol=1e-11)


def test_between_the_nodes_as_an_independent_interpolator_says() -> None:
    """SciPy's, linear in SCR and R/X."""
    rng = np.random.default_rng(3)
    scr, ratio = rng.uniform(1.5, 20.0, 200), np.exp(rng.uniform(np.log(0.3), np.log(20.0), 200))
    R_g, L_g = np.array([grid(s, x) for s, x in zip(scr, ratio, strict=True)]).T
    found = SCHEDULE.normalised(R_g, L_g)
    for values, name in zip(found, TABLE.columns, strict=True):
        other = RegularGridInterpolator((SCR, 1.0 / RATIO[::-1]), TABLE.parameters[name][:, ::-1])
        np.testing.assert_allclose(values, other(np.stack([scr, 1.0 / ratio], axis=1)), rtol=1e-12)


coordinates = st.tuples(st.floats(1.0, 30.0), st.floats(0.1, 50.0))


@examples(60)
@given(coordinates)
def test_within_the_four_neighbours(at: tuple[float, float]) -> None:
    scr, ratio = at
    rows = np.searchsorted(SCR, np.clip(scr, SCR[0], SCR[-1]) * np.array([1 - 1e-9, 1 + 1e-9]))
    cols = np.searchsorted(RATIO, np.clip(ratio, RATIO[0], RATIO[-1]) * np.array([1 - 1e-9, 1 + 1e-9]))
    block = (slice(max(rows[0] - 1, 0), rows[1] + 1), slice(max(cols[0] - 1, 0), cols[1] + 1))
    for value, name in zip(SCHEDULE.normalised(*grid(scr, ratio)), TABLE.columns, strict=True):
        corners = TABLE.parameters[name][block]
        assert corners.min() * (1 - 1e-14) <= value <= corners.max() * (1 + 1e-14)


@examples(40)
@given(coordinates)
def test_continuous(at: tuple[float, float]) -> None:
    """A step of 1e-9 moves nothing by more than the steepest cell can: a jump at a cell's border would show."""
    R_g, L_g = grid(*at)
    near = np.array(SCHEDULE.normalised(R_g, L_g))
    # Columns differ by at most 9 over an interval of 0.3 in SCR or 0.05 in R/X, both above 0.05.
    for moved in ((R_g * (1 + 1e-9), L_g), (R_g, L_g * (1 + 1e-9))):
        assert np.abs(np.array(SCHEDULE.normalised(*moved)) - near).max() < 9.0 / 0.05 * 60e-9


@pytest.mark.parametrize(
    "seam", [(2.0, 0.7), (5.0, 4.0), (3.0, 1.0), (10.0, 3.0), (7.0, 10.0), (2.0, 1.0), (5.0, 10.0)]
)
def test_no_jump_across_a_seam(seam: tuple[float, float]) -> None:
    sides = [
        np.array(SCHEDULE.normalised(*grid(seam[0] * a, seam[1] * b)))
        for a in (1 - 1e-9, 1 + 1e-9)
        for b in (1 - 1e-9, 1 + 1e-9)
    ]
    assert np.ptp(sides, axis=0).max() < 1e-5


def test_the_edge_holds_beyond_it_and_says_so() -> None:
    edge = SCHEDULE.normalised(*grid(20.0, 2.0))
    assert np.array(SCHEDULE.normalised(*grid(100.0, 2.0))) == pytest.approx(np.array(edge), rel=1e-12)
    assert SCHEDULE.place(*grid(100.0, 2.0))[2:4] == (1, 0)
    assert SCHEDULE.place(*grid(1.0, 0.1))[2:4] == (-1, -1)
    assert SCHEDULE.place(*grid(3.0, 40.0))[2:4] == (0, 1)
    assert SCHEDULE.place(*grid(3.0, 2.0))[:4] == pytest.approx((3.0, 2.0, 0, 0), rel=1e-12)


def test_no_resistance_or_an_estimate_below_zero_is_the_largest_x_over_r() -> None:
    L_g = Z_BASE / 4.0 / OMEGA
    for R_g in (0.0, -1e-3, -0.3):
        scr = Z_BASE / np.hypot(R_g, OMEGA * L_g)
        largest = np.array(SCHEDULE.normalised(*grid(scr, 20.0)))
        assert np.array(SCHEDULE.normalised(R_g, L_g)) == pytest.approx(largest, rel=1e-12)
        assert SCHEDULE.place(R_g, L_g).clipped_x_over_r == 1


@pytest.mark.parametrize(
    ("R_g", "L_g"), [(np.nan, 1e-3), (1.0, np.nan), (np.inf, 1e-3), (1.0, np.inf), (1.0, 0.0), (1.0, -1e-3)]
)
def test_no_usable_estimate_gives_no_number(R_g: float, L_g: float) -> None:
    assert np.isnan(SCHEDULE.normalised(R_g, L_g)).all()
    assert not SCHEDULE.place(R_g, L_g).designed
    gains = SCHEDULE.gains_measured(R_g, L_g, 3e3, 1e3, 112.0)
    assert np.isnan([gains.K_ip, gains.K_iq, gains.k_P]).all()


def test_neighbours_of_an_undesigned_node_are_known() -> None:
    partly = table(scr=(0.3, 2.0, 8.0))
    schedule = table_schedule(partly)
    assert not schedule.place(*grid(1.0, 2.0)).designed
    assert schedule.place(*grid(3.0, 2.0)).designed
    assert schedule.place(*grid(2.0, 1.0)).designed  # at a node its neighbours have no say
    with pytest.raises(NoOperatingPointError, match=r"Design for [0-9.]+ % of that power"):
        schedule.gains(*grid(0.3, 2.0))
    assert np.isnan(schedule.gains_over(*grid(0.3, 2.0)).K_ip)


@pytest.mark.parametrize(
    ("structure", "law"), [("published", "poles"), ("decoupled", "poles"), ("angle_damped", "inertia")]
)
def test_a_constant_table_is_the_closed_form(structure: str, law: str) -> None:
    """The same law through another door: a table of the closed form's constants on any grid, any measurement."""
    made = table(structure, law, scr=SCR, x_over_r=RATIO)
    closed = ClosedFormSchedule(
        P=4500.0,
        Q=1000.0,
        V_g_rms=110.0,
        omega=OMEGA,
        settling_time=1.0,
        damping_ratio=1.0,
        droop_ratio=0.01,
        structure=structure,
        law=law,
        k_1=15.8,
        d_1=6.6,
        k_2=4.0,
        H=2.0,
        zeta=0.7,
        D_p=made.D_p,
        D_q=made.D_q,
        S_rated=5e3,
    )
    for at in ((2.5, 0.8), (11.0, 6.0)):
        measured = (*grid(*at), 2.2e3, 700.0, 114.0)
        np.testing.assert_allclose(
            table_schedule(made).gains_measured(*measured), closed.gains_measured(*measured), rtol=1e-12
        )
        np.testing.assert_allclose(table_schedule(made).gains(*grid(*at)), closed.gains(*grid(*at)), rtol=1e-12)


def test_on_the_reactance_basis() -> None:
    schedule = table_schedule(random_table(base=replace(PUBLISHED_BASE, scr_basis="reactance")))
    place = schedule.place(1.0, 0.5 / OMEGA)
    assert place.scr == pytest.approx(Z_BASE / 0.5, rel=1e-14)
    assert place.x_over_r == pytest.approx(0.5, rel=1e-14)


def test_one_node_on_an_axis_holds_everywhere() -> None:
    one = table(scr=(2.0, 5.0), x_over_r=(1.0,), parameters={"k_1": np.array([[10.0], [20.0]])})
    for ratio in (0.2, 1.0, 9.0):
        assert table_schedule(one).normalised(*grid(3.5, ratio)).k_1_or_H == pytest.approx(15.0, rel=1e-12)


def test_r_over_x_is_the_better_coordinate() -> None:
    """What a design depends on is the coupling c = BC/(AD), near −(R/X)²: its error between nodes, in both."""
    rng = np.random.default_rng(0)
    points = np.exp(rng.uniform(np.log([1.5, 0.3]), np.log([20.0, 20.0]), (500, 2)))

    def c(scr: float, ratio: float) -> float:
        R, L = grid(scr, ratio)
        V = operating_point(1500.0, 500.0, 110.0, R, OMEGA * L)[0]
        A, B, C, D = jacobian_from_powers(1500.0, 500.0, V, R, OMEGA * L)
        return float(B * C / (A * D))

    nodes = np.array([[c(s, x) for x in RATIO] for s in SCR])
    true = np.array([c(*point) for point in points])
    in_r = RegularGridInterpolator((SCR, 1.0 / RATIO[::-1]), nodes[:, ::-1])(
        np.stack([points[:, 0], 1 / points[:, 1]], 1)
    )
    in_x = RegularGridInterpolator((SCR, RATIO), nodes)(points)
    assert np.abs(in_r - true).max() < 0.5 * np.abs(in_x - true).max()


def as_the_format_says(made: GainTable, R_g: float, L_g: float) -> list[float]:
    """The steps of docs/gain-table-file.md on floats, one operation at a time: what C would do."""
    base, omega = made.base, made.base.omega_n
    X = omega * L_g
    scr = Z_BASE / (float(np.hypot(R_g, X)) if base.scr_basis == "impedance" else X)
    axes = made.scr.tolist(), [1.0 / x for x in reversed(made.x_over_r.tolist())]
    places = []
    for axis, value in zip(axes, (scr, R_g / X), strict=True):
        inside = min(max(value, axis[0]), axis[-1])
        low = 0
        while low < len(axis) - 2 and axis[low + 1] <= inside:
            low += 1
        places.append((low, (inside - axis[low]) / (axis[low + 1] - axis[low])))
    (i, r), (j, c) = places
    w00, w01, w10, w11 = (1.0 - r) * (1.0 - c), (1.0 - r) * c, r * (1.0 - c), r * c
    found = []
    for name, stored in made.columns.items():
        scale = {"k_1": made.time_scale**2, "d_1": made.time_scale, "k_2": made.time_scale}.get(name, 1.0)
        v = [[value / scale for value in reversed(row)] for row in stored.tolist()]
        found.append(((w00 * v[i][j] + w01 * v[i][j + 1]) + w10 * v[i + 1][j]) + w11 * v[i + 1][j + 1])
    return found


@pytest.mark.parametrize("basis", ["impedance", "reactance"])
def test_another_implementation_gets_the_same_bits(basis: str) -> None:
    made = random_table(5, base=replace(PUBLISHED_BASE, scr_basis=basis))
    schedule = table_schedule(made)
    assert schedule.Z_base == Z_BASE
    rng = np.random.default_rng(6)
    for R_g, L_g in np.stack([rng.uniform(-0.2, 5.0, 300), rng.uniform(1e-4, 2e-2, 300)], axis=1).tolist():
        assert [float(value) for value in schedule.normalised(R_g, L_g)] == as_the_format_says(made, R_g, L_g)


def test_reading_and_using_a_table_stays_light(tmp_path: Path) -> None:
    """From file to gains without CasADi, SciPy, Numba, or what reads studies."""
    path = tmp_path / "t.json"
    write_table_file(table(), path)
    code = (
        "import sys; from vsgdesign.artifacts.gain_table_file import read_table_file;"
        "from vsgdesign.runtime import table_schedule;"
        f"table_schedule(read_table_file({str(path)!r})).gains(1.0, 0.004); print(*sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    names = set(run.stdout.split())
    assert "numpy" in names
    assert {name.split(".")[0] for name in names}.isdisjoint({"casadi", "scipy", "numba", "matplotlib", "click"})
    assert not any(name.startswith("vsgdesign.study.parameters") for name in names)
