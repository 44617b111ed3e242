"""The certainty that a table needs of an estimate: one number on the terminal, on the page and in the export."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.cli.small_studies import call
from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.equations.scheduler_data import PARTLY
from vsgdesign.export import export_c_files
from vsgdesign.report.gain_table.words import heading
from vsgdesign.runtime import scheduler_of
from vsgdesign.runtime.needed_sigma import needed_sigma_of, needed_sigma_text, needed_sigmas

BOX = {"box": {"error_R": 0.2, "error_X": 0.2, "error_Z": 0.0}}
ASKED = replace(table(), specification=BOX)


def test_it_is_what_the_scheduler_follows_fully() -> None:
    """In every node: an estimate a little more certain is followed fully, one a little less certain in part."""
    needed = needed_sigmas(ASKED)
    assert needed.shape == ASKED.shape
    scheduler = scheduler_of(ASKED)
    lookup, omega = scheduler.lookup, scheduler.lookup.omega
    for (i, j), sigma in np.ndenumerate(needed):
        R, L = lookup.grid(float(ASKED.scr[i]), 1.0 / float(ASKED.x_over_r[j]))
        for factor, partly in ((0.999, 0), (1.001, PARTLY)):
            var = 0.5 * (factor * sigma) ** 2 * (R**2 + (omega * L) ** 2)
            covariance = (var, 0.0, var / omega**2)
            answers = [scheduler.update_estimate(R, L, 1e3, 0.0, 110.0, covariance=covariance) for _ in range(4)]
            assert answers[-1].status & PARTLY == partly
    assert needed_sigma_of(ASKED).sigma == pytest.approx(needed.min(), rel=1e-6)


def test_by_hand() -> None:
    """±20 % of R at X/R 10 is 2 % of |Z|; the 95 % circle of χ² is 2.448 σ per axis wide, and √2 of them are σ of Z."""
    needed = needed_sigma_of(ASKED)
    assert needed.x_over_r == pytest.approx(10.0)
    assert needed.sigma == pytest.approx(math.sqrt(2.0) * 0.2 / math.hypot(1.0, 10.0) / 2.4477, rel=1e-4)
    wide = replace(ASKED, specification={"box": BOX["box"] | {"error_Z": 0.05}})
    assert needed_sigma_of(wide).sigma == pytest.approx(math.sqrt(2.0) * 0.05 / 2.4477, rel=1e-4)


def test_nodes_outside_need_nothing() -> None:
    status = np.full((4, 4), "met", dtype="<U8")
    status[0, 1] = "outside"
    assert np.argwhere(np.isnan(needed_sigmas(table(status=status)))).tolist() == [[0, 1]]


def test_every_page_and_verb_says_the_same(tmp_path: Path) -> None:
    file = tmp_path / "t.json"
    write_table_file(ASKED, file)
    sentence = needed_sigma_text(ASKED)
    assert sentence == (
        "An estimate is followed fully on every grid if its relative standard deviation of Z is at most 1.1 % (X/R 10 "
        "needs it), and in part otherwise: the gains are for R and X known to ±20 %."
    )
    assert sentence in list(heading(ASKED))
    assert sentence in call("table", "show", file).stdout
    assert sentence in call("table", "show", file, "--sigma").stdout
    shown = json.loads(call("table", "show", file, "--sigma", "--json").stdout)
    np.testing.assert_allclose(shown["needed_sigma"], needed_sigmas(ASKED))
    folder = export_c_files(file, tmp_path / "c").folder
    assert sentence in (folder / "INTEGRATION.md").read_text(encoding="utf-8")


def test_errors_that_are_assumed_are_said_to_be() -> None:
    exact = replace(ASKED, specification={}, validity=replace(ASKED.validity, error=0.0))
    assert "These errors are assumed: the table was designed for exact estimates." in needed_sigma_text(exact)
    apart = replace(ASKED, specification={"box": {"error_R": 0.1, "error_X": 0.15, "error_Z": 0.04}})
    assert needed_sigma_text(apart).endswith(
        "R known to ±10 %, or to ±4 % of |Z| where that is more, and X to ±15 %, or to ±4 % of |Z| where that is more."
    )
    refused = replace(ASKED, certificate=table(certificate={"region": {"scr": [30.0, 40.0]}}).certificate)
    assert needed_sigma_text(refused).startswith("No scheduler can take this table. scheduler settings:")
