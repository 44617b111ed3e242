"""A table's margins against figures from elsewhere, and a check that finds what was done to a table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.gain_tables import PUBLISHED_BASE, table
from vsgdesign.artifacts import read_table_file, write_table_file
from vsgdesign.artifacts.gain_table import GainTable, base_of
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import ArtifactError
from vsgdesign.linear.stability.gain_table import (
    FIGURES,
    check_table,
    compare_tables,
    figure_of,
    largest_difference,
    nominal_margins,
    stale_margins,
)
from vsgdesign.study.parameters import study_from_text

REACTANCE = replace(PUBLISHED_BASE, scr_basis="reactance")
FAST = ("disk_margin_output", "disk_margin_input", "damping_power_loops", "decay_1_s", "H_s")

STUDY = """
base = "case:hoang2025_5kva"
[simulation]
duration = "0.1 s"
P_ref = "2 kW"
Q_ref = "1 kvar"
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""


@pytest.fixture(scope="module")
def checked() -> GainTable:
    """A table with the margins of its own model, two cells on each axis."""
    bare = table(scr=(2.0, 8.0), x_over_r=(0.5, 3.0))
    return replace(bare, margins=nominal_margins(bare))


def test_the_published_closed_form_has_the_figures_of_the_prototype() -> None:
    """Overshoot %, settling s, damping, disk margin of the P step at SCR 2 and 5 × X/R 0.5, 1, 3, reactance basis,
    computed elsewhere to the digits given here."""
    made = table("published", scr=(2.0, 5.0), x_over_r=(0.3, 0.5, 1.0, 3.0), base=REACTANCE)
    found = nominal_margins(made)
    smaller = np.minimum(found["disk_margin_output"], found["disk_margin_input"])
    assert found["overshoot_P_pct"][:, 1:].round() == pytest.approx(np.array([[49, 12, 0], [54, 15, 0]]))
    # The designs that hardly overshoot settle where a flat curve enters the band: a hundredth either way.
    settling = [[3.79, 1.51, 1.58], [4.24, 1.98, 1.22]]
    assert found["settling_P_s"][:, 1:] == pytest.approx(np.array(settling), abs=0.016)
    assert found["damping_power_loops"][:, 1:] == pytest.approx(
        np.array([[0.19, 0.56, 0.97], [0.16, 0.52, 0.90]]), abs=6e-3
    )
    assert smaller[:, 1:] == pytest.approx(np.array([[0.24, 0.69, 1.42], [0.20, 0.63, 1.22]]), abs=6e-3)
    # Unstable at X/R 0.3: it says so, and has no margins.
    assert (found["decay_1_s"][:, 0] < 0.0).all()
    assert np.isnan(smaller[:, 0]).all()


def test_constant_inertia_is_constant_whatever_the_shares() -> None:
    shares = np.array([[0.0, 0.3], [1.0, 0.6]])
    made = table("decoupled", "inertia", (2.0, 8.0), (1.0, 5.0), {"share_P": shares, "share_Q": 1.0 - shares})
    assert nominal_margins(made, ("H_s",))["H_s"] == pytest.approx(np.full((2, 2), 2.0), rel=1e-12)


def test_a_stale_schedule_is_dangerous_where_the_grid_is_weaker_than_it_knows() -> None:
    damping = stale_margins(table(), 1.0, "damping_power_loops")
    assert np.diag(damping) == pytest.approx(np.full(4, 6.6 / (2.0 * np.sqrt(15.8))), rel=1e-9)
    assert (np.diff(damping[0]) < 0.0).all()  # SCR 1.5, gains for ever stronger grids


def test_a_good_table_passes(checked: GainTable) -> None:
    found = check_table(checked)
    assert found.good
    assert found.cells == 4
    assert set(found.largest) == set(FIGURES)
    assert max(found.largest.values()) == 0.0


def test_an_unknown_margin_is_carried_and_named(checked: GainTable) -> None:
    other = replace(checked, margins={"worst_overshoot_P_pct": np.ones((2, 2)), "mine": np.ones((2, 2))})
    assert check_table(other).carried == ("mine", "worst_overshoot_P_pct")
    assert figure_of("worst_overshoot_P_pct").title == "Overshoot of P, worst of the box"
    assert figure_of("mine").title == "mine"


@pytest.mark.parametrize("name", FIGURES)
def test_a_margin_that_is_not_the_models_is_found(checked: GainTable, name: str) -> None:
    margins = {key: values.copy() for key, values in checked.margins.items()}
    margins[name][1, 0] += 0.2 + 0.1 * margins[name][1, 0]
    found = check_table(replace(checked, margins=margins))
    assert [fault for fault in found.faults if f"margins.{name}" in fault and "SCR 8, X/R 0.5" in fault]
    assert len(found.faults) == 1


