"""What one takes away: the study as a file, the figures, the data; and that they say what the page shows."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from tests.explore.browser.explorer import Explorer, ExplorerPage
from vsgdesign.study.parameters import load_study

MINUS = "−"


def test_a_saved_study_is_read_again(explorer: Explorer, opened: ExplorerPage) -> None:
    page = opened.page
    opened.page.click(opened.place(0.7, 0.3).point)
    page.type(opened.field("P_pu"), "1.5")
    page.type(opened.field("power_loops.P_droop"), "4")
    opened.settle()
    page.click("#save")
    path = page.downloaded(f"{explorer.session.info()['study']['name']}-explored.toml")
    study, changes = load_study(path), opened.changes()
    converter = study.converter
    assert study.simulation.P_ref == pytest.approx(changes["P_pu"] * converter.S_rated)
    assert study.target.P_droop == pytest.approx(0.04)
    X = converter.omega_n * study.grid.L_g
    assert X / study.grid.R_g == pytest.approx(changes["x_over_r"], rel=1e-6)
    # One file has one P_ref and one Q_ref; with its other droops the published structure needs others.
    assert [spec.name for spec in study.controllers] == ["decoupled", "angle_damped"]
    assert "published is left out" in path.read_text(encoding="utf-8")


def test_figures_and_data_are_downloaded(explorer: Explorer, opened: ExplorerPage) -> None:
    page = opened.page
    page.click(opened.place(0.6, 0.4).point)
    opened.settle()
    for choice in ("svg", "png", "csv"):
        page.click("#downloads summary")
        page.click(f"#{choice}")
        page.downloaded(f"structures_explore.{choice}")
    svg = ElementTree.parse(page.downloaded("structures_explore.svg")).getroot()
    words = " ".join("".join(text.itertext()) for text in svg.iter("{http://www.w3.org/2000/svg}text"))
    assert all(name in words for name in ("published", "decoupled", "angle_damped", "SCR", "real part"))
    assert len(list(svg.iter("{http://www.w3.org/2000/svg}path"))) > 20
    with Image.open(page.downloaded("structures_explore.png")) as image:
        assert image.width >= 1200
        assert len(image.convert("RGB").getcolors(1 << 24) or []) > 50
    first, text = page.downloaded("structures_explore.csv").read_text(encoding="utf-8").split("\n", 1)
    assert first.startswith("# state: {")
    rows = list(csv.DictReader(io.StringIO(text)))
    state = explorer.state(**opened.changes())
    answer = explorer.session.answer("emt", state, lambda: False)
    assert answer is not None
    for k, one in enumerate(answer.header["controllers"]):
        taken = [row for row in rows if (row["figure"], row["controller"]) == ("EMT", one["name"])]
        P = [float(row["value"]) for row in taken if row["quantity"] == "P"]
        np.testing.assert_allclose(P, np.asarray(answer.arrays[f"{k}/P"], dtype="<f4"), rtol=1e-6)


COLUMNS = {
    "Margins: disk out": ("linear", "disk_margin_output", 2, 1.0),
    "Margins: disk in": ("linear", "disk_margin_input", 2, 1.0),
    "Margins: gain P dB": ("linear", "gain_margin_db", 1, 1.0),
    "Margins: phase P °": ("linear", "phase_margin_deg", 0, 1.0),
    "Margins: gain Q dB": ("linear", "gain_margin_Q_db", 1, 1.0),
    "Margins: phase Q °": ("linear", "phase_margin_Q_deg", 0, 1.0),
    "Margins: Mₛ": ("linear", "M_s", 2, 1.0),
    "Linear: ζ": ("linear", "damping_all_modes", 2, 1.0),
    "Linear: settles s": ("linear", "settling_s", 2, 1.0),
    "Linear: over %": ("linear", "overshoot", 1, 100.0),
    "EMT: settles s": ("emt", "settling_s", 2, 1.0),
    "EMT: over %": ("emt", "overshoot", 1, 100.0),
    "EMT: peak i pu": ("emt", "peak_pu", 2, 1.0),
    "Droop, inertia: H s": ("linear", "H_s", 2, 1.0),
}
"""Columns of the page's table: which answer has the figure, its place there, printed digits, and a factor."""
NONE = ("–", "none")


def figure_of(answers: Mapping[str, Mapping[str, Any]], kind: str, path: str) -> float | None:
    """A figure of one controller's answers."""
    found: Any = answers[kind]
    for name in path.split("."):
        found = found[name]
    return found


def test_the_printed_figures_are_those_of_the_answers(explorer: Explorer, opened: ExplorerPage) -> None:
    rng, compared = np.random.default_rng(16), 0
    for _ in range(5):
        changes = {
            "scr": round(float(np.exp(rng.uniform(np.log(2.0), np.log(18.0)))), 2),
            "x_over_r": round(float(np.exp(rng.uniform(np.log(0.4), np.log(8.0)))), 2),
            "P_pu": round(float(rng.uniform(-0.9, 0.9)), 2),
            "Q_pu": round(float(rng.uniform(-0.4, 0.4)), 2),
            "error_R": round(float(rng.uniform(-0.2, 0.2)), 2),
        }
        before = opened.counts()
        opened.page.evaluate(f"location.hash = {explorer.link(**changes).partition('#')[2]!r}")
        opened.redrawn(before, "linear", "emt")
        state, table = explorer.state(**changes), opened.table()
        answers = [explorer.header(kind, state)["controllers"] for kind in ("linear", "emt")]
        for linear, emt in zip(*answers, strict=True):
            row = table[linear["name"]]
            for column, (kind, path, digits, factor) in COLUMNS.items():
                if not linear["modes"]:
                    assert row[column] in NONE, "there is no figure where there is no operating point"
                    continue
                value = figure_of({"linear": linear, "emt": emt}, kind, path)
                if value is None or not np.isfinite(value):
                    assert row[column] in NONE, (changes, linear["name"], column)
                    continue
                # Half a digit, and no more: JavaScript and Python round a tie differently.
                shown = float(row[column].replace("−", "-"))
                assert abs(shown - factor * value) <= 0.5 * 10.0**-digits * (1.0 + 1e-9), (
                    changes,
                    linear["name"],
                    column,
                )
                assert len(row[column].partition(".")[2]) == digits
                compared += 1
    assert compared > 100
