"""A table whose gains feed nearly all of the droop back through k_P is refused, at its node or between two of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.gain_tables import table
from vsgdesign.artifacts import read_table_file, write_table_file
from vsgdesign.artifacts.gain_table_file import TABLE_FILE, fed_back_fault, largest_fed_back, table_document
from vsgdesign.equations.power_loops import MOST_FED_BACK
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime import table_schedule


def largest_by_the_schedule(made, count: int) -> float:
    """By the schedule itself at random places and powers of the box, beside what :func:`largest_fed_back` looks at."""
    rng, box, base = np.random.default_rng(4), made.validity, made.base
    scr, r_over_x = (
        rng.uniform(box.scr[0], box.scr[1], count),
        rng.uniform(1.0 / box.x_over_r[1], 1.0 / box.x_over_r[0], count),
    )
    P, Q, V = (
        np.where(rng.random(count) < 0.5, rng.choice(pair, count), rng.uniform(pair[0], pair[1], count))
        for pair in (box.P, box.Q, box.V_rms)
    )
    schedule = table_schedule(made)
    Z = schedule.Z_base / scr
    X = Z / np.hypot(1.0, r_over_x)
    gains = schedule.gains_measured(X * r_over_x, X / base.omega_n, P, Q, V)
    return float(np.nanmax(gains.k_P * gains.D_p))


@pytest.mark.parametrize(
    ("law", "parameters"),
    [("poles", {}), ("poles", {"d_1": 7.7}), ("inertia", {}), ("inertia", {"zeta": 0.95})],
)
def test_it_is_the_largest_of_the_schedule(law: str, parameters: dict[str, float]) -> None:
    made = table(law=law, parameters=parameters, status=np.full((4, 4), "met"))
    found, at = largest_fed_back(made)
    sampled = largest_by_the_schedule(made, 20_000)
    # What lies between the points that it looks at is the reserve between its limit and 1.
    assert sampled <= found + 0.4 * (1.0 - MOST_FED_BACK)
    Z = table_schedule(made).Z_base / at["scr"]
    X = Z / np.hypot(1.0, 1.0 / at["x_over_r"])
    gains = table_schedule(made).gains_measured(
        X / at["x_over_r"], X / made.base.omega_n, at["P"], at["Q"], at["V_rms"]
    )
    assert float(gains.k_P * gains.D_p) == pytest.approx(found, rel=1e-9)


@pytest.mark.parametrize("structure", ["published", "decoupled"])
def test_without_damping_through_the_angle_there_is_none(structure: str) -> None:
    assert largest_fed_back(table(structure))[0] == 0.0


def test_more_damping_than_critical_is_refused_where_the_droop_is_large(tmp_path: Path) -> None:
    """ζ = 1.1 on every grid. Where w_11 D_p is small, as on a strong grid, nothing is wrong with it."""
    overdamped = table(parameters={"d_1": 2.0 * 1.1 * np.sqrt(15.8)})
    found, at = largest_fed_back(overdamped)
    assert found > 1.0
    assert at["scr"] < 3.0
    fault = f"k_P·D_p reaches {found:.3g} at SCR"
    with pytest.raises(ArtifactError, match=fault):
        write_table_file(overdamped, tmp_path / "t.json")
    (tmp_path / "t.json").write_text(TABLE_FILE.render(table_document(overdamped)), encoding="utf-8")
    with pytest.raises(ArtifactError, match=r"not a usable gain table.*\n.*may be at most 0\.95.*softer P–f droop"):
        read_table_file(tmp_path / "t.json")
    strong = table(scr=(10.0, 20.0), parameters={"d_1": 2.0 * 1.1 * np.sqrt(15.8)})
    assert fed_back_fault(strong) is None
    softer = table(parameters={"d_1": 2.0 * 1.1 * np.sqrt(15.8)}, D_p=30.0)
    assert largest_fed_back(softer)[0] < MOST_FED_BACK


def test_a_place_between_two_nodes_counts() -> None:
    """Halfway between two nodes, the droop of the weak one meets the damping of the strong one."""
    status = np.full((2, 2), "met")
    made = table(scr=(1.5, 3.0), x_over_r=(1.0, 3.0), parameters={"d_1": [[4.0, 4.0], [7.0, 7.0]]}, status=status)
    found, at = largest_fed_back(made)
    assert at["scr"] == 2.25
    assert found > 1.2 * 0.253  # that of the weaker node, where it is larger than at the stronger one


def test_a_table_without_a_design_has_no_place() -> None:
    made = table(status=np.full((4, 4), "outside"))
    assert largest_fed_back(made) == (-np.inf, {})
