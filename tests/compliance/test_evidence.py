"""The CSV of a trace: every number back to its last digit, readable by any tool, refused where it is not one."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsgdesign.campaigns.compliance import evidence as module
from vsgdesign.campaigns.compliance.evidence import (
    SIGNALS,
    Evidence,
    csv_path,
    figure_path,
    figures_of,
    limits_at,
    read_evidence,
    slug,
    write_evidence,
)
from vsgdesign.campaigns.compliance.measuring import Trace
from vsgdesign.campaigns.compliance.rows import FAIL, PASS
from vsgdesign.errors import ArtifactError


def made(n: int = 500, **others: np.ndarray) -> Trace:
    rng = np.random.default_rng(5)
    columns: dict[str, Any] = {name: rng.normal(size=n) * 10.0 ** rng.uniform(-5, 3) for name in SIGNALS}
    columns |= {"t_s": np.arange(n) * 5e-4} | others
    return Trace(**columns)


def evidence(trace: Trace) -> Evidence:
    limits = limits_at(trace.t_s, "P_pu", np.array([0.01, 0.2]), np.array([0.0, -1.0]), np.array([1.0, 2.0]))
    return Evidence(trace=trace, limits=(limits,))


@pytest.mark.parametrize("name", ["trace.csv", "trace.csv.gz"])
def test_a_trace_comes_back_to_a_millionth(tmp_path: Path, name: str) -> None:
    given = evidence(made())
    write_evidence(tmp_path / name, given)
    found = read_evidence(tmp_path / name)
    for signal in SIGNALS:
        assert np.abs(getattr(found.trace, signal) - getattr(given.trace, signal)).max() <= 0.5001e-6
    assert found.limits[0].signal == "P_pu"
    np.testing.assert_allclose(found.limits[0].high, given.limits[0].high, atol=1e-6)
    # Outside of the time of an envelope there is none.
    assert np.isnan(found.limits[0].low[0])
    assert np.isnan(found.limits[0].low[-1])


def test_numbers_are_read_as_python_reads_them() -> None:
    rng = np.random.default_rng(8)
    digits = rng.integers(0, 10**12, size=(400, 9)).tolist()
    texts = [[f"{'-' * (k % 3 == 0)}{str(one)[: 1 + k % 5]}.{str(one)[3:].ljust(8, '0')[: 1 + n % 8]}"
              for n, one in enumerate(row)] for k, row in enumerate(digits)]  # fmt: skip
    texts[0][7] = texts[5][2] = "nan"
    texts += [["nan", "-inf", "inf"] * 3, [f"-0.{'0' * (1 + n % 8)}" for n in range(8)] + ["-nan"]]
    body = "".join(",".join(row) + "\n" for row in texts).encode()
    numbers = np.array([list(map(float, row)) for row in texts])
    for chosen in (range(9), [0, 3, 8], [7]):
        found = module._plain_numbers(body, 9, chosen)
        assert found is not None
        assert found.tobytes() == numbers.T[list(chosen)].tobytes()


@pytest.mark.parametrize(
    "row",
    [
        "1.0,2",
        "1nan,2.0",
        "nano,2.0",
        "1.0,ina",
        "1.0,n",
        "1.0,2e3",
        "1.0;2.0",
        "1.0,2.0,3.0",
        ".5,1.0",
        "--1.0,2.0",
        "1.,2.0",
    ],
)
def test_another_text_is_left_to_the_usual_reader(row: str) -> None:
    assert module._plain_numbers(f"1.0,2.0\n{row}\n".encode(), 2, [0, 1]) is None
    assert module._plain_numbers(b"1.0,2.0\n3.0,4.0", 2, [0, 1]) is None


def test_columns_that_are_not_asked_for_are_not_read(tmp_path: Path) -> None:
    given = evidence(made(40))
    write_evidence(tmp_path / "t.csv", given)
    whole, some = read_evidence(tmp_path / "t.csv"), read_evidence(tmp_path / "t.csv", ["f_hz"])
    for name in SIGNALS:  # P has limits
        same = getattr(whole.trace, name) if name in ("t_s", "f_hz", "P_pu") else np.full(40, np.nan)
        np.testing.assert_array_equal(getattr(some.trace, name), same)
    np.testing.assert_array_equal(some.limits[0].low, whole.limits[0].low)


def test_another_reader_reads_the_same_numbers(tmp_path: Path) -> None:
    hard = np.array([0.0, -0.0, 9.9999999, -9.9999996, 1e-7, -4e-7, 0.1, -123.456789, 5e8, np.nan])
    trace = made(len(hard), P_pu=hard, Q_pu=hard * 1e6, V_pu=np.full(len(hard), np.inf))
    write_evidence(tmp_path / "t.csv", Evidence(trace=trace))
    with (tmp_path / "t.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    read = np.array([float(row["P_pu [pu]"]) for row in rows])
    np.testing.assert_allclose(read, hard, rtol=0.0, atol=0.51e-6)
    assert not any(text.startswith("-") for text in (rows[1]["P_pu [pu]"], rows[5]["P_pu [pu]"]))
    np.testing.assert_allclose([float(row["Q_pu [pu]"]) for row in rows], 1e6 * hard, rtol=1e-8)
    assert all(row["V_pu [pu]"] == "inf" for row in rows)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_s [s],P_pu [pu]\n0,1\n", "there is no column Q_pu"),
        (",".join(SIGNALS) + "\n0,1\n", "the header has"),
        (",".join(SIGNALS) + "\n" + ",".join(["x"] * len(SIGNALS)), "could not convert"),
        ("", "there is no column t_s"),
    ],
)
def test_what_is_no_trace_is_refused_with_its_reason(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ArtifactError, match=said):
        read_evidence(tmp_path / "t.csv")


def test_a_trace_without_rows_is_empty(tmp_path: Path) -> None:
    write_evidence(tmp_path / "t.csv", Evidence(trace=made(0)))
    assert len(read_evidence(tmp_path / "t.csv").trace.t_s) == 0


def test_names_of_files_are_plain_and_apart() -> None:
    assert slug("own", "phase +60 deg, SCR 20, X/R 10") != slug("own", "phase -60 deg, SCR 20, X/R 10")
    assert csv_path("own", "Δθ = 30°, X/R 0.5", "OPT-ANN").startswith("traces/own-30-x-r-0.5-opt-ann-")
    assert slug("a b", "c") != slug("a", "b c")
    assert len(slug("x" * 500)) < 100
    assert slug("../../etc") == "etc-" + slug("../../etc")[-8:]


def test_the_failures_of_the_best_controller_have_a_figure_first(monkeypatch: pytest.MonkeyPatch) -> None:
    def row(test: str, controller: str, verdict: str, csv: str | None = "t.csv") -> dict[str, Any]:
        return {"suite": "s", "test": test, "controller": controller, "verdict": verdict, "csv": csv}

    rows = [row(f"t{k}", "bad", FAIL) for k in range(5)] + [row(f"t{k}", "good", PASS) for k in range(4)]
    rows += [row("t4", "good", FAIL), row("t5", "bad", FAIL, None)]
    monkeypatch.setattr("vsgdesign.campaigns.compliance.evidence.MOST_FIGURES", 3)
    found = figures_of(rows)
    assert [test for _, test in found] == ["t4", "t0", "t1"]
    assert found["s", "t4"] == figure_path("s", "t4")
    assert figures_of([]) == {}
