"""Measured errors against the error set of a gain table, on made-up errors whose shares are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.gain_tables import table
from vsgdesign.artifacts import GainTable
from vsgdesign.artifacts.measured_errors import MEASURED_FILE, GridBin, JumpInstant, MeasuredErrors, shipped_errors
from vsgdesign.errors import ArtifactError
from vsgdesign.linear.stability.safe_place import inside_run, inside_set, within
from vsgdesign.report.gain_table.words import inside_figure, inside_sentence


def errors_of(R: float, count: int, share: float, size: float = 0.05) -> np.ndarray:
    """``share`` of the errors are ``size`` of |Z| in R alone, the others ten times as much."""
    off = np.where(np.arange(count) < round(share * count), size, 10.0 * size)
    return np.stack([off, np.zeros(count), np.full(count, R)], axis=1)


def measured(jumps: tuple[JumpInstant, ...] = ()) -> MeasuredErrors:
    bins = (
        GridBin((1.5, 5.0), (1.0, 3.0), 10, 500, 0.99, errors_of(0.5, 200, 0.99)),
        GridBin((5.0, 20.0), (1.0, 3.0), 10, 500, 0.99, errors_of(0.5, 200, 0.975)),
        GridBin((1.5, 5.0), (3.0, 10.0), 10, 500, 0.99, errors_of(0.15, 200, 1.0)),
        GridBin((5.0, 20.0), (3.0, 10.0), 1, 10, 0.99, errors_of(0.15, 10, 1.0)),
    )
    return MeasuredErrors(
        estimator="made up", converters=("one",), background="none", runs=31, seed=0, bins=bins, jumps=jumps
    )


def with_errors(error: float, error_Z: float) -> GainTable:
    made = table(scr=(1.5, 5.0, 20.0), x_over_r=(0.3, 1.0, 3.0, 10.0), certificate={"proof": "gap-free", "decay": 1.0})
    return replace(made, validity=replace(made.validity, error=error, error_Z=error_Z))


def test_an_error_is_inside_by_the_larger_of_both_kinds() -> None:
    """5 % of |Z| in R at X/R 10 is 50 % of R: outside ±20 %, inside 6 % of |Z|. At X/R 1 it is 7 % of R."""
    errors = np.array([[0.05, 0.0, 0.0995], [0.05, 0.0, 0.7071], [0.0, 0.19, 0.0995], [np.nan, 0.0, 0.5]])
    assert within(errors, 0.2, 0.0).tolist() == [False, True, True, False]
    assert within(errors, 0.2, 0.06).tolist() == [True, True, True, False]
    assert within(errors, 0.0, 0.06).tolist() == [True, True, False, False]


def test_a_node_has_the_worst_of_its_ranges_and_is_not_known_beyond_them() -> None:
    found = inside_set(with_errors(0.2, 0.06), measured())
    expected = np.array([[np.nan, 0.99, 0.99, 1.0], [np.nan, 0.975, 0.975, 1.0], [np.nan, 0.975, 0.975, np.nan]])
    np.testing.assert_allclose(found.shares, expected)
    assert found.known == 8
    assert found.worst in {(1, 1), (1, 2), (2, 1), (2, 2)}
    assert (found.since, found.settled_s) == ((), None)
    # ±20 % alone: 5 % of |Z| is more than a fifth of R where R is 15 % of |Z|.
    assert inside_set(with_errors(0.2, 0.0), measured()).shares[0, 3] == 0.0


def test_the_reactance_basis_is_looked_up_by_its_impedance() -> None:
    """At X/R 1 an SCR of 7 of the reactance is one of 4.95 of |Z|."""
    made = replace(with_errors(0.2, 0.06), scr=np.array([1.6, 7.0, 20.0]))
    made = replace(made, base=replace(made.base, scr_basis="reactance"))
    assert inside_set(made, measured()).shares[1, 1] == 0.99


def test_a_jump_counts_from_when_the_share_stays() -> None:
    jumps = tuple(
        JumpInstant(t_s, errors_of(0.5, 40, share))
        for t_s, share in ((0.02, 0.1), (0.06, 0.95), (0.1, 0.9), (0.14, 0.975), (0.2, 1.0))
    )
    found = inside_set(with_errors(0.2, 0.06), measured(jumps))
    assert [share for _, share in found.since] == [0.1, 0.95, 0.9, 0.975, 1.0]
    assert found.settled_s == 0.14
    assert inside_set(with_errors(0.2, 0.06), measured(jumps[:3])).settled_s is None
    assert ", and from 0.14 s after a jump (95 % of 40 jumps of the grid)" in inside_sentence(
        with_errors(0.2, 0.06), measured(jumps)
    )
    assert "after 0.1 s it is inside for 90 % of 40 jumps" in inside_sentence(
        with_errors(0.2, 0.06), measured(jumps[:3])
    )


def test_the_sentence_says_what_is_known_and_what_is_not() -> None:
    text = inside_sentence(with_errors(0.2, 0.06), measured())
    assert text.startswith("The estimate is inside the certified set (R and X known to ±20 %, or to ±6 % of |Z|")
    assert "at least 97.5 % of the time at rest (worst node: SCR 5, X/R 1, 200 answers)" in text
    assert "nodes nothing was measured" in text
    assert "not known: no errors were measured" in inside_sentence(with_errors(0.2, 0.06), None)
    assert "designed for an exact estimate" in inside_sentence(with_errors(0.0, 0.0), measured())
    far = replace(with_errors(0.2, 0.06), x_over_r=np.array([0.1, 0.2, 0.3, 0.4]))
    assert "was not measured on its grids" in inside_sentence(far, measured())
    bare = replace(with_errors(0.2, 0.06), certificate=None)
    assert "inside the set that the table was designed for" in inside_sentence(bare, measured())


def test_the_answers_of_a_run_are_held_where_there_is_none() -> None:
    """At X/R 1 and SCR 2: off by 10 % of |Z| in X, exact, none, off by 30 %; before the first there is none."""
    made = with_errors(0.2, 0.12)
    omega, Z = made.base.omega_n, 3.63
    R = np.full(6, Z / np.sqrt(2.0))
    X_hat = R + np.array([np.nan, 0.1, 0.0, np.nan, 0.3, np.nan]) * Z
    R_hat = np.where(np.isnan(X_hat), np.nan, R)
    rest = np.array([True, True, False, False, True, True])
    found = inside_run(made, (R, R / omega), (R_hat, X_hat / omega), rest)
    assert found == (0.25, 0.5)
    assert np.isnan(inside_run(made, (R, R / omega), (R_hat, X_hat / omega), ~np.ones(6, dtype=bool))[0])


def test_the_map_shows_the_shares() -> None:
    named = inside_figure(with_errors(0.2, 0.06), measured())
    assert named is not None
    assert named.name == "table_inside"
    (legend,) = named.figure.legends
    said = [text.get_text() for text in legend.get_texts()]
    assert said == ["at least 95 % of the time", "not known: not measured"]
    assert inside_figure(with_errors(0.2, 0.06), None) is None
    assert inside_figure(with_errors(0.0, 0.0), measured()) is None


def test_the_file_comes_back_and_refuses_what_is_wrong(tmp_path: Path) -> None:
    rows = errors_of(0.5, 3, 1.0)
    rows[1] = np.nan
    made = measured((JumpInstant(0.02, rows),))
    MEASURED_FILE.write(made, tmp_path / "m.json")
    again = MEASURED_FILE.read(tmp_path / "m.json")
    np.testing.assert_array_equal(again.jumps[0].errors, rows)
    np.testing.assert_array_equal(again.bins[1].errors, made.bins[1].errors)
    assert (again.estimator, again.bins[0].scr, again.converters) == ("made up", (1.5, 5.0), ("one",))
    wrong = replace(made, bins=(replace(made.bins[0], scr=(5.0, 1.5), valid=2.0),), jumps=made.jumps * 2)
    with pytest.raises(ArtifactError) as caught:
        MEASURED_FILE.write(wrong, tmp_path / "wrong.json")
    for part in ("bins[0].scr: 5 1.5", "bins[0].valid: 2", "t_s must increase"):
        assert part in str(caught.value)
    text = (tmp_path / "m.json").read_text().replace("0.05", "0.04", 1)
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(ArtifactError, match="does not match its sha256"):
        MEASURED_FILE.read(tmp_path / "m.json")


def test_what_the_package_ships_can_be_read() -> None:
    found = shipped_errors()
    if found is not None:
        assert found.bins
        assert found.runs > 0
