"""The explorer's maps against the linear answer, the EMT and the package's own functions, cell by cell."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.report.explore import maps
from vsgdesign.report.explore.linear import linear_answer
from vsgdesign.report.explore.live import emt_answer
from vsgdesign.report.explore.maps import figures_of, map_answer, map_axes, map_figures
from vsgdesign.report.explore.state import FIGURES, defaults, state_of
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study

LINEAR = {"damping_all_modes": 1e-6, "decay": 1e-6, "settling_s": 2e-3, "overshoot": 2e-3}
"""Relative tolerances: a map reads a step at 500 instants instead of 4000."""


@pytest.fixture(params=["structures", "utility"])
def study(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Study:
    monkeypatch.setattr(maps, "COUNTS", (5, 4))
    return load_study(f"studies/{request.param}/study.toml")


def documents() -> list[dict[str, Any]]:
    return [
        {"P_pu": 0.4, "Q_pu": 0.1, "error_R": 0.1, "error_X": -0.1},
        {"P_pu": 0.7, "hold": {"scr": 8.0, "x_over_r": 2.0}},
    ]


@pytest.mark.parametrize("document", documents(), ids=["scheduled", "held"])
def test_a_cell_is_the_linear_answer(study: Study, document: dict[str, Any]) -> None:
    rng = np.random.default_rng(5)
    for figure in ("disk_margin_output", *LINEAR):
        state = state_of(document | {"figure": figure}, study)
        answer = map_answer(study, NOTHING, state)
        scr, ratio, values = (answer.arrays[name] for name in ("scr", "x_over_r", "values"))
        unit = 100.0 if figure == "overshoot" else 1.0
        for _ in range(2):
            i, j = int(rng.integers(len(ratio))), int(rng.integers(len(scr)))
            at = replace(state, scr=float(scr[j]), x_over_r=float(ratio[i]))
            row = linear_answer(study, NOTHING, at).header["controllers"][-1]
            if row["why"] is not None:
                assert np.isnan(values[i, j])
            elif not row["stable"]:
                assert values[i, j] == -np.inf
                assert answer.arrays["unstable"][i, j] == 1.0
            elif figure == "disk_margin_output":
                assert values[i, j] == pytest.approx(row["disk_margin_output"], rel=1e-6)
            else:
                expected = np.inf if row[figure] is None else row[figure] * unit
                assert values[i, j] == pytest.approx(expected, rel=LINEAR[figure], abs=0.02)


@pytest.mark.parametrize(
    "event",
    [{"kind": "phase", "size": 60.0}, {"kind": "sag", "size": 0.6, "length_s": 0.2}, {"kind": "step", "size": 0.1}],
    ids=["phase", "sag", "step"],
)
def test_survived_is_the_verdict_of_one_run(event: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Random cells of each verdict are simulated one by one as the page's EMT."""
    monkeypatch.setattr(maps, "COUNTS", (12, 8))
    study = load_study("studies/structures/study.toml")
    document = {"figure": "survived", "event": event, "controllers": ["published"], "P_pu": 0.4}
    document["hold"] = {"scr": 10.0, "x_over_r": 3.0}
    state = state_of(document, study)
    answer = map_answer(study, NOTHING, state)
    scr, ratio, values = (answer.arrays[name] for name in ("scr", "x_over_r", "values"))
    lost, kept = (np.argwhere(values == verdict) for verdict in (0.0, 1.0))
    rng = np.random.default_rng(3)
    chosen = [rng.choice(cells, size=min(len(cells), 2), replace=False) for cells in (lost, kept)]
    assert len(kept) > 3
    for i, j in np.concatenate(chosen).tolist():
        at = replace(state, scr=float(scr[j]), x_over_r=float(ratio[i]))
        found = emt_answer(study, NOTHING, at, lambda: False)
        assert found is not None
        status = found.header["controllers"][0]["status"]
        if status != "window too short":  # the page shows 2 s, the map waits longer
            assert (status in ("survived", "settled")) == (values[i, j] == 1.0), (status, at.scr, at.x_over_r)


def test_no_point_and_counts(study: Study) -> None:
    state = state_of({"P_pu": 1.0, "figure": "damping_all_modes"}, study)
    answer = map_answer(study, NOTHING, state)
    counts, values = answer.header["counts"], answer.arrays["values"]
    assert counts["cells"] == values.size == 20
    assert counts["no_point"] == np.isnan(values).sum()
    assert counts["unstable"] == np.isneginf(values).sum() == answer.arrays["unstable"].sum()
    assert counts["stable"] == np.isfinite(values).sum()
    use = answer.arrays["limit_use"]
    assert (np.isnan(use) | (use > 0.9))[np.isnan(values)].all()


def test_an_empty_map_says_why(study: Study) -> None:
    event = {"kind": "grid", "to_scr": 0.05, "to_x_over_r": 5.0}
    answer = map_answer(study, NOTHING, state_of({"figure": "survived", "event": event, "P_pu": 0.9}, study))
    assert np.isnan(answer.arrays["values"]).all()
    assert answer.header["why"].startswith("No grid of the map has a steady state before and after the event")


def test_a_map_without_a_table_says_why() -> None:
    study = load_study("studies/table/study.toml")
    answer = map_answer(study, NOTHING, state_of({"map_of": "table"}, study))
    assert "its gain table is missing" in answer.header["why"]
    assert np.isnan(answer.arrays["values"]).all()


@pytest.mark.parametrize("name", ["structures", "published", "inertia", "laboratory"])
def test_figures_and_axes_of_any_study(name: str) -> None:
    study = load_study(f"studies/{name}/study.toml")
    assert [row["name"] for row in figures_of(study)] == list(FIGURES)
    for row in figures_of(study):
        assert row["low"] < row["high"]
        assert row["better"] in ("high", "low")
    at = defaults(study)
    for (low, high), value in zip(map_axes(study), (at["scr"], at["x_over_r"]), strict=True):
        assert low < value < high


def test_the_damping_of_every_mode_is_judged_by_the_gate_of_every_mode() -> None:
    """A specification's damping ratio is a promise of the power loops; the page called nodes that keep it red."""
    study = load_study("studies/table/study.toml")
    assert study.specification is not None
    promised = {figure.name: figure.promise for figure in map_figures(study)}
    assert promised["damping_all_modes"] == study.stability.gates.damping_ratio == 0.3
    assert study.specification.damping_ratio == 0.5
    assert promised["disk_margin_output"] == study.specification.disk_margin
