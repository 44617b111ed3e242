"""The safe place: the best worst decay over the specification's grids, by other equations and another search."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigvals

from tests.gain_tables import table
from vsgdesign.equations.power_flow import POWER_MARGIN, operating_point, power_flow
from vsgdesign.equations.power_loops import References, power_loops
from vsgdesign.linear.stability.maps import cell_set, full_order_cells
from vsgdesign.linear.stability.margins import full_order_margins
from vsgdesign.linear.stability.safe_place import (
    LEAST_DISK_MARGIN,
    LOWEST_DISK_MARGIN,
    closed_form_place,
    middle_place,
    table_safe_place,
)
from vsgdesign.runtime.of_study import ControllerGains
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.study.parameters import Study, load_study, study_from_text
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import ControllerSpec

STUDIES = Path(__file__).resolve().parents[2] / "studies" / "survival"
NAMES = ("study", "laboratory", "utility")


@functools.cache
def study_named(name: str) -> tuple[Study, ControllerSpec]:
    study = load_study(STUDIES / f"{name}.toml")
    return study, next(spec for spec in study.controllers if spec.name == "angle_damped")


@functools.cache
def place_of(name: str) -> Place:
    place = closed_form_place(*study_named(name))
    assert place is not None
    return place


def slowest(name: str, place: Place, scrs: tuple[float, ...], x_over_rs: tuple[float, ...]) -> float:
    """Decay rate (1/s) of the slowest mode with the gains of a place over grids and powers of the specification.

    The closed loop is written as five differential equations, and its Jacobian is taken by central differences.
    """
    study, spec = study_named(name)
    asked = study.specification
    assert asked is not None
    c, f, law = study.converter, study.filter, closed_form_schedule(study, spec.target)
    assumed, worst = place.grid(c), math.inf
    P_s, Q_s = ((one[0], 0.5 * one[0], 0.0, 0.5 * one[1], one[1]) for one in (asked.box.P, asked.box.Q))
    for scr, x_over_r, P, Q in product(scrs, x_over_rs, P_s, Q_s):
        true = Place(scr, x_over_r, "impedance").grid(c)
        R, X = true.R_g + f.R_2, c.omega_n * (true.L_g + f.L_2)
        with np.errstate(invalid="ignore"):
            V, delta = operating_point(P, Q, c.V_rated_rms, R, X)
        carried = POWER_MARGIN * math.hypot(R, X) * math.hypot(P, Q) <= 3.0 * V * V
        if not (carried and c.V_limits_rms[0] <= V <= c.V_limits_rms[1]):
            continue
        if math.hypot(P, Q) > (c.current_limit_pu or math.inf) * c.S_rated * V / c.V_rated_rms:
            continue
        gains = law.gains_measured(assumed.R_g, assumed.L_g, P, Q, V)
        rest = References(P, Q + 0.0, c.omega_n, V)
        omega_i = c.omega_n + gains.k_P * P + gains.k_Q * (Q + gains.D_q * V)

        def rates(x: np.ndarray, R=R, X=X, rest=rest, gains=gains) -> np.ndarray:
            delta, omega_i, V, P_f, Q_f = x
            P, Q = power_flow(delta, V, c.V_rated_rms, R, X)
            omega, domega, dV = power_loops(omega_i, V, P_f, Q_f, rest, gains)
            return np.array([omega - c.omega_n, domega, dV, (P - P_f) / study.tau_P, (Q - Q_f) / study.tau_Q])

        x = np.array([delta, omega_i, V, P, Q])
        steps = 1e-5 * np.array([1.0, 1.0, V, c.S_rated, c.S_rated])
        assert np.abs(rates(x)[:3]).max() < 1e-6 * c.omega_n
        A = [(rates(x + h) - rates(x - h)) / (2.0 * h.max()) for h in np.diag(steps)]
        worst = min(worst, -float(eigvals(np.array(A).T).real.max()))
    return worst


def margin(name: str, place: Place, scrs: tuple[float, ...], x_over_rs: tuple[float, ...]) -> float:
    """The least disk margin of the full-order model with the gains of a place, on 500 frequencies."""
    study, spec = study_named(name)
    asked = study.specification
    assert asked is not None
    law = ControllerGains(closed_form_schedule(study, spec.target), None, True)
    every = list(product(scrs, x_over_rs, asked.box.P, asked.box.Q))
    grids = [Place(scr, x_over_r, "impedance").grid(study.converter) for scr, x_over_r, _, _ in every]
    R_g, L_g = np.array([grid.R_g for grid in grids]), np.array([grid.L_g for grid in grids])
    P, Q = np.array([one[2] for one in every]), np.array([one[3] for one in every])
    R, X = R_g + study.filter.R_2, study.converter.omega_n * (L_g + study.filter.L_2)
    with np.errstate(invalid="ignore"):
        V, _ = operating_point(P, Q, study.grid_source.V_g_rms, R, X)
    made = place.grid(study.converter)
    cells = cell_set(study, R_g, L_g, P, Q, law(made.R_g, made.L_g, P, Q, V))
    found = full_order_margins(full_order_cells(study, cells.take(np.flatnonzero(cells.inside & cells.good))))
    return float(np.nan_to_num(found.disk_output.value, nan=0.0).min())


@pytest.mark.parametrize("name", NAMES)
def test_no_place_of_a_finer_search_is_better(name: str) -> None:
    """SCR in steps of 3 % around the place; the compared places are 4.6 % apart. The angle is that of all places."""
    place, scrs, x_over_rs = place_of(name), (1.2, 20.0), (0.3, 20.0)
    found = slowest(name, place, scrs, x_over_rs)
    floor = max(min(LEAST_DISK_MARGIN, margin(name, middle_place_of(name), (20.0,), x_over_rs)), LOWEST_DISK_MARGIN)
    for scr in place.scr * 1.03 ** np.arange(-12.0, 7.0):
        other = replace(place, scr=float(scr))
        # What is slower needs no margin.
        if slowest(name, other, (1.2,), (0.3,)) > 1.05 * found:
            assert margin(name, other, (20.0,), x_over_rs) < 1.02 * floor, f"{other} is better than {place}"


def middle_place_of(name: str) -> Place:
    specification = study_named(name)[0].specification
    assert specification is not None
    return middle_place(specification)


@pytest.mark.parametrize(("name", "gain"), [("study", 1.4), ("laboratory", 2.0), ("utility", 0.85)])
def test_it_is_faster_than_the_middle_and_keeps_the_margin(name: str, gain: float) -> None:
    place, middle = place_of(name), middle_place_of(name)
    nodes = (1.2, 1.5, 2.0, 5.0, 20.0), (0.3, 1.0, 5.0, 20.0)
    assert slowest(name, place, *nodes) > gain * slowest(name, middle, *nodes)
    kept = margin(name, place, *nodes)
    # Below 0.3 only where the middle is, which has 0.07 with the 1 MVA converter: decay is given up for a margin there.
    assert kept > 0.99 * LEAST_DISK_MARGIN or kept > 0.99 * max(margin(name, middle, *nodes), LOWEST_DISK_MARGIN)
    # Equally far from the angles of the most resistive and the most inductive grid.
    assert 2.0 * math.atan(place.x_over_r) == pytest.approx(math.atan(0.3) + math.atan(20.0), abs=1e-3)


def test_equal_designs_have_one_place_whatever_happens_to_them() -> None:
    """The place is that of the design: events, the start and other controllers do not move it."""
    study, spec = study_named("study")
    other = study.with_changes(simulation={"P_ref": "1 kW"}, grid={"scr": 2.0}, events=[])
    assert closed_form_place(other, spec) is closed_form_place(study, spec)
    slower = replace(spec, target=replace(spec.target, k_1=5.0, d_1=4.0, k_2=2.0))
    assert closed_form_place(study, slower) != place_of("study")


def test_without_a_specification_there_is_none() -> None:
    study, spec = study_named("study")
    bare = replace(study, specification=None)
    assert closed_form_place(bare, spec) is None
    assert table_safe_place(bare, table("angle_damped")) is None


def test_where_no_grid_carries_a_power_it_is_the_middle() -> None:
    """The powers that are asked for are above the limits on every grid: a design takes a share of them."""
    study = study_from_text("""
base = "case:lab_12kva_lcl"
grid = { scr_basis = "impedance", scr = 20, x_over_r = 3 }
simulation = { duration = "0.1 s", P_ref = "1 kW", Q_ref = "0 var" }
controllers = [{ name = "a", kind = "scheduled", structure = "angle_damped" }]
[specification]
settling_time = "1.3 s"
overshoot = "5 %"
scr = [1.1, 1.2]
x_over_r = [0.3, 0.5]
P = ["24 kW", "25 kW"]
""")
    assert study.specification is not None
    assert closed_form_place(study, study.controllers[0]) == middle_place(study.specification)


def test_the_published_structure_waits_where_it_did() -> None:
    """It is not stable between the grids: no search, and its tables wait at the strongest grid."""
    study, _ = study_named("study")
    published = next(spec for spec in study.controllers if spec.name == "published")
    assert closed_form_place(study, published) == middle_place_of("study")
    assert table_safe_place(study, table("published")) is None
