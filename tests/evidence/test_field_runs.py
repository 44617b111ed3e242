"""One draw of each kind through the EMT: the figures that the evidence is made of, on a small seeded sample."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from evidence._field_converters import bridge_phasors, converter_named, references, rest_at
from evidence._field_draws import field_draw
from evidence._field_runs import run_field, simulate_field, study_of
from evidence._field_survival_draws import survival_draw
from evidence._field_survival_runs import VARIANTS, Task, run_survival
from evidence._kept_runs import kept_runs
from evidence.field_survival import asked_table, figures, kinds_table, lost_lines, pairs_of

NAME = "1 MVA"
"""The fastest to simulate: 6 kHz."""


def test_a_run_and_what_is_kept_of_it(tmp_path: Path) -> None:
    converter = converter_named(NAME)
    draws = [field_draw(converter, group, 1) for group in ("rest", "jump")]
    rows = kept_runs(run_field, draws, tmp_path / "runs.jsonl", "test", workers=1)
    rest, jump = rows
    assert len(rest["rest"]) >= 10
    assert len(jump["after"]) == 60
    assert "found_s" in jump
    # A second call finds them again, also after a line that was not written to its end.
    path = tmp_path / "runs.jsonl"
    text = path.read_text()
    path.write_text(text[:-30])
    again = kept_runs(run_field, draws, path, "test", workers=1)
    assert again[0] == json.loads(json.dumps(rest))
    assert {key: again[1][key] for key in jump if key != "seconds"} == {k: v for k, v in jump.items() if k != "seconds"}


def test_the_estimator_finds_the_grid_and_the_draw_rests_where_it_says() -> None:
    """With next to no noise, within 5 %. The bridge's current in the EMT is the one that the draw was checked with."""
    converter = converter_named(NAME)
    draw = dataclasses.replace(field_draw(converter, "rest", 2), duration_s=3.0)
    quiet = dataclasses.replace(draw.surroundings, background="clean", noise=1e-5)
    study = study_of(converter, dataclasses.replace(draw, surroundings=quiet))
    simulation, answers = simulate_field(converter, study)
    assert answers.valid[-50:].all()
    assert answers.error[-50:].max() < 0.05
    log, c = simulation.log[-10:], converter.study.converter
    point = rest_at(converter, draw.start, *references(converter, draw.start))
    i_s = (log[:, 0] ** 2 + log[:, 1] ** 2) ** 0.5 / c.I_rated_pk
    asked = abs(bridge_phasors(converter, point)[0]) * 2.0**0.5 / c.I_rated_pk
    # The ripple of the current at the samples, and the probe.
    assert i_s.mean() == pytest.approx(asked, abs=0.05)


def test_a_pair_of_survival_runs() -> None:
    """The run with the truth would compile another loop: the same figures stand for it."""
    with_estimate = run_survival(Task(survival_draw(converter_named(NAME), 9), "field"))
    rows = [with_estimate, with_estimate | {"variant": "truth"}]
    assert {row["variant"] for row in rows} == set(VARIANTS)
    (pair,) = pairs_of(rows)
    found = figures([pair])
    assert found["pairs"] == 1
    assert found["survived"] == found["survived_truth"]
    assert pair.field["longest_silence_s"] >= 0.0
    assert len(asked_table([pair])) > 10
    assert len(kinds_table([pair])) == 3
    assert len(lost_lines([pair])) == 1 - found["survived"]
    assert pairs_of(rows[:1]) == []
