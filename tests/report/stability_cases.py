"""Small stability assessments with their reports, each made once for all tests of a worker."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from tests.report.layout import write_svg
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure, write_all
from vsgdesign.report.page.html import print_html
from vsgdesign.report.stability.page import stability_figures, stability_page
from vsgdesign.simulation.stability_result import step_evidence
from vsgdesign.study.parameters import study_from_text
from vsgdesign.verbs.pipeline import StabilityResult, assess_study

BASE = """
base = "case:hoang2025_5kva"
[study]
name = "small"
title = "Small, <short> & sweet"
[simulation]
duration = "0.3 s"
P_ref = "2 kW"
Q_ref = "1 kvar"
[stability]
scr = [2, 8]
x_over_r = [1, 5]
errors = [-0.1, 0, 0.1]
"""
FIXED = '[[controllers]]\nname = "fixed"\nkind = "fixed"\n'
SCHEDULED = '[[controllers]]\nname = "scheduled"\nkind = "scheduled"\n'
STRONGER = '[[events]]\ntime = "0.2 s"\ngrid = { scr = 8 }\n'
UNSTABLE_GAINS = "gains = { K_ip = 0.5, D_p = 10, K_iq = 5, D_q = 0.7 }\n"

TEXTS = {
    "plain": BASE + FIXED + SCHEDULED + STRONGER,
    # One SCR, several powers of which the largest does not fit every grid, gates at their ends.
    "odd": BASE.replace("[2, 8]", "[1.5]").replace("[-0.1, 0, 0.1]", "[0]")
    + 'P = ["0 kW", "5.5 kW"]\nQ = ["-1 kvar", "1 kvar"]\n'
    + "[stability.gates]\ndamping_ratio = 0.0\ngain_margin_db = 60\nphase_margin_deg = 180\nM_s = 1.0\n"
    + SCHEDULED,
    "unstable": BASE + FIXED + UNSTABLE_GAINS,
    "faulty": BASE.replace("[2, 8]", "[0.1, 0.2]") + "[grid]\nscr = 0.2\nx_over_r = 1\n" + SCHEDULED,
}
AS_WRITTEN = "unstable"


@dataclass(frozen=True)
class Made:
    """An assessment, its figures on disk and its page."""

    result: StabilityResult
    figures: list[WrittenFigure]
    page: Path

    @property
    def text(self) -> str:
        return self.page.read_text(encoding="utf-8")


@functools.cache
def assessed(name: str) -> StabilityResult:
    """With EMT evidence for one case only, and short: simulations take time."""
    result = assess_study(study_from_text(TEXTS[name]), evidence=False)
    if name != "plain":
        return result
    first = result.assessments[0]
    evidence = {(first.spec.name, cell.label): step_evidence(result.study, cell, 0.8) for cell in first.focus}
    return replace(result, evidence=evidence)


@functools.cache
def drawn(name: str) -> dict[str, NamedFigure]:
    """The figures of a case."""
    return {figure.name: figure for figure in stability_figures(assessed(name))}


def make(name: str, folder: Path) -> Made:
    """Figures and page of a case in a folder. Those of one case are drawn as the verb draws them."""
    result = assessed(name)
    if name == AS_WRITTEN:
        figures = write_all(stability_figures(result), folder)
    else:
        figures = [write_svg(named, folder) for named in drawn(name).values()]
    return Made(result, figures, print_html(stability_page(result, figures), folder / "report.html"))


_MADE: dict[str, Made] = {}


def case(name: str, factory: pytest.TempPathFactory) -> Made:
    """Of a case, made once for all tests of a worker."""
    if name not in _MADE:
        _MADE[name] = make(name, factory.mktemp(name))
    return _MADE[name]
