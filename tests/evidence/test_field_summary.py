"""Tables of the field estimator, on made-up runs whose figures are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from evidence.__main__ import paste
from evidence._field_draws import field_draw
from evidence._field_runs import KEPT, STRIDE, converter_of, figures_of
from evidence._field_summary import (
    asked_table,
    at_rest,
    bins_table,
    covered_from,
    error_quantiles,
    errors,
    errors_since,
    found_of_bin,
    quantile,
    times_to_find,
)
from vsgdesign.metrics.answers import Answers

Row = dict[str, Any]


def rest_row(scr: float, off: float, **changed: Any) -> Row:
    """40 answers at rest, each off by ``off`` in R and as much in X; of the last, half are not inside."""
    rest = [[off, off, 0.6, 1.0, float(k < 38)] for k in range(40)]
    row = {
        "group": "rest",
        "converter": "A",
        "scr": [scr, scr],
        "x_over_r": [2.0, 2.0],
        "duration_s": 60.0,
        "rest": rest,
        "false_changes": 0,
        "worst": off,
        "wrong_s": 0.0,
        "share_valid": 1.0,
        "longest_silence_s": 0.0,
    }
    return row | changed


def jump_row(found_s: float | None, valid: int, **changed: Any) -> Row:
    """After a jump: ``valid`` answers that are, the first of them 50 % off and outside its ellipse."""
    after = [[0.5 if k == 0 else 0.05, float(k < valid), float(k > 0)] for k in range(30)]
    row = {
        "group": "jump",
        "converter": "A",
        "scr": [2.0, 10.0],
        "x_over_r": [2.0, 2.0],
        "duration_s": 2.7,
        "after": after,
        "found_s": found_s,
        "false_changes": 0,
        "worst": 0.05,
        "wrong_s": 0.0,
        "longest_silence_s": 0.1,
    }
    return row | changed


def test_a_quantile_is_a_value_that_occurs() -> None:
    assert quantile([3.0, 1.0, 2.0, 4.0], 0.5) == 2.0
    assert quantile([1.0, math.inf], 0.95) == math.inf
    assert quantile(np.arange(1.0, 101.0), 0.95) == 95.0
    assert math.isnan(quantile([], 0.5))


def test_errors_at_rest_are_of_the_vector_and_of_its_parts() -> None:
    rows = [rest_row(2.0, 0.03), rest_row(2.0, 0.01)]
    assert np.unique(np.round(errors(at_rest(rows)), 6)).tolist() == pytest.approx([0.014142, 0.042426], abs=1e-6)
    (one,) = error_quantiles(rows)
    assert (one["scr"], one["x_over_r"], one["answers"]) == ((1.2, 3.0), (1.0, 3.0), 80)
    assert one["R_pct"]["1"] == pytest.approx(100.0 * 0.03 / 0.6)
    assert one["X_pct"]["1"] == pytest.approx(100.0 * 0.03 / 0.8)
    assert one["Z_pct"]["0.5"] == pytest.approx(1.414)


def test_never_found_is_the_longest_time() -> None:
    rows = [jump_row(t, 30) for t in (0.08, 0.12, None)]
    assert times_to_find(rows) == [0.08, 0.12, math.inf]
    assert found_of_bin(rows) == "120 / never (3)"
    assert bins_table(rows, found_of_bin)[-1] == "| 8–20 | – | 120 / never (3) | – | – |"


def test_coverage_is_of_valid_answers_alone() -> None:
    rows = [jump_row(0.1, 30), jump_row(0.1, 0)]
    assert covered_from(rows, 1) == 100.0
    assert covered_from(rows, 0) == pytest.approx(100.0 * 29 / 30)
    first, second = errors_since(rows, 2)
    assert (first["valid_pct"], first["coverage_pct"], first["median_pct"]) == (50.0, 0.0, 50.0)
    assert (second["valid_p95_pct"], second["coverage_pct"]) == (5.0, 100.0)


def test_what_misses_a_figure_is_marked() -> None:
    rows = [rest_row(2.0, 0.01), rest_row(10.0, 0.05, false_changes=1), jump_row(0.09, 30), jump_row(0.3, 30)]
    rows.append(jump_row(0.1, 30, group="grid-side step", worst=0.25, wrong_s=0.05, longest_silence_s=1.5))
    lines, data = asked_table(rows)
    by = {one["what"]: one for one in data}
    weak, strong = (next(one for one in data if text in one["what"]) for text in ("SCR 1.2–8, X/R", "the same, SCR"))
    assert (weak["all"], weak["kept"]) == ("1.4 % (median 1.4 %)", True)
    assert (strong["all"], strong["kept"]) == ("7.1 % (median 7.1 %)", False)
    assert by["coverage of the 95 % ellipse at rest"]["kept"] is True  # 38 of 40
    assert by["false changes at rest"]["all"] == "1 in 2 min"
    assert by["time to stay within 10 % after a jump: median"]["all"] == "90 ms of 2"
    assert by["valid and > 20 % wrong from 40 ms after an event: longest"]["all"] == "50 ms; 1 of 3 runs 20 ms or more"
    assert by["longest silence after an event"]["kept"] is False
    assert by["measured background: coverage at rest"]["kept"] is None
    assert sum("✗" in line for line in lines) == sum(one["kept"] is False for one in data)


def test_figures_of_a_run() -> None:
    """A perfect estimator that is silent for five cycles after the jump, and one that never learns of it."""
    draw = field_draw(converter_of("1 MVA"), "jump", 3)
    (jump_s,) = draw.jumps_s
    t = 0.02 * np.arange(1, int(draw.duration_s / 0.02) + 1, dtype=np.float64)
    Z = np.where(t < jump_s, 1.0 + 2.0j, 0.5 + 1.5j)

    def figures(Z_hat: Any, valid: Any) -> dict[str, Any]:
        n = len(t)
        answers = Answers(
            t_s=t, Z=Z, Z_hat=Z_hat, covariance=np.tile(1e-4 * np.eye(2), (n, 1, 1)), valid=valid,
            changed=np.arange(n) == int(np.flatnonzero(t > jump_s)[5]), end_s=draw.duration_s,
        )  # fmt: skip
        return figures_of(draw, answers, 0.02)

    first = int(np.flatnonzero(t > jump_s)[0])
    good = figures(Z, (np.arange(len(t)) < first) | (np.arange(len(t)) >= first + 5))
    assert good["found_s"] == pytest.approx(t[first + 5] - jump_s)
    assert (good["false_changes"], good["wrong_s"], good["announced"]) == (0, 0.0, True)
    assert good["longest_silence_s"] == pytest.approx(0.1)
    bad = figures(np.full(len(t), 1.0 + 2.0j), np.ones(len(t), dtype=bool))
    assert bad["found_s"] is None
    assert bad["wrong_s"] == pytest.approx(draw.duration_s - jump_s - 0.04)
    assert bad["worst"] == pytest.approx(abs(0.5 + 0.5j) / abs(0.5 + 1.5j))


def test_a_long_rest_counts_no_more_than_others() -> None:
    draw = field_draw(converter_of("5 kVA"), "long rest", 3)
    for cycles, kept in ((300, 20), (3000, 40)):
        t = 0.02 * np.arange(1, cycles + 1, dtype=np.float64)
        Z = np.full(cycles, 1.0 + 1.0j)
        flags = np.ones(cycles, dtype=bool)
        answers = Answers(
            t_s=t, Z=Z, Z_hat=Z, covariance=np.tile(np.eye(2), (cycles, 1, 1)), valid=flags, changed=~flags, end_s=t[-1]
        )
        rest = figures_of(draw, answers, 0.02)["rest"]
        assert len(rest) == pytest.approx(kept, abs=1)
    assert (STRIDE, KEPT) == (10, 40)


def test_tables_are_pasted_between_their_marks(tmp_path: Any) -> None:
    page, other = tmp_path / "a.md", tmp_path / "b.md"
    page.write_text("# A\n<!-- evidence: one -->\nold\n<!-- end of evidence -->\nrest\n")
    other.write_text("# B\n<!-- evidence: two -->\nkept\n<!-- end of evidence -->\n")
    assert paste("one", "| new |\n", tmp_path) == [page]
    assert page.read_text() == "# A\n<!-- evidence: one -->\n\n| new |\n\n<!-- end of evidence -->\nrest\n"
    assert paste("one", "| new |\n", tmp_path) == [page]
    assert page.read_text().count("new") == 1
    assert "kept" in other.read_text()
