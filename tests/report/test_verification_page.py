"""Figures and page of a verification: complete, readable, and with the numbers of the document."""

from __future__ import annotations

import functools
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.report.layout import assert_apart
from tests.verification_documents import document
from vsgdesign.artifacts.verification_text import promise_sentences
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.verification.page import (
    again_text,
    case_value,
    cases_table,
    left_out_table,
    promises_table,
    verification_figures,
    write_verification_page,
)

UNIT = re.compile(r"\[[^\]]+\]$")


@functools.cache
def made(broken: bool) -> dict[str, Any]:
    return document(broken=broken)


@functools.cache
def drawn(broken: bool) -> dict[str, NamedFigure]:
    return {figure.name: figure for figure in verification_figures(made(broken))}


@pytest.mark.parametrize("broken", [True, False])
def test_every_axis_has_a_unit_and_nothing_overlaps(broken: bool) -> None:
    assert list(drawn(broken)) == ["verification_promises", "verification_map_step", "verification_map_grid"]
    for named in drawn(broken).values():
        labels = [label for axes in named.figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
        assert labels
        assert all(UNIT.search(label) for label in labels), (named.name, labels)
        assert_apart(named.figure, 1.5, named.name)


def panels(broken: bool, name: str) -> dict[str, Any]:
    axes = drawn(broken)[f"verification_map_{name}"].figure.axes
    return {one.get_title(loc="left"): one for one in axes if one.get_title(loc="left")}


def test_a_map_marks_the_bins_in_which_something_is_broken() -> None:
    found = made(True)["map"]["families"]["step"]
    broken = np.argwhere(np.array(found["broken"]) > 0)
    assert len(broken) > 1
    marked = panels(True, "step")["Share of broken cases"].lines[0].get_xydata()
    edges = [np.array(made(True)["map"][key]) for key in ("scr_edges", "x_over_r_edges")]
    bins = np.stack([np.searchsorted(e, marked[:, k]) - 1 for k, e in enumerate(edges)], axis=1)
    assert sorted(map(tuple, bins)) == sorted(map(tuple, broken))
    # A promise that is kept has no marks, although another one is broken in the same bins.
    assert len(panels(True, "step")["Worst settling time, asked for ≤ 1.3 s"].lines) == 0


def test_without_broken_cases_there_is_no_map_of_their_share() -> None:
    assert "Share of broken cases" not in panels(False, "step")
    assert list(panels(False, "step"))[-1] == "Judged steps, and the worst of them"


def test_bins_without_cases_are_left_grey() -> None:
    few = document(runs=60, broken=False)
    figure = next(one for one in verification_figures(few) if one.name == "verification_map_step")
    counts = np.array(few["map"]["families"]["step"]["judged"])
    assert (counts == 0).any()
    for axes in figure.figure.axes[::2]:
        values: Any = axes.collections[0].get_array()
        assert np.array_equal(np.ma.getmaskarray(values).T.reshape(counts.shape), counts == 0)
    assert "no judged cases" in [text.get_text() for text in figure.figure.legends[0].get_texts()]


def test_a_family_without_judged_cases_says_so(tmp_path: Path) -> None:
    empty = document(runs=40, broken=False)
    step = empty["families"]["step"]
    step["judged"] = 0
    for promise in step["promises"].values():
        promise.update(broken=0, judged=0, share=None, bound=None, one_in=None, worst=None, quantiles={})
    step["lost"] = {}
    maps = empty["map"]["families"]["step"]
    maps["judged"] = (0 * np.array(maps["judged"])).tolist()
    maps["worst_of"] = {name: [[None] * 10] * 12 for name in maps["worst_of"]}
    empty["worst"], empty["search"] = [], {"evaluations": 0, "found": []}
    text = write_verification_page(empty, tmp_path)[-1].read_text(encoding="utf-8")
    assert "Overshoot: no steps were judged, so nothing is known." in text
    assert "figure-verification_map_step" not in text
    assert "No search was made." in text


class Page(HTMLParser):
    """Ids, links and text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href") and not (value or "").startswith(("#", "data:")):
                assert (tag, name) == ("a", "href")
                self.links.append(value or "")

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", "".join(self.words))


@pytest.mark.parametrize("broken", [True, False])
def test_the_page_has_everything(tmp_path: Path, broken: bool) -> None:
    files = write_verification_page(made(broken), tmp_path)
    assert sorted(path.name for path in files if path.suffix == ".svg") == sorted(f"{n}.svg" for n in drawn(broken))
    assert all(path.is_file() for path in files)
    source = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(source)
    assert len(page.ids) == len(set(page.ids))
    assert [i for i in page.ids if i.startswith("part-")] == [f"part-{k}" for k in range(1, 9)]
    assert page.links == [case["study"] for case in (*made(broken)["worst"], *made(broken)["search"]["found"])]
    # The answer comes first, before any heading of a part.
    top = page.text.split("1. Promises")[0]
    for sentence in promise_sentences(made(broken)):
        assert sentence in top
    assert ('class="verdict warning"' in source) == broken
    assert "these do not count in the share" in page.text


def test_the_tables_have_the_numbers_of_the_document() -> None:
    rows = {(row[0], row[1]): row for row in promises_table(made(True)).rows}
    promise = made(True)["families"]["step"]["promises"]["overshoot"]
    row = rows["Steps of P_ref or Q_ref", "Overshoot ≤ 5 %"]
    assert row[2:4] == (str(promise["broken"]), f"{promise['judged']:,}")
    assert row[5] == f"1 in {promise['one_in']:,}"
    assert row[-1] == f"{100.0 * promise['worst']:.3g} %"
    last = left_out_table(made(True)).rows[-1]
    assert last[1] == "6,000"
    assert last[-1] == f"{made(True)['judged']:,}"
    counts = [int(cell.replace(",", "")) for cell in last[1:]]
    assert counts[0] == sum(counts[1:])


def test_all_bounds_together_hold_with_less() -> None:
    assert promises_table(made(True)).notes == (
        "∞: not settled or not at rest within the simulated time.",
        f"Lost jumps of the grid: {made(True)['families']['grid']['lost']['diverged']} diverged.",
        "Each bound holds with 99 % confidence by itself; all 5 together hold with at least 95 %.",
    )
    assert promises_table(document(runs=400, confidence=0.7)).notes[0].endswith("nothing is said of all 5 at once.")


def test_cases_that_were_simulated_again_are_compared() -> None:
    case = {"rank": 1, "simulated": {"overshoot": 0.05}, "difference": 2.4e-9, "agrees": True}
    assert again_text([case, case | {"rank": 2, "difference": None}]).endswith("agree to 2.4·10⁻⁹ of each figure.")
    other = case | {"rank": 7, "difference": None, "agrees": False}
    assert "rank 7 does not agree" in again_text([case, other])
    assert again_text([]) == again_text([{"rank": 1}]) == ""


def test_a_lost_case_says_how_it_was_lost() -> None:
    promise = {"figure": "recovery_s", "survival": True, "limit": 2.8}
    case = {"promise": "survival", "status": "latched", "figures": {"recovery_s": 2.39}, "broken": ["survival"]}
    assert case_value(case, "survival", promise) == "latched"
    assert case_value(case | {"status": "judged", "broken": []}, "survival", promise) == "2.39 s"


def test_the_source_is_shown_where_it_is_not_the_same_in_all_cases() -> None:
    cases = made(True)["worst"]
    assert cases_table("worst", cases, made(True)).head[-6:-2] == ("SCR", "X/R", "P [pu]", "Q [pu]")
    other = [
        case | {"start": case["start"] | {"f_hz": 50.0 + case["rank"], "error_R": 0, "error_X": 0}} for case in cases
    ]
    table = cases_table("worst", other, made(True))
    assert table.head[-1] == "f [Hz]"
    assert table.rows[2][-1] == "53.00"
    assert table.rows[0][0] == "1"
    tiny = [case | {"start": case["start"] | {"P_pu": -4e-6, "Q_pu": -4e-6}} for case in cases]
    assert cases_table("worst", tiny, made(True)).rows[0][-4:-2] == ("0.00", "0.00")
    assert table.links[0] == cases[0]["study"]


def test_a_single_x_over_r_is_one_row_of_bins() -> None:
    narrow = document(runs=600, broken=False)
    narrow["map"]["x_over_r_edges"] = [3.0] * 11
    figure = next(one for one in verification_figures(narrow) if one.name == "verification_map_step").figure
    step = narrow["map"]["families"]["step"]
    last = figure.axes[-2]
    assert last.get_title(loc="left").startswith("Judged steps")
    values: Any = last.collections[0].get_array()
    shown = np.ma.getdata(values).reshape(-1)
    sums = np.array(step["judged"]).sum(axis=1)
    assert np.allclose(shown, sums / sums.max())
    assert [label.get_text() for label in last.get_yticklabels()] == ["3"]


def test_promises_that_every_case_breaks_are_drawn() -> None:
    lost = document(runs=300)
    for family in lost["families"].values():
        for promise in family["promises"].values():
            promise["worst"] = 7.0 * promise["limit"]
            promise["quantiles"] = dict.fromkeys(promise["quantiles"], 5.0 * promise["limit"])
    first = next(verification_figures(lost))
    assert [text.get_text() for text in first.figure.axes[0].texts].count("700 %") == 5