def test_gains_that_do_not_follow_from_the_columns_are_found(checked: GainTable) -> None:
    K_iq = checked.gains.K_iq.copy()
    K_iq[0, 1] *= 1.0 + 1e-6
    found = check_table(replace(checked, gains=checked.gains._replace(K_iq=K_iq), margins={}))
    stored, made = K_iq[0, 1], checked.gains.K_iq[0, 1]
    assert found.faults == (f"gains.K_iq is {stored:.12g} at SCR 2, X/R 3, the columns give {made:.12g}",)


def test_a_promise_of_an_unstable_cell_is_found() -> None:
    made = table("published", scr=(2.0, 5.0), x_over_r=(0.3, 1.0))
    (fault,) = check_table(made).faults
    assert fault.startswith("status is met at SCR 2, X/R 0.3 and 1 more cell, but the reduced model decays at -0.4")


def test_another_study_is_found() -> None:
    study = study_from_text(STUDY)
    made = table(scr=(2.0, 8.0), x_over_r=(0.5, 3.0), base=base_of(study), study_hash=study.hash)
    assert check_table(made, study).good
    other = replace(made, study_hash="f" * 64, base=replace(made.base, S_rated=6e3, scr_basis="impedance"))
    faults = " ".join(check_table(other, study).faults)
    assert "the table was made for ffffffffffff…" in faults
    assert "base.S_rated is 6000.0, the study has 5000.0" in faults
    assert "scr_basis" not in faults  # a table may have another axis than its study


def test_comparing_interpolates_on_the_first_ones_grids() -> None:
    fine = table(scr=(2.0, 4.0, 8.0), x_over_r=(0.5, 3.0))
    coarse = table(scr=(1.0, 10.0), x_over_r=(0.3, 5.0), name="coarse")
    published = table("published", scr=(2.0, 8.0), x_over_r=(0.5, 3.0), name="published")
    a, b, c = compare_tables([fine, coarse, published], ["a", "b", "c"])
    # Constant columns: another table of them is the same design.
    for one, other in zip(a.gains, b.gains, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    assert c.gains.K_pq.shape == (3, 2)
    assert a.worst("disk_margin_output") == a.margins["disk_margin_output"].min()
    assert a.worst("overshoot_P_pct") == a.margins["overshoot_P_pct"].max()
    difference, i, j = largest_difference(a.margins, c.margins, "overshoot_P_pct") or (0.0, -1, -1)
    assert difference > 40.0  # X/R 0.5: about 50 against 1 %
    assert j == 0
    assert difference == c.margins["overshoot_P_pct"][i, 0] - a.margins["overshoot_P_pct"][i, 0]
    missing = {"x": np.full((2, 2), np.nan)}
    assert largest_difference(missing, missing, "x") is None


def test_tables_of_two_systems_are_not_compared() -> None:
    """Tables of two studies often have one name, that of their controllers."""
    other = table(base=replace(PUBLISHED_BASE, L_2=1e-3))
    with pytest.raises(ArtifactError, match=r"(?s)a\.json and b\.json are .* base\.L_2 is 0\.0, b\.json has 0\.001"):
        compare_tables([table(), other], ["a.json", "b.json"])


def test_no_cell_that_can_be_analysed() -> None:
    made = table(scr=(2.0, 5.0), x_over_r=(0.5, 3.0))
    nothing = replace(made, gains=PowerLoopGains(*[np.full((2, 2), np.nan)] * 8))
    assert all(np.isnan(values).all() for values in nominal_margins(nothing, FAST).values())


def test_a_design_for_other_powers_where_the_design_point_does_not_exist(tmp_path: Path) -> None:
    """The file takes it without gains there, the check does not mistake it for a fault, but finds a gain forgotten."""
    weak = table(scr=(0.3, 2.0), x_over_r=(1.0, 20.0))
    assert weak.valid.tolist() == [[True, False], [True, True]]
    designed = replace(weak, status=np.full((2, 2), "met"), price=np.zeros((2, 2)), specification={})
    designed = replace(designed, margins=nominal_margins(designed))
    write_table_file(designed, tmp_path / "t.json")
    assert check_table(read_table_file(tmp_path / "t.json")).good
    K_ip = np.where(np.arange(4).reshape(2, 2) == 2, np.nan, designed.gains.K_ip)
    (fault,) = check_table(replace(designed, gains=designed.gains._replace(K_ip=K_ip), margins={})).faults
    assert fault.startswith("gains.K_ip is nan at SCR 2, X/R 1, the columns give 0.00")
