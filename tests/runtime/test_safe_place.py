"""Which single place may be waited at on every grid, by the coupled power loops."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import table_document
from vsgdesign.artifacts.gain_table_file import read_table_file, write_table_file
from vsgdesign.equations.grid import grid_from_scr_impedance
from vsgdesign.equations.power_flow import jacobian_from_powers, operating_point
from vsgdesign.equations.power_loops import References, power_loops
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime import scheduler_of, settings_of, table_schedule
from vsgdesign.runtime.guards import lacks_safe_place, safe_place_text

NONE = References(0.0, 0.0, 0.0, 0.0)


def least_stable(structure: str, scr: float, x_over_r: float) -> float:
    """The largest real part (1/s) on every grid and power within the static limits, with the gains of one place."""
    schedule = table_schedule(table(structure))
    assumed = grid_from_scr_impedance(scr, x_over_r, schedule.Z_base, schedule.omega)
    worst = -np.inf
    for true_scr in (1.5, 2.0, 5.0, 10.0, 20.0):
        for ratio in (0.3, 0.5, 1.0, 3.0, 10.0):
            R, L = grid_from_scr_impedance(true_scr, ratio, schedule.Z_base, schedule.omega)
            X = schedule.omega * L
            for P in (-4500.0, 0.0, 4500.0):
                for Q in (-2000.0, 0.0, 2000.0):
                    with np.errstate(invalid="ignore"):
                        V, _ = operating_point(P, Q, 110.0, R, X)
                    if not 93.5 <= V <= 137.5 or 1.3 * np.hypot(R, X) * np.hypot(P, Q) > 3.0 * V * V:
                        continue
                    gains = schedule.gains_measured(*assumed, P, Q, V)
                    A, B, C, D = jacobian_from_powers(P, Q, V, R, X)
                    columns = [
                        power_loops(0.0, 0.0, A, C, NONE, gains),
                        power_loops(1.0, 0.0, 0.0, 0.0, NONE, gains),
                        power_loops(0.0, 1.0, B, D, NONE, gains),
                    ]
                    worst = max(worst, np.linalg.eigvals(np.array(columns, dtype=float).T).real.max())
    return worst


@pytest.mark.parametrize("structure", ["published", "decoupled", "angle_damped"])
def test_the_safe_place_is_stable_on_every_grid(structure: str) -> None:
    settings = scheduler_of(table(structure)).settings
    assert settings.safe_scr == pytest.approx(20.0 if structure == "published" else np.sqrt(1.5 * 20.0), rel=1e-6)
    assert least_stable(structure, settings.safe_scr, 1.0 / settings.safe_r_over_x) < 0.0


@pytest.mark.parametrize(("scr", "x_over_r"), [(20.0, 0.3), (20.0, 10.0)])
def test_other_places_are_not(scr: float, x_over_r: float) -> None:
    assert least_stable("angle_damped", scr, x_over_r) > 0.0


def test_the_middle_is_safer_than_the_strongest_grid() -> None:
    """Gains of the strongest grid are too slow on a weak one: there is less than a quarter of the damping left."""
    middle, strongest = (least_stable("angle_damped", scr, np.sqrt(3.0)) for scr in (np.sqrt(30.0), 20.0))
    assert middle < 4.0 * strongest < 0.0


def test_nor_is_a_weaker_one_with_the_published_loops() -> None:
    assert least_stable("published", 5.0, 2.0) > 0.5


def test_a_table_carries_its_safe_place(tmp_path: Path) -> None:
    """In its file, in the settings of its scheduler, and in what is shown of it."""
    found = replace(table("angle_damped"), safe_place=(3.905, 0.9048))
    write_table_file(found, tmp_path / "t.json")
    again = read_table_file(tmp_path / "t.json")
    assert again == found
    assert again.safe_place == (3.905, 0.9048)
    settings = scheduler_of(again).settings
    assert settings.safe_scr == pytest.approx(3.905, rel=1e-6)
    assert settings.safe_r_over_x == pytest.approx(1.0 / 0.9048, rel=1e-6)
    assert safe_place_text(settings) == "SCR 3.905, X/R 0.9048"


def test_what_is_set_by_hand_stays() -> None:
    found = replace(table("angle_damped"), safe_place=(3.905, 0.9048))
    settings = settings_of(found, safe_scr=8.0)
    assert settings.safe_scr == 8.0
    assert settings.safe_r_over_x == pytest.approx(1.0 / 0.9048, rel=1e-6)


def test_a_place_at_the_edge_of_the_table_is_in_the_box_of_single_precision() -> None:
    found = table("angle_damped")
    v = found.validity
    for place in ((v.scr[0], v.x_over_r[1]), (v.scr[1], v.x_over_r[0])):
        settings = settings_of(replace(found, safe_place=place))
        assert settings.safe_scr == pytest.approx(place[0], rel=1e-6)
        assert settings.safe_r_over_x == pytest.approx(1.0 / place[1], rel=1e-6)


def test_a_table_of_before_keeps_its_bytes_and_its_place() -> None:
    old = table("angle_damped")
    assert "safe_place" not in table_document(old)
    assert settings_of(old).safe_scr == pytest.approx(np.sqrt(30.0), rel=1e-6)
    assert lacks_safe_place(old)
    assert not lacks_safe_place(table("published"))
    assert not lacks_safe_place(replace(old, safe_place=(3.0, 1.0)))


@pytest.mark.parametrize(
    ("place", "problem"),
    [
        ((0.5, 1.0), r"safe_place: SCR 0\.5 is outside of the validity, 1\.5 to 20"),
        ((3.0, 99.0), r"safe_place: X/R 99 is outside of the validity, 0\.3 to 10"),
        ((float("nan"), 1.0), "safe_place: must be two numbers, SCR and X/R"),
        ((3.0,), "safe_place: must be two numbers, SCR and X/R"),
        ("3.0", "safe_place: must be two numbers, SCR and X/R"),
    ],
)
def test_a_place_that_is_none_is_refused(tmp_path: Path, place: Any, problem: str) -> None:
    with pytest.raises(ArtifactError, match=problem):
        write_table_file(replace(table("angle_damped"), safe_place=place), tmp_path / "t.json")
