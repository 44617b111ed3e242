"""One sentence about a certificate, the same on every page and verb, a failed proof first."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.cli.small_studies import call
from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.certificate_record import StaticLimits, certificate_record
from vsgdesign.artifacts.table_text import (
    between_text,
    certificate_sentence,
    certificate_summary,
    error_text,
    table_lines,
)
from vsgdesign.certificate.results import Counterexample, growing_mode
from vsgdesign.export import export_c_files
from vsgdesign.report.gain_table import page as table_page
from vsgdesign.report.gain_table.maps import certificate_figure
from vsgdesign.report.gain_table.page import verdict_of
from vsgdesign.report.gain_table.words import built_text

REGION = {"scr": [2.0, 8.0], "x_over_r": [0.3, 3.0], "P": [-4500.0, 4500.0], "Q": [-2e3, 2e3], "error": 0.2}
CELL = {"scr": 2.0, "x_over_r": 0.3, "P": -2500.0, "Q": 1000.0, "error_R": -0.2, "error_L": 0.0}
PROVED = {"certified": True, "region": REGION, "decay": 2.15, "checked": 40, "fresh": 2, "gap": {"share": 0.0}}
DOCUMENTS: dict[str, Any] = {
    "none": None,
    "gap-free": PROVED | {"proof": "gap-free"},
    "gridded": PROVED | {"proof": "gridded", "gap": {"share": 0.25}},
    "slow": PROVED | {"proof": "gap-free", "region": REGION | {"rate": 0.05}},
    "unstable": {"certified": False, "region": REGION, "eigenvalue": {"real": 0.5, "imag": -6.0}, **CELL},
    "no function": {
        "certified": False,
        "region": REGION,
        "reason": "No common function exists.",
        "slowest": CELL | {"decay": 0.4},
    },
}
CASES = {name: None if said is None else certificate_record(said) for name, said in DOCUMENTS.items()}
SAYS = {
    "none": "There is no certificate: no proof was made for this table.",
    "gap-free": "Certified, gap-free (every point of the region is proved). Over SCR 2 to 8, X/R 0.3 to 3, "
    "P −4.5 to 4.5 kW, Q −2 to 2 kvar, R_g and L_g known to ±20 %, within the static limits of V and power transfer "
    "alone, one quadratic Lyapunov function decays at 2.15 1/s or faster, whatever the speed of change (power loops; "
    "ideal inner loops, no power filters).",
    "gridded": "Certified on a grid only, not gap-free (verified at 42 points, not between them; 75 % of the region is "
    "proved on boxes).",
    "slow": "a quadratic Lyapunov function that follows the grid decays at 2.15 1/s or faster, while SCR and X/R "
    "change by no more than 5 % per second each",
    "unstable": "the power loops are unstable at SCR 2, X/R 0.3, P −2.5 kW, Q 1 kvar, with an estimate of R_g that is "
    "20 % too small and of L_g that is exact. The eigenvalue is 0.5 ± 6j 1/s: a disturbance grows, e-fold in 2 s.",
    "no function": "No common function exists. The slowest cell is SCR 2, X/R 0.3, P −2.5 kW",
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_said(case: str) -> None:
    assert SAYS[case] in certificate_sentence(CASES[case])
    assert certificate_summary(CASES[case])["certified"] is {"none": None}.get(
        case, case not in ("unstable", "no function")
    )


@pytest.mark.parametrize("case", CASES)
def test_every_page_and_verb_says_the_same_and_a_failed_proof_first(
    tmp_path: Path, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of the page's figures only that of the certificate speaks of it.
    for others in ("margin_figures", "gain_surfaces", "constraint_figures", "stale_figures"):
        monkeypatch.setattr(table_page, others, lambda _: ())
    sentence, failed = certificate_sentence(CASES[case]), case in ("unstable", "no function")
    between = {"points": 50, "outside": 1, "promised": 40, "broken": [], "seed": 3}
    made = table(scr=(2.0, 8.0), x_over_r=(0.5, 3.0), certificate=DOCUMENTS[case], between=between)
    write_table_file(made, tmp_path / "t.json")
    shown = call("table", "show", tmp_path / "t.json").stdout
    summary = certificate_summary(CASES[case])
    built = built_text(
        {
            "file": "t.json",
            "table": {"name": "t", "scr": [1.0], "x_over_r": [1.0], "sha256": "0"},
            "added": [],
            "certificate": summary,
            "cells": {"met": 1},
            "relaxed": [],
            "between": between,
            "causes": [],
        }
    )
    run = "\n".join(
        table_lines(
            "t",
            {
                "certificate": summary,
                "nodes": [2, 2],
                "status": {"met": 4},
                "between": between,
                "causes": [],
                "not_of_this_study": [],
            },
        )
    )
    page = verdict_of(made)
    c = (export_c_files(tmp_path / "t.json", tmp_path / "c").folder / "INTEGRATION.md").read_text(encoding="utf-8")
    report = call("table", "report", tmp_path / "t.json", "--out", tmp_path / "page", "--json")
    assert json.loads(report.stdout)["certificate"]["text"] == sentence
    written = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    plain = html.unescape(re.sub(r"<i>(.*?)</i><sub>(.*?)</sub>", r"\1_\2", written))
    for said in (shown, built, run, page, c, plain):
        assert sentence in said
    for said in (built, run):
        assert said.startswith(f"t: {sentence}") is failed
    for said in (shown, page):
        assert said.startswith(sentence) is failed
    for said in (shown, built, run):
        assert between_text(between) in said
    assert "between nodes: 50 random grids, 1 outside the static limits, 40 promised, 0 broken" in shown.replace(
        "B", "b"
    )


def test_a_region_without_a_proof_is_not_drawn_as_certified() -> None:
    made = table(scr=(2.0, 8.0), x_over_r=(0.5, 3.0), certificate=DOCUMENTS["unstable"])
    found = certificate_figure(made)
    assert found is not None
    assert found.title == "Region without a proof"
    texts = [text.get_text() for legend in found.figure.legends for text in legend.get_texts()]
    assert "not certified" in texts
    assert "counterexample: unstable" in texts
    assert not any(text.startswith("certified") for text in texts)


def test_the_document_of_a_counterexample_is_understood() -> None:
    """What the search hands over, not a dictionary that this page made up."""
    import numpy as np

    from vsgdesign.certificate import Region

    A = np.array([[0.5, 6.0, 0.0], [-6.0, 0.5, 0.0], [0.0, 0.0, -3.0]])
    value, trajectory = growing_mode(A, np.ones(3))
    region = Region((2.0, 8.0), (0.3, 3.0), (-4500.0, 4500.0), (-2e3, 2e3), 0.2)
    found = Counterexample(
        controller="mine",
        region=region,
        limits=StaticLimits(V_low=0.85, V_high=1.25, power_transfer=1.3),
        scr=2.0,
        x_over_r=0.3,
        P=-2500.0,
        Q=1000.0,
        error_R=-0.2,
        error_L=0.0,
        eigenvalue=value,
        trajectory=trajectory,
    )
    assert SAYS["unstable"] in certificate_sentence(found.as_record())
    made = table(scr=(2.0, 8.0), x_over_r=(0.5, 3.0), certificate=found.as_record())
    assert certificate_sentence(replace(made).certificate) == certificate_sentence(found.as_record())


def test_how_well_an_estimate_is_known_in_words() -> None:
    assert error_text(0.0, 0.0) == "exactly"
    assert error_text(0.2, 0.0) == "to ±20 %"
    assert error_text(0.0, 0.06) == "to ±6 % of |Z|"
    assert error_text(0.2, 0.06) == "to ±20 %, or to ±6 % of |Z| where that is more"
